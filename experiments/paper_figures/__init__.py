"""The paper's figures, drawn anew from two finished runs. `python -m experiments.paper_figures` makes the page."""
