"""Cameras that stand in metres, and what lengths in the hall say of their unit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from experiments.footage import SMALL
from pzcap.camera_set import calibrated_of
from pzcap.io.capture import read_capture
from pzcap.pipeline import Config
from pzcap.scale_by_lengths import Measured, scale_by_lengths
from pzcap.types import Array, Capture, KnownLength, Mark, Reconstruction
from pzcap.views import ViewLocaliser
from sim.measuring import best_seen
from sim.session import assemble

pytestmark = pytest.mark.xdist_group("pipeline")
POINTS_M = np.array([[1.0, -0.5, 0.0], [-1.2, 0.8, 0.0], [0.6, 1.4, 1.2], [-0.8, -1.1, 0.6]])


@pytest.fixture(scope="module")
def take(small_capture: Path, small_run: Reconstruction) -> Iterator[tuple[Capture, ViewLocaliser]]:
    capture = read_capture(small_capture / "capture")
    with ThreadPoolExecutor(2) as pool:
        yield capture, ViewLocaliser(calibrated_of(small_run), Config().panzoom, pool, capture.frame_rate)


def marks(point_m: Array, cameras: Sequence[int]) -> tuple[Mark, ...]:
    """A point in the sweep of each of the cameras, to the pixel."""
    session = assemble(SMALL)
    found = []
    for c in cameras:
        frame, px, _ = best_seen(session, c, point_m)
        found.append(Mark(session.config.camera_names[c], "sweep", frame, px))
    return tuple(found)


def between(name: str, one: int, other: int, factor: float = 1.0, cameras: Sequence[int] = (0, 2)) -> KnownLength:
    """The length between two of the points, read ``factor`` times as long."""
    length_m = factor * float(np.linalg.norm(POINTS_M[one] - POINTS_M[other]))
    return KnownLength(name, length_m, 0.002, (marks(POINTS_M[one], cameras), marks(POINTS_M[other], cameras)))


def measured(take: tuple[Capture, ViewLocaliser], run: Reconstruction, *lengths: KnownLength) -> Measured:
    capture, localise = take
    return scale_by_lengths(replace(capture, lengths=lengths), calibrated_of(run), np.full(4, 0.003), 0.003, localise)


def test_metres_are_metres(take: tuple[Capture, ViewLocaliser], small_run: Reconstruction) -> None:
    lengths = [between("a", 0, 1), between("b", 2, 3), between("floor", 0, 1, cameras=[0])]
    found = measured(take, small_run, *lengths)
    assert found.notes == ()
    assert found.scale is not None
    assert abs(found.scale.factor - 1.0) < min(3.0 * found.scale.sigma, 0.004)


def test_a_reading_of_feet_is_named(take: tuple[Capture, ViewLocaliser], small_run: Reconstruction) -> None:
    found = measured(take, small_run, between("a", 0, 1), between("b", 2, 3), between("feet", 0, 3, factor=3.28))
    assert found.scale is not None
    assert abs(found.scale.factor - 1.0) < 0.005
    assert [note.split('"')[1] for note in found.notes] == ["feet"]


def test_marks_of_different_points_are_named(take: tuple[Capture, ViewLocaliser], small_run: Reconstruction) -> None:
    right, wrong = between("right", 2, 3), between("wrong", 0, 1)
    elsewhere = replace(wrong.ends[0][0], px=wrong.ends[0][0].px + np.array([0.0, 60.0]))
    wrong = replace(wrong, ends=((elsewhere, *wrong.ends[0][1:]), wrong.ends[1]))
    found = measured(take, small_run, right, wrong)
    assert found.scale is not None
    assert abs(found.scale.factor - 1.0) < 0.005
    assert len(found.notes) == 1
    assert '"wrong" is left out: the marks of one end ("from") show different points' in found.notes[0]


def test_two_that_contradict_each_other_are_named(
    take: tuple[Capture, ViewLocaliser], small_run: Reconstruction
) -> None:
    found = measured(take, small_run, between("a", 0, 1), between("feet", 2, 3, factor=3.28))
    assert found.scale is not None
    (note,) = found.notes
    assert '"a" and "feet" contradict each other, and nothing tells which is right' in note


def test_a_mark_of_no_floor_names_its_end(take: tuple[Capture, ViewLocaliser], small_run: Reconstruction) -> None:
    one = between("sky", 0, 1, cameras=[0])
    (above,) = marks(np.array([-4.0, 3.0, 3.5]), [0])  # seen over the horizon
    found = measured(take, small_run, replace(one, ends=(one.ends[0], (above,))))
    assert found.scale is None
    assert 'the marks of the other end ("to") show no point: their lines of sight' in found.notes[0]


def test_lengths_that_tell_nothing_say_so(take: tuple[Capture, ViewLocaliser], small_run: Reconstruction) -> None:
    one = between("none", 0, 1)
    found = measured(take, small_run, replace(one, ends=(one.ends[0], one.ends[0])))
    assert found.scale is None
    assert "one and the same point" in found.notes[0]


def test_a_mark_in_a_video_that_was_not_brought_is_named(
    take: tuple[Capture, ViewLocaliser], small_run: Reconstruction
) -> None:
    capture, localise = take
    first = replace(capture.cameras[0], sweep=None)
    lengths = (between("a", 0, 1), between("b", 2, 3, cameras=[1, 2]))
    brought = replace(capture, cameras=(first, *capture.cameras[1:]), lengths=lengths)
    found = scale_by_lengths(brought, calibrated_of(small_run), np.full(4, 0.003), 0.003, localise)
    assert found.scale is not None
    assert found.notes == (f'lengths.json: "a" is left out: camera {first.name} has no sweep; mark another picture',)
