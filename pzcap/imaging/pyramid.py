"""The panorama that frames are aligned with (`pzcap.localisation.photometric_alignment`), in several resolutions."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from pzcap.imaging.bspline import Stored, stored
from pzcap.types import Float32, Mask


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """The panorama in one resolution, ready to be sampled."""

    image: Stored  # (H, W)
    known: Mask  # (H, W) all around a pixel is known
    scale: float  # panorama pixels to one of this image's
    pixels: int  # of a frame that are compared with it, about


def halved(image: Float32, known: Float32, halvings: int, pixels: int) -> Level:
    """A grey panorama (H, W), and where it is ``known``, made smaller; ``pixels`` of a frame are compared with it."""
    scale = 2.0**halvings
    size = (int(image.shape[1] / scale), int(image.shape[0] / scale))
    # whole cells only, so that places scale exactly
    rows, columns = int(size[1] * scale), int(size[0] * scale)
    small = cv2.resize(image[:rows, :columns], size, interpolation=cv2.INTER_AREA)
    complete = cv2.resize(known[:rows, :columns], size, interpolation=cv2.INTER_AREA) > 0.999
    inside = cv2.erode(complete.astype(np.uint8), np.ones((5, 5), np.uint8), borderValue=0)
    return Level(stored(np.asarray(small, np.float32)), inside > 0, scale, pixels)
