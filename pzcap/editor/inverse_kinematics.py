"""Inverse kinematics of the whole body from clicks in the views.

A click says where a joint, or an end of the body, is seen in one view, with a standard deviation. All clicks of a frame
are fitted together by damped Gauss-Newton steps on the pose's 43 numbers, with the limits of the joints and the arms
kept out of the trunk, and the pose as it was when the hand took hold of it: loosely, a shoulder's radian cheap and the
pelvis's dear, and the less the further it is left. So an arm follows a hand that is dragged and the trunk stays, what
no click bears on stays as it was, and what clicks do fix is fitted to them however far it was off.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from scipy.spatial.transform import Rotation

from pzcap.body.kinematics import (
    difference,
    forward,
    joint_angles,
    joint_jacobians,
    limit_residuals,
    point_jacobians,
    retract,
    world_points,
)
from pzcap.body.skeleton import DOF_SEGMENT, LIMBS, Body, moved
from pzcap.editor.tuning import POSING
from pzcap.geometry.camera import rays
from pzcap.geometry.pinhole import Pinhole, pinhole, pixel_gradient, projected, ray, to_pixel
from pzcap.initialisation.pose_fit import REST
from pzcap.initialisation.tuning import FIT
from pzcap.tracking.body_constraints import collision_residuals, collision_shapes, spine
from pzcap.tracking.limbs import turned
from pzcap.types import DOF, ENDS, JOINTS, SEGMENTS, Array, Camera, Indices, Pose, without_side

HANDLES: Final[tuple[str, ...]] = (*JOINTS, *ENDS)
"""Points of the body that can be dragged: the joints, then its ends."""
SEGMENT: Final[Indices] = np.array([*range(len(SEGMENTS)), *(SEGMENTS.index(name) for name in ENDS.values())])
"""(23,) The segment that a handle is fixed to."""
MIRRORED: Final[Indices] = np.array([
    HANDLES.index(
        name.replace("left_", "right_") if name.startswith("left_") else name.replace("right_", "left_")
    )
    for name in HANDLES
])  # fmt: skip
"""(23,) The handle on the other side of the body; a middle one's is itself."""


def _easy() -> Array:
    """(43,) How readily each degree of freedom gives way to a drag: metres, radians."""
    ease = {"pelvis": 0.10, "lumbar": 0.12, "thorax": 0.12, "head": 0.3, "hand": 0.3, "foot": 0.3}
    out = np.full(DOF, 0.5)
    for index, name in enumerate(SEGMENTS):
        out[index == DOF_SEGMENT] = ease.get(without_side(name), 0.5)
    out[:3] = 0.03
    return out


_EASE: Final[Array] = _easy()


def _natural() -> Array:
    """(43,) Information with which joints are expected at rest: clicks say little of how a straight arm or leg is
    twisted."""
    out = REST.copy()
    for limb in ("upper_arm", "thigh"):
        for side in ("left", "right"):
            along = np.flatnonzero(SEGMENTS.index(f"{side}_{limb}") == DOF_SEGMENT)[2]
            out[along] = np.deg2rad(POSING.twist_deg) ** -2.0
    return out


_NATURAL: Final[Array] = _natural()

LOOSENESS: Final[Mapping[str, tuple[float, float]]] = {
    "keyframe": (0.01, 0.05), "tracker": (0.05, 0.20), "between": (0.10, 0.35), "copied": (0.30, 0.50),
    "standing": (2.0, 1.0),
}  # fmt: skip
"""Standard deviation of the root (m) and of each rotation (rad) of a pose by where it came from, before any click."""


class Click(NamedTuple):
    """A handle as it was clicked in one view."""

    handle: int
    camera: int
    x: float  # pixels of the frame
    y: float
    sigma_px: float


class Held(NamedTuple):
    """A pose that is left only as far as clicks ask for it: two of opposite cameras leave the depth open, and noise
    would choose it."""

    pose: Pose
    sigma: Array
    """(43,) Standard deviation of what it is left by."""

    @classmethod
    def of(cls, pose: Pose, origin: str) -> Held:
        """The pose as it is when a hand takes hold of it; ``origin`` is one of `LOOSENESS`."""
        return cls(pose, _EASE * (POSING.begun if origin in ("copied", "standing") else 1.0))


