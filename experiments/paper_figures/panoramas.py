"""Figures 4 and 5: the panoramas, and where the reference pose and a panned frame lie on one of them."""

from __future__ import annotations

from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.paper_figures.canvas import (
    COLOURS,
    MUTED,
    PANNED,
    REFERENCE,
    TRUTH_ON_PAPER,
    WIDTH,
    Drawn,
    beneath,
    cased,
    connect,
    letter,
    lines,
    show,
)
from experiments.paper_figures.material import Located, Run
from experiments.report.pictures import EMPTY, border_on_panorama, window
from experiments.report.style import literal
from experiments.score import sweep_errors
from pzcap.geometry import camera as geometry
from pzcap.types import Array, PzcapError
from pzcap.viewer.drawing import centred, footprint

PANORAMA_PX: Final = 2400  # across, in a file
MARGIN_RAD: Final = 0.12


def panoramas(run: Run) -> Drawn:
    """Figure 4."""
    located = run.located()
    figure = Figure(figsize=(WIDTH, 0.3 + 1.28 * len(located)))
    plots = figure.subplots(len(located), 1, squeeze=False)[:, 0]
    for plot, one in zip(plots, located, strict=True):
        _panorama(plot, run, one)
    plots[-1].set_xlabel("pan [deg], positive to the left")
    caption = (
        "Panoramas of the empty hall, on the cylinder about each camera's pan axis; columns are pan angles, rows are "
        "tilt angles. Blue: what the camera sees at its reference pose, whose middle is pan 0. Ticks above: the "
        "frames of the sweep. 'Closes to' is what the chain of displacements missed the full turn by before that was "
        "distributed, 'residual' the RMS of the sweep's matches after the adjustment."
    )
    if run.truth is not None:
        caption += " Pale, beneath: the same frames and view by the truth; the RMS error of the sweep's pan is given."
    return Drawn(4, "panoramas", "Panoramas", caption, figure)


def _panorama(plot: Axes, run: Run, one: Located) -> None:
    shown, camera = centred(one.panorama), one.camera
    height, width = shown.image.shape[:2]
    image = np.where(shown.valid[..., None], shown.image, EMPTY)
    show(plot, image, shrink=PANORAMA_PX / width)
    plot.set_ylim(height - 0.5, -0.17 * height)
    column = shown.origin_px[0] - shown.sweep_pan_rad * shown.px_per_rad
    said = [f"residual {shown.residual_px:.2f} px"]
    if shown.full_turn:
        column = np.mod(column, width)
        said.insert(0, f"closes to {abs(np.degrees(shown.closure_rad)):.3f}°")
    true = run.true_camera(one.name, None)
    errors = None
    if run.truth is not None and true is not None:
        beneath(plot, footprint(shown, camera, true))
        errors = sweep_errors(one.panorama, run.truth, run.truth.camera_names.index(one.name))
    if errors is not None:
        _ticks(plot, column + errors * shown.px_per_rad, height, TRUTH_ON_PAPER, 3.0)
        said.append(f"sweep {np.degrees(np.sqrt(np.mean(errors**2))):.4f}° RMS off the truth")
    _ticks(plot, column, height, COLOURS[one.number % len(COLOURS)], 0.7)
    at = geometry.at(camera, 0.0, camera.tilt_rad, camera.lens.reference_focal_px)
    cased(plot, footprint(shown, camera, at), REFERENCE)
    plot.set_title(f"Camera {literal(one.name)}", pad=3)
    plot.set_title(", ".join(said), loc="right", fontsize=8.0, fontweight="normal", color=MUTED, pad=3)
    degrees: Array = np.arange(-720.0, 721.0, 30.0)  # a partial panorama may count on beyond half a turn
    at_column = shown.origin_px[0] - np.radians(degrees) * shown.px_per_rad
    inside = (at_column >= -1) & (at_column <= width)
    labels = [f"{180.0 - (180.0 - value) % 360.0:.0f}" for value in degrees[inside]]
    plot.set_xticks(at_column[inside], labels, fontsize=7.5)
    tilts: Array = np.array([-15.0, 0.0, 10.0])
    rows = shown.origin_px[1] - np.tan(np.radians(tilts)) * shown.px_per_rad
    inside = (rows >= 0) & (rows < height)
    plot.set_yticks(rows[inside], [f"{value:.0f}°" for value in tilts[inside]], fontsize=7.5)


