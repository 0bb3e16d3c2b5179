"""The tracker with a detector's keypoints: no worse where the images say enough, not lost where they do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pzcap.body import kinematics, landmarks
from pzcap.body import skeleton as bodies
from pzcap.geometry.camera import project
from pzcap.io.detections import KEYPOINTS
from pzcap.tracking import keypoint_residuals
from pzcap.tracking.tracker import TrackInput, ViewInput
from pzcap.types import JOINTS, SEGMENTS, Array, Keyframe, Silhouette
from tests.scenes.tracked import FRAMES, by_hand, clip, errors_m, inputs, lost, run, true_body

pytestmark = pytest.mark.xdist_group("tracked")  # the clip is rendered once
LEFT = [k for k, name in enumerate(KEYPOINTS) if name.startswith("left_") and k > 4]
RIGHT = [KEYPOINTS.index(KEYPOINTS[k].replace("left_", "right_")) for k in LEFT]


def detected(frame: int, camera: int, seed: int = 0) -> Array:
    """One person (1, 26, 3), as a detector errs: by 15 mm on the body in all views, by 2.5 pixels in each."""
    rng, always = np.random.default_rng([frame, camera, seed]), np.random.default_rng(seed)
    body, shot = true_body(), clip().shots[frame][camera]
    meant = body.landmarks.points_m + always.normal(0.0, 0.015, (len(KEYPOINTS), 3))
    marks = landmarks.Landmarks(meant, body.landmarks.sigma_m)
    pixels, _ = project(shot.camera, keypoint_residuals.in_world(marks, kinematics.forward(body, clip().poses[frame])))
    pixels += rng.normal(0.0, 2.5, pixels.shape)
    return np.column_stack([pixels, rng.uniform(0.5, 1.0, len(pixels))])[None]


def with_keypoints(items: tuple[TrackInput, ...], seed: int = 0, swapped: int | None = None) -> tuple[TrackInput, ...]:
    """The same views, looked at by a detector, which takes left for right in one of them."""
    rows = []
    for item in items:
        views = []
        for camera, view in enumerate(item.views):
            assert view is not None
            people = detected(item.frame, camera, seed)
            if camera == swapped:
                people[:, LEFT + RIGHT] = people[:, RIGHT + LEFT]
            views.append(replace(view, people=people))
        rows.append(TrackInput(item.frame, tuple(views)))
    return tuple(rows)


def blank(items: tuple[TrackInput, ...]) -> tuple[TrackInput, ...]:
    """Views that show nothing: neither silhouette nor texture."""

    def grey(view: ViewInput) -> ViewInput:
        image = np.full_like(view.image, 128)
        nothing = Silhouette(
            np.zeros(image.shape[:2], np.uint8), image, np.zeros_like(image[::2, ::2, 0], np.float32), True
        )
        return replace(view, image=image, silhouette=nothing)

    return tuple(TrackInput(item.frame, tuple(v and grey(v) for v in item.views)) for item in items)


def test_no_worse_with_keypoints_even_if_one_view_swaps_the_sides() -> None:
    """Over three detectors and hands: by luck either may be ahead by 4 %."""
    errors: list[list[Array]] = []
    for seed in range(3):
        keys = [by_hand(0, seed), by_hand(FRAMES - 1, seed)]
        footage = inputs(), with_keypoints(inputs(), seed), with_keypoints(inputs(), seed, swapped=1)
        errors.append([errors_m(run(keys, items)) for items in footage])
    without, with_, swapped = np.array(errors).swapaxes(0, 1)
    assert with_.mean() < 1.02 * without.mean()
    assert swapped.mean() < 1.10 * without.mean()
    assert with_.max() < 1.1 * without.max()


def test_somebody_else_changes_nothing() -> None:
    keys = [by_hand(0)]
    people = detected(0, 0) + np.array([400.0, 0.0, 0.0])
    items = [TrackInput(i.frame, tuple(v and replace(v, people=people) for v in i.views)) for i in inputs()[:5]]
    for a, b in zip(run(keys, inputs()[:5]), run(keys, items), strict=True):
        np.testing.assert_array_equal(a.joints_m, b.joints_m)
        np.testing.assert_array_equal(a.sigma_m, b.sigma_m)


def test_keypoints_carry_the_body_where_the_images_show_nothing() -> None:
    keys = [by_hand(0)]
    alone = errors_m(run(keys, with_keypoints(blank(inputs()))))
    nothing = errors_m(run(keys, blank(inputs())))
    assert alone.mean() < 0.04
    assert nothing.mean() > 4 * alone.mean()


def test_a_limb_that_was_lost_is_found_again() -> None:
    """From a keyframe that has the right arm elsewhere."""
    pose = by_hand(0).pose
    for segment, by in (("right_upper_arm", 1.8), ("right_forearm", 0.8)):
        pose = lost(pose, int(np.argmax(SEGMENTS.index(segment) == bodies.DOF_SEGMENT)), by)
    wrist = JOINTS.index("right_wrist")
    for items, found_m in ((inputs(), 0.03), (blank(inputs()), 0.10)):
        without, found = (errors_m(run([Keyframe(0, pose)], i))[:, wrist] for i in (items, with_keypoints(items)))
        assert without.min() > 0.3
        assert found[3:].max() < found_m
