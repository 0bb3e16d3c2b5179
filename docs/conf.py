"""How the pages in this folder become a site: `make docs`."""

from __future__ import annotations

from pathlib import Path

from experiments.settings_reference import markdown

project = "pzcap"
extensions = ["myst_parser", "sphinx.ext.mathjax"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
html_theme = "furo"
exclude_patterns = ["_build"]

(Path(__file__).parent / "configuration.md").write_text(markdown(), encoding="utf-8")  # always that of this code
