"""The parameters of one camera on its head that calibration estimates, from matches (`bundle_adjustment`) or from grey
values (`photometric_bundle_adjustment`), and what is believed of them before.

As a vector they are, in this order: pans, log focals, tilt, roll, the principal point's coefficients (x and y in turn),
k1's coefficients, k2, p1 and p2, offset, travel, inverse distances of walls, and departures from these. Lengths are in
heights of the camera over the floor.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pzcap.calibration.tuning import HALL
from pzcap.geometry import camera as geometry
from pzcap.geometry.camera import PARAMETERS, VIEW, View
from pzcap.geometry.cylinder import inverse_distance
from pzcap.geometry.lens import Distortion
from pzcap.types import Array, InverseDepthMap, Lens

CENTRE = len(PARAMETERS)  # where the projection centre begins in a view's vector


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationParameters:
    """Pans and zooms of a camera's frames, its lens, its place on the head, and the distances of the hall."""

    pan_rad: Array  # (P,)
    log_focal: Array  # (Z,); the first is the lens's reference focal length
    pan_of: NDArray[np.int64]  # (F,) index of each frame's pan
    focal_of: NDArray[np.int64]  # (F,) index of each frame's log focal
    tilt_rad: float
    roll_rad: float
    principal_px: Array  # (p, 2) coefficients, as in types.Lens
    k1: Array  # (q,) coefficients
    higher: Array  # (3,) k2, p1 and p2, the same at all zooms: they bend by a pixel in the corners, at the wide end
    offset: Array  # (2,) projection centre forward and to the left of the pan axis, camera heights
    travel: float  # of the same, forward along the optical axis, for each unit of log focal
    surroundings: InverseDepthMap  # in camera heights

    def view(self, frame: int) -> View:
        """View of ``frame``; its ``centre_m`` is in camera heights."""
        log_focal = self.log_focal[self.focal_of[frame]]
        x = log_focal - self.log_focal[0]
        principal_px = x ** np.arange(len(self.principal_px)) @ self.principal_px
        distortion = Distortion(float(x ** np.arange(len(self.k1)) @ self.k1), *map(float, self.higher))
        pan_rad, centre = self.pan_rad[self.pan_of[frame]], geometry.centre(self.offset, self.travel * x, self.tilt_rad)
        focal_px = float(np.exp(log_focal))
        return View(float(pan_rad), self.tilt_rad, self.roll_rad, focal_px, principal_px, distortion, centre)

    def lens(self, width: int, height: int) -> Lens:
        return Lens(width, height, float(np.exp(self.log_focal[0])), self.principal_px, self.k1, *self.higher[:, None])


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


def to_vector(state: CalibrationParameters) -> Array:
    """The parameters as a vector (U,), in the order above."""
    return np.concatenate([
        state.pan_rad, state.log_focal, [state.tilt_rad, state.roll_rad], state.principal_px.ravel(), state.k1,
        state.higher, state.offset, [state.travel], state.surroundings.walls, state.surroundings.departures.ravel(),
    ])  # fmt: skip


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


def hall_size(state: CalibrationParameters) -> int:
    """Number of parameters, the vector's last, that are distances of the hall."""
    return state.surroundings.walls.size + state.surroundings.departures.size


def retract(state: CalibrationParameters, step: Array) -> CalibrationParameters:
    """The parameters with ``step`` (U,) added to their vector."""
    there, hall, lens = to_vector(state) + step, state.surroundings, (2 * len(state.principal_px), len(state.k1), 3)
    ends = np.cumsum([len(state.pan_rad), len(state.log_focal), 2, *lens, 2, 1, len(hall.walls)])
    pan, focal, angles, principal, k1, higher, offset, travel, walls, departures = np.split(there, ends)
    return CalibrationParameters(
        pan, focal, state.pan_of, state.focal_of, float(angles[0]), float(angles[1]), principal.reshape(-1, 2), k1,
        higher, offset, float(travel[0]),
        replace(hall, walls=walls, departures=departures.reshape(hall.departures.shape)),
    )  # fmt: skip


class ViewJacobians(NamedTuple):
    """The frames' views, and their derivatives by the parameters, for kernels."""

    views: Array  # (F, VIEW + 7) as `View.vector`
    by_parameters: Array  # (F, VIEW, C) by the C parameters that a view depends on
    columns: NDArray[np.int64]  # (F, C) where these stand in the vector
    higher: int  # where k2, p1 and p2, on which all views depend alike, begin in the vector


def view_jacobians(state: CalibrationParameters) -> ViewJacobians:
    """Every frame's view, linearised."""
    pans, focals = len(state.pan_rad), len(state.log_focal)
    p, q = len(state.principal_px), len(state.k1)
    lens = 5 + 2 * p + q  # where the offset's columns begin, after pan, focal, first focal, tilt, roll, the lens
    x = state.log_focal[state.focal_of] - state.log_focal[0]
    powers = x[:, None] ** np.arange(max(p, q))
    slopes = np.arange(max(p, q)) * np.hstack([np.zeros((len(x), 1)), powers[:, :-1]])
    cos_t, sin_t = np.cos(state.tilt_rad), np.sin(state.tilt_rad)
    forward, up = CENTRE, CENTRE + 2
    chain = np.zeros((len(x), VIEW, lens + 3))
    chain[:, 0, 0] = chain[:, 2, 1] = chain[:, 1, 3] = chain[:, 3, 4] = 1.0
    chain[:, 4:6, 1] = slopes[:, :p] @ state.principal_px
    chain[:, 6, 1] = slopes[:, :q] @ state.k1
    chain[:, forward, 1], chain[:, up, 1] = state.travel * cos_t, state.travel * sin_t
    chain[:, 4:, 2] = -chain[:, 4:, 1]  # the lens is a function of the zoom relative to the first focal length
    chain[:, forward, 3], chain[:, up, 3] = -state.travel * x * sin_t, state.travel * x * cos_t
    chain[:, 4, 5 : 5 + 2 * p : 2] = chain[:, 5, 6 : 6 + 2 * p : 2] = powers[:, :p]
    chain[:, 6, 5 + 2 * p : lens] = powers[:, :q]
    chain[:, forward, lens] = chain[:, forward + 1, lens + 1] = 1.0
    chain[:, forward, lens + 2], chain[:, up, lens + 2] = x * cos_t, x * sin_t
    higher = pans + focals + 2 + 2 * p + q
    shared = np.concatenate([np.arange(pans + focals, higher), higher + 3 + np.arange(3)])
    own = np.column_stack([state.pan_of, pans + state.focal_of, np.full(len(x), pans)])
    views = np.array([state.view(frame).vector() for frame in range(len(x))])
    columns = np.hstack([own, np.tile(shared, (len(x), 1))]).astype(np.int64)
    return ViewJacobians(views, chain, columns, higher)
