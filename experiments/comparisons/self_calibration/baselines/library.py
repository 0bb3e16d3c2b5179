"""Wu and Radke (2013): a library of features, with which a calibrated camera is followed from frame to frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from experiments.comparisons.self_calibration.baselines.adjustment import LENS, transfer
from experiments.comparisons.self_calibration.baselines.methods import ZoomModel
from experiments.comparisons.self_calibration.baselines.rotations import Frames, Pair, initial, match_pairs, turn_of
from experiments.comparisons.self_calibration.baselines.shots import Shots
from pzcap.calibration import features
from pzcap.calibration.features import Features
from pzcap.geometry.lens import Distortion, distort, undistort
from pzcap.solver.gauss_newton import NormalEquations, Schedule, minimise
from pzcap.solver.robust import geman_mcclure, planar_sigma
from pzcap.types import Array, Mask

LIBRARY = 20000  # features, at most
FORGOTTEN = 5  # a feature of the library that was looked for in vain so many times more than found is dropped


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
        """Pixels of the library's features, and which are in the picture."""
        points = self._directions @ rotation
        front = points[:, 2] > 0.1
        flat = points[:, :2] / np.where(front, points[:, 2], 1.0)[:, None]
        pixels = lens[1:3] + np.exp(lens[0]) * distort(flat, Distortion(lens[3]))
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
        xy = undistort((found.points_px - lens[1:3]) / np.exp(lens[0]), Distortion(lens[3]))
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

    def seen(rotation: Array, log_focal: float) -> tuple[Array, Array]:
        """Residuals (N, 2) and their derivatives (N, 2, 14), from a camera of focal length 1 looking the same way."""
        rays = directions @ rotation
        pixels, by = transfer(np.zeros(LENS), model.lens(log_focal), np.eye(3), rays[:, :2] / rays[:, 2:])
        return pixels - points_px, by

    def linearise(state: tuple[Array, float], scale: float) -> NormalEquations:
        residual, by = seen(*state)
        x = state[1] - model.reference_log_focal
        bend = float(model.k1[1:] @ (np.arange(1, len(model.k1)) * x ** np.arange(len(model.k1) - 1)))
        length = np.hypot(*residual.T)
        weight = geman_mcclure(length, scale)
        jacobian = np.concatenate([by[:, :, 7:10], by[:, :, 10:11] + bend * by[:, :, 13:14]], axis=2).reshape(-1, 4)
        weighted = jacobian * np.repeat(weight, 2)[:, None]
        normal, gradient = weighted.T @ jacobian + 1e-9 * np.eye(4), weighted.T @ residual.ravel()
        return NormalEquations(normal, gradient, planar_sigma(length), float(weight @ length**2))

    def retract(state: tuple[Array, float], step: Array) -> tuple[Array, float]:
        turn = Rotation.from_rotvec(np.clip(step[:3], -0.2, 0.2)).as_matrix()
        return state[0] @ turn, float(state[1] + np.clip(step[3], -0.3, 0.3))

    schedule = Schedule(15, 20.0, least_scale=0.5, fall=2.0, steady=0.05)
    found = minimise((rotation, log_focal), linearise, retract, lambda step: bool(np.abs(step).max() < 1e-7), schedule)
    length = np.hypot(*seen(*found.state)[0].T)
    return *found.state, int(np.sum(length < 2.0 * found.scale))
