"""Keyframes from keypoints: poses of all frames first, then those of them that the images bear out.

Where the cameras looked is known by now. The athlete's keypoints are put right over views and frames (`people`) and the
body is fitted to all of them (`pose_fit`). Of the frames that would help most (`selection`) the pictures are taken once
more: the pose is fitted to them as the tracker does, and judged by what is left. A frame that fails is passed over for
the next best.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from pzcap.body.kinematics import difference, forward
from pzcap.body.skeleton import Body
from pzcap.initialisation import pose_fit
from pzcap.initialisation.limb_poses import pose_of_points
from pzcap.initialisation.people import Detections, Sighting, athlete
from pzcap.initialisation.selection import chosen
from pzcap.initialisation.triangulation import rays_of, triangulate
from pzcap.initialisation.tuning import FIT, JUDGEMENT, PEOPLE
from pzcap.tracking.interval_solver import fit_keyframe
from pzcap.tracking.observation import ViewCrop, ViewInput, crop_view
from pzcap.tracking.pixel_time import sequence_rates
from pzcap.tracking.settings import TrackingConfig
from pzcap.tracking.skin_colour_model import SkinColourModel
from pzcap.tracking.tracked_body import misplaced
from pzcap.tracking.tuning import HAND_SIGMA
from pzcap.types import Array, Keyframe, Pose

Observe = Callable[[Keyframe], Sequence[ViewInput | None]]
"""The views of a keyframe's instant, the athlete cut out where the keyframe has the body."""


def find_keyframes(
    detections: Sequence[Detections], body: Body, given: Sequence[Keyframe], rate: float, observe: Observe,
    config: TrackingConfig,
) -> list[Keyframe]:  # fmt: skip
    """Keyframes from the ``detections`` of all frames, ``rate`` a second, beside the ``given`` ones."""
    sightings = athlete(detections)
    first = [closed_form(seen) for seen in sightings]
    if not any(first):
        return []
    usual, poses = body.landmarks, pose_fit.fit(body, sightings, list(_filled(first)))
    for _ in range(FIT.rounds):
        body = replace(body, landmarks=pose_fit.learned_landmarks(usual, body, poses, sightings))
        poses = pose_fit.fit(body, sightings, poses)
    rates = sequence_rates([forward(body, pose) for pose in poses], 1.0)
    candidates, variances = {}, {}
    for frame, (pose, seen) in enumerate(zip(poses, sightings, strict=True)):
        known = pose_fit.known(body, pose, seen)
        if known.views >= JUDGEMENT.least_views and known.misfit < JUDGEMENT.largest_misfit:
            candidates[frame] = Keyframe(frame, pose, known.covariance, found=True)
            variances[frame] = float(np.mean(known.sigma_m**2)) * max(known.misfit / JUDGEMENT.usual_misfit, 1.0) ** 2
    by_hand = {key.frame: float(HAND_SIGMA[0] ** 2) for key in given}
    sure: set[int] = set()
    while True:
        found = chosen(variances, by_hand, len(detections), rate)
        unjudged = next((frame for frame in found if frame not in sure), None)
        if unjudged is None:
            return [candidates[frame] for frame in found]
        key = candidates[unjudged]
        if is_borne_out(body, key, observe(key), rates[unjudged], config):
            sure.add(unjudged)
        else:
            del variances[unjudged]


def is_borne_out(
    body: Body, key: Keyframe, views: Sequence[ViewInput | None], rates: Array, config: TrackingConfig
) -> bool:
    """True where the images agree with a keyframe: fitted to them, it moves no further than it is uncertain by, and its
    contours are those of the silhouettes."""
    assert key.covariance is not None, "a hand's keyframes are not judged here"
    crops = crops_of(body, key, views, config)
    if crops is None:
        return False
    fit, _ = fit_keyframe(body, key, crops, rates, config)
    moved = difference(fit.pose, key.pose)
    off = float(moved @ np.linalg.solve(key.covariance, moved)) / len(moved)
    return off < JUDGEMENT.largest_move and float(misplaced(fit.contour).max()) < JUDGEMENT.misplaced


def crops_of(
    body: Body, key: Keyframe, views: Sequence[ViewInput | None], config: TrackingConfig
) -> list[ViewCrop | None] | None:
    """The ``views`` cut out around a keyframe's pose; None where too few show the body."""
    crops = [
        None if view is None else crop_view(body, view, key.pose, config.cut_out_margin, SkinColourModel())
        for view in views
    ]
    return None if sum(crop is not None for crop in crops) < JUDGEMENT.least_views else crops


def closed_form(seen: Sighting) -> Pose | None:
    """The pose of one frame by itself; None where too little is seen of it."""
    views = [view for view in seen if view is not None]
    if len(views) < 2:
        return None
    met = triangulate(rays_of(views, PEOPLE.least_confidence), PEOPLE.agree_m)
    return pose_of_points(met.points_m, met.found)


def _filled(poses: Sequence[Pose | None]) -> Iterator[Pose]:
    """The poses, one that is missing as the last one before it."""
    last = next(pose for pose in poses if pose is not None)
    for pose in poses:
        last = last if pose is None else pose
        yield last
