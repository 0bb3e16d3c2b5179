"""Grey values of images."""

from __future__ import annotations

import cv2
import numpy as np

from pzcap.types import Image


def grey(image: Image) -> Image:
    """Grey image (H, W) of an image (H, W[, 3])."""
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image, np.uint8)
