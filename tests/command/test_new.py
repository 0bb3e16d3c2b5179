"""`pzcap new` on a crew's own folders: names of cameras, what a file is for, what stands in the way."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from pzcap.command.footage_files import cameras_in
from pzcap.command.main import main
from pzcap.io.capture import read_capture
from pzcap.io.clocks import SYNC_FORMAT, SYNC_VERSION
from pzcap.types import PzcapError
from tests.scenes.recorders import encode, pictures


def video(
    path: Path, *, size: tuple[int, int] = (64, 48), rate: Fraction = Fraction(30), timecode: str | None = None
) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=rate)
        stream.width, stream.height, stream.pix_fmt = *size, "yuv420p"
        if timecode:
            container.metadata["timecode"] = timecode
        rng = np.random.default_rng(0)
        for _ in range(4):
            frame = av.VideoFrame.from_ndarray(rng.integers(0, 255, (size[1], size[0], 3), np.uint8), format="rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def still(path: Path, size: tuple[int, int] = (64, 48)) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.zeros((size[1], size[0], 3), np.uint8))


def crew(folder: Path, cameras: Sequence[str] = ("GoPro 1", "GoPro 2"), timecode: str | None = "10:20:30:00") -> None:
    """Cameras that number their files."""
    for camera in cameras:
        card = folder / camera / "DCIM" / "100GOPRO"
        still(card / "GOPR0033.PNG")
        for number in (34, 35, 36):
            video(card / f"GX01{number:04d}.MP4", timecode=timecode)


def entries(folder: Path) -> list[dict[str, str]]:
    manifest = json.loads((folder / "capture.json").read_text())
    return list(manifest["cameras"])


def test_files_that_a_camera_has_numbered(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    crew(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    assert main(["new", str(tmp_path), "--name", "Kür"]) == 0
    assert sorted(tmp_path.rglob("*")) == sorted([*before, tmp_path / "capture.json"])
    assert entries(tmp_path)[0] == {
        "name": "GoPro 1",
        "reference": "GoPro 1/DCIM/100GOPRO/GOPR0033.PNG",
        "sweep": "GoPro 1/DCIM/100GOPRO/GX010034.MP4",
        "zoom": "GoPro 1/DCIM/100GOPRO/GX010035.MP4",
        "motion": "GoPro 1/DCIM/100GOPRO/GX010036.MP4",
    }
    capture = read_capture(tmp_path)
    assert (capture.name, capture.frame_rate, capture.full_turn) == ("Kür", Fraction(30), True)
    table = capsys.readouterr().out.splitlines()
    row = next(line for line in table if "GX010036" in line).split()
    assert row[:4] == ["GoPro", "1", "motion", "GX010036.MP4"]
    assert row[-5:] == ["64x48", "4", "30", "10:20:30:00", "progressive"]


@pytest.mark.parametrize(
    ("names", "roles"),
    [
        (("A001_sweep.MP4", "A002_ZoomRun.MP4", "A003_take3.MP4"), ("sweep", "zoom", "motion")),
        (("motionA.MP4", "pan-left.MP4"), ("motion", "sweep")),
        (("C9.MP4", "C10.MP4"), ("sweep", "motion")),
        (("C1.MP4",), ("motion",)),
        (("a_zoom.MP4", "b.MP4", "c.MP4"), ("zoom", "sweep", "motion")),
    ],
)
def test_what_a_file_is_for_is_told_by_its_name_or_its_place(
    names: Sequence[str], roles: Sequence[str], tmp_path: Path
) -> None:
    for name in names:
        video(tmp_path / "cam" / name)
    [files] = cameras_in(tmp_path, {}).values()
    assert {file.path.name: file.role for file in files} == dict(zip(names, roles, strict=True))


def test_files_of_all_cameras_in_one_folder(tmp_path: Path) -> None:
    for camera in ("left", "right"):
        still(tmp_path / f"{camera}_reference.png")
        video(tmp_path / f"{camera}_sweep.mp4")
        video(tmp_path / f"{camera}_motion.mp4", timecode="01:00:00:00")
    assert main(["new", str(tmp_path), "--partial-sweep"]) == 0
    assert [entry["name"] for entry in entries(tmp_path)] == ["left", "right"]
    assert entries(tmp_path)[1]["sweep"] == "right_sweep.mp4"
    assert read_capture(tmp_path).full_turn is False


def test_patterns_say_what_names_do_not(tmp_path: Path) -> None:
    for number in range(5):
        video(tmp_path / "cam" / f"{number}.mp4", timecode="01:00:00:00")
    with pytest.raises(PzcapError, match=r"nothing tells what 0\.mp4, 1\.mp4, 2\.mp4, 3\.mp4, 4\.mp4 are for"):
        cameras_in(tmp_path, {})
    for number in (0, 3):
        (tmp_path / "cam" / f"{number}.mp4").unlink()
    main(["new", str(tmp_path), "--sweep", "4*", "--zoom", "1.mp4", "--motion", "2.mp4"])
    assert [entries(tmp_path)[0][role] for role in ("sweep", "zoom", "motion")] == [
        "cam/4.mp4",
        "cam/1.mp4",
        "cam/2.mp4",
    ]


def test_two_files_for_one_purpose(tmp_path: Path) -> None:
    video(tmp_path / "cam" / "sweep1.mp4")
    video(tmp_path / "cam" / "sweep2.mp4")
    with pytest.raises(PzcapError, match=r"sweep1\.mp4, sweep2\.mp4 could each be its sweep; say which by --sweep"):
        cameras_in(tmp_path, {})


def test_one_piece_of_a_recording_may_be_chosen(tmp_path: Path) -> None:
    for name in ("sweep", "zoom", "motion1", "motion2"):
        video(tmp_path / "cam" / f"{name}.mp4")
    with pytest.raises(PzcapError, match=r"could each be its motion; .*; join pieces of one recording first"):
        cameras_in(tmp_path, {})
    [files] = cameras_in(tmp_path, {"motion": "motion2.mp4"}).values()
    assert [file.path.stem for file in files] == ["sweep", "zoom", "motion2"]


def test_further_videos_are_left_out_where_all_are_named(tmp_path: Path) -> None:
    for number in range(5):
        video(tmp_path / "cam" / f"{number}.mp4")
    [files] = cameras_in(tmp_path, {"sweep": "1.*", "zoom": "2.*", "motion": "3.*"}).values()
    assert [file.path.stem for file in files] == ["1", "2", "3"]


@pytest.mark.parametrize("ending", ["webm", "TS", "m2t", "mpg", "3gp", "wmv", "braw"])
def test_no_video_is_passed_over_for_its_ending(ending: str, tmp_path: Path) -> None:
    """Else the zoom run would be taken for the motion."""
    for number in (1, 2):
        video(tmp_path / "cam" / f"{number}.mp4")
    (tmp_path / "cam" / f"3.{ending}").write_bytes(b"no video")
    [files] = cameras_in(tmp_path, {}).values()
    assert [(file.role, file.trouble is None) for file in files] == [
        ("sweep", True), ("zoom", True), ("motion", False),
    ]  # fmt: skip


def test_raw_pictures_beside_a_still_are_no_stills(tmp_path: Path) -> None:
    video(tmp_path / "cam" / "1.mp4")
    (tmp_path / "cam" / "0.DNG").write_bytes(b"II*\0")
    [[still_file, _]] = cameras_in(tmp_path, {}).values()
    assert "neither PNG nor JPEG" in str(still_file.trouble)
    still(tmp_path / "cam" / "0.png")
    [[still_file, _]] = cameras_in(tmp_path, {}).values()
    assert (still_file.path.name, still_file.trouble) == ("0.png", None)


def test_phones_whose_rate_varies_have_the_rate_they_were_set_to(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(4)
    for camera in ("a", "b"):
        times = np.delete(np.cumsum(rng.normal(1 / 30, 0.004, 40)), rng.integers(1, 39, 3))
        path = tmp_path / camera / "motion.mov"
        path.parent.mkdir()
        encode(path, pictures(len(times)), Fraction(30), times_s=times.tolist(), timecode="10:20:30:00")
    assert main(["new", str(tmp_path)]) == 1  # for the still and the sweep alone
    said = capsys.readouterr().out
    assert "frames/s; one rate" not in said
    assert said.count("30, varies") == 2
    assert json.loads((tmp_path / "capture.json").read_text())["frame_rate"] == "30/1"


def broken(folder: Path) -> None:
    (folder / "GoPro 1/DCIM/100GOPRO/GX010034.MP4").write_bytes(b"no video")


def other_size(folder: Path) -> None:
    video(folder / "GoPro 1/DCIM/100GOPRO/GX010035.MP4", size=(96, 48))


def turned(folder: Path) -> None:
    video(folder / "GoPro 1/DCIM/100GOPRO/GX010035.MP4", size=(48, 64))


def photo(folder: Path) -> None:
    still(folder / "GoPro 1/DCIM/100GOPRO/GOPR0033.PNG", size=(640, 480))


def heic(folder: Path) -> None:
    no_still(folder)
    (folder / "GoPro 2/DCIM/100GOPRO/IMG_0033.HEIC").write_bytes(b"\0\0\0\x18ftypheic")


def other_rate(folder: Path) -> None:
    video(folder / "GoPro 1/DCIM/100GOPRO/GX010036.MP4", timecode="10:20:30:00", rate=Fraction(25))


def no_still(folder: Path) -> None:
    (folder / "GoPro 2/DCIM/100GOPRO/GOPR0033.PNG").unlink()


def bad_text(folder: Path) -> None:
    (folder / "subject.json").write_text("{}")


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (broken, "GX010034.MP4: the video is truncated or damaged"),
        (other_size, "camera GoPro 1: one size is needed for all its files, not"),
        (other_size, "shoot what differs again"),
        (turned, "some stand upright and some lie"),
        (photo, "64x48; a photo shows more or less of the scene than a video"),
        (heic, "IMG_0033.HEIC: the image cannot be decoded, being neither PNG nor JPEG"),
        (other_rate, "the motion videos have 25, 30 frames/s; one rate is needed"),
        (no_still, "camera GoPro 2: no still of the calibration object"),
        (bad_text, "subject.json"),
    ],
)
def test_what_stands_in_the_way_is_listed(
    damage: object, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    crew(tmp_path)
    assert callable(damage)
    damage(tmp_path)
    assert main(["new", str(tmp_path)]) == 1
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("  to mend: ")]
    assert len(lines) == 1
    assert says in lines[0]


def test_a_video_without_timecode(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    crew(tmp_path, timecode=None)
    assert main(["new", str(tmp_path)]) == 1
    said = capsys.readouterr().out
    assert "to mend: sync by sound: camera GoPro 1 has none" in said
    assert "sync: NOT KNOWN how the cameras lie to each other" in said


def test_a_sync_json_older_than_the_videos_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    crew(tmp_path)
    clocks = [{"name": name, "offset_s": 0.0, "rate": 1.0, "sigma_s": 0.001} for name in ("GoPro 1", "GoPro 2")]
    content = {"format": SYNC_FORMAT, "version": SYNC_VERSION, "cameras": clocks}
    (tmp_path / "sync.json").write_text(json.dumps(content))
    main(["new", str(tmp_path)])
    assert "of another take" not in capsys.readouterr().out
    os.utime(tmp_path / "sync.json", (0, 0))
    main(["new", str(tmp_path), "--replace"])
    assert f"of another take, run pzcap sync {tmp_path}" in capsys.readouterr().out


@pytest.mark.parametrize(("rate", "mends"), [(Fraction(30000, 1001), 0), (Fraction(25), 1)])
def test_rates_that_a_sync_json_brings_together_are_no_trouble(
    rate: Fraction, mends: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    crew(tmp_path)
    video(tmp_path / "GoPro 1/DCIM/100GOPRO/GX010036.MP4", timecode="10:20:30:00", rate=rate)
    assert main(["new", str(tmp_path)]) == 1
    assert "pzcap sync FOLDER brings together" in capsys.readouterr().out
    clocks = [{"name": name, "offset_s": 0.0, "rate": 1.0, "sigma_s": 0.001} for name in ("GoPro 1", "GoPro 2")]
    content = {"format": SYNC_FORMAT, "version": SYNC_VERSION, "cameras": clocks}
    (tmp_path / "sync.json").write_text(json.dumps(content))
    assert main(["new", str(tmp_path), "--replace"]) == mends


@pytest.mark.parametrize(
    ("folders", "names"),
    [
        (("camera1", "camera2"), ["1", "2"]),
        (("Camera A", "cam_B"), ["A", "B"]),
        (("camera", "camera 2"), ["camera", "camera 2"]),  # nothing would be left of one
        (("cam1", "camera 1"), ["cam1", "camera 1"]),  # nor could they be told apart
        (("cam1", "left"), ["cam1", "left"]),
    ],
)
def test_a_camera_is_called_what_its_folder_is(folders: Sequence[str], names: list[str], tmp_path: Path) -> None:
    crew(tmp_path, folders)
    assert main(["new", str(tmp_path)]) == 0
    assert sorted(entry["name"] for entry in entries(tmp_path)) == sorted(names)


def test_a_capture_json_is_not_written_over(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    crew(tmp_path)
    (tmp_path / "capture.json").write_text("mine")
    assert main(["new", str(tmp_path)]) == 1
    assert "is there already; give --replace" in capsys.readouterr().err
    assert (tmp_path / "capture.json").read_text() == "mine"
    assert main(["new", str(tmp_path), "--replace"]) == 0


@pytest.mark.parametrize("kind", ["nothing", "empty"])
def test_a_folder_without_footage(kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / kind
    if kind == "empty":
        folder.mkdir()
    assert main(["new", str(folder)]) == 1
    assert ("no videos in it" if kind == "empty" else "no such folder") in capsys.readouterr().err


def test_results_among_the_footage_are_no_camera(tmp_path: Path) -> None:
    crew(tmp_path)
    video(tmp_path / "results" / "stabilised" / "GoPro_1.mp4")
    still(tmp_path / "results" / "reconstruction" / "panorama1.png")
    (tmp_path / "results" / "reconstruction" / "reconstruction.json").write_text("{}")
    assert set(cameras_in(tmp_path, {})) == {"GoPro 1", "GoPro 2"}
