"""Bodies come back through other people's readers: units, axes, time, gaps and bones."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import bvhio
import ezc3d
import numpy as np
import pandas as pd
import pytest
from pyglm import glm

from pzcap.export import formats
from pzcap.export.take import Take
from pzcap.types import ENDS, JOINTS, SEGMENTS, Array, PzcapError
from tests.scenes import exported
from tests.scenes.exported import FRAMES, GAP, RATE

VALID = [frame for frame in range(FRAMES) if frame != GAP]


def written(name: str, folder: Path, suffix: str) -> Path:
    return next(path for path in formats.write(exported.take(), name, folder) if path.suffix == suffix)


def test_trc(tmp_path: Path) -> None:
    """Read as Pose2Sim reads it, by pandas, and by the rules of OpenSim's reader for what pandas does not look at."""
    path = written("trc", tmp_path, ".trc")
    lines = path.read_text(encoding="utf-8").split("\n")
    keys, values = lines[1].split("\t"), lines[2].split("\t")
    header = dict(zip(keys, values, strict=True))
    assert lines[0].split("\t")[0] == "PathFileType"
    assert (header["NumFrames"], header["NumMarkers"], header["Units"]) == (str(FRAMES), "23", "m")
    assert float(header["DataRate"]) == pytest.approx(float(RATE), rel=1e-7)
    names = [cell for cell in lines[3].split("\t") if cell][2:]
    assert names == [*JOINTS, *ENDS]
    table = pd.read_csv(path, sep="\t", skiprows=4)
    assert len(table) == FRAMES
    numbers = pd.read_csv(path, sep="\t", skiprows=5, header=None).to_numpy(float)
    assert numbers.shape == (FRAMES, 2 + 3 * 23)
    np.testing.assert_allclose(numbers[:, 1], np.arange(FRAMES) / float(RATE), atol=1e-8)
    places = numbers[:, 2:].reshape(FRAMES, 23, 3)
    assert np.isnan(places[GAP]).all()
    for frame in VALID:  # OpenSim: x forward, y up, z to the right
        forward, left, up = np.vstack([exported.joints(frame), exported.ends(frame)]).T
        np.testing.assert_allclose(places[frame], np.column_stack([forward, up, -left]), atol=1e-6)


def test_c3d(tmp_path: Path) -> None:
    file = ezc3d.c3d(str(written("c3d", tmp_path, ".c3d")))
    point = file["parameters"]["POINT"]
    assert point["UNITS"]["value"] == ["mm"]
    assert point["LABELS"]["value"] == [*JOINTS, *ENDS]
    assert point["RATE"]["value"][0] == pytest.approx(float(RATE), rel=1e-6)
    assert (point["X_SCREEN"]["value"], point["Y_SCREEN"]["value"]) == (["+X"], ["+Z"])
    points, residuals = file["data"]["points"], file["data"]["meta_points"]["residuals"]
    assert points.shape == (4, 23, FRAMES)
    assert (residuals[0, :, GAP] < 0).all()
    assert np.isnan(points[:3, :, GAP]).all()
    own, motion = file["parameters"]["PZCAP"], exported.reconstruction().motion
    assert motion is not None
    assert own["TIMECODE"]["value"] == ["01:00:00:05"]
    for frame in VALID:
        assert (residuals[0, :, frame] >= 0).all()
        places = np.vstack([exported.joints(frame), exported.ends(frame)])
        np.testing.assert_allclose(points[:3, :, frame].T, 1000.0 * places, atol=1e-3)
        np.testing.assert_allclose(own["SIGMA_MM"]["value"][:, frame], 1000.0 * motion.sigma_m[frame], rtol=1e-5)


def test_bvh(tmp_path: Path) -> None:
    path = written("bvh", tmp_path, ".bvh")
    container = bvhio.readAsBvh(str(path))
    assert container.FrameCount == FRAMES
    assert container.FrameTime == pytest.approx(float(1 / RATE), rel=1e-8)
    root = bvhio.readAsHierarchy(str(path))

    def read(frame: int) -> dict[str, Array]:
        root.loadPose(frame)
        return {joint.Name: np.array([*joint.PositionWorld]) for joint, _, _ in root.layout()}

    for frame in VALID:
        found = read(frame)
        for name, (forward, left, up) in zip(SEGMENTS, exported.joints(frame), strict=True):
            np.testing.assert_allclose(found[name], 100.0 * np.array([left, up, forward]), atol=2e-3, err_msg=name)
    before, gap = read(GAP - 1), read(GAP)
    for name in SEGMENTS:
        np.testing.assert_array_equal(before[name], gap[name])


