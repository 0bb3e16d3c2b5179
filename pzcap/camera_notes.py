"""Notes on what a camera does and a studio's would not do: lens, shutter, clock, tripod, woven fields."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from pzcap.imaging.comb import comb_of
from pzcap.tuning import PLAUSIBILITY
from pzcap.types import Array, CameraFiles, Lens, PanZoomCamera, PanZoomTrack

ON_ITS_SIDE: Final = (
    "it was held upright, and its columns are exposed one after the other in place of rows; where its shutter rolls, "
    "as all phones' do, pan, zoom and the athlete are off by more than is said: film with the camera lying"
)


def camera_notes(
    name: str, head: PanZoomCamera, track: PanZoomTrack, usual_clock_s: float, timecodes: Sequence[str]
) -> list[str]:
    """Notes on what has been found of camera ``name`` and a studio's would not do; all of it is corrected for.
    ``usual_clock_s``: the median of all cameras' clocks, which one that is a whole frame off does not move."""
    found = [
        *_colours(head.lens),
        *_shutter(head),
        *_clock(head, usual_clock_s),
        *_settled(head, track),
        *_moved(track, timecodes),
    ]
    return [f"camera {name}: {each}" for each in found]


def _colours(lens: Lens) -> list[str]:
    if not lens.lateral_colour.any():
        return []
    blue_px, _, red_px = lens.lateral_colour * np.hypot(lens.width, lens.height) / 2
    return [
        f"its lens sets colours apart: in the corners red stands {red_px:+.1f} px and blue {blue_px:+.1f} px further "
        "out than grey"
    ]


def _shutter(head: PanZoomCamera) -> list[str]:
    if abs(head.readout_s) <= max(PLAUSIBILITY.readout_s, PLAUSIBILITY.sigmas * head.readout_sigma_s):
        return []
    upside_down = "" if head.readout_s > 0.0 else ", from the bottom up"
    return [
        f"its shutter rolls: {1e3 * abs(head.readout_s):.1f} ms (standard deviation {1e3 * head.readout_sigma_s:.2f}) "
        f"from the first row to the last{upside_down}"
    ]


def _clock(head: PanZoomCamera, usual_clock_s: float) -> list[str]:
    clock_s = head.clock_s - usual_clock_s
    if abs(clock_s) <= max(PLAUSIBILITY.clock_s, PLAUSIBILITY.sigmas * head.clock_sigma_s):
        return []
    late = "after" if clock_s > 0.0 else "before"
    return [
        f"it exposes {1e3 * abs(clock_s):.1f} ms (standard deviation {1e3 * head.clock_sigma_s:.2f}) {late} the median "
        "of all: the cameras are not locked to each other"
    ]


def _settled(head: PanZoomCamera, track: PanZoomTrack) -> list[str]:
    if not track.valid.any():
        return []
    off = np.median(_leaned(track)[track.valid], axis=0) - (head.tilt_rad, 0.0)
    if np.abs(off).max() <= PLAUSIBILITY.tilt_rad:
        return []
    return [
        f"in the motion it is tilted by {np.rad2deg(off[0]):+.3f} and rolled by {np.rad2deg(off[1]):+.3f} degrees "
        "against the sweep: the tripod has settled or was touched"
    ]


def _moved(track: PanZoomTrack, timecodes: Sequence[str]) -> list[str]:
    """Notes on a tripod that moved in mid-take."""
    notes, bumped = [], bump(track)
    if bumped:
        tilt_deg, roll_deg = np.rad2deg(bumped.step_rad)
        notes.append(
            f"at frame {bumped.frame} ({timecodes[bumped.frame]}) its tripod was bumped: from there on it is tilted by "
            f"{tilt_deg:+.3f} and rolled by {roll_deg:+.3f} degrees against before; by how much it was turned about "
            "the vertical nobody can tell from the pan"
        )
    off = rocking(track, bumped)
    rocks, size = np.flatnonzero(off > PLAUSIBILITY.rocks_rad), np.rad2deg(off.max(initial=0.0))
    if len(rocks):
        notes.append(
            f"its tripod rocks by up to {size:.2f} degrees between frames {rocks[0]} and {rocks[-1]} "
            f"({timecodes[rocks[0]]} to {timecodes[rocks[-1]]}): put it on firm ground. Frames are "
            "corrected for it; those that it smears are lost"
        )
    return notes


