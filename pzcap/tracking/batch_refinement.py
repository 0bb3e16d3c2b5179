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
from pzcap.body.skeleton import Body
from pzcap.solver.gauss_newton import SolveReport
from pzcap.tracking.appearance import LimbAppearance
from pzcap.tracking.body_constraints import constraints
from pzcap.tracking.camera_refinement import MarginalisedCamera
from pzcap.tracking.frame_tracker import PoseEstimate
from pzcap.tracking.keyframes import information
from pzcap.tracking.observation import Placed
from pzcap.tracking.pixel_time import ClockEquations, ClockEstimate, ClockSystem
from pzcap.tracking.pose_objective import PosedBody, PoseEquations, PoseObjective
from pzcap.tracking.reacquisition import PassResults, Places, Reacquired, accepted, posterior_spread, reacquire
from pzcap.tracking.settings import TrackingConfig
from pzcap.tracking.skin_appearance import Appearances, mean_appearances
from pzcap.tracking.temporal_constraints import contacts, smooth_step
from pzcap.tracking.tuning import ACCELERATION_SIGMA, CLOCK, PREDICTION_SIGMA, REACQUISITION
from pzcap.tracking.view_sequence import ViewSequence
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
    limbs = LimbAppearance(body, config.appearance_score).calibrated(
        [each.pose for each in found.frames], found.objectives, passes.reference, passes.sure
    )
    places, reference = Places(), passes.reference
    for _ in range(REACQUISITION.rounds):
        found, again, taken = _reacquired(batch, limbs, found, sequence, passes)
        if again is not None:
            for limb, there in again.places.items():
                places[limb] = [*places.get(limb, []), *there]
            reference = again.reference
        if not taken:
            break
        passes = replace(passes, doubtful=np.zeros_like(passes.doubtful))  # what leapt does no longer
    poses = [each.pose for each in found.frames]
    return replace(found, spread_m=posterior_spread(limbs, poses, found.objectives, reference, places))


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
        """Gauss-Newton steps of the poses, the cameras and the clocks until they stay, visibility staying as
        ``placed``. A frame that has come to rest is not linearised again: its equations follow its last small steps."""
        config, poses = self.config, [each.pose for each in posed]
        seen = [any(view is not None for view in each.views) for each in objectives]
        keys = [*[None] * (len(poses) - 1), self.key]
        scene = zip(keys, objectives, posed, placed, strict=True)
        equations = [self._linearised(*each, appearances) for each in scene]
        objectives, clock, known = list(objectives), clocks_of(objectives), self.clocks
        weak = np.diag(1.0 / PREDICTION_SIGMA**2)  # what no view shows still moves as other frames do
        # forces that change at random: how far they throw a body off grows as the time to the power of 3/2
        sigma = ACCELERATION_SIGMA * self.period**1.5
        moving, count = np.ones(len(poses), bool), 0
        while moving.any() and count < config.polishing_sweeps:
            if count:
                objectives = self._moved(objectives, poses)
                equations = [
                    self._linearised(keys[t], objectives[t], objectives[t].posed(poses[t]), placed[t], appearances)
                    if moving[t] else each
                    for t, each in enumerate(equations)
                ]  # fmt: skip
            system = ClockSystem(self.clocks)
            crosses = [system.add(each.clocks, each.hessian + weak, each.gradient) for each in equations]
            known = system.solve(clock)
            ticked, clock = known.clock - clock, known.clock
            pulls = [each.gradient - cross @ ticked for each, cross in zip(equations, crosses, strict=True)]
            ties = contacts(self.body, [*self.before, *poses]) if config.contacts else []
            steps = smooth_step(poses, [each.hessian for each in equations], pulls, sigma, self.before, ties)
            steps = steps.clip(-0.5, 0.5)
            poses = [retract(pose, step) for pose, step in zip(poses, steps, strict=True)]
            objectives = [
                objective.after(each.normal, step).with_clocks(clock)
                for objective, each, step in zip(objectives, equations, steps, strict=True)
            ]
            moving, count = np.abs(steps).max(axis=1) > config.step_tolerance, count + 1
            equations = [
                each.after(step, ticked, pull) for each, step, pull in zip(equations, steps, pulls, strict=True)
            ]
        found = zip(poses, equations, seen, strict=True)
        frames = [PoseEstimate(pose, each.hessian, each.normal.contour, any_) for pose, each, any_ in found]
        return RefinedBatch(
            frames, objectives, known, [each.normal.cameras for each in equations],
            SolveReport(not moving.any(), count, sum(each.normal.cost for each in equations)),
            np.full((len(frames), len(SEGMENTS)), np.nan),
        )  # fmt: skip

    def _linearised(
        self, key: Keyframe | None, objective: PoseObjective, posed: PosedBody, placed: Placed, appearances: Appearances
    ) -> _Linearised:
        """The equations of a frame, whose pose a hand gave if it is a ``key``."""
        config, normal = self.config, objective.normal(posed, placed, appearances, self.config.schedule[-1].terms)
        stiffness, pull = constraints(
            self.body, posed.pose, config.limit_sigma_rad, self_collision=config.self_collision,
            spine_sigma_rad=config.spine_sigma_rad,
        )  # fmt: skip
        hessian, gradient = normal.hessian + stiffness, normal.gradient + pull
        if key is not None:
            prior = information(key)
            hessian, gradient = hessian + prior, gradient + prior @ difference(key.pose, posed.pose)
        return _Linearised(normal, hessian, gradient, objective.clocks(posed, normal))

    def _moved(self, objectives: Sequence[PoseObjective], poses: Sequence[Pose]) -> list[PoseObjective]:
        """The ``objectives`` with the body moving as the ``poses`` say."""
        moved = ViewSequence([each.views for each in objectives], self.period).objectives(self.body, poses)
        return [replace(each, drape=old.drape) for each, old in zip(moved, objectives, strict=True)]


@dataclass(frozen=True, slots=True, eq=False)
class _Linearised:
    """Normal equations of a frame: its images, the constraints of the body, and the hand where it set the pose."""

    normal: PoseEquations  # of the images
    hessian: Array  # (43, 43)
    gradient: Array  # (43,)
    clocks: list[ClockEquations | None]

    def after(self, step: Array, ticked: Array, pull: Array) -> _Linearised:
        """The equations after a small ``step`` (43,) of the pose, the clocks having ``ticked`` (C,), which has left the
        gradient ``pull`` (43,)."""
        clocks = [
            None if one is None else one.after(step, float(tick)) for one, tick in zip(self.clocks, ticked, strict=True)
        ]
        return replace(self, normal=self.normal.taken(), gradient=pull - self.hessian @ step, clocks=clocks)


def clocks_of(objectives: Sequence[PoseObjective]) -> Array:
    """(C,) the clocks that the views were exposed by; 0 of a camera without a view."""
    clocks = np.zeros(len(objectives[0].views))
    for each in objectives:
        for c, view in enumerate(each.views):
            if view is not None:
                clocks[c] = view.exposure.clock
    return clocks
