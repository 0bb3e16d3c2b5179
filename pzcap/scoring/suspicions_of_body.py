"""Suspicions about joints, against the truth: each undoes one mistake, and speaks where that fits far better."""

from __future__ import annotations

from collections.abc import Iterator
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
SIDES: Final = tuple(
    JOINTS.index(name.replace("left", "R").replace("right", "left").replace("R", "right")) for name in JOINTS
)
"""Index of each joint's counterpart on the other side of the body."""


def suspicious_body(body: BodyTrack, truth: TrueCapture, frames: NDArray[np.int64], known: Mask) -> Iterator[str]:
    """Suspicions: what is probably not meant as it is written."""
    given = body.valid & known[:, None] & ~body.keyframe[:, None] & ~truth.keyframe[frames][:, None]
    if not given.any():
        return
    true = truth.joints_m[frames]
    off = _off(body.joints_m, true, given)
    best = min(SHIFTS, key=lambda shift: _shifted(body, truth, frames, given, shift))
    if off > SHIFT_M and better(_shifted(body, truth, frames, given, best), off):
        yield f"joints are those {abs(best)} frames {'later' if best > 0 else 'earlier'}: count frames from 0"
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
