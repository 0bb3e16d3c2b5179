"""Time of a pixel: views are not exposed at one instant, and the athlete moves meanwhile.

A camera's clock is off from the others' by ``d``, and with a rolling shutter row v of H is exposed ``r tau`` after the
middle row, tau = (v + 1/2) / H - 1/2. A point that moves with the velocity ``u`` and the acceleration ``a`` is seen
where it is at

    x + t u + t^2 a / 2,   t = d + r tau                                  (times in frame periods)

(between two frames a hand is a centimetre off the straight line in a somersault; of fields, ``a`` is taken for 0).
`Exposure` holds d and r of a view, and how late a picture came whose stamps are uneven; `exposed` puts the skin there.
The derivative by d is the segments' velocity then, a twist
``M_s`` of each, so that the normal equations of the clocks follow from those of the segments as the cameras' do
(`pzcap.tracking.camera_refinement`): ``C = sum_s M_s' H_s M_s``, ``c = sum_s M_s' g_s``, ``B = sum_s T_s' H_s M_s``.
All frames of an interval share the clocks (`ClockEstimate`). What shifts all of them alike is a shift of the motion in
time, which no image shows: it stays at the prior's mean of 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
from numba import njit

from pzcap.body.kinematics import Coordinates, coordinates, segment_end, turned
from pzcap.body.segment_equations import SegmentSums
from pzcap.body.skeleton import DOF_SEGMENT
from pzcap.geometry.pinhole import NEAREST_M, Pinhole, pinhole, projected, ray, to_pixel
from pzcap.imaging.row_bands import row_time
from pzcap.tracking.camera_refinement import CAMERA_DOF, MarginalisedCamera
from pzcap.tracking.tuning import CLOCK
from pzcap.tracking.visibility import SkinPoints
from pzcap.types import DOF, PARENTS, SEGMENTS, Array, Camera, Indices


class Exposure(NamedTuple):
    """Times of a view, in frame periods."""

    clock: float = 0.0  # after the instant that the frame set stands for
    readout: float = 0.0  # from its top edge to its bottom edge
    late: float = 0.0  # of this picture alone, by its stamp, beside what the clock is off by

    def times(self, rows: Array, height: int) -> Array:
        """Time (N,) of pixel ``rows`` (N,) of an image that is ``height`` high."""
        return np.asarray(self.clock + self.late + self.readout * np.clip(row_time(rows, height), -0.5, 0.5))


AT_ONCE: Final = Exposure()
AT_REST: Final = np.zeros((len(SEGMENTS), 12))  # rates of segments that do not move


def rates_between(before: Array, after: Array, periods: float) -> Array:
    """(16, 12) Rates of the segments, world, a frame period, from ``before`` to ``after`` (16, 4, 4), which are so many
    ``periods`` apart: velocity of each one's joint, its angular velocity, and the acceleration of both, of which two
    instants know nothing: 0."""
    return np.hstack([_moved(before, after) / periods, np.zeros((len(before), 6))])


def sequence_rates(frames: Sequence[Array], period: float) -> list[Array]:
    """Rates (16, 12), as in `rates_between`, at each of successive instants (16, 4, 4), one every ``period`` frame
    periods: central differences, so that the three instants about each are met. At the ends nothing is known of the
    acceleration; nor is it of fields, since a clock half a frame off leads beyond the next field, where a parabola
    through three goes anywhere."""
    if len(frames) < 2:
        return [AT_REST] * len(frames)
    steps = [_moved(before, after) / period for before, after in pairwise(frames)]
    per_period = 0.0 if abs(period) < 1.0 else 1.0 / period
    inner = [np.hstack([(before + after) / 2.0, (after - before) * per_period]) for before, after in pairwise(steps)]
    ends = [np.hstack([step, np.zeros_like(step)]) for step in (steps[0], steps[-1])]
    return [ends[0], *inner, ends[1]]


def _moved(before: Array, after: Array) -> Array:
    """(16, 6) By how much joints have moved and segments turned."""
    return np.hstack([after[:, :3, 3] - before[:, :3, 3], turned(before, after)])


def exposed(skin: SkinPoints, world_T_segment: Array, rates: Array, camera: Camera, exposure: Exposure) -> Array:
    """Points (V, 3) of the ``skin`` where they are when the camera exposes them, a coordinate after the other in
    memory; ``rates`` (16, 12) as in `rates_between`."""
    out = np.empty_like(skin.points)
    rows = row_time(_ROWS, camera.height).tolist()
    first, clock = (rows[0], rows[1] - rows[0]), exposure.clock + exposure.late
    eye, joints = pinhole(camera), world_T_segment[:, :3, 3]
    _expose(skin.points, skin.segment, joints, rates, eye, first, (clock, exposure.readout), out)
    return out


_ROWS: Final = np.array([0.0, 1.0])


@njit(cache=True, nogil=True, error_model="numpy")
def _expose(
    points: Array, segment: Indices, joints: Array, rates: Array, camera: Pinhole, rows: tuple[float, float],
    exposure: tuple[float, float], out: Array,
) -> None:  # fmt: skip
    """``rows``: time of the first one, and from one to the next. ``exposure``: clock and readout."""
    time = np.empty(len(points))
    for n in range(len(points)):  # a loop of its own, which the compiler vectorises
        across, down, depth = ray(points[n, 0], points[n, 1], points[n, 2], camera)
        row = to_pixel(across, down, camera)[1]
        row = row if depth >= NEAREST_M else 0.0
        time[n] = exposure[0] + exposure[1] * min(max(rows[0] + rows[1] * row, -0.5), 0.5)
    begin = 0
    while begin < len(points):
        end, s = segment_end(segment, begin), segment[begin]
        here, there = coordinates(points, begin, end), coordinates(out, begin, end)
        _move_on(here, joints[s], rates[s], time[begin:end], there)
        begin = end


@njit(cache=True, nogil=True)
def _move_on(here: Coordinates, joint: Array, rates: Array, time: Array, out: Coordinates) -> None:
    """Points of a segment whose ``joint`` and turn have the ``rates`` (12,), each after its ``time`` (N,)."""
    (px, py, pz), (ox, oy, oz) = here, out
    jx, jy, jz = joint[0], joint[1], joint[2]
    vx, vy, vz, wx, wy, wz = rates[0], rates[1], rates[2], rates[3], rates[4], rates[5]
    ax, ay, az, bx, by, bz = rates[6], rates[7], rates[8], rates[9], rates[10], rates[11]
    for n in range(len(time)):
        x, y, z, t = px[n] - jx, py[n] - jy, pz[n] - jz, time[n]
        ux, uy, uz = wy * z - wz * y, wz * x - wx * z, wx * y - wy * x
        half = 0.5 * t
        ox[n] = px[n] + t * (vx + ux + half * (ax + by * z - bz * y + wy * uz - wz * uy))
        oy[n] = py[n] + t * (vy + uy + half * (ay + bz * x - bx * z + wz * ux - wx * uz))
        oz[n] = pz[n] + t * (vz + uz + half * (az + bx * y - by * x + wx * uy - wy * ux))


def moved_frames(world_T_segment: Array, rates: Array, time: Array) -> Array:
    """Segments (..., S, 4, 4) of the ``rates`` (S, 12) or (..., S, 12) after ``time`` (..., S)."""
    after = time[..., None]
    out, moved = world_T_segment.copy(), after * (rates[..., :6] + 0.5 * after * rates[..., 6:])
    _move(moved.reshape(-1, 6), out.reshape(-1, 4, 4))
    return out


@njit(cache=True, nogil=True)
def _move(moved: Array, frames: Array) -> None:
    """Shift and turn ``frames`` (N, 4, 4), in place, by ``moved`` (N, 6): metres, and rotation vectors about the axes
    of the world."""
    for n in range(len(frames)):
        x, y, z = moved[n, 3], moved[n, 4], moved[n, 5]
        squared = x * x + y * y + z * z
        angle = np.sqrt(squared)
        small = angle < 1e-4
        sine = 1.0 - squared / 6.0 if small else np.sin(angle) / angle
        rest = 0.5 - squared / 24.0 if small else (1.0 - np.cos(angle)) / squared
        for i in range(3):
            a, b, c = frames[n, 0, i], frames[n, 1, i], frames[n, 2, i]
            along = rest * (x * a + y * b + z * c)
            cosine = 1.0 - rest * squared
            frames[n, 0, i] = cosine * a + sine * (y * c - z * b) + along * x
            frames[n, 1, i] = cosine * b + sine * (z * a - x * c) + along * y
            frames[n, 2, i] = cosine * c + sine * (x * b - y * a) + along * z
            frames[n, i, 3] += moved[n, i]


def exposed_frames(world_T_segment: Array, rates: Array | None, camera: Camera, exposure: Exposure) -> Array:
    """Segments (..., S, 4, 4) of the ``rates``, as `moved_frames` has them, where they are when the camera exposes
    their joints; None: they are not known."""
    if rates is None or exposure == AT_ONCE:
        return world_T_segment
    rows = projected(world_T_segment[..., :3, 3].reshape(-1, 3), camera)[0][:, 1]
    time = exposure.times(rows, camera.height).reshape(world_T_segment.shape[:-2])
    return moved_frames(world_T_segment, rates, time)


# --------------------------------------------------------------------------------------------------------------
# Clocks


class ClockEquations(NamedTuple):
    """Normal equations of one view's clock at one instant."""

    information: float  # C
    pull: float  # c
    cross: Array  # (43,) B

    def after(self, step: Array, tick: float) -> ClockEquations:
        """The equations after a small ``step`` (43,) of the pose and ``tick`` of the clock."""
        return self._replace(pull=self.pull - float(self.cross @ step) - self.information * tick)


