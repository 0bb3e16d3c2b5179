"""Input of the methods: frames of one camera, matched with each other, and first values of their cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from experiments.comparisons.self_calibration.baselines.rotations import (
    Frames,
    Pair,
    initial,
    match_pairs,
    rechained,
    spanning,
    turn_of,
)
from pzcap.calibration.features import Features
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

    As they are where the sweep has no chain, or none of its later frames shows what the first did.
    """
    by_frames = {(pair.first, pair.second): pair for pair in pairs}
    order = shots.sequence
    steps = list(pairwise(order))
    chain = [by_frames[step] for step in steps if step in by_frames]
    ends = [(k, by_frames[order[0], order[k]]) for k in range(len(order) // 2, len(order))
            if (order[0], order[k]) in by_frames]  # fmt: skip
    if not ends or len(chain) < len(steps):
        return start
    last, seam = max(ends, key=lambda end: len(end[1].first_px))
    frames = _closing(start, chain[:last], seam)
    tree = [(pair.first, pair.second, pair) for pair in chain]
    rest = [(len(pair.first_px), pair) for pair in pairs if pair.second not in order or pair.first not in order]
    tree += spanning(rest, set(order))
    frames = rechained(replace(frames, rotation=np.tile(np.eye(3), (len(frames.valid), 1, 1))), tree)
    # the gap that is left is spread over the turn
    ahead = frames.rotation[order[last]] @ turn_of(seam, frames)  # where the chain puts the first frame again
    miss = Rotation.from_matrix(ahead @ frames.rotation[order[0]].T).as_rotvec()
    rotation = frames.rotation.copy()
    for k, frame in enumerate(order):
        rotation[frame] = Rotation.from_rotvec(-miss * k / last).as_matrix() @ rotation[frame]
    return replace(frames, rotation=rotation)


def _closing(frames: Frames, chain: Sequence[Pair], seam: Pair) -> Frames:
    """All focal lengths scaled by ``turn / 2 pi``, where ``turn`` is what the chain adds up to, from the first frame to
    the one that shows the same again; several times, since the turns themselves depend on it."""
    for _ in range(4):
        turns = [Rotation.from_matrix(turn_of(pair, frames)).as_rotvec() for pair in chain]
        back = Rotation.from_matrix(turn_of(seam, frames)).as_rotvec()  # the chain's last frame from its first, shortly
        angle = sum(float(np.linalg.norm(turn)) for turn in turns) - float(back @ turns[0] / np.linalg.norm(turns[0]))
        lens = frames.lens.copy()
        lens[:, 0] += np.log(np.clip(angle / (2 * np.pi), 0.8, 1.25))
        frames = replace(frames, lens=lens)
    return frames


def one_zoom(shots: Shots, start: Frames) -> Mask:
    """(F,) The frames of the sweep, or else the largest group of frames of one zoom."""
    if shots.sequence and shots.full_turn:
        base = np.zeros(len(start.valid), bool)
        base[list(shots.sequence)] = True
        return base & start.valid
    logs = start.lens[:, 0]
    near = (np.abs(logs[:, None] - logs[None, :]) < SAME_ZOOM) & start.valid[None, :] & start.valid[:, None]
    return np.asarray(near[int(np.argmax(near.sum(axis=1)))], np.bool_)
