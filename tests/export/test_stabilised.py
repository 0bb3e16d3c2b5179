"""Stabilised video: what stands in the hall stands in the picture, where the calibration beside it says."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from pzcap.export import formats, stabilised
from pzcap.export.take import Take
from pzcap.export.virtual_cameras import athlete, virtual_cameras
from pzcap.geometry.camera import project
from pzcap.io.video import VideoReader
from pzcap.types import FrameSet, PzcapError
from tests.scenes import exported
from tests.scenes.exported import LOST


def test_a_spot_stands_where_the_calibration_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stabilised, "LONGEST_PX", 400)  # less than the camera's: it is scaled
    places, count = athlete(exported.take()), 8

    def picture(number: int, frame: int) -> np.ndarray:
        camera = exported.true_camera(number, frame)
        spot = project(camera, places[frame][None])[0][0]
        across, down = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
        grey = 40 + 200 * np.exp(-((across - spot[0]) ** 2 + (down - spot[1]) ** 2) / (2 * 3.0**2))
        return np.repeat(grey[..., None], 3, axis=2).astype(np.uint8)

    def sets(_: object) -> list[FrameSet]:
        return [FrameSet(f, "", tuple(picture(c, f) for c in range(4))) for f in range(count)]

    monkeypatch.setattr(stabilised, "frame_sets", sets)
    take = Take(exported.reconstruction(), capture=SimpleNamespace())  # type: ignore[arg-type]
    formats.write(take, "stabilised", tmp_path)
    about = json.loads((tmp_path / "cameras.json").read_text())
    assert about["frame_rate"] == "30000/1001"
    assert len(about["cameras"]) == 4
    for number, (entry, virtual) in enumerate(zip(about["cameras"], virtual_cameras(take), strict=True)):
        reader = VideoReader(tmp_path / entry["video"])
        assert [reader.width, reader.height] == entry["size"]
        assert max(entry["size"]) <= 400 < max(virtual.camera.width, virtual.camera.height)
        pictures = [image for _, image in reader]
        assert len(pictures) == count
        for frame, image in enumerate(pictures):
            if (number, frame) == (0, LOST):
                assert image.max() < 20
                continue
            vectors = np.array(entry["rotation"]), np.array(entry["translation"])
            lens = np.array(entry["matrix"]), np.array(entry["distortions"])
            [[expected]] = cv2.projectPoints(places[frame][None], *vectors, *lens)[0]
            light = (image[..., 0].astype(float) - 80.0).clip(0.0)
            rows, columns = np.mgrid[: image.shape[0], : image.shape[1]]
            found = [float((light * each).sum() / light.sum()) for each in (columns, rows)]
            np.testing.assert_allclose(found, expected, atol=0.25)


def test_it_needs_the_capture(tmp_path: Path) -> None:
    with pytest.raises(PzcapError, match="give --capture FOLDER"):
        formats.write(exported.take(), "stabilised", tmp_path)