def _ticks(plot: Axes, columns: Array, height: int, colour: str, width: float) -> None:
    strips = [np.array([(x, -0.15 * height), (x, -0.04 * height)]) for x in columns]
    lines(plot, strips, colour, width)


# --------------------------------------------------------------------------------------------------------------


def located_frames(run: Run) -> Drawn:
    """Figure 5."""
    one, frame = _most_panned(run)
    panorama, camera = one.panorama, one.camera
    reference_image, image = run.references[one.number], run.views(frame)[one.number]
    at = one.at[frame]
    assert at is not None
    home = geometry.at(camera, 0.0, camera.tilt_rad, camera.lens.reference_focal_px)
    pan = float(one.track.pan_rad[frame])
    borders = [border_on_panorama(panorama, camera, a, near) for a, near in ((home, 0.0), (at, pan))]
    azimuths = (panorama.origin_px[0] - np.concatenate(borders)[:, 0]) / panorama.px_per_rad
    low, high = azimuths.min() - 6 * MARGIN_RAD, azimuths.max() + 6 * MARGIN_RAD
    crop, corner = window(panorama, low, high, (0, panorama.image.shape[0]))

    figure = Figure(figsize=(WIDTH, 6.6))
    grid = figure.add_gridspec(2, 2, height_ratios=[1.0, 1.25])
    wide = figure.add_subplot(grid[0, :])
    show(wide, crop)
    rows = (
        ("reference pose", home, None, borders[0] - corner, REFERENCE, reference_image),
        (f"frame {frame}", at, frame, borders[1] - corner, PANNED, image),
    )
    # the picture that lies further left on the panorama stands on the left
    order = sorted(rows, key=lambda row: float(row[3][:, 0].mean()))
    for place, (name, view, index, border, colour, picture) in enumerate(order):
        true = run.true_camera(one.name, index)
        if true is not None:
            beneath(wide, [border_on_panorama(panorama, camera, true, pan if index is not None else 0.0) - corner])
        cased(wide, [border], colour, 1.8)
        below = figure.add_subplot(grid[1, place])
        if picture is not None:
            show(below, picture)
            for spine in below.spines.values():
                spine.set(visible=True, color=colour, linewidth=2.4)
        azimuth = 0.0 if index is None else np.degrees(pan)
        zoom = view.focal_px / camera.lens.reference_focal_px
        letter(below, f"{name}: pan {azimuth:+.2f}°, zoom {zoom:.2f}")
        start = np.array([border[:, 0].mean(), border[:, 1].max()])
        connect(figure, (wide, start), (below, np.array([view.width / 2, -0.5])), colour, lw=1.4)
    origin = panorama.origin_px - corner
    wide.plot(*origin, "+", color=REFERENCE, ms=11, mew=1.8)
    wide.set_title(f"Camera {literal(one.name)}: panorama", pad=4)
    caption = (
        f"The image of the calibration object at the reference pose (blue) and frame {frame} of the motion after "
        f"panning and zooming (orange), each located on the panorama of camera {one.name}. The cross is the origin: "
        "pan 0, slope 0."
    )
    if run.truth is not None:
        caption += " Pale line beneath each border: the same view by the truth."
    return Drawn(5, "frames_on_panorama", "Frames located on the panorama", caption, figure)


def _most_panned(run: Run) -> tuple[Located, int]:
    """The view that was turned furthest from its reference pose, of those that were recorded."""
    views = [(one, int(frame)) for one in run.located() for frame in np.flatnonzero(one.track.valid)]
    for one, frame in sorted(views, key=lambda view: -abs(float(view[0].track.pan_rad[view[1]]))):
        if run.views(frame)[one.number] is not None:
            return one, frame
    raise PzcapError(f"{run.reconstruction.capture_name}: no frame was located")
