"""The clip of `tests.scenes.body_scene` as the tracker is given it: views, a taped body and keyframes set by hand."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import cache

import cv2
import numpy as np

from pzcap.body import kinematics
from pzcap.body import skeleton as bodies
from pzcap.body.skeleton import LIMBS, Body
from pzcap.segmentation import foreground
from pzcap.tracking.frame_tracker import NO_CONTOUR, FrameEstimate
from pzcap.tracking.observation import ViewCrop, prepare
from pzcap.tracking.pose_objective import PoseObjective
from pzcap.tracking.settings import Terms, TrackingConfig
from pzcap.tracking.skin_appearance import Appearance, learn
from pzcap.tracking.skin_colour_model import UNKNOWN
from pzcap.tracking.tracker import Tracked, Tracker, TrackInput, ViewInput
from pzcap.types import DOF, Array, Image, Keyframe, Pose, Subject
from tests.scenes.body_scene import HEIGHT, WIDTH, Clip, shoot

FRAMES = 13
CONFIG = TrackingConfig()
TERMS = Terms(0, 5.0, 1.0, 12.0, 1.0, 1.0, 0.15)


@cache
def clip() -> Clip:
    """Thirteen frames of `body_scene.swing`, rendered once."""
    return shoot(FRAMES)


@cache
def taped() -> Body:
    """The body as a tape measures it: each measurement off by 4 mm."""
    rng = np.random.default_rng(7)
    return bodies.build(Subject({k: v + rng.normal(0, 0.004) for k, v in clip().measurements_m.items()}, 0.004))


@cache
def inputs() -> tuple[TrackInput, ...]:
    return inputs_of(clip())


def inputs_of(filmed: Clip) -> tuple[TrackInput, ...]:
    """What the tracker is given of a clip."""
    settings = foreground.ForegroundConfig()
    rows = []
    for frame, row in enumerate(filmed.shots):
        views = []
        for shot in row:
            known = np.ones(shot.mask.shape, bool)
            silhouette = foreground.subtract(shot.image, shot.empty, known, shot.camera, 0.0, settings)
            views.append(ViewInput(shot.image, shot.camera, silhouette))
        rows.append(TrackInput(frame, tuple(views)))
    return tuple(rows)


def as_fields(items: Iterable[TrackInput]) -> list[TrackInput]:
    """The instants as if they were the fields of interlaced frames, two a frame."""
    return [TrackInput(item.frame // 2, item.views, bool(item.frame % 2)) for item in items]


def by_hand(frame: int, seed: int = 0) -> Keyframe:
    """The true pose with a hand's error: 10 mm along each axis, 3 degrees of each degree of freedom."""
    rng = np.random.default_rng(100 * seed + frame)
    error = np.concatenate([rng.normal(0, 0.010, 3), rng.normal(0, np.deg2rad(3.0), DOF - 3)])
    return Keyframe(frame, kinematics.retract(clip().poses[frame], error))


def errors_m(results: list[Tracked]) -> Array:
    """Distance (N, 16) of the joints from the truth."""
    return np.array([np.linalg.norm(r.joints_m - clip().joints_m[r.frame], axis=1) for r in results])


def track(
    body: Body, keyframes: Sequence[Keyframe], inputs: Iterable[TrackInput], config: TrackingConfig
) -> Iterator[Tracked]:
    """Track the body through ``inputs``, in the order of their frames: a result each, in that order. See `Tracker`."""
    tracker = Tracker(body, keyframes, config)
    for item in inputs:
        yield from tracker.push(item)
    yield from tracker.finish()


def run(keyframes: list[Keyframe], items: tuple[TrackInput, ...] | list[TrackInput]) -> list[Tracked]:
    """Track ``items`` with the taped body from ``keyframes``."""
    return list(track(taped(), keyframes, items, CONFIG))


def crops(frame: int) -> list[ViewCrop | None]:
    """The views whole, with their true masks."""
    rows: list[ViewCrop | None] = []
    for shot in clip().shots[frame]:
        mask = (255 * shot.mask).astype(np.uint8)
        belief = cv2.resize(
            2.0 * shot.mask.astype(np.float32) - 1.0, (WIDTH // 4, HEIGHT // 4), interpolation=cv2.INTER_AREA
        )
        rows.append(prepare(shot.image, mask, unknown(mask), belief, shot.camera, (0, 0)))
    return rows


def unknown(silhouette: Image) -> Image:
    """Likelihood of arms where their colours are not known."""
    return np.full(silhouette.shape, UNKNOWN)


def observed(frame: int, body: Body) -> PoseObjective:
    return PoseObjective(body, crops(frame))


def true_body() -> Body:
    """The body of the true measurements."""
    return bodies.build(Subject(clip().measurements_m, 0.001))


def lost(pose: Pose, dof: int, by: float) -> Pose:
    """``pose`` with one degree of freedom changed."""
    delta = np.zeros(DOF)
    delta[dof] = by
    return kinematics.retract(pose, delta)


def step(pose: Pose) -> FrameEstimate:
    nothing = np.zeros(DOF)
    return FrameEstimate(pose, np.diag(nothing), NO_CONTOUR, True, nothing, [], 0.0, np.ones(16))


def without_score(_pass: int, _frame: int) -> Array:
    """The images tell no limb from another."""
    return np.zeros(4)


def swung(pose: Pose, limb: int, by: float) -> Pose:
    return lost(pose, int(np.flatnonzero(LIMBS[limb][0] == bodies.DOF_SEGMENT)[1]), by)


def known(frames: range = range(2, 5)) -> list[Appearance]:
    """Appearance of the skin in each view, learned in these frames from the true poses."""
    body = true_body()
    looks = [Appearance.unseen(body) for _ in crops(0)]
    for frame in frames:
        objective = observed(frame, body)
        learn(objective.views, objective.place(clip().poses[frame])[1], looks, 0.5)
    return looks
