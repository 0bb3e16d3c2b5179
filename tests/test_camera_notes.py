"""Notes on what a camera does: a tripod that is bumped or rocks, a floor that rings."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from pzcap.camera_notes import bump, camera_notes, rocking, stabilised
from pzcap.types import PanZoomTrack
from tests.scenes import fabricated

TIMECODES = tuple(f"10:00:{frame // 30:02}:{frame % 30:02}" for frame in range(90))


def leaning(
    step_deg: tuple[float, float], at: int, seed: int, frames: int = 90, ring_deg: float = 0.03
) -> PanZoomTrack:
    """A track on a sprung floor that rings after two landings, of a tripod that is bumped ``at`` a frame."""
    rng, time_s = np.random.default_rng(seed), np.arange(frames) / 30
    lean = rng.normal(0.0, np.deg2rad(0.002), (frames, 2))
    for landing_s in (0.7, 1.9):
        since = time_s - landing_s
        ring = np.where(since > 0.0, np.exp(-6.0 * since) * np.sin(2 * np.pi * 8.0 * since), 0.0)
        lean += np.deg2rad(ring_deg) * ring[:, None]
    lean[at:] += np.deg2rad(step_deg)
    track = fabricated.reconstruction(frames=frames).tracks[0]
    assert track is not None
    return replace(track, tilt_rad=track.tilt_rad + lean[:, 0], roll_rad=lean[:, 1])


@settings(max_examples=40, deadline=None)
@given(st.floats(0.06, 0.5), st.floats(0.0, 2 * np.pi), st.integers(20, 70), st.integers(0, 1000))
def test_a_tripod_that_is_bumped_is_told_with_the_frame_and_by_how_much(
    size_deg: float, way: float, at: int, seed: int
) -> None:
    step_deg = size_deg * np.cos(way), size_deg * np.sin(way)
    found = bump(leaning(step_deg, at, seed))
    assert found is not None
    assert abs(found.frame - at) <= 2
    np.testing.assert_allclose(np.rad2deg(found.step_rad), step_deg, atol=0.01)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000))
def test_a_floor_that_rings_bumps_no_tripod(seed: int) -> None:
    assert bump(leaning((0.0, 0.0), 0, seed)) is None
    assert bump(leaning((0.0, 0.0), 0, seed, frames=20)) is None  # too short to tell


def test_the_note_on_a_bumped_tripod_names_camera_frame_and_angles() -> None:
    head = fabricated.reconstruction(frames=90).cameras[0]
    assert head is not None
    notes = camera_notes("2", head, leaning((0.1, -0.05), 50, 3), 0.0, TIMECODES)
    [note] = [each for each in notes if "bumped" in each]
    assert note.startswith(("camera 2: at frame 49 (10:00:01:19) its", "camera 2: at frame 50 (10:00:01:20) its"))
    assert re.search(r"tilted by \+0\.(09|10)\d and rolled by -0\.0[45]\d degrees", note)
    assert not [each for each in camera_notes("2", head, leaning((0.0, 0.0), 0, 3), 0.0, TIMECODES) if "bumped" in each]


@settings(max_examples=40, deadline=None)
@given(st.floats(0.3, 2.0), st.integers(0, 1000))
def test_a_tripod_that_rocks_is_told_by_how_much_and_is_not_bumped(ring_deg: float, seed: int) -> None:
    track = leaning((0.0, 0.0), 0, seed, ring_deg=ring_deg)
    assert bump(track) is None
    size_rad = rocking(track, None).max()
    off = np.stack([track.tilt_rad - np.median(track.tilt_rad), track.roll_rad], axis=1)
    np.testing.assert_allclose(size_rad, np.linalg.norm(off, axis=1).max(), atol=np.deg2rad(0.01))


def test_the_note_on_a_tripod_that_rocks_names_camera_frames_and_size() -> None:
    head = fabricated.reconstruction(frames=90).cameras[0]
    assert head is not None
    [note] = camera_notes("2", head, leaning((0.0, 0.0), 0, 3, ring_deg=1.0), 0.0, TIMECODES)
    assert re.match(
        r"camera 2: its tripod rocks by up to 1\.\d\d degrees between frames 2\d and \d\d \(10:00:00:2", note
    )
    # what comes back after a bump is no rocking
    [note] = camera_notes("2", head, leaning((0.3, 0.0), 50, 3), 0.0, TIMECODES)
    assert "bumped" in note


def test_many_bumped_tripods_are_a_stabiliser() -> None:
    still, bumped = leaning((0.0, 0.0), 0, 3), leaning((0.1, -0.05), 50, 3)
    assert stabilised(("1", "2", "3", "4"), (still, bumped, None, still)) == []
    [note] = stabilised(("1", "2", "3", "4"), (bumped, bumped, None, still))
    assert note.startswith("cameras 1, 2: ")
    assert "stabiliser" in note


def test_a_lens_that_sets_colours_apart_is_told_with_its_size() -> None:
    made = fabricated.reconstruction(frames=90)
    (head, *_), (track, *_) = made.cameras, made.tracks
    assert head is not None
    assert track is not None
    corner_px = np.hypot(head.lens.width, head.lens.height) / 2
    parting = replace(head, lens=replace(head.lens, lateral_colour=np.array([-0.62, 0.02, 0.41]) / corner_px))
    said = camera_notes("1", parting, track, 0.0, TIMECODES)
    assert any("in the corners red stands +0.4 px and blue -0.6 px further out than grey" in each for each in said)
    assert not any("colours" in each for each in camera_notes("1", head, track, 0.0, TIMECODES))
