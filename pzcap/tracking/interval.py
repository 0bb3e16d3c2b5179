"""Records of the frames between two keyframes: the problem that the worker process gets, the result that it gives
back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pzcap.body.shape_estimation import Shape
from pzcap.solver.gauss_newton import SolveReport
from pzcap.tracking.body_estimate import BodyEstimate
from pzcap.tracking.camera_refinement import Correction
from pzcap.tracking.frame_tracker import FrameEstimate, PoseEstimate
from pzcap.tracking.observation import Views
from pzcap.tracking.pixel_time import ClockEstimate
from pzcap.tracking.settings import TrackingConfig
from pzcap.tracking.skin_appearance import Appearances
from pzcap.types import Array, Keyframe, Pose


@dataclass(frozen=True, slots=True, eq=False)
class Tracked:
    """The body at one instant."""

    frame: int
    pose: Pose
    joints_m: Array  # (16, 3)
    sigma_m: Array  # (16,)
    valid: bool
    shape: Shape  # of the body that was tracked
    corrections: tuple[Correction | None, ...]  # of the cameras, one a view; empty: not solved with other frames
    lost: float = 0.0  # probability that the body as a whole is not where it was found, see `lost`


@dataclass(frozen=True, slots=True, eq=False)
class Instant:
    """An instant after a keyframe, as the forward pass has it."""

    frame: int
    views: Views
    forward: FrameEstimate
    second_field: bool = False  # half a frame period after the frame


@dataclass(frozen=True, slots=True, eq=False)
class Anchor:
    """A keyframe, fitted to its images."""

    key: Keyframe
    views: Views
    fit: PoseEstimate
    velocity: Array  # (43,) with which the forward pass arrives at it
    rates: Array  # (16, 12) the same of the segments, as in `pixel_time.rates_between`


@dataclass(frozen=True, slots=True, eq=False)
class IntervalProblem:
    """The instants between two keyframes, for `solved`."""

    estimate: BodyEstimate
    clocks: ClockEstimate
    before: Sequence[Pose]  # of up to two frames before the first of them
    instants: Sequence[Instant]
    reference: Appearances  # of the skin beside the keyframe that the interval began with, a view each
    anchor: Anchor | None  # the keyframe that ends them; None: none does
    config: TrackingConfig
    period: float  # frame periods from an instant to the next


@dataclass(frozen=True, slots=True, eq=False)
class IntervalResult:
    """The solution of an `IntervalProblem`."""

    tracked: list[Tracked]  # the frames, and the keyframe that ends them
    estimate: BodyEstimate
    clocks: ClockEstimate
    before: Sequence[Pose]  # of the last two frames
    report: SolveReport
