"""Style and drawing of all figures: one style, one set of colours, and pictures over which lines stay lines in an SVG.

Everywhere the truth is the wide pale line that lies beneath the estimate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import cv2
import matplotlib.patheffects as effects
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import ConnectionPatch
from matplotlib.ticker import MultipleLocator

from experiments.paper_figures.material import Run
from experiments.report import style
from pzcap.geometry import camera as geometry
from pzcap.types import Array, Camera, Image
from pzcap.viewer.drawing import BONE_COLOURS, BONES, KEYFRAME_COLOUR

WIDTH: Final = 10.0
"""Of a figure, inches."""
MARGIN_M: Final = 2.2
"""Of floor about the tripods."""
STYLE: Final[Any] = style.STYLE | {"svg.fonttype": "path", "axes.grid": False, "savefig.dpi": 200}
COLOURS: Final = style.COLOURS
INK, MUTED = style.INK, style.MUTED
TRUTH_ON_IMAGE, TRUTH_ON_PAPER = "#ffffff", "#c4c7cc"
REFERENCE, PANNED = "#56b4e9", "#f0a020"
"""Of what belongs to the reference pose, and to a frame after panning and zooming; told apart by the colour-blind."""

Plain = tuple[float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """A figure, and what is said of it."""

    number: int  # in the paper
    name: str
    title: str
    caption: str
    figure: Figure

    @property
    def stem(self) -> str:
        """Of its files."""
        return f"figure{self.number:02d}_{self.name}"


def show(plot: Axes, image: Image, *, shrink: float = 1.0) -> None:
    """``image`` (H, W, 3) without axes, in its own pixels; stored smaller by ``shrink``."""
    height, width = image.shape[:2]
    extent = (-0.5, width - 0.5, height - 0.5, -0.5)
    if shrink < 1.0:
        image = np.asarray(cv2.resize(image, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA), np.uint8)
    plot.imshow(image[..., ::-1], extent=extent, aspect="equal", interpolation="antialiased")
    plot.set(xlim=extent[:2], ylim=extent[2:], xticks=[], yticks=[])
    plot.spines[:].set_visible(False)


def close_together(figure: Figure) -> None:
    """Pictures that follow each other without room for axes between them."""
    figure.set_layout_engine("constrained", w_pad=0.02, h_pad=0.02, wspace=0.01, hspace=0.0)


def plain(colour: tuple[int, int, int]) -> Plain:
    """A colour of 0..255 as matplotlib takes it."""
    return colour[0] / 255, colour[1] / 255, colour[2] / 255


def lines(plot: Axes, strips: Sequence[Array], colour: Any, width: float, **style: Any) -> None:
    """Polylines (N, 2). They are cut off at the border and do not move it."""
    plot.add_collection(LineCollection(list(strips), colors=colour, linewidths=width, **style), autolim=False)


def cased(plot: Axes, strips: Sequence[Array], colour: Any, width: float = 1.4, **style: Any) -> None:
    """Polylines with a dark rim, to be seen on any picture."""
    rim = [effects.Stroke(linewidth=width + 1.2, foreground="#000000a0"), effects.Normal()]
    lines(plot, strips, colour, width, path_effects=rim, **style)


def beneath(plot: Axes, strips: Sequence[Array], width: float = 3.6) -> None:
    """Draw the truth on a picture."""
    lines(plot, strips, TRUTH_ON_IMAGE, width, alpha=0.75, capstyle="round", joinstyle="round")


def bones(pixels: Array) -> list[Array]:
    """The bones (2, 2) of a figure (21, 2)."""
    return list(pixels[np.array(BONES)])


def skeleton(plot: Axes, pixels: Array, *, keyframe: bool = False, width: float = 1.3) -> None:
    """A figure (21, 2): in the colours of its sides, or red where a person posed it."""
    colours = plain(KEYFRAME_COLOUR) if keyframe else [plain(colour) for colour in BONE_COLOURS]
    lines(plot, bones(pixels), colours, width, capstyle="round")


def seen(camera: Camera, points_m: Array) -> Array | None:
    """World points (N, 3) as ``camera`` sees them (N, 2); None where one is not before it."""
    pixels, depth = geometry.project(camera, points_m)
    return pixels if np.all(depth > 0.2) else None


def both_bodies(plot: Axes, run: Run, camera: Camera, true: Camera | None, frame: int) -> None:
    """The body in a frame set as ``camera`` sees it, over the truth as the ``true`` camera does."""
    body, was, motion = run.body(), run.true_body(), run.reconstruction.motion
    if was is not None and true is not None and (pixels := seen(true, was[frame])) is not None:
        beneath(plot, bones(pixels), 2.2)
    if motion is not None and motion.valid[frame] and (pixels := seen(camera, body[frame])) is not None:
        skeleton(plot, pixels, width=1.1)


def floor(plot: Axes, places_m: Array) -> None:
    """Axes in metres of a floor on which tripods stand at (C, 2)."""
    low, high = places_m.min(axis=0) - MARGIN_M, places_m.max(axis=0) + MARGIN_M
    plot.set(aspect="equal", xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    for axis in (plot.xaxis, plot.yaxis):
        axis.set_major_locator(MultipleLocator(4))
        axis.set_minor_locator(MultipleLocator(2))
    plot.tick_params(which="minor", length=0)


def tripod(plot: Axes, place_m: Array, name: str, colour: str) -> None:
    """A camera's place (2,) on the floor, its name beyond it."""
    plot.plot(*place_m, "o", color=colour, ms=6, mec="white", zorder=4)
    x, y = (1.12 * place_m).tolist()
    plot.text(x, y, style.literal(name), ha="center", va="center", color=colour, fontweight="bold")


def letter(plot: Axes, text: str) -> None:
    """A label in the corner of a picture."""
    plot.text(
        0.015, 0.98, style.literal(text), transform=plot.transAxes, va="top", color="white", fontsize=8.0,
        path_effects=[effects.withStroke(linewidth=2.0, foreground="#000000c0")],
    )  # fmt: skip


def connect(figure: Figure, start: tuple[Axes, Array], end: tuple[Axes, Array], colour: Any, **style: Any) -> None:
    """A line or an arrow from a point of one plot to a point of another."""
    patch = ConnectionPatch(
        (float(start[1][0]), float(start[1][1])), (float(end[1][0]), float(end[1][1])), "data", "data",
        axesA=start[0], axesB=end[0], color=colour, **style,
    )  # fmt: skip
    patch.set_in_layout(False)
    figure.add_artist(patch)
