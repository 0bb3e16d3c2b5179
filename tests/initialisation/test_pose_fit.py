"""The body fitted to keypoints: near the truth, and as sure as it says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from pzcap.body.kinematics import joints
from pzcap.body.skeleton import DOF_SEGMENT
from pzcap.initialisation import pose_fit
from pzcap.initialisation.limb_poses import pose_of_points
from pzcap.initialisation.people import Sighting, athlete
from pzcap.initialisation.triangulation import rays_of, triangulate
from pzcap.io.detections import KEYPOINTS
from pzcap.types import SEGMENTS, Array, Pose
from tests.scenes import detected
from tests.scenes.detected import Faults, body, detections, poses

FRAMES = 12


def start(sightings: Sequence[Sighting]) -> list[Pose]:
    found = []
    for seen in sightings:
        met = triangulate(rays_of([view for view in seen if view], 0.1), 0.15)
        found.append(pose_of_points(met.points_m, met.found) or pytest.fail("everything is seen"))
    return found


def fitted(faults: Faults, seed: int = 0) -> tuple[list[Sighting], list[Pose]]:
    sightings = athlete(detections(FRAMES, faults, seed))
    return sightings, pose_fit.fit(body(), sightings, start(sightings))


def errors_m(found: Sequence[Pose]) -> Array:
    pairs = zip(found, poses(FRAMES), strict=True)
    return np.array([np.linalg.norm(joints(body(), one) - joints(body(), true), axis=1) for one, true in pairs])


def test_exact_without_errors() -> None:
    exact = Faults(meaning_m=0.0, noise_px=0.0)
    sightings = athlete(detections(FRAMES, exact))
    assert errors_m(start(sightings)).mean() < 0.05  # the spine is shared out
    assert errors_m(pose_fit.fit(body(), sightings, start(sightings))).mean() < 0.006


def test_near_the_truth_and_as_sure_as_it_says() -> None:
    for seed in range(3):
        sightings, found = fitted(Faults(), seed)
        known = [pose_fit.known(body(), pose, seen) for pose, seen in zip(found, sightings, strict=True)]
        off, sigma = errors_m(found), np.array([one.sigma_m for one in known])
        assert off.mean() < 0.025
        assert np.mean(off < 2.0 * sigma) > 0.95
        assert sigma.mean() < 0.05


def test_a_view_turned_over_and_one_seen_from_behind_are_borne() -> None:
    good, bad = fitted(Faults())[1], fitted(Faults(turned=((5, 1),), backward=((6, 0), (7, 0))))[1]
    assert errors_m(bad).mean() < 1.3 * errors_m(good).mean()


def test_more_frames_do_not_make_what_the_detector_means_any_surer() -> None:
    """The offsets are one error of all frames: a pose has it in full, whatever the number of views and their noise."""
    sightings, found = fitted(Faults(noise_px=0.0))
    sure = [(camera, np.column_stack([person[:, :2], np.ones(26)])) for camera, person in filter(None, sightings[0])]
    known = pose_fit.known(body(), found[0], tuple(sure))
    assert known.sigma_m.mean() > 0.02


def test_the_twist_of_an_arm_and_the_hands_are_open() -> None:
    sightings, found = fitted(Faults())
    sigma = np.sqrt(np.diag(pose_fit.known(body(), found[0], sightings[0]).covariance))

    def of(name: str) -> Array:
        return sigma[SEGMENTS.index(name) == DOF_SEGMENT]

    assert of("left_hand").min() > np.deg2rad(20.0)
    assert of("left_upper_arm")[2] > 1.3 * of("left_upper_arm")[:2].max()  # bent by 50 degrees; a straight one's more


def test_joints_seen_by_one_view_alone_are_known_less() -> None:
    sightings, found = fitted(Faults())
    hidden = [KEYPOINTS.index(name) for name in ("left_elbow", "left_wrist")]
    blind = []
    for number, (camera, person) in enumerate(filter(None, sightings[0])):
        seen = person.copy()
        seen[hidden, 2] *= number == 0
        blind.append((camera, seen))
    full, less = (pose_fit.known(body(), found[0], seen).sigma_m for seen in (sightings[0], tuple(blind)))
    elbow = SEGMENTS.index("left_forearm")
    assert less[elbow] > 1.5 * full[elbow]
    assert less[SEGMENTS.index("right_forearm")] == pytest.approx(full[SEGMENTS.index("right_forearm")], rel=0.05)


def test_frames_without_anybody_are_carried_over() -> None:
    sightings = athlete(detections(FRAMES, Faults()))
    first = start(sightings)
    first[5] = first[4]
    sightings[5] = (None,) * 4
    found = pose_fit.fit(body(), sightings, first)
    assert errors_m(found)[5].mean() < 0.05
    known = pose_fit.known(body(), found[5], sightings[5])
    assert known.views == 0
    assert known.sigma_m.min() > 0.2


def test_a_body_without_offsets_is_surer() -> None:
    sightings, found = fitted(Faults())
    marks = replace(body().landmarks, sigma_m=np.full(len(KEYPOINTS), 1e-4))
    exact = pose_fit.known(replace(body(), landmarks=marks), found[0], sightings[0])
    assert exact.sigma_m.mean() < 0.6 * pose_fit.known(body(), found[0], sightings[0]).sigma_m.mean()


def test_a_long_take_is_fitted_in_stretches_that_meet(monkeypatch: pytest.MonkeyPatch) -> None:
    sightings, whole = fitted(Faults())
    monkeypatch.setattr(pose_fit, "FIT", pose_fit.FIT._replace(stretch=5, beyond=3))
    parts = pose_fit.fit(body(), sightings, start(sightings))
    assert len(parts) == FRAMES
    assert np.abs(errors_m(parts) - errors_m(whole)).max() < 0.03
    assert errors_m(parts).mean() < 1.2 * errors_m(whole).mean()


def test_what_the_detector_means_is_learned_as_far_as_bones_show_it() -> None:
    sightings, found = fitted(Faults())
    usual = body().landmarks
    learned = pose_fit.learned_landmarks(usual, body(), found, sightings)
    meant = detected.meant(Faults(), 0)
    assert np.all(learned.sigma_m <= usual.sigma_m)
    assert learned.sigma_m.mean() < 0.95 * usual.sigma_m.mean()
    before, after = (np.linalg.norm(marks.points_m - meant, axis=1) for marks in (usual, learned))
    assert after.mean() < 0.97 * before.mean()
    again = pose_fit.fit(replace(body(), landmarks=learned), sightings, found)
    assert errors_m(again).mean() < 0.97 * errors_m(found).mean()


def test_a_trunk_that_all_keypoints_have_elsewhere_cannot_be_told() -> None:
    """An offset that a change of all poses explains as well: hips and shoulders a centimetre higher."""
    sightings, found = fitted(Faults(meaning_m=0.0, noise_px=0.3))
    learned = pose_fit.learned_landmarks(body().landmarks, body(), found, sightings)
    hip = KEYPOINTS.index("left_hip")
    assert learned.sigma_m[hip] > 0.5 * body().landmarks.sigma_m[hip]
