"""Height of the athlete in the cameras' units of length, from the contours of some frames.

The body is fitted to the silhouettes of frames from all over the take, its pose in each, its shape (lengths, size and
skin, `pzcap.body.shape_estimation`) common to all, in turns until both stay. Of a body whose size is open the contours
tell it to half a percent: soles and vertex are seen, whatever a detector means by a hip.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pzcap.body.shape_estimation import Shape, ShapeEstimate
from pzcap.body.skeleton import Body, moved
from pzcap.initialisation import pose_fit
from pzcap.initialisation.keyframes import Observe, closed_form, crops_of
from pzcap.initialisation.people import Sighting
from pzcap.initialisation.tuning import HEIGHT, JUDGEMENT
from pzcap.tracking.body_estimate import BodyEstimate
from pzcap.tracking.interval_solver import fit_keyframe
from pzcap.tracking.keypoint_residuals import LandmarkEstimate
from pzcap.tracking.pixel_time import AT_REST
from pzcap.tracking.settings import TrackingConfig
from pzcap.tracking.tracked_body import misplaced
from pzcap.types import PARENTS, SEGMENTS, Keyframe, MovedBody


@dataclass(frozen=True, slots=True, eq=False)
class SeenHeight:
    """Height of the athlete over that of a body."""

    ratio: float
    sigma: float
    frames: tuple[int, ...]  # that it was seen in


def standing_height(body: MovedBody) -> float:
    """From the soles to the top of the head of a body that stands upright, metres."""
    height_m = np.zeros(len(SEGMENTS))
    for s, parent in enumerate(PARENTS):
        if parent >= 0:
            height_m[s] = height_m[parent] + body.offsets_m[s, 2]
    return float(np.ptp(height_m[body.skin_segment] + body.skin_m[:, 2]))


def seen_height(
    body: Body, sightings: Sequence[tuple[int, Sighting]], observe: Observe, config: TrackingConfig
) -> SeenHeight | None:
    """Height by the contours of the best frames among the ``sightings``, each with its number, of a ``body`` whose size
    is open; None where too few bear the keypoints out."""
    keys = _keys(body, sightings)
    seen = [(key, observe(key)) for key in keys]
    base = ShapeEstimate.of(body)
    amounts = base.amounts_m
    used: list[int] = []
    for number in range(HEIGHT.rounds):
        shape = replace(base, amounts_m=amounts)
        now = replace(shape.body(amounts), landmarks=body.landmarks)
        known = Shape(amounts, np.zeros(len(SEGMENTS)))
        estimate = BodyEstimate(now, shape, known, LandmarkEstimate.of(body.landmarks))
        used, following = [], []
        for key, inputs in seen:
            crops = crops_of(now, key, inputs, config)
            if crops is None:
                continue
            fit, _ = fit_keyframe(now, key, crops, AT_REST, config)
            following.append((replace(key, pose=fit.pose), inputs))
            if number < HEIGHT.rounds - 1 or float(misplaced(fit.contour).max()) < JUDGEMENT.misplaced:
                estimate = estimate.with_keyframe(key, fit.pose, crops, AT_REST, config)
                used.append(key.frame)
        seen = following
        if len(used) < HEIGHT.fewest:
            return None
        equations = estimate.shape.equations
        amounts = np.asarray(np.linalg.solve(equations.information, equations.vector))
    usual, found = standing_height(moved(body)), standing_height(moved(base.body(amounts)))
    steps = np.eye(len(amounts)) * HEIGHT.step_m
    slope = (np.array([standing_height(moved(base.body(amounts + step))) for step in steps]) - found) / HEIGHT.step_m
    variance = float(slope @ np.linalg.solve(equations.information, slope))
    return SeenHeight(found / usual, float(np.hypot(np.sqrt(variance) / usual, HEIGHT.sigma)), tuple(used))


def _keys(body: Body, sightings: Sequence[tuple[int, Sighting]]) -> list[Keyframe]:
    """The best-fitting frame of each of some equal parts of the take."""
    best: dict[int, tuple[float, Keyframe]] = {}
    for number in np.unique(np.linspace(0, len(sightings) - 1, HEIGHT.tried).round().astype(int)).tolist():
        frame, seen = sightings[number]
        start = closed_form(seen)
        if start is None:
            continue
        [pose] = pose_fit.fit(body, [seen], [start])
        known = pose_fit.known(body, pose, seen)
        part = number * HEIGHT.frames // len(sightings)
        if known.misfit < JUDGEMENT.largest_misfit and known.misfit < best.get(part, (np.inf, None))[0]:
            best[part] = known.misfit, Keyframe(frame, pose, known.covariance, found=True)
    return [key for _, key in best.values()]
