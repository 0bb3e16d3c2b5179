"""Whatever a file holds: a result or one line, within 10 s and 1 GiB, and nothing written but where it should be.

`make fuzz` tries 10,000 files, `make test` a few of each kind. What is found comes back as an example that can be
repeated (hypothesis prints it).
"""

from __future__ import annotations

import faulthandler
import json
import os
import resource
import shutil
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from experiments import recordings
from experiments.config import build, default_tree
from experiments.report import bookmarks
from experiments.studies import page
from pzcap.calibration import reference_camera
from pzcap.calibration.settings import PanZoomConfig
from pzcap.io import results
from pzcap.io.capture import frame_sets, read_capture, read_image
from pzcap.io.video import VideoReader
from pzcap.starting_poses import body_to_track
from pzcap.tracking.settings import TrackingConfig
from pzcap.types import SEGMENTS, PzcapError
from sim import motion, truth
from sim.cameras.optics import OpticsConfig, build_rig
from sim.cameras.trajectories import read_trajectories
from sim.capture_writer import write_video
from sim.people.anthropometry import draw_measurements
from tests.fuzz.mutations import (
    TEXTS,
    changed_arrays,
    changed_boxes,
    changed_json,
    changed_tree,
    changed_words,
    damaged_bytes,
)
from tests.scenes import fabricated
from tests.scenes.bvh_files import Style, write_bvh
from tests.scenes.fabricated_truth import truth_of
from tests.scenes.recorders import encode, pictures
from tests.scenes.studies import NOISE, grid, record

WANTED = int(os.environ.get("PZCAP_FUZZ", "0"))
"""Inputs to try in all; 0: FEW."""
FEW = 6
SECONDS = 10.0
MIB = 1024.0
MUTATE: dict[str, Callable[[bytes], st.SearchStrategy[bytes]]] = {
    ".json": changed_json,
    ".npz": lambda content: st.one_of(changed_arrays(content), damaged_bytes(content)),
    ".mp4": lambda content: st.one_of(changed_boxes(content), damaged_bytes(content)),
    ".bvh": lambda content: st.one_of(changed_words(content), damaged_bytes(content)),
    ".csv": lambda content: st.one_of(changed_words(content), damaged_bytes(content)),
}
"""What is done to a file of this ending; to all others, what is done to bytes."""


@dataclass(frozen=True)
class Target:
    """A folder of sound files, who reads it, and which of its files are damaged."""

    make: Callable[[Path], None]
    read: Callable[[Path], object]
    files: tuple[str, ...]
    share: float  # of all inputs


# --------------------------------------------------------------------------------------------------------------
# Captures


def make_capture(folder: Path) -> None:
    """Two cameras of 64 x 48 pixels, every kind of paper, and keypoints of every kind."""
    for name in ("camera1", "camera2"):
        (folder / name).mkdir()
        for kind in ("sweep", "zoom"):
            write_video(folder / name / f"{kind}.mp4", pictures(4), Fraction(5), crf=12)
        cv2.imwrite(str(folder / name / "reference.png"), pictures(1)[0])
    cv2.imwrite(str(folder / "camera2" / "reference.jpg"), pictures(1)[0])
    encode(
        folder / "camera1" / "motion.mp4", pictures(8), Fraction(30), timecode="10:00:00:00",
        options={"x264-params": "bframes=2"},
    )  # fmt: skip
    write_video(folder / "camera2" / "motion.mkv", pictures(8), Fraction(30), crf=12, timecode="10:00:00:02")
    person = [10.0, 20.0, 0.5] * 25
    (folder / "keypoints").mkdir()
    for k in range(3):
        (folder / "keypoints" / f"motion_{k}_keypoints.json").write_text(
            json.dumps({"people": [{"pose_keypoints_2d": person}]})
        )
    instance = {"keypoints": [[10.0, 20.0]] * 17, "keypoint_scores": [0.5] * 17}
    (folder / "mmpose.json").write_text(json.dumps({"instance_info": [{"frame_id": 0, "instances": [instance]}]}))
    whole = fabricated.reconstruction()
    assert whole.motion is not None
    subject = draw_measurements(np.random.default_rng(0))
    (folder / "subject.json").write_text(json.dumps({"measurements_m": subject, "sigma_m": 0.005}))
    corners = [[[0.0, y, z] for y, z in ((0, 1.5), (0.5, 1.5), (0.5, 1.0), (0, 1.0))] for _ in range(4)]
    markers = [{"id": k, "corners_m": [[x + 0.6 * k, y + (k % 2), z] for x, y, z in c]} for k, c in enumerate(corners)]
    (folder / "object.json").write_text(
        json.dumps({"dictionary": "DICT_4X4_50", "markers": markers, "wireframe_m": [[[0, 0, 0], [1, 0, 0]]]})
    )
    poses = [
        {
            "timecode": f"10:00:00:0{k}", "root_position_m": [0.0, 0.1 * k, 0.9],
            "rotations_wxyz": {segment: [1.0, 0.0, 0.0, 0.0] for segment in SEGMENTS},
        }
        for k in (3, 6)
    ]  # fmt: skip
    (folder / "keyframes.json").write_text(json.dumps(poses))
    mark = {"camera": "2", "video": "motion", "frame": 3, "px": [12.5, 20.0]}
    side = {"name": "side", "length_m": 12.0, "sigma_m": 0.01, "from": [mark], "to": [{**mark, "video": "sweep"}]}
    (folder / "lengths.json").write_text(json.dumps([side]))
    cameras = [
        {
            "name": "1", "reference": "camera1/reference.png", "sweep": "camera1/sweep.mp4", "zoom": "camera1/zoom.mp4",
            "motion": "camera1/motion.mp4", "keypoints": "keypoints",
        },
        {
            "name": "2", "reference": "camera2/reference.jpg", "sweep": "camera2/sweep.mp4", "zoom": None,
            "motion": "camera2/motion.mkv", "keypoints": "mmpose.json", "keypoints_from": 0,
        },
    ]  # fmt: skip
    manifest = {
        "format": "pzcap-capture", "version": 1, "name": "a take", "frame_rate": "30/1", "full_turn": True,
        "cameras": cameras, "object": "object.json", "subject": "subject.json", "keyframes": "keyframes.json",
        "lengths": "lengths.json",
    }  # fmt: skip
    (folder / "capture.json").write_text(json.dumps(manifest))


