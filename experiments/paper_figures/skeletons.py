"""Figure 10: the captured motion over the panorama, in the frames, and from a view that no camera had."""

from __future__ import annotations

from itertools import islice
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from experiments.paper_figures.canvas import (
    INK,
    MUTED,
    WIDTH,
    Drawn,
    beneath,
    bones,
    both_bodies,
    close_together,
    connect,
    letter,
    plain,
    show,
    skeleton,
)
from experiments.paper_figures.material import Located, Run, shoot_config
from experiments.paper_figures.novel_view import render, virtual_camera
from experiments.report.pictures import on_panorama, window
from experiments.report.style import literal
from pzcap.body import skeleton as body_model
from pzcap.types import Array, Camera, Image, PzcapError
from pzcap.viewer.drawing import KEYFRAME_COLOUR
from sim.restage import Hall

COLUMNS: Final = 6
NOVEL_PX: Final = (420, 460)  # width and height


def skeletons(run: Run) -> Drawn:
    """The camera is the one that turned most; the frames are evenly spread."""
    one = max(run.located(), key=lambda one: float(np.ptp(one.track.pan_rad[one.track.valid])))
    motion = run.reconstruction.motion
    body, true = run.body(), run.true_body()
    if motion is None or run.subject is None:
        raise PzcapError(f"{run.reconstruction.capture_name}: nobody was measured and tracked; Fig. 10 needs a motion")
    frames = _spread(run, one)
    motion_frames = [f for f in _between(sorted(frames), 3) if motion.valid[f] and one.at[f] is not None]
    pelvis = motion.joints_m[motion.valid, 0].mean(axis=0)
    view = virtual_camera(run, np.array([*pelvis[:2], 1.0]), *NOVEL_PX)
    person = body_model.build(run.subject)
    true_portraits = _portraits(run, frames, view)

    rows = 3 if true_portraits is None else 4
    tall = [1.55, 1.22, 1.78, 1.78][:rows]
    figure = Figure(figsize=(WIDTH, 0.4 + sum(tall)))
    close_together(figure)
    grid = figure.add_gridspec(rows, len(frames), height_ratios=tall)
    wide = figure.add_subplot(grid[0, :])
    middle = float(np.mean(one.track.pan_rad[one.track.valid]))
    corner = _panorama(wide, one, body, true, motion_frames, set(motion.keyframes.tolist()), middle)
    for column, frame in enumerate(frames):
        plot = figure.add_subplot(grid[1, column])
        _frame(plot, run, one, frame)
        foot = on_panorama(one.panorama, one.camera, body[frame], middle) - corner
        above = np.array([one.camera.lens.width / 2, -0.5])
        feet = np.array([foot[:, 0].mean(), foot[:, 1].max() + 4])
        arrow = {"arrowstyle": "-|>", "lw": 1.1, "mutation_scale": 9, "shrinkB": 1}
        connect(figure, (plot, above), (wide, feet), plain(KEYFRAME_COLOUR), **arrow)
        below = figure.add_subplot(grid[2, column])
        moved = _following(view, motion.joints_m[frame, 0])
        show(below, render(run, person, frame, moved))
        if true_portraits is not None:
            last = figure.add_subplot(grid[3, column])
            show(last, true_portraits[column])
            _aside(last, column, "truth")
        _aside(below, column, "reconstructed")
    wide.set_title(
        f"Camera {literal(one.name)}: motion over its panorama, {len(motion_frames)} of {len(body)} frames", pad=4
    )
    caption = (
        f"Motion of the athlete. Top: stick figures over the panorama of camera {one.name}, which turned the most; red "
        "those that a person posed (keyframes), else cyan the left side, orange the right. Below: frames of the same "
        "camera, in the order of the panorama; arrows lead to where on it the athlete is. Then the athlete from a view "
        f"that no camera had, between cameras {' and '.join(o.name for o in run.located()[:2])} and above them: the "
        "tracked body wears what the cameras saw in that frame, the floor what the panoramas show."
    )
    if true is not None:
        error = 1000 * np.linalg.norm(body[:, :16] - true[:, :16], axis=2)[motion.valid].mean()
        caption += (
            " Pale beneath the figures: the truth"
            + (", and in the last row what really was to be seen from there" if true_portraits is not None else "")
            + f"; joints are off by {error:.0f} mm on average, keyframes included."
        )
    return Drawn(10, "skeletons", "Captured motion", caption, figure)


