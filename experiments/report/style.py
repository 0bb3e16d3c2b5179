"""Style of all figures of the pages, and a figure as an SVG to stand inside one."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from typing import Any, Final

import matplotlib as mpl
from markupsafe import Markup
from matplotlib.figure import Figure

STYLE: Final[Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "pzcap",
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.edgecolor": "#9aa0a6",
    "axes.labelcolor": "#3c4043",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e8eaed",
    "grid.linewidth": 0.8,
    "axes.axisbelow": True,
    "xtick.color": "#5f6368",
    "ytick.color": "#5f6368",
    "xtick.major.size": 0,
    "ytick.major.size": 0,
    "lines.linewidth": 1.4,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "figure.constrained_layout.use": True,
}
COLOURS: Final = ("#3b8ec2", "#d98e04", "#00916a", "#bb5d94")
INK, MUTED, KEY = "#202124", "#9aa0a6", "#d93025"


def svg(width: float, height: float, draw: Callable[[Figure], None]) -> Markup:
    """The figure that ``draw`` fills, ``width`` x ``height`` inches, as an SVG element that scales with the page."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(width, height))
        draw(figure)
        out = io.StringIO()
        figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None}, transparent=True)
    text = out.getvalue()
    text = text[text.index("<svg") :]
    scaling = re.sub(
        r'<svg ([^>]*?)width="[^"]*" height="[^"]*"',
        r"<svg \1",
        re.sub(r'height="[^"]*pt" |width="[^"]*pt" ', "", text, count=2),
        count=1,
    )
    return Markup(scaling)  # Matplotlib has escaped what is written in it


def literal(text: str) -> str:
    """Text that Matplotlib is to draw as it is: between dollars it reads formulas, and gives up on those it cannot."""
    return text.replace("$", r"\$")