def read_a_capture(folder: Path) -> None:
    """All that happens before the first camera is calibrated, and every frame decoded."""
    capture = read_capture(folder)
    sets = frame_sets(capture)
    for frames in sets:
        assert len(frames.images) == len(capture.cameras)
    body_to_track(capture, sets, TrackingConfig(), [])
    for files in capture.cameras:
        for path in (files.sweep, files.zoom):
            if path is not None:
                list(VideoReader(path))


def read_a_shot(folder: Path) -> None:
    """The calibration object in a picture that shows it."""
    capture = read_capture(folder)
    for files in capture.cameras:
        if files.reference is not None and capture.calibration_object is not None:
            image = read_image(files.reference)
            reference_camera.calibrate(image, capture.calibration_object, PanZoomConfig().reference)


CAPTURE_FILES = (
    "capture.json", "object.json", "subject.json", "keyframes.json", "lengths.json", "mmpose.json",
    "keypoints/motion_1_keypoints.json",
    "camera1/reference.png", "camera2/reference.jpg", "camera1/sweep.mp4", "camera1/zoom.mp4", "camera1/motion.mp4",
    "camera2/motion.mkv",
)  # fmt: skip


# --------------------------------------------------------------------------------------------------------------
# What runs leave


def make_truth(folder: Path) -> None:
    truth.save(truth_of(fabricated.reconstruction()), folder)


def make_reconstruction(folder: Path) -> None:
    results.save(fabricated.reconstruction(), folder)


def make_study(folder: Path) -> None:
    for place in grid(folder, {NOISE: (0, 1), "seed": (0, 1)}):
        place.rename(folder / f"job{place.name[-1]}{place.name.count('=1')}")
    (folder / "failed").mkdir()
    (folder / "failed" / "failed.txt").write_text("memory ran out\n")


def read_a_study(folder: Path) -> None:
    places = sorted(path for path in folder.iterdir() if path.is_dir())
    page.write_study(folder, places)


def make_recording(folder: Path) -> None:
    record(folder / "run" / "recording.rrd", 1.0, 0)


def read_a_recording(folder: Path) -> None:
    path = folder / "run" / "recording.rrd"
    recordings.recording_id(path)
    bookmarks.worst(bookmarks.errors(path))


# --------------------------------------------------------------------------------------------------------------
# Motions and hands of a user's own


def make_own(folder: Path) -> None:
    rng = np.random.default_rng(3)
    measurements = draw_measurements(rng)
    clip = motion.make("pedestrian", measurements, rng)
    write_bvh(folder / "own.bvh", clip, measurements, Style(rate=10.0))
    rows = [f"{camera},{frame},{camera + frame / 4},{900 + 7 * frame}" for camera in (1, 2) for frame in range(4)]
    (folder / "hands.csv").write_text("\n".join(["camera,frame,pan_deg,focal_px", *rows]))


