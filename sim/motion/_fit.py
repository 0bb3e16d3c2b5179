"""Fit a motion to the floor and to gravity: authored poses go in, a motion that could have happened comes out.

All poses of a clip are solved for at once by Gauss-Newton. The objective asks for the authored poses and for smooth
rotations, softly, and firmly for physics: what stands on the floor stays where it stands, nothing enters the floor,
joints keep their limits, and in flight the centre of mass falls with g.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation
from scipy.special import expit

from pzcap.types import HINGE_AXES, SEGMENTS, Array, Mask
from sim.motion._clip import END_POINTS, FRAME_RATE, MotionClip
from sim.motion._kinematics import DOF, DOFS, Frames, log, skew
from sim.motion._normal import NormalEquations
from sim.people.anthropometry import body_tree, joint_limit_rad

KNOT_RATE: Final = 90
DENSE_RATE: Final = 240
GRAVITY: Final = np.array([0.0, 0.0, -9.81])

# Standard deviations of the residuals: the smaller, the harder the demand.
_POSE_RAD: Final = 0.20
_SMOOTH_RAD_S2: Final = 120.0  # angular acceleration
_SUPPORTED_M_S2: Final = 15.0  # acceleration of the centre of mass while something stands on the floor
_EDGE_M_S2: Final = 5.0
_BALLISTIC_M_S2: Final = 0.05
_SUPPORTED_SPIN_M2_S2: Final = 12.0  # rate of change of angular momentum over the body's mass
_SPIN_M2_S2: Final = 0.2
_CONTACT_M: Final = 0.0004
_PASSING_M: Final = 0.015
_FLOOR_M: Final = 0.001
_FLOOR_SOFT_M: Final = 0.002
_LIMIT_RAD: Final = 0.01
_LIMIT_MARGIN_RAD: Final = 0.02


@dataclass(frozen=True, slots=True)
class Contact:
    """Something stands on the floor: "left_heel", "left_toe" or "left_hand", or the same on the right."""

    point: str
    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True, eq=False)
class FloorPoint:
    """A ball on a segment that may touch the floor but not enter it."""

    name: str
    segment: int
    local_m: Array  # (3,)
    radius_m: float


def floor_points(measurements: dict[str, float]) -> tuple[FloorPoint, ...]:
    """Return the points of a person with these measurements that may touch the floor."""
    m, points = measurements, []
    for side in ("left", "right"):
        foot, hand = SEGMENTS.index(f"{side}_foot"), SEGMENTS.index(f"{side}_hand")
        sole, half_width = -m["ankle_height"], 0.16 * m["foot"]
        for name, x, y in (("heel", -0.25, 0.0), ("toe", 0.70, 1.0), ("toe", 0.70, -1.0)):
            points.append(FloorPoint(f"{side}_{name}", foot, np.array([x * m["foot"], y * half_width, sole]), 0.0))
        for along, radius in ((0.30, 0.022), (0.92, 0.012)):
            points.append(FloorPoint(f"{side}_hand", hand, np.array([0.0, 0.0, -along * m["hand"]]), radius))
        points.append(FloorPoint("", SEGMENTS.index(f"{side}_shank"), np.zeros(3), m["girth_knee"] / 6.0))
        points.append(FloorPoint("", SEGMENTS.index(f"{side}_forearm"), np.zeros(3), m["girth_elbow"] / 6.0))
    points.append(FloorPoint("", SEGMENTS.index("head"), np.array([0.02, 0.0, 0.55 * m["head"]]), 0.5 * m["head"]))
    return tuple(points)


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """The parts of the problem that stay the same from one iteration to the next."""

    authored: Frames
    points: tuple[FloorPoint, ...]
    stand: Mask  # (P, T) this point stands on the floor
    flight: Mask  # (T,) nothing does; the knots beside the first and last of these still do
    root_sigma_m: Array  # (3,)

    def normal(self, frames: Frames, hardness: float, damping: float) -> NormalEquations:
        normal = NormalEquations(len(frames.roots_m))
        self._authored_pose(normal, frames, damping)
        self._smoothness(normal, frames)
        self._centre_of_mass(normal, frames, hardness)
        self._angular_momentum(normal, frames, hardness)
        self._floor(normal, frames, hardness)
        self._limits(normal, frames, hardness)
        return normal

    def _authored_pose(self, normal: NormalEquations, frames: Frames, damping: float) -> None:
        errors = _as_dofs(log(self.authored.rotations.swapaxes(-1, -2) @ frames.rotations))
        errors[:, :3] = frames.roots_m - self.authored.roots_m
        weights = np.full(DOF, _POSE_RAD**-2)
        weights[:3] = self.root_sigma_m**-2
        _add_diagonal(normal.blocks[0], weights + damping)
        normal.right -= errors * weights

    def _smoothness(self, normal: NormalEquations, frames: Frames) -> None:
        turns = log(frames.rotations[:-1].swapaxes(-1, -2) @ frames.rotations[1:])
        residuals = _as_dofs(turns[1:] - turns[:-1])
        weight = np.full(DOF, (_SMOOTH_RAD_S2 / KNOT_RATE**2) ** -2)
        weight[:3] = 0.0
        last = len(residuals)
        for i, left in enumerate((1.0, -2.0, 1.0)):
            normal.right[i : i + last] -= left * weight * residuals
            for j in range(i + 1):
                _add_diagonal(normal.blocks[i - j][j : j + last], left * (1.0, -2.0, 1.0)[j] * weight)

    def _centre_of_mass(self, normal: NormalEquations, frames: Frames, hardness: float) -> None:
        centre, jacobian = frames.centre_of_mass(), frames.centre_of_mass_jacobian()
        bend = (centre[2:] - 2 * centre[1:-1] + centre[:-2]) * KNOT_RATE**2
        flying = self.flight[1:-1]
        # The floor's force grows from nothing at touch-down and is back at nothing at take-off.
        edge = ~flying & (self.flight[:-2] | self.flight[2:])
        for where, target, sigma in (
            (flying, GRAVITY, _BALLISTIC_M_S2 / hardness),
            (edge, GRAVITY, _EDGE_M_S2),
            (~flying & ~edge, np.zeros(3), _SUPPORTED_M_S2),
        ):
            first = np.flatnonzero(where)
            parts = [jacobian[first + i] * (scale * KNOT_RATE**2) for i, scale in enumerate((1.0, -2.0, 1.0))]
            normal.add(first, parts, bend[first] - target, sigma)

    def _angular_momentum(self, normal: NormalEquations, frames: Frames, hardness: float) -> None:
        """In flight the angular momentum about the centre of mass stays what it was at take-off; else it may change.

        Between two knots it is the sum of m r x r' over mass points at r and then r', relative to the centre of mass;
        since the sum of m r vanishes, the centre's own motion drops out of the derivative.
        """
        count = len(frames.roots_m) - 2
        parts = np.zeros((3, count, 3, DOF))
        change = np.zeros((count, 3))
        centre = frames.centre_of_mass()
        for s, (mass, middle, spread) in enumerate(
            zip(frames.tree.masses, frames.tree.centres_m, frames.tree.gyration_m, strict=True)
        ):
            for end in (-spread, spread):
                points = frames.points(s, middle + np.array([0.0, 0.0, end]))
                jacobian = 0.5 * mass * KNOT_RATE * frames.jacobian(s, points)
                arms = points - centre
                a, b, c = (skew(arms[i : i + count]) for i in range(3))
                change += 0.5 * mass * KNOT_RATE * ((b @ (arms[2:] + arms[:-2])[:, :, None])[:, :, 0])
                parts[0] += b @ jacobian[:-2]
                parts[1] -= (a + c) @ jacobian[1:-1]
                parts[2] += b @ jacobian[2:]
        for where, sigma in ((self.flight[1:-1], _SPIN_M2_S2 / hardness), (~self.flight[1:-1], _SUPPORTED_SPIN_M2_S2)):
            first = np.flatnonzero(where)
            normal.add(first, [part[first] for part in parts], change[first], sigma / KNOT_RATE)

    def _floor(self, normal: NormalEquations, frames: Frames, hardness: float) -> None:
        for point, stand in zip(self.points, self.stand, strict=True):
            places = frames.points(point.segment, point.local_m)
            height = places[:, 2] - point.radius_m
            near = np.flatnonzero(~stand & (height < 6.0 * _FLOOR_SOFT_M))
            standing = np.flatnonzero(stand)
            if len(near) + len(standing) == 0:
                continue
            jacobian = frames.jacobian(point.segment, places)
            # A soft bound: a hard one would switch on and off from one iteration to the next.
            depth = -height[near, None] / _FLOOR_SOFT_M
            slope = -expit(depth)[:, :, None] * jacobian[near, 2:]
            normal.add(near, [slope], _FLOOR_SOFT_M * np.logaddexp(0.0, depth), _FLOOR_M)
            normal.add(standing, [jacobian[standing, 2:]], height[standing, None], _CONTACT_M / hardness)
            held = np.flatnonzero(stand[:-1] & stand[1:])
            slide = (places[1:] - places[:-1])[held, :2]
            parts = [-jacobian[held, :2], jacobian[held + 1, :2]]
            normal.add(held, parts, slide, _CONTACT_M / hardness)
            # A hand or foot slows down before it touches, and leaves slowly.
            passing = np.flatnonzero(stand[:-1] != stand[1:])
            normal.add(
                passing, [-jacobian[passing], jacobian[passing + 1]], (places[1:] - places[:-1])[passing], _PASSING_M
            )

    def _limits(self, normal: NormalEquations, frames: Frames, hardness: float) -> None:
        vectors = log(frames.rotations)
        for s, name in enumerate(SEGMENTS[1:], start=1):
            low, high = joint_limit_rad(name)
            if name in HINGE_AXES:
                angles, directions = vectors[:, s] @ np.array(HINGE_AXES[name]), np.ones((len(vectors), 1))
            else:
                angles = np.linalg.norm(vectors[:, s], axis=1)
                directions = vectors[:, s] / np.maximum(angles, 1e-9)[:, None]
            over = np.maximum(angles - (high - _LIMIT_MARGIN_RAD), 0.0)
            under = np.minimum(angles - (low + _LIMIT_MARGIN_RAD), 0.0) if name in HINGE_AXES else 0.0 * over
            at = np.flatnonzero(over + under)
            jacobian = np.zeros((len(at), 1, DOF))
            jacobian[:, 0, DOFS[s]] = directions[at]
            normal.add(at, [jacobian], (over + under)[at, None], _LIMIT_RAD / hardness)


def _as_dofs(vectors: Array) -> Array:
    """Return rotation vectors (T, 16, 3) as degrees of freedom (T, 43), zero for the root's position."""
    out = np.zeros((len(vectors), DOF))
    for s, name in enumerate(SEGMENTS):
        out[:, DOFS[s]] = vectors[:, s] @ np.array(HINGE_AXES[name])[:, None] if name in HINGE_AXES else vectors[:, s]
    return out


