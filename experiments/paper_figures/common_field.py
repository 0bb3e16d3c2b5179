"""Figure 1: the common field of view of fixed, pan and pan-zoom cameras."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.paper_figures.canvas import COLOURS, INK, MUTED, TRUTH_ON_PAPER, WIDTH, Drawn, tripod
from experiments.paper_figures.canvas import floor as frame_floor
from experiments.paper_figures.field import (
    CELL_M,
    FEET,
    FREEDOMS,
    Floor,
    Standing,
    common_height_px,
    floor_between,
    zoom_range,
)
from experiments.paper_figures.material import Run
from pzcap.types import Array, Mask, PanZoomCamera

TITLES: Final = {"fixed": "(a) Fixed cameras", "pan": "(b) Pan cameras", "pan-zoom": "(c) Pan-zoom cameras"}
BODY: Final = Standing()
LARGE_PX: Final = 200.0  # what silhouettes are scored from
TALLEST_PX: Final = 350.0  # on the colour scale


def common_field(runs: Sequence[Run], cell_m: float = CELL_M) -> Drawn:
    """The cameras are those of the first run; they zoom as far as any run shows them to."""
    located = runs[0].located()
    names, cameras = [one.name for one in located], [one.camera for one in located]
    tracks = [one.track.focal_px[one.track.valid] for run in runs for one in run.located()]
    focals = zoom_range(tracks, cameras[0].lens.reference_focal_px)
    floor = floor_between(cameras, cell_m)
    true = [camera for name in names if (camera := runs[0].true_head(name)) is not None]

    figure = Figure(figsize=(WIDTH, 4.1))
    plots = figure.subplots(1, 3, sharey=True)
    said: list[str] = []
    picture: Any = None
    for plot, freedom in zip(plots, FREEDOMS, strict=True):
        feet = common_height_px(cameras, floor, FEET, freedom, focals)
        tall = common_height_px(cameras, floor, BODY, freedom, focals)
        picture = _areas(plot, floor, feet, tall)
        areas = [floor.area_m2(feet >= 0), floor.area_m2(tall >= 0), floor.area_m2(tall >= LARGE_PX)]
        text = f"floor {areas[0]:.0f} m²; body {areas[1]:.0f} m²; {LARGE_PX:.0f} px tall {areas[2]:.0f} m²"
        if true:
            true_tall = common_height_px(true, floor, BODY, freedom, focals)
            _border(plot, floor, true_tall >= 0, TRUTH_ON_PAPER, 3.0, zorder=2.5)
            said.append(f"{floor.area_m2(true_tall >= 0):.1f} for {areas[1]:.1f} m²")
        _border(plot, floor, tall >= 0, INK, 1.1, zorder=3)
        _border(plot, floor, floor.inside, MUTED, 0.7, linestyles="dotted", zorder=1)
        _tripods(plot, cameras, names, wedges=freedom == "fixed")
        plot.set_title(TITLES[freedom], pad=16)
        plot.text(0.0, 1.02, text, transform=plot.transAxes, fontsize=8.0, color=INK)
    plots[0].set_ylabel("y [m]")
    bar = figure.colorbar(picture, ax=plots, orientation="horizontal", aspect=60, shrink=0.6, extend="max")
    bar.set_label("height of a standing body in the camera that sees it smallest [px]")
    low, high = focals.min() / cameras[0].lens.reference_focal_px, focals.max() / cameras[0].lens.reference_focal_px
    caption = (
        f"Common field of view of {len(cameras)} cameras on the floor between them (dotted, "
        f"{floor.area_m2(floor.inside):.0f} m²). Grey: a point of the floor is seen by all. Coloured, with a dark "
        "border: somebody who stands there, "
        f"{BODY.height_m:.2f} m tall and {BODY.width_m:.1f} m wide, is whole in all pictures; the colour says how tall "
        f"in the camera that sees them smallest. (a) at the reference pose, whose edges are drawn; (b) turned towards "
        f"the body; (c) turned, and zoomed in as far as the body stays whole, within {low:.2f} to {high:.2f} times the "
        "reference focal length, which is what the two runs show of the lenses. Panning widens the area, and only the "
        "zoom makes the body large in all of it."
    )
    if said:
        caption += " Pale line beneath the border: the same with the true cameras (" + ", ".join(said) + ")."
    return Drawn(1, "common_field_of_view", "Common field of view", caption, figure)


def _areas(plot: Axes, floor: Floor, feet: Array, tall: Array) -> Any:
    x, y = floor.points_m.T
    half = floor.cell_m / 2
    extent = (x.min() - half, x.max() + half, y.min() - half, y.max() + half)
    seen = np.ma.masked_array(np.zeros(floor.shape), ~floor.grid((feet >= 0) & floor.inside))
    plot.imshow(seen, extent=extent, origin="lower", cmap="gray", vmin=-6, vmax=1, interpolation="nearest")
    whole = np.ma.masked_array(floor.grid(tall), ~floor.grid((tall >= 0) & floor.inside))
    return plot.imshow(
        whole, extent=extent, origin="lower", cmap="cividis", vmin=50.0, vmax=TALLEST_PX, interpolation="nearest"
    )


def _border(plot: Axes, floor: Floor, where: Mask, colour: str, width: float, **style: Any) -> None:
    rim = 1  # of squares that are not inside: the border closes
    x, y = (np.pad(floor.grid(axis), rim, "reflect", reflect_type="odd") for axis in floor.points_m.T)
    inside = np.pad(floor.grid(where & floor.inside).astype(float), rim)
    if inside.any():
        plot.contour(x, y, inside, levels=[0.5], colors=colour, linewidths=width, **style)


def _tripods(plot: Axes, cameras: Sequence[PanZoomCamera], names: Sequence[str], *, wedges: bool) -> None:
    """Draw the cameras, and the edges of what they see at the reference pose."""
    frame_floor(plot, np.array([camera.world_T_head[:2, 3] for camera in cameras]))
    plot.set_xlabel("x [m]")
    for number, (camera, name) in enumerate(zip(cameras, names, strict=True)):
        place, ahead = camera.world_T_head[:2, 3], camera.world_T_head[:2, 0]
        colour = COLOURS[number % len(COLOURS)]
        if wedges:
            half = np.arctan(camera.lens.width / 2 / camera.lens.reference_focal_px)
            for angle in (-half, half):
                c, s = np.cos(angle), np.sin(angle)
                edge = place + 22.0 * np.array([c * ahead[0] - s * ahead[1], s * ahead[0] + c * ahead[1]])
                plot.plot(*np.array([place, edge]).T, color=colour, lw=0.8, ls=(0, (5, 3)))
        tripod(plot, place, name, colour)
    plot.tick_params(colors=MUTED)
