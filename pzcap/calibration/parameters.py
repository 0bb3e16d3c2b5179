"""The parameters of one camera on its head that calibration estimates, from matches (`bundle_adjustment`) or from grey
values (`photometric_bundle_adjustment`).

As a vector they are, in this order: pans, log focals, tilt, roll, the principal point's coefficients (x and y in turn),
k1's coefficients, k2, p1 and p2, offset, travel, inverse distances of walls, and departures from these. Lengths are in
heights of the camera over the floor.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pzcap.geometry import camera as geometry
from pzcap.geometry.camera import PARAMETERS, VIEW, View
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


def to_vector(state: CalibrationParameters) -> Array:
    """The parameters as a vector (U,), in the order above."""
    return np.concatenate([
        state.pan_rad, state.log_focal, [state.tilt_rad, state.roll_rad], state.principal_px.ravel(), state.k1,
        state.higher, state.offset, [state.travel], state.surroundings.walls, state.surroundings.departures.ravel(),
    ])  # fmt: skip


def hall_size(state: CalibrationParameters) -> int:
    """Number of parameters, the vector's last, that are distances of the hall."""
    return state.surroundings.walls.size + state.surroundings.departures.size


def place_of_travel(state: CalibrationParameters) -> int:
    """Index of the travel in the vector."""
    return len(to_vector(state)) - hall_size(state) - 1


def place_of_k2(state: CalibrationParameters) -> int:
    """Index of k2 in the vector."""
    return place_of_travel(state) - len(state.offset) - len(state.higher)


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
