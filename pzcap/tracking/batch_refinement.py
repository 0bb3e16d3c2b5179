"""Batch refinement of the frames between two keyframes: drift and jitter removed.

The passes from the keyframes have found the body in every frame, each from its own side. Now every pose is fitted to
the silhouettes and to the mean appearance of the skin, with a prior on the acceleration
(`pzcap.tracking.temporal_constraints`). The keyframe that ends the interval is one of these frames: the hand that set
it is wrong by more than they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pzcap.body.kinematics import difference, retract
from pzcap.body.skeleton import DOF, Body
from pzcap.solver.gauss_newton import SolveReport
from pzcap.tracking.appearance import LimbAppearance
from pzcap.tracking.body_constraints import constraints
from pzcap.tracking.camera_refinement import MarginalisedCamera
from pzcap.tracking.frame_tracker import NO_CONTOUR, PoseEstimate
from pzcap.tracking.keyframes import information
from pzcap.tracking.observation import Placed
from pzcap.tracking.pixel_time import ClockEstimate, ClockSystem
from pzcap.tracking.pose_objective import PosedBody, PoseObjective, ViewSequence
from pzcap.tracking.reacquisition import PassResults, Reacquired, accepted, posterior_spread, reacquire
from pzcap.tracking.settings import TrackingConfig
from pzcap.tracking.skin_appearance import Appearances, mean_appearances
from pzcap.tracking.temporal_constraints import contacts, smooth_step
from pzcap.tracking.tuning import CLOCK, REACQUISITION
from pzcap.types import SEGMENTS, Array, Keyframe, Pose


@dataclass(frozen=True, slots=True, eq=False)
class RefinedBatch:
    """The frames of an interval, and how well the images of each determine it."""

    frames: list[PoseEstimate]
    objectives: list[PoseObjective]  # their cameras and clocks corrected
    clocks: ClockEstimate
    cameras: list[list[MarginalisedCamera | None]]
    report: SolveReport
    spread_m: Array  # (T, 16) of joints in limbs that were sought, as `posterior_spread` has it; NaN of others


def refine_batch(
    body: Body, poses: Sequence[Pose], sequence: ViewSequence, before: Sequence[Pose], key: Keyframe | None,
    passes: PassResults | None, clocks: ClockEstimate, config: TrackingConfig,
) -> RefinedBatch:  # fmt: skip
    """Refine the ``poses`` of the frames of a ``sequence``, and the ``clocks`` of the cameras as they are known before;
    in the frames ``before`` them the body is held fast. Where the last is a ``key``, the pose that it was given counts
    there beside the images.

    Given the results of the ``passes`` in the others, limbs that do not look like themselves are also reacquired
    (`pzcap.tracking.reacquisition`), and taken from there if that scores more.
    """
    batch = _Batch(body, sequence.period, before, key, clocks, config)
    objectives = sequence.objectives(body, poses)
    posed, placed = _placed(objectives, poses)
    found = batch.sweep(objectives, posed, placed, mean_appearances(body, sequence.views, placed))
    for _ in range(CLOCK.rounds):  # a skin that was sampled at wrong poses, or by wrong clocks, holds these back
        clock = found.clocks.clock
        posed, placed = _placed(found.objectives, [each.pose for each in found.frames])
        found = batch.sweep(found.objectives, posed, placed, mean_appearances(body, sequence.views, placed))
        if np.abs(found.clocks.clock - clock).max() < CLOCK.settled:
            break
    if passes is None or not config.reacquisition:
        return found
    limbs = LimbAppearance(body, config.appearance_score)
    sought, reference = np.zeros(found.spread_m.shape, bool), passes.reference
    for _ in range(REACQUISITION.rounds):
        found, again, taken = _reacquired(batch, limbs, found, sequence, passes)
        if again is not None:
            sought[: len(again.lost)] |= again.lost
            reference = again.reference
        if not taken:
            break
        passes = replace(passes, doubtful=np.zeros_like(passes.doubtful))  # what leapt does no longer
    poses = [each.pose for each in found.frames]
    return replace(found, spread_m=posterior_spread(limbs, poses, found.objectives, reference, sought))


def _reacquired(
    batch: _Batch, limbs: LimbAppearance, found: RefinedBatch, sequence: ViewSequence, passes: PassResults
) -> tuple[RefinedBatch, Reacquired | None, bool]:
    """The batch ``found``, refined anew with lost limbs where they score more; what was reacquired; and whether
    anything of it was taken."""
    poses = [each.pose for each in found.frames]
    inner, after = (len(poses), None) if batch.key is None else (len(poses) - 1, poses[-1])
    placed = _placed(found.objectives, poses)[1]
    again = reacquire(
        limbs, poses[:inner], found.objectives[:inner], placed[:inner], passes, (batch.before[-1], after), batch.period
    )
    if again is None:
        return found, None, False
    other = batch.sweep(found.objectives, *_placed(found.objectives, [*again.poses, *poses[inner:]]), again.reference)
    pairs = [(here, there.pose) for here, there in zip(poses, other.frames, strict=True)]
    chosen = accepted(limbs, batch.before[-1], pairs, sequence.corrected(other.objectives), again, passes.agreed)
    # where limbs of the two meet, the motion leaps: a third sweep smooths it
    smoothed = batch.sweep(other.objectives, *_placed(other.objectives, chosen), again.reference)
    return smoothed, again, any(one is not here for one, here in zip(chosen, poses, strict=True))


def _placed(objectives: Sequence[PoseObjective], poses: Sequence[Pose]) -> tuple[list[PosedBody], list[Placed]]:
    """The body in each frame, and its visibility."""
    pairs = [each.place(pose) for each, pose in zip(objectives, poses, strict=True)]
    return [posed for posed, _ in pairs], [placed for _, placed in pairs]


@dataclass(frozen=True, slots=True, eq=False)
class _Batch:
    """Frames that are solved for together, but for their images."""

    body: Body
    period: float  # frame periods from an instant to the next
    before: Sequence[Pose]
    key: Keyframe | None  # of the last of them
    clocks: ClockEstimate  # as they are known from other intervals
    config: TrackingConfig

    def sweep(
        self, objectives: Sequence[PoseObjective], posed: Sequence[PosedBody], placed: Sequence[Placed],
        appearances: Appearances,
    ) -> RefinedBatch:  # fmt: skip
        """Some Gauss-Newton steps of the poses, the cameras and the clocks, visibility staying as ``placed``."""
        config, objectives, poses = self.config, list(objectives), [each.pose for each in posed]
        hessians, contours = [np.zeros((DOF, DOF)) for _ in poses], [NO_CONTOUR for _ in poses]
        cameras: list[list[MarginalisedCamera | None]] = [[None] * len(each.views) for each in objectives]
        steps, cost, clock = np.zeros((len(poses), DOF)), 0.0, clocks_of(objectives)
        known = self.clocks
        for count in range(config.polishing_sweeps):
            if count:
                drapes = [each.drape for each in objectives]
                sequence = ViewSequence([each.views for each in objectives], self.period)
                objectives = sequence.objectives(self.body, poses)
                objectives = [replace(each, drape=drape) for each, drape in zip(objectives, drapes, strict=True)]
                posed = [each.posed(pose) for each, pose in zip(objectives, poses, strict=True)]
            gradients, cost, normals = [], 0.0, {}
            system, crosses, told = ClockSystem(self.clocks), [], []
            for t, (objective, here, where) in enumerate(zip(objectives, posed, placed, strict=True)):
                normal = objective.normal(here, where, appearances, config.schedule[-1].terms)
                stiffness, pull = constraints(
                    self.body,
                    here.pose,
                    config.limit_sigma_rad,
                    self_collision=config.self_collision,
                    spine_sigma_rad=config.spine_sigma_rad,
                )
                hessians[t] = normal.hessian + stiffness
                gradients.append(normal.gradient + pull)
                contours[t], cameras[t], cost = normal.contour, normal.cameras, cost + normal.cost
                normals[t] = normal
                told.append(objective.clocks(here, normal))
            if self.key is not None:
                prior = information(self.key, config)
                hessians[-1] += prior
                gradients[-1] += prior @ difference(self.key.pose, poses[-1])
            weak = np.diag(1.0 / config.prediction_sigma**2)  # what no view shows still moves as other frames do
            for hessian, gradient, own in zip(hessians, gradients, told, strict=True):
                crosses.append(system.add(own, hessian + weak, gradient))
            known = system.solve(clock)
            ticked, clock = known.clock - clock, known.clock
            gradients = [each - cross @ ticked for each, cross in zip(gradients, crosses, strict=True)]
            chain = [*self.before, *poses]
            ties = contacts(self.body, chain) if config.contacts else []
            # forces that change at random: how far they throw a body off grows as the time to the power of 3/2
            sigma = config.acceleration_sigma * self.period**1.5
            steps = smooth_step(poses, hessians, gradients, sigma, self.before, ties)
            steps = steps.clip(-0.5, 0.5)
            poses = [retract(pose, step) for pose, step in zip(poses, steps, strict=True)]
            objectives = [
                each.after(normals[t], step).with_clocks(clock)
                for t, (each, step) in enumerate(zip(objectives, steps, strict=True))
            ]
        seen = [any(view is not None for view in each.views) for each in objectives]
        frames = [PoseEstimate(*each) for each in zip(poses, hessians, contours, seen, strict=True)]
        converged = bool(np.abs(steps).max(initial=0.0) < config.step_tolerance)
        return RefinedBatch(
            frames, objectives, known, cameras, SolveReport(converged, config.polishing_sweeps, cost),
            np.full((len(frames), len(SEGMENTS)), np.nan),
        )  # fmt: skip


def clocks_of(objectives: Sequence[PoseObjective]) -> Array:
    """(C,) the clocks that the views were exposed by; 0 of a camera without a view."""
    clocks = np.zeros(len(objectives[0].views))
    for each in objectives:
        for c, view in enumerate(each.views):
            if view is not None:
                clocks[c] = view.exposure.clock
    return clocks
