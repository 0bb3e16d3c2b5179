"""What is estimated of one camera on its head, from matches (`bundle`) or from grey values (`direct`).

The vector of unknowns holds pans, log focals, tilt, roll, the principal point's coefficients (x and y in turn), k1's,
offset, travel, walls and departures. Lengths are in heights of the camera over the floor.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pzcap.geometry import camera as geometry
from pzcap.geometry.camera import PARAMETERS, VIEW, View
from pzcap.geometry.lens import Distortion
from pzcap.types import Array, InverseDepthMap, Lens

CENTRE = len(PARAMETERS)  # where the projection centre begins in a view's vector


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """What a camera did, and what it is."""

    pan_rad: Array  # (P,)
    log_focal: Array  # (Z,); the first is the lens's reference focal length
    pan_of: NDArray[np.int64]  # (F,) index of each frame's pan
    focal_of: NDArray[np.int64]  # (F,) index of each frame's log focal
    tilt_rad: float
    roll_rad: float
    principal_px: Array  # (p, 2) coefficients, as in types.Lens
    k1: Array  # (q,) coefficients
    offset: Array  # (2,) projection centre forward and to the left of the pan axis, camera heights
    travel: float  # of the same, forward along the optical axis, for each unit of log focal
    surroundings: InverseDepthMap  # in camera heights

    def view(self, frame: int) -> View:
        """How ``frame`` was taken; its ``centre_m`` is in camera heights."""
        log_focal = self.log_focal[self.focal_of[frame]]
        x = log_focal - self.log_focal[0]
        return View(
            float(self.pan_rad[self.pan_of[frame]]),
            self.tilt_rad,
            self.roll_rad,
            float(np.exp(log_focal)),
            x ** np.arange(len(self.principal_px)) @ self.principal_px,
            Distortion(float(x ** np.arange(len(self.k1)) @ self.k1)),
            geometry.centre(self.offset, self.travel * float(x), self.tilt_rad),
        )

    def lens(self, width: int, height: int) -> Lens:
        return Lens(width, height, float(np.exp(self.log_focal[0])), self.principal_px, self.k1)


@dataclass(frozen=True, slots=True)
class BeliefConfig:
    """Standard deviations of what is believed of a camera before its footage is seen."""

    tilt_deg: float = 12.0
    """Of tilt and of roll, about 0."""
    principal: float = 0.01
    """Of the principal point about the image's centre, of the image's width."""
    k1: float = 0.1
    """About 0."""
    offset_m: float = 0.03
    """Of the projection centre beside the pan axis."""
    travel_m: float = 0.003
    """Of the same along the optical axis, for each unit of log focal."""


@dataclass(frozen=True, slots=True, eq=False)
class Sigmas:
    """The same of a model, and of what it says of the hall."""

    reference_focal: float  # relative
    angle_rad: float  # tilt and roll
    principal_px: Array  # (p,) for each coefficient
    k1: Array  # (q,)
    offset: float = 0.02  # camera heights
    travel: float = 0.002
    walls: float = 0.2
    unevenness: float = 0.1  # of the walls, from one azimuth to the next
    departures: float = 1e-3  # features are too few to tell
    roughness: float = 1e-3  # of the departures, from one to the next


def vector(model: Model) -> Array:
    """(U,) The unknowns, in the order above."""
    return np.concatenate([
        model.pan_rad, model.log_focal, [model.tilt_rad, model.roll_rad], model.principal_px.ravel(), model.k1,
        model.offset, [model.travel], model.surroundings.walls, model.surroundings.departures.ravel(),
    ])  # fmt: skip


def information(model: Model, sigmas: Sigmas) -> Array:
    """The inverse covariance (U, U) of what is believed before the matches."""
    focal = np.zeros(len(model.log_focal))
    focal[0] = sigmas.reference_focal**-2.0
    rows, around = model.surroundings.departures.shape
    information = np.diag(np.concatenate([
        np.zeros(len(model.pan_rad)), focal, np.full(2, sigmas.angle_rad**-2.0),
        np.repeat(sigmas.principal_px**-2.0, 2), sigmas.k1**-2.0, np.full(2, sigmas.offset**-2.0),
        [sigmas.travel**-2.0], np.full(around, sigmas.walls**-2.0), np.full(rows * around, sigmas.departures**-2.0),
    ]))  # fmt: skip
    if around:
        beside = np.eye(around) - np.roll(np.eye(around), 1, axis=1)
        above = np.diff(np.eye(rows), axis=0)
        rough = np.kron(np.eye(rows), beside.T @ beside) + np.kron(above.T @ above, np.eye(around))
        walls, departures = slice(-nearness_size(model), -rows * around), slice(-rows * around, None)
        information[walls, walls] += beside.T @ beside * sigmas.unevenness**-2.0
        information[departures, departures] += rough * sigmas.roughness**-2.0
    return information


def nearness_size(model: Model) -> int:
    """How many unknowns the surroundings are."""
    return model.surroundings.walls.size + model.surroundings.departures.size


def stepped(model: Model, step: Array) -> Model:
    """The model with ``step`` (U,) added to its unknowns."""
    there = vector(model) + step
    hall = model.surroundings
    counts = [len(model.pan_rad), len(model.log_focal), 2, 2 * len(model.principal_px), len(model.k1), 2, 1]
    pan, focal, angles, principal, k1, offset, travel, walls, departures = np.split(
        there, np.cumsum([*counts, len(hall.walls)])
    )
    return Model(
        pan, focal, model.pan_of, model.focal_of, float(angles[0]), float(angles[1]), principal.reshape(-1, 2), k1,
        offset, float(travel[0]), replace(hall, walls=walls, departures=departures.reshape(hall.departures.shape)),
    )  # fmt: skip


def vectors(model: Model) -> Array:
    """(F, VIEW + 3) every frame's view, as `View.vector`."""
    return np.array([model.view(frame).vector() for frame in range(len(model.pan_of))])


