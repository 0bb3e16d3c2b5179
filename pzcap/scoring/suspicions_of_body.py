"""Suspicions about joints, against the truth: each undoes one mistake, and speaks where that fits far better."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pzcap.scoring.misreadings import AXES, UNITS, another_world, axes, better, in_words, scaled
from pzcap.scoring.records import BodyTrack, TrueCapture
from pzcap.scoring.suspicions_of_cameras import SHIFTS, enough
from pzcap.types import JOINTS, Array, Mask

NEAR_M: Final = 0.03  # joints nearer to the truth than this, in the median, are meant as they are written
SHIFT_M: Final = 0.01
"""The same for frames that are counted otherwise: somebody who walks is 3 cm further a frame later."""
FIXED_BY: Final = 12  # joints that fit another world by no chance
RATES: Final = (2.0, 0.5, 3.0, 1.0 / 3.0, 4.0, 0.25)  # frames a second over the capture's, as of 60 for 30
FEWEST: Final = 3  # frames that fit other times by no chance
SIDES: Final = tuple(
    JOINTS.index(name.replace("left", "R").replace("right", "left").replace("R", "right")) for name in JOINTS
)
"""Index of each joint's counterpart on the other side of the body."""


def suspicious_body(body: BodyTrack, truth: TrueCapture, frames: NDArray[np.int64], known: Mask) -> Iterator[str]:
    """Suspicions: what is probably not meant as it is written."""
    given = body.valid & known[:, None] & ~body.keyframe[:, None] & ~truth.keyframe[frames][:, None]
    if not given.any():
        return
    given &= np.any(body.joints_m != 0.0, axis=2)  # what was not found hides no mistake of the others
    if not given.any():
        return
    true = truth.joints_m[frames]
    off = _off(body.joints_m, true, given)
    best = min(SHIFTS, key=lambda shift: _shifted(body, truth, frames, given, shift))
    if off > SHIFT_M and better(_shifted(body, truth, frames, given, best), off):
        yield f"joints are those {abs(best)} frames {'later' if best > 0 else 'earlier'}: {_count(body, best)}"
        return
    if off > NEAR_M:
        other_times = list(_another_rate(body, truth, frames, given, off)) or list(
            _cut_out(body, truth, frames, given, off)
        )
        if other_times:
            yield from other_times
            return
    if off <= NEAR_M:
        yield from _wrong_order(body, true, given)
        yield from _strange_claim(body, given, off)
        return
    size = [float(np.median(np.linalg.norm(joints[given], axis=1))) for joints in (body.joints_m, true)]
    for factor, unit in UNITS.items():
        if scaled(size[0] / size[1], factor, _off(body.joints_m / factor, true, given), off):
            yield f"joints lie {unit}? write metres"
            return
    turned = {words: _off(body.joints_m @ turn.T, true, given) for words, turn in AXES.items()}
    words = min(turned, key=lambda one: turned[one])
    if better(turned[words], off):
        yield f"joints have other axes ({words}): {_turn_back(body, AXES[words])}"
        return
    if better(_off(body.joints_m[:, SIDES], true, given & given[:, SIDES]), _sides_off(body, true, given)):
        yield "left and right joints are exchanged: left is the athlete's own left"
        return
    strange = list(_wrong_order(body, true, given))
    yield from strange or _another_world(body, true, given, off)


def _turn_back(body: BodyTrack, turn: Array) -> str:
    """Advice on joints whose coordinates ``turn`` brings to the world's."""
    if body.read_by is None or np.linalg.det(turn) < 0.0:
        return "write z up, as the calibration object has it"
    return f"say --axes {in_words(turn @ axes(body.read_by))}"


def _another_world(body: BodyTrack, true: Array, given: Mask, off: float) -> Iterator[str]:
    found = another_world(body.joints_m[given], true[given]) if given.sum() >= FIXED_BY else None
    if found is not None:
        aligned = _off(found[0].apply(body.joints_m), true, given)
        if aligned <= NEAR_M and better(aligned, off):
            yield f"joints are in another world ({found[1]}): write that of the calibration object"


def _off(joints_m: Array, true_m: Array, given: Mask) -> float:
    """Median distance of the joints that are given, m; of none infinite."""
    return float(np.median(np.linalg.norm((joints_m - true_m)[given], axis=1))) if given.any() else np.inf