def stabilised(names: Sequence[str], tracks: Sequence[PanZoomTrack | None]) -> list[str]:
    """A note where several tripods seem to have been bumped in one take, which is what a stabiliser looks like."""
    bumped = [name for name, track in zip(names, tracks, strict=True) if track is not None and bump(track)]
    if len(bumped) < PLAUSIBILITY.bumped_tripods:
        return []
    return [
        f"cameras {', '.join(bumped)}: so many tripods are hardly bumped in one take, but a stabiliser that was left "
        "on shifts and turns pictures so; switch it off, in camera and lens, and film all anew"
    ]


class Bump(NamedTuple):
    """A tripod that was moved for good."""

    frame: int  # the first one after it
    step_rad: Array  # (2,) of tilt and roll


def bump(track: PanZoomTrack) -> Bump | None:
    """The step of tilt and roll in mid-take, if there is one: between the medians of fifteen frames before and after,
    and of all that is before and after; what rings on a sprung floor has a mean of 0, and is not told by a step."""
    valid, width = np.flatnonzero(track.valid), PLAUSIBILITY.bump_frames
    if len(valid) < 2 * width:
        return None
    leaned = _leaned(track)[valid]
    medians = np.median(sliding_window_view(leaned, width, axis=0), axis=2)
    steps = medians[width:] - medians[:-width]
    at = int(np.argmax(np.linalg.norm(steps, axis=1)))
    near = leaned[at : at + 2 * width]
    scatters = [_scatter(near[:k]) + _scatter(near[k:]) for k in range(1, len(near))]
    middle = at + 1 + int(np.argmin(scatters))
    whole = np.median(leaned[middle:], axis=0) - np.median(leaned[:middle], axis=0)
    if min(np.linalg.norm(steps[at]), np.linalg.norm(whole)) < PLAUSIBILITY.tilt_rad:
        return None
    if min(scatters) > PLAUSIBILITY.bump_leaves * _scatter(near):
        return None
    return Bump(int(valid[middle]), steps[at])


def rocking(track: PanZoomTrack, bumped: Bump | None) -> Array:
    """(F,) radians by which tripod and head lean otherwise than usual, before and after it was ``bumped``; 0 where the
    frame is lost."""
    leaned, off = _leaned(track), np.zeros(len(track.pan_rad))
    for part in np.split(np.arange(len(off)), [bumped.frame] if bumped else []):
        found = part[track.valid[part]]
        if len(found):
            off[found] = np.linalg.norm(leaned[found] - np.median(leaned[found], axis=0), axis=1)
    return off


def _leaned(track: PanZoomTrack) -> Array:
    """(F, 2) tilt and roll."""
    return np.stack([track.tilt_rad, track.roll_rad], axis=1)


def _scatter(part: Array) -> float:
    return float(np.sum((part - part.mean(axis=0)) ** 2))


def woven_motion(files: CameraFiles, combs_px: Array, track: PanZoomTrack | None) -> str | None:
    """A note where the frames of a camera are of two instants each, and were taken for one; ``combs_px`` (F,) as in
    `comb_px`."""
    if track is None or files.motion is None or len(combs_px) < 2:
        return None
    turned_px = track.focal_px * np.gradient(np.unwrap(track.pan_rad))
    comb = comb_of(combs_px[track.valid], turned_px[track.valid])
    if comb is None or not comb.is_woven:
        return None
    return (
        f"camera {files.name}: odd and even rows of its pictures are of two instants ({abs(comb.share):.0%} of half a "
        "frame period apart): it is interlaced video, and the file does not say so. Each picture was taken for one "
        f"instant; copy the original again, or say it: {comb.cure(files.motion.name)}"
    )
