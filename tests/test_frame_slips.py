"""A camera that lost frames, or whose timecode is wrong, is told by the body, and the frame by its pan and zoom."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pzcap.body.kinematics import joints
from pzcap.frame_slips import FrameOffsets, along_limbs, leap_near, slip_notes
from pzcap.geometry.camera import project
from pzcap.segmentation.others import BEFORE
from pzcap.types import Array, Camera, Silhouette
from tests.scenes.bodies import BODY
from tests.scenes.body_scene import POSITIONS, swing
from tests.scenes.captures import facing

FRAMES = 60
RATE = 30.0
NAMES = ("1", "2", "3", "4")
TIMECODES = [f"10:00:0{frame // 30}:{frame % 30:02}" for frame in range(FRAMES)]


def pan_at(camera: int, time_s: float) -> float:
    """Pan of an operator, radians: smooth, with a tremor."""
    return 0.3 * np.sin(0.9 * time_s + camera) + 0.0003 * np.sin(25.0 * time_s * (camera + 1))


def focal_at(camera: int, time_s: float) -> float:
    return 480.0 * float(np.exp(0.08 * np.sin(0.7 * time_s + 2.0 * camera)))


def looking(camera: int, target: Array, time_s: float) -> Camera:
    return Camera(320, 240, facing(POSITIONS[camera], target), focal_at(camera, time_s), np.array([159.5, 119.5]), 0.0)


def silhouette(camera: Camera, joints_m: Array, rng: np.random.Generator) -> Silhouette:
    """The athlete's limbs by their colours, with noise."""
    evidence = np.full((120, 160), -4.0, np.float32)
    for column, row in np.round(project(camera, along_limbs(joints_m))[0] / 2).astype(int):
        evidence[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2] = 4.0
    evidence += rng.normal(0.0, 2.0, evidence.shape).astype(np.float32)
    nothing = np.zeros((240, 320), np.uint8)
    return Silhouette(nothing, np.zeros((240, 320, 3), np.uint8), evidence, True)


def seen(offsets: Sequence[Sequence[float]]) -> tuple[FrameOffsets, list[Any]]:
    """A take in which each camera shows in each frame (C, F) the instant so many frames later."""
    rng = np.random.default_rng(0)

    def there(time: float) -> Array:
        return joints(BODY, swing(2.0 * time / RATE))

    found, tracks = FrameOffsets(len(offsets)), []
    for frame in range(FRAMES):
        views = []
        for camera, own in enumerate(offsets):
            time = frame + own[frame]
            view = looking(camera, there(time)[0], time / RATE)
            views.append((view, silhouette(view, there(time), rng)))
        found.see(frame, [view for view, _ in views], [outline for _, outline in views])
        if frame >= 7:  # as late as a tracker
            found.track([tracked(frame - 7, there(frame - 7))])
    found.track([tracked(frame, there(frame)) for frame in range(FRAMES - 7, FRAMES)])
    for camera, own in enumerate(offsets):
        times = (np.arange(FRAMES) + own) / RATE
        tracks.append(
            SimpleNamespace(
                pan_rad=np.array([pan_at(camera, time) for time in times]),
                focal_px=np.array([focal_at(camera, time) for time in times]),
                valid=np.ones(FRAMES, bool),
            )
        )
    return found, tracks


def test_a_view_in_which_somebody_hides_the_athlete_tells_nothing() -> None:
    rng, found = np.random.default_rng(1), FrameOffsets(2)
    there = [joints(BODY, swing(2.0 * frame / RATE)) for frame in range(FRAMES)]
    for frame in range(FRAMES):
        cameras = [looking(camera, there[frame][0], frame / RATE) for camera in range(2)]
        outlines = [silhouette(camera, there[frame], rng) for camera in cameras]
        if 20 <= frame < 30:
            column = round(float(project(cameras[1], there[frame][:1])[0][0, 0]) / 2)
            others, evidence = np.zeros((120, 160), np.uint8), outlines[1].evidence.copy()
            others[:, column : column + 20] = BEFORE
            evidence[others > 0] = 0.0
            outlines[1] = replace(outlines[1], others=others, evidence=evidence)
        found.see(frame, cameras, outlines)
    found.track([tracked(frame, there[frame]) for frame in range(FRAMES)])
    told = {frame: np.isfinite(scores).all(axis=1).tolist() for frame, scores in found.scores.items()}
    assert told[19] == told[30] == [True, True]
    assert all(told[frame] == [True, False] for frame in range(20, 30))


def tracked(frame: int, joints_m: Array, lost: float = 0.0) -> Any:
    return SimpleNamespace(frame=frame, joints_m=joints_m, valid=frame not in (12, 13), lost=lost)


def still() -> list[np.ndarray]:
    return [np.zeros(FRAMES) for _ in NAMES]


def told(offsets: Sequence[Sequence[float]], clocks: Sequence[float] = (0.0, 0.0, 0.0, 0.0)) -> list[str]:
    found, tracks = seen(offsets)
    return slip_notes(found, np.array(clocks), tracks, NAMES, TIMECODES)


def test_right_footage_raises_no_note_nor_do_clocks_that_are_half_a_frame_off() -> None:
    assert told(still()) == []
    assert told([own + share for own, share in zip(still(), (0.4, -0.3, 0.0, 0.2), strict=True)]) == []


def test_a_clock_that_is_half_a_frame_off_is_no_wrong_timecode() -> None:
    clocks = (0.2, -0.6, 0.0, 0.3)
    off = [own + share for own, share in zip(still(), clocks, strict=True)]
    assert told(off, clocks) == []
    off[1] -= 1.0
    (note,) = told(off, clocks)
    assert "camera 2: its pictures show the athlete 2 frames earlier" in note


