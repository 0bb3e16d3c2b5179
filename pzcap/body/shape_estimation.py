"""The body corrected from the images: segment lengths, and the shape of the skin.

A tape is off by half a centimetre and an athlete is no stack of ellipses. What the contours and the skin's texture say
is also differentiated with respect to the corrections (`pzcap.body.shape_basis`), the pose of each frame is
eliminated (Schur complement), and what is left is gathered over the frames with the tape as prior.

The contours show the skin; where in it the joints lie shows only in how the limbs move: the texture of a thigh turns
about the hip. But what the skin looks like was learned from the very poses that are to be corrected, so it may be in
the wrong place. Each segment's texture may therefore *slide* on it as a rigid body, by the same six numbers in all
frames of a stretch; they are eliminated as the poses are. Without them the texture would hold the body where it is.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pzcap.body.kinematics import joint_jacobians, screws
from pzcap.body.shape_basis import basis, corrected
from pzcap.body.skeleton import DOF, MOVES, Body
from pzcap.types import SEGMENTS, Array

_SLIDE_SIGMA: Final = np.tile([0.01, 0.01, 0.01, 0.05, 0.05, 0.05], len(SEGMENTS))  # metres, radians
_TEXTURE_CURVATURE: Final = 0.4
"""Of the texture's cost, beside what Gauss-Newton has: robust weights, and texture as fine as the pixels, make it
flatter (0.25-0.5 measured). Taken at its word, each step would stop far short."""

_DOUBT: Final = 0.9
"""Of the deviation that is left of the tape's: the frames are believed so little, since they err alike, that it comes
out too large (the one number of a joint's sigma that is fitted, to what is covered on the development captures)."""


@dataclass(frozen=True, slots=True, eq=False)
class ContourRows:
    """Contour points of one frame, of all views, with their residuals (N of them)."""

    segment: NDArray[np.int64]  # (N,)
    points_m: Array  # (N, 3) world
    gradients: Array  # (N, 3) of the residual's distance, pixels a metre
    residual_px: Array  # (N,)
    weight: Array  # (N,)


@dataclass(frozen=True, slots=True, eq=False)
class Texture:
    """Evidence of the skin's brightness in one frame on each segment as a free rigid body: normal equations in its
    twist about the pelvis joint, as `pzcap.body.kinematics.lift` takes them."""

    hessians: Array  # (16, 6, 6)
    gradients: Array  # (16, 6)


@dataclass(frozen=True, slots=True, eq=False)
class FrameResiduals:
    """Residuals of one frame by pose and shape, linearised."""

    world_T_segment: Array  # (16, 4, 4)
    rows: ContourRows
    texture: Texture | None
    prior: Array  # (43, 43) information on the pose beside the images
    pull: Array  # (43,) the gradient of that


@dataclass(frozen=True, slots=True, eq=False)
class ShapeEquations:
    """Normal equations of the corrections themselves (not of a step from where they are now)."""

    information: Array  # (P, P)
    vector: Array  # (P,)
    joints: Array  # (S, 16, 3, P) in each frame, what a correction that is wrong moves the joints by


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """A body's shape as far as it is known at some time."""

    amounts_m: Array  # (P,) its corrections
    joint_variance_m2: Array  # (16,) of the joints' distance from where they are, for what is not known of it


class ShapeEstimate:
    """Gathers what the frames say about the corrections of a body."""

    def __init__(self, body: Body) -> None:
        self._tape = body
        self._basis = basis(body)
        self.amounts_m: Array = np.zeros(len(self._basis.sigma_m))
        self._information: Array = np.diag(1.0 / self._basis.sigma_m**2)
        self._vector: Array = np.zeros(len(self.amounts_m))
        self._joints_moved: Array = np.zeros((0, len(SEGMENTS), 3, len(self.amounts_m)))

    def accumulate(self, residuals: Iterable[FrameResiduals]) -> ShapeEquations:
        """Normal equations of frames that share their texture, tracked with the body as corrected last."""
        size = len(self.amounts_m) + len(_SLIDE_SIGMA)
        shared, right, joints = np.zeros((size, size)), np.zeros(size), []
        for frame in residuals:
            hessian, gradient = self._contour(frame)
            joints.append(self._joints(frame.world_T_segment, hessian))
            if frame.texture is not None:
                self._add(frame.texture, frame.world_T_segment, hessian, gradient)
            information, vector = _without(hessian, gradient, DOF)
            shared += information
            right += vector
        slides = slice(len(self.amounts_m), None)
        shared[slides, slides] += np.diag(1.0 / _SLIDE_SIGMA**2)
        order = np.roll(np.arange(size), len(_SLIDE_SIGMA))
        information, vector = _without(shared[np.ix_(order, order)], right[order], len(_SLIDE_SIGMA))
        return ShapeEquations(information, vector + information @ self.amounts_m, np.array(joints))

    def commit(self, equations: ShapeEquations) -> None:
        """Add the ``equations`` of some frames for good."""
        self._information = self._information + equations.information
        self._vector = self._vector + equations.vector
        self._joints_moved = equations.joints

    def solve(self, equations: ShapeEquations | None = None) -> Body:
        """The body from all that was committed, and from further ``equations``."""
        information, vector = self._information, self._vector
        if equations is not None:
            information, vector = information + equations.information, vector + equations.vector
        self.amounts_m = np.asarray(np.linalg.solve(information, vector))
        return self.body(self.amounts_m)

    def body(self, amounts_m: Array) -> Body:
        """The body after corrections (P,)."""
        return corrected(self._tape, self._basis, amounts_m)

    def joint_variance(self) -> Array:
        """(16,) of the joints' distance (square metres) from where they are, for what is not known of the body: the
        same error in all frames, and the mean over those heard of last.

        A correction that is wrong by ``c`` moves the joints by ``(B - J (A' W A)^-1 A' W C) c``: ``B`` moves them in
        the body, ``C`` moves the contours, and the pose (contours ``A``, joints ``J``) then follows the contours to
        where they were seen. The errors ``c`` have the covariance that is left of the tape's by all that was kept.
        """
        covariance = _DOUBT**2 * np.linalg.inv(self._information)
        joints = self._joints_moved
        return np.asarray(np.einsum("sjap,pq,sjaq->j", joints, covariance, joints, optimize=True) / len(joints))

    def _joints(self, frames: Array, hessian: Array) -> Array:
        """(16, 3, P) derivatives of the joints in the world with respect to the corrections, the pose following the
        contours: ``hessian`` is as `_contour` has it."""
        changes = slice(DOF, DOF + len(self.amounts_m))
        follows = np.linalg.solve(hessian[:DOF, :DOF], hessian[:DOF, changes])
        carried = self._basis.carried(frames).transpose(1, 2, 0)
        return np.asarray(carried - joint_jacobians(frames) @ follows)

    def _contour(self, frame: FrameResiduals) -> tuple[Array, Array]:
        """Normal equations in a frame's pose (43), the corrections (P) and the slides (96), of its contours and of what
        is known of the pose beside the images."""
        size = DOF + len(self.amounts_m) + len(_SLIDE_SIGMA)
        hessian, gradient = np.zeros((size, size)), np.zeros(size)
        rows = frame.rows
        jacobian = self._jacobian(frame.world_T_segment, rows)
        for s in np.unique(rows.segment):  # few of the unknowns move a segment's skin
            here = np.flatnonzero(rows.segment == s)
            own = jacobian[here]
            movers = np.flatnonzero(own.any(axis=0))
            weighted = own[:, movers].T * rows.weight[here]
            hessian[np.ix_(movers, movers)] += weighted @ own[:, movers]
            gradient[movers] += weighted @ rows.residual_px[here]
        hessian[:DOF, :DOF] += frame.prior
        gradient[:DOF] += frame.pull
        return hessian, gradient

    def _add(self, texture: Texture, frames: Array, hessian: Array, gradient: Array) -> None:
        """Add the evidence of the texture to the normal equations of the contours."""
        moved = self._twists(frames)  # (16, 6, size)
        held = _TEXTURE_CURVATURE * texture.hessians @ moved
        hessian += moved.reshape(-1, len(gradient)).T @ held.reshape(-1, len(gradient))
        gradient += moved.reshape(-1, len(gradient)).T @ texture.gradients.ravel()

    def _jacobian(self, frames: Array, rows: ContourRows) -> Array:
        """Derivatives (N, 43 + P) of the distances that the residuals are made of, by pose and corrections."""
        centre = frames[0, :3, 3].copy()
        twists = screws(frames, centre)
        arm = rows.points_m - centre
        wrench = np.hstack([rows.gradients, np.cross(arm, rows.gradients)])
        carried = self._basis.carried(frames)
        jacobian = np.empty((len(arm), DOF + len(self.amounts_m)))
        for s in np.unique(rows.segment):
            here = rows.segment == s
            gradients, turned = rows.gradients[here], frames[s, :3, :3]
            jacobian[here, :DOF] = wrench[here] @ np.where(MOVES[:, s, None], twists, 0.0).T
            local = (rows.points_m[here] - frames[s, :3, 3]) @ turned
            change = self._basis.skin_change(s, local, gradients @ turned) + gradients @ carried[:, s].T
            jacobian[here, DOF:] = change
        return jacobian

    def _twists(self, frames: Array) -> Array:
        """(16, 6, 43 + P + 96) the twist of each segment's texture about the pelvis joint by pose, corrections and
        slides."""
        centre, count = frames[0, :3, 3].copy(), DOF + len(self.amounts_m)
        twists, carried = screws(frames, centre), self._basis.carried(frames)
        moved = np.zeros((len(SEGMENTS), 6, count + len(_SLIDE_SIGMA)))
        for s in range(len(SEGMENTS)):
            axes, arm = frames[s, :3, :3], frames[s, :3, 3] - centre
            own = slice(count + 6 * s, count + 6 * s + 6)
            moved[s, :, :DOF] = np.where(MOVES[:, s, None], twists, 0.0).T
            moved[s, :3, DOF:count] = carried[:, s].T
            slide = np.zeros((6, 6))
            slide[:3, :3] = slide[3:, 3:] = axes
            slide[:3, 3:] = np.cross(arm, axes, axisb=0).T
            moved[s, :, own] = -slide
        return moved


def _without(hessian: Array, gradient: Array, count: int) -> tuple[Array, Array]:
    """Normal equations with the first ``count`` unknowns eliminated."""
    kept = np.column_stack([hessian[:count, count:], gradient[:count]])
    eliminate = np.linalg.solve(hessian[:count, :count], kept)
    cross = hessian[count:, :count]
    return hessian[count:, count:] - cross @ eliminate[:, :-1], gradient[count:] - cross @ eliminate[:, -1]
