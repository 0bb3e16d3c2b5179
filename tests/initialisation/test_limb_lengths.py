"""The length of a metre by the athlete's limbs."""

from __future__ import annotations

import numpy as np
import pytest

from pzcap.body import skeleton
from pzcap.body.kinematics import forward
from pzcap.initialisation.limb_lengths import scale_by_limbs
from pzcap.tracking.keypoint_residuals import in_world
from pzcap.types import SEGMENTS, Array, Pose, PzcapError, Subject

_STATURE = Subject({"stature": 1.70}, 0.005)


def _keypoints(body: skeleton.Body) -> Array:
    """(40, 26, 3) of somebody who stands about."""
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (len(SEGMENTS), 1))
    poses = [Pose(np.array([0.1 * k, 0.0, 0.9]), upright) for k in range(40)]
    return np.array([in_world(body.landmarks, forward(body, pose)) for pose in poses])


def test_limbs_of_known_length_tell_how_long_a_metre_is() -> None:
    body = skeleton.build(_STATURE)
    points = _keypoints(body) / 3.0
    scale, sigma = scale_by_limbs(points, np.ones(points.shape[:2], bool), body)
    assert scale == pytest.approx(3.0, rel=1e-3)
    assert 0.01 < sigma < 0.06  # of a stature alone, and of a detector that may mean another hip


def test_limbs_that_nobody_sees_tell_nothing() -> None:
    with pytest.raises(PzcapError, match="no limb"):
        scale_by_limbs(np.zeros((40, 26, 3)), np.zeros((40, 26), bool), skeleton.build(_STATURE))