def _add_diagonal(blocks: Array, values: Array) -> None:
    diagonal = np.arange(DOF)
    blocks[:, diagonal, diagonal] += values


def knots(frame_count: int) -> Array:
    """Return the times (T,) of the poses that a motion of so many frames is authored and solved at."""
    return np.arange((frame_count - 1) * KNOT_RATE // FRAME_RATE + 1) / KNOT_RATE


def fit(
    measurements: dict[str, float],
    frame_count: int,
    authored_roots_m: Array,
    authored_rotations: Array,
    contacts: Sequence[Contact],
    root_sigma_m: tuple[float, float, float],
) -> MotionClip:
    """Return the motion nearest to the authored one that stands on the floor and falls with g.

    Authored roots (T, 3) and rotations (T, 16, 3, 3) are at `knots`. Authored places of the
    feet are soft: the contacts say when feet stand, and the poses where.
    """
    times, tree, points = knots(frame_count), body_tree(measurements), floor_points(measurements)
    stand = np.zeros((len(points), len(times)), dtype=bool)
    for contact in contacts:
        first, last = np.round(np.array([contact.start_s, contact.end_s]) * KNOT_RATE).astype(int)
        stand[[point.name == contact.point for point in points], max(first, 0) : max(last + 1, 0)] = True
    flight: Mask = np.logical_not(stand.any(axis=0))
    frames = Frames.place(tree, authored_roots_m, authored_rotations)
    problem = _Problem(frames, points, stand, flight, np.array(root_sigma_m))
    for hardness, damping in _SCHEDULE:
        step = problem.normal(frames, hardness, damping).solve()
        step *= min(1.0, _LONGEST_STEP_RAD / float(np.abs(step[:, 3:]).max()))
        frames = frames.moved(step)
    return _dense_clip(frames, frame_count, times, points, stand, flight)


_LONGEST_STEP_RAD: Final = 0.5
_SCHEDULE: Final = (
    (0.02, 0.0), (0.02, 0.0), (0.05, 0.0), (0.1, 0.0), (0.2, 0.0), (0.5, 20.0),
    (1.0, 50.0), (1.0, 50.0), (1.0, 50.0), (1.0, 100.0), (1.0, 200.0), (1.0, 200.0),
)  # fmt: skip
"""Hardness of the demands and Marquardt's damping, an iteration each: soft first, so that the authored poses may be far
from any possible motion; damped at the end, where the bend of the floor's soft bound makes full steps swing."""


def _dense_clip(
    frames: Frames, frame_count: int, times: Array, points: tuple[FloorPoint, ...], stand: Mask, flight: Mask
) -> MotionClip:
    """Sample between the knots so finely that what is between the samples does not matter.

    Rotations are splines through the knots; the centre of mass is a parabola in each flight and a spline that joins
    them in between; the root follows from both.
    """
    dense = np.arange(round(times[-1] * DENSE_RATE) + 1) / DENSE_RATE
    quaternions = Rotation.from_matrix(frames.rotations.reshape(-1, 3, 3)).as_quat(scalar_first=True)
    rough = MotionClip.from_samples(frame_count, times, frames.roots_m, quaternions.reshape(-1, 16, 4), stand.T[:, :4])
    rotations = np.stack([rough.at(t).rotations for t in dense])
    matrices = Rotation.from_quat(rotations.reshape(-1, 4), scalar_first=True).as_matrix().reshape(-1, 16, 3, 3)
    hanging = Frames.place(frames.tree, np.zeros((len(dense), 3)), matrices).centre_of_mass()
    roots = _centre_path(times, frames.centre_of_mass(), flight, dense) - hanging
    held = np.floor(dense * KNOT_RATE + 1e-6).astype(int)
    contact = np.zeros((len(times), len(END_POINTS)), dtype=bool)
    for e, end in enumerate(END_POINTS):
        side, kind = end.split("_")
        names = (f"{side}_hand",) if kind == "hand" else (f"{side}_heel", f"{side}_toe")
        for point, row in zip(points, stand, strict=True):
            if point.name in names:
                contact[:, e] |= row & np.append(row[1:], row[-1])
    return MotionClip.from_samples(frame_count, dense, roots, rotations, contact[held])


def _centre_path(times: Array, centre: Array, flight: Mask, dense: Array) -> Array:
    """Return the centre of mass (D, 3) between its knots (T, 3)."""
    out = np.empty((len(dense), 3))
    edges = np.flatnonzero(np.diff(flight.astype(int)))
    # Flight begins at the last knot that stands and ends at the first that stands again.
    starts, ends = edges[~flight[edges]], edges[flight[edges]] + 1
    # No acceleration where the clip begins and ends; elsewhere a stance has the speeds of the flights beside it.
    slopes: list[tuple[Literal[1, 2], Array]] = [(2, np.zeros(3))]
    for a, b in zip(starts, ends, strict=True):
        span = times[b] - times[a]
        speed = (centre[b] - centre[a]) / span - GRAVITY * span / 2
        inside = (dense >= times[a]) & (dense <= times[b])
        t = (dense[inside] - times[a])[:, None]
        out[inside] = centre[a] + speed * t + GRAVITY * t**2 / 2
        slopes += [(1, speed), (1, speed + GRAVITY * span)]
    slopes.append((2, np.zeros(3)))
    lows, highs = [0, *ends], [*starts, len(times) - 1]
    for a, b, left, right in zip(lows, highs, slopes[::2], slopes[1::2], strict=True):
        inside = (dense >= times[a]) & (dense <= times[b])
        out[inside] = CubicSpline(times[a : b + 1], centre[a : b + 1], bc_type=(left, right))(dense[inside])
    return out
