"""Motions from BVH files: what is written of ours comes back, however it was written."""

from __future__ import annotations

import functools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pzcap.types import HINGE_AXES, SEGMENTS, Array, PzcapError
from sim import motion
from sim.motion import MotionClip
from sim.motion._fit import floor_points
from sim.motion._kinematics import Frames, log
from sim.motion._retarget import _limited
from sim.people.anthropometry import body_tree, draw_measurements, joint_limit_rad
from tests.scenes.bvh_files import MIXAMO, SMPL, XSENS, Y_UP, Style, astride, t_pose, write_bvh

CMU = {name: joint.removeprefix("mixamorig:") for name, joint in MIXAMO.items()}
STYLES = {
    "as we are": Style(),
    "t-pose, y up, centimetres": Style(rest=t_pose(), axes=Y_UP, unit=100.0, rate=120.0),
    "xsens, other order": Style(names=XSENS, rest=t_pose(), axes=Y_UP, unit=100.0, order="YXZ"),
    "cmu, legs astride, facing backwards": Style(
        names=CMU, rest=astride(), axes=np.diag([-1.0, -1.0, 1.0]), unit=39.37, order="XYZ"
    ),
    "smpl": Style(names=SMPL, rest=t_pose(), axes=Y_UP),
    "a character's prefix": Style(names={key: f"Character1_{name}" for key, name in CMU.items()}),
    "a rig's suffix": Style(names={key: f"{name}_{k:02d}" for k, (key, name) in enumerate(CMU.items())}),
    "two prefixes before smpl": Style(names={key: f"f_avg_{name}" for key, name in SMPL.items()}),
}


@functools.cache
def measured(seed: int) -> dict[str, float]:
    return draw_measurements(np.random.default_rng(seed))


@functools.cache
def ours(name: str) -> MotionClip:
    return motion.make(name, measured(0), np.random.default_rng(0))


def sampled(clip: MotionClip, measurements: dict[str, float], rate: float = 30.0) -> Frames:
    poses = [clip.at(k / rate) for k in range(round(clip.duration_s * rate) + 1)]
    rotations = Rotation.from_quat(np.concatenate([pose.rotations for pose in poses]), scalar_first=True).as_matrix()
    roots = np.stack([pose.root_position_m for pose in poses])
    return Frames.place(body_tree(measurements), roots, rotations.reshape(-1, 16, 3, 3))


def read(path: Path, seed: int = 0) -> MotionClip:
    return motion.make(str(path), measured(seed), np.random.default_rng(0))


def shift(frames: Frames, other: Frames) -> Array:
    """(3,) between two motions that differ by where they take place."""
    return (frames.joints_m - other.joints_m).mean(axis=(0, 1))


@pytest.mark.parametrize("name", ["floor_exercise", "pedestrian"])
@pytest.mark.parametrize("style", STYLES.values(), ids=STYLES.keys())
def test_what_is_written_comes_back(name: str, style: Style, tmp_path: Path) -> None:
    clip = ours(name)
    back = read(write_bvh(tmp_path / "own.bvh", clip, measured(0), style))
    assert back.frame_count == clip.frame_count
    expected, found = sampled(clip, measured(0)), sampled(back, measured(0))
    moved = shift(found, expected)
    difference = found.joints_m - moved - expected.joints_m
    assert np.abs(difference[..., :2]).max() < 1e-5
    assert np.abs(difference[..., 2]).max() < 0.003, "feet are lifted out of the floor"
    assert abs(moved[2]) < 0.001
    assert np.linalg.norm(log(expected.rotations.swapaxes(-1, -2) @ found.rotations), axis=-1).max() < 1e-5


def test_the_way_lies_about_the_middle_of_the_hall(tmp_path: Path) -> None:
    roots = sampled(
        read(write_bvh(tmp_path / "own.bvh", ours("pedestrian"), measured(0), Style())), measured(0)
    ).roots_m
    np.testing.assert_allclose(roots[:, :2].min(axis=0) + roots[:, :2].max(axis=0), 0.0, atol=0.01)


