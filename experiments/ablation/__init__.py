"""What each piece of evidence is worth, and each error costs: see `experiments.ablation.__main__`."""
