"""Prior of a camera's parameters, before its footage is seen: standard deviations, and the information matrix that they
make."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pzcap.calibration.parameters import CalibrationParameters, hall_size
from pzcap.calibration.tuning import HALL
from pzcap.geometry.cylinder import inverse_distance
from pzcap.types import Array


@dataclass(frozen=True, slots=True)
class BeliefConfig:
    """Standard deviations of what is believed of a camera before its footage is seen."""

    tilt_deg: float = 12.0
    """Degrees, of tilt and of roll about 0: a tripod is levelled roughly, or tilted towards the floor."""
    principal: float = 0.01
    """Share of the image's width, of the principal point about the image's centre. Lenses are centred to about that."""
    k1: float = 0.1
    """Of k1 about 0: the distortion of usual zoom lenses at their wide end."""
    k2: float = 0.03
    """Of k2 about 0."""
    decentring: float = 0.001
    """Of p1 and p2 about 0: a pixel or two in the corners of a wide image."""
    offset_m: float = 0.03
    """Metres, of the projection centre about the pan axis. A slide head leaves less; a plain head 5 to 15 cm, which the
    footage tells all the same: near and far things shift against each other by pixels."""
    travel_m: float = 0.003
    """Metres a unit of log focal, of the projection centre along the optical axis as the lens zooms."""
    sway_deg: float = 0.015
    """Degrees, of tilt and of roll in a single frame about the camera's: floors spring, and tripods settle."""
    readout: float = 0.6
    """Frame periods, of the read-out time of a rolling shutter about 0: it is no longer than a frame, and shorter in
    most cameras."""


@dataclass(frozen=True, slots=True, eq=False)
class Sigmas:
    """Standard deviations of the parameters, as `information` takes them."""

    reference_focal: float  # relative
    angle_rad: float  # tilt and roll
    principal_px: Array  # (p,) for each coefficient
    k1: Array  # (q,)
    higher: Array  # (3,) k2, p1, p2
    offset: float = 0.02  # camera heights
    travel: float = 0.002  # camera heights a unit of log focal
    walls: float = 0.2  # inverse camera heights
    unevenness: float = 0.1  # of the walls, from one azimuth to the next
    departures: float = 1e-3  # a share of the distance: features are too few to tell
    roughness: float = 1e-3  # of the departures, from one to the next


def information(state: CalibrationParameters, sigmas: Sigmas, apart: NDArray[np.bool_] | None = None) -> Array:
    """Inverse covariance (U, U) of the parameters before the footage is seen; departures are open where something
    stands ``apart`` (R, A) from floor and walls."""
    focal = np.zeros(len(state.log_focal))
    focal[0] = sigmas.reference_focal**-2.0
    rows, around = state.surroundings.departures.shape
    open_to = np.zeros(rows * around, np.bool_) if apart is None else apart.ravel()
    anything = HALL.apart_sigma / max(float(np.linalg.norm(state.offset)), HALL.least_offset)
    information = np.diag(np.concatenate([
        np.zeros(len(state.pan_rad)), focal, np.full(2, sigmas.angle_rad**-2.0),
        np.repeat(sigmas.principal_px**-2.0, 2), sigmas.k1**-2.0, sigmas.higher**-2.0,
        np.full(2, sigmas.offset**-2.0), [sigmas.travel**-2.0], np.full(around, sigmas.walls**-2.0),
        np.where(open_to, max(anything, sigmas.departures), sigmas.departures) ** -2.0,
    ]))  # fmt: skip
    if around:
        across = np.eye(around) - np.roll(np.eye(around), 1, axis=1)  # differences between neighbouring azimuths
        down = np.diff(np.eye(rows), axis=0)  # and slopes
        differences = np.vstack([np.kron(np.eye(rows), across), np.kron(down, np.eye(around))])
        rough = np.where(np.abs(differences) @ open_to > 0, max(anything, sigmas.roughness), sigmas.roughness) ** -2.0
        walls, departures = slice(-hall_size(state), -rows * around), slice(-rows * around, None)
        information[walls, walls] += across.T @ across * sigmas.unevenness**-2.0
        information[departures, departures] += differences.T @ (rough[:, None] * differences)
    return information


def standing_apart(state: CalibrationParameters) -> NDArray[np.bool_]:
    """(R, A) where something stands before the walls or on the floor: there it is much nearer than these are, and
    enough to be seen to shift against them."""
    hall = state.surroundings
    rows, around = hall.departures.shape
    azimuth, slope = np.arange(around) * 2 * np.pi / around, np.linspace(hall.slopes[0], hall.slopes[1], rows)
    behind = inverse_distance(replace(hall, departures=np.zeros((rows, around))), azimuth, slope[:, None])
    nearer = hall.departures - np.median(hall.departures)
    shift_px = np.linalg.norm(state.offset) * np.exp(state.log_focal[0]) * nearer * behind  # from one side to the other
    return np.asarray((nearer > HALL.nearer) & (shift_px > HALL.shift_px))
