"""Cameras whose clocks differ: without timecode, of other rates, of stamps that tremble or vary."""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pzcap.io.capture import FrameSets, frame_sets, read_capture
from pzcap.io.clocks import read_sync
from pzcap.io.video import VideoReader
from pzcap.types import FrameSet, PzcapError
from tests.fuzz.mutations import changed_json, damaged_bytes
from tests.scenes.recorders import encode, number, pictures

RATE = Fraction(30)


def capture(
    folder: Path, motions: dict[str, Path], sync: list[dict[str, Any]] | None = None, rate: Fraction = RATE
) -> Path:
    content: dict[str, Any] = {
        "format": "pzcap-capture", "version": 1, "name": "clocks", "frame_rate": f"{rate.numerator}/{rate.denominator}",
        "full_turn": False, "cameras": [{"name": name, "motion": path.name} for name, path in motions.items()],
    }  # fmt: skip
    if sync is not None:
        content["sync"] = "sync.json"
        (folder / "sync.json").write_text(json.dumps({"format": "pzcap-sync", "version": 1, "cameras": sync}))
    (folder / "capture.json").write_text(json.dumps(content))
    return folder


def clock(name: str, offset_s: float, **more: float) -> dict[str, Any]:
    return {"name": name, "offset_s": offset_s, "rate": 1.0, "sigma_s": 0.01} | more


def shown(sets: FrameSets) -> list[tuple[int | None, ...]]:
    def row(each: FrameSet) -> tuple[int | None, ...]:
        return tuple(None if image is None else number(image) for image in each.images)

    return [row(each) for each in sets]


def sets_of(folder: Path) -> FrameSets:
    return frame_sets(read_capture(folder))


def test_offsets_bring_pictures_together(tmp_path: Path) -> None:
    """0.2 s are 6 frames; cameras that are not locked to each other are less than half a frame off."""
    one, other = (encode(tmp_path / f"{k}.mp4", pictures(20), RATE) for k in "ab")
    sync = [clock("a", 0.0), clock("b", -0.2 - 0.4 / 30)]
    sets = sets_of(capture(tmp_path, {"a": one, "b": other}, sync))
    assert shown(sets) == [(k, k + 6) for k in range(14)]
    assert sets.timecodes[0] == "00:00:00:00"
    assert sets.people(0) == ()
    later = [clock("a", 1.0), clock("b", 1.5)]
    assert sets_of(capture(tmp_path, {"a": one, "b": other}, later)).timecodes[0] == "00:00:01:15"


def test_pictures_are_never_taken_twice_however_the_offset_falls(tmp_path: Path) -> None:
    """Half a frame, where rounding of single pictures would take some twice."""
    one, other = (encode(tmp_path / f"{k}.mp4", pictures(20), RATE) for k in "ab")
    found = shown(sets_of(capture(tmp_path, {"a": one, "b": other}, [clock("a", 0.0), clock("b", 0.5 / 30)])))
    assert {second - first for first, second in found if first is not None and second is not None} in ({0}, {-1})


@pytest.mark.parametrize(
    ("own", "rate", "every"),
    [(Fraction(60), RATE, 2), (Fraction(120), RATE, 4), (Fraction(60000, 1001), Fraction(30000, 1001), 2)],
)
def test_a_faster_camera_gives_every_nth_picture(own: Fraction, rate: Fraction, every: int, tmp_path: Path) -> None:
    slow = encode(tmp_path / "a.mov", pictures(10), rate, timecode="10:00:00:05")
    fast = encode(tmp_path / "b.mov", pictures(40), own, timecode=f"10:00:00:{every * 5 - 3:02d}")
    sets = sets_of(capture(tmp_path, {"a": slow, "b": fast}, rate=rate))
    assert shown(sets)[:4] == [(k, every * k + 3) for k in range(4)]
    assert sets.timecodes[0] == "10:00:00:05"


def test_slow_motion_is_told_by_its_rate(tmp_path: Path) -> None:
    """120 a second, stored to be shown at 30: a second passes while it shows four."""
    usual = encode(tmp_path / "a.mp4", pictures(10), RATE)
    slow = encode(tmp_path / "b.mp4", pictures(40), RATE)
    sync = [clock("a", 0.0), clock("b", 0.0, rate=0.25)]
    assert shown(sets_of(capture(tmp_path, {"a": usual, "b": slow}, sync)))[:5] == [(k, 4 * k) for k in range(5)]