def test_limbs_bend_where_the_file_says_not_where_its_frames_do(tmp_path: Path) -> None:
    """The upper arms are turned about themselves by 40 degrees, as if the elbows' hinges lay otherwise."""
    turn = Rotation.from_euler("z", 40.0, degrees=True).as_matrix()
    rest = {name: at_rest @ turn if name.endswith("upper_arm") else at_rest for name, at_rest in t_pose().items()}
    back = read(write_bvh(tmp_path / "own.bvh", ours("floor_exercise"), measured(0), Style(rest=rest)))
    expected, found = sampled(ours("floor_exercise"), measured(0)), sampled(back, measured(0))
    off = np.linalg.norm(found.joints_m - shift(found, expected) - expected.joints_m, axis=2)
    assert np.percentile(off, 99) < 0.01
    assert off.max() < 0.03  # the wrist of an arm that is all but straight


@pytest.mark.parametrize("name", ["floor_exercise", "pedestrian"])
def test_somebody_of_other_proportions_does_the_same(name: str, tmp_path: Path) -> None:
    """Limbs point as before, feet stand on the floor, and what stands hardly slides."""
    path = write_bvh(tmp_path / "own.bvh", ours(name), measured(0), Style(rest=t_pose(), unit=100.0))
    other = measured(5)
    clip = read(path, seed=5)
    found, expected = sampled(clip, other, 60.0), sampled(ours(name), measured(0), 60.0)
    for near, far in (("thigh", "shank"), ("upper_arm", "forearm"), ("forearm", "hand"), ("shank", "foot")):
        a, b = SEGMENTS.index(f"left_{near}"), SEGMENTS.index(f"left_{far}")
        ways = [frames.joints_m[:, b] - frames.joints_m[:, a] for frames in (found, expected)]
        ways = [way / np.linalg.norm(way, axis=1, keepdims=True) for way in ways]
        assert np.degrees(np.arccos(np.clip(np.sum(ways[0] * ways[1], axis=1), -1, 1))).max() < 0.1
    heights = [found.points(p.segment, p.local_m)[:, 2] - p.radius_m for p in floor_points(other)]
    assert np.min(heights) > -1e-3
    times = np.arange(len(found.roots_m)) / 60.0
    stands = np.array([list(clip.contacts(t).values()) for t in times])
    truly = np.array([list(ours(name).contacts(t).values()) for t in times])
    assert (stands == truly).mean() > 0.9
    assert (stands.any(axis=1) == truly.any(axis=1)).mean() > 0.9


def test_limits_hold(tmp_path: Path) -> None:
    """The figure's head turns all the way round, an elbow bends by 170 degrees."""
    path = write_bvh(tmp_path / "own.bvh", ours("pedestrian"), measured(0), Style())
    lines = path.read_text().splitlines()
    joints = [line.split()[1] for line in lines if line.startswith(("ROOT", "JOINT"))]
    for joint, turn in (("mixamorig:Head", "120 0 0"), ("mixamorig:LeftForeArm", "0 0 -170")):
        at = 3 + 3 * joints.index(joint)
        for k in range(lines.index("MOTION") + 3, len(lines)):
            words = lines[k].split()
            lines[k] = " ".join(words[:at] + turn.split() + words[at + 3 :])
    path.write_text("\n".join(lines))
    vectors = log(sampled(read(path), measured(0)).rotations)
    for s, name in enumerate(SEGMENTS[1:], start=1):
        low, high = joint_limit_rad(name)
        angles = (
            vectors[:, s] @ np.array(HINGE_AXES[name]) if name in HINGE_AXES else np.linalg.norm(vectors[:, s], axis=1)
        )
        assert low - 1e-6 < angles.min(), name
        assert angles.max() < high + 1e-6, name


def test_a_limit_takes_the_twist_before_the_direction() -> None:
    rng = np.random.default_rng(0)
    turns = Rotation.random(500, rng=rng).as_matrix()
    for limit in np.radians([40.0, 95.0, 175.0]):
        held = _limited(turns, limit)
        whole = np.linalg.norm(log(held), axis=1)
        assert whole.max() < limit + 1e-9
        inside = np.linalg.norm(log(turns), axis=1) < limit
        np.testing.assert_allclose(held[inside], turns[inside], atol=1e-9)
        reach = np.arccos(turns[:, 2, 2])
        np.testing.assert_allclose(held[reach < limit, :, 2], turns[reach < limit, :, 2], atol=1e-7)
        np.testing.assert_allclose(np.arccos(held[:, 2, 2]), np.minimum(reach, limit), atol=1e-6)