def chains_of(model: Model) -> tuple[Array, NDArray[np.int64]]:
    """The derivatives (F, VIEW, C) of each frame's view with respect to the unknowns it touches, and these (F, C)."""
    pans, focals = len(model.pan_rad), len(model.log_focal)
    p, q = len(model.principal_px), len(model.k1)
    lens = 5 + 2 * p + q  # where the offset's columns begin, after pan, focal, first focal, tilt, roll, the lens
    x = model.log_focal[model.focal_of] - model.log_focal[0]
    powers = x[:, None] ** np.arange(max(p, q))
    slopes = np.arange(max(p, q)) * np.hstack([np.zeros((len(x), 1)), powers[:, :-1]])
    cos_t, sin_t = np.cos(model.tilt_rad), np.sin(model.tilt_rad)
    forward, up = CENTRE, CENTRE + 2
    chains = np.zeros((len(x), VIEW, lens + 3))
    chains[:, 0, 0] = chains[:, 2, 1] = chains[:, 1, 3] = chains[:, 3, 4] = 1.0
    chains[:, 4:6, 1] = slopes[:, :p] @ model.principal_px
    chains[:, 6, 1] = slopes[:, :q] @ model.k1
    chains[:, forward, 1], chains[:, up, 1] = model.travel * cos_t, model.travel * sin_t
    chains[:, 4:, 2] = -chains[:, 4:, 1]  # the lens is a function of the zoom relative to the first focal length
    chains[:, forward, 3], chains[:, up, 3] = -model.travel * x * sin_t, model.travel * x * cos_t
    chains[:, 4, 5 : 5 + 2 * p : 2] = chains[:, 5, 6 : 6 + 2 * p : 2] = powers[:, :p]
    chains[:, 6, 5 + 2 * p : lens] = powers[:, :q]
    chains[:, forward, lens] = chains[:, forward + 1, lens + 1] = 1.0
    chains[:, forward, lens + 2], chains[:, up, lens + 2] = x * cos_t, x * sin_t
    shared = pans + focals + np.arange(2 + 2 * p + q + 3)
    own = np.column_stack([model.pan_of, pans + model.focal_of, np.full(len(x), pans)])
    return chains, np.hstack([own, np.tile(shared, (len(x), 1))]).astype(np.int64)
