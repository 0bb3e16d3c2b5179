"""Retargeting: the motion of a BVH file, done by a person of other proportions.

Limbs have the directions of the figure's; trunk, hands and feet turn as the figure's do, away from a rest pose that may
be any upright one; the path through the hall is as long, in leg lengths. Then the whole is put on the floor.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Final

import numpy as np
from scipy.ndimage import maximum_filter1d, uniform_filter1d
from scipy.spatial.transform import Rotation

from pzcap.types import HINGE_AXES, PARENTS, SEGMENTS, Array, Mask, PzcapError
from sim.motion._bvh import Bvh
from sim.motion._clip import END_POINTS, FRAME_RATE, MotionClip
from sim.motion._figure import Figure, match_joints
from sim.motion._fit import FloorPoint, floor_points
from sim.motion._kinematics import Frames, exp, log
from sim.people.anthropometry import body_tree, joint_limit_rad

_SPACE_M: Final = (18.0, 13.0)  # between the tripods
_FASTEST_RAD_S: Final = np.radians(2000.0)  # of a limb; a somersault's fastest reaches three quarters of it
_STRAIGHT: Final = np.sin(np.radians(6.0)) ** 3  # a limb bent much less has no hinge axis of its own to show
_FLOOR_PERCENTILE: Final = 5.0  # percentile of the lowest point's height that is taken for the floor
_LIFT_S: Final = 0.1  # time over which a pose that would enter the floor is lifted
_CONTACT_M: Final = 0.03  # a point stands on the floor if it is lower than this
_CONTACT_M_S: Final = 0.3  # a point stands on the floor if it is slower than this


def retarget(bvh: Bvh, measurements: dict[str, float]) -> MotionClip:
    """Return the file's motion for a person with these measurements (metres), in the middle of the hall.

    The figure's forward at rest becomes the world's x. Raises PzcapError if the motion does not fit the hall or the
    file's joints are not those of a person.
    """
    figure = _without_t_pose(match_joints(bvh), bvh.frame_s)
    duration_s = (len(figure.turns) - 1) * bvh.frame_s
    frame_count = int(duration_s * FRAME_RATE + 0.05) + 1  # frame times are rounded in files
    if frame_count < 2:
        raise PzcapError(
            f"{bvh.path}: the motion lasts {duration_s:.3f} s; it must last two frames, {1 / FRAME_RATE:.3f} s"
        )
    rotations, roots = _rotations(figure), _path(bvh, figure, measurements)
    times = np.arange(len(roots), dtype=np.float64) * bvh.frame_s
    frames, points = Frames.place(body_tree(measurements), roots, rotations), floor_points(measurements)
    frames = _on_the_floor(frames, points, bvh.frame_s)
    quaternions = Rotation.from_matrix(rotations.reshape(-1, 3, 3)).as_quat(scalar_first=True).reshape(-1, 16, 4)
    contact = _contacts(frames, points, bvh.frame_s)
    return MotionClip.from_samples(frame_count, times, frames.roots_m, quaternions, contact)


def _without_t_pose(figure: Figure, frame_s: float) -> Figure:
    """The figure without its first frame if it jumps from there: many files show a T-pose before the motion."""
    turns = figure.turns
    speeds = [np.linalg.norm(log(a.swapaxes(-1, -2) @ b), axis=1).max() / frame_s for a, b in pairwise(turns[:3])]
    jumps = len(speeds) == 2 and speeds[0] > _FASTEST_RAD_S > speeds[1]
    return replace(figure, places=figure.places[1:], turns=turns[1:]) if jumps else figure


def _path(bvh: Bvh, figure: Figure, measurements: dict[str, float]) -> Array:
    """The middle between the hip joints (T, 3), in metres, its way over the floor about the middle of the hall."""
    joint, rest = figure.joint, figure.rest
    legs = [
        np.linalg.norm(rest[joint[f"{side}_{near}"]] - rest[joint[f"{side}_{far}"]])
        for side in ("left", "right")
        for near, far in (("thigh", "shank"), ("shank", "foot"))
    ]
    scale = 2 * (measurements["thigh"] + measurements["shank"]) / float(np.sum(legs))
    roots = scale * (figure.places[:, joint["left_thigh"]] + figure.places[:, joint["right_thigh"]]) / 2
    low, high = roots[:, :2].min(axis=0), roots[:, :2].max(axis=0)
    if (high - low > _SPACE_M).any():
        x, y = high - low
        raise PzcapError(
            f"{bvh.path}: the motion takes {x:.1f} x {y:.1f} m of floor; between the cameras there are "
            f"{_SPACE_M[0]:g} x {_SPACE_M[1]:g} m, the longer side along the figure's forward; cut or turn it"
        )
    roots[:, :2] -= (low + high) / 2
    return roots


def _rotations(figure: Figure) -> Array:
    """(T, 16, 3, 3) parent from segment, within the limits of each joint; the pelvis: world from segment."""
    wanted, bends = _wanted(figure)
    rotations, world = np.empty_like(wanted), np.empty_like(wanted)
    for s, name in enumerate(SEGMENTS):
        if PARENTS[s] < 0:
            rotations[:, s] = world[:, s] = wanted[:, s]
            continue
        if name in HINGE_AXES:
            angles = np.clip(bends[name], *joint_limit_rad(name))
            rotations[:, s] = exp(angles[:, None] * np.array(HINGE_AXES[name]))
        else:
            own = world[:, PARENTS[s]].swapaxes(-1, -2) @ wanted[:, s]
            rotations[:, s] = _limited(own, joint_limit_rad(name)[1])
        world[:, s] = world[:, PARENTS[s]] @ rotations[:, s]
    return rotations


def _wanted(figure: Figure) -> tuple[Array, dict[str, Array]]:
    """World from segment (T, 16, 3, 3) as the file has it, whatever our joints can do, and the angles of hinges (T,).

    What is beyond a hinge has no place of its own: it follows from the angle.
    """
    joint, turns = figure.joint, figure.turns
    wanted = np.tile(np.eye(3), (len(turns), 16, 1, 1))
    for name in ("pelvis", "thorax", "head"):
        wanted[:, SEGMENTS.index(name)] = turns[:, joint[name]]
    pelvis, thorax = turns[:, joint["pelvis"]], turns[:, joint["thorax"]]
    between = pelvis @ exp(log(pelvis.swapaxes(-1, -2) @ thorax) / 2)
    wanted[:, SEGMENTS.index("lumbar")] = turns[:, joint["lumbar"]] if "lumbar" in joint else between
    bends = {}
    for side in ("left", "right"):
        for near, hinge, end in (("upper_arm", "forearm", "hand"), ("thigh", "shank", "foot")):
            limb = [f"{side}_{part}" for part in (near, hinge, end)]
            wanted[:, SEGMENTS.index(limb[0])], bends[limb[1]] = _limb(figure, *limb)
        hand, foot = joint[f"{side}_hand"], joint[f"{side}_foot"]
        straight = figure.rest[hand] - figure.rest[joint[f"{side}_forearm"]]
        along = figure.ends[hand] - figure.rest[hand] if hand in figure.ends else straight
        wanted[:, SEGMENTS.index(f"{side}_hand")] = turns[:, hand] @ _hanging_to(along if along.any() else straight)
        wanted[:, SEGMENTS.index(f"{side}_foot")] = turns[:, foot] @ _foot_at_rest(figure, side)
    return wanted, bends


def _foot_at_rest(figure: Figure, side: str) -> Array:
    """(3, 3) Level as seen from the side, and seen from the front square to the leg, which may stand astride."""
    hip, ankle = (figure.joint[f"{side}_{part}"] for part in ("thigh", "foot"))
    square = _hanging_to((figure.rest[ankle] - figure.rest[hip]) * (0.0, 1.0, 1.0))
    toes = square.T @ (figure.ends.get(ankle, figure.rest[ankle]) - figure.rest[ankle])
    outwards_rad = np.arctan2(toes[1], toes[0]) if toes[0] > abs(toes[1]) else 0.0  # else they do not tell
    return square @ exp(np.array([0.0, 0.0, outwards_rad]))


def _limb(figure: Figure, near: str, hinge: str, end: str) -> tuple[Array, Array]:
    """World from the near segment (T, 3, 3) of an arm or a leg, and the angle (T,) of its hinge.

    The bend itself shows the hinge's axis. A straight limb has none to show: there it is the one that the file's near
    segment carries along from the rest pose.
    """
    a, b, c = (figure.places[:, figure.joint[name]] for name in (near, hinge, end))
    upper, lower = _unit(b - a), _unit(c - b)
    at_rest = figure.rest[figure.joint[hinge]] - figure.rest[figure.joint[near]]
    axis = np.array(HINGE_AXES[hinge])
    carried = figure.turns[:, figure.joint[near]] @ _hanging_to(at_rest) @ axis
    bend = np.cross(upper, lower)
    shown = _STRAIGHT * carried + np.sum(bend**2, axis=1, keepdims=True) * bend
    shown = _unit(shown - np.sum(shown * upper, axis=1, keepdims=True) * upper)
    angle = np.arctan2(np.sum(shown * bend, axis=1), np.sum(upper * lower, axis=1))
    left = axis[1] * shown
    return np.stack([np.cross(upper, left), left, -upper], axis=-1), angle


def _hanging_to(direction: Array) -> Array:
    """(3, 3) The shortest turn that makes what hangs down point in this direction (3,)."""
    across = np.array([direction[1], -direction[0], 0.0])  # down x direction
    sine = float(np.linalg.norm(across))
    axis = across / sine if sine > 0.0 else np.array([1.0, 0.0, 0.0])
    return exp(float(np.arctan2(sine, -direction[2])) * axis)


def _limited(rotations: Array, limit_rad: float) -> Array:
    """Rotations (T, 3, 3) by no more than a limit. The twist about the segment gives way first, then its direction."""
    x, y, z, w = Rotation.from_matrix(rotations).as_quat(canonical=True).T
    swing, twist = 2 * np.arctan2(np.hypot(x, y), np.hypot(z, w)), 2 * np.arctan2(z, w)
    about_itself = np.stack([np.zeros_like(twist), np.zeros_like(twist), twist], axis=1)
    vectors = log(rotations @ exp(-about_itself))
    allowed = np.minimum(swing, limit_rad)
    # the half angles of a swing and a twist: cos(whole) = cos(swing) cos(twist)
    most = 2 * np.arccos(np.minimum(np.cos(limit_rad / 2) / np.cos(allowed / 2), 1.0))
    about_itself[:, 2] = np.clip(twist, -most, most)
    return exp(vectors * (allowed / np.maximum(swing, 1e-12))[:, None]) @ exp(about_itself)


def _on_the_floor(frames: Frames, points: tuple[FloorPoint, ...], frame_s: float) -> Frames:
    """The same poses, standing on the floor and never in it."""
    lowest = np.min([frames.points(p.segment, p.local_m)[:, 2] - p.radius_m for p in points], axis=0)
    floor = float(np.percentile(lowest, _FLOOR_PERCENTILE))
    window = 2 * round(_LIFT_S / 2 / frame_s) + 1
    lift: Array = maximum_filter1d(np.maximum(floor - lowest, 0.0), 2 * window - 1, mode="nearest")
    for _ in range(2):  # each average reaches half a window to either side, as far as the maximum does for both
        lift = uniform_filter1d(lift, window, mode="nearest")
    rise = np.stack([0.0 * lift, 0.0 * lift, lift - floor], axis=1)
    return Frames.place(frames.tree, frames.roots_m + rise, frames.rotations)


def _contacts(frames: Frames, points: tuple[FloorPoint, ...], frame_s: float) -> Mask:
    """(T, 4) which of END_POINTS stand on the floor: those that are low and slow."""
    contact = np.zeros((len(frames.roots_m), len(END_POINTS)), dtype=bool)
    for point in points:
        side, _, kind = point.name.partition("_")
        end = f"{side}_{'hand' if kind == 'hand' else 'foot'}"
        if end in END_POINTS:
            places = frames.points(point.segment, point.local_m)
            speed = np.linalg.norm(np.gradient(places, frame_s, axis=0), axis=1)
            low = places[:, 2] - point.radius_m < _CONTACT_M
            contact[:, END_POINTS.index(end)] |= low & (speed < _CONTACT_M_S)
    return contact


def _unit(vectors: Array) -> Array:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)
