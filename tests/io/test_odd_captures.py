"""Captures that are slightly other than meant: read as meant, or refused with the true cause."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest

from pzcap.command.main import main
from pzcap.io.capture import frame_sets, read_capture
from pzcap.types import PzcapError
from tests.fuzz.test_fuzz import make_capture, read_a_capture
from tests.scenes.recorders import pictures


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sound")
    make_capture(folder)
    return folder


@pytest.fixture
def folder(sound: Path, tmp_path: Path) -> Path:
    """A copy that a test may change."""
    return Path(shutil.copytree(sound, tmp_path / "capture"))


def change(path: Path, how: Callable[[Any], object]) -> None:
    content = json.loads(path.read_text())
    how(content)
    path.write_text(json.dumps(content))


def named(folder: Path, kind: str, name: str) -> None:
    """Have capture.json say that a file of camera 1 has this name."""
    change(folder / "capture.json", lambda manifest: manifest["cameras"][0].update({kind: name}))


def refused(folder: Path, said: str) -> None:
    with pytest.raises(PzcapError, match=said):
        read_a_capture(folder)


# --------------------------------------------------------------------------------------------------------------
# Names


@pytest.mark.parametrize("written", ["camera1/Motion.MP4", "camera1\\motion.mp4", "camera1/motion.mp4 "])
def test_a_name_that_is_spelt_otherwise(folder: Path, written: str) -> None:
    named(folder, "motion", written)
    refused(folder, 'is missing; its name is written "camera1/motion.mp4"')


def test_accents_as_macs_write_them(folder: Path) -> None:
    (folder / "camera1" / "motion.mp4").rename(folder / "camera1" / "\u00fcbung.mp4")
    named(folder, "motion", "camera1/u\u0308bung.mp4")
    read_a_capture(folder)


def test_a_name_that_no_file_can_have_and_a_link_to_nothing(folder: Path) -> None:
    (folder / "camera1" / "motion.mp4").unlink()
    (folder / "camera1" / "motion.mp4").symlink_to("/nowhere/motion.mp4")
    refused(folder, "is a link to /nowhere/motion.mp4, which is missing")
    named(folder, "motion", "x" * 5000)
    refused(folder, "File name too long")


def test_one_file_in_two_places(folder: Path) -> None:
    os.link(folder / "camera1" / "motion.mp4", folder / "camera1" / "again.mp4")
    change(folder / "capture.json", lambda manifest: manifest["cameras"][1].update(motion="camera1/again.mp4"))
    refused(folder, r"cameras\[0\].motion and cameras\[1\].motion are one and the same")


# --------------------------------------------------------------------------------------------------------------
# Papers


@pytest.mark.parametrize(
    ("paper", "how", "said"),
    [
        ("object.json", lambda it: it.update(units="mm"), 'unknown entry "units"'),
        ("subject.json", lambda it: it.update(stature=1.71), '"stature" is a measurement: it belongs'),
        ("object.json", lambda it: it["markers"][1].update(corners_m=it["markers"][0]["corners_m"]), "0 and 1 are"),
        ("keyframes.json", lambda it: it[0].update(covarience=[1.0]), 'write it "covariance"'),
        ("subject.json", lambda it: it.update(sigma_m=0.5), "no tape errs by 0.5 m"),
        ("mmpose.json", lambda it: it["instance_info"].append(it["instance_info"][0]), "are both of picture 0"),
    ],
)  # fmt: skip
def test_entries_that_would_be_passed_over(folder: Path, paper: str, how: Callable[[Any], object], said: str) -> None:
    change(folder / paper, how)
    refused(folder, said)


def test_other_entries_of_keyframes_are_the_users_own(folder: Path) -> None:
    change(folder / "keyframes.json", lambda poses: poses[0].update(by="Anna"))
    read_a_capture(folder)


def test_quaternions_of_those_who_write_w_last(folder: Path) -> None:
    def scalar_last(poses: Any) -> None:
        for name, (w, x, y, z) in poses[0]["rotations_wxyz"].items():
            poses[0]["rotations_wxyz"][name] = [x, y, z, w]

    change(folder / "keyframes.json", scalar_last)
    refused(folder, r"\[0\].rotations_wxyz: its quaternions are \[x, y, z, w\]")


def test_a_key_that_stands_there_twice(folder: Path) -> None:
    path = folder / "subject.json"
    path.write_text(path.read_text().replace('"sigma_m": 0.005', '"sigma_m": 0.005, "sigma_m": 0.02'))
    refused(folder, '"sigma_m" stands there twice')


def test_keypoints_of_two_videos_in_one_folder(folder: Path) -> None:
    shutil.copy(folder / "keypoints" / "motion_2_keypoints.json", folder / "keypoints" / "motion_2_keypoints (1).json")
    refused(folder, r"motion_1_keypoints.json and motion_2_keypoints \(1\).json are both of picture 1")


def test_a_keyframe_on_the_clock_that_sync_does_not_count_by(folder: Path) -> None:
    clocks = [{"name": name, "offset_s": 0.0, "rate": 1.0, "sigma_s": 0.0} for name in ("1", "2")]
    (folder / "sync.json").write_text(json.dumps({"format": "pzcap-sync", "version": 1, "cameras": clocks}))
    change(folder / "capture.json", lambda manifest: manifest.update(sync="sync.json"))
    refused(folder, r"common range .* \(sync.json counts from 00:00:00:00 on\)")


# --------------------------------------------------------------------------------------------------------------
# Videos


def encoded(path: Path, codec: str = "libx264", thumbnail: bool = False) -> None:
    """Four pictures; with a thumbnail, a track of one small picture before them."""
    with av.open(str(path), "w") as container:
        tracks = []
        if thumbnail:
            small = container.add_stream("mjpeg", rate=Fraction(5))
            small.width, small.height, small.pix_fmt = 32, 32, "yuvj420p"
            tracks.append((small, pictures(1, 32, 32)))
        stream = container.add_stream(codec, rate=Fraction(5))
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        tracks.append((stream, pictures(4)))
        for track, images in tracks:
            for image in images:
                container.mux(track.encode(av.VideoFrame.from_ndarray(image, "bgr24")))
            container.mux(track.encode())


def test_lists_of_other_files_are_no_recordings(folder: Path) -> None:
    """FFmpeg would open what they name, pipes too."""
    (folder / "camera1" / "sweep.mp4").write_text("ffconcat version 1.0\nfile zoom.mp4\n")
    refused(folder, "sweep.mp4: is no recording, but a picture or a list of other files")


def test_a_pattern_of_pictures_is_no_recording(folder: Path) -> None:
    for name in ("still%03d.png", "still000.png", "still001.png"):
        cv2.imwrite(str(folder / "camera1" / name), pictures(1)[0])
    named(folder, "sweep", "camera1/still%03d.png")
    refused(folder, "is no recording, but a picture or a list of other files")


def test_a_stream_without_a_container(folder: Path) -> None:
    encoded(folder / "camera1" / "sweep.h264")
    named(folder, "sweep", "camera1/sweep.h264")
    refused(folder, "a raw stream, .* ffmpeg -framerate RATE -i sweep.h264 -c copy OUT.mp4")


def test_a_thumbnail_before_the_recording(folder: Path) -> None:
    encoded(folder / "camera1" / "sweep.mkv", thumbnail=True)
    named(folder, "sweep", "camera1/sweep.mkv")
    read_a_capture(folder)


def test_a_name_that_is_a_protocol(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file's name is no address, wherever the command is begun."""
    shutil.copy(folder / "camera1" / "motion.mp4", folder / "data:motion.mp4")
    named(folder, "motion", "data:motion.mp4")
    monkeypatch.chdir(folder)
    sets = frame_sets(read_capture(Path()))
    assert np.asarray(next(iter(sets)).images[0]).shape == (48, 64, 3)


# --------------------------------------------------------------------------------------------------------------
# Control characters, which terminals obey


@pytest.mark.parametrize("name", ["\x1b[2Jcam", "a\nb", "\x9b31m", "b\u2028c"])
def test_names_hold_no_control_characters(folder: Path, name: str) -> None:
    change(folder / "capture.json", lambda manifest: manifest["cameras"][1].update(name=name))
    refused(folder, r"cameras\[1\].name: holds control characters")
    change(folder / "capture.json", lambda manifest: manifest.update(name=name))
    refused(folder, "name: holds control characters")


def test_a_line_holds_no_control_characters(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    hostile = folder.with_name("\x1b]0;title\x07")
    assert main(["check", str(hostile)]) == 1
    said = capsys.readouterr().err
    assert "\x1b" not in said
    assert r"\x1b]0;title\x07" in said
