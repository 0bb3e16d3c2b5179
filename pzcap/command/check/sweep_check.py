"""Sweep: speed, evenness, overlap, how far round, closure, exposure, flicker, blur; and the views that all else of the
camera is compared with."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from pzcap.command.check.findings import Finding, Level, graded
from pzcap.command.check.tuning import SWEEP, VIEWS
from pzcap.command.check.views import Relation, View, best, overlap, relate, small, step, view
from pzcap.io.video import VideoReader
from pzcap.solver.robust import normal_sigma
from pzcap.types import Array, Image

MAINS: Final = "a shutter of 1/50 or 1/100 s (1/60 or 1/120 s) fits the mains"


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """A sweep, as far as other files of the camera are compared with it."""

    focal: float  # over the width of the picture
    angles_rad: Array  # (M,) of each frame from the first, to the left
    keys: tuple[View, ...]
    key_angles_rad: Array  # (K,)
    thumbnails: tuple[Image, ...]  # (K)
    brightness: float  # mean of all key views

    @property
    def span_rad(self) -> float:
        """Angle by which the camera was turned."""
        return float(np.ptp(self.angles_rad))


def check_sweep(
    camera: str, path: Path, focal: float | None, full_turn: bool, reference: Image | None = None
) -> tuple[Sweep, list[Finding]]:
    """The sweep of a camera, and what there is to say about it. ``focal``: over the width, of the ``reference`` image;
    None: it is unknown, and found from the circle where the sweep closes one. What of the hall both show tells
    whether the zoom ring was moved between them; the sweep then has the focal length at which it was filmed."""
    reader, used = VideoReader(path), focal or SWEEP.usual_field
    steps, small_before = [], None
    keys: list[View] = []
    angles, key_angles, thumbnails, last_key, gains = [0.0], [], [], np.inf, []
    for _, image in reader:
        here = small(image, 320)
        if small_before is not None:
            across, down, sure = step(small_before, here)
            steps.append((across, down, sure))
            angles.append(angles[-1] + float(np.arctan(across / used)))
            one, other = overlap(small_before, here, across)
            gains.append(float(np.log(max(other.mean(), 1.0) / max(one.mean(), 1.0))) if one.size else 0.0)
        if abs(angles[-1] - last_key) > np.deg2rad(SWEEP.key_deg) or not keys:
            keys.append(view(image, VIEWS.most_in_sweep))
            key_angles.append(angles[-1])
            thumbnails.append(_thumbnail(image))
            last_key = angles[-1]
        small_before = here
    brightness = float(np.mean([key.picture.mean() for key in keys]))
    sweep = Sweep(used, np.array(angles), tuple(keys), np.array(key_angles), tuple(thumbnails), brightness)
    zoomed = None if focal is None or reference is None else _zoomed(sweep, reference)
    sweep = _at_focal(sweep, sweep.focal * (zoomed or 1.0))
    moves, turned_deg = np.array(steps).reshape(-1, 3), None
    closing = _closing(sweep, SWEEP.least_round_deg if focal else SWEEP.least_guessed_deg) if full_turn else None
    if closing is not None:
        turned_deg = float(np.rad2deg(_turned(sweep, closing)))
        sweep = _closed(sweep, closing, focal is not None)
    found = [*_motion(sweep, moves, float(reader.frame_rate)), *_light(np.array(gains), keys), *_ring(zoomed or 1.0)]
    found += _round(sweep, turned_deg, focal is not None, zoomed is not None) if full_turn else _part(sweep)
    found += _level(sweep, moves[:, 1], closing[1].down if closing else 0.0)
    return sweep, [Finding(level, camera, "sweep", text) for level, text in found]


def _motion(sweep: Sweep, moves: Array, rate: float) -> Iterator[tuple[Level, str]]:
    """Speed and evenness."""
    if len(moves) < 8:
        yield Level.FAIL, f"has {len(moves) + 1} frames; turn the head slowly through the whole range"
        return
    across, _, sure = moves.T
    turned = np.diff(sweep.angles_rad)
    lost = float(np.mean(sure < SWEEP.unsure))
    shared = 1.0 - float(np.percentile(np.abs(across), 95))
    speed = np.rad2deg(float(np.median(np.abs(turned)))) * rate
    yield (
        graded(1.0 - shared, 0.2, 0.4),
        f"turns at {speed:.1f} degrees/s; neighbours share {100 * shared:.0f} % (90 % is good, 60 % the least)",
    )
    if lost > 0.1:
        yield (
            Level.WARN,
            f"{100 * lost:.0f} % of its frames cannot be laid to the next; bare walls, blur or somebody in it?",
        )
    yield from _bare(sweep, sure)
    way = np.sign(np.median(turned))
    back = float(np.sum(np.abs(turned[turned * way < 0]))) if way else 0.0
    if back > np.deg2rad(5.0):
        text = f"turns back by {np.rad2deg(back):.0f} degrees; turn the head one way throughout"
        yield graded(np.rad2deg(back), 5.0, SWEEP.back_deg), text


def _bare(sweep: Sweep, sure: Array) -> Iterator[tuple[Level, str]]:
    """Word on frames that show hardly anything, by how ``sure`` (N,) each step to the next is."""
    bare = np.flatnonzero(sure < SWEEP.bare * np.median(sure))
    if len(bare):
        longest = max(np.split(bare, np.flatnonzero(np.diff(bare) > 1) + 1), key=len)
        first, last = int(longest[0]), int(longest[-1]) + 1
        at = np.rad2deg(np.abs(sweep.angles_rad[[first, last]]))
        yield (
            Level.WARN,
            f"shows next to nothing in frames {first} to {last}, {at[0]:.0f} to {at[1]:.0f} degrees on: a bare wall? "
            "What is not seen twice does not close the circle, which then does not fix the focal length; "
            "hang something up there",
        )


def _level(sweep: Sweep, down: Array, net: float) -> Iterator[tuple[Level, str]]:
    """Rise and fall of the pictures, of which each moves ``down`` (N,) from the one before, and the one that shows the
    start again by ``net`` altogether.

    A step ``down`` that goes with the angle is no rise: a camera that leans to a side moves so as it turns, and so do
    rows that are interpolated, whose places are known to a fraction only. All round, ``net`` tells the rise instead.
    """
    if len(down) < 8:
        return
    way = np.concatenate([[0.0], np.cumsum(down)])
    even = way[-1] * sweep.angles_rad / sweep.angles_rad[-1] if sweep.angles_rad[-1] else 0.0
    rise = float(np.abs(way - even).max() + abs(net)) / sweep.focal
    if np.rad2deg(rise) > 3.0:
        yield Level.WARN, f"rises or falls by {np.rad2deg(rise):.1f} degrees; lock the tilt, level the pan axis"


def _light(gains: Array, keys: list[View]) -> Iterator[tuple[Level, str]]:
    """Exposure and flicker."""
    burnt = float(np.mean([np.mean(key.picture >= 252) for key in keys]))
    if burnt > 0.03:
        yield Level.WARN, f"{100 * burnt:.0f} % of it is burnt out; expose less"
    if len(gains) < 8:
        return
    trend = np.convolve(gains, np.ones(5) / 5, mode="same")
    flicker = normal_sigma(gains - trend)
    yield (
        graded(flicker, 0.02, 0.08),
        f"flickers by {100 * flicker:.1f} % from frame to frame" + (f"; {MAINS}" if flicker > 0.02 else ""),
    )
    drift = float(np.ptp(np.cumsum(gains)))
    if drift > 0.4:
        yield (
            Level.WARN,
            f"its brightness drifts by {100 * (np.exp(drift) - 1):.0f} %; fix exposure and gain; if they are, "
            f"lamps flicker nearly in step with the frames: {MAINS}",
        )


def _closing(sweep: Sweep, least_deg: float) -> tuple[int, Relation] | None:
    """The number of the key view, ``least_deg`` from the first or more, that shows the start again, best of all, and
    how; None if none does."""
    ends = [k for k in range(len(sweep.keys)) if abs(sweep.key_angles_rad[k]) > np.deg2rad(least_deg)]
    relations = [(k, relate(sweep.keys[0], sweep.keys[k])) for k in ends]
    most = max(relations, key=lambda pair: pair[1].inliers, default=None)
    return most if most is not None and most[1].found else None


def _turned(sweep: Sweep, closing: tuple[int, Relation]) -> float:
    """Angle in radians from the first picture to where the sweep shows the same again."""
    index, relation = closing
    return float(abs(sweep.key_angles_rad[index] + relation.across / sweep.focal))


def _closed(sweep: Sweep, closing: tuple[int, Relation], measured: bool) -> Sweep:
    """The sweep whose circle comes to a full turn: what its steps have missed is shared out among them, or, where no
    reference image has told the focal length, is an error of that; steps are small, in inverse proportion to it."""
    ratio = 2.0 * np.pi / _turned(sweep, closing)
    closed = _at_focal(sweep, sweep.focal / ratio)
    return replace(closed, focal=sweep.focal) if measured else closed


def _at_focal(sweep: Sweep, focal: float) -> Sweep:
    """The sweep by another focal length: its steps are small angles, which are in inverse proportion to it."""
    ratio = sweep.focal / focal
    return replace(sweep, focal=focal, angles_rad=sweep.angles_rad * ratio, key_angles_rad=sweep.key_angles_rad * ratio)


def _zoomed(sweep: Sweep, reference: Image) -> float | None:
    """Focal length of the sweep over that of the reference image, by what both show; None where they do not fit."""
    _, relation = best(view(reference), sweep.keys)
    return relation.scale if relation.found else None


def _ring(zoomed: float) -> Iterator[tuple[Level, str]]:
    """Word on a zoom ring that was moved between reference image and sweep; a little is found by calibration itself."""
    off = abs(float(np.log(zoomed)))
    if off > SWEEP.ring:
        text = f"was filmed at {zoomed:.2f} times the focal length of the reference image; was the zoom ring moved?"
        yield graded(off, SWEEP.ring, SWEEP.ring_far), text


def _part(sweep: Sweep) -> Iterator[tuple[Level, str]]:
    """Check of the angle that a partial sweep covers."""
    span = np.rad2deg(sweep.span_rad)
    yield graded(-span, -110.0, -60.0), f"covers {span:.0f} degrees (120 or more is good)"


def _round(sweep: Sweep, turned_deg: float | None, measured: bool, compared: bool) -> Iterator[tuple[Level, str]]:
    """Check of the circle's closure. ``turned_deg``: where the start is seen again, by the steps; ``measured``: the
    focal length is that of the reference image, and not of the circle itself; ``compared``: the picture of it was."""
    if turned_deg is None:
        yield (
            Level.FAIL,
            f"covers {np.rad2deg(sweep.span_rad):.0f} degrees and does not come round to its start; turn by 380, or "
            "give --partial-sweep",
        )
        return
    if not measured:
        field = 2.0 * np.rad2deg(np.arctan(0.5 / sweep.focal))
        yield Level.OK, f"comes round to its start, which tells the focal length: it sees {field:.0f} degrees across"
        return
    miss = abs(turned_deg / 360.0 - 1.0)
    by = "by its own steps" if compared else "by the reference image's focal length"
    doubt = "do its frames share enough?" if compared else "was the zoom ring moved between the two?"
    yield (
        graded(miss, 0.06, 0.15),
        f"comes round to its start; {by} that is {turned_deg:.0f} degrees" + (f"; {doubt}" if miss > 0.06 else ""),
    )


def _thumbnail(image: Image) -> Image:
    height = round(SWEEP.thumbnail * image.shape[0] / image.shape[1])
    return np.asarray(cv2.resize(image, (SWEEP.thumbnail, height), interpolation=cv2.INTER_AREA), np.uint8)
