"""A motion as a function of time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.interpolate import CubicSpline

from pzcap.types import Array, Mask, Pose

END_POINTS: Final[tuple[str, ...]] = ("left_hand", "right_hand", "left_foot", "right_foot")
"""Ends of the body that can stand on the floor."""

FRAME_RATE: Final = 30


@dataclass(frozen=True, slots=True, eq=False)
class MotionClip:
    """A motion sampled at knots, smooth between them."""

    frame_count: int  # at FRAME_RATE
    knots_s: Array  # (K,)
    spline: CubicSpline  # knots_s -> (3 + 64): root position, quaternions wxyz of 16 segments, not yet unit
    contact: Mask  # (K, 4) END_POINTS on the floor, from this knot until the next

    @classmethod
    def from_samples(
        cls, frame_count: int, knots_s: Array, roots_m: Array, rotations: Array, contact: Mask
    ) -> MotionClip:
        """Make a clip through samples: roots (K, 3), rotations (K, 16, 4) wxyz of either sign, contact (K, 4)."""
        flips = np.sign(np.sum(rotations[1:] * rotations[:-1], axis=2))
        signs = np.cumprod(np.concatenate([np.ones((1, 16)), np.where(flips == 0, 1.0, flips)]), axis=0)
        values = np.concatenate([roots_m, (rotations * signs[:, :, None]).reshape(len(knots_s), 64)], axis=1)
        return cls(frame_count, knots_s, CubicSpline(knots_s, values), contact)

    @property
    def duration_s(self) -> float:
        """Time of the last frame; the first is at 0."""
        return (self.frame_count - 1) / FRAME_RATE

    def at(self, t_s: float) -> Pose:
        """Return the pose at a time, clamped to the clip's ends."""
        values = np.asarray(self.spline(float(np.clip(t_s, 0.0, self.duration_s))))
        rotations = values[3:].reshape(16, 4)
        return Pose(values[:3].copy(), rotations / np.linalg.norm(rotations, axis=1, keepdims=True))

    def contacts(self, t_s: float) -> dict[str, bool]:
        """Tell which of `END_POINTS` stand on the floor at a time."""
        knot = int(np.clip(np.searchsorted(self.knots_s, t_s, side="right") - 1, 0, len(self.knots_s) - 1))
        return dict(zip(END_POINTS, map(bool, self.contact[knot]), strict=True))

    @property
    def landings_s(self) -> Array:
        """(L,) the times at which the first of `END_POINTS` comes down after none stood on the floor."""
        stands = np.asarray(self.contact.any(axis=1))
        return self.knots_s[1:][stands[1:] & ~stands[:-1]]

    def airborne(self, t_s: float) -> bool:
        """Tell whether nothing stands on the floor at a time."""
        return not any(self.contacts(t_s).values())
