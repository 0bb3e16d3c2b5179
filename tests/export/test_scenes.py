"""USD and glTF: the body, its skin and the cameras in one scene, read back by usd-core and by glTF's own definition."""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom, UsdSkel
from scipy.spatial.transform import Rotation, Slerp

from pzcap.body import kinematics
from pzcap.export import formats
from pzcap.export.take import Take
from pzcap.geometry.camera import project
from pzcap.types import SEGMENTS, Array
from tests.scenes import exported, fabricated
from tests.scenes.bodies import BODY, random_pose
from tests.scenes.exported import FRAMES, GAP, LOST, RATE

WIDTH, HEIGHT = fabricated.WIDTH, fabricated.HEIGHT
FILES = ("Sud_1", "b_c_2", "b_c_3", "4")
VALID = [frame for frame in range(FRAMES) if frame != GAP]
PIXELS = 0.02


def skin(frame: int) -> Array:
    """(V, 3) by the library's own kinematics."""
    motion = exported.reconstruction().motion
    assert motion is not None
    pose = replace(random_pose(frame, 0.8), root_position_m=motion.root_position_m[frame])
    return kinematics.place(BODY, kinematics.forward(BODY, pose))[0]


# --------------------------------------------------------------------------------------------------------------
# USD


def stage_of(take: Take, folder: Path) -> Any:
    return Usd.Stage.Open(str(next(path for path in formats.write(take, "usd", folder) if path.suffix == ".usda")))


def test_usd_cameras(tmp_path: Path) -> None:
    """Through usd-core's own frustum. Its window does not bend, so the take has a lens that does not, either."""
    stage = stage_of(exported.take(0.0), tmp_path)
    for number, file in enumerate(FILES):
        schema = UsdGeom.Camera.Get(stage, f"/World/camera_{file}")
        assert len(schema.GetFocalLengthAttr().GetTimeSamples()) == FRAMES - (number == 0)
        for frame in range(FRAMES):
            if (number, frame) == (0, LOST):
                continue
            frustum = schema.GetCamera(Usd.TimeCode(frame)).frustum
            matrix = frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix()
            clip = np.array([matrix.Transform(Gf.Vec3d(*point)) for point in exported.joints(frame).tolist()])
            corner = np.column_stack([(clip[:, 0] + 1) / 2 * WIDTH, (1 - clip[:, 1]) / 2 * HEIGHT])
            expected = project(exported.true_camera(number, frame, 0.0), exported.joints(frame))[0]
            np.testing.assert_allclose(corner - 0.5, expected, atol=PIXELS)


def test_usd_keeps_what_it_has_no_place_for(tmp_path: Path) -> None:
    stage = stage_of(exported.take(), tmp_path)
    prim = stage.GetPrimAtPath("/World/camera_4")
    assert prim.GetAttribute("pzcap:k1").Get(3) == pytest.approx(exported.true_camera(3, 3).k1)
    assert prim.GetAttribute("pzcap:panSigmaDegrees").Get(3) == pytest.approx(np.rad2deg(1e-4))
    assert stage.GetDefaultPrim().GetCustomDataByKey("pzcap:timecode") == "01:00:00:05"


def test_usd_body(tmp_path: Path) -> None:
    stage = stage_of(exported.take(), tmp_path)
    assert UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert stage.GetTimeCodesPerSecond() == pytest.approx(float(RATE))
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0, FRAMES - 1)
    root, cache = UsdSkel.Root.Get(stage, "/World/Athlete"), UsdSkel.Cache()
    cache.Populate(root, Usd.PrimDefaultPredicate)
    query = cache.GetSkelQuery(UsdSkel.Skeleton.Get(stage, "/World/Athlete/Skeleton"))
    names = [str(path).rpartition("/")[2] for path in query.GetJointOrder()]
    assert names[:16] == list(SEGMENTS)
    for frame in VALID:
        places = [t.ExtractTranslation() for t in query.ComputeJointSkelTransforms(Usd.TimeCode(frame))]
        np.testing.assert_allclose(np.array(places)[:16], exported.joints(frame), atol=1e-5)
        np.testing.assert_allclose(np.array(places)[16:], exported.ends(frame), atol=1e-5)
    assert GAP not in query.GetAnimQuery().GetJointTransformTimeSamples()


def test_usd_skin(tmp_path: Path) -> None:
    stage = stage_of(exported.take(), tmp_path)
    root = UsdSkel.Root.Get(stage, "/World/Athlete")
    mesh = UsdGeom.Mesh.Get(stage, "/World/Athlete/Skin")
    assert UsdSkel.BakeSkinning(root, Gf.Interval(0, FRAMES - 1))
    for frame in VALID:
        np.testing.assert_allclose(np.array(mesh.GetPointsAttr().Get(frame)), skin(frame), atol=1e-4)


# --------------------------------------------------------------------------------------------------------------
# glTF, by its definition


