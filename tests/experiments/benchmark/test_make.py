"""The captures of a split: shot by whatever launcher, the same; killed and resumed, the same; truth apart."""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from experiments.benchmark.fingerprint import compared, differences, fingerprint, kind, read_manifest, write_manifest
from experiments.benchmark.make import described
from pzcap.io.capture import read_capture
from pzcap.scoring.command import main as pzcap_score
from pzcap.scoring.truth_files import read_truth
from pzcap.types import PzcapError
from tests.scenes.captures import CAPTURES
from tests.scenes.sweeps import ENVIRONMENT, ROOT

pytestmark = pytest.mark.heavy

RELEASE = {
    "release": "tiny",
    "common": [
        "shoot.motion=pedestrian", "shoot.motion_frames=8", "shoot.width=320", "shoot.height=240", "shoot.sweep_deg=80",
        "shoot.zoom_frames=8", "shoot.optics.zoom_max=1.8", "shoot.gym.texture_px_per_m=80",
        "shoot.detector.enabled=true", f"output.captures={CAPTURES}",
    ],
    "axes": {
        "noise": {"2": [], "8": ["shoot.sensor.read_noise=8"]},
        "keyframes": {"all": [], "0": ["without_keyframes=true"]},
    },
    "base": {"noise": "2", "keyframes": "all"},
    "splits": {
        "open": {"gives_truth": True, "captures": [{"seed": 0}, {"seed": 0, "noise": "8", "keyframes": "0"}]},
        "kept": {"captures": [{"seed": 0}]},
    },
}  # fmt: skip
PLAIN, NOISY = "capture_0", "capture_0_noise-8_keyframes-0"


def command(folder: Path, split: str, *more: str) -> list[str]:
    path = folder / "tiny.yaml"
    path.write_text(yaml.safe_dump(RELEASE, sort_keys=False))
    where = [f"release={path}", f"split={split}", f"out={folder / 'out'}"]
    return [sys.executable, "-m", "experiments.benchmark", "make", *where, *more]


def made(folder: Path, split: str, *more: str) -> Path:
    done = subprocess.run(command(folder, split, *more), capture_output=True, text=True, cwd=ROOT, env=ENVIRONMENT)
    assert done.returncode == 0, done.stderr
    return folder / "out" / "tiny" / split