def read_own(folder: Path) -> None:
    motion.make(str(folder / "own.bvh"), draw_measurements(np.random.default_rng(0)), np.random.default_rng(0))


def read_hands(folder: Path) -> None:
    rigs = {name: build_rig(c, 640, 480, OpticsConfig(), np.random.default_rng(c)) for c, name in enumerate(("1", "2"))}
    for trajectory in read_trajectories(folder / "hands.csv", rigs, 30, 0.1):
        assert np.isfinite(trajectory.at(0.05)).all()


TARGETS = {
    "capture": Target(make_capture, read_a_capture, CAPTURE_FILES, 0.36),
    "reconstruction": Target(
        make_reconstruction, results.load, ("reconstruction.json", "reconstruction.npz", "panorama2.png"), 0.06
    ),
    "truth": Target(make_truth, truth.load, ("truth.json", "truth.npz", "masks.npz"), 0.14),
    "study": Target(make_study, read_a_study, ("job00/metrics.json", "job00/job.json", "failed/failed.txt"), 0.06),
    "recording": Target(make_recording, read_a_recording, ("run/recording.rrd",), 0.08),
    "motion": Target(make_own, read_own, ("own.bvh",), 0.07),
    "hands": Target(make_own, read_hands, ("hands.csv",), 0.08),
}


# --------------------------------------------------------------------------------------------------------------
# The trial


def examples(share: float) -> settings:
    """Settings of a test that has this share of all inputs."""
    return settings(
        max_examples=max(1, round(share * (WANTED or FEW))), deadline=None,
        derandomize=not WANTED, database=None, suppress_health_check=list(HealthCheck),
    )  # fmt: skip


_watched: list[Path] = []
_astray: list[str] = []
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_APPEND


def _audit(event: str, arguments: tuple[Any, ...]) -> None:
    """Note what is written outside of the folder that is watched."""
    if not _watched or event not in ("open", "os.remove", "os.rename", "os.mkdir", "os.rmdir", "os.link", "os.symlink"):
        return
    if event == "open" and not (isinstance(arguments[2], int) and arguments[2] & _WRITING):
        return
    within = arguments[-1] if event in ("os.remove", "os.mkdir", "os.rmdir") else -1  # a folder that is open
    if isinstance(within, int) and within >= 0:
        arguments = (Path(f"/proc/self/fd/{within}").readlink() / os.fsdecode(arguments[0]),)
    for path in arguments[:1] if event in ("open", "os.remove", "os.mkdir", "os.rmdir") else arguments[:2]:
        if isinstance(path, str | bytes | os.PathLike):
            place = Path(os.fsdecode(path)).absolute()
            if not place.is_relative_to(_watched[-1]) and place != Path(os.devnull):
                _astray.append(f"{event} {place}")


@pytest.fixture(scope="module", autouse=True)
def audited() -> None:
    sys.addaudithook(_audit)


_outcomes: Counter[tuple[str, str]] = Counter()


@pytest.fixture(autouse=True)
def counted(pytestconfig: pytest.Config) -> Iterator[None]:
    """Counts of inputs by kind and outcome, printed after a test where many were asked for."""
    _outcomes.clear()
    yield
    capture = pytestconfig.pluginmanager.get_plugin("capturemanager")
    if WANTED and capture is not None:
        with capture.global_and_fixture_disabled():
            for changed in sorted({changed for changed, _ in _outcomes}):
                found, said = _outcomes[changed, "a result"], _outcomes[changed, "a line"]
                print(f"\n{found + said:6} {changed}: {found} results, {said} lines", end="", flush=True)


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """The sound files of a target, made once."""
    made: dict[str, Path] = {}

    def folder(name: str) -> Path:
        if name not in made:
            made[name] = tmp_path_factory.mktemp(name)
            TARGETS[name].make(made[name])
            TARGETS[name].read(made[name])
        return made[name]

    return folder


