"""The focal length of a sweep by itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pzcap.calibration.focal_from_sweep import camera_of_sweep
from pzcap.calibration.settings import PanZoomConfig
from pzcap.io.video import VideoReader
from pzcap.types import PzcapError


def test_a_sweep_tells_its_focal_length(small_capture: Path) -> None:
    found = camera_of_sweep(VideoReader(small_capture / "capture" / "camera1" / "sweep.mp4"), PanZoomConfig())
    assert found.focal_px == pytest.approx(1.375 * 320, rel=0.02)
    assert (found.width, found.height) == (320, 240)


def test_a_sweep_of_a_bare_wall_tells_none() -> None:
    bare = [(number, np.full((120, 160, 3), 128, np.uint8)) for number in range(12)]
    with pytest.raises(PzcapError, match="focal length"):
        camera_of_sweep(bare, PanZoomConfig())
