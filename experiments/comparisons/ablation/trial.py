"""A tracker under one variant, on cameras that were localised once.

The tracker takes what `pzcap.pipeline` would give it. Where a variant says so the experiment puts the truth in place of
an estimate; the tracker does not know.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from experiments.comparisons.ablation.variants import Variant
from experiments.config import CONVERTER
from experiments.score import body_errors, frames_of
from pzcap import pipeline
from pzcap.body import skeleton
from pzcap.camera_set import calibrated_of
from pzcap.events import BodyTracked, Event, FrameLocalised, FrameSegmented, Progress
from pzcap.extras.cpu_clock import cpu_clock
from pzcap.io.capture import FrameSets, frame_sets
from pzcap.progress import Report
from pzcap.scoring.totals import body_metrics
from pzcap.tracking.tracker import Tracked, Tracker
from pzcap.types import (
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
from pzcap.views import Expecting, as_found, segment_views
from sim.people.crew import CrewConfig, keyframe_indices, pose_by_hand
from sim.scene import stream
from sim.truth import Truth

SURE_SIGMA_M: Final = 0.0005
"""Of a true length: what `sim.people.crew.measure` claims of a tape that does not err."""
SURE: Final = 8.0  # log-odds of a true mask
SEED: Final = 0  # of keyframes that the crew did not pose


Located: TypeAlias = tuple[Localisation | None, ...]
"""The views of an instant, one a camera."""


@dataclass(frozen=True, slots=True, eq=False)
class Material:
    """A capture whose cameras are found in every frame, and its truth."""

    capture: Capture
    subject: Subject
    sets: FrameSets
    found: Reconstruction  # without a motion
    second_fields: Mapping[int, Located]  # by frame, half a frame period later; none: all views are whole frames
    truth: Truth
    true_frames: NDArray[np.int64]  # (F,) index into the truth of each frame set


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """Result of a variant."""

    variant: Variant
    figures: dict[str, float | None]  # "mpjpe.mean" and so on, as the metrics under "body."
    keyframes_per_s: float
    cpu_ms: float  # of the tracker, a frame set


def prepare(capture: Capture, truth: Truth, config: pipeline.Config, report: Report) -> Material:
    """Find the cameras in every frame. PzcapError where the capture has not what a body is tracked by."""
    sets = frame_sets(capture)
    if capture.subject is None or not sets.keyframes:
        raise PzcapError(f"{capture.folder}: an ablation tracks the body; add subject.json and keyframes.json")
    second_fields: dict[int, Located] = {}

    def seen() -> Iterator[Event]:
        # without a subject nothing is tracked
        for event in pipeline.stages(replace(capture, subject=None), config):
            if isinstance(event, FrameLocalised) and event.second_fields is not None:
                second_fields[event.frames.index] = event.second_fields.localisations
            yield event

    found = pipeline.finished(seen(), report)
    return Material(capture, capture.subject, sets, found, second_fields, truth, frames_of(truth, found)[0])


def attempt(material: Material, variant: Variant, config: pipeline.Config, report: Report) -> Outcome:
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


def follow(material: Material, variant: Variant, config: pipeline.Config, report: Report) -> tuple[Motion, float]:
    """The motion under ``variant``, and the CPU seconds that it took from the videos on, localisation aside.

    It is the pipeline's own loop, whose stages are given what the variant knows.
    """
    subject = Subject(material.truth.measurements_m, SURE_SIGMA_M) if "body" in variant.known else material.subject
    body = skeleton.build(subject)
    tracking = variant.change(config.tracking)
    # no truth is known half a frame later
    by_fields = bool(material.second_fields) and tracking.second_fields and not variant.known & {"cameras", "masks"}
    tracker = Tracker(body, keyframes(material, variant), tracking, by_fields)
    tracked: list[Tracked] = []
    with ThreadPoolExecutor(config.threads) as pool:
        stages = _Stages(material, variant, config, pool)
        started = cpu_clock()
        for event in pipeline.follow(material.sets, stages.localise, stages.segment, tracker):
            match event:
                case BodyTracked(poses):
                    tracked += poses
                case Progress(_, done, total):
                    report(variant.label, done, total)
        spent = started.seconds()
    return tracker.motion(tracked), spent


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


class _Stages:
    """Stages 4 and 5 under a variant: cameras and silhouettes as the pipeline has them, but for what it knows."""

    def __init__(self, material: Material, variant: Variant, config: pipeline.Config, pool: ThreadPoolExecutor) -> None:
        self._material, self._variant, self._config, self._pool = material, variant, config, pool
        self._cameras = calibrated_of(material.found)

    def localise(self, frames: FrameSet, tracker: Expecting | None) -> FrameLocalised:
        """The views where they were found, shaken where the variant says so."""
        del tracker
        found = tuple(self._located(c, frames.index) for c in range(len(frames.images)))
        later = self._material.second_fields.get(frames.index)
        shaken = None if later is None else tuple(self._shaken(c, frames.index, one) for c, one in enumerate(later))
        return as_found(self._material.found.cameras, frames, found, shaken)

    def _located(self, camera: int, frame: int) -> Localisation | None:
        track, none = self._material.found.tracks[camera], np.empty((0, 2))
        if track is None or not track.valid[frame]:
            return None
        place = float(track.pan_rad[frame]), float(track.tilt_rad[frame]), float(track.focal_px[frame])
        found = Localisation(
            *place, track.covariance[frame], True, none, none, float(track.roll_rad[frame]),
            shear=track.shear[frame] if len(track.shear) else np.zeros(2),
            readout=float(track.readout[frame]) if len(track.readout) else 0.0,
        )  # fmt: skip
        return self._shaken(camera, frame, found)

    def _shaken(self, camera: int, frame: int, found: Localisation | None) -> Localisation | None:
        """The view with the variant's error in its pan: both fields of a frame have the same."""
        if found is None:
            return None
        shaken_rad = np.deg2rad(self._variant.shaken_deg)
        pan_rad = found.pan_rad + shaken_rad * stream(SEED, "shaken", camera, frame).standard_normal()
        return replace(found, pan_rad=pan_rad, covariance=found.covariance + np.diag([shaken_rad**2, 0.0]))

    def segment(self, seen: FrameLocalised, tracker: Expecting | None) -> FrameSegmented:
        """The silhouettes; masks and cameras true where the variant knows them."""
        variant, truth = self._variant, self._material.truth
        expecting = tracker if variant.expected else None
        silhouettes = replace(self._config.foreground, others=variant.others)
        cut = segment_views(self._cameras, silhouettes, self._config.panzoom, self._pool, seen, expecting)
        if not variant.corrected:
            cut = replace(cut, priors=(None,) * len(cut.cameras))
        at = int(self._material.true_frames[seen.frames.index])
        names = self._material.found.camera_names
        here = [None if one is None else truth.camera_names.index(name) for one, name in zip(cut.cameras, names)]  # noqa: B905
        if "masks" in variant.known:
            masks = (None if c is None else true_silhouette(truth.mask(c, at)) for c in here)
            cut = replace(cut, silhouettes=tuple(masks))
        if "cameras" in variant.known:
            true = tuple(None if c is None else truth.camera(c, at) for c in here)
            cut = replace(cut, cameras=true, priors=(None,) * len(here))
        return cut


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