def _spread(run: Run, one: Located) -> list[int]:
    """COLUMNS frames that were recorded, located and tracked, as they stand on the panorama from left to right."""
    motion = run.reconstruction.motion
    assert motion is not None
    good = [int(f) for f in np.flatnonzero(one.track.valid & motion.valid)]
    wanted = np.linspace(0.03, 0.97, COLUMNS) * (len(motion.valid) - 1)
    chosen: set[int] = set()
    for at in wanted:
        near = sorted(set(good) - chosen, key=lambda f: abs(f - at))
        chosen.update(islice((f for f in near if run.views(f)[one.number] is not None), 1))
    return sorted(chosen, key=lambda f: -float(one.track.pan_rad[f]))


def _between(frames: list[int], pieces: int) -> NDArray[np.int64]:
    """``frames`` and ``pieces`` - 1 more from each to the next."""
    at = np.interp(np.arange(pieces * (len(frames) - 1) + 1) / pieces, np.arange(len(frames)), frames)
    return np.unique(at.round().astype(np.int64))


def _panorama(
    plot: Axes, one: Located, body: Array, true: Array | None, frames: list[int], keyframes: set[int], middle: float
) -> Array:
    """The stretch that the athlete crosses; returns its top left corner on the panorama (2,)."""
    camera, panorama = one.camera, one.panorama
    drawn = sorted({*frames, *(f for f in keyframes if one.at[f] is not None)})
    placed = {f: on_panorama(panorama, camera, body[f], middle) for f in drawn}
    every = np.concatenate(list(placed.values()))
    low, high = every.min(axis=0), every.max(axis=0)
    tall = 1.5 * (high[1] - low[1])
    # as wide as the figure is, whatever was crossed
    across = max(1.15 * (high[0] - low[0]), tall * WIDTH / 1.6)
    centre = (low + high) / 2
    azimuths = (panorama.origin_px[0] - centre[0] + np.array([-0.5, 0.5]) * across) / panorama.px_per_rad
    tall = max(tall, across * 1.55 / WIDTH)
    rows = (centre[1] - 0.5 * tall, centre[1] + 0.5 * tall)
    image, corner = window(panorama, float(azimuths[0]), float(azimuths[1]), rows)
    show(plot, image)
    for frame, pixels in placed.items():
        if true is not None:
            beneath(plot, bones(on_panorama(panorama, camera, true[frame], middle) - corner), 2.0)
        skeleton(plot, pixels - corner, keyframe=frame in keyframes, width=0.9)
    return corner


def _frame(plot: Axes, run: Run, one: Located, frame: int) -> None:
    image, at = run.views(frame)[one.number], one.at[frame]
    assert image is not None
    assert at is not None
    show(plot, image)
    both_bodies(plot, run, at, run.true_camera(one.name, frame), frame)
    letter(plot, f"frame {frame}, zoom {at.focal_px / one.camera.lens.reference_focal_px:.1f}")


def _following(view: Camera, pelvis_m: Array) -> Camera:
    """``view`` carried along so that the athlete stays in the middle."""
    pose = view.world_T_cam.copy()
    ahead = pose[:3, 2]
    reach = (1.0 - pose[2, 3]) / ahead[2]
    aim = pose[:3, 3] + reach * ahead
    pose[:2, 3] += pelvis_m[:2] - aim[:2]
    return Camera(view.width, view.height, pose, view.focal_px, view.principal_px, view.k1)


def _portraits(run: Run, frames: list[int], view: Camera) -> list[Image] | None:
    """The true pictures from that view."""
    motion = run.reconstruction.motion
    if run.truth is None or motion is None:
        return None
    with Hall(shoot_config(run.truth)) as hall:
        return [
            hall.portray(_following(view, motion.joints_m[frame, 0]), pose)
            for frame in frames
            if (pose := run.true_pose(frame)) is not None
        ]


def _aside(plot: Axes, column: int, text: str) -> None:
    if column == 0:
        plot.set_ylabel(text, color=INK if text == "reconstructed" else MUTED, fontsize=8.5, labelpad=3)
