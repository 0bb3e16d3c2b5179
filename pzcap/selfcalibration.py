"""Self-calibration from the footage alone: the three methods that the paper names as alternatives to its own.

The paper announces a comparison with them (section 7). Their outlines are kept: the abstracts and what later work says
of them were at hand, the full texts were not, so that details may differ. AKAZE matches stand in place of the features
of their day, and the camera model is that of `pzcap.types` (one coefficient of distortion, square pixels). What else
was simplified stands with each method.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from pzcap import features
from pzcap.camera import distort, undistort
from pzcap.features import Features
from pzcap.rotations import (
    Frames,
    LensModel,
    Pair,
    adjust,
    initial,
    match_pairs,
    rechained,
    transfer,
    turn_of,
)
from pzcap.types import Array, Mask, PzcapError

GUESS_WIDTHS = 1.2  # focal length, in image widths, where no homography shows one
SAME_ZOOM = 0.05  # of log focal: frames whose first values differ by less were taken at one zoom
LIBRARY = 20000  # features, at most
FORGOTTEN = 5  # a feature of the library that was looked for in vain so many times more than found is dropped


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


# --------------------------------------------------------------------------------------------------------------
# Shum and Szeliski (2000)


def shum_szeliski(shots: Shots, pairs: Sequence[Pair]) -> Frames:
    """A mosaic: focal lengths and rotations of all frames, no distortion, principal point in the middle.

    Focal lengths in closed form from the homographies; rotations chained; in a full turn the gap at the end gives the
    focal length and is spread over the turn; then all frames are aligned globally over all overlapping
    pairs, each with a rotation and a focal length. Simplified: homographies from features instead of
    registered patches, and residuals in pixels instead of between rays; no deghosting, which moves pixels, not cameras.
    """
    start = initial(pairs, len(shots.found), shots.centre_px, GUESS_WIDTHS * shots.width)
    if shots.full_turn:
        start = close_gap(shots, pairs, start)
    count = len(shots.found)
    design = np.zeros((count, 4, count))
    design[np.arange(count), 0, np.arange(count)] = 1.0
    constant = np.array([0.0, *shots.centre_px, 0.0])
    # nothing is believed of the focal lengths, but that of a frame without matches must not be anything at all
    model = LensModel(design, np.eye(count), start.lens[:, 0].copy(), np.full(count, 2.0), constant)
    frames, _, _ = adjust(start, start.lens[:, 0].copy(), model, pairs)
    return frames


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


# --------------------------------------------------------------------------------------------------------------
# Sinha and Pollefeys (2006)


def sinha_pollefeys(shots: Shots, pairs: Sequence[Pair]) -> Frames:
    """Intrinsics at one zoom by adjusting a mosaic, then outwards through the zoom, one step after the other.

    The mosaic's frames share focal length, principal point and distortion; then every zoom
    step has its own, adjusted with those before it, and at last all at once. Where a step does not show
    distortion or principal point they stay near the step before. Simplified: one coefficient of distortion; first
    values from closed-form focal lengths instead of the linear self-calibration; where there is no panorama at the
    widest zoom, the largest group of frames of one zoom is the mosaic, and the zoom goes outwards from it both ways;
    where there is no zoom run, frames that pan and zoom at once are its steps, each with a rotation of its own.
    """
    start = initial(pairs, len(shots.found), shots.centre_px, GUESS_WIDTHS * shots.width)
    if shots.full_turn:
        start = close_gap(shots, pairs, start)
    count = len(shots.found)
    base = _one_zoom(shots, start)
    # stage 1: the mosaic
    shared = np.zeros((count, 4, 4))
    shared[:] = np.eye(4)
    first = np.array([np.median(start.lens[base, 0]), *shots.centre_px, 0.0])
    loose = np.array([2.0, 0.02 * shots.width, 0.02 * shots.width, 0.2])
    mosaic = replace(start, valid=start.valid & base)
    model = LensModel(shared, np.eye(4), first, loose)
    mosaic, intrinsics, _ = adjust(mosaic, first, model, pairs)

    # stage 2: outwards, one step at a time
    steps = [int(k) for k in np.flatnonzero(start.valid & ~base)]
    steps.sort(key=lambda k: abs(start.lens[k, 0] - first[0]))
    lens = mosaic.lens.copy()
    known = mosaic.valid.copy()
    frames = mosaic
    order = np.array([0.3, 0.005 * shots.width, 0.005 * shots.width, 0.05])
    before: dict[int, int] = {}
    for k in steps:
        linked = [pair for pair in pairs if k in (pair.first, pair.second) and known[_other(pair, k)]]
        if not linked:
            continue
        best = max(linked, key=lambda pair: len(pair.first_px))
        nearest = _other(best, k)
        before[k] = nearest
        guess = lens[nearest].copy()
        guess[0] += start.lens[k, 0] - start.lens[nearest, 0]
        lens[k] = guess
        rotation = frames.rotation.copy()
        turn = turn_of(best, Frames(rotation, lens, known))
        rotation[k] = rotation[nearest] @ (turn.T if best.first == nearest else turn)
        known[k] = True
        one = np.zeros((count, 4, 4))
        one[k] = np.eye(4)
        held = lens.copy()
        held[k] = 0.0
        moving = np.zeros(count, bool)
        moving[k] = True
        model = LensModel(one, np.eye(4), guess, order, held)
        frames, found, _ = adjust(Frames(rotation, lens, known), guess, model, linked, moving=moving, scale_px=15.0)
        lens[k] = found
    # all at once: the mosaic's intrinsics and each step's, near those of the frame it was reached from
    members = [k for k in steps if known[k]]
    size = 4 * (1 + len(members))
    where = {k: 4 * (1 + n) for n, k in enumerate(members)}
    design = np.zeros((count, 4, size))
    design[:, :, :4] = np.eye(4)
    unknowns = np.concatenate([intrinsics, *(lens[k] for k in members)]) if members else intrinsics
    rows, values, sigmas = [np.eye(4, size)], [first], [loose]
    for k, at in where.items():
        design[k] = 0.0
        design[k, :, at : at + 4] = np.eye(4)
        row = np.zeros((4, size))
        row[:, at : at + 4] = np.eye(4)
        parent = where.get(before[k], 0)
        row[:, parent : parent + 4] -= np.eye(4)
        rows.append(row[1:])
        values.append(np.zeros(3))
        sigmas.append(order[1:])
    model = LensModel(design, np.concatenate(rows), np.concatenate(values), np.concatenate(sigmas))
    frames, _, _ = adjust(replace(frames, valid=known), unknowns, model, pairs, scale_px=6.0)
    return frames


def _other(pair: Pair, frame: int) -> int:
    return pair.second if pair.first == frame else pair.first


def _one_zoom(shots: Shots, start: Frames) -> Mask:
    """(F,) The frames of the sweep, or else the largest group of frames of one zoom."""
    if shots.sequence and shots.full_turn:
        base = np.zeros(len(start.valid), bool)
        base[list(shots.sequence)] = True
        return base & start.valid
    logs = start.lens[:, 0]
    near = (np.abs(logs[:, None] - logs[None, :]) < SAME_ZOOM) & start.valid[None, :] & start.valid[:, None]
    return np.asarray(near[int(np.argmax(near.sum(axis=1)))], np.bool_)


# --------------------------------------------------------------------------------------------------------------
# Wu and Radke (2013)


@dataclass(frozen=True, slots=True, eq=False)
class ZoomModel:
    """The camera as Wu and Radke model it: distortion a smooth function of zoom, principal point where zooming aims."""

    reference_log_focal: float
    principal_px: Array  # (2,)
    k1: Array  # (3,) polynomial in log focal over the reference

    def lens(self, log_focal: float) -> Array:
        """(4,) as in `rotations.Frames`."""
        x = log_focal - self.reference_log_focal
        return np.array([log_focal, *self.principal_px, self.k1 @ x ** np.arange(len(self.k1))])


def wu_radke(shots: Shots, pairs: Sequence[Pair]) -> tuple[Frames, ZoomModel]:
    """The complete model from panned and zoomed frames: simple first values, then one nonlinear fit.

    The principal point is first where the zoom run's pictures expand from. Simplified: our cameras have no encoder, so
    that every zoom step's focal length is free, and distortion a quadratic in its logarithm rather than in a reading;
    rotations are free, for want of readings of pan and tilt.
    """
    start = initial(pairs, len(shots.found), shots.centre_px, GUESS_WIDTHS * shots.width)
    if shots.full_turn:
        start = close_gap(shots, pairs, start)
    count = len(shots.found)
    centre = centre_of_zoom(shots, pairs)
    base = _one_zoom(shots, start)
    reference = float(np.median(start.lens[base, 0]))
    own = [int(k) for k in np.flatnonzero(~base)]
    size = 1 + len(own) + 5  # log focals, principal point, k1's polynomial
    design = np.zeros((count, 4, size))
    design[base, 0, 0] = 1.0
    for n, k in enumerate(own):
        design[k, 0, 1 + n] = 1.0
    design[:, 1, -5] = design[:, 2, -4] = 1.0
    x = np.where(base, 0.0, start.lens[:, 0] - reference)
    design[:, 3, -3:] = x[:, None] ** np.arange(3)
    guess = np.concatenate([[reference], start.lens[own, 0], centre, np.zeros(3)])
    sigmas = np.concatenate([np.full(1 + len(own), 2.0), np.full(2, 0.02 * shots.width), [0.2, 0.2, 0.1]])
    frames, unknowns = start, guess
    for _ in range(3):  # the polynomial's argument is the zoom, which is found at the same time
        model = LensModel(design, np.eye(size), guess, sigmas)
        frames, unknowns, _ = adjust(frames, unknowns, model, pairs)
        x = np.where(base, 0.0, frames.lens[:, 0] - unknowns[0])
        design[:, 3, -3:] = x[:, None] ** np.arange(3)
    return frames, ZoomModel(float(unknowns[0]), unknowns[-5:-3].copy(), unknowns[-3:].copy())


def centre_of_zoom(shots: Shots, pairs: Sequence[Pair]) -> Array:
    """(2,) Where the pictures of the zoom run expand from; the middle of the picture where there is no run."""
    members = set(shots.zoom)
    normal, right = np.zeros((2, 2)), np.zeros(2)
    for pair in pairs:
        if pair.first in members and pair.second in members:
            # p' = c + s (p - c): a similarity without turn
            a, b = pair.first_px.mean(axis=0), pair.second_px.mean(axis=0)
            p, q = pair.first_px - a, pair.second_px - b
            scale = float(np.sum(p * q) / np.sum(p * p))
            share = 1.0 - scale
            normal += len(p) * share**2 * np.eye(2)
            right += len(p) * share * (b - scale * a)
    if normal[0, 0] < 1.0:
        return shots.centre_px
    centre = np.linalg.solve(normal, right)
    return np.asarray(np.clip(centre, shots.centre_px - 0.03 * shots.width, shots.centre_px + 0.03 * shots.width))


class Library:
    """Features on the sphere, with which a frame is found and which it keeps up to date.

    A frame's features are matched with the library's near where the last frame says they are; the pan, tilt, roll and
    zoom that most agree on correct the estimate, the model of the lens staying as it was calibrated. Then the features
    that were found are renewed, those looked for in vain forgotten, and new ones taken in. Simplified: where the camera
    believes it looks is the estimate of the frame before, there being no encoder; no index of images over a grid.
    """

    def __init__(self, shots: Shots, frames: Frames, model: ZoomModel) -> None:
        self._model = model
        self._size = (shots.width, shots.height)
        self._sources = [(k, shots.found[k], frames.rotation[k], frames.lens[k]) for k in np.flatnonzero(frames.valid)]
        self._directions = np.zeros((0, 3))
        self._features = Features(np.zeros((0, 2)), np.zeros((0, 61), np.uint8), np.zeros(0))
        self._missed = np.zeros(0, np.int64)
        for _, found, rotation, lens in self._sources:
            self._insert(found, rotation, lens)
        self._last: tuple[Array, float] | None = None

    def __len__(self) -> int:
        return len(self._directions)

    def locate(self, found: Features) -> tuple[Array, Array, bool]:
        """Rotation (3, 3) and lens (4,) of the next frame, and whether it was found. Renews the library."""
        located = None if self._last is None else self._track(found, *self._last, 40.0)
        if located is None:
            place = self._place(found)
            located = None if place is None else self._track(found, *place, 25.0)
        if located is None:
            self._last = None
            return np.eye(3), self._model.lens(self._model.reference_log_focal), False
        rotation, log_focal = located
        lens = self._model.lens(log_focal)
        self._renew(found, rotation, lens)
        self._last = located
        return rotation, lens, True

    def _seen(self, rotation: Array, lens: Array) -> tuple[Array, Mask]:
        """Where the library's features are seen, and which are in the picture."""
        points = self._directions @ rotation
        front = points[:, 2] > 0.1
        flat = points[:, :2] / np.where(front, points[:, 2], 1.0)[:, None]
        pixels = lens[1:3] + np.exp(lens[0]) * distort(flat, lens[3])
        width, height = self._size
        return pixels, front & (pixels >= 0).all(axis=1) & (pixels < (width, height)).all(axis=1)

    def _track(self, found: Features, rotation: Array, log_focal: float, reach_px: float) -> tuple[Array, float] | None:
        for radius in (reach_px, 0.25 * reach_px):
            lens = self._model.lens(log_focal)
            pixels, inside = self._seen(rotation, lens)
            known = np.flatnonzero(inside)
            if len(known) < 20:
                return None
            pairs = features.match(self._features.subset(known), found, 0.85, (pixels[known], radius))
            if len(pairs) < 15:
                return None
            directions, points = self._directions[known[pairs[:, 0]]], found.points_px[pairs[:, 1]]
            rotation, log_focal, agreed = resect(directions, points, rotation, log_focal, self._model)
            if agreed < 15:
                return None
        return rotation, log_focal

    def _place(self, found: Features) -> tuple[Array, float] | None:
        """First values from the homography with the calibrated frame that matches best."""
        query = len(self._sources)
        best: tuple[int, Pair | None] = (0, None)
        for n, (_, source, _, _) in enumerate(self._sources):
            for match in match_pairs([source, found], [(0, 1)]):
                if len(match.first_px) > best[0]:
                    best = (len(match.first_px), replace(match, first=n, second=query))
        pair = best[1]
        if pair is None:
            return None
        _, _, rotation, lens = self._sources[pair.first]
        start = initial([replace(pair, first=0, second=1)], 2, lens[1:3], float(np.exp(lens[0])))
        log_focal = float(lens[0] + start.lens[1, 0] - start.lens[0, 0])
        pose = Frames(np.tile(np.eye(3), (2, 1, 1)), np.stack([lens, self._model.lens(log_focal)]), np.ones(2, bool))
        return rotation @ turn_of(replace(pair, first=0, second=1), pose).T, log_focal

    def _insert(self, found: Features, rotation: Array, lens: Array) -> None:
        xy = undistort((found.points_px - lens[1:3]) / np.exp(lens[0]), lens[3])
        rays = np.column_stack([xy, np.ones(len(xy))])
        rays = rays / np.linalg.norm(rays, axis=1, keepdims=True) @ rotation.T
        both = (self._features, found)
        self._directions = np.concatenate([self._directions, rays])[-LIBRARY:]
        self._features = Features(
            np.concatenate([each.points_px for each in both])[-LIBRARY:],
            np.concatenate([each.descriptors for each in both])[-LIBRARY:],
            np.concatenate([each.brightness for each in both])[-LIBRARY:],
        )
        self._missed = np.concatenate([self._missed, np.zeros(len(rays), np.int64)])[-LIBRARY:]

    def _renew(self, found: Features, rotation: Array, lens: Array) -> None:
        pixels, inside = self._seen(rotation, lens)
        known = np.flatnonzero(inside)
        pairs = features.match(self._features.subset(known), found, 0.85, (pixels[known], 3.0))
        self._missed[known] += 1
        self._missed[known[pairs[:, 0]]] = np.maximum(self._missed[known[pairs[:, 0]]] - 2, 0)
        keep = self._missed < FORGOTTEN
        self._directions, self._missed = self._directions[keep], self._missed[keep]
        self._features = self._features.subset(keep)
        new = np.ones(len(found), bool)
        new[pairs[:, 1]] = False
        self._insert(found.subset(new), rotation, lens)


