"""The focal length of a pan sweep by itself, where no calibration object has told it.

A camera that only turns sees two frames alike but for a pan, and under the right focal length all their matches name
the same pan: under a wrong one those at the edges name another than those in the middle. Some pairs of frames vote for
a focal length; a bundle adjustment of a part of the sweep then finds it to a percent, which is what the circle needs
to close. The closed circle fixes it for good.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import islice

import numpy as np

from pzcap.calibration import features
from pzcap.calibration.bundle_adjustment import adjust
from pzcap.calibration.correspondences import first_values, sigmas_of
from pzcap.calibration.features import Features
from pzcap.calibration.settings import PanZoomConfig
from pzcap.calibration.sweep import Frames, chain, detect, link_further
from pzcap.calibration.tuning import FOCAL
from pzcap.geometry import camera as geometry
from pzcap.geometry.camera import View
from pzcap.geometry.lens import NONE
from pzcap.types import Array, Camera, PzcapError


def camera_of_sweep(sweep: Frames, config: PanZoomConfig) -> Camera:
    """The camera of a sweep, level at pan 0 in a world of its own, as high over the floor as tripods usually are.

    Raises PzcapError where the sweep does not tell its focal length, or has a gap.
    """
    found: list[Features] = []
    size = (0, 0)
    for _, image in islice(sweep, FOCAL.frames):
        size = image.shape[1], image.shape[0]
        found.append(detect(image, config.sweep))
    width, height = size
    pairs = _pairs(found, width, config)
    if len(pairs) < FOCAL.fewest_pairs:
        raise PzcapError(
            "sweep: too little is seen in two frames to find the focal length; pan more slowly, past texture, "
            "or film a calibration object"
        )
    view = View(0.0, 0.0, 0.0, 1.0, np.array([(width - 1) / 2, (height - 1) / 2]), NONE)
    focals_px = width * np.exp(np.arange(np.log(FOCAL.shortest), np.log(FOCAL.longest), FOCAL.step))
    votes = [sum(_agreeing(view, focal, *pair) for pair in pairs) for focal in focals_px]
    view = replace(view, focal_px=float(focals_px[int(np.argmax(votes))]))
    start = _camera(view, width, height)
    chained = chain(islice(sweep, FOCAL.frames), view, False, config.sweep, lambda _: None)
    usual = sigmas_of(start, config.beliefs, full_turn=True, zoom=False)
    sigmas = replace(usual, reference_focal=FOCAL.sigma)
    coarse = adjust(first_values(view, chained.pan_rad), chained.links, sigmas, iterations=10).parameters
    further = link_further(chained.features, [coarse.view(i) for i in range(len(chained.pan_rad))], width, config.sweep)
    fine = adjust(coarse, [*chained.links, *further], sigmas, prior=first_values(view, chained.pan_rad)).parameters
    return _camera(replace(view, focal_px=float(np.exp(fine.log_focal[0]))), width, height)


def _camera(view: View, width: int, height: int) -> Camera:
    return Camera(width, height, levelled(0.0, 0.0), view.focal_px, view.principal_px, 0.0)


def levelled(tilt_rad: float, roll_rad: float) -> Array:
    """(4, 4) World from camera at pan 0 where the head is level, as high as tripods usually are."""
    pose = geometry.head_T_cam(0.0, tilt_rad, roll_rad)
    pose[2, 3] = FOCAL.usual_height_m
    return pose


def _pairs(found: Sequence[Features], width: int, config: PanZoomConfig) -> list[tuple[Array, Array]]:
    """Matched pixels (N, 2), (N, 2) of frames that are some share of the picture apart."""
    pairs: list[tuple[Array, Array]] = []
    for first in range(0, len(found), max(len(found) // FOCAL.pairs, 1)):
        best: tuple[Array, Array] | None = None
        for second in range(first + 1, len(found)):
            matched = features.match(found[first], found[second], config.sweep.ratio)
            if len(matched) < 2 * config.sweep.min_matches:
                break
            ends = found[first].points_px[matched[:, 0]], found[second].points_px[matched[:, 1]]
            best = ends
            if abs(float(np.median(ends[0][:, 0] - ends[1][:, 0]))) > FOCAL.apart * width:
                break
        pairs += [] if best is None else [best]
    return pairs


def _agreeing(view: View, focal_px: float, first_px: Array, second_px: Array) -> int:
    """Matches that name the same pan under a focal length."""
    seen = replace(view, focal_px=focal_px)
    (azimuth_a, slope_a), (azimuth_b, slope_b) = (geometry.pixel_to_direction(seen, px) for px in (first_px, second_px))
    level = np.abs(slope_a - slope_b) < FOCAL.slope_tolerance
    if not level.any():
        return 0
    return int(features.densest((azimuth_a - azimuth_b)[level], FOCAL.tolerance_px / focal_px).sum())
