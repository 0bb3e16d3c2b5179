"""Errors of the motion, joint by joint. Nothing is aligned before it is compared, but where a name says so."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pzcap.scoring.records import BodyTrack, TrueCapture
from pzcap.types import PARENTS, Array, Mask


@dataclass(frozen=True, slots=True, eq=False)
class BodyErrors:
    """Errors of the motion."""

    joints_m: Array  # (F, 16) distance of each joint from the truth
    sigma_m: Array | None  # (F, 16) standard deviation that the estimate claims
    limbs: Array  # (15,) length of each limb, joint to joint, relative to the true one; empty where nothing is valid
    valid: Mask  # (F,) the estimate gives a joint
    keyframe: Mask  # (F,) a person posed it: not scored
    inverted: Mask  # (F,) head below the pelvis
    airborne: Mask  # (F,) no contact with the floor
    given: Mask | None = None  # (F, 16) the estimate gives this joint; None: all in the valid frames
    aligned_m: Array | None = None  # (F, 16) the distances after one similarity transform of the whole motion
    similarity: Similarity | None = None  # that transform

    @property
    def scored(self) -> Mask:
        """(F,) the frames that count: estimated, and not posed by hand."""
        return self.valid & ~self.keyframe

    @property
    def scored_joints(self) -> Mask:
        """(F, 16) the joints that count."""
        given = np.repeat(self.valid[:, None], self.joints_m.shape[1], axis=1) if self.given is None else self.given
        return np.asarray(given & ~self.keyframe[:, None])


def body_errors(body: BodyTrack, truth: TrueCapture, frames: NDArray[np.int64], known: Mask) -> BodyErrors:
    """Compare a motion (F,) with the truth in its ``frames`` (F,), where it is ``known`` (F,)."""
    true, given = truth.joints_m[frames], body.valid & known[:, None]
    whole = given.all(axis=1)
    lengths = [_limbs_m(joints[whole]) for joints in (body.joints_m, true)]
    keyframe = body.keyframe | (truth.keyframe[frames] & known)
    scored = given & ~keyframe[:, None]
    similarity = similarity_of(body.joints_m[scored], true[scored])
    return BodyErrors(
        joints_m=np.linalg.norm(body.joints_m - true, axis=2), sigma_m=body.sigma_m,
        limbs=lengths[0] / lengths[1] - 1.0, valid=np.any(given, axis=1), keyframe=keyframe,
        inverted=truth.inverted[frames], airborne=truth.airborne[frames], given=given,
        aligned_m=None if similarity is None else np.linalg.norm(similarity.apply(body.joints_m) - true, axis=2),
        similarity=similarity,
    )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Similarity:
    """A turn, a scaling and a shift."""

    rotation: Array  # (3, 3)
    scale: float
    shift: Array  # (3,)

    def apply(self, points_m: Array) -> Array:
        """``points_m`` (..., 3) after it."""
        return np.asarray(self.scale * points_m @ self.rotation.T + self.shift)


def similarity_of(found: Array, true: Array) -> Similarity | None:
    """The similarity that brings points (N, 3) that were ``found`` nearest to the ``true`` ones (Umeyama, 1991); None
    where they do not fix it."""
    if len(found) < 3:
        return None
    middle, there = found.mean(axis=0), true.mean(axis=0)
    spread = float(np.sum((found - middle) ** 2))
    u, values, vt = np.linalg.svd((true - there).T @ (found - middle))
    if spread <= 0.0 or values[1] <= 1e-12 * values[0]:
        return None
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation, scale = (u * signs) @ vt, float(values @ signs) / spread
    return Similarity(rotation, scale, there - scale * rotation @ middle)


def _limbs_m(joints_m: Array) -> Array:
    """Mean length (15,) of each limb, from a joint (F, 16, 3) to its parent; empty if there are no frames."""
    if not len(joints_m):
        return np.zeros(0)
    children = np.arange(1, len(PARENTS))
    return np.asarray(np.linalg.norm(joints_m[:, children] - joints_m[:, PARENTS[1:]], axis=2).mean(axis=0))
