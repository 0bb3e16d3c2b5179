"""A tracker under one variant, on cameras that were prepared once.

The tracker takes what `pzcap.pipeline` would give it. Where a variant says so the experiment puts the truth in place of
an estimate; the tracker does not know.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from experiments.comparisons.ablation.variants import Variant
from experiments.config import CONVERTER
from experiments.score import body_errors, frames_of
from experiments.totals import body_metrics
from pzcap import pipeline
from pzcap.body import skeleton
from pzcap.geometry import camera
from pzcap.io.capture import FrameSets, frame_sets
from pzcap.io.detections import NOBODY
from pzcap.segmentation import foreground
from pzcap.tracking.camera_refinement import camera_prior
from pzcap.tracking.tracker import Tracked, Tracker, TrackInput, ViewInput
from pzcap.types import (
    Camera,
    Capture,
    FrameSet,
    Keyframe,
    Localisation,
    Mask,
    Motion,
    Pose,
    PzcapError,
    Reconstruction,
    Silhouette,
    Subject,
)
from sim.people.crew import CrewConfig, keyframe_indices, pose_by_hand
from sim.scene import stream
from sim.truth import Truth

SURE_SIGMA_M: Final = 0.0005
"""Of a true length: what `sim.people.crew.measure` claims of a tape that does not err."""
SURE: Final = 8.0  # log-odds of a true mask
SEED: Final = 0  # of keyframes that the crew did not pose


@dataclass(frozen=True, slots=True, eq=False)
class Material:
    """A capture whose cameras are found in every frame, and its truth."""

    capture: Capture
    subject: Subject
    sets: FrameSets
    found: Reconstruction  # without a motion
    truth: Truth
    true_frames: NDArray[np.int64]  # (F,) index into the truth of each frame set


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What came of a variant."""

    variant: Variant
    figures: dict[str, float | None]  # "mpjpe.mean" and so on, as the metrics under "body."
    keyframes_per_s: float
    cpu_ms: float  # of the tracker, a frame set


def prepare(
    capture: Capture, truth: Truth, config: pipeline.Config, report: Callable[[str, int, int], None]
) -> Material:
    """Find the cameras in every frame. PzcapError where the capture has not what a body is tracked by."""
    sets = frame_sets(capture)
    if capture.subject is None or not sets.keyframes:
        raise PzcapError(f"{capture.folder}: an ablation tracks the body; add subject.json and keyframes.json")
    # without a subject nothing is tracked
    found = pipeline.reconstruct(replace(capture, subject=None), config, report)
    return Material(capture, capture.subject, sets, found, truth, frames_of(truth, found)[0])


def attempt(
    material: Material, variant: Variant, config: pipeline.Config, report: Callable[[str, int, int], None]
) -> Outcome:
    """Track the body under ``variant``, and score it where neither the variant nor the default has a keyframe."""
    motion, seconds = follow(material, variant, config, report)
    errors = body_errors(motion, material.truth, material.true_frames)
    by_default = np.isin(np.arange(len(material.sets)), [key.frame for key in material.sets.keyframes])
    found = body_metrics(replace(errors, keyframe=errors.keyframe | by_default))
    return Outcome(
        variant,
        {metric.key.removeprefix("body."): metric.value for metric in found},
        len(motion.keyframes) * float(material.capture.frame_rate) / len(material.sets),
        1000.0 * seconds / len(material.sets),
    )


def follow(
    material: Material, variant: Variant, config: pipeline.Config, report: Callable[[str, int, int], None]
) -> tuple[Motion, float]:
    """The motion under ``variant``, and the CPU seconds that it took from the videos on, cameras aside."""
    keys = keyframes(material, variant)
    subject = material.subject
    if "body" in variant.known:
        subject = Subject(material.truth.measurements_m, SURE_SIGMA_M)
    rate = float(material.capture.frame_rate)
    tracker = Tracker(skeleton.build(subject), keys, rate, variant.change(config.tracking))
    tracked: list[Tracked] = []
    started = time.process_time()  # the tracker has a thread of its own
    for frames in material.sets:
        views = tuple(_view(material, frames, number, variant, config, tracker) for number in range(len(frames.images)))
        tracked += tracker.push(TrackInput(frames.index, views))
        report(variant.label, frames.index + 1, len(material.sets))
    tracked += tracker.finish()
    return tracker.motion(tracked), time.process_time() - started