def tried(read: Callable[[Path], object], folder: Path, changed: str) -> None:
    """A result or one line, in little time and memory, and nothing written elsewhere.

    ``changed``: what is not as it should be, by which `counted` counts.
    """
    said = "a result"
    faulthandler.dump_traceback_later(6 * SECONDS, exit=True)
    # of CPU, since others may work here, too; who waits for ever is ended by the clock
    before, begun = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    _watched.append(folder)
    _astray.clear()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            read(folder)
    except PzcapError as error:
        said = str(error)
    finally:
        _watched.clear()
        faulthandler.cancel_dump_traceback_later()
    _outcomes[changed, "a result" if said == "a result" else "a line"] += 1
    assert said.strip()
    assert "\n" not in said
    assert time.process_time() - begun < SECONDS
    assert (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024 < MIB
    assert not _astray


def linked(sound_folder: Path, folder: Path, damaged: str, content: bytes) -> None:
    """The sound files, and one that is damaged in its place."""
    shutil.copytree(sound_folder, folder, copy_function=os.link)
    (folder / damaged).unlink()
    (folder / damaged).write_bytes(content)


@pytest.mark.parametrize("name", TARGETS)
def test_damaged_files(name: str, sound: Callable[[str], Path]) -> None:
    target = TARGETS[name]
    contents = {file: (sound(name) / file).read_bytes() for file in target.files}

    @examples(target.share)
    @given(data=st.data())
    def trial(data: st.DataObject) -> None:
        file = data.draw(st.sampled_from(target.files))
        mutate = MUTATE.get(Path(file).suffix, damaged_bytes)
        content = data.draw(mutate(contents[file]))
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place) / "input"
            linked(sound(name), folder, file, content)
            tried(target.read, folder, file)

    trial()


@pytest.fixture(scope="module")
def shown(small_capture: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A capture whose reference images show the object; without its videos, which need more time."""
    folder = tmp_path_factory.mktemp("shown")
    whole = json.loads((small_capture / "capture" / "capture.json").read_text())
    for camera in whole["cameras"]:
        (folder / camera["reference"]).parent.mkdir(parents=True)
        shutil.copy(small_capture / "capture" / camera["reference"], folder / camera["reference"])
        camera.update(sweep=None, zoom=None, motion=None)
    whole["cameras"] = whole["cameras"][:1]
    whole.update(subject=None, keyframes=None)
    shutil.copy(small_capture / "capture" / "object.json", folder / "object.json")
    (folder / "capture.json").write_text(json.dumps(whole))
    return folder


def test_objects_of_any_shape(shown: Path) -> None:
    """What object.json says may pass every check, and be an object that nobody can see so."""
    content = (shown / "object.json").read_bytes()
    read_a_shot(shown)

    @examples(0.04)
    @given(content=changed_json(content))
    def trial(content: bytes) -> None:
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place) / "input"
            linked(shown, folder, "object.json", content)
            tried(read_a_shot, folder, "object")

    trial()


@st.composite
def clocks(draw: st.DrawFn) -> dict[str, Any]:
    """How a recorder may write a motion: rate, clock, gaps, order, size."""
    count = draw(st.integers(1, 9))
    gaps = draw(st.lists(st.sampled_from((1, 1, 1, 2, 5, 400, 10_000)), min_size=count, max_size=count))
    rate = draw(st.sampled_from(("30", "25", "30000/1001", "24000/1001", "60000/1001", "120", "1", "999", "1/7")))
    usual = st.sampled_from(("10:00:00:00", "23:59:59:00"))  # most others are refused, and nothing behind that is tried
    return {
        "rate": rate,
        "timecode": draw(
            st.one_of(
                usual, usual, st.none(), st.sampled_from((*TEXTS[:-1], "23:59:59:29", "10:01:00;02", "10:00:00:105"))
            )
        ),
        "indices": [int(index) for index in np.cumsum(gaps)],
        "size": draw(st.sampled_from(((64, 48), (32, 32), (66, 50), (4096, 16)))),
        "ending": draw(st.sampled_from(("mp4", "mkv", "mov"))),
        "said": draw(st.one_of(st.just(rate), st.sampled_from(("30/1", "30000/1001", "25", "29.97", "1", "1000/1")))),
    }


def test_recordings_of_any_clock() -> None:
    @examples(0.06)
    @given(how=clocks())
    def trial(how: dict[str, Any]) -> None:
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place)
            path = folder / f"motion.{how['ending']}"
            try:
                write_video(
                    path, pictures(len(how["indices"]), *how["size"]), Fraction(how["rate"]), crf=30,
                    timecode=how["timecode"], indices=how["indices"],
                )  # fmt: skip
            except (PzcapError, ValueError, UnicodeError, av.error.FFmpegError):
                return  # FFmpeg writes no such video
            manifest = {
                "format": "pzcap-capture", "version": 1, "name": "a take", "frame_rate": how["said"], "full_turn": True,
                "cameras": [{"name": "1", "motion": path.name}],
            }  # fmt: skip
            (folder / "capture.json").write_text(json.dumps(manifest))
            tried(read_a_capture, folder, how["ending"])

    trial()


def test_settings_of_any_value(tmp_path: Path) -> None:
    tree = default_tree()

    @examples(0.05)
    @given(changed=changed_tree(tree))
    def trial(changed: Any) -> None:
        tried(lambda _: build(changed), tmp_path, "settings")

    trial()