def test_a_rate_that_is_no_multiple_gets_one_line(tmp_path: Path) -> None:
    paths = {
        "a": encode(tmp_path / "a.mp4", pictures(9), RATE),
        "b": encode(tmp_path / "b.mp4", pictures(9), RATE * 5 / 6),
    }
    with pytest.raises(PzcapError, match=r"b\.mp4: has 25 frames/s where capture\.json says 30; .* whole multiple"):
        read_capture(capture(tmp_path, paths, [clock("a", 0.0), clock("b", 0.0)]))


def test_stamps_that_tremble_are_of_a_constant_rate(tmp_path: Path) -> None:
    """Up to three quarters of a frame: rounded one by one, some would meet in one frame and leave others empty."""
    rng = np.random.default_rng(3)
    times = np.sort((np.arange(30) + rng.uniform(-0.75, 0.75, 30)).clip(0)) / 30
    times += np.arange(30) * 1e-4
    reader = VideoReader(encode(tmp_path / "a.mp4", pictures(30), RATE, times_s=times.tolist()))
    assert reader.constant_rate
    assert reader.frame_rate == RATE
    assert [(index, number(image)) for index, image in reader] == [(k, k) for k in range(30)]


def test_a_varying_rate_is_used_by_its_stamps(tmp_path: Path) -> None:
    """A phone that slows down in the dark: the nearest picture, and how late it is."""
    even = encode(tmp_path / "a.mp4", pictures(30), RATE)
    times = np.cumsum([0.0, *np.linspace(1 / 32, 1 / 24, 29)])
    reader = VideoReader(encode(tmp_path / "b.mp4", pictures(30), RATE, times_s=times.tolist()))
    assert not reader.constant_rate
    np.testing.assert_allclose(reader.times_s, times, atol=1e-4)
    sets = sets_of(capture(tmp_path, {"a": even, "b": reader.path}, [clock("a", 0.0), clock("b", 0.0)]))
    for each in sets:
        first, second = each.images
        assert first is not None
        nearest = int(np.argmin(np.abs(times - each.index / 30)))
        if abs(times[nearest] * 30 - each.index) < 0.49:
            assert second is not None
            assert number(second) == nearest
            assert each.late == pytest.approx((0.0, times[nearest] * 30 - each.index), abs=0.01)


@pytest.mark.parametrize(
    ("sync", "says"),
    [
        ([clock("a", 0.0)], r'sync\.json says nothing of camera "b"'),
        ([clock("a", 0.0), clock("a", 0.0), clock("b", 0.0)], r'camera "a" stands there twice'),
        ([clock("a", 0.0), clock("b", 1e6)], r"offset_s: is 1e\+06 s, where 86400 are the most"),
        ([clock("a", 0.0), clock("b", 0.0, rate=0.0)], r"rate: is 0; it is the seconds that pass"),
        ([clock("a", 0.0), clock("b", 0.0, sigma_s=-1.0)], r"must be a standard deviation in seconds"),
        ([clock("a", 0.0), clock("b", 0.0, ofset=1.0)], r'unknown entry "ofset"'),
        ([clock("a", 0.0), clock("b", 30.0)], r"no time by sync\.json in common"),
    ],
)
def test_a_sync_file_that_is_wrong_gets_one_line(sync: list[dict[str, Any]], says: str, tmp_path: Path) -> None:
    paths = {name: encode(tmp_path / f"{name}.mp4", pictures(6), RATE) for name in "ab"}
    with pytest.raises(PzcapError, match=says):
        sets_of(capture(tmp_path, paths, sync))


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_damaged_sync_file_is_a_result_or_one_line(data: st.DataObject, tmp_path: Path) -> None:
    whole = {"format": "pzcap-sync", "version": 1, "cameras": [clock("a", 0.0, rate=1.0), clock("b", -1.5)]}
    content = json.dumps(whole).encode()
    path = tmp_path / "sync.json"
    path.write_bytes(data.draw(st.one_of(changed_json(content), damaged_bytes(content))))
    try:
        clocks = read_sync(path)
    except PzcapError:
        return
    assert all(np.isfinite([each.offset_s, each.rate, each.sigma_s]).all() for each in clocks.values())