def resect(
    directions: Array, points_px: Array, rotation: Array, log_focal: float, model: ZoomModel
) -> tuple[Array, float, int]:
    """Rotation and log focal of a frame that sees ``directions`` (N, 3) at ``points_px`` (N, 2), and how many agree."""
    scale = 20.0
    length = np.zeros(len(points_px))
    for _ in range(15):
        lens = model.lens(log_focal)
        x = log_focal - model.reference_log_focal
        bend = float(model.k1[1:] @ (np.arange(1, len(model.k1)) * x ** np.arange(len(model.k1) - 1)))
        seen = directions @ rotation
        virtual = np.array([0.0, 0.0, 0.0, 0.0])  # a camera of focal length 1 looking the same way
        pixels, by = transfer(virtual, lens, np.eye(3), seen[:, :2] / seen[:, 2:])
        residual = pixels - points_px
        length = np.hypot(*residual.T)
        weight = (scale**2 / (scale**2 + length**2)) ** 2
        jacobian = np.concatenate([by[:, :, 7:10], by[:, :, 10:11] + bend * by[:, :, 13:14]], axis=2).reshape(-1, 4)
        weighted = jacobian * np.repeat(weight, 2)[:, None]
        step = -np.linalg.solve(weighted.T @ jacobian + 1e-9 * np.eye(4), weighted.T @ residual.ravel())
        rotation = rotation @ Rotation.from_rotvec(np.clip(step[:3], -0.2, 0.2)).as_matrix()
        log_focal = float(log_focal + np.clip(step[3], -0.3, 0.3))
        spread = float(np.median(length)) / 1.1774
        if np.abs(step).max() < 1e-7 and scale < 1.05 * max(3.0 * spread, 0.5):
            break
        scale = max(3.0 * spread, scale / 2.0, 0.5)
    return rotation, log_focal, int(np.sum(length < 2.0 * scale))


METHODS: dict[str, Callable[[Shots, Sequence[Pair]], Frames]] = {
    "shum_szeliski": shum_szeliski,
    "sinha_pollefeys": sinha_pollefeys,
    "wu_radke": lambda shots, pairs: wu_radke(shots, pairs)[0],
}
