"""The body corrected from the images: segment lengths, and the shape of the skin.

A tape is off by half a centimetre and an athlete is no stack of ellipses. What the contours and the skin's texture say
is also differentiated with respect to the corrections (`pzcap.body.shape_basis`), the pose of each frame is
eliminated (Schur complement), and what is left is gathered over the frames with the tape as prior. Frames of the same
posture err alike: of what they say together a share counts (`Postures.share`), in the corrections as in their
covariance.

The contours show the skin; where in it the joints lie shows only in how the limbs move: the texture of a thigh turns
about the hip. But what the skin looks like was learned from the very poses that are to be corrected, so it may be in
the wrong place. Each segment's texture may therefore *slide* on it as a rigid body, by the same six numbers in all
frames of a stretch; they are eliminated as the poses are. Without them the texture would hold the body where it is.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from pzcap.body.kinematics import joint_jacobians, screws
from pzcap.body.segment_equations import PointResiduals, SegmentSums
from pzcap.body.shape_basis import LENGTHS, Basis, basis, corrected
from pzcap.body.skeleton import MOVES, Body
from pzcap.body.tuning import SHAPE
from pzcap.types import DOF, SEGMENTS, Array

_SLIDES: Final = 6 * len(SEGMENTS)
_CHANGES: Final = DOF + _SLIDES
"""The unknowns of a frame: its pose (43), the slides (96), from here on the corrections (P)."""


@dataclass(frozen=True, slots=True, eq=False)
class FrameResiduals:
    """Residuals of one frame by pose and shape, linearised."""

    world_T_segment: Array  # (16, 4, 4)
    contour: PointResiduals  # of all views; the owner is the segment
    texture: SegmentSums | None  # about the pelvis joint: what the skin's brightness says of each segment by itself
    prior: Array  # (43, 43) information on the pose beside the images
    pull: Array  # (43,) the gradient of that


class Postures(NamedTuple):
    """Sums over frames of what a correction that is wrong moves the joints by: how far it differs with the posture."""

    frames: int
    total: Array  # (16, 3, P)
    squares: float

    @staticmethod
    def of(joints: Array) -> Postures:
        """Sums over frames (S, 16, 3, P)."""
        return Postures(len(joints), np.asarray(joints.sum(axis=0)), float(np.sum(joints**2)))

    def plus(self, other: Postures) -> Postures:
        """Sums over the frames of both."""
        return Postures(self.frames + other.frames, self.total + other.total, self.squares + other.squares)

    @property
    def share(self) -> float:
        """Share of what the frames say that is their own: one frame's where all postures are the same."""
        mean = self.total / max(self.frames, 1)
        alike = self.frames * float(np.sum(mean**2)) / max(self.squares, 1e-12)
        return min(1.0, (1.0 + SHAPE.postures * (1.0 - min(alike, 1.0))) / max(self.frames, 1))


@dataclass(frozen=True, slots=True, eq=False)
class ShapeEquations:
    """Normal equations of the corrections themselves (not of a step from where they are now)."""

    information: Array  # (P, P)
    vector: Array  # (P,)
    joints: Array  # (S, 16, 3, P) in each frame, what a correction that is wrong moves the joints by
    postures: Postures  # of all frames that have said this


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """A body's shape as far as it is known at some time."""

    amounts_m: Array  # (P,) its corrections
    joint_variance_m2: Array  # (16,) of the joints' distance from where they are, for what is not known of it


