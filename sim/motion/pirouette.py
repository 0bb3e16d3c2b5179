"""A dancer who draws the arms in before the chest, turns one and a half times on the balls of the feet, and opens them.

The hands lie before the chest, one forearm over the other, for more than two seconds: in no view do they show against
the hall for long. How high and how close they are held, and to which side the turn goes, is drawn by chance.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from pzcap.types import Array
from sim.motion._authoring import Keys, curve, interpolate, joint_rotations
from sim.motion._clip import MotionClip
from sim.motion._fit import Contact, fit, knots

FRAMES: Final = 150
_TURN_DEG: Final = 540.0
_TURN: Final = (0.9, 3.9)  # from when to when, s
_STEPS: Final = 12
_SWING_S: Final = 0.16  # of each step's time, the foot is off the floor for so long
_DRAW_IN: Final = (0.6, 1.25)  # the arms, s
_OPEN: Final = (3.75, 4.45)
_LATER_S: Final = 0.15  # the arm in front follows the other in, and is first to go
_OPEN_ARMS: Final[Keys] = {"shoulder": (12.0, 78.0, 0.0), "elbow": 15.0}


def make(measurements: dict[str, float], rng: np.random.Generator) -> MotionClip:
    """Turn on the spot in the middle of the hall; place, direction and how the arms are held vary with ``rng``."""
    times = knots(FRAMES)
    middle, start_deg = rng.normal(0.0, 0.5, 2), float(rng.uniform(0.0, 360.0))
    side = 1.0 if rng.uniform() < 0.5 else -1.0  # 1: the turn goes to the left
    first, second = ("left", "right") if side > 0 else ("right", "left")
    turned = _eased(times, *_TURN)
    channels = interpolate(_arms(rng, first, second), times)
    contacts = []
    for name, steps in ((first, range(0, _STEPS, 2)), (second, range(1, _STEPS, 2))):
        yaw, lifted = _feet(times, turned, steps)
        sign = 1.0 if name == "left" else -1.0
        twist = side * sign * _TURN_DEG * (turned - yaw)  # the pelvis turns over the foot that stands
        up = curve([(0.5, 0), (0.9, 1), (3.95, 1), (4.5, 0)], times)  # on the balls of the feet
        zero = np.zeros_like(times)
        channels[f"{name}_hip"] = np.stack([25 * lifted + 5 * up, 2 + zero, twist], axis=1)
        channels[f"{name}_knee"] = (45 * lifted + 8 * up + 3)[:, None]
        channels[f"{name}_ankle"] = (22 * up + 10 * lifted)[:, None]
        contacts += _contacts(name, steps, times[-1])
    channels["trunk"] = np.stack([curve([(0, 0), (1.2, 4), (3.6, 4), (4.3, -3)], times), zero, zero], axis=1)
    pelvis = Rotation.from_euler("z", (start_deg + side * _TURN_DEG * turned)[:, None], degrees=True).as_matrix()
    leg = measurements["thigh"] + measurements["shank"] + measurements["ankle_height"]
    height = leg * (0.985 + 0.04 * up)
    roots = np.column_stack([np.broadcast_to(middle, (len(times), 2)), height])
    return fit(measurements, FRAMES, roots, joint_rotations(channels, pelvis), contacts, (0.05, 0.05, 0.05))


def _arms(rng: np.random.Generator, outer: str, inner: str) -> list[tuple[float, Keys]]:
    """Keys of arms that are held to the sides, then before the chest, the ``outer`` one in front, then aside again."""
    height, close = float(rng.uniform(-6.0, 6.0)), float(rng.uniform(-6.0, 6.0))
    held: Keys = {
        f"{outer}_shoulder": (42.0 + height, 6.0, 80.0), f"{outer}_elbow": 100.0 + close,
        f"{inner}_shoulder": (24.0 + height, 8.0, 70.0), f"{inner}_elbow": 118.0 + close,
    }  # fmt: skip
    keys: list[tuple[float, Keys]] = []
    for name, late_s in ((inner, 0.0), (outer, _LATER_S)):
        opened = {f"{name}_{joint}": value for joint, value in _OPEN_ARMS.items()}
        own = {joint: value for joint, value in held.items() if joint.startswith(name)}
        keys += [(0.0, opened), (_DRAW_IN[0] + late_s, opened), (_DRAW_IN[1] + late_s, own)]
        keys += [(_OPEN[0] - late_s, own), (_OPEN[1] - late_s, opened)]
    return keys


def _eased(times: Array, start_s: float, end_s: float) -> Array:
    """Share (T,) of a way that begins and ends at rest, with an even speed between."""
    ease = 0.2
    share = np.clip((times - start_s) / (end_s - start_s), 0.0, 1.0)
    speed = np.minimum(np.minimum(share, 1.0 - share) / ease, 1.0)
    way = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]))])
    return way / way[-1]


def _swing(step: int) -> tuple[float, float]:
    """Times at which the foot of a step is off the floor."""
    stride = (_TURN[1] - _TURN[0]) / _STEPS
    start = _TURN[0] + step * stride
    return start + 0.5 * (stride - _SWING_S), start + 0.5 * (stride + _SWING_S)


def _feet(times: Array, turned: Array, steps: range) -> tuple[Array, Array]:
    """Turn (T,) of a foot, as a share of the whole turn, and its lift (T,), 0 to 1; ``turned`` (T,) is the body's."""
    yaw, lifted = [(0.0, 0.0)], [(0.0, 0.0)]
    for step in steps:
        up, down = _swing(step)
        ahead = _swing(step + 2)[0]  # it will stand until then, and be passed over half-way
        there = 1.0 if step + 2 >= _STEPS else float(np.interp(0.5 * (down + ahead), times, turned))
        yaw += [(up, yaw[-1][1]), (down, there)]
        lifted += [(up, 0.0), (0.5 * (up + down), 1.0), (down, 0.0)]
    return curve(yaw, times), curve(lifted, times)


def _contacts(name: str, steps: range, end_s: float) -> list[Contact]:
    """The ball of a foot stands between its steps; the heel comes down only before and after the turn."""
    swings = [_swing(step) for step in steps]
    downs, ups = [0.0, *(down for _, down in swings)], [*(up for up, _ in swings), end_s]
    balls = [Contact(f"{name}_toe", down, up) for down, up in zip(downs, ups, strict=True)]
    return [*balls, Contact(f"{name}_heel", 0.0, 0.5), Contact(f"{name}_heel", 4.6, end_s)]