class Solved(NamedTuple):
    """A pose fitted to clicks."""

    pose: Pose
    cost: float
    """Sum of squared residuals, in sigmas, of what pulls too hard less."""


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """The cameras of one instant, and the body."""

    body: Body
    cameras: Sequence[Camera | None]  # None: the view is not there

    def handles(self, pose: Pose) -> Array:
        """The handles in the world, (23, 3)."""
        return world_points(forward(self.body, pose), SEGMENT, handle_points(self.body))

    def residuals(self, pose: Pose, clicks: Sequence[Click]) -> tuple[Array, Array]:
        """Residuals (2N,), click minus projection in sigmas, and derivatives (2N, 43) of the projections in sigmas."""
        frames = forward(self.body, pose)
        world = world_points(frames, SEGMENT, handle_points(self.body))
        table = np.array(clicks, np.float64).reshape(-1, 5)
        handle, view, seen = table[:, 0].astype(np.int64), table[:, 1], table[:, 2:]
        off, slopes = np.zeros((len(table), 2)), np.zeros((len(table), 2, 3))
        for number, camera in enumerate(self.cameras):
            own = np.flatnonzero(view == number)
            if camera is not None and len(own):
                _compare(world[handle], own, pinhole(camera), seen, POSING.tape_m, off, slopes)
        by_handle = point_jacobians(frames, SEGMENT, world)
        rows = np.matmul(slopes, by_handle[handle]).reshape(-1, DOF)
        return off.ravel(), rows

    def normal(self, pose: Pose, clicks: Sequence[Click], held: Held) -> tuple[Array, Array, float]:
        """Normal equations (43, 43) and (43,) of the clicks, of the body's own constraints, of what is natural and of
        the pose that is ``held``, and their cost."""
        residual, rows = self.residuals(pose, clicks)
        excess, violated = limit_residuals(pose)
        stiffness = violated / POSING.limit_rad**2
        inside, depth = collision_residuals(collision_shapes(self.body), forward(self.body, pose))
        far = np.linalg.norm(residual.reshape(-1, 2), axis=1)
        weight = np.repeat(POSING.strongest / np.maximum(far, POSING.strongest), 2)  # Huber's
        hessian = (rows.T * weight) @ rows + np.diag(stiffness) + inside.T @ inside
        gradient = rows.T @ (weight * residual) - stiffness * excess - inside.T @ depth
        back = difference(held.pose, pose) / held.sigma
        grip = 1.0 / (1.0 + (back / POSING.grip) ** 2)  # Cauchy's weight
        angles = joint_angles(pose)
        bent, straighten, unusual = spine(angles, FIT.spine_rad)
        hessian += np.diag(grip / held.sigma**2 + _NATURAL) + bent
        gradient += grip * back / held.sigma - _NATURAL * angles + straighten
        pulls = np.where(far > POSING.strongest, POSING.strongest * (2.0 * far - POSING.strongest), far**2)
        cost = pulls.sum() + stiffness @ excess**2 + depth @ depth + _NATURAL @ angles**2 + unusual
        cost -= POSING.grip**2 * np.log(grip).sum()
        return hessian, gradient, float(cost)

    def solve(self, start: Pose, clicks: Sequence[Click], held: Held, most_steps: int) -> Solved:
        """The pose that fits the ``clicks`` and leaves the one ``held`` as little as it can, by so many steps from a
        ``start`` at most."""
        damping, metric = POSING.first_damping, np.diag(1.0 / _EASE**2)
        pose, (hessian, gradient, cost) = start, self.normal(start, clicks, held)
        for _ in range(1, most_steps + 1):
            delta = np.asarray(np.linalg.solve(hessian + damping * metric, gradient), np.float64)
            longest = float(np.max(np.abs(delta) / _EASE)) / POSING.longest
            tried = retract(pose, np.asarray(delta / max(longest, 1.0), np.float64))
            after = self.normal(tried, clicks, held)
            if after[2] < cost:
                settled = damping < POSING.small_damping and cost - after[2] < POSING.settled * (1.0 + cost)
                pose, (hessian, gradient, cost) = tried, after
                damping = max(0.2 * damping, POSING.least_damping)
                if settled:
                    break
            else:
                damping *= 8.0
                if damping > POSING.most_damping:
                    break
        return Solved(pose, cost)

    def settle(self, start: Pose, clicks: Sequence[Click], held: Held, handles: Sequence[int] = ()) -> Solved:
        """The pose that fits all ``clicks`` and leaves the one ``held`` as little as it can, at leisure.

        A body that is turned the wrong way, or a limb whose elbow or knee has come to the wrong side, does not find
        back by small steps. If the clicks are not fitted, all ways to turn the body are tried; and the limbs of the
        ``handles``, or all of a body that has been turned, are tried twisted. What fits clearly better is taken.
        """
        best = self.solve(start, clicks, held, POSING.at_leisure)
        if self._is_doubted(best.pose, clicks):
            other = self._better(best, (_turned(start, turn) for turn in _TURNS), clicks, held)
            handles = handles if other is best else range(len(HANDLES))
            best = other
        for limb, segments in enumerate(LIMBS):
            if best.cost > POSING.clearly and any(SEGMENT[handle] in segments for handle in handles):
                best = self._better(best, [turned(limb, best.pose, turn) for turn in _TWISTS], clicks, held)
        return best

    def _is_doubted(self, pose: Pose, clicks: Sequence[Click]) -> bool:
        """True if a pose fits its clicks so badly that the body may be turned otherwise; a wrong click or two are no
        reason to think that."""
        squares = np.sort(np.sum(self.residuals(pose, clicks)[0].reshape(-1, 2) ** 2, axis=1))
        most = squares[: int(np.ceil(POSING.most * len(squares)))]
        return len(most) > 0 and float(most.mean()) > POSING.doubted

    def _better(self, best: Solved, starts: Iterable[Pose], clicks: Sequence[Click], held: Held) -> Solved:
        for start in starts:
            other = self.solve(start, clicks, held, POSING.tried)
            if other.cost < best.cost - POSING.clearly:
                best = self.solve(other.pose, clicks, held, POSING.at_leisure)
        return best

    def covariance(self, pose: Pose, clicks: Sequence[Click], before: Array) -> Array:
        """Covariance (43, 43) of a pose that clicks have corrected; ``before`` (43, 43) is what was known without them,
        as information."""
        residual, rows = self.residuals(pose, clicks)
        worse = max(1.0, float(residual @ residual) / max(len(residual), 1))  # clicks that contradict each other
        return np.asarray(np.linalg.inv(rows.T @ rows / worse + before))

    def information(self, pose: Pose, joint_sigma_m: Array) -> Array:
        """Information (43, 43) on a pose whose joints are known to (16,) by themselves."""
        rows = joint_jacobians(forward(self.body, pose)) * (np.sqrt(3.0) / joint_sigma_m[:, None, None])
        return np.asarray(np.einsum("jad,jae->de", rows, rows) + loose("standing"))

    def sigma_m(self, pose: Pose, covariance: Array) -> Array:
        """(23,) Standard deviation of each handle's distance from where it is."""
        frames = forward(self.body, pose)
        points = world_points(frames, SEGMENT, handle_points(self.body))
        jacobians = point_jacobians(frames, SEGMENT, points)
        return np.asarray(np.sqrt(np.einsum("nid,de,nie->n", jacobians, covariance, jacobians)))

    def exchanged(self, pose: Pose, limbs: Sequence[int]) -> Pose:
        """The pose with left and right exchanged: every handle of the ``limbs`` (those of both sides), or of the whole
        body if there are none, goes to where its counterpart is, as near as the body can."""
        world = self.handles(pose)
        moved = np.isin(np.arange(len(HANDLES)), limbs) if len(limbs) else np.ones(len(HANDLES), bool)
        target = np.where(moved[:, None], world[MIRRORED], world)
        starts = [pose, *(_turned(pose, turn) for turn in _TURNS)] if not len(limbs) else [pose]
        fits = [self._towards(start, target) for start in starts]
        return min(fits, key=lambda fit: fit.cost).pose

    def _towards(self, start: Pose, target_m: Array) -> Solved:
        """The pose whose handles are nearest to (23, 3) places in the world."""
        pose, cost = start, np.inf
        for _ in range(1, 31):
            frames = forward(self.body, pose)
            points = world_points(frames, SEGMENT, handle_points(self.body))
            rows = (point_jacobians(frames, SEGMENT, points) / POSING.tape_m).reshape(-1, DOF)
            off = (target_m - points).ravel() / POSING.tape_m
            excess, violated = limit_residuals(pose)
            stiffness = violated / POSING.limit_rad**2
            now = float(off @ off + stiffness @ excess**2)
            if cost - now < 1e-3 * now:
                break
            cost = now
            hessian = rows.T @ rows + np.diag(stiffness + 1.0 / _EASE**2)
            pose = retract(pose, np.asarray(np.linalg.solve(hessian, rows.T @ off - stiffness * excess), np.float64))
        return Solved(pose, cost)