def test_a_first_frame_at_rest_is_no_part_of_the_motion(tmp_path: Path) -> None:
    path = write_bvh(tmp_path / "own.bvh", ours("pedestrian"), measured(0), Style(rest=t_pose(), rate=30.0))
    plain = read(path)
    lines = path.read_text().splitlines()
    at = lines.index("MOTION") + 1
    lines[at] = f"Frames: {int(lines[at].split()[1]) + 1}"
    lines.insert(at + 2, " ".join(["0"] * (3 + 3 * 16)))
    path.write_text("\n".join(lines))
    resting = read(path)
    assert resting.frame_count == plain.frame_count
    np.testing.assert_allclose(resting.at(1.0).rotations, plain.at(1.0).rotations, atol=1e-12)


def test_smpl_has_feet_and_hands_beyond_ankles_and_wrists(tmp_path: Path) -> None:
    """There left_foot is the ball of the foot and left_hand the palm: neither is a joint of ours."""
    path = write_bvh(tmp_path / "own.bvh", ours("pedestrian"), measured(0), Style(names=SMPL, rest=t_pose(), axes=Y_UP))
    plain = read(path)
    lines = path.read_text().splitlines()
    begins = []
    for side in ("left", "right"):
        for near, far in (("ankle", "foot"), ("wrist", "hand")):
            begins.append((lines.index(f"JOINT {side}_{near}"), f"{side}_{far}"))
    for at, name in sorted(begins, reverse=True):
        end = next(k for k in range(at, len(lines)) if lines[k].startswith("End"))
        offset = lines[end + 2]
        lines[end : end + 4] = [
            f"JOINT {name}",
            "{",
            offset,
            "CHANNELS 0",
            "End Site",
            "{",
            "OFFSET 0 0 0.03",
            "}",
            "}",
        ]
    path.write_text("\n".join(lines))
    found = read(path)
    for t in (0.0, 0.4, 0.9):
        np.testing.assert_allclose(found.at(t).rotations, plain.at(t).rotations, atol=1e-9)


def test_a_program_that_counts_the_steps_between_frames(tmp_path: Path) -> None:
    path = write_bvh(tmp_path / "own.bvh", ours("pedestrian"), measured(0), Style(rest=t_pose(), rate=30.0))
    plain, text = read(path), path.read_text()
    count = int(text[text.index("Frames:") :].split()[1])
    path.write_text(text.replace(f"Frames: {count}", f"Frames: {count - 1}"))
    assert read(path).frame_count == plain.frame_count


def test_joints_that_channels_place(tmp_path: Path) -> None:
    """Every OFFSET is 0 0 0, and every joint has the place against its parent in its channels, frame by frame."""
    path = write_bvh(tmp_path / "own.bvh", ours("pedestrian"), measured(0), Style(rest=t_pose(), axes=Y_UP))
    plain = read(path)
    lines = path.read_text().splitlines()
    motion_at = lines.index("MOTION")
    offsets: list[str] = []
    for k, line in enumerate(lines[:motion_at]):
        if line.startswith("CHANNELS 3"):
            lines[k] = line.replace("CHANNELS 3", "CHANNELS 6 Xposition Yposition Zposition")
            offsets.append(lines[k - 1].removeprefix("OFFSET "))
            lines[k - 1] = "OFFSET 0 0 0"
    for k in range(motion_at + 3, len(lines)):
        words = lines[k].split()
        turns = [" ".join(words[at : at + 3]) for at in range(6, len(words), 3)]
        lines[k] = " ".join([*words[:6], *(f"{o} {t}" for o, t in zip(offsets, turns, strict=True))])
    path.write_text("\n".join(lines))
    found = read(path)
    for t in (0.0, 0.4, 0.9):
        np.testing.assert_allclose(found.at(t).rotations, plain.at(t).rotations, atol=1e-9)


# What cannot be used --------------------------------------------------------------------------------------------------

