"""From world points to pixels: the lens of `pzcap.geometry.lens`, written out a second time and without it.

So a bug in the estimator's lens shows in its score and does not cancel out, and the score needs numpy alone.
"""

from __future__ import annotations

import numpy as np

from pzcap.scoring.records import CameraPoses
from pzcap.types import Array, Mask

NEAREST_M = 0.1  # points nearer to the projection centre along the optical axis than this are not seen


def wrapped(angle_rad: Array) -> Array:
    """Angles brought into [-pi, pi)."""
    return np.asarray(np.mod(angle_rad + np.pi, 2 * np.pi) - np.pi)


def project(poses: CameraPoses, focal_px: float, frame: int, points_m: Array) -> tuple[Array, Mask]:
    """World points (N, 3) to pixels (N, 2) at one frame, and which of them can be seen at all (N,).

    With barrel distortion the radius grows to a largest value and then folds back: what lies beyond is never seen,
    though the formula puts it into the image. Pixels of what is not seen are meaningless but finite.
    """
    cam = (points_m - poses.position_m[frame]) @ poses.rotation[frame]
    front = cam[:, 2] > NEAREST_M
    x, y = (cam[:, :2] / np.where(front, cam[:, 2], 1.0)[:, None]).T
    k1, k2, p1, p2 = poses.distortion[frame]
    squared = x * x + y * y
    seen = front & (1.0 + (3.0 * k1 + 5.0 * k2 * squared) * squared > 0.0)
    factor = 1.0 + (k1 + k2 * squared) * squared
    bent_x = factor * x + 2.0 * p1 * x * y + p2 * (squared + 2.0 * x * x)
    bent_y = factor * y + p1 * (squared + 2.0 * y * y) + 2.0 * p2 * x * y
    principal = poses.principal_px[frame]
    return np.column_stack([principal[0] + focal_px * bent_x, principal[1] + focal_px * bent_y]), seen


def inside(pixels: Array, image_size: tuple[int, int]) -> Mask:
    """Mask (N,) of the pixels (N, 2) that lie within the image."""
    return np.asarray(np.all((pixels >= 0) & (pixels <= np.array(image_size) - 1), axis=1))


def heading(rotation: Array, pan_axis: Array) -> Array:
    """(F, 3) optical axes of cameras ``rotation`` (F, 3, 3), made normal to ``pan_axis`` (3,)."""
    forward = rotation[:, :, 2]
    return np.asarray(forward - (forward @ pan_axis)[:, None] * pan_axis)


def turned(rotation: Array, true_rotation: Array, pan_axis: Array) -> Array:
    """Angles (F,) in rad, positive to the left, by which cameras are turned about ``pan_axis`` against the true."""
    found, true = heading(rotation, pan_axis), heading(true_rotation, pan_axis)
    return np.arctan2(np.cross(true, found) @ pan_axis, np.sum(true * found, axis=1))


def angle_between(one: Array, other: Array) -> Array:
    """Angles (F,) in rad of the rotations that lie between ``one`` and ``other`` (F, 3, 3)."""
    apart = np.einsum("fij,fik->fjk", one, other)
    sine = np.linalg.norm(
        np.stack([apart[:, 2, 1] - apart[:, 1, 2], apart[:, 0, 2] - apart[:, 2, 0], apart[:, 1, 0] - apart[:, 0, 1]]),
        axis=0,
    )
    return np.asarray(np.arctan2(sine, np.trace(apart, axis1=1, axis2=2) - 1.0))
