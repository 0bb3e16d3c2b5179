"""The programs themselves read what is written for them: aniposelib, Pose2Sim, OpenSim, Blender, each in an environment
of its own, since they want other versions of what pzcap is made of. `make test-clients` installs them and runs this."""

from __future__ import annotations

import json
import os
import stat
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from experiments.comparisons.fixed_tools.clients import HERE as OURS
from experiments.comparisons.fixed_tools.clients import environments, installed, python, run
from pzcap.export import formats
from pzcap.export.take import Take
from pzcap.geometry.camera import project
from pzcap.types import ENDS, JOINTS, SEGMENTS, Array
from tests.scenes import exported, fabricated, seen_keypoints
from tests.scenes.exported import FRAMES, GAP, LOST, RATE
from tests.scenes.seen_keypoints import OWN, ROWS

pytestmark = pytest.mark.slow

HERE = Path(__file__).parent
VALID = [frame for frame in range(FRAMES) if frame != GAP]
PIXELS = 0.02
TO_BLENDER = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""World to Blender's, of what faces +z with y up: Blender lets it face -y."""


def read(client: str, script: Path, *arguments: object, folder: Path) -> str:
    """What a script says in the environment of a client."""
    assert installed(client), f"{environments() / client} is missing; say make test-clients"
    return run(client, script, *arguments, folder=folder)


