"""The panorama that frames are aligned with (`pzcap.localisation.photometric_alignment`), in several resolutions, ready
to be sampled."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from pzcap.imaging.bspline import Stored, stored
from pzcap.types import Array, Mask, Panorama


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """The panorama in one resolution."""

    image: Stored  # (H, W)
    known: Mask  # (H, W) all around a pixel is known
    scale: tuple[float, float]  # panorama pixels to one of this image's, across and down
    half: Array = field(default_factory=lambda: np.empty((0, 2)))  # (N, 2) see `rays.sample`


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    layer: Layer
    scale: float
    pixels: int  # of a frame that are looked at, about


def halved(image: NDArray[np.float32], known: NDArray[np.float32], halvings: int, pixels: int) -> Level:
    """A grey panorama (H, W), and where it is ``known``, made smaller; ``pixels`` of a frame are compared with it."""
    scale = 2.0**halvings
    size = (int(image.shape[1] / scale), int(image.shape[0] / scale))
    # whole cells only, so that places scale exactly
    rows, columns = int(size[1] * scale), int(size[0] * scale)
    small = cv2.resize(image[:rows, :columns], size, interpolation=cv2.INTER_AREA)
    complete = cv2.resize(known[:rows, :columns], size, interpolation=cv2.INTER_AREA) > 0.999
    inside = cv2.erode(complete.astype(np.uint8), np.ones((5, 5), np.uint8), borderValue=0)
    return Level(Layer(stored(np.asarray(small, np.float32)), inside > 0, (scale, scale)), scale, pixels)


def super_resolved(panorama: Panorama, known: NDArray[np.float32], margin: int) -> Layer:
    """The super-resolved panorama; ``known`` and ``margin`` are those of the panorama that goes on beyond its ends."""
    down, across = np.array(panorama.fine.shape) // np.array(panorama.image.shape[:2])
    image = cv2.copyMakeBorder(panorama.fine, 0, 0, margin * across, margin * across, cv2.BORDER_WRAP)
    inside = cv2.resize(known.astype(np.uint8), image.shape[::-1], interpolation=cv2.INTER_NEAREST)
    inside = cv2.erode(inside, np.ones((9, 9), np.uint8))
    return Layer(np.asarray(image, np.uint16), inside > 0, (1.0 / across, 1.0 / down))
