"""The body corrected from the images: segment lengths, girths and where the skin lies on the skeleton.

A tape is off by half a centimetre and an athlete is no stack of ellipses. Every residual of the contour is also
differentiated with respect to some thirty corrections, the pose of each frame is eliminated (Schur complement), and
what is left is gathered over the frames with the tape as prior. Left and right are taken to be alike.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pzcap.body import DOF, MOVES, Body, screws
from pzcap.types import LUMBAR_FRACTION, PARENTS, SEGMENTS, THORAX_FRACTION, Array

_SKIN_SIGMA_M: Final = 0.010  # how far a ring's half axis, and its middle, may be from where the tape's girth puts it


@dataclass(frozen=True, slots=True, eq=False)
class Basis:
    """How a body changes with each of P corrections, each in metres."""

    joints: Array  # (P, 16, 3) of a segment's joint in its parent's frame
    skin: Array  # (P, 16, 3, 4) of a point (x, y, z, 1) in its segment's frame
    sigma_m: Array  # (P,) prior


@dataclass(frozen=True, slots=True, eq=False)
class ContourRows:
    """Contour points of one frame, of all views, with their residuals (N of them)."""

    segment: NDArray[np.int64]  # (N,)
    points_m: Array  # (N, 3) world
    gradients: Array  # (N, 3) of the residual's distance, pixels a metre
    residual_px: Array  # (N,)
    weight: Array  # (N,)


def _segments(name: str) -> list[int]:
    return [i for i, segment in enumerate(SEGMENTS) if segment.removeprefix("left_").removeprefix("right_") == name]


def basis(body: Body) -> Basis:
    """The corrections of ``body``."""
    rows: list[tuple[Array, Array, float]] = []

    def add(sigma_m: float, joints: Mapping[int, Sequence[float]], skin: Mapping[int, Array]) -> None:
        joint_row, skin_row = np.zeros((16, 3)), np.zeros((16, 3, 4))
        for segment, direction in joints.items():
            joint_row[segment] = direction
        for segment, affine in skin.items():
            skin_row[segment] = affine
        rows.append((joint_row, skin_row, sigma_m))

    def half_axes(segment: int) -> Array:
        return np.ptp(body.surface.points_m[body.surface.segment == segment], axis=0) / 2

    def stretch(axis: int, per_m: float) -> Array:
        affine = np.zeros((3, 4))
        affine[axis, axis] = per_m
        return affine

    def shift(axis: int) -> Array:
        affine = np.zeros((3, 4))
        affine[axis, 3] = 1.0
        return affine

    tape, trunk = body.sigma_m, float(body.offsets_m[[1, 2, 3], 2].sum())
    shoulders, hips = _segments("upper_arm"), _segments("thigh")
    chest = 1 - THORAX_FRACTION
    add(
        tape,
        {1: (0, 0, LUMBAR_FRACTION), 2: (0, 0, THORAX_FRACTION - LUMBAR_FRACTION)}
        | dict.fromkeys((3, *shoulders), (0, 0, chest)),
        {i: stretch(2, 1 / trunk) for i in (0, 1, 2)},
    )
    add(tape, dict.fromkeys(shoulders, (0, 0, -1.0)), {})
    add(tape, dict(zip(shoulders, ((0, 0.5, 0), (0, -0.5, 0)), strict=True)), {})
    add(tape, dict(zip(hips, ((0, 0.5, 0), (0, -0.5, 0)), strict=True)), {})
    for near, far in (("upper_arm", "forearm"), ("forearm", "hand"), ("thigh", "shank"), ("shank", "foot")):
        length = float(-body.offsets_m[_segments(far)[0], 2])
        add(tape, dict.fromkeys(_segments(far), (0, 0, -1.0)), {i: stretch(2, 1 / length) for i in _segments(near)})
    for index in range(4):  # the trunk and the head: deeper, wider, further ahead, further up
        half = half_axes(index)
        add(_SKIN_SIGMA_M, {}, {index: stretch(0, 1 / half[0])})
        add(_SKIN_SIGMA_M, {}, {index: stretch(1, 1 / half[1])})
        add(_SKIN_SIGMA_M, {}, {index: shift(0)})
        add(_SKIN_SIGMA_M, {}, {index: shift(2)})
    for name in ("upper_arm", "forearm", "hand", "thigh", "shank"):  # thicker, further ahead
        half = half_axes(_segments(name)[0])
        scale = 1 / float(half[:2].mean())
        add(_SKIN_SIGMA_M, {}, {i: stretch(0, scale) + stretch(1, scale) for i in _segments(name)})
        add(_SKIN_SIGMA_M, {}, {i: shift(0) for i in _segments(name)})
    for name, axis in (("head", 2), ("hand", 2), ("foot", 0), ("foot", 1), ("foot", 2)):  # what ends a limb
        extent = 2 * float(half_axes(_segments(name)[0])[axis])
        add(_SKIN_SIGMA_M, {}, {i: stretch(axis, 1 / extent) for i in _segments(name)})
    for axis in (0, 2):  # a shoe is no foot
        add(_SKIN_SIGMA_M, {}, {i: shift(axis) for i in _segments("foot")})
    joints, skin, sigma = zip(*rows, strict=True)
    return Basis(np.array(joints), np.array(skin), np.array(sigma))


def corrected(body: Body, change: Basis, amounts_m: Array) -> Body:
    """``body`` after corrections (P,)."""
    surface = body.surface
    affine = np.einsum("p,psij->sij", amounts_m, change.skin)[surface.segment]
    points = surface.points_m + np.einsum("vij,vj->vi", affine[:, :, :3], surface.points_m) + affine[:, :, 3]
    offsets = body.offsets_m + np.einsum("p,psi->si", amounts_m, change.joints)
    return replace(body, offsets_m=offsets, surface=replace(surface, points_m=np.asfortranarray(points)))


class ShapeEstimate:
    """Gathers what the frames say about the corrections of a body."""

    def __init__(self, body: Body) -> None:
        self._tape = body
        self._basis = basis(body)
        self.amounts_m: Array = np.zeros(len(self._basis.sigma_m))
        self._information: Array = np.diag(1.0 / self._basis.sigma_m**2)
        self._vector: Array = np.zeros(len(self.amounts_m))

    def add(self, world_T_segment: Array, rows: ContourRows, prior: Array, pull: Array) -> None:
        """A frame, tracked with the body as corrected so far. ``prior`` (43, 43) is the information on its pose beside
        the contour, and ``pull`` (43,) the gradient of that."""
        pose, change = self._jacobians(world_T_segment, rows)
        both = np.hstack([pose, change])
        weighted = both * rows.weight[:, None]
        hessian, gradient = weighted.T @ both, weighted.T @ rows.residual_px
        eliminate = np.linalg.solve(
            hessian[:DOF, :DOF] + prior, np.column_stack([hessian[:DOF, DOF:], gradient[:DOF] + pull])
        )
        information = hessian[DOF:, DOF:] - hessian[DOF:, :DOF] @ eliminate[:, :-1]
        step = gradient[DOF:] - hessian[DOF:, :DOF] @ eliminate[:, -1]
        self._information += information
        self._vector += information @ self.amounts_m + step

    def solve(self) -> Body:
        """The body as all frames so far have it."""
        self.amounts_m = np.asarray(np.linalg.solve(self._information, self._vector))
        return corrected(self._tape, self._basis, self.amounts_m)

    def _jacobians(self, frames: Array, rows: ContourRows) -> tuple[Array, Array]:
        """Derivatives (N, 43) and (N, P) of the distances that the residuals are made of."""
        centre = frames[0, :3, 3].copy()
        twists = screws(frames, centre)
        arm = rows.points_m - centre
        wrench = np.hstack([rows.gradients, np.cross(arm, rows.gradients)])
        carried = np.zeros_like(self._basis.joints)  # (P, 16, 3) what a correction moves each joint by, in the world
        for s, parent in enumerate(PARENTS):
            if parent >= 0:
                carried[:, s] = carried[:, parent] + self._basis.joints[:, s] @ frames[parent, :3, :3].T
        pose, change = np.zeros((len(arm), DOF)), np.zeros((len(arm), len(self.amounts_m)))
        for s in np.unique(rows.segment):
            here = rows.segment == s
            gradients = rows.gradients[here]
            pose[here] = wrench[here] @ np.where(MOVES[:, s, None], twists, 0.0).T
            local = (rows.points_m[here] - frames[s, :3, 3]) @ frames[s, :3, :3]
            moment = (gradients @ frames[s, :3, :3])[:, :, None] * np.column_stack([local, np.ones(len(local))])[
                :, None
            ]
            change[here] = (
                moment.reshape(-1, 12) @ self._basis.skin[:, s].reshape(-1, 12).T + gradients @ carried[:, s].T
            )
        return pose, change
