"""Trajectories from a table: do they do what it says, and is what is wrong in it named?"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pzcap.types import PzcapError
from sim.cameras.operator import OperatorConfig, Trajectory
from sim.cameras.optics import OpticsConfig, build_rig
from sim.cameras.trajectories import read_trajectories

RIGS = {name: build_rig(c, 640, 480, OpticsConfig(), np.random.default_rng(c)) for c, name in enumerate(("1", "2"))}
TABLE = """camera,frame,pan_deg,focal_px
1,0,-3.5,880
1,2,-1.0,900
1,5,4.0,1800

2,0,0,700
2,5,0,700
"""


def read(path: Path, table: str, end_s: float = 5 / 30) -> list[Trajectory]:
    path.write_text(table)
    return read_trajectories(path, RIGS, 30, end_s)


def test_the_hands_do_what_the_table_says(tmp_path: Path) -> None:
    first, second = read(tmp_path / "hands.csv", TABLE)
    for frame, pan_deg, focal_px in ((0, -3.5, 880.0), (2, -1.0, 900.0), (5, 4.0, 1800.0)):
        assert first.at(frame / 30) == pytest.approx((np.deg2rad(pan_deg), focal_px, 0.0, 0.0))
    assert second.at(0.1) == pytest.approx((0.0, 700.0, 0.0, 0.0))


def test_between_the_rows_nothing_overshoots_and_beyond_them_it_keeps_still(tmp_path: Path) -> None:
    (trajectory, _) = read(tmp_path / "hands.csv", TABLE)
    aims = np.array([trajectory.at(t) for t in np.linspace(0, 5 / 30, 100)])
    assert (np.diff(aims[:, :2], axis=0) > -1e-9).all()
    for before, end in ((-0.3, 0.0), (-100.0, 0.0), (9.0, 5 / 30)):
        assert trajectory.at(before) == pytest.approx(trajectory.at(end))


def test_seconds_tilt_and_any_order_of_columns(tmp_path: Path) -> None:
    table = "tilt_deg, focal_px, time_s, camera, pan_deg\n1,800,0,1,0\n2,800,1,1,5\n0,900,-0.5,2,0\n0,900,1.5,2,0\n"
    first, second = read(tmp_path / "hands.csv", table, 1.0)
    assert first.at(1.0) == pytest.approx((np.deg2rad(5.0), 800.0, np.deg2rad(2.0), 0.0))
    assert second.at(1.0) == pytest.approx((0.0, 900.0, 0.0, 0.0))


def decimal_commas(table: str) -> str:
    return table.replace(",", ";").replace(".", ",")


@pytest.mark.parametrize(
    "write",
    [
        decimal_commas,
        lambda table: table.replace(",", "\t"),
        lambda table: decimal_commas(table).replace(";", "\t"),
        lambda table: "\ufeff" + table.replace("\n", ",\r\n") + ",,,,\r\n,,,,\r\n",
        lambda table: table.replace("\n1,", "\n1.0,").replace("\n2,", "\n2.0,"),
        lambda table: "# exported from a head with encoders; 25 Hz\n\n" + table,
        lambda table: "\n".join(",".join(f'"{cell}"' for cell in row.split(",")) for row in table.split("\n") if row),
        lambda table: table.replace(",", ", "),
    ],
    ids=["semicolons", "tabs", "tabs, decimal commas", "empty cells", "1.0", "a remark", "quoted", "spaces"],
)
def test_a_table_as_spreadsheets_and_trackers_write_it(write: Callable[[str], str], tmp_path: Path) -> None:
    plain, other = read(tmp_path / "hands.csv", TABLE), read(tmp_path / "other.csv", write(TABLE))
    for one, same in zip(plain, other, strict=True):
        for t in (0.0, 0.05, 5 / 30):
            assert same.at(t) == pytest.approx(one.at(t))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("pan_deg", "pan", "line 1: the columns must be camera, time_s or frame, pan_deg, focal_px"),
        ("frame", "frame,time_s", "line 1: the columns must be"),
        (TABLE, "", "they are missing"),
        ("2,0,0,700", "3,0,0,700", "line 6: there is no camera '3'; there are 1, 2"),
        ("1,2,-1.0,900", "1,2,-1.0", "line 3: 3 values where 4 belong"),
        ("1,2,-1.0,900", "1,2,left,900", "line 3: pan_deg is 'left', which is no number"),
        ("1,2,-1.0,900", "1,2,nan,900", "line 3: pan_deg is 'nan'; it must be finite"),
        ("1,2,-1.0,900", "1,0,-1.0,900", "line 3: camera 1 goes back in time, or stands still, since line 2"),
        ("1,2,-1.0,900", "1,2,359,900", "line 3: pan_deg jumps by 362.5 since line 2"),
        ("1,2,-1.0,900", "1,2,-1.0,90", "line 3: focal_px is 90; the lens goes from 616 to 2640"),
        ("2,5,0,700", "2,4,0,700", "camera 2 has 0.000 to 0.133 s; it films from 0 to 0.167 s"),
        ("2,0,0,700\n2,5,0,700\n", "", "camera 2 has nothing"),
    ],
)
def test_what_is_wrong_is_named_with_its_line(old: str, new: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "hands.csv"
    assert old in TABLE
    with pytest.raises(PzcapError) as caught:
        read(path, TABLE.replace(old, new, 1))
    assert str(caught.value).startswith(f"{path}: ")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_is_no_table_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PzcapError, match="cannot read the trajectories: No such file"):
        read_trajectories(tmp_path / "none.csv", RIGS, 30, 1.0)
    (tmp_path / "video.csv").write_bytes(b"\xff\x00\x81")
    with pytest.raises(PzcapError, match="it is not a table of text"):
        read_trajectories(tmp_path / "video.csv", RIGS, 30, 1.0)


def test_what_would_be_without_effect_is_refused() -> None:
    with pytest.raises(PzcapError, match="swing_deg_s, zoom_swing_s and tilts have no effect"):
        replace(OperatorConfig(trajectories="hands.csv"), tilts=True)