def test_the_ends_of_bvh_turn_with_their_bones(tmp_path: Path) -> None:
    """The reader leaves ends out of its poses: they are taken from its bones, turned as it says."""
    path = written("bvh", tmp_path, ".bvh")
    ends = {joint.Name: joint for joint, _, _ in bvhio.readAsBvh(str(path)).Root.layout() if not joint.Children}
    expected = {"head": 0, "left_hand": 1, "right_hand": 2, "left_foot": 3, "right_foot": 4}
    assert set(ends) == set(expected)
    root = bvhio.readAsHierarchy(str(path))
    root.loadRestPose()
    at_rest = {joint.Name: joint.RotationWorld for joint, _, _ in root.layout()}
    root.loadPose(2)
    for joint, _, _ in root.layout():
        if joint.Name in ends:
            turned = joint.RotationWorld * glm.inverse(at_rest[joint.Name])
            end = joint.PositionWorld + turned * ends[joint.Name].EndSite
            forward, left, up = exported.ends(2)[expected[joint.Name]]
            np.testing.assert_allclose([*end], 100.0 * np.array([left, up, forward]), atol=2e-3, err_msg=joint.Name)


@pytest.mark.parametrize("name", ["trc", "c3d", "bvh"])
def test_how_certain_a_joint_is_stands_beside(name: str, tmp_path: Path) -> None:
    table = pd.read_csv(next(p for p in formats.write(exported.take(), name, tmp_path) if p.suffix == ".csv"))
    motion = exported.reconstruction().motion
    assert motion is not None
    assert table["timecode"].tolist() == list(exported.reconstruction().timecodes)
    np.testing.assert_allclose(table["time_s"], np.arange(FRAMES) / float(RATE), atol=1e-8)
    sigmas = table[[f"{joint}_sigma_m" for joint in JOINTS]].to_numpy()
    np.testing.assert_allclose(sigmas[VALID], motion.sigma_m[VALID], atol=1e-6)
    assert np.isnan(sigmas[GAP]).all()


def test_a_take_without_a_body_is_told_what_can_be_written(tmp_path: Path) -> None:
    whole = exported.reconstruction()
    assert whole.motion is not None
    bare = Take(replace(whole, motion=replace(whole.motion, body=None)))
    assert formats.write(bare, "trc", tmp_path)
    with pytest.raises(PzcapError, match=r"joints, but no body .*write trc or c3d"):
        formats.write(bare, "bvh", tmp_path)
    with pytest.raises(PzcapError, match="no body was tracked"):
        formats.write(Take(replace(whole, motion=None)), "c3d", tmp_path)


def test_a_format_that_is_not_known(tmp_path: Path) -> None:
    with pytest.raises(PzcapError, match=r"no format 'fbxx'; did you mean 'fbx'\? There are trc, c3d, bvh"):
        formats.write(exported.take(), "fbxx", tmp_path)


@pytest.mark.parametrize("name", formats.FORMATS)
def test_the_page_of_a_format_has_the_units_that_the_command_says(name: str) -> None:
    page = (Path(__file__).parents[2] / "docs" / "formats" / f"{name}.md").read_text(encoding="utf-8")
    units = formats.FORMATS[name].units.partition(";")[0]
    told = " ".join(page.split()).lower().replace("**", "")
    assert all(word in told for word in units.replace(" and ", ", ").split(", ")), units


def test_fbx_is_written_by_blender_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(PzcapError, match="no program 'blender' is on the PATH; install it, or write bvh"):
        formats.write(exported.take(), "fbx", tmp_path)
    (tmp_path / "blender").write_text("#!/bin/sh\necho 'Error: of version 2.49' >&2\nexit 1\n")
    (tmp_path / "blender").chmod(0o755)
    with pytest.raises(PzcapError, match=r"wrote no FBX, and said: Error: of version 2.49; Blender 4.2"):
        formats.write(exported.take(), "fbx", tmp_path)


def test_a_library_that_is_missing_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ezc3d", None)
    with pytest.raises(PzcapError, match=r"C3D is written by the package ezc3d.*pip install 'pzcap\[export\]'"):
        formats.write(exported.take(), "c3d", tmp_path)
