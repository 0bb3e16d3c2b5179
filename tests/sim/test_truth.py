"""Cameras and lenses as the truth hands them out."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from pzcap.geometry.lens import at as lens_at
from sim.truth import Truth, load


@pytest.fixture(scope="module")
def truth(small_capture: Path) -> Truth:
    return load(small_capture / "truth")


def test_a_lens_gives_the_intrinsics_of_every_frame(truth: Truth) -> None:
    for c in range(len(truth.camera_names)):
        lens = truth.lens(c)
        cameras = [truth.camera(c, f) for f in range(len(truth.timecodes))] + [truth.reference_camera(c)]
        for camera in cameras:
            principal_px, (k1, *_) = lens_at(lens, camera.focal_px)
            np.testing.assert_allclose(principal_px, camera.principal_px, atol=1e-9)
            assert k1 == pytest.approx(camera.k1, abs=1e-12)


def test_a_lens_has_the_distortion_that_was_configured(truth: Truth) -> None:
    optics = json.loads(truth.config)["optics"]
    lens = truth.lens(0)
    wide, long = (lens_at(lens, optics[end] * lens.reference_focal_px)[1].k1 for end in ("zoom_min", "zoom_max"))
    assert (wide, long) == pytest.approx((optics["k1_wide"], optics["k1_long"]), abs=1e-9)


def test_cameras_and_poses_are_those_of_the_frame(truth: Truth) -> None:
    camera, pose = truth.camera(2, 5), truth.pose(5)
    assert (camera.width, camera.height) == (truth.width, truth.height)
    np.testing.assert_array_equal(camera.world_T_cam, truth.world_T_cam[2, 5])
    assert (camera.focal_px, camera.k1) == (truth.focal_px[2, 5], truth.k1[2, 5])
    np.testing.assert_array_equal(truth.reference_camera(1).world_T_cam, truth.reference_world_T_cam[1])
    np.testing.assert_array_equal(pose.root_position_m, truth.joints_m[5, 0])