def _sides_off(body: BodyTrack, true_m: Array, given: Mask) -> float:
    """Median distance of the joints that have a counterpart."""
    paired = given & given[:, SIDES]
    paired[:, [at for at, other in enumerate(SIDES) if at == other]] = False
    return _off(body.joints_m, true_m, paired)


def _shifted(body: BodyTrack, truth: TrueCapture, frames: NDArray[np.int64], given: Mask, shift: int) -> float:
    there = frames + shift
    inner = (there >= 0) & (there < len(truth.timecodes))
    if np.any(given[inner], axis=1).sum() < enough(shift, np.any(given, axis=1).sum()):
        return np.inf
    return _off(body.joints_m[inner], truth.joints_m[there[inner]], given[inner])


def _count(body: BodyTrack, later: int) -> str:
    """Advice on joints that are of so many frames later."""
    begins = int(np.argmax(body.valid.any(axis=1))) + later
    if body.read_by is None or begins < 0:
        return "count frames as the capture does, from 0"
    return f"say --first-frame {begins}"


def _another_rate(
    body: BodyTrack, truth: TrueCapture, frames: NDArray[np.int64], given: Mask, off: float
) -> Iterator[str]:
    """Frames that are counted more quickly or slowly than the truth's, from the first one or the first given on."""
    own = float(Fraction(truth.frame_rate))
    for begins in dict.fromkeys((0, int(np.argmax(body.valid.any(axis=1))))):
        for ratio in RATES:
            instants = frames[begins] + (frames - frames[begins]) / ratio
            there = np.rint(instants).astype(np.int64)
            inner = (there >= 0) & (there < len(truth.timecodes)) & (np.abs(instants - there) < 1e-6)
            if np.any(given[inner], axis=1).sum() < FEWEST:
                continue
            undone = _off(body.joints_m[inner], truth.joints_m[there[inner]], given[inner])
            if undone <= NEAR_M and better(undone, off):
                rate = ratio * own
                say = f"say --rate {rate:g}" if body.read_by else "give a frame for each of the capture's"
                yield f"joints have {rate:.4g} frames a second where the capture has {own:.4g}: {say}"
                return


def _cut_out(body: BodyTrack, truth: TrueCapture, frames: NDArray[np.int64], given: Mask, off: float) -> Iterator[str]:
    """A part of the capture whose frames are counted from the part's own beginning, however late that is."""
    rows = np.flatnonzero(given.any(axis=1))
    most = len(truth.timecodes) - 1 - int(frames[rows].max())
    if len(rows) < FEWEST or most < 1:
        return
    shifted = [_off(body.joints_m[rows], truth.joints_m[frames[rows] + by], given[rows]) for by in range(most + 1)]
    best = int(np.argmin(shifted))
    if shifted[best] <= NEAR_M and better(shifted[best], off):
        yield f"joints are those {best} frames later: {_count(body, best)}"


def _wrong_order(body: BodyTrack, true: Array, given: Mask) -> Iterator[str]:
    """Joints that lie where another one is, all the time."""
    count = len(JOINTS)
    apart = np.full((count, count), np.inf)
    for joint in range(count):
        at = given[:, joint]
        if at.any():
            apart[joint] = np.median(np.linalg.norm(body.joints_m[at, joint, None] - true[at], axis=2), axis=0)
    nearest = np.argmin(apart, axis=1)
    wrong = [
        joint
        for joint in range(count)
        if np.isfinite(apart[joint, joint]) and apart[joint, nearest[joint]] < 0.3 * apart[joint, joint] - NEAR_M
    ]
    if len(wrong) > 1:
        joint = wrong[0]
        yield (
            f"{len(wrong)} joints lie where others are ({JOINTS[joint]} at {JOINTS[nearest[joint]]}): name each as "
            "docs/benchmark.md does"
        )


def _strange_claim(body: BodyTrack, given: Mask, off_m: float) -> Iterator[str]:
    if body.sigma_m is None:
        return
    sigma = float(np.median(body.sigma_m[given]))
    if sigma > 0.0 and sigma > 100.0 * max(off_m, 1e-4):
        yield f"sigma_m claims {sigma:.2g} m where the error is {off_m:.2g}: millimetres? write metres"