_TWISTS: Final = np.array([(0.0, 0.0, twist * np.pi / 2, bend) for twist in range(4) for bend in (0.0, 0.8)][1:])
"""(7, 4) Turns of a limb, as `pzcap.tracking.limbs.turned` takes them."""
_TURNS: Final = tuple(
    Rotation.from_euler("zy", [yaw, pitch], degrees=True)
    for pitch, yaws in ((0, (90, 180, 270)), (180, (0, 90, 180, 270)), (90, (0, 180)), (270, (0, 180)))
    for yaw in yaws
)


def loose(origin: str) -> Array:
    """Information (43, 43) on a pose that was begun from an ``origin``, one of `LOOSENESS`."""
    position, rotation = LOOSENESS[origin]
    return np.diag(np.r_[np.full(3, position), np.full(DOF - 3, rotation)] ** -2.0)


@lru_cache(maxsize=4)
def handle_points(body: Body) -> Array:
    """The handles (23, 3), each in the frame of its segment."""
    return np.concatenate([np.zeros((len(JOINTS), 3)), moved(body).ends_m])


def is_ready(sigma_m: Array) -> bool:
    """True if a pose with such sigmas (23,) of its handles is good enough to track from."""
    return bool(sigma_m[: len(JOINTS)].max() < POSING.ready_m)


