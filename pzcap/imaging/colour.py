"""Grey values of images; and lateral colour, by which a lens shows red larger or smaller than green and blue.

Seen in white light all colours of a frame have the same centre and stretches ``1 + s_c`` that differ by thousandths. A
grey edge then keeps its place in the grey values, and is only a little softer. An edge between colours does not: it
moves towards where its strongest colour stands, by tenths of a pixel in the corners, as if the focal length were longer
in a hall of red walls.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from pzcap.types import Array, Image

LUMA: Final = np.array([0.114, 0.587, 0.299])  # weights of blue, green and red in grey values (BT.601)


def grey(image: Image) -> Image:
    """Grey image (H, W) of an image (H, W[, 3])."""
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image, np.uint8)


def colours_aligned(image: Image, stretches: Array) -> Image:
    """An image (H, W, 3) with its blue, green and red brought to where they are seen without `Lens.lateral_colour`,
    which are their ``stretches`` (3,); itself where these are 0."""
    if not np.any(stretches):
        return image
    height, width = image.shape[:2]
    middle = np.array([(width - 1) / 2, (height - 1) / 2])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    planes = [
        cv2.warpAffine(
            plane, np.column_stack([np.eye(2) * (1.0 + stretch), -stretch * middle]), (width, height), flags=flags,
            borderMode=cv2.BORDER_REPLICATE,
        )
        for plane, stretch in zip(cv2.split(image), stretches, strict=True)
    ]  # fmt: skip
    return np.asarray(cv2.merge(planes), np.uint8)
