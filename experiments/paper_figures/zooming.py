"""Figures 11, 12 and 13: what the zoom is good for."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from experiments.paper_figures.canvas import (
    COLOURS,
    INK,
    TRUTH_ON_PAPER,
    WIDTH,
    Drawn,
    both_bodies,
    close_together,
    floor,
    letter,
    show,
    tripod,
)
from experiments.paper_figures.material import Located, Run
from experiments.report.plots import triangle
from experiments.report.style import literal
from pzcap.geometry import camera as geometry
from pzcap.geometry.lens import at as lens_at
from pzcap.localisation.panorama_sampler import ViewPlace, warp_background
from pzcap.types import Camera, Image, PanZoomCamera, PzcapError

INSTANTS: Final = 4
HERE = "#d55e00"  # where somebody is on their path
FADED: Final = 0.45  # of the panorama, where the frame saw nothing


def _instants(run: Run) -> NDArray[np.int64]:
    """Evenly spread frames; the last but one, as a video may end on a dropped one."""
    frames = len(run.reconstruction.timecodes)
    return np.unique(np.linspace(0, max(frames - 2, 0), INSTANTS).round().astype(np.int64))


def top_view(run: Run) -> Drawn:
    """Figure 11."""
    located, motion = run.located(), run.reconstruction.motion
    if motion is None:
        raise PzcapError(f"{run.reconstruction.capture_name}: no motion was tracked; Fig. 11 needs a path")
    figure = Figure(figsize=(WIDTH, 7.5))
    plots = figure.subplots(2, 2, sharex=True, sharey=True)
    true = run.true_body()
    for plot, frame in zip(plots.ravel(), _instants(run), strict=False):
        floor(plot, np.array([one.camera.world_T_head[:2, 3] for one in located]))
        plot.grid(visible=True, which="both", color="#e8eaed", lw=0.7)
        for one in located:
            _camera(plot, run, one, int(frame))
        if true is not None:
            plot.plot(*true[:, 0, :2].T, color=TRUTH_ON_PAPER, lw=4.0)
        plot.plot(*motion.joints_m[motion.valid, 0, :2].T, color=INK, lw=1.4)
        if motion.valid[frame]:
            plot.plot(*motion.joints_m[frame, 0, :2], "o", color=HERE, ms=6, mec="white", mew=0.8, zorder=5)
        plot.set_title(f"frame {frame}", pad=3)
    for plot in plots[-1]:
        plot.set_xlabel("x [m]")
    for plot in plots[:, 0]:
        plot.set_ylabel("y [m]")
    caption = (
        "The cameras and the pedestrian from above at four instants, on a grid of 2 m. A camera is a triangle: its "
        "apex is the viewpoint, its height the focal length (4 m for the reference focal length), its base the width "
        "of the image in the same measure, so that the angle at the apex is the angle of view. Dark: the path of the "
        "pelvis, with a dot where it is."
    )
    if run.truth is not None:
        caption += " Pale, beneath: triangles and path by the truth."
    return Drawn(11, "top_view", "Cameras and path from above", caption, figure)


def _camera(plot: Axes, run: Run, one: Located, frame: int) -> None:
    colour = COLOURS[one.number % len(COLOURS)]
    head, true = run.true_head(one.name), run.true_track(one.name)
    if head is not None and true is not None:
        plot.plot(*triangle(head, float(true[0][frame]), float(true[1][frame])).T, color=TRUTH_ON_PAPER, lw=4.0)
    if one.track.valid[frame]:
        corners = triangle(one.camera, float(one.track.pan_rad[frame]), float(one.track.focal_px[frame]))
        plot.fill(*corners.T, color=colour, alpha=0.16, lw=0)
        plot.plot(*corners.T, color=colour, lw=1.2)
    tripod(plot, one.camera.world_T_head[:2, 3], one.name, colour)


# --------------------------------------------------------------------------------------------------------------


def focal_lengths(run: Run) -> Drawn:
    """Figure 12."""
    located = run.located()
    figure = Figure(figsize=(WIDTH, 3.5))
    plot = figure.subplots()
    width = located[0].camera.lens.width
    worst = []
    for one in located:
        colour, track = COLOURS[one.number % len(COLOURS)], one.track
        frames, style = np.arange(len(track.valid)), ("-", (0, (6, 2)))[one.number % 2]
        true = run.true_track(one.name)
        if true is not None:
            plot.plot(frames, true[1] / width, color=TRUTH_ON_PAPER, lw=5.0, zorder=1)
            worst.append(100 * np.abs(track.focal_px / true[1] - 1)[track.valid].max())
        estimate = np.ma.masked_array(track.focal_px / width, ~track.valid)
        plot.plot(
            frames, estimate, color=colour, lw=1.6, ls=style, label=f"camera {literal(one.name)}", zorder=2 + one.number
        )
    reference = float(np.mean([one.camera.lens.reference_focal_px for one in located])) / width
    plot.axhline(reference, color=INK, ls=":", lw=1.3, label="reference")
    plot.set(xlabel="frame", ylabel=f"focal length [×{width} px]", xlim=(0, len(located[0].track.valid) - 1))
    plot.set_ylim(0, None)
    plot.grid(visible=True, color="#e8eaed", lw=0.7)
    plot.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=len(located) + 1, borderaxespad=0.2)
    caption = (
        "Focal length of each camera while the pedestrian walks, zoomed by hand so that the body fills the picture. "
        "Dotted: the focal length at the reference pose, in the mean of the cameras."
    )
    if worst:
        caption += f" Pale, beneath: the truth, from which no frame departs by more than {max(worst):.3f} %."
    return Drawn(12, "focal_lengths", "Focal lengths over time", caption, figure)


# --------------------------------------------------------------------------------------------------------------


def fixed_focus(run: Run) -> Drawn:
    """Figure 13: the camera whose zoom changed most, and the one that was zoomed in furthest."""
    located = run.located()
    spread = [float(np.ptp(np.log(one.track.focal_px[one.track.valid]))) for one in located]
    far = [float(np.median(one.track.focal_px[one.track.valid])) for one in located]
    changing = located[int(np.argmax(spread))]
    distant = max(
        (one for one in located if one is not changing), key=lambda one: far[located.index(one)], default=changing
    )
    frames = _instants(run)
    figure = Figure(figsize=(WIDTH, 7.7))
    close_together(figure)
    plots = figure.subplots(4, len(frames), squeeze=False)
    for pair, one in enumerate((changing, distant)):
        for column, frame in enumerate(frames):
            _pair(plots[2 * pair, column], plots[2 * pair + 1, column], run, one, int(frame))
        for row, text in enumerate(("variable focus", "fixed focus")):
            plots[2 * pair + row, 0].set_ylabel(f"camera {literal(one.name)}, {text}", fontsize=8.5, color=INK)
    caption = (
        "Upper row of each camera: the frames as they were taken, with variable focal length f. Lower row: what the "
        "camera would have taken at its reference focal length f0, made from them by eq. 17 (x' = f0 / f · x about the "
        "principal point); what the frame did not see is filled in, faded, from the panorama. Where f0 / f is above 1 "
        "the body is cut off; where it is below, the body is small. Coloured: the captured skeleton, in the lower "
        "row by eq. 16."
    )
    if run.truth is not None:
        caption += " Pale, beneath: the truth."
    return Drawn(13, "fixed_focus", "Variable against fixed focal length", caption, figure)


def _pair(variable: Axes, fixed: Axes, run: Run, one: Located, frame: int) -> None:
    """One frame as it was taken and at the reference focal length."""
    image, at = run.views(frame)[one.number], one.at[frame]
    for plot in (variable, fixed):
        plot.set(xticks=[], yticks=[])
    if image is None or at is None:
        variable.text(0.5, 0.5, "no frame", ha="center", transform=variable.transAxes)
        return
    pan, tilt, focal = (float(values[frame]) for values in (one.track.pan_rad, one.track.tilt_rad, one.track.focal_px))
    reference = one.camera.lens.reference_focal_px
    show(variable, image)
    show(fixed, at_fixed_focus(image, one, pan, tilt, focal))
    letter(variable, f"frame {frame}, f = {focal / reference:.2f} f0")
    true = run.true_camera(one.name, frame)
    held = geometry.at(one.camera, pan, tilt, reference)
    both_bodies(variable, run, at, true, frame)
    both_bodies(fixed, run, held, None if true is None else _zoomed(run.true_head(one.name), true, reference), frame)


def at_fixed_focus(image: Image, one: Located, pan_rad: float, tilt_rad: float, focal_px: float) -> Image:
    """Eq. 17, over the panorama."""
    camera = one.camera
    reference = camera.lens.reference_focal_px
    ratio, here, there = reference / focal_px, lens_at(camera.lens, focal_px)[0], lens_at(camera.lens, reference)[0]
    warp = np.column_stack([ratio * np.eye(2), there - ratio * here])
    size = camera.lens.width, camera.lens.height
    soft = cv2.GaussianBlur(image, (0, 0), 0.4 / ratio) if ratio < 0.8 else image  # or it would alias
    moved = cv2.warpAffine(soft, warp, size, flags=cv2.INTER_LINEAR)
    seen_there = cv2.warpAffine(np.ones(image.shape[:2], np.uint8), warp, size, flags=cv2.INTER_NEAREST) > 0
    hall, _ = warp_background(one.panorama, camera, ViewPlace(pan_rad, tilt_rad, reference))
    faded = (FADED * hall + (1 - FADED) * 235.0).astype(np.uint8)
    return np.where(seen_there[..., None], moved, faded)


def _zoomed(head: PanZoomCamera | None, true: Camera, focal_px: float) -> Camera:
    """The true camera at another focal length."""
    assert head is not None
    principal, distortion = lens_at(head.lens, focal_px)
    return Camera(true.width, true.height, true.world_T_cam, focal_px, principal, *distortion)
