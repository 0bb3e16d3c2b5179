"""docs/capture.md, read as by someone who writes a capture with another program: its examples and tables alone."""

from __future__ import annotations

import json
import re
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest
from av.video.frame import VideoFrame
from av.video.stream import VideoStream

from pzcap.io.capture import frame_sets, read_capture
from pzcap.io.clocks import read_sync
from pzcap.io.known_lengths import read_known_lengths
from pzcap.types import HINGE_AXES, MEASUREMENTS, PARENTS, SEGMENTS

PAGE = (Path(__file__).parents[2] / "docs" / "capture.md").read_text(encoding="utf-8")
MANIFEST, SYNC, OBJECT, KEYFRAMES, LENGTHS = (
    json.loads(block) for block in re.findall(r"```json\n(.*?)```", PAGE, re.DOTALL)
)


def table(heading: str) -> list[list[str]]:
    """Cells of the last table of a section, without backticks and head."""
    section = PAGE.split(f"\n## {heading}\n")[1].split("\n## ")[0]
    rows = re.findall(r"(?:^\|.*\n)+", section, re.MULTILINE)[-1].splitlines()[2:]
    return [[cell.strip().strip("`") for cell in row.strip("|").split("|")] for row in rows]


def film(path: Path, codec: str, rate: int, timecode: str | None = None) -> None:
    """Twelve frames, as another program writes them."""
    rng = np.random.default_rng(0)
    with av.open(str(path), "w") as container:
        if timecode is not None and path.suffix == ".mkv":
            container.metadata["TIMECODE"] = timecode
        stream = container.add_stream(codec, rate=Fraction(rate))
        assert isinstance(stream, VideoStream)
        stream.width, stream.height, stream.pix_fmt = 96, 64, "yuv420p"
        if timecode is not None and path.suffix != ".mkv":
            stream.metadata["timecode"] = timecode
        for _ in range(12):
            image = rng.integers(0, 255, (64, 96, 3), np.uint8)
            container.mux(stream.encode(VideoFrame.from_ndarray(image, format="bgr24")))
        container.mux(stream.encode())


@pytest.mark.parametrize(("suffix", "codec"), [("mp4", "libx264"), ("mov", "mpeg4"), ("mkv", "mpeg4")])
def test_a_capture_written_after_the_page_is_read(tmp_path: Path, suffix: str, codec: str) -> None:
    manifest: dict[str, Any] = json.loads(json.dumps(MANIFEST))
    (camera,) = manifest["cameras"]
    camera["motion"] = f"camera1/motion.{suffix}"
    (tmp_path / "camera1").mkdir()
    film(tmp_path / camera["sweep"], "libx264", 5)
    film(tmp_path / camera["zoom"], "libx264", 10)
    film(tmp_path / camera["motion"], codec, 30, KEYFRAMES[0]["timecode"])
    cv2.imwrite(str(tmp_path / camera["reference"]), np.zeros((64, 96, 3), np.uint8))
    keyframes = json.loads(json.dumps(KEYFRAMES))
    for row in table("keyframes.json"):
        keyframes[0]["rotations_wxyz"].setdefault(row[0], [1, 0, 0, 0])
    subject = {"measurements_m": {row[0]: 0.3 for row in table("subject.json")}, "sigma_m": 0.005}
    for name, value in {
        "capture": manifest, "object": OBJECT, "subject": subject, "keyframes": keyframes
    }.items():  # fmt: skip
        (tmp_path / f"{name}.json").write_text(json.dumps(value), encoding="utf-8")

    capture = read_capture(tmp_path)
    assert capture.name == MANIFEST["name"]
    assert capture.calibration_object is not None
    assert len(capture.calibration_object.wireframe_m) == 1
    sets = frame_sets(capture)
    assert len(sets) == 12
    assert sets.timecodes[11] == "10:20:30:11"
    (keyframe,) = sets.keyframes
    assert keyframe.frame == 0
    np.testing.assert_allclose(keyframe.pose.root_position_m, [0.12, -1.4, 0.93])
    np.testing.assert_allclose(keyframe.pose.rotations[0], [0.92, 0, 0, 0.3919], atol=1e-4)
    assert all(frames.images[0] is not None for frames in sets)


def test_the_example_of_sync_json_is_read(tmp_path: Path) -> None:
    (tmp_path / "sync.json").write_text(json.dumps(SYNC), encoding="utf-8")
    clocks = read_sync(tmp_path / "sync.json")
    assert [(name, clock.offset_s, clock.rate, clock.sigma_s) for name, clock in clocks.items()] == [
        ("1", 0.0, 1.0, 0.01),
        ("2", 1.2667, 1.0, 0.01),
    ]


def test_the_example_of_lengths_json_is_read(tmp_path: Path) -> None:
    (tmp_path / "lengths.json").write_text(json.dumps(LENGTHS), encoding="utf-8")
    (found,) = read_known_lengths(tmp_path / "lengths.json")
    assert (found.name, found.length_m, found.sigma_m) == ("east side of the carpet", 12.0, 0.005)
    assert [[(mark.camera, mark.frame) for mark in end] for end in found.ends] == [
        [("1", 73), ("2", 95)],
        [("1", 90), ("3", 85)],
    ]


def test_the_tables_name_what_the_code_knows() -> None:
    assert tuple(row[0] for row in table("subject.json")) == tuple(MEASUREMENTS)
    rows = table("keyframes.json")
    assert tuple(row[0] for row in rows) == tuple(SEGMENTS)
    for name, parent, _, _, moves in rows:
        told = re.match(r"hinge about \((.*)\)", moves)
        assert (name in HINGE_AXES) == (told is not None)
        if told is not None:
            assert [float(x) for x in told.group(1).split(",")] == list(HINGE_AXES[name])
        index = PARENTS[SEGMENTS.index(name)]
        assert parent == ("world" if index < 0 else SEGMENTS[index])
