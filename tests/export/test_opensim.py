"""OpenSim's model and motion, by what their definition says: forward kinematics of the XML as it stands."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pzcap.export import formats, mot
from pzcap.types import Array
from tests.scenes import exported
from tests.scenes.exported import FRAMES, GAP, RATE

VALID = [frame for frame in range(FRAMES) if frame != GAP]


def numbers(node: ET.Element | None) -> Array:
    assert node is not None
    assert node.text is not None
    return np.array(node.text.split(), np.float64)


def text(node: ET.Element, path: str) -> str:
    return (node.findtext(path) or "").strip()


def markers(model: ET.Element, row: dict[str, float]) -> dict[str, Array]:
    """Places of the model's markers, at coordinates in degrees and metres."""
    frames = {"/ground": np.eye(4)}
    for joint in model.iter("CustomJoint"):
        offsets = {}
        for frame in joint.iter("PhysicalOffsetFrame"):
            place = np.eye(4)
            place[:3, 3] = numbers(frame.find("translation"))
            offsets[frame.attrib["name"]] = (text(frame, "socket_parent"), place)
        moved = np.eye(4)
        for axis in joint.iter("TransformAxis"):
            coordinate, along = text(axis, "coordinates"), numbers(axis.find("axis"))
            if not coordinate:
                continue
            if axis.attrib["name"].startswith("rotation"):
                moved[:3, :3] = moved[:3, :3] @ Rotation.from_rotvec(np.deg2rad(row[coordinate]) * along).as_matrix()
            else:
                moved[:3, 3] += row[coordinate] * along
        parent, before = offsets[text(joint, "socket_parent_frame")]
        child, after = offsets[text(joint, "socket_child_frame")]
        frames[child] = frames[parent] @ before @ moved @ np.linalg.inv(after)
    return {
        marker.attrib["name"]: (frames[text(marker, "socket_parent_frame")] @ [*numbers(marker.find("location")), 1.0])[
            :3
        ]
        for marker in model.iter("Marker")
    }


def test_forward_kinematics_gives_the_joints_back(tmp_path: Path) -> None:
    files = {path.suffix: path for path in formats.write(exported.take(), "mot", tmp_path)}
    model = ET.parse(files[".osim"]).getroot()
    lines = files[".mot"].read_text().splitlines()
    head = lines.index("endheader")
    assert "inDegrees=yes" in lines[:head]
    names = lines[head + 1].split("\t")
    table = np.array([line.split("\t") for line in lines[head + 2 :]], np.float64)
    assert f"nRows={len(table)}" in lines[:head]
    assert f"nColumns={len(names)}" in lines[:head]
    np.testing.assert_allclose(table[:, 0], np.array(VALID) / float(RATE), atol=1e-8)
    for values, frame in zip(table, VALID, strict=True):
        found = markers(model, dict(zip(names, values, strict=True)))
        forward, left, up = np.vstack([exported.joints(frame), exported.ends(frame)]).T
        np.testing.assert_allclose(list(found.values()), np.column_stack([forward, up, -left]), atol=1e-6)


@pytest.mark.parametrize(
    ("coordinate", "segment", "rotation", "degrees"),
    [
        ("knee_angle_r", 14, [0.0, 1.0, 0.0], 40.0),  # the heel goes back
        ("elbow_flex_l", 5, [0.0, -1.0, 0.0], 40.0),  # the hand comes forward
        ("hip_flexion_r", 13, [0.0, -1.0, 0.0], 40.0),  # the thigh goes forward
        ("hip_adduction_r", 13, [-1.0, 0.0, 0.0], -40.0),  # to the right, away from the middle
        ("hip_adduction_l", 10, [1.0, 0.0, 0.0], -40.0),  # to the left, away from the middle
        ("ankle_angle_l", 12, [0.0, -1.0, 0.0], 40.0),  # toes up
    ],
)
def test_angles_have_the_signs_that_opensim_gives_them(
    coordinate: str, segment: int, rotation: list[float], degrees: float
) -> None:
    turned = Rotation.from_rotvec(np.deg2rad(40.0) * np.array(rotation)).as_quat(scalar_first=True)
    names = [each.name for each in mot.coordinates_of(segment)]
    found = np.rad2deg(mot.angles(segment, turned[None]))[0]
    np.testing.assert_allclose(found[names.index(coordinate)], degrees, atol=1e-9)
    np.testing.assert_allclose(np.delete(found, names.index(coordinate)), 0.0, atol=1e-9)


def test_angles_do_not_jump() -> None:
    """An arm that is raised sideways past the height of the shoulder, where two of its axes fall together."""
    raised = np.deg2rad(np.linspace(0.0, 170.0, 60))
    arm = Rotation.from_rotvec(raised[:, None] * np.array([-1.0, 0.0, 0.0])) * Rotation.from_rotvec([0.0, -0.2, 0.0])
    found = np.rad2deg(mot.angles(7, arm.as_quat(scalar_first=True)))
    assert np.abs(np.diff(found, axis=0)).max() < 30.0