def clock_equations(
    view: SegmentSums, velocity: Array, world_T_segment: Array, twists: Array,
    camera: tuple[MarginalisedCamera, Array] | None,
) -> ClockEquations:  # fmt: skip
    """Normal equations of the clock of a view that has made the normal equations ``view`` of the segments. ``velocity``
    (16, 6) is theirs at its time, ``twists`` (43, 6) those by the pose. Where the view's ``camera`` is eliminated from
    the pose's equations, it is given with its `segment_twists`, and eliminated from these, too."""
    moves = _NO_MOVES if camera is None else camera[1]
    information, pull, with_camera, cross = _clock_sums(view, velocity, world_T_segment, twists, moves)
    if camera is not None:
        free = camera[0]
        information -= float(with_camera @ free.covariance @ with_camera)
        pull -= float(with_camera @ free.pull)
        cross -= with_camera @ free.give
    return ClockEquations(information, pull, cross)


_NO_MOVES: Final = np.zeros((len(SEGMENTS), 6, CAMERA_DOF))


@njit(cache=True, nogil=True)
def _clock_sums(
    view: SegmentSums, velocity: Array, world_T_segment: Array, twists: Array, moves: Array
) -> tuple[float, float, Array, Array]:
    """C, c and B of one view, and the cross term (2,) with its camera, by which the segments make ``moves``."""
    information, pull, with_camera = 0.0, 0.0, np.zeros(moves.shape[2])
    moved = np.zeros(velocity.shape)  # H M, of a segment and all that hang on it
    for s in range(len(velocity) - 1, -1, -1):  # parents come before their children
        twist, arm = velocity[s].copy(), view.centre - world_T_segment[s, :3, 3]
        twist[0] += velocity[s, 4] * arm[2] - velocity[s, 5] * arm[1]
        twist[1] += velocity[s, 5] * arm[0] - velocity[s, 3] * arm[2]
        twist[2] += velocity[s, 3] * arm[1] - velocity[s, 4] * arm[0]
        for i in range(6):  # sums, as in `pzcap.tracking.camera_refinement.eliminate`
            own = 0.0
            for j in range(6):
                own += view.hessians[s, i, j] * twist[j]
            moved[s, i] += own
            information += own * twist[i]
            pull += twist[i] * view.gradients[s, i]
            for k in range(len(with_camera)):
                with_camera[k] += moves[s, i, k] * own
        if PARENTS[s] >= 0:
            moved[PARENTS[s]] += moved[s]
    cross = np.zeros(DOF)
    for d in range(DOF):
        for i in range(6):
            cross[d] += twists[d, i] * moved[DOF_SEGMENT[d], i]
    return information, pull, with_camera, cross