PLAIN = """HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Spine {
    OFFSET 0 10 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    { OFFSET 0 10 0 }
  }
}
MOTION
Frames: 2
Frame Time: 0.04
0 0 0 0 0 0 0 0 0
0 0 0 0 0 0 0 0 0
"""


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("HIERARCHY", "HIERACHY", "line 1: 'HIERARCHY' must stand here, not 'HIERACHY'"),
        ("ROOT Hips", "JOINT Hips", "line 2: 'ROOT' must stand here"),
        ("OFFSET 0 0 0", "OFFSET 0 0", "line 4: OFFSET: 2 values where 3 belong"),
        ("OFFSET 0 10 0\n    C", "OFFSET 0 ten 0\n    C", "line 7: OFFSET: 'ten' is no number"),
        ("CHANNELS 6", "CHANNELS 5", "line 5: CHANNELS says '5' and names 6"),
        ("CHANNELS 3 Zrotation", "CHANNELS 3 Wrotation", "line 8: 'wrotation' is no channel"),
        ("CHANNELS 3 Zrotation", "CHANNELS 3 Xrotation", "line 8: 'xrotation' is no channel, or stands here twice"),
        ("JOINT Spine", "JOINT Hips", "line 6: a joint must have a name of its own"),
        ("JOINT Spine", "JONT Spine", "line 6: 'JOINT' must stand here, not 'JONT Spine'"),
        ("Frames: 2", "Frames: 3", "line 15: 3 frames are announced and 2 follow"),
        ("Frames: 2", "Frames: 0", "line 15: 0 frames are announced and 2 follow"),
        ("Frame Time: 0.04", "Frame Time: 0", "line 15: Frame Time is 0"),
        ("0 0 0 0 0 0 0 0 0\n0", "0 0 0 0 0 0 0 0\n0", "line 16: this frame: 8 values where 9 belong"),
        ("0 0 0 0 0 0 0 0 0\n0", "0 0 nan 0 0 0 0 0 0\n0", "line 16: this frame: not every value is finite"),
        (PLAIN[PLAIN.index("MOTION") :], "", "the file ends too early"),
    ],
)
def test_what_is_broken_is_named_with_its_line(old: str, new: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "broken.bvh"
    assert old in PLAIN
    path.write_text(PLAIN.replace(old, new, 1))
    refused(path, message)


def refused(path: Path, message: str) -> None:
    with pytest.raises(PzcapError) as caught:
        read(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_joint_is_named(tmp_path: Path) -> None:
    path = tmp_path / "plain.bvh"
    path.write_text(PLAIN)
    refused(path, "there is no joint for head (head, neck, ...), left_upper_arm (leftarm, larm, ...)")


def test_a_figure_that_cannot_be_ours_is_refused(tmp_path: Path) -> None:
    path = write_bvh(tmp_path / "own.bvh", ours("pedestrian"), measured(0), Style())
    sound = path.read_text()
    refused(tmp_path / "none.bvh", "cannot read the motion: No such file")
    path.write_bytes(b"\xff\xfe\x00\x80")
    refused(path, "it is not text")
    lying = {name: Rotation.from_euler("y", -90.0, degrees=True).as_matrix() for name in ("left_thigh", "left_shank")}
    write_bvh(path, ours("pedestrian"), measured(0), Style(rest=lying))
    refused(path, "does not stand upright")
    hand = sound.index("OFFSET", sound.index("LeftHand"))
    path.write_text(sound[:hand] + "OFFSET 0 0 0" + sound[sound.index("\n", hand) :])
    refused(path, "'mixamorig:LeftForeArm' and 'mixamorig:LeftHand' coincide")
    frame_time = sound.index("Frame Time")
    path.write_text(sound[:frame_time] + sound[frame_time:].replace("0.016666667", "0.0001", 1))
    refused(path, "it must last two frames")


def test_a_way_that_is_longer_than_the_hall_is_refused(tmp_path: Path) -> None:
    clip = ours("pedestrian")
    spline = replace(clip, spline=type(clip.spline)(clip.knots_s, clip.spline(clip.knots_s) * ([3.0] * 3 + [1.0] * 64)))
    path = write_bvh(tmp_path / "own.bvh", spline, measured(0), Style(rate=30.0))
    refused(path, "between the cameras there are 18 x 13 m")