@pytest.fixture(scope="module")
def split(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made(tmp_path_factory.mktemp("make"), "open")


@pytest.mark.slow
def test_footage_truth_and_gifts_lie_apart(split: Path) -> None:
    assert sorted(path.name for path in (split / "footage").iterdir()) == [PLAIN, NOISY]
    names = {path.name for path in (split / "footage").rglob("*")}
    assert not any("truth" in name or "mask" in name for name in names)
    capture = read_capture(split / "footage" / PLAIN)
    assert capture.name == PLAIN
    assert capture.keyframe_poses
    truth = read_truth(split / "truth" / PLAIN)
    assert truth.keyframe.sum() == len(capture.keyframe_poses)
    assert truth.cameras[0].pan_bound_rad is not None
    assert truth.cameras[0].pan_bound_rad.valid.all()
    mask = cv2.imread(str(split / "given" / PLAIN / "masks" / "1" / "000003.png"), cv2.IMREAD_GRAYSCALE)
    assert mask is not None
    assert set(np.unique(mask)) == {0, 255}
    assert (split / "given" / PLAIN / "panorama" / "reconstruction.json").is_file()
    assert described(split)["captures"][NOISY] == {"seed": 0, "noise": "8", "keyframes": "0"}


@pytest.mark.slow
def test_a_capture_without_keyframes_gives_none(split: Path) -> None:
    folder = split / "footage" / NOISY
    assert not read_capture(folder).keyframe_poses
    assert not list(folder.glob("keyframes*"))
    assert not read_truth(split / "truth" / NOISY).keyframe.any()


@pytest.mark.slow
def test_true_cameras_that_are_given_are_results_of_a_perfect_method(split: Path, tmp_path: Path) -> None:
    header = json.loads((split / "truth" / PLAIN / "truth.json").read_text())
    content = {"format": "pzcap-results", "version": 1, "method": "given", "frames": 8, "cameras": header["cameras"]}
    (tmp_path / "results.json").write_text(json.dumps(content))
    (tmp_path / "cameras.csv").write_bytes((split / "given" / PLAIN / "cameras.csv").read_bytes())
    out = tmp_path / "metrics.json"
    assert pzcap_score([str(tmp_path), str(split / "truth" / PLAIN), "--json", str(out)]) == 0
    found = json.loads(out.read_text())
    assert found["panzoom.pan.max"]["value"] == found["panzoom.reprojection.rms"]["value"] == 0.0


@pytest.mark.slow
def test_the_truth_of_a_split_that_is_kept_is_not_given(tmp_path: Path) -> None:
    folder = made(tmp_path, "kept")
    assert [path.name for path in (folder / "given" / PLAIN).iterdir()] == ["panorama"]
    assert (folder / "truth" / PLAIN / "truth.json").is_file()


@pytest.mark.slow
@pytest.mark.parametrize("launcher", ["joblib", "ray"])
def test_by_any_launcher_the_footage_is_the_same(launcher: str, split: Path, tmp_path: Path) -> None:
    pytest.importorskip(launcher)
    other = made(tmp_path, "open", f"hydra/launcher={launcher}", f"output.captures={tmp_path / 'captures'}")
    assert read_manifest(other / "manifest.json") == read_manifest(split / "manifest.json")
    for name in (PLAIN, NOISY):
        for file in ("cameras.csv", "joints.csv", "points.csv"):
            assert (other / "truth" / name / file).read_bytes() == (split / "truth" / name / file).read_bytes()


@pytest.mark.slow
def test_killed_it_goes_on_where_it_was(split: Path, tmp_path: Path) -> None:
    anew = f"output.captures={tmp_path / 'captures'}"  # filmed, and not found there
    line = command(tmp_path, "open", anew)
    process = subprocess.Popen(line, stderr=subprocess.DEVNULL, cwd=ROOT, env=ENVIRONMENT, start_new_session=True)
    jobs = tmp_path / "out" / "tiny" / "open" / "jobs"
    deadline = time.monotonic() + 300.0
    while not (jobs / PLAIN / "job.json").exists() and time.monotonic() < deadline:
        assert process.poll() is None
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    assert not (jobs.parent / "manifest.json").exists()
    began = (jobs / PLAIN / "job.json").stat().st_mtime_ns
    folder = made(tmp_path, "open", anew)
    assert (jobs / PLAIN / "job.json").stat().st_mtime_ns == began  # was not done again
    assert read_manifest(folder / "manifest.json") == read_manifest(split / "manifest.json")
    assert not list(jobs.glob(".*.partial"))


@pytest.mark.slow
def test_frozen_footage_is_told_by_hash_here_and_by_tolerance_elsewhere(split: Path, tmp_path: Path) -> None:
    found = {name: fingerprint(split / "footage" / name) for name in (PLAIN, NOISY)}
    frozen = tmp_path / "frozen.json"
    assert compared(found, frozen) == ("not frozen yet: nothing to compare with", [])
    write_manifest(frozen, "tiny", "open", found)
    assert compared(found, frozen) == ("by hash: a machine of the same kind", [])

    content: dict[str, Any] = json.loads(frozen.read_text())
    content["captures"][PLAIN]["files"]["camera1/sweep.mp4"] = "0" * 64
    frozen.write_text(json.dumps(content))
    _, lines = compared(found, frozen)
    assert lines == [f"{PLAIN}/camera1/sweep.mp4: another content ({found[PLAIN].files['camera1/sweep.mp4'][:12]}, "
                     "frozen 000000000000)"]  # fmt: skip
    content["kind"]["cpu"] = "another"
    frozen.write_text(json.dumps(content))
    assert compared(found, frozen) == ("by tolerance: a machine of another kind", [])
    # the other capture's frames are noisier, of the same view: their blocks' means tell little; another motion's do
    content["captures"][PLAIN]["blocks"]["camera1/motion.mp4 0"][5] += 1.2
    content["captures"][PLAIN]["frames"]["camera2/motion.mp4"] += 1
    frozen.write_text(json.dumps(content))
    _, lines = compared(found, frozen)
    count = found[PLAIN].frames["camera2/motion.mp4"]
    assert f"{PLAIN}/camera2/motion.mp4: {count} frames where the release has {count + 1}" in lines
    assert any("camera1/motion.mp4 0: differs by 1.2 grey levels" in line for line in lines)
    assert len(lines) == 2
    some = {PLAIN: found[PLAIN]}
    assert f"{NOISY}: not made" in compared(some, frozen)[1]


def test_a_file_more_or_less_is_named() -> None:
    from experiments.benchmark.fingerprint import Fingerprint

    one = Fingerprint({"a": "1", "b": "2"}, {}, {})
    two = dataclasses.replace(one, files={"a": "1", "c": "3"})
    assert list(differences(two, one, True)) == ["b: missing", "c: is not of the release"]
    assert list(differences(one, one, True)) == []


def test_the_kind_of_machine_names_what_bytes_depend_on() -> None:
    assert set(kind()) == {"cpu", "versions"}
    assert set(kind()["versions"]) == {"numpy", "opencv-python-headless", "av", "mujoco"}


def test_what_was_never_made_says_how(tmp_path: Path) -> None:
    with pytest.raises(PzcapError, match=r"make it first, python -m experiments.benchmark make split=mini"):
        described(tmp_path / "mini")
    (tmp_path / "manifest.json").write_text("{}")
    with pytest.raises(PzcapError, match="no readable manifest"):
        read_manifest(tmp_path / "manifest.json")
