"""What a user gets who brings something broken: one line on stderr, exit status 1, no traceback, no results."""

from __future__ import annotations

import errno
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import av
import cv2
import pytest

import sim
from experiments.footage import SMALL, shot
from experiments.run import RESULTS, main
from pzcap import pipeline
from pzcap.io.capture import read_capture
from pzcap.io.video import VideoReader
from pzcap.types import PzcapError
from sim.capture_writer import write_video

pytestmark = pytest.mark.xdist_group("experiments")


@pytest.fixture
def footage(small_capture: Path, tmp_path: Path) -> Path:
    """A capture to break."""
    return Path(shutil.copytree(small_capture / "capture", tmp_path / "footage"))


@pytest.fixture
def refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Start the command, which must fail as it should; return its line."""

    def start(*arguments: str) -> str:
        folder = tmp_path / "run"
        monkeypatch.setattr("sys.argv", ["experiments.run", *arguments, f"hydra.run.dir={folder}"])
        assert main() == 1
        out, err = capfd.readouterr()
        assert out == ""
        assert err.startswith("error: ")
        assert err.count("\n") == 1, err
        assert not any((folder / name).exists() for name in RESULTS)
        return err

    return start


def change(path: Path, edit: Callable[[Any], object]) -> None:
    value = json.loads(path.read_text(encoding="utf-8"))
    edit(value)
    path.write_text(json.dumps(value), encoding="utf-8")


def cut(path: Path) -> None:
    data = path.read_bytes()
    path.write_bytes(data[: 6 * len(data) // 10])


def cut_behind_its_index(path: Path) -> None:
    """Cut a video whose index stands in front, so that it opens, and lists frames that are not there."""
    moved = path.with_name("moved.mp4")
    with av.open(str(path)) as source, av.open(str(moved), "w", options={"movflags": "faststart"}) as target:
        stream = source.streams.video[0]
        copy = target.add_stream_from_template(stream)
        copy.metadata.update(stream.metadata)
        for packet in source.demux(stream):
            if packet.dts is not None:
                packet.stream = copy
                target.mux(packet)
    moved.replace(path)
    cut(path)


def lose_the_timecode(path: Path) -> None:
    reader = VideoReader(path)
    images = [image for _, image in reader]
    write_video(path, images, reader.frame_rate, crf=20)


def show_the_hall_only(path: Path) -> None:
    _, image = next(iter(VideoReader(path.with_name("sweep.mp4"))))
    cv2.imwrite(str(path), image)


FAULTS: dict[str, tuple[str, Callable[[Path], object], str]] = {
    "a missing video": ("camera1/motion.mp4", Path.unlink, "is missing"),
    "a truncated motion": ("camera2/motion.mp4", cut, "truncated"),
    "a truncated sweep": ("camera2/sweep.mp4", cut, "truncated"),
    "a truncated zoom run": ("camera2/zoom.mp4", cut, "truncated"),
    "a motion that ends behind its index": ("camera2/motion.mp4", cut_behind_its_index, "truncated"),
    "a sweep that ends behind its index": ("camera2/sweep.mp4", cut_behind_its_index, "truncated"),
    "an empty video": ("camera2/motion.mp4", lambda path: path.write_bytes(b""), "truncated"),
    "a truncated picture": ("camera2/reference.png", cut, "cannot be decoded"),
    "no timecode": ("camera3/motion.mp4", lose_the_timecode, "no SMPTE timecode"),
    "no object in sight": ("camera4/reference.png", show_the_hall_only, "markers found"),
    "another dictionary": (
        "object.json",
        lambda path: change(path, lambda o: o.update(dictionary="DICT_6X6_50")),
        "markers are of DICT_4X4_50, where object.json says DICT_6X6_50; correct it there",
    ),
    "an empty file of keyframes": ("keyframes.json", lambda path: path.write_text(""), "not valid JSON"),
    "endless keyframes": ("keyframes.json", lambda path: path.write_text("[" * 100_000), "not valid JSON"),
    "another version": ("capture.json", lambda path: change(path, lambda m: m.update(version=7)), "version 1"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_broken_footage(fault: str, footage: Path, refused: Callable[..., str]) -> None:
    file, damage, expected = FAULTS[fault]
    damage(footage / file)
    line = refused(f"capture={footage}", "output.recording=false")
    assert expected in line
    assert file in line


def test_a_misspelt_entry_is_not_taken_for_a_missing_file(footage: Path, refused: Callable[..., str]) -> None:
    change(footage / "capture.json", lambda m: m["cameras"][0].update(swep=m["cameras"][0].pop("sweep")))
    assert 'unknown entry "swep"; the nearest are sweep' in refused(f"capture={footage}")


def test_what_a_line_quotes_is_of_one_line_and_moves_no_cursor(footage: Path) -> None:
    change(footage / "capture.json", lambda m: m.update({"one\ntwo\x1b[2J": 3}))
    with pytest.raises(PzcapError) as caught:
        read_capture(footage)
    assert 'unknown entry "one two\\x1b[2J"; the nearest are' in str(caught.value)


def test_no_such_folder(tmp_path: Path, refused: Callable[..., str]) -> None:
    assert str(tmp_path / "nowhere") in refused(f"capture={tmp_path / 'nowhere'}")
    assert not (tmp_path / "run" / "capture").is_symlink()


@pytest.mark.parametrize(
    ("argument", "expected"),
    [
        ("shoot.sensor.read_nose=3", "did you mean shoot.sensor.read_noise"),
        ("+sed=1", "did you mean seed"),
        ("hydra.run.dri=x", "did you mean hydra.run.dir"),
        ("experiment=flor_exercise", "did you mean floor_exercise?"),
        ("reconstruct.panzoom.threshold=low", "'low' is not a number"),
        ("method=papr", "choose one of exact, paper"),
        ("reconstruct.threads=0", "give 1 or more"),
        ("output.jpeg_quality=0", "output.jpeg_quality is 0; give from 1 to 100"),
        ("output.light_gb=-1", "output.light_gb is -1.0; give from 0 to 1000000"),
        ("seed=-1", "seed is -1; give from 0 to 4294967295"),
        ("shoot.width=0", "shoot.width is 0; give a multiple of 2 from 32 to 8192"),
        ("shoot.width=321", "shoot.width is 321; give a multiple of 2"),
        ("shoot.height=100000", "shoot.height is 100000; give a multiple of 2"),
        ("shoot.frame_rate=0", "shoot.frame_rate is 0; give from 1 to 240"),
        ("shoot.sweep_deg=nan", "shoot.sweep_deg is nan; give from 1 to 360"),
        ("shoot.sweep_frame_rate=-5", "shoot.sweep_frame_rate is -5"),
        ("shoot.motion_frames=-1", "shoot.motion_frames is -1"),
        ("shoot.zoom_frames=1", "zoom_frames is 1; give 2 or more, or 0"),
        ("shoot.optics.zoom_max=0", "zoom_min is 0.7, zoom_max 0"),
        ("shoot.optics.reference_focal=-1", "shoot.optics.reference_focal is -1.0; give from 0.2 to 50"),
        (
            "shoot.sensor.supersampling=1000",
            "supersampling is 1000.0; give a multiple of 0.25 from 1 to 16",
        ),
        ("shoot.sensor.sub_exposures=0", "shoot.sensor.sub_exposures is 0; give from 1 to 64"),
        ("shoot.sensor.read_noise=inf", "shoot.sensor.read_noise is inf; give from 0 to 128"),
        ("shoot.sensor.crf_motion=99", "shoot.sensor.crf_motion is 99; give from 0 to 51"),
        ("shoot.sensor.dropped_share=1", "shoot.sensor.dropped_share is 1.0; give from 0 to 0.95"),
        ("shoot.operator.sweep_step_deg=0", "shoot.operator.sweep_step_deg is 0.0; give from 0.05 to 60"),
        ("shoot.gym.texture_px_per_m=1e9", "texture_px_per_m is 1000000000.0; give from 50 to 500"),
        ("reconstruct.tracking.velocity_gain=nan", "reconstruct.tracking.velocity_gain is not a number; give one"),
        ("cameras=nowhere", "nowhere: no reconstruction.json"),
        ("seed", "cannot read 'seed'; settings are given as key=value"),
        ("capture=takes/seed=3", """in quotes: 'capture="takes/seed=3"'"""),
        ("capture=take (2)", """in quotes: 'capture="take (2)"'"""),
    ],
)
def test_a_wrong_argument(argument: str, expected: str, refused: Callable[..., str]) -> None:
    assert expected in refused(argument)


def test_overrides_on_both_sides_of_the_flag(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As people write them, and Hydra refuses them with its usage."""
    arguments = ["method=exact", "-m", "seed=-1,-2", f"hydra.sweep.dir={tmp_path / 'study'}"]
    monkeypatch.setattr("sys.argv", ["experiments.run", *arguments])
    assert main() == 1
    assert len(list((tmp_path / "study").rglob("failed.txt"))) == 2