class Gltf:
    """A binary glTF file, read with struct and numpy alone."""

    def __init__(self, path: Path) -> None:
        content = path.read_bytes()
        magic, version, length = struct.unpack("<4sII", content[:12])
        assert (magic, version, length) == (b"glTF", 2, len(content))
        size, kind = struct.unpack("<I4s", content[12:20])
        assert kind == b"JSON"
        self.tree = json.loads(content[20 : 20 + size])
        self.data = content[28 + size :]
        self.parent = {child: n for n, node in enumerate(self.tree["nodes"]) for child in node.get("children", [])}

    def array(self, accessor: int) -> Array:
        entry = self.tree["accessors"][accessor]
        view = self.tree["bufferViews"][entry["bufferView"]]
        kind = {5126: "<f4", 5123: "<u2", 5125: "<u4"}[entry["componentType"]]
        columns = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}[entry["type"]]
        start = view.get("byteOffset", 0) + entry.get("byteOffset", 0)
        assert start % 4 == 0
        flat = np.frombuffer(self.data, kind, entry["count"] * columns, start)
        return flat.reshape(entry["count"], columns).astype(float)

    def animated(self, time: float) -> dict[tuple[Any, str], Array]:
        """(node or pointer, property) -> value at a time."""
        [animation] = self.tree["animations"]
        values = {}
        for channel in animation["channels"]:
            sampler, target = animation["samplers"][channel["sampler"]], channel["target"]
            times, outputs = self.array(sampler["input"])[:, 0], self.array(sampler["output"])
            time = float(np.clip(time, times[0], times[-1]))
            if target["path"] == "rotation":
                value = Slerp(times, Rotation.from_quat(outputs))(time).as_quat()
            else:
                value = np.array([np.interp(time, times, column) for column in outputs.T])
            where = (
                target["extensions"]["KHR_animation_pointer"]["pointer"]
                if target["path"] == "pointer"
                else target["node"]
            )
            values[where, target["path"]] = value
        return values

    def world(self, node: int, values: dict[tuple[Any, str], Array]) -> Array:
        entry = self.tree["nodes"][node]
        local = np.eye(4)
        local[:3, :3] = Rotation.from_quat(
            values.get((node, "rotation"), entry.get("rotation", [0, 0, 0, 1]))
        ).as_matrix()
        local[:3, 3] = values.get((node, "translation"), entry.get("translation", [0, 0, 0]))
        return self.world(self.parent[node], values) @ local if node in self.parent else local


def gltf_of(take: Take, folder: Path) -> Gltf:
    return Gltf(next(path for path in formats.write(take, "gltf", folder) if path.suffix == ".glb"))


def yup(points: Array) -> Array:
    """Left, up, forward: glTF's assets face +z, with x to their left."""
    return points[:, [1, 2, 0]]


def test_gltf_skin(tmp_path: Path) -> None:
    file = gltf_of(exported.take(), tmp_path)
    [part], [bound] = file.tree["meshes"][0]["primitives"], file.tree["skins"]
    points = file.array(part["attributes"]["POSITION"])
    carriers, weights = file.array(part["attributes"]["JOINTS_0"]), file.array(part["attributes"]["WEIGHTS_0"])
    np.testing.assert_array_equal(weights.sum(axis=1), 1.0)
    inverse = file.array(bound["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
    for frame in VALID:
        values = file.animated(frame / float(RATE))
        joints = np.array([file.world(node, values) for node in bound["joints"]])
        np.testing.assert_allclose(joints[:16, :3, 3], yup(exported.joints(frame)), atol=1e-5)
        np.testing.assert_allclose(joints[16:, :3, 3], yup(exported.ends(frame)), atol=1e-5)
        moved = (joints @ inverse)[carriers[:, 0].astype(int)]
        placed = np.einsum("nij,nj->ni", moved, np.column_stack([points, np.ones(len(points))]))[:, :3]
        np.testing.assert_allclose(placed, yup(skin(frame)), atol=1e-4)


def test_gltf_faces_look_outward(tmp_path: Path) -> None:
    file = gltf_of(exported.take(), tmp_path)
    part = file.tree["meshes"][0]["primitives"][0]
    points, faces = file.array(part["attributes"]["POSITION"]), file.array(part["indices"]).reshape(-1, 3).astype(int)
    a, b, c = points[faces].transpose(1, 0, 2)
    assert np.sum(a * np.cross(b, c)) / 6.0 == pytest.approx(0.07, abs=0.03)  # cubic metres of a person


def test_gltf_cameras(tmp_path: Path) -> None:
    """No place for the principal point and the distortion: both are taken from what the take has."""
    file = gltf_of(exported.take(0.0), tmp_path)
    assert file.tree["extensionsUsed"] == ["KHR_animation_pointer"]
    nodes = {node["name"]: n for n, node in enumerate(file.tree["nodes"]) if "camera" in node}
    for number, name in enumerate(FILES):
        node = nodes[f"camera_{name}"]
        for frame in range(FRAMES):
            if (number, frame) == (0, LOST):
                continue
            values, true = file.animated(frame / float(RATE)), exported.true_camera(number, frame, 0.0)
            pose = file.world(node, values)
            field = values[f"/cameras/{file.tree['nodes'][node]['camera']}/perspective/yfov", "pointer"][0]
            right, up, back = ((yup(exported.joints(frame)) - pose[:3, 3]) @ pose[:3, :3]).T
            focal = HEIGHT / 2 / np.tan(field / 2)
            found = np.column_stack([focal * right / -back, focal * -up / -back]) + true.principal_px
            np.testing.assert_allclose(found, project(true, exported.joints(frame))[0], atol=PIXELS)
