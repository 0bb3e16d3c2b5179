"""What each piece of evidence is worth, and each error costs: see `experiments.comparisons.ablation.__main__`."""