def standing(cameras: Sequence[Camera | None]) -> Pose | None:
    """The body upright where the cameras look: their operators keep the athlete in the middle. None without two of
    them."""
    seen = [camera for camera in cameras if camera is not None]
    if len(seen) < 2:
        return None
    centres = np.array([camera.world_T_cam[:3, 3] for camera in seen])
    ways = np.array([camera.world_T_cam[:3, 2] for camera in seen])
    across = np.eye(3) - ways[:, :, None] * ways[:, None, :]
    middle = np.linalg.solve(across.sum(axis=0) + 1e-9 * np.eye(3), np.einsum("nij,nj->i", across, centres))
    return Pose(middle, np.tile([1.0, 0.0, 0.0, 0.0], (len(SEGMENTS), 1)))


def epipolar(camera: Camera, pixel: Array, other: Camera) -> Array:
    """Where in the ``other`` view what stands at a ``pixel`` (2,) can be, (N, 2): a line, bent by the lens."""
    (way,) = rays(camera, pixel[None])
    points = camera.world_T_cam[:3, 3] + np.geomspace(1.0, 120.0, 60)[:, None] * way
    pixels, depth = projected(points, other)
    size = np.array([other.width, other.height])
    near = (depth > 0.5) & (np.abs(pixels - size / 2) < 1.5 * size).all(axis=1)
    return np.asarray(pixels[near])


def _turned(pose: Pose, turn: Rotation) -> Pose:
    """The pose, its pelvis turned about itself in the world."""
    rotations = pose.rotations.copy()
    root = turn * Rotation.from_quat(rotations[0], scalar_first=True)
    rotations[0] = root.as_quat(scalar_first=True)
    return Pose(pose.root_position_m, rotations)


@njit(cache=True, nogil=True)
def _compare(
    points: Array, which: Indices, camera: Pinhole, seen: Array, tape_m: float, off: Array, slopes: Array
) -> None:
    """For those of the world ``points`` (N, 3) in a view (``which``), ``seen`` at (N, 3: x, y, sigma), fill in the
    residuals (N, 2) and the derivatives (N, 2, 3) of their projections by the points, both in sigmas. Of a point that
    is not before the camera both stay as they are."""
    for n in which:
        across, down, depth = ray(points[n, 0], points[n, 1], points[n, 2], camera)
        if depth < POSING.nearest_m:
            continue
        u, v = to_pixel(across, down, camera)
        sigma = np.sqrt(seen[n, 2] ** 2 + (tape_m * camera.focal / depth) ** 2)
        off[n, 0], off[n, 1] = (seen[n, 0] - u) / sigma, (seen[n, 1] - v) / sigma
        for axis in range(2):
            slope = pixel_gradient(across, down, depth, camera, 1.0 - axis, float(axis))
            for k in range(3):
                slopes[n, axis, k] = slope[k] / sigma


def handle_name(handle: int) -> str:
    """A handle as a person calls it."""
    return HANDLES[handle].replace("_", " ")
