"""Unfolding a frame onto the paper's cylinder, which stands about the camera's own y axis (eq. 6)."""

from __future__ import annotations

import cv2
import numpy as np

from pzcap.types import Array, Image, Mask


def to_cylinder(image: Image, focal_px: float) -> tuple[Image, Mask, Array]:
    """Unfold ``image`` (H, W[, 3]) onto the cylinder about the camera's own y axis (eq. 6).

    The principal point is the image's centre, and the cylinder has ``focal_px`` pixels to the radian, so that scales
    agree in the centre. Returns the unfolded image, where it is covered, and its origin ``(r_0, s_0)`` in it: the
    image of the principal point.
    """
    height, width = image.shape[:2]
    right_edge = points_to_cylinder(np.array([[width - 0.5, 0.0]]), focal_px, width, height)[0, 0]
    origin = np.array([np.floor(right_edge), (height - 1) / 2])
    out_width = int(2 * origin[0]) + 1
    angle = (np.arange(out_width) - origin[0]) / focal_px
    slope = (np.arange(height) - origin[1]) / focal_px
    column = np.broadcast_to((width - 1) / 2 + focal_px * np.tan(angle), (height, out_width)).astype(np.float32)
    row = ((height - 1) / 2 + focal_px * slope[:, None] / np.cos(angle)).astype(np.float32)
    unfolded = cv2.remap(image, column, row, cv2.INTER_LINEAR)
    covered = (column >= 0) & (column <= width - 1) & (row >= 0) & (row <= height - 1)
    return np.asarray(unfolded, np.uint8), covered, origin


def points_to_cylinder(points_px: Array, focal_px: float, width: int, height: int) -> Array:
    """Eq. 6 with ``r_0 = s_0 = 0`` for points (N, 2), the principal point in the image's centre."""
    offset = points_px - np.array([(width - 1) / 2, (height - 1) / 2])
    r = focal_px * np.arctan(offset[:, 0] / focal_px)
    s = focal_px * offset[:, 1] / np.hypot(offset[:, 0], focal_px)
    return np.column_stack([r, s])


def points_from_cylinder(relative_px: Array, focal_px: float, width: int, height: int) -> Array:
    """The inverse of eq. 6: points (N, 2) relative to the cylinder's origin to pixels of the frame."""
    x = focal_px * np.tan(relative_px[:, 0] / focal_px)
    y = relative_px[:, 1] * np.hypot(x, focal_px) / focal_px
    return np.column_stack([x, y]) + np.array([(width - 1) / 2, (height - 1) / 2])