@dataclass(frozen=True, slots=True, eq=False)
class ClockEstimate:
    """Clocks of the cameras, frame periods, about the instant that a frame set stands for."""

    clock: Array  # (C,)
    information: Array  # (C, C)

    @staticmethod
    def of(cameras: int, sigma: float) -> ClockEstimate:
        """Estimate before any image: each known to ``sigma``, their mean to be 0."""
        return ClockEstimate(np.zeros(cameras), np.eye(cameras) / max(sigma, 1e-6) ** 2 + CLOCK.together)

    def after(self, periods: float) -> ClockEstimate:
        """The estimate so many frame periods later: clocks drift."""
        drifted = np.linalg.inv(self.information) + (CLOCK.drift * periods) ** 2 * np.eye(len(self.clock))
        return replace(self, information=np.asarray(np.linalg.inv(drifted), np.float64))

    @property
    def sigma(self) -> Array:
        """(C,) standard deviations from the mean of all: what all have in common no image shows. Skin is sampled where
        clocks have it so far, so that they come out too small by a share of themselves."""
        apart = np.eye(len(self.clock)) - 1.0 / len(self.clock)
        variance = np.diag(apart @ np.linalg.inv(self.information) @ apart)
        return np.sqrt(variance + (CLOCK.short * (apart @ self.clock)) ** 2)


class ClockSystem:
    """Normal equations of all clocks, gathered from instants whose poses are eliminated."""

    def __init__(self, prior: ClockEstimate) -> None:
        self._prior = prior
        self._information = np.zeros_like(prior.information)
        self._pull = np.zeros_like(prior.clock)

    def add(self, clocks: Sequence[ClockEquations | None], hessian: Array, gradient: Array) -> Array:
        """Add an instant with the normal equations of its pose, (43, 43) and (43,); return the cross terms (43, C)."""
        cross = np.zeros((DOF, len(clocks)))
        for c, one in enumerate(clocks):
            if one is not None:
                cross[:, c] = one.cross
                self._information[c, c] += one.information
                self._pull[c] += one.pull
        solved = np.linalg.solve(hessian, np.column_stack([cross, gradient]))
        self._information -= cross.T @ solved[:, :-1]
        self._pull -= cross.T @ solved[:, -1]
        return cross

    def solve(self, clock: Array) -> ClockEstimate:
        """The clocks, which are at ``clock`` (C,) now."""
        prior, worth = self._prior, 1.0 / CLOCK.doubt
        information = prior.information + worth * self._information
        pull = worth * self._pull - prior.information @ (clock - prior.clock)
        return ClockEstimate(clock + np.linalg.solve(information, pull), information)
