"""Files of other programs are scored as they are."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pzcap.scoring import truth_files
from pzcap.scoring.command import REFUSED, main
from pzcap.scoring.readers.conventions import Conventions, axes, joint_names
from pzcap.scoring.readers.read import read
from pzcap.scoring.records import CameraTrack, TrueCapture
from pzcap.scoring.score import score
from pzcap.scoring.suspicions import suspicions
from pzcap.scoring.totals import metrics
from pzcap.types import JOINTS, PARENTS, Array, PzcapError
from tests.scenes import plain

PLAIN = Conventions()


@pytest.fixture(scope="module")
def truth() -> TrueCapture:
    return plain.good()[1]


def found(path: Path, truth: TrueCapture, said: Conventions = PLAIN) -> dict[str, float | None]:
    results = read(path, truth, said)
    assert suspicions(results, truth) == []
    return {metric.key: metric.value for metric in metrics(score(results, truth))}


def tracks(truth: TrueCapture) -> dict[str, CameraTrack]:
    return {name: camera.track for name, camera in zip(truth.camera_names, truth.cameras, strict=True)}


def write_colmap(truth: TrueCapture, folder: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    folder.mkdir()
    cameras, images = ["# cameras"], ["# images, two lines each"]
    number = 0
    for name, track in tracks(truth).items():
        poses = track.poses
        assert poses is not None
        for frame in range(len(truth.timecodes)):
            number += 1
            cx, cy = poses.principal_px[frame] + 0.5
            lens = " ".join(repr(float(v)) for v in (track.focal_px[frame], cx, cy, poses.distortion[frame, 0]))
            cameras.append(f"{number} SIMPLE_RADIAL {truth.image_size[0]} {truth.image_size[1]} {lens}")
            turn = poses.rotation[frame].T
            x, y, z, w = pycolmap.Rotation3d(turn).quat
            shift = -turn @ poses.position_m[frame]
            values = " ".join(repr(float(v)) for v in (w, x, y, z, *shift))
            images += [f"{number} {values} {number} {name}/{frame:06d}.png", ""]
    (folder / "cameras.txt").write_text("\n".join(cameras) + "\n")
    (folder / "images.txt").write_text("\n".join(images) + "\n")
    (folder / "points3D.txt").write_text("")
    model = pycolmap.Reconstruction()
    model.read_text(str(folder))  # the file is one to its own reader, too
    assert model.num_images() == number


def test_colmap(truth: TrueCapture, tmp_path: Path) -> None:
    write_colmap(truth, tmp_path / "model")
    values = found(tmp_path / "model", truth)
    assert values["panzoom.pan.max"] == pytest.approx(0.0, abs=1e-9)
    assert values["panzoom.reprojection.rms"] == pytest.approx(0.0, abs=1e-6)
    assert values["panzoom.position.rms"] == pytest.approx(0.0, abs=1e-6)
    assert values["panzoom.completeness"] == 100.0


def write_soccernet(truth: TrueCapture, folder: Path) -> None:
    for name, track in tracks(truth).items():
        poses = track.poses
        assert poses is not None
        (folder / name).mkdir(parents=True)
        for frame in range(len(truth.timecodes)):
            turn = np.diag([1.0, -1.0, -1.0]) @ poses.rotation[frame]
            tilt = np.arccos(turn[2, 2])
            pan, roll = np.arctan2(turn[0, 2], -turn[1, 2]), np.arctan2(turn[2, 0], turn[2, 1])
            content = {
                "pan_degrees": np.degrees(pan), "tilt_degrees": np.degrees(tilt), "roll_degrees": np.degrees(roll),
                "position_meters": (np.diag([1.0, -1.0, -1.0]) @ poses.position_m[frame]).tolist(),
                "x_focal_length": track.focal_px[frame], "y_focal_length": track.focal_px[frame],
                "principal_point": poses.principal_px[frame].tolist(),
                "radial_distortion": [poses.distortion[frame, 0], 0.0, 0.0, 0.0, 0.0, 0.0],
                "tangential_distortion": [0.0, 0.0], "thin_prism_distortion": [0.0, 0.0, 0.0, 0.0],
            }  # fmt: skip
            (folder / name / f"camera_{frame:05d}.json").write_text(json.dumps(content))


def test_soccernet(truth: TrueCapture, tmp_path: Path) -> None:
    write_soccernet(truth, tmp_path)
    values = found(tmp_path, truth)
    assert values["panzoom.reprojection.rms"] == pytest.approx(0.0, abs=1e-6)
    assert values["panzoom.rotation.rms"] == pytest.approx(0.0, abs=1e-6)


def write_trc(path: Path, joints_m: Array, names: tuple[str, ...] = JOINTS, unit: str = "mm") -> None:
    """Joints (T, N, 3) in the axes of Pose2Sim: y up."""
    scale = 1000.0 if unit in ("mm", "millimetres") else 1.0
    head = ["PathFileType\t4\t(X/Y/Z)\tx.trc",
            "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
            f"30\t30\t{len(joints_m)}\t{len(names)}\t{unit}\t30\t1\t{len(joints_m)}",
            "Frame#\tTime\t" + "\t\t\t".join(names), "\t\tX1\tY1\tZ1", ""]  # fmt: skip
    for at, row in enumerate(scale * joints_m[:, :, [1, 2, 0]]):
        cells = ["" if np.isnan(value) else repr(float(value)) for value in row.ravel()]
        head.append("\t".join([str(at + 1), str(at / 30), *cells]))
    path.write_text("\r\n".join(head) + "\r\n")


@pytest.mark.parametrize("unit", ["mm", "m", "Meter", "millimetres"])
def test_trc_with_blank_cells_and_a_table_of_names(truth: TrueCapture, tmp_path: Path, unit: str) -> None:
    joints = truth.joints_m.copy()
    joints[3, 5] = np.nan
    joints[7, 15] = np.nan  # the last marker of a row, whose blank cells editors drop
    write_trc(tmp_path / "walk.trc", joints, tuple(name.upper() for name in JOINTS), unit)
    (tmp_path / "names.csv").write_text("theirs,joint\n" + "".join(f"{n.upper()},{n}\n" for n in JOINTS))
    said = Conventions(names=joint_names(tmp_path / "names.csv"))
    values = found(tmp_path / "walk.trc", truth, said)
    assert values["body.mpjpe.max"] == pytest.approx(0.0, abs=1e-9)
    assert values["body.completeness"] == pytest.approx(100.0 * (19 * 16 - 2) / (19 * 16))  # one frame is a keyframe


def test_part_of_the_joints_and_frames(truth: TrueCapture, tmp_path: Path) -> None:
    write_trc(tmp_path / "part.trc", truth.joints_m[5:15, 10:], JOINTS[10:])
    values = found(tmp_path / "part.trc", truth, Conventions(first_frame=5))
    assert values["body.mpjpe.max"] == pytest.approx(0.0, abs=1e-9)
    assert values["body.completeness"] == pytest.approx(100.0 * 60 / (19 * 16))
    with pytest.raises(PzcapError, match="10 frames from 15 on, of 20; see --first-frame"):
        read(tmp_path / "part.trc", truth, Conventions(first_frame=15))


def test_c3d(truth: TrueCapture, tmp_path: Path) -> None:
    ezc3d = pytest.importorskip("ezc3d")
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    file["parameters"]["POINT"]["RATE"]["value"] = [30]
    file["parameters"]["POINT"]["LABELS"]["value"] = list(JOINTS)
    points = np.ones((4, len(JOINTS), len(truth.timecodes)))
    points[:3] = 1000.0 * truth.joints_m.transpose(2, 1, 0)
    file["data"]["points"] = points
    residuals = np.zeros((1, *points.shape[1:]))
    residuals[0, 3, 4] = -1.0
    points[:3, 3, 4] = 0.0
    file["data"]["meta_points"]["residuals"] = residuals
    file.write(str(tmp_path / "walk.c3d"))
    values = found(tmp_path / "walk.c3d", truth)
    assert values["body.mpjpe.max"] == pytest.approx(0.0, abs=1e-3)  # single precision
    assert values["body.completeness"] == pytest.approx(100.0 * (19 * 16 - 1) / (19 * 16))


def test_bvh_places_its_joints(truth: TrueCapture, tmp_path: Path) -> None:
    """A figure of our own proportions, turned and moved: its joints lie where the chain of turns puts them."""
    rest = truth.joints_m[0][:, [1, 2, 0]] * 100.0  # y up, centimetres
    lines, order = ["HIERARCHY"], []

    def joint(index: int, depth: int) -> None:
        order.append(index)
        offset = rest[index] - (rest[PARENTS[index]] if index else rest[0])
        lines.append(
            f"{'ROOT' if index == 0 else 'JOINT'} {JOINTS[index]}\n{{\nOFFSET {offset[0]} {offset[1]} {offset[2]}"
        )
        places = "Xposition Yposition Zposition " if index == 0 else ""
        lines.append(f"CHANNELS {6 if index == 0 else 3} {places}Zrotation Xrotation Yrotation")
        children = [n for n, parent in enumerate(PARENTS) if parent == index]
        for child in children:
            joint(child, depth + 1)
        if not children:
            lines.append("End Site\n{\nOFFSET 0 -5 0\n}")
        lines.append("}")

    joint(0, 0)
    frames = np.zeros((len(truth.timecodes), 6 + 15 * 3))
    frames[:, :3] = truth.joints_m[:, 0][:, [1, 2, 0]] * 100.0
    frames[:, 5] = 30.0  # of the root about the vertical: the whole figure turns to the left
    elbow = 6 + 3 * (order.index(JOINTS.index("left_shoulder")) - 1)
    frames[:, elbow + 1] = -90.0  # the left arm forward: about the file's x, which is our y
    motion = [f"MOTION\nFrames: {len(frames)}\nFrame Time: 0.0333", *(" ".join(map(str, row)) for row in frames)]
    (tmp_path / "walk.bvh").write_text("\n".join(lines + motion) + "\n")
    body = read(tmp_path / "walk.bvh", truth, PLAIN).body
    assert body is not None
    c, s = np.cos(np.deg2rad(30.0)), np.sin(np.deg2rad(30.0))
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    own = truth.joints_m[0] - truth.joints_m[0, 0]
    shoulder, wrist = JOINTS.index("left_shoulder"), JOINTS.index("left_wrist")
    expected = own.copy()
    length = np.linalg.norm(own[wrist] - own[shoulder])
    expected[shoulder + 1] = own[shoulder] + [np.linalg.norm(own[shoulder + 1] - own[shoulder]), 0.0, 0.0]
    expected[wrist] = own[shoulder] + [length, 0.0, 0.0]
    np.testing.assert_allclose(body.joints_m, expected @ turn.T + truth.joints_m[:, :1], atol=1e-9)


def test_axes_are_told_by_where_each_points() -> None:
    np.testing.assert_array_equal(axes("y,z,x") @ [1.0, 2.0, 3.0], [3.0, 1.0, 2.0])
    np.testing.assert_array_equal(axes("x,z,-y") @ [1.0, 2.0, 3.0], [1.0, -3.0, 2.0])
    with pytest.raises(PzcapError, match="mirrored"):
        axes("y,x,z")
    with pytest.raises(PzcapError, match="name our axis"):
        axes("x,y,y")


def test_what_is_wrong_with_them_is_said_in_a_line(
    truth: TrueCapture, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth_files.write_truth(truth, tmp_path / "truth")
    for name, text, line in (
        ("a.trc", "Frame#\n" * 9, "is no TRC file"),
        ("a.bvh", "HIERARCHY ROOT hips { OFFSET 0 0", "is no BVH file"),
        (
            "b.bvh",
            "HIERARCHY ROOT hips { OFFSET 0 0 0 CHANNELS 0 } MOTION Frames: 2 Frame Time: 0.1 7",
            "1 numbers where",
        ),
    ):
        (tmp_path / name).write_text(text)
        assert main([str(tmp_path / name), str(tmp_path / "truth")]) == REFUSED
        said = capsys.readouterr().err
        assert line in said
        assert said.count("\n") == 1
    write_trc(tmp_path / "other.trc", truth.joints_m[:, :2], ("Hip", "RKnee"))
    assert main([str(tmp_path / "other.trc"), str(tmp_path / "truth")]) == REFUSED
    assert "map them with --joints TABLE.csv" in capsys.readouterr().err
    assert main(["--check", str(tmp_path / "other.trc")]) == REFUSED
    assert "give the truth as well" in capsys.readouterr().err


def test_colmap_says_where_a_line_is_wrong(truth: TrueCapture, tmp_path: Path) -> None:
    write_colmap(truth, tmp_path / "model")
    images, cameras = tmp_path / "model" / "images.txt", tmp_path / "model" / "cameras.txt"
    good = images.read_text()
    for old, new, line in (
        ("1/000003.png", "9/000003.png", "names no camera and frame; call it 1/000012.png"),
        ("1/000003.png", "1/000002.png", "camera 1 has frame 2 twice"),
        ("1/000003.png", "1/000020.png", "count them from 0, not from 1"),
    ):
        images.write_text(good.replace(old, new, 1))
        with pytest.raises(PzcapError, match=line):
            read(tmp_path / "model", truth, PLAIN)
    images.write_text(good)
    cameras.write_text(cameras.read_text().replace("SIMPLE_RADIAL", "FISHEYE", 1))
    with pytest.raises(PzcapError, match=r"cameras.txt line 2: model FISHEYE; one of"):
        read(tmp_path / "model", truth, PLAIN)


def test_results_of_others_are_those_of_the_truth_with_fewer_frames(truth: TrueCapture, tmp_path: Path) -> None:
    """An image that was not registered is a frame without an answer."""
    write_colmap(truth, tmp_path / "model")
    path = tmp_path / "model" / "images.txt"
    lines = path.read_text().split("\n")
    path.write_text("\n".join([lines[0], *lines[1 + 2 * 20 :]]))  # camera 1 is not there at all
    results = read(tmp_path / "model", truth, PLAIN)
    assert results.cameras[0] is None
    values = {m.key: m.value for m in metrics(score(results, truth))}
    assert values["panzoom.completeness"] == 75.0
    assert values == {m.key: m.value for m in metrics(score(replace(results, method="x"), truth))}


TRC_MISTAKES = {
    "a joint without a name": (lambda t: t.replace("lumbar\t\t\t", "\t\t\t"), "48 coordinates where line 4 names 15"),
    "a name twice": (lambda t: t.replace("lumbar", "pelvis"), "names 'pelvis' twice"),
    "no unit": (lambda t: t.replace("\tmm\t", "\t\t"), "names no unit; say --unit m, cm or mm"),
    "another unit": (lambda t: t.replace("\tmm\t", "\tin\t"), "its unit 'in' is none of m, cm and mm"),
    "decimal commas in numbers": (lambda t: t[:400] + t[400:].replace(".", ","), "points in numbers, not commas"),
    "decimal comma in the rate": (lambda t: t.replace("\r\n30\t", "\r\n60,0\t"), "60 frames a second where"),
    "no rate": (lambda t: t.replace("\r\n30\t", "\r\nfast\t"), "DataRate is 'fast'"),
    "no names": (lambda t: re.sub("(Time|\n[0-9]+\t0[.][0-9]+)[^\r]*", r"\1", t), "names no joint"),
    "no frame": (lambda t: t[: t.index("\r\n1\t0.0")] + "\r\n\r\n", "holds no frame"),
    "no tabs": (lambda t: t.replace("\t", " "), "line 7: one cell, '1 0.0 "),
}


@pytest.mark.parametrize("mistake", TRC_MISTAKES)
def test_a_trc_that_is_none_is_refused(truth: TrueCapture, tmp_path: Path, mistake: str) -> None:
    edit, line = TRC_MISTAKES[mistake]
    path = tmp_path / "x.trc"
    write_trc(path, truth.joints_m)
    path.write_bytes(edit(path.read_bytes().decode()).encode())
    with pytest.raises(PzcapError) as error:
        read(path, truth, PLAIN)
    assert line in str(error.value)
    assert len(str(error.value)) < 250 + len(str(path))


def test_a_blank_line_between_frames_is_a_frame_without_an_answer(truth: TrueCapture, tmp_path: Path) -> None:
    write_trc(tmp_path / "x.trc", truth.joints_m)
    lines = (tmp_path / "x.trc").read_text().split("\n")
    (tmp_path / "x.trc").write_text("\n".join([*lines[:11], "", *lines[12:]]))
    body = read(tmp_path / "x.trc", truth, PLAIN).body
    assert body is not None
    np.testing.assert_array_equal(np.flatnonzero(~body.valid.all(axis=1)), [5])


def test_where_nothing_is_scored_a_line_says_what_to_give(truth: TrueCapture, tmp_path: Path) -> None:
    with pytest.raises(PzcapError, match=r"x\.trc: there is nothing; give"):
        read(tmp_path / "x.trc", truth, PLAIN)
    (tmp_path / "out" / "walk").mkdir(parents=True)
    (tmp_path / "out" / "walk" / "results.json").write_text("{}")  # as an export leaves it
    with pytest.raises(PzcapError, match="out/walk is one"):
        read(tmp_path / "out", truth, PLAIN)
    (tmp_path / "joints.csv").write_text("frame,joint,x_m,y_m,z_m\n")
    for path in (tmp_path, tmp_path / "joints.csv"):
        with pytest.raises(PzcapError, match=r"joints\.csv alone says not .*; write results\.json beside it"):
            read(path, truth, PLAIN)
    (tmp_path / "names.csv").write_text("theirs,joint\n")
    with pytest.raises(PzcapError, match="holds no name"):
        joint_names(tmp_path / "names.csv")
    (tmp_path / "results.json").write_text("{}")
    with pytest.raises(PzcapError, match="are of TRC, C3D and BVH; this is none"):
        read(tmp_path, truth, Conventions(unit="mm"))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("value", ["inf", "-1e400", "1e200"])
def test_a_number_that_is_no_place_is_a_joint_without_an_answer(truth: TrueCapture, tmp_path: Path, value: str) -> None:
    write_trc(tmp_path / "x.trc", truth.joints_m)
    lines = (tmp_path / "x.trc").read_text().split("\n")
    lines[8] = "\t".join([*lines[8].split("\t")[:2], value, *lines[8].split("\t")[3:]])
    (tmp_path / "x.trc").write_text("\n".join(lines))
    body = read(tmp_path / "x.trc", truth, PLAIN).body
    assert body is not None
    np.testing.assert_array_equal(np.argwhere(~body.valid), [[2, 0]])
    assert suspicions(read(tmp_path / "x.trc", truth, PLAIN), truth) == []