def test_aniposelib(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its own triangulation of the keypoints that were carried over, to what the moving projection centre leaves."""
    formats.write(seen_keypoints.take(monkeypatch), "aniposelib", tmp_path)
    found = json.loads(read("aniposelib", OURS / "run_aniposelib.py", tmp_path, folder=tmp_path).splitlines()[-1])
    assert found["names"] == list(exported.NAMES)
    for frame, places in enumerate(found["places"]):
        np.testing.assert_allclose(np.array(places)[ROWS], exported.joints(frame)[OWN], atol=0.004)


def test_pose2sim(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its own triangulation and filtering of the project as it was written, without a setting changed."""
    project_folder = tmp_path / "Take"
    formats.write(seen_keypoints.take(monkeypatch), "pose2sim", project_folder)
    read("pose2sim", OURS / "run_pose2sim.py", project_folder, folder=tmp_path)
    [path] = [path for path in (project_folder / "pose-3d").glob("*.trc") if "filt" not in path.stem]
    names = [cell for cell in path.read_text().split("\n")[3].split("\t") if cell][2:]
    table = pd.read_csv(path, sep="\t", skiprows=5, header=None).to_numpy(float)
    np.testing.assert_allclose(table[:, 1], np.arange(FRAMES) / float(RATE), atol=1e-4)
    for name, joint in (("RKnee", 14), ("LAnkle", 12), ("LShoulder", 4), ("RWrist", 9)):
        column = 2 + 3 * names.index(name)
        for frame in range(FRAMES):
            x, y, z = exported.joints(frame)[joint]
            np.testing.assert_allclose(table[frame, column : column + 3], [y, z, x], atol=0.004, err_msg=name)


def test_opensim(tmp_path: Path) -> None:
    path = next(path for path in formats.write(exported.take(), "trc", tmp_path) if path.suffix == ".trc")
    found = json.loads(read("pose2sim", HERE / "read_opensim.py", path, folder=tmp_path).splitlines()[-1])
    assert found["units"] == "m"
    assert len(found["names"]) == 23
    np.testing.assert_allclose(found["times"], np.arange(FRAMES) / float(RATE), atol=1e-8)
    places = np.array(found["places"], float)
    assert np.isnan(places[GAP]).all()
    for frame in VALID:
        forward, left, up = exported.joints(frame).T
        np.testing.assert_allclose(places[frame, :16], np.column_stack([forward, up, -left]), atol=1e-6)


def test_opensim_moves_the_model(tmp_path: Path) -> None:
    """Forward kinematics by OpenSim itself, of the model and the motion as they were written."""
    files = {path.suffix: path for path in formats.write(exported.take(), "mot", tmp_path)}
    said = read("pose2sim", HERE / "read_opensim_motion.py", files[".osim"], files[".mot"], folder=tmp_path)
    found = json.loads(said.splitlines()[-1])
    assert found["names"] == [*JOINTS, *ENDS]
    assert 40.0 < found["mass"] < 130.0
    np.testing.assert_allclose(found["times"], np.array(VALID) / float(RATE), atol=1e-6)
    for places, frame in zip(np.array(found["places"]), VALID, strict=True):
        forward, left, up = np.vstack([exported.joints(frame), exported.ends(frame)]).T
        np.testing.assert_allclose(places, np.column_stack([forward, up, -left]), atol=1e-6)


def blender(path: Path, turn: Array, rate: float, folder: Path) -> dict[str, Any]:
    points = folder / "points.json"
    points.write_text(json.dumps([(exported.joints(frame) @ turn.T).tolist() for frame in range(FRAMES)]))
    size = fabricated.WIDTH, fabricated.HEIGHT
    said = read("bpy", HERE / "read_blender.py", path, points, rate, *size, folder=folder)
    found: dict[str, Any] = json.loads(said.splitlines()[-1])
    assert found["rate"] == pytest.approx(rate, rel=1e-6)
    return found


def whole_rate() -> Take:
    """Blender's importers of glTF and FBX count frames by the whole rate."""
    return Take(replace(exported.reconstruction(0.0), frame_rate=Fraction(30)))


def assert_bones(found: dict[str, Any], turn: Array) -> None:
    for frame in VALID:
        bones = np.array([found["bones"][frame][segment] for segment in SEGMENTS])
        np.testing.assert_allclose(bones, exported.joints(frame) @ turn.T, atol=1e-5)


def assert_cameras(found: dict[str, Any], *, principal_point: bool) -> None:
    """By Blender's own projection. Without ``principal_point`` the format has none: what it makes is taken away."""
    for number, file in enumerate(("Sud_1", "b_c_2", "b_c_3", "4")):
        for frame in range(FRAMES):
            if (number, frame) == (0, LOST):
                continue
            camera = exported.true_camera(number, frame, 0.0)
            expected = project(camera, exported.joints(frame))[0]
            if not principal_point:
                expected = expected - camera.principal_px + [(camera.width - 1) / 2, (camera.height - 1) / 2]
            pixels = np.array(found["pixels"][frame][f"camera_{file}"]) - 0.5
            np.testing.assert_allclose(pixels, expected, atol=PIXELS)


def test_blender_reads_bvh(tmp_path: Path) -> None:
    path = next(path for path in formats.write(exported.take(), "bvh", tmp_path) if path.suffix == ".bvh")
    assert_bones(blender(path, TO_BLENDER, float(RATE), tmp_path), TO_BLENDER)


def test_blender_reads_usd(tmp_path: Path) -> None:
    path = next(path for path in formats.write(exported.take(0.0), "usd", tmp_path) if path.suffix == ".usda")
    found = blender(path, np.eye(3), float(RATE), tmp_path)
    assert_bones(found, np.eye(3))
    assert_cameras(found, principal_point=True)


def test_blender_reads_gltf(tmp_path: Path) -> None:
    path = next(path for path in formats.write(whole_rate(), "gltf", tmp_path) if path.suffix == ".glb")
    found = blender(path, TO_BLENDER, 30.0, tmp_path)
    assert_bones(found, TO_BLENDER)
    assert_cameras(found, principal_point=False)


def test_blender_writes_fbx_and_reads_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Through bpy in the place of the program, started as the program is."""
    program = tmp_path / "bin" / "blender"
    program.parent.mkdir()
    line = "import runpy, sys\nrunpy.run_path(sys.argv[sys.argv.index('--python') + 1], run_name='__main__')\n"
    program.write_text(f"#!{python('bpy')}\n{line}")
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", str(program.parent), prepend=os.pathsep)
    path = next(path for path in formats.write(whole_rate(), "fbx", tmp_path) if path.suffix == ".fbx")
    assert_bones(blender(path, np.eye(3), 30.0, tmp_path), np.eye(3))
