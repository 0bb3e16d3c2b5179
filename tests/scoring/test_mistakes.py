"""Mistakes that people make when they write results: each is refused, or named as suspect, in one line."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pzcap.scoring.command import REFUSED, SUSPICIOUS, main
from pzcap.scoring.suspicions import suspicions
from pzcap.types import JOINTS
from tests.scenes.plain import edited, good, header, written

Rows = list[dict[str, str]]
ROTATION = [f"r{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3)]
PLACE = ("x_m", "y_m", "z_m")


def every(**changes: Callable[[dict[str, str]], Any]) -> Callable[[Rows], Rows]:
    """Rows with columns set to what a function of the row gives."""

    def edit(rows: Rows) -> Rows:
        return [row | {name: str(change(row)) for name, change in changes.items()} for row in rows]

    return edit


def rotation_of(row: dict[str, str]) -> np.ndarray:
    return np.array([float(row[name]) for name in ROTATION]).reshape(3, 3)


def posed(row: dict[str, str], rotation: np.ndarray, place: np.ndarray) -> dict[str, str]:
    named = zip((*ROTATION, *PLACE), (*rotation.ravel(), *place), strict=True)
    return row | {name: repr(float(value)) for name, value in named}


def poses(change: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]) -> Callable[[Rows], Rows]:
    def edit(rows: Rows) -> Rows:
        return [posed(r, *change(rotation_of(r), np.array([float(r[name]) for name in PLACE]))) for r in rows]

    return edit


def requaternioned(rotation: np.ndarray) -> np.ndarray:
    """The rotation of a quaternion that was written x, y, z, w and read as w, x, y, z."""
    return Rotation.from_quat(Rotation.from_matrix(rotation).as_quat()[[1, 2, 3, 0]]).as_matrix()


def places(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Rows], Rows]:
    def edit(rows: Rows) -> Rows:
        found = [change(np.array([float(row[name]) for name in PLACE])) for row in rows]
        return [put(row, at) for row, at in zip(rows, found, strict=True)]

    return edit


def put(row: dict[str, str], place: np.ndarray) -> dict[str, str]:
    return row | {name: repr(float(value)) for name, value in zip(PLACE, place, strict=True)}


def scaled(name: str, factor: float) -> Callable[[dict[str, str]], float]:
    return lambda row: factor * float(row[name])


def first(**values: str) -> Callable[[Rows], Rows]:
    return lambda rows: [rows[0] | values, *rows[1:]]


def renamed(names: dict[str, str], column: str) -> Callable[[Rows], Rows]:
    return lambda rows: [row | {column: names.get(row[column], row[column])} for row in rows]


def without(*columns: str) -> Callable[[Rows], Rows]:
    return lambda rows: [{name: cell for name, cell in row.items() if name not in columns} for row in rows]


Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # (x, y, z) to (x, z, -y)
Z_TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
MIRROR = {n: n.replace("left", "L").replace("right", "left").replace("L", "right") for n in JOINTS}
SORTED = dict(zip(JOINTS, sorted(JOINTS), strict=True))

REFUSALS: dict[str, tuple[str, Callable[[Rows], Rows], str]] = {
    "not a number": ("cameras.csv", first(focal_px="n/a"), r"line 2: focal_px 'n/a' is no number"),
    "NaN": ("cameras.csv", first(x_m="nan"), r"line 2: x_m is nan; leave the row out"),
    "infinite": ("joints.csv", first(z_m="inf"), r"line 2: z_m is inf"),
    "empty cell": ("cameras.csv", first(k1="", x_m=""), r"line 2: x_m is empty"),
    "no rotation": ("cameras.csv", first(r11="2.0"), r"line 2: r11 to r33 are no rotation"),
    "left-handed": ("cameras.csv", poses(lambda r, t: (r * [-1, 1, 1], t)), r"line 2: .* mirrored"),
    "focal below zero": ("cameras.csv", first(focal_px="-500"), r"line 2: focal_px is -500"),
    "frames from one": ("cameras.csv", every(frame=lambda r: int(r["frame"]) + 1), r"count them from 0, not from 1"),
    "joints from one": ("joints.csv", every(frame=lambda r: int(r["frame"]) + 1), r"count them from 0, not from 1"),
    "frame beyond the end": ("cameras.csv", first(frame="77"), r"line 2: frame 77 of 20"),
    "frame a fraction": ("cameras.csv", first(frame="0.5"), r"line 2: frame is 0.5; write a whole number"),
    "frame twice": ("cameras.csv", lambda rows: [*rows, rows[0]], r"line 82: camera 1 has frame 0 twice"),
    "joint twice": ("joints.csv", lambda rows: [*rows, rows[0]], r"frame 0 has pelvis twice"),
    "unknown camera": ("cameras.csv", first(camera="cam1"), r"line 2: no camera 'cam1' in results.json"),
    "unknown joint": ("joints.csv", first(joint="left_elbw"), r"no joint 'left_elbw'; did you mean 'left_elbow'"),
    "unknown column": ("cameras.csv", lambda rows: [r | {"focal_mm": "35"} for r in rows], r"did you mean 'focal_px'"),
    "column missing": ("cameras.csv", without("focal_px"), r"no column 'focal_px'"),
    "half a pose": ("cameras.csv", without("r33"), r"no column 'r33'; a pose has all of"),
    "negative variance": ("cameras.csv", first(var_pan="-1e-8"), r"line 2: var_pan.* are no covariance"),
    "correlation above one": ("cameras.csv", first(cov_pan_logf="1.0"), r"are no covariance"),
    "negative sigma": ("joints.csv", first(sigma_m="-0.01"), r"line 2: sigma_m is -0.01"),
    "valid in words": (
        "joints.csv",
        lambda rows: [r | {"valid": "yes"} for r in rows],
        r"valid is 'yes'; write 0 or 1",
    ),
}


@pytest.mark.parametrize("mistake", REFUSALS)
def test_what_cannot_be_meant_is_refused(mistake: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    results, truth = written(tmp_path)
    name, edit, line = REFUSALS[mistake]
    edited(results / name, edit)
    assert main([str(results), str(truth), "--check"]) == REFUSED
    assert main([str(results), str(truth)]) == REFUSED  # nor is it scored
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 2
    assert said[0].startswith(f"error: {results / name}")
    assert re.search(line, said[0]), said[0]


SUSPECTS: dict[str, tuple[str, Callable[[Rows], Rows], str]] = {
    "pan in degrees": ("cameras.csv", every(pan_rad=scaled("pan_rad", 180 / np.pi)), "pan_rad is in degrees"),
    "pan to the right": ("cameras.csv", every(pan_rad=scaled("pan_rad", -1.0)), "positive to the right"),
    "pan as a compass has it": (
        "cameras.csv",
        every(pan_rad=lambda r: 0.9 - float(r["pan_rad"])),
        "positive to the right, and off by 51.6 degrees",
    ),
    "pan from behind": (
        "cameras.csv",
        every(pan_rad=lambda r: float(r["pan_rad"]) + np.pi),
        "180.0 degrees in every frame",
    ),
    "pan from north": ("cameras.csv", every(pan_rad=lambda r: float(r["pan_rad"]) + 0.7), "off by 40.1 degrees"),
    "transposed rotation": ("cameras.csv", poses(lambda r, t: (r.T, t)), "rotation is transposed"),
    "world to camera": ("cameras.csv", poses(lambda r, t: (r.T, -r.T @ t)), "pose is world to camera"),
    "OpenGL axes": ("cameras.csv", poses(lambda r, t: (r * [1, -1, -1], t)), "camera axes are y up"),
    "cameras y up": ("cameras.csv", poses(lambda r, t: (Y_UP @ r, Y_UP @ t)), "world has other axes (y is up"),
    "quaternions w last": ("cameras.csv", poses(lambda r, t: (requaternioned(r), t)), "quaternion in another order"),
    "cameras turned": ("cameras.csv", poses(lambda r, t: (Z_TURN @ r, Z_TURN @ t)), "(turned by 90 degrees about z)"),
    "cameras of another origin": (
        "cameras.csv",
        poses(lambda r, t: (Y_UP @ r, 0.3 * (Y_UP @ t) + [1, 2, 3])),
        "the cameras' world is another one (turned by 90.0 degrees, 0.3 times as large",
    ),
    "cameras in millimetres": ("cameras.csv", places(lambda t: 1000.0 * t), "1000 times too far"),
    "cameras in centimetres": ("cameras.csv", places(lambda t: 100.0 * t), "100 times too far"),
    "half a pixel": (
        "cameras.csv",
        every(cx_px=lambda r: float(r["cx_px"]) + 0.5, cy_px=lambda r: float(r["cy_px"]) + 0.5),
        "cx_px and cy_px are +0.5 px off",
    ),
    "swapped cameras": ("cameras.csv", renamed({"1": "2", "2": "1"}, "camera"), "camera 1 stands where camera 2 does"),
    "focal in millimetres": ("cameras.csv", every(focal_px=scaled("focal_px", 36.0 / 320)), "focal_px is 0.1"),
    "image resized": ("cameras.csv", every(focal_px=scaled("focal_px", 1.5)), "of a resized image"),
    "k1 the other way": ("cameras.csv", every(k1=scaled("k1", -1.0)), "k1 has the other sign"),
    "a frame late": (
        "cameras.csv",
        lambda rows: [r | {"frame": str(int(r["frame"]) - 1)} for r in rows if int(r["frame"]) > 0],
        "frames are those 1 later",
    ),
    "variance in degrees": ("cameras.csv", every(var_pan=lambda _: 1.0, cov_pan_logf=lambda _: 0.0), "var_pan claims"),
    "variance of pixels": (
        "cameras.csv",
        every(var_logf=lambda _: 4.0, cov_pan_logf=lambda _: 0.0),
        "var_logf is above",
    ),
    "joints in millimetres": ("joints.csv", places(lambda t: 1000.0 * t), "1000 times too far"),
    "joints y up": ("joints.csv", places(lambda t: Y_UP @ t), "joints have other axes (y is up"),
    "joints z down": ("joints.csv", places(lambda t: t * [1, -1, -1]), "joints have other axes (z is down"),
    "joints turned": ("joints.csv", places(lambda t: Z_TURN @ t), "(turned by 90 degrees about z)"),
    "joints turned about": ("joints.csv", places(lambda t: t * [-1, -1, 1]), "(turned by 180 degrees about z)"),
    "joints mirrored": ("joints.csv", places(lambda t: t * [1, -1, 1]), "mirrored: x, y, z of the world are x, -y, z"),
    "joints of another origin": ("joints.csv", places(lambda t: np.add(t, (0, 0, 2))), "its middle 2.00 m away"),
    "joints divided by 1000": ("joints.csv", places(lambda t: 0.001 * t), "1000 times too near"),
    "joints in tens": ("joints.csv", places(lambda t: 10.0 * t), "10 times too far"),
    "a knee for the other": (
        "joints.csv",
        renamed({"left_knee": "right_knee", "right_knee": "left_knee"}, "joint"),
        "2 joints lie where others are (left_knee at right_knee)",
    ),
    "joints in another order": ("joints.csv", renamed(SORTED, "joint"), "joints lie where others are"),
    "left is right": ("joints.csv", renamed(MIRROR, "joint"), "left and right joints are exchanged"),
    "joints a frame late": (
        "joints.csv",
        lambda rows: [r | {"frame": str(int(r["frame"]) - 1)} for r in rows if int(r["frame"]) > 0],
        "joints are those 1 frames later",
    ),
    "joints many frames late": (
        "joints.csv",
        lambda rows: [r | {"frame": str(int(r["frame"]) - 7)} for r in rows if int(r["frame"]) > 6],
        "joints are those 7 frames later",
    ),
    "sigma in millimetres": ("joints.csv", every(sigma_m=lambda _: 12.0), "sigma_m is above a metre"),
}


@pytest.mark.parametrize("mistake", SUSPECTS)
def test_what_reads_well_and_is_not_meant_is_named(
    mistake: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    results, truth = written(tmp_path)
    name, edit, line = SUSPECTS[mistake]
    edited(results / name, edit)
    assert main([str(results), str(truth), "--check"]) == SUSPICIOUS
    said = capsys.readouterr().err.splitlines()
    assert any(line in each for each in said), said
    assert all(each.startswith("suspicious: truth: ") for each in said)
    assert len(said) <= 8  # a line a camera, and what follows from it
    assert main([str(results), str(truth)]) == SUSPICIOUS  # scored all the same
    assert "panzoom.pan.rms" in capsys.readouterr().out


def test_a_frame_late_shows_of_somebody_who_walks() -> None:
    results, truth = good()
    assert results.body is not None
    walked = truth.joints_m[0] + np.arange(results.frames)[:, None, None] * np.array([0.02, 0.0, 0.0])
    late = replace(results.body, joints_m=walked + np.array([0.02, 0.001, 0.0]))
    walking = replace(truth, joints_m=walked)
    assert any("joints are those 1 frames later" in line for line in suspicions(replace(results, body=late), walking))
    right = replace(results.body, joints_m=walked + np.array([0.012, 0.0, 0.0]))  # off, and no other frame's
    assert not any("joints are" in line for line in suspicions(replace(results, body=right), walking))


def relative(rows: Rows) -> Rows:
    found = [np.array([float(r[name]) for name in PLACE]) for r in rows]
    roots = {r["frame"]: at for r, at in zip(rows, found, strict=True) if r["joint"] == "pelvis"}
    return [put(r, at - roots[r["frame"]]) for r, at in zip(rows, found, strict=True)]


def unfound(rows: Rows) -> Rows:
    return [put(r, np.zeros(3)) if r["frame"] in ("3", "7") else r for r in rows]


@pytest.mark.parametrize(
    ("name", "edit", "line"),
    [
        ("joints.csv", relative, "the pelvis is at the origin"),
        ("cameras.csv", every(focal_px=lambda _: 35.0), "focal_px is far below the image's width"),
        ("cameras.csv", places(lambda t: 1000.0 * t), "stands hundreds of metres away"),
        ("joints.csv", places(lambda t: 1000.0 * t), "joints lie hundreds of metres away"),
        ("cameras.csv", every(pan_rad=lambda _: 123.0), "beyond a full turn: degrees?"),
        ("joints.csv", lambda rows: [r | {"valid": "0"} for r in rows], "no joint is valid"),
        ("joints.csv", unfound, "32 joints are exactly at 0, 0, 0, the first in frame 3: not found?"),
    ],
)
def test_some_mistakes_show_without_the_truth(
    name: str, edit: Callable[[Rows], Rows], line: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    results, _ = written(tmp_path)
    edited(results / name, edit)
    assert main(["--check", str(results)]) == SUSPICIOUS
    assert line in capsys.readouterr().err


@pytest.mark.parametrize(
    ("values", "line"),
    [
        ({"frames": 21, "timecodes": None}, "21 frames where the capture has 20"),
        ({"frames": 19}, "20 timecodes for 19 frames"),
        ({"frames": -3}, "frames is -3"),
        ({"image_size": [1280, 960]}, "image_size is [1280, 960] where the images are [320, 260]"),
        ({"cameras": ["1", "2", "3", "4", "5"]}, "knows no '5'"),
        ({"cameras": ["1", "1"]}, "cameras is"),
        ({"version": 2}, "version 2; this scorer reads version 1"),
        ({"format": "bop19"}, '"format" is not "pzcap-results"'),
        ({"methods": "x"}, "unknown key 'methods'; did you mean 'method'?"),
        ({"method": None}, "no 'method'"),
        ({"keyframes": [20]}, "keyframe 20 of 20 frames"),
    ],
)
def test_a_header_that_does_not_fit_is_refused(
    values: dict[str, Any], line: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    results, truth = written(tmp_path)
    header(results, **values)
    assert main(["--check", str(results), str(truth)]) == REFUSED
    said = capsys.readouterr().err
    assert line in said
    assert said.count("\n") == 1


def test_files_that_are_none_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    results, truth = written(tmp_path)
    (results / "results.json").write_text("{not json")
    assert main([str(results), str(truth)]) == REFUSED
    assert "is no JSON" in capsys.readouterr().err
    header_only = tmp_path / "empty"
    header_only.mkdir()
    json.dump(
        {"format": "pzcap-results", "version": 1, "method": "x", "frames": 20}, (header_only / "results.json").open("w")
    )
    assert main([str(header_only), str(truth)]) == REFUSED
    assert "neither cameras.csv nor joints.csv" in capsys.readouterr().err
    for given in (str(tmp_path / "nothing"), str(tmp_path)):
        assert main([given, str(truth)]) == REFUSED
        assert "give a folder with results.json" in capsys.readouterr().err
    assert main([str(results), str(results)]) == REFUSED
    assert "holds no truth.json" in capsys.readouterr().err
    assert main([str(results)]) == REFUSED
    assert "a score needs the truth" in capsys.readouterr().err


def test_rows_with_commas_in_their_numbers_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    results, truth = written(tmp_path)
    path = results / "joints.csv"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([lines[0], lines[1].replace(".", ","), *lines[2:]]))
    assert main([str(results), str(truth)]) == REFUSED
    assert "line 2: 10 cells where the first line names 6 columns; numbers have a point" in capsys.readouterr().err


@pytest.mark.parametrize("mark", [";", "\t"])
def test_other_marks_between_columns_are_named(mark: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    results, truth = written(tmp_path)
    path = results / "joints.csv"
    path.write_text(path.read_text().replace(",", mark))
    assert main([str(results), str(truth)]) == REFUSED
    assert "write commas between columns" in capsys.readouterr().err


def test_a_damaged_truth_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    results, truth = written(tmp_path)
    edited(truth / "joints.csv", lambda rows: rows[:-1])
    assert main([str(results), str(truth)]) == REFUSED
    assert "the truth is damaged" in capsys.readouterr().err
