"""Two estimates of one instant, from the keyframe before it and from the one after it, made one: drift removed.

Where the two agree they are averaged limb by limb, weighted by confidence, which falls with the distance from the
keyframe (Yamamoto 2005). Where they do not, one of them has lost the limb, and the silhouettes decide which.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from pzcap.body import DOF, DOF_SEGMENT, Body, difference, forward, retract
from pzcap.following import Step
from pzcap.limbs import LIMBS
from pzcap.types import Array, Pose

AGREE_M: Final = 0.05
_AROUND: Final = 2  # frames on either side that have a say in which pass kept a limb
_SUPPORT_M2: Final = 0.004  # a pass whose limb explains so much more is believed against the other's confidence


def merge(body: Body, ahead: Sequence[Step], back: Sequence[Step]) -> list[Pose]:
    """The poses of an interval from the steps of its forward and backward pass, both in the order of the frames."""
    if not ahead:
        return []
    share = np.array([a.variance / (a.variance + b.variance) for a, b in zip(ahead, back, strict=True)])  # of ``back``
    apart = np.array([_apart(body, a.pose, b.pose) for a, b in zip(ahead, back, strict=True)])
    gain = np.array([np.subtract(*(b.support - a.support).T) for a, b in zip(ahead, back, strict=True)])
    for limb, members in enumerate(LIMBS):
        disagree = apart[:, list(members)].max(axis=1) > AGREE_M
        for frame in np.flatnonzero(disagree):
            around = slice(max(frame - _AROUND, 0), frame + _AROUND + 1)
            say = float(np.sum(gain[around, limb] * disagree[around]) / np.sum(disagree[around]))
            trust = float(np.mean(share[frame, list(members)])) - 0.5
            share[frame, list(members)] = 1.0 if say / _SUPPORT_M2 + trust > 0.0 else 0.0
    return [_mix(a.pose, b.pose, s) for a, b, s in zip(ahead, back, share, strict=True)]


def _apart(body: Body, one: Pose, other: Pose) -> Array:
    """Distance (16,) between the joints, metres."""
    return np.asarray(np.linalg.norm(forward(body, one)[:, :3, 3] - forward(body, other)[:, :3, 3], axis=1))


def _mix(ahead: Pose, back: Pose, share: Array) -> Pose:
    """Each segment's rotation (and the root's position) turned by its ``share`` (16,) from ``ahead`` to ``back``."""
    delta = difference(back, ahead)
    assert len(delta) == DOF
    return retract(ahead, share[DOF_SEGMENT] * delta)
