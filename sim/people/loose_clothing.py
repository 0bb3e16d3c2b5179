"""Loose clothes and hair: pieces that stand off the skin, hang behind its motion and swing.

Each piece is a body of its own, as wide as the skin below it and ``loose_m`` more, put where its segment is and moved
back along the segment's motion of the last moments (by at most ``loose_m``), and swings a little across it. All of it
is a function of time: a shutter's moments may be asked for in any order.
"""

from __future__ import annotations

from typing import Final

import mujoco
import numpy as np

from pzcap.types import SEGMENTS, Array
from sim.motion import MotionClip
from sim.people.athlete import CLOTH, set_pose

_LAGS_S: Final = 0.12
"""Cloth follows the motion of so long."""
_FULL_M_S: Final = 1.5
"""Speed at which two thirds of a piece's room are taken."""
_SWING_HZ: Final = (1.6, 2.6)
_SWING: Final = 0.35
"""Share of the room that a piece swings by, at speed."""


class Clothes:
    """Moves the pieces of the person whose segments' bodies are in ``model``."""

    def __init__(self, model: mujoco.MjModel, clip: MotionClip, loose_m: float, rng: np.random.Generator) -> None:
        self._model, self._clip, self._loose_m = model, clip, loose_m
        self._scratch = mujoco.MjData(model)
        self._pieces = []
        for segment in SEGMENTS:
            piece = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, CLOTH + segment)
            if piece >= 0:
                swing = rng.uniform(*_SWING_HZ), rng.uniform(0.0, 2 * np.pi), rng.normal(size=3)
                self._pieces.append((model.body(segment).id, int(model.body_mocapid[piece]), segment, swing))

    def hang(self, data: mujoco.MjData, time_s: float) -> None:
        """Put the pieces where they are at a time; the person has been posed for it."""
        if not self._pieces:
            return
        places, turns = self._placed(time_s)
        before, _ = self._placed(time_s - _LAGS_S)
        for body, mocap, segment, (hertz, phase, way) in self._pieces:
            velocity = (places[body] - before[body]) / _LAGS_S
            speed = float(np.linalg.norm(velocity))
            room = max(self._loose_m, 0.03) * (2.0 if segment == "head" else 1.0)  # hair has no skin to end at
            lag = -room * np.tanh(speed / _FULL_M_S) * velocity / max(speed, 1e-6)
            across = np.cross(velocity / max(speed, 1e-6), way / np.linalg.norm(way))
            swing = _SWING * room * np.tanh(speed / _FULL_M_S) * np.sin(2 * np.pi * hertz * time_s + phase) * across
            data.mocap_pos[mocap] = places[body] + lag + swing
            data.mocap_quat[mocap] = turns[body]

    def _placed(self, time_s: float) -> tuple[Array, Array]:
        """Middles (B, 3) and quaternions (B, 4) of the model's bodies at a time."""
        set_pose(self._model, self._scratch, self._clip.at(time_s))
        mujoco.mj_kinematics(self._model, self._scratch)
        return self._scratch.xpos.copy(), self._scratch.xquat.copy()
