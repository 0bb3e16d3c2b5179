"""Rerun's own viewer driven without a screen, and a look at its pixels."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from experiments import review
from pzcap.types import Image
from pzcap.viewer import window


def _vulkan() -> bool:
    """True if there is a driver that the viewer can draw with."""
    named = os.environ.get("VK_DRIVER_FILES") or os.environ.get("VK_ICD_FILENAMES")
    return bool(named) or any(Path("/usr/share/vulkan/icd.d").glob("*.json"))


needs_vulkan = pytest.mark.skipif(
    not _vulkan(),
    reason="needs a Vulkan driver: apt-get install --no-install-recommends mesa-vulkan-drivers libvulkan1",
)


def screenshot(found: review.Review) -> tuple[Image, Any]:
    """Screenshot of a review in the viewer once it has come to rest (blue, green, red), and the viewer's state."""
    process, client = window.show([found.place], headless=True)
    try:
        shots = [client.take_screenshot()]
        while len(shots) < 2 or (shots[-1] != shots[-2] and len(shots) < 20):
            shots.append(client.take_screenshot())
        state = client.get_state()
    finally:
        window.close(process)
    pixels = cv2.imdecode(np.frombuffer(shots[-1], np.uint8), cv2.IMREAD_COLOR)
    assert pixels is not None
    return np.asarray(pixels, np.uint8), state


def likeness(shown: Image, picture: Image) -> float:
    """Correlation with ``picture`` where it is shown best, whatever its size."""
    half = cv2.resize(shown, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    best = -1.0
    for width in range(160, 500, 4):
        height = round(width * picture.shape[0] / picture.shape[1])
        if height <= half.shape[0]:
            small = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
            best = max(best, float(cv2.matchTemplate(half, small, cv2.TM_CCOEFF_NORMED).max()))
    return best