@dataclass(frozen=True, slots=True, eq=False)
class ShapeEstimate:
    """Estimate of the corrections of a body, from the tape and what frames say about them."""

    tape: Body
    basis: Basis
    amounts_m: Array  # (P,) the corrections as they were solved for last
    equations: ShapeEquations  # of the tape and all frames committed; ``joints`` are of those committed last

    @staticmethod
    def of(body: Body) -> ShapeEstimate:
        """Estimate before any image."""
        change = basis(body)
        nothing, joints = np.zeros(len(change.station)), np.zeros((0, len(SEGMENTS), 3, len(change.station)))
        information = np.asarray(np.linalg.inv(change.covariance_m2))
        return ShapeEstimate(body, change, nothing, ShapeEquations(information, nothing, joints, Postures.of(joints)))

    def accumulate(self, residuals: Iterable[FrameResiduals]) -> ShapeEquations:
        """Normal equations of frames that share their texture, tracked with the body as corrected last."""
        size = _SLIDES + len(self.amounts_m)
        shared, right, joints = np.zeros((size, size)), np.zeros(size), []
        shared[:_SLIDES, :_SLIDES] = np.diag(1.0 / self._slide_sigma() ** 2)
        for frame in residuals:
            hessian, gradient = self._contour(frame)
            joints.append(self._joints(frame.world_T_segment, hessian))
            if frame.texture is not None:
                moved = self._twists(frame.world_T_segment).reshape(-1, len(gradient))
                held = SHAPE.texture_curvature * frame.texture.hessians @ moved.reshape(len(SEGMENTS), 6, -1)
                hessian += moved.T @ held.reshape(moved.shape)
                gradient += moved.T @ frame.texture.gradients.ravel()
            information, vector = _without(hessian, gradient, DOF)
            shared += information
            right += vector
        information, vector = _without(shared, right, _SLIDES)
        moved = np.array(joints)
        return ShapeEquations(information, vector + information @ self.amounts_m, moved, Postures.of(moved))

    def commit(self, equations: ShapeEquations) -> ShapeEstimate:
        """The estimate with the ``equations`` of some frames added for good."""
        before = self.equations
        information, vector = before.information + equations.information, before.vector + equations.vector
        postures = before.postures.plus(equations.postures)
        return replace(self, equations=ShapeEquations(information, vector, equations.joints, postures))

    def solve(self, equations: ShapeEquations) -> ShapeEstimate:
        """The estimate with its corrections solved for from all that was committed and from further ``equations``."""
        both = self.commit(equations).equations
        share = both.postures.share
        return replace(self, amounts_m=np.asarray(np.linalg.solve(self._information(both), share * both.vector)))

    def _information(self, equations: ShapeEquations) -> Array:
        """(P, P) what is known of the corrections: by the tape, and by the share of what the frames say."""
        tape = np.linalg.inv(self.basis.covariance_m2)
        return np.asarray(tape + equations.postures.share * (equations.information - tape))

    def body(self, amounts_m: Array) -> Body:
        """The body after corrections (P,)."""
        return corrected(self.tape, self.basis, amounts_m)

    def joint_variance(self) -> Array:
        """(16,) of the joints' distance (square metres) from where they are, for what is not known of the body: the
        same error in all frames, and the mean over those committed last.

        A correction that is wrong by ``c`` moves the joints by ``(B - J (A' W A)^-1 A' W C) c``: ``B`` moves them in
        the body, ``C`` moves the contours, and the pose (contours ``A``, joints ``J``) then follows the contours to
        where they were seen. The errors ``c`` have the covariance that is left of the tape's by all that was kept. What
        no correction describes comes to `SHAPE.undescribed_m` beside that.
        """
        covariance = np.linalg.inv(self._information(self.equations)) * np.outer(self.basis.doubt, self.basis.doubt)
        joints = self.equations.joints
        described = np.einsum("sjap,pq,sjaq->j", joints, covariance, joints, optimize=True) / len(joints)
        return np.asarray(described + SHAPE.undescribed_m**2)

    def _slide_sigma(self) -> Array:
        """(96,) metres and radians of the slides: texture lies as far off as the body that it was learned with was."""
        lengths = self.basis.sigma_m[:LENGTHS]
        sigma_m = SHAPE.slide * float(np.sqrt(np.mean(lengths**2)))
        return np.tile(np.repeat([sigma_m, sigma_m / SHAPE.slide_arm_m], 3), len(SEGMENTS))

    def _joints(self, frames: Array, hessian: Array) -> Array:
        """(16, 3, P) derivatives of the joints in the world with respect to the corrections, the pose following the
        contours: ``hessian`` is as `_contour` has it."""
        follows = np.linalg.solve(hessian[:DOF, :DOF], hessian[:DOF, _CHANGES:])
        carried = self.basis.carried(frames).transpose(1, 2, 0)
        return np.asarray(carried - joint_jacobians(frames) @ follows)

    def _contour(self, frame: FrameResiduals) -> tuple[Array, Array]:
        """Normal equations of a frame's unknowns, of its contours and of what is known of the pose beside the
        images."""
        size = _CHANGES + len(self.amounts_m)
        hessian, gradient = np.zeros((size, size)), np.zeros(size)
        (rows, segment), jacobian = frame.contour, self._jacobian(frame.world_T_segment, frame.contour)
        for s in np.unique(segment):  # few of the unknowns move a segment's skin
            here = np.flatnonzero(segment == s)
            own = jacobian[here]
            movers = np.flatnonzero(own.any(axis=0))
            weighted = own[:, movers].T * rows[here, 0]
            hessian[np.ix_(movers, movers)] += weighted @ own[:, movers]
            gradient[movers] += weighted @ rows[here, 1]
        hessian[:DOF, :DOF] += frame.prior
        gradient[:DOF] += frame.pull
        return hessian, gradient

    def _jacobian(self, frames: Array, contour: PointResiduals) -> Array:
        """Derivatives (N, 43 + 96 + P) of the distances that the residuals are made of, by the frame's unknowns."""
        (rows, segment), centre = contour, frames[0, :3, 3].copy()
        along, points, twists = rows[:, 2:5], rows[:, 5:], screws(frames, centre)
        wrench = np.hstack([along, np.cross(points - centre, along)])
        carried = self.basis.carried(frames)
        jacobian = np.zeros((len(rows), _CHANGES + len(self.amounts_m)))
        for s in np.unique(segment):
            here, turned = segment == s, frames[s, :3, :3]
            jacobian[here, :DOF] = wrench[here] @ np.where(MOVES[:, s, None], twists, 0.0).T
            local = (points[here] - frames[s, :3, 3]) @ turned
            change = self.basis.skin_change(s, local, along[here] @ turned) + along[here] @ carried[:, s].T
            jacobian[here, _CHANGES:] = change
        return jacobian

    def _twists(self, frames: Array) -> Array:
        """(16, 6, 43 + 96 + P) the twist of each segment's texture about the pelvis joint by the frame's unknowns."""
        centre = frames[0, :3, 3].copy()
        twists, carried = screws(frames, centre), self.basis.carried(frames)
        moved = np.zeros((len(SEGMENTS), 6, _CHANGES + len(self.amounts_m)))
        for s in range(len(SEGMENTS)):
            axes, arm = frames[s, :3, :3], frames[s, :3, 3] - centre
            slide = np.zeros((6, 6))
            slide[:3, :3] = slide[3:, 3:] = axes
            slide[:3, 3:] = np.cross(arm, axes, axisb=0).T
            moved[s, :, :DOF] = np.where(MOVES[:, s, None], twists, 0.0).T
            moved[s, :, DOF + 6 * s : DOF + 6 * s + 6] = -slide
            moved[s, :3, _CHANGES:] = carried[:, s].T
        return moved


def _without(hessian: Array, gradient: Array, count: int) -> tuple[Array, Array]:
    """Normal equations with the first ``count`` unknowns eliminated."""
    kept = np.column_stack([hessian[:count, count:], gradient[:count]])
    eliminate = np.linalg.solve(hessian[:count, :count], kept)
    cross = hessian[count:, :count]
    return hessian[count:, count:] - cross @ eliminate[:, :-1], gradient[count:] - cross @ eliminate[:, -1]