def test_pictures_that_no_graphics_library_holds(tmp_path: Path) -> None:
    config = replace(SMALL, width=2560, height=1440, sensor=replace(SMALL.sensor, supersampling_still=8.0))
    with pytest.raises(
        PzcapError, match=r"\d+ x \d+ px would be rendered, and 16384 is the most; give a smaller shoot"
    ):
        shot(config, tmp_path)


def test_cameras_of_another_take_and_an_estimator(refused: Callable[..., str]) -> None:
    assert "leave out cameras" in refused("cameras=nowhere", "estimator=tests.scenes.biased:pan_off")


def test_no_gl_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]) -> None:
    monkeypatch.setattr(sim, "GL_BACKEND", "osmesa")
    monkeypatch.setattr("sim.cameras.render._PROBE", "raise ImportError")
    assert "apt-get install libosmesa6" in refused(f"output.captures={tmp_path / 'captures'}")
    assert not list((tmp_path / "captures").iterdir())


@pytest.mark.parametrize(("number", "expected"), [(errno.ENOSPC, "the disk is full"), (errno.EACCES, "no permission")])
def test_a_folder_that_takes_nothing(
    number: int, expected: str, small_capture: Path, monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]
) -> None:
    def write(*_: object) -> None:
        raise OSError(number, "no", "numbers.npz")

    monkeypatch.setattr(pipeline, "stages", write)
    line = refused(f"capture={small_capture / 'capture'}", "output.recording=false")
    assert expected in line
    assert "numbers.npz" in line
    assert "hydra.run.dir=FOLDER" in line
