"""The paper's figures, drawn anew from two finished runs. `python -m experiments.figures` makes the page."""
