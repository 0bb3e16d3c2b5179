"""Files of other programs at another frame rate, with another first frame, with gaps, or more frames than there are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pzcap.scoring.command import REFUSED, SUSPICIOUS, main
from pzcap.scoring.readers.conventions import Conventions, joint_names
from pzcap.scoring.readers.read import read
from pzcap.scoring.records import TrueCapture
from pzcap.scoring.truth_files import write_truth
from pzcap.types import JOINTS, Array, Mask, PzcapError
from tests.scenes import plain

PLAIN = Conventions()


@pytest.fixture(scope="module")
def truth() -> TrueCapture:
    return plain.good()[1]


def write_trc(
    path: Path, joints_m: Array, numbers: Sequence[int], rate: float = 30.0, turn: Array | None = None
) -> None:
    """Joints (T, 16, 3) in millimetres, in the axes of Pose2Sim or, after a ``turn`` of the world, in others."""
    places = 1000.0 * (joints_m if turn is None else joints_m @ turn.T)[:, :, [1, 2, 0]]
    head = ["PathFileType\t4\t(X/Y/Z)\tx.trc", "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits",
            f"{rate}\t{rate}\t{len(places)}\t{len(JOINTS)}\tmm",
            "Frame#\tTime\t" + "\t\t\t".join(JOINTS), "\t\tX1"]  # fmt: skip
    rows = [
        "\t".join([str(number), f"{number / rate:.4f}", *(f"{value:.6f}" for value in row.ravel())])
        for number, row in zip(numbers, places, strict=True)
    ]
    path.write_text("\n".join(head + rows) + "\n")


def given(path: Path, truth: TrueCapture, said: Conventions = PLAIN) -> Mask:
    """The frames that a file gives, after a look at whether they are right."""
    body = read(path, truth, said).body
    assert body is not None
    np.testing.assert_allclose(body.joints_m[body.valid], truth.joints_m[body.valid], atol=1e-6)
    return body.valid.all(axis=1)


def test_rows_that_are_left_out_are_frames_without_an_answer(truth: TrueCapture, tmp_path: Path) -> None:
    kept = [frame for frame in range(20) if not 8 <= frame < 12]
    write_trc(tmp_path / "x.trc", truth.joints_m[kept], [frame + 1 for frame in kept])
    np.testing.assert_array_equal(np.flatnonzero(given(tmp_path / "x.trc", truth)), kept)


def test_a_count_that_begins_later_is_asked_about(truth: TrueCapture, tmp_path: Path) -> None:
    write_trc(tmp_path / "x.trc", truth.joints_m[5:], range(6, 21))
    with pytest.raises(PzcapError, match="begins with frame 6 of its own count; say --first-frame 5"):
        read(tmp_path / "x.trc", truth, PLAIN)
    frames = np.flatnonzero(given(tmp_path / "x.trc", truth, Conventions(first_frame=5)))
    np.testing.assert_array_equal(frames, range(5, 20))
    write_trc(tmp_path / "x.trc", truth.joints_m, range(101, 121))
    assert given(tmp_path / "x.trc", truth, Conventions(first_frame=0)).all()


@pytest.mark.parametrize(("rate", "many"), [(60.0, 2), (119.88, 4)])
def test_of_more_frames_a_second_those_count_that_both_have(
    rate: float, many: int, truth: TrueCapture, tmp_path: Path
) -> None:
    write_trc(tmp_path / "x.trc", np.repeat(truth.joints_m, many, axis=0), range(20 * many), rate)
    with pytest.raises(PzcapError, match=rf"{rate:g} frames a second where the capture has 30; say --rate {rate:g} to"):
        read(tmp_path / "x.trc", truth, PLAIN)
    assert given(tmp_path / "x.trc", truth, Conventions(rate=rate)).all()


def test_of_fewer_frames_a_second_too(truth: TrueCapture, tmp_path: Path) -> None:
    write_trc(tmp_path / "x.trc", truth.joints_m[::2], range(1, 11), 15.0)
    with pytest.raises(PzcapError, match="15 frames a second where the capture has 30"):
        read(tmp_path / "x.trc", truth, PLAIN)
    frames = np.flatnonzero(given(tmp_path / "x.trc", truth, Conventions(rate=15.0)))
    np.testing.assert_array_equal(frames, range(0, 20, 2))


def test_a_rate_that_is_none_of_ours_is_to_be_interpolated(truth: TrueCapture, tmp_path: Path) -> None:
    write_trc(tmp_path / "x.trc", truth.joints_m, range(20), 25.0)
    with pytest.raises(PzcapError, match="25 frames a second where the capture has 30; interpolate it to 30"):
        read(tmp_path / "x.trc", truth, PLAIN)
    assert given(tmp_path / "x.trc", truth, Conventions(rate=30.0)).all()  # the file says it wrongly


@pytest.mark.parametrize(
    ("numbers", "line"),
    [([1, 1, *range(2, 20)], "frame 1 is there twice"), ([*range(1, 20), 24], "20 frames from 0 on, of 20; see")],
)
def test_frames_that_cannot_be_are_refused(numbers: list[int], line: str, truth: TrueCapture, tmp_path: Path) -> None:
    write_trc(tmp_path / "x.trc", truth.joints_m, numbers)
    with pytest.raises(PzcapError, match=line):
        read(tmp_path / "x.trc", truth, PLAIN)


def test_c3d_says_its_rate_and_its_first_frame(truth: TrueCapture, tmp_path: Path) -> None:
    ezc3d = pytest.importorskip("ezc3d")
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    file["parameters"]["POINT"]["RATE"]["value"] = [60]
    file["parameters"]["POINT"]["LABELS"]["value"] = list(JOINTS)
    points = np.ones((4, len(JOINTS), 20))
    points[:3] = 1000.0 * np.repeat(truth.joints_m[10:], 2, axis=0).transpose(2, 1, 0)
    file["data"]["points"] = points
    file["header"]["points"]["first_frame"] = 20
    file.write(str(tmp_path / "x.c3d"))
    with pytest.raises(PzcapError, match="begins with frame 20 of its own count"):
        read(tmp_path / "x.c3d", truth, PLAIN)
    with pytest.raises(PzcapError, match="60 frames a second"):
        read(tmp_path / "x.c3d", truth, Conventions(first_frame=10))
    body = read(tmp_path / "x.c3d", truth, Conventions(first_frame=10, rate=60.0)).body
    assert body is not None
    np.testing.assert_array_equal(np.flatnonzero(body.valid.all(axis=1)), range(10, 20))


def test_axes_that_would_be_right_are_said(
    truth: TrueCapture, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The TRC of our own export has OpenSim's axes, and not those of Pose2Sim."""
    write_truth(truth, tmp_path / "truth")
    write_trc(tmp_path / "x.trc", truth.joints_m, range(20), turn=np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]]))
    told = [str(tmp_path / "x.trc"), str(tmp_path / "truth")]
    assert main(told) == SUSPICIOUS
    line = capsys.readouterr().err
    assert "joints have other axes (turned by 90 degrees about z): say --axes x,z,-y" in line
    assert main([*told, "--axes", "x,z,-y"]) == 0
    for rate in ("0", "thirty"):
        with pytest.raises(SystemExit):
            main([*told, "--rate", rate])
        assert f"{rate} is no number above 0" in capsys.readouterr().err