@pytest.mark.parametrize(("camera", "at", "lost"), [(0, 30, 1), (2, 20, 3), (3, 25, -1)])
def test_lost_and_doubled_frames_are_named(camera: int, at: int, lost: int) -> None:
    offsets = still()
    offsets[camera][at:] = lost
    (note,) = told(offsets)
    assert note.startswith(f"camera {camera + 1}: from frame {at} ({TIMECODES[at]}) on its pictures show the athlete")
    many = f"{abs(lost)} frame{'s' * (abs(lost) > 1)}"
    assert f"{many} {'later' if lost > 0 else 'earlier'} than before" in note
    assert ("closed up" in note) == (lost > 0)


@pytest.mark.parametrize(("off", "says"), [(1, "1 frame too low"), (-2, "2 frames too high")])
def test_a_timecode_that_is_off_is_named(off: int, says: str) -> None:
    offsets = still()
    offsets[1] += off
    (note,) = told(offsets)
    assert note.startswith("camera 2: its pictures show the athlete ")
    assert says in note


def test_what_the_pictures_hardly_tell_is_no_wrong_timecode() -> None:
    """In loose clothes, which lag, all offsets fit nearly as well: the best one is chance."""
    offsets = still()
    offsets[1] += 2
    found, tracks = seen(offsets)
    frames, late = found.offsets()
    assert len(frames) > 30
    assert found.worth(1, late[:, 1], 0.0) > 100.0
    assert len(slip_notes(found, np.zeros(4), tracks, NAMES, TIMECODES)) == 1
    for scores in found.scores.values():
        scores[1] *= 0.03
    assert found.offsets()[1][0, 1] == late[0, 1]
    assert 0.0 < found.worth(1, late[:, 1], 0.0) < 8.0
    assert slip_notes(found, np.zeros(4), tracks, NAMES, TIMECODES) == []


def test_a_lost_frame_that_pan_and_zoom_contradict_is_none() -> None:
    """A body that is wrong shifts against the pictures; the camera would have leapt."""
    offsets = still()
    offsets[0][30:] = 1
    found, leaping = seen(offsets)
    _, tracks = seen(still())
    assert len(slip_notes(found, np.zeros(4), leaping, NAMES, TIMECODES)) == 1
    assert slip_notes(found, np.zeros(4), tracks, NAMES, TIMECODES) == []
    tracks[0].pan_rad, tracks[0].focal_px = np.zeros(FRAMES), np.full(FRAMES, 480.0)  # at rest, it tells nothing
    assert len(slip_notes(found, np.zeros(4), tracks, NAMES, TIMECODES)) == 1


def test_pictures_do_not_pile_up() -> None:
    found, _ = seen(still())
    assert len(found._views) <= 8
    assert len(found._points) <= 10


def test_a_camera_that_stands_still_tells_no_frame() -> None:
    rng = np.random.default_rng(0)
    track: Any = SimpleNamespace(
        pan_rad=1e-5 * rng.normal(size=FRAMES), focal_px=480.0 + 0.01 * rng.normal(size=FRAMES),
        valid=np.ones(FRAMES, bool),
    )  # fmt: skip
    assert leap_near(track, 30, 1) is None
    moving = SimpleNamespace(**(vars(track) | {"pan_rad": np.append(np.arange(30), np.arange(31, 61)) * 0.01}))
    assert leap_near(moving, 28, 1) == 30  # type: ignore[arg-type]
    assert leap_near(moving, 28, 2) is None  # type: ignore[arg-type]


def test_a_body_that_may_be_lost_tells_nothing() -> None:
    found = FrameOffsets(1)
    view = looking(0, np.zeros(3), 0.0)
    outline = silhouette(view, joints(BODY, swing(0.0)), np.random.default_rng(0))
    for frame in range(40):
        found.see(frame, [view], [outline])
        found.track([tracked(frame, joints(BODY, swing(0.0)), lost=0.5 if frame == 20 else 0.0)])
    told = [frame for frame, scores in found.scores.items() if np.isfinite(scores).all()]
    assert {5, 30} < set(told)
    assert not {16, 20, 24} & set(told)


@pytest.mark.parametrize("clock", [-0.8, -0.3, 0.5, 0.79])
def test_what_a_clock_is_off_by_is_no_slip_and_hides_none(clock: float) -> None:
    """Of a camera that is between two frames, either is near: no frame is lost where one comes nearer than the other
    (from still to moving, say), and a lost one is told as of any other camera."""
    clocks, offsets = np.array([0.0, 0.0, clock, 0.0]), still()
    offsets[2] += clock
    found, tracks = seen(offsets)
    _, told = found.offsets()
    assert np.abs(told - clocks).max() < 0.3
    assert slip_notes(found, clocks, tracks, NAMES, TIMECODES) == []
    offsets[2][25:] += 1.0
    found, tracks = seen(offsets)
    (note,) = slip_notes(found, clocks, tracks, NAMES, TIMECODES)
    assert note.startswith("camera 3: from frame 25 ")


def test_a_view_without_a_body_or_an_athlete_is_passed_over() -> None:
    found = FrameOffsets(2)
    view = looking(0, np.zeros(3), 0.0)
    outline = silhouette(view, joints(BODY, swing(0.0)), np.random.default_rng(0))
    for frame in range(12):
        found.see(frame, [view, None], [replace(outline, valid=False), None])
        found.track([tracked(frame, joints(BODY, swing(0.0)))])
    assert slip_notes(found, np.zeros(2), [None, None], NAMES[:2], TIMECODES) == []