def keyframes(material: Material, variant: Variant) -> list[Keyframe]:
    """Those of the capture that are chosen, and those posed besides by a hand as good as the crew's; where they are
    known, the true poses in the same frames."""
    given, crew = material.sets.keyframes, CONVERTER.structure(json.loads(material.truth.config)["crew"], CrewConfig)
    poses = {given[i].frame: given[i].pose for i in variant.chosen(len(given))}
    if variant.posed_per_s:
        often, hand = replace(crew, keyframes_per_s=variant.posed_per_s), stream(SEED, "more keyframes")
        for frame in keyframe_indices(len(material.sets), float(material.capture.frame_rate), often):
            poses.setdefault(frame, pose_by_hand(_true_pose(material, frame), crew, hand))
    if "keyframes" in variant.known:
        poses = {frame: _true_pose(material, frame) for frame in poses}
    return [Keyframe(frame, poses[frame]) for frame in sorted(poses)]


def _view(
    material: Material,
    frames: FrameSet,
    number: int,
    variant: Variant,
    config: pipeline.Config,
    tracker: Tracker,
) -> ViewInput | None:
    """What the tracker is given of one camera, as `pzcap.pipeline` has it but for what the ``variant`` knows."""
    found, truth = material.found, material.truth
    head, panorama, track = found.cameras[number], found.panoramas[number], found.tracks[number]
    image, frame = frames.images[number], frames.index
    if head is None or panorama is None or track is None or image is None or not track.valid[frame]:
        return None
    here = truth.camera_names.index(found.camera_names[number]), int(material.true_frames[frame])
    shaken_rad, covariance = np.deg2rad(variant.shaken_deg), track.covariance[frame]
    pan_rad = float(track.pan_rad[frame]) + shaken_rad * stream(SEED, "shaken", number, frame).standard_normal()
    covariance = covariance + np.diag([shaken_rad**2, 0.0])
    aim = pan_rad, float(track.tilt_rad[frame]), float(track.focal_px[frame])
    none = np.empty((0, 2))
    located = Localisation(*aim, covariance, True, none, none)
    if "masks" in variant.known:
        silhouette = true_silhouette(truth.mask(*here))
    else:
        expected = tracker.expect(frame, camera.at(head, *aim)) if variant.expected else None
        silhouette = foreground.separate(image, panorama, head, located, config.foreground, expected)
    people = frames.keypoints[number] if frames.keypoints else NOBODY
    if "cameras" in variant.known:
        return ViewInput(image, true_camera(truth, *here), silhouette, people)
    known = camera_prior(config.panzoom, head, located) if variant.corrected else None
    return ViewInput(image, camera.at(head, *aim), silhouette, people, known)


def true_camera(truth: Truth, number: int, frame: int) -> Camera:
    return Camera(
        truth.width, truth.height, truth.world_T_cam[number, frame], float(truth.focal_px[number, frame]),
        truth.principal_px[number, frame], float(truth.k1[number, frame]),
    )  # fmt: skip


def true_silhouette(mask: Mask) -> Silhouette:
    """The true ``mask`` (H, W) as a silhouette that is sure of it; the hall behind it is nothing to the tracker."""
    height, width = mask.shape
    evidence = np.where(mask[: height // 2 * 2 : 2, : width // 2 * 2 : 2], np.float32(SURE), np.float32(-SURE))
    return Silhouette(
        np.where(mask, np.uint8(255), np.uint8(0)), np.zeros((height, width, 3), np.uint8), evidence, True
    )


def _true_pose(material: Material, frame: int) -> Pose:
    at = material.true_frames[frame]
    return Pose(material.truth.root_position_m[at], material.truth.rotations[at])
