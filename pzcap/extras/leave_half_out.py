"""The pans of a sweep, found by aligning each half of its frames with what the other half shows.

Pans from pairs of frames are off by what is finer than pixels, in each by something else. A super-resolved panorama
foresees that, but where a frame is beside its place, what is made of it is so as well, and agrees. So every second
frame is aligned with cells that are made of the others alone (as in cross-validation; Stone, 1974).

These others are not in their places either. With e_k what frame k is beside its own, the cells at an azimuth are beside
theirs by s, the mean of e over the frames that show them; and so frame k is found where s puts it, by d_k of pan and
f_k of log focal:

    (d_k, f_k) = N_k^-1 sum (g, h) g s - (e_k, 0) + (0, phi),    N_k = sum (g, h) (g, h)^T

summed over its pixels, whose grey changes by g with pan and by h with log focal; phi is what the sweep's log focal is
off by. Least squares with weights N_k tell all e. Errors that change slowly, once or twice in a turn, put hardly any
frame beside its neighbours; but they stretch the hall, and that all frames feel in their focal length, which is the
same for all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from pzcap.calibration import stitching
from pzcap.calibration.stitching import SweptFrames
from pzcap.extras.superresolution import Levels, super_resolve
from pzcap.extras.superresolved_alignment import SUPERRESOLVED, SuperresolvedAligner
from pzcap.geometry.cylinder import to_unwrapped
from pzcap.imaging.bspline import smoothed
from pzcap.imaging.colour import grey
from pzcap.localisation.panorama_sampler import ViewPlace, axis_directions
from pzcap.localisation.tuning import ALIGNMENT
from pzcap.progress import Report
from pzcap.types import Array, Image, Panorama, PanZoomCamera

ROWS = 4  # of a frame one row in so many is looked at for what its pixels tell
UNTOLD = 1e-3  # share in the weight of a frame that was not found: it goes where its neighbours go


def pans(panorama: Panorama, camera: PanZoomCamera, images: Sequence[Image], level: Levels, report: Report) -> Array:
    """(K,) pans of the frames that a panorama was stitched of, better than its ``sweep_pan_rad``.

    ``images`` (K of them, grey) are the frames, ``level(k)`` are they as bright as the panorama (see `super_resolve`).
    ``report(stage, done, total)`` hears of the progress.
    """
    count, focal_px = len(images), camera.lens.reference_focal_px
    half = np.arange(count) % 2
    found, trust = np.zeros((count, 2)), np.full(count, UNTOLD)
    for which in (0, 1):
        aligner = _aligner(panorama, camera, level, np.flatnonzero(half != which), images[0].size, report)
        for k in np.flatnonzero(half == which).tolist():
            pan_rad = float(panorama.sweep_pan_rad[k])
            one = aligner.align(images[k], ViewPlace(pan_rad, camera.tilt_rad, focal_px), 1.5)
            if one.report.converged and one.agreement > ALIGNMENT.sure_agreement:
                found[k], trust[k] = (one.at.pan_rad - pan_rad, np.log(one.at.focal_px / focal_px)), 1.0
            report("align sweep", k // 2 + 1, (count + 1 - which) // 2)
    beside = _beside(_told(panorama, camera), half, found, trust, panorama.full_turn)
    return np.asarray(panorama.sweep_pan_rad - beside)


def _aligner(
    panorama: Panorama, camera: PanZoomCamera, level: Levels, frames: NDArray[np.int64], pixels: int, report: Report
) -> SuperresolvedAligner:
    """Aligns with cells that are made of some ``frames`` of the sweep."""
    some = replace(panorama, sweep_pan_rad=panorama.sweep_pan_rad[frames])
    cells = super_resolve(
        some, camera, lambda k: level(int(frames[k])), lambda done, total: report("super-resolve half", done, total)
    )
    return SuperresolvedAligner(replace(some, fine=cells), camera, pixels=pixels)


@dataclass(frozen=True, slots=True, eq=False)
class _Told:
    """Information of a frame's pixels on where it is: sums over them of how they change with pan and log focal."""

    normal: Array  # (2, 2) of both times both
    by_column: Array  # (2, W) of both times by pan, in each of the panorama's columns
    shown: NDArray[np.bool_]  # (W,) columns that the frame shows


