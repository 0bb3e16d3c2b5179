"""Robust least squares over matches between frames of one camera on its head: pans, zooms, tilt, roll and lens at once.

Every frame has a pan and a focal length, which it may share with others: the frames of the sweep share the focal
length, those of the zoom run the pan. All share tilt, roll and the lens, polynomials in log focal. A match says that
two pixels of two frames show the same direction; its residual is where the first frame's point would be seen in the
second, minus where it was seen, in pixels of the second. No world points are estimated: between two views from one
point, a rotation carries pixels to pixels (Shum and Szeliski, 2000).

The views are not quite from one point: the slide head leaves the projection centre some millimetres beside the pan
axis, which moves near things by a pixel. How near things are needs to be known only roughly: a floor, and before it a
wall whose distance varies with the azimuth. Lengths are in heights of the camera over the floor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pzcap import camera as geometry
from pzcap.camera import View
from pzcap.types import Array, Lens

SETTLED_RAD = 1e-5  # a step this small ends the adjustment: a hundredth of a pixel
LEAST_SPREAD_PX = 0.01  # no match is better than this, however well all agree


@dataclass(frozen=True, slots=True, eq=False)
class Link:
    """Matches between two frames."""

    first: int
    second: int
    first_px: Array  # (N, 2)
    second_px: Array  # (N, 2)
    log_ratio: Array  # (N,) log of the second frame's brightness there over the first's


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
    nearness: Array  # (A,) inverse distance of the walls, at equally spaced azimuths; none: all is far away

    def view(self, frame: int) -> View:
        """How ``frame`` was taken."""
        log_focal = self.log_focal[self.focal_of[frame]]
        x = log_focal - self.log_focal[0]
        return View(
            float(self.pan_rad[self.pan_of[frame]]),
            self.tilt_rad,
            self.roll_rad,
            float(np.exp(log_focal)),
            x ** np.arange(len(self.principal_px)) @ self.principal_px,
            float(x ** np.arange(len(self.k1)) @ self.k1),
        )

    def lens(self, width: int, height: int) -> Lens:
        return Lens(width, height, float(np.exp(self.log_focal[0])), self.principal_px, self.k1)


@dataclass(frozen=True, slots=True, eq=False)
class Sigmas:
    """Standard deviations of what is believed before the matches."""

    reference_focal: float  # relative
    angle_rad: float  # tilt and roll
    principal_px: Array  # (p,) for each coefficient
    k1: Array  # (q,)
    offset: float = 0.02
    nearness: float = 0.2
    unevenness: float = 0.1  # of nearness, from one azimuth to the next


@dataclass(frozen=True, slots=True, eq=False)
class Adjusted:
    model: Model
    residual_px: float  # RMS of the inliers
    inliers: NDArray[np.int64]  # a link


def adjust(
    start: Model,
    links: Sequence[Link],
    sigmas: Sigmas,
    *,
    prior: Model | None = None,
    scale_px: float = 8.0,
    iterations: int = 20,
) -> Adjusted:
    """Fit the model to ``links``; the pan of the first frame stays what it is.

    ``sigmas`` are about ``prior``, or else about ``start``. Weights fall with a residual's length (Geman and McClure,
    1987), by a scale that starts at ``scale_px`` and follows the residuals down.
    """
    mean = _vector(start if prior is None else prior)
    model, scale = start, scale_px
    believed = _information(start, sigmas)
    for _ in range(iterations):
        normal, gradient = np.zeros((len(believed), len(believed))), np.zeros(len(believed))
        lengths = []
        for link in links:
            residual, jacobian, columns = _linearised(model, link)
            lengths.append(np.hypot(residual[:, 0], residual[:, 1]))
            weight = (scale**2 / (scale**2 + lengths[-1] ** 2)) ** 2
            weighted = jacobian * np.repeat(weight, 2)[:, None]
            np.add.at(normal, np.ix_(columns, columns), weighted.T @ jacobian)
            np.add.at(gradient, columns, weighted.T @ residual.ravel())
        spread = max(float(np.median(np.concatenate(lengths))) / 1.1774, LEAST_SPREAD_PX)  # of one coordinate
        normal += believed * spread**2
        gradient += spread**2 * believed @ (_vector(model) - mean)
        normal[model.pan_of[0]] = 0.0
        normal[model.pan_of[0], model.pan_of[0]] = 1.0
        gradient[model.pan_of[0]] = 0.0
        step = np.asarray(-np.linalg.solve(normal, gradient), np.float64)
        model = _stepped(model, step)
        next_scale = max(3.0 * spread, 0.1)
        if np.abs(step[: len(model.pan_rad)]).max() < SETTLED_RAD and abs(next_scale - scale) < 0.05 * scale:
            break
        scale = max(next_scale, scale / 3.0)
    inliers = [length < 2.0 * scale for length in lengths]
    kept = np.concatenate([length[good] for length, good in zip(lengths, inliers, strict=True)])
    return Adjusted(
        model,
        float(np.sqrt(np.mean(kept**2))),
        np.array([int(good.sum()) for good in inliers]),
    )


def thinned(links: Sequence[Link], every: int) -> list[Link]:
    """One match in ``every``, for a quick first adjustment."""
    keep = slice(None, None, every)
    return [
        Link(link.first, link.second, link.first_px[keep], link.second_px[keep], link.log_ratio[keep]) for link in links
    ]


def _linearised(model: Model, link: Link) -> tuple[Array, Array, NDArray[np.int64]]:
    """Residuals (N, 2) of a link, derivatives (2 N, C), and which unknowns (C,) they are with respect to."""
    first, second = model.view(link.first), model.view(link.second)
    azimuth, slope = geometry.look(first, link.first_px)
    by_offset, by_nearness, nodes = np.zeros((len(azimuth), 2, 2)), np.zeros((len(azimuth), 2, 0)), np.zeros(0, int)
    moved = np.zeros((len(azimuth), 2))
    if len(model.nearness):
        moved, by_offset, by_nearness, nodes = _parallax(model, first.pan_rad, second.pan_rad, azimuth, slope)
    seen, by_views, by_direction = transfer(first, second, (azimuth, slope), moved)
    residual = seen - link.second_px
    columns, chain = _chain(model, link)
    count = len(_vector(model)) - len(model.nearness)
    jacobian = np.concatenate([by_views @ chain, by_direction @ by_offset, by_direction @ by_nearness], axis=2)
    columns = np.concatenate([columns, [count - 2, count - 1], count + nodes])
    return residual, jacobian.reshape(2 * len(residual), -1), columns


def _parallax(
    model: Model, first_pan: float, second_pan: float, azimuth: Array, slope: Array
) -> tuple[Array, Array, Array, NDArray[np.int64]]:
    """How directions (N,) move from one frame to another, as the projection centre goes round the pan axis.

    Returns (N, 2) azimuth and slope, their derivatives with respect to the offset (N, 2, 2) and to the nearness at
    some azimuths (N, 2, n), and which azimuths (n,) these are.
    """
    nodes = len(model.nearness)
    place = np.mod(azimuth / (2 * np.pi), 1.0) * nodes
    below = np.floor(place).astype(np.int64)
    share = place - below
    wall = (1.0 - share) * model.nearness[below % nodes] + share * model.nearness[(below + 1) % nodes]
    near = np.maximum(wall, -slope)
    sin = np.sin(azimuth - second_pan) - np.sin(azimuth - first_pan)
    cos = np.cos(azimuth - second_pan) - np.cos(azimuth - first_pan)
    forward = np.stack([sin, slope * cos], axis=1)  # of (azimuth, slope), by nearness times offset
    left = np.stack([-cos, slope * sin], axis=1)
    by_near = model.offset[0] * forward + model.offset[1] * left
    by_offset = near[:, None, None] * np.stack([forward, left], axis=2)
    used, where = np.unique(np.concatenate([below % nodes, (below + 1) % nodes]), return_inverse=True)
    by_nearness = np.zeros((len(azimuth), 2, len(used)))
    rows, walled = np.arange(len(azimuth)), (wall > -slope).astype(np.float64)
    by_nearness[rows, :, where[: len(rows)]] = by_near * ((1.0 - share) * walled)[:, None]
    by_nearness[rows, :, where[len(rows) :]] += by_near * (share * walled)[:, None]
    return by_near * near[:, None], by_offset, by_nearness, used


def transfer(first: View, second: View, direction: tuple[Array, Array], moved: Array) -> tuple[Array, Array, Array]:
    """Where in the second frame (N, 2) the first frame's points are seen; derivatives (N, 2, 14) and (N, 2, 2).

    The points are given by the azimuth and slope (N,) to which the first frame looks through them (`camera.look`), and
    ``moved`` (N, 2) is added to these on the way. The derivatives hold the pixels in the first frame, and are with
    respect to the `camera.PARAMETERS` of the first view, then of the second; and to the directions.
    """
    azimuth, slope = direction
    by_first, by_direction = geometry.derivatives(first, azimuth, slope)
    azimuth, slope = azimuth + moved[:, 0], slope + moved[:, 1]
    seen, _ = geometry.see(second, azimuth, slope)
    by_second, by_second_direction = geometry.derivatives(second, azimuth, slope)
    # the pixel in the first frame stays: its direction moves against what the parameters do to it
    through = by_second_direction @ _inverse_2x2(by_direction) @ by_first
    return seen, np.concatenate([-through, by_second], axis=2), by_second_direction


def _inverse_2x2(matrices: Array) -> Array:
    a, b, c, d = matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 0], matrices[:, 1, 1]
    inverse = np.empty_like(matrices)
    inverse[:, 0, 0], inverse[:, 0, 1], inverse[:, 1, 0], inverse[:, 1, 1] = d, -b, -c, a
    return inverse / (a * d - b * c)[:, None, None]


# The vector of unknowns: pans, log focals, tilt, roll, principal point's coefficients (x and y in turn), k1's, offset,
# nearness.


def _vector(model: Model) -> Array:
    return np.concatenate([
        model.pan_rad, model.log_focal, [model.tilt_rad, model.roll_rad], model.principal_px.ravel(), model.k1,
        model.offset, model.nearness,
    ])  # fmt: skip


def _information(model: Model, sigmas: Sigmas) -> Array:
    focal = np.zeros(len(model.log_focal))
    focal[0] = sigmas.reference_focal**-2.0
    walls = len(model.nearness)
    information = np.diag(np.concatenate([
        np.zeros(len(model.pan_rad)), focal, np.full(2, sigmas.angle_rad**-2.0),
        np.repeat(sigmas.principal_px**-2.0, 2), sigmas.k1**-2.0, np.full(2, sigmas.offset**-2.0),
        np.full(walls, sigmas.nearness**-2.0),
    ]))  # fmt: skip
    steps = np.eye(walls) - np.roll(np.eye(walls), 1, axis=1)
    information[len(information) - walls :, len(information) - walls :] += steps.T @ steps * sigmas.unevenness**-2.0
    return information


def _stepped(model: Model, step: Array) -> Model:
    vector = _vector(model) + step
    pans, focals, p, q = len(model.pan_rad), len(model.log_focal), len(model.principal_px), len(model.k1)
    rest = vector[pans + focals :]
    return Model(
        vector[:pans], vector[pans : pans + focals], model.pan_of, model.focal_of, float(rest[0]), float(rest[1]),
        rest[2 : 2 + 2 * p].reshape(p, 2), rest[2 + 2 * p : 2 + 2 * p + q], rest[2 + 2 * p + q : 4 + 2 * p + q],
        rest[4 + 2 * p + q :],
    )  # fmt: skip


def _chain(model: Model, link: Link) -> tuple[NDArray[np.int64], Array]:
    """Which unknowns a link touches (C,), and the derivatives (14, C) of its two views with respect to them."""
    pans, focals = len(model.pan_rad), len(model.log_focal)
    p, q = len(model.principal_px), len(model.k1)
    shared = pans + focals + np.arange(2 + 2 * p + q)
    columns = np.concatenate([
        model.pan_of[[link.first, link.second]], pans + model.focal_of[[link.first, link.second]], [pans], shared,
    ])  # fmt: skip
    chain = np.zeros((14, len(columns)))
    for side, frame in enumerate((link.first, link.second)):
        rows = chain[7 * side : 7 * side + 7]
        x = model.log_focal[model.focal_of[frame]] - model.log_focal[0]
        powers = x ** np.arange(max(p, q))
        slopes = np.arange(max(p, q)) * np.concatenate([[0.0], powers[:-1]])
        rows[0, side] = rows[2, 2 + side] = 1.0
        rows[4:6, 2 + side] = slopes[:p] @ model.principal_px
        rows[6, 2 + side] = slopes[:q] @ model.k1
        rows[4:7, 4] = -rows[4:7, 2 + side]  # the lens is a function of the zoom relative to the first focal length
        rows[1, 5] = rows[3, 6] = 1.0
        rows[4, 7 : 7 + 2 * p : 2] = rows[5, 8 : 8 + 2 * p : 2] = powers[:p]
        rows[6, 7 + 2 * p :] = powers[:q]
    return columns, chain
