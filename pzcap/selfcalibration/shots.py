"""What the methods begin with: frames of one camera, matched with each other, and first values of their cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from pzcap.features import Features
from pzcap.selfcalibration.rotations import Frames, Pair, initial, match_pairs, rechained, turn_of
from pzcap.types import Array, Mask, PzcapError

GUESS_WIDTHS = 1.2  # focal length, in image widths, where no homography shows one
SAME_ZOOM = 0.05  # of log focal: frames whose first values differ by less were taken at one zoom


@dataclass(frozen=True, slots=True, eq=False)
class Shots:
    """Frames of one camera, by their features."""

    found: tuple[Features, ...]
    width: int
    height: int
    sequence: tuple[int, ...] = ()  # frames that pan in order
    full_turn: bool = False  # and go all the way round
    zoom: tuple[int, ...] = ()  # frames of a zoom run, in order

    @property
    def centre_px(self) -> Array:
        return np.array([(self.width - 1) / 2, (self.height - 1) / 2])


def link(shots: Shots) -> list[Pair]:
    """All pairs of frames that show the same."""
    count = len(shots.found)
    pairs = match_pairs(shots.found, [(i, j) for i in range(count) for j in range(i + 1, count)])
    if len(pairs) < 2:
        raise PzcapError("self-calibration: no three frames show the same; take frames that overlap by half")
    return pairs


def first_values(shots: Shots, pairs: Sequence[Pair]) -> Frames:
    """Focal lengths in closed form from the homographies, and chained rotations; a full turn is closed."""
    start = initial(pairs, len(shots.found), shots.centre_px, GUESS_WIDTHS * shots.width)
    return close_gap(shots, pairs, start) if shots.full_turn else start


def close_gap(shots: Shots, pairs: Sequence[Pair], start: Frames) -> Frames:
    """The focal length at which the chain of a full turn closes, and rotations chained with it.

    The focal length of all frames is scaled by ``turn / 2 pi``, where ``turn`` is what the chain of the sweep, from
    the first frame to the one that shows the same again, adds up to; twice, since the turns themselves depend on it.
    """
    by_frames = {(pair.first, pair.second): pair for pair in pairs}
    order = shots.sequence
    chain = [by_frames.get((a, b)) for a, b in pairwise(order)]
    ends = [
        (k, pair)
        for k in range(len(order) // 2, len(order))
        if (pair := by_frames.get((order[0], order[k]))) is not None
    ]
    if not ends or any(pair is None for pair in chain):
        return start
    last, seam = max(ends, key=lambda end: len(end[1].first_px))
    frames = start
    for _ in range(4):
        turn = np.eye(3)
        angle = 0.0
        for pair in chain[:last]:
            assert pair is not None
            step = turn_of(pair, frames)
            turn = step @ turn
            angle += float(np.linalg.norm(Rotation.from_matrix(step).as_rotvec()))
        back = turn_of(seam, frames)  # frame `last` from the first, the short way
        axis = Rotation.from_matrix(turn_of(_first(chain), frames)).as_rotvec()
        angle -= float(Rotation.from_matrix(back).as_rotvec() @ axis / np.linalg.norm(axis))
        lens = frames.lens.copy()
        lens[:, 0] += np.log(np.clip(angle / (2 * np.pi), 0.8, 1.25))
        frames = replace(frames, lens=lens)
    tree = [(a, b, pair) for (a, b), pair in zip(pairwise(order), chain, strict=True) if pair]
    rest = [pair for pair in pairs if pair.second not in order or pair.first not in order]
    reached = set(order)
    while edges := [p for p in rest if (p.first in reached) != (p.second in reached)]:
        pair = max(edges, key=lambda p: len(p.first_px))
        known, new = (pair.first, pair.second) if pair.first in reached else (pair.second, pair.first)
        reached.add(new)
        tree.append((known, new, pair))
    frames = rechained(replace(frames, rotation=np.tile(np.eye(3), (len(frames.valid), 1, 1))), tree)
    # the gap that is left is spread over the turn
    ahead = frames.rotation[order[last]] @ turn_of(seam, frames)  # where the chain puts the first frame again
    miss = Rotation.from_matrix(ahead @ frames.rotation[order[0]].T).as_rotvec()
    rotation = frames.rotation.copy()
    for k, frame in enumerate(order):
        rotation[frame] = Rotation.from_rotvec(-miss * k / last).as_matrix() @ rotation[frame]
    return replace(frames, rotation=rotation)


def _first(chain: Sequence[Pair | None]) -> Pair:
    assert chain[0] is not None
    return chain[0]


def one_zoom(shots: Shots, start: Frames) -> Mask:
    """(F,) The frames of the sweep, or else the largest group of frames of one zoom."""
    if shots.sequence and shots.full_turn:
        base = np.zeros(len(start.valid), bool)
        base[list(shots.sequence)] = True
        return base & start.valid
    logs = start.lens[:, 0]
    near = (np.abs(logs[:, None] - logs[None, :]) < SAME_ZOOM) & start.valid[None, :] & start.valid[:, None]
    return np.asarray(near[int(np.argmax(near.sum(axis=1)))], np.bool_)