def test_a_table_that_does_not_fit_the_file_is_refused(
    truth: TrueCapture, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_truth(truth, tmp_path / "truth")
    write_trc(tmp_path / "x.trc", truth.joints_m, range(20))
    names = tmp_path / "names.csv"
    rows = "".join(f"{name},{name}\n" for name in JOINTS[:9])
    told = [str(tmp_path / "x.trc"), str(tmp_path / "truth"), "--joints", str(names)]
    for more, line in (
        ("left_hipp,left_hip\n", "no 'left_hipp', which the table of joints names; did you mean 'left_hip'?"),
        ("left_hip,pelvis\n", "line 11: 'pelvis' is there twice"),
        ("pelvis,left_hip\n", "line 11: 'pelvis' is there twice"),
    ):
        names.write_text("theirs,joint\n" + rows + more)
        assert main(told) == REFUSED
        assert line in capsys.readouterr().err
    names.write_text("theirs,joint\n" + rows)
    assert len(joint_names(names)) == 9
    assert main(told) == 0


def crossing(truth: TrueCapture) -> TrueCapture:
    """The ``truth`` of somebody who walks and does not come back."""
    walked = truth.joints_m[0] + np.arange(len(truth.joints_m))[:, None, None] * np.array([0.06, 0.01, 0.0])
    return replace(truth, joints_m=walked)


@pytest.mark.parametrize(
    ("frames", "line", "said"),
    [
        (range(0, 20, 2), "joints have 15 frames a second where the capture has 30: say --rate 15", ["--rate", "15"]),
        (np.repeat(range(10), 2), "joints have 60 frames a second where the capture has 30", ["--rate", "60"]),
        (range(12, 17), "joints are those 12 frames later: say --first-frame 12", ["--first-frame", "12"]),
        (range(1, 20), "joints are those 1 frames later: say --first-frame 1", ["--first-frame", "1"]),
    ],
)
def test_what_would_bring_the_frames_to_their_times_is_said(
    frames: Sequence[int], line: str, said: list[str] | None, truth: TrueCapture, tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    walking = crossing(truth)
    write_truth(walking, tmp_path / "truth")
    write_trc(tmp_path / "x.trc", walking.joints_m[list(frames)], range(len(frames)))
    told = [str(tmp_path / "x.trc"), str(tmp_path / "truth")]
    assert main(told) == SUSPICIOUS
    assert line in capsys.readouterr().err
    if said is not None:
        assert main([*told, *said]) == 0
