"""The body as the tracker expects it in a view, before the view is cut out."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from pzcap.localisation.panorama_sampler import Window
from pzcap.segmentation.tuning import BODY
from pzcap.types import Array, Float32, Mask


@dataclass(frozen=True, slots=True, eq=False)
class Expected:
    """The body as it is predicted in a view, over the part of the view in which it can be."""

    left: int  # even, as are width and height: half pixels
    top: int
    distance_px: Float32  # (h, w) of half pixels, from the outline; positive inside
    sigma_px: float  # of that, for the error of the predicted pose
    pelvis_m: Array | None = None  # (3,) where the body is; None: it is lost

    @property
    def window(self) -> Window:
        height, width = self.distance_px.shape
        return self.left, self.top, self.left + 2 * width, self.top + 2 * height

    def within(self, beside_px: float, shape: tuple[int, ...]) -> Mask:
        """(h, w) half pixels of the view that the body may cover, or stand off by ``beside_px``, as predictions err."""
        left, top, right, bottom = self.window
        near = np.zeros(shape, np.bool_)
        near[top // 2 : bottom // 2, left // 2 : right // 2] = self.distance_px >= -beside_px - self.sigma_px
        return near

    def covered(self, height: int, width: int) -> Mask:
        """(height, width) the pixels of the view in which the body may be."""
        left, top, right, bottom = self.window
        near = (self.distance_px > -self.sigma_px - BODY.clothes_px).astype(np.uint8)
        covered = np.zeros((height, width), np.bool_)
        size = right - left, bottom - top
        covered[top:bottom, left:right] = cv2.resize(near, size, interpolation=cv2.INTER_NEAREST)
        return covered