def _told(panorama: Panorama, camera: PanZoomCamera) -> list[_Told]:
    """Of each frame of the sweep."""
    image = smoothed(grey(panorama.image), SUPERRESOLVED.smoothing_px2)
    known = cv2.erode(panorama.valid.astype(np.uint8), np.ones((9, 9), np.uint8), borderType=cv2.BORDER_REPLICATE)
    down, across = np.gradient(image) * known
    height, width = image.shape
    lens = camera.lens
    edge = ALIGNMENT.border_px
    u, v = np.meshgrid(np.arange(edge, lens.width - edge), np.arange(edge, lens.height - edge, ROWS))
    points = np.stack([u.ravel(), v.ravel()], axis=1).astype(np.float64)
    told = []
    for pan_rad in panorama.sweep_pan_rad.tolist():
        looks = axis_directions(panorama, camera, points, ViewPlace(pan_rad, camera.tilt_rad, lens.reference_focal_px))
        places = np.rint(to_unwrapped(panorama, pan_rad + looks[:, 0], looks[:, 1])).astype(np.int64)
        column = np.mod(places[:, 0], width) if panorama.full_turn else np.clip(places[:, 0], 0, width - 1)
        row = np.clip(places[:, 1], 0, height - 1)
        by_azimuth, by_slope = across[row, column], down[row, column]
        changes = np.stack([by_azimuth, by_azimuth * looks[:, 2] + by_slope * looks[:, 3]])
        by_column = np.array([np.bincount(column, change * changes[0], width) for change in changes])
        normal = changes @ changes.T + np.eye(2)  # a bare wall tells nothing, and that can be solved too
        told.append(_Told(normal, by_column, np.bincount(column, minlength=width) > 0))
    return told


def _beside(told: Sequence[_Told], half: NDArray[np.int64], found: Array, trust: Array, full_turn: bool) -> Array:
    """(K,) what frames are beside their places, from where they were ``found`` (K, 2) on the cells of the others; their
    mean is 0."""
    shown = np.array([one.shown for one in told], np.float64)
    rows, values = [], []
    for k, one in enumerate(told):
        others = np.flatnonzero(half != half[k])
        count = shown[others].sum(axis=0)
        row = np.zeros((2, len(told) + 1))
        row[:, others] = (one.by_column / np.maximum(count, 1.0)) @ shown[others].T
        row[:, k] = one.by_column @ (count == 0)  # there cells are what the panorama is, and that is of this frame
        root = np.linalg.cholesky(one.normal).T
        row = np.linalg.solve(root.T, row)
        row[:, k] -= root[:, 0]
        if full_turn:  # the circle that closes tells the focal length as well; an arc would stretch with it
            row[:, -1] = root[:, 1]
        rows.append(trust[k] * row)
        values.append(trust[k] * root @ found[k])
    return np.asarray(np.linalg.lstsq(np.vstack(rows), np.concatenate(values), rcond=1e-9)[0][:-1], np.float64)


def super_resolved(panorama: Panorama, camera: PanZoomCamera, swept: SweptFrames, report: Report) -> Panorama:
    """The panorama super-resolved from the sweep's grey frames, whose pans are found again for that."""
    images, brightness, view = swept.images, swept.brightness, swept.view
    height, width = images[0].shape
    flat = stitching.flatness(brightness, view, width, height)
    gains = np.exp(-brightness.log_gain).astype(np.float32)

    def level(k: int) -> NDArray[np.float32]:
        return np.asarray(images[k] * (flat * gains[k]), np.float32)

    moved = replace(panorama, sweep_pan_rad=pans(panorama, camera, images, level, report))
    fine = super_resolve(moved, camera, level, lambda done, total: report("super-resolve", done, total))
    return replace(moved, fine=fine)
