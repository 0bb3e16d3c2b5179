"""Methods that find the body: ours, keypoints triangulated, tools for fixed cameras, our tracker with truth given."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from experiments import footage
from experiments.benchmark.methods.given import Answered, Given, attempted, reconstructed
from experiments.comparisons.ablation import trial as ablation
from experiments.comparisons.ablation.variants import Known, Variant
from experiments.comparisons.fixed_tools import LIMBS, TOOLS
from experiments.comparisons.fixed_tools.clients import installed
from experiments.comparisons.triangulation import all_joints, cameras_at, triangulate, triangulated
from experiments.score import frames_of
from pzcap.export.tables import body_track, results_of
from pzcap.export.take import Take
from pzcap.io.capture import read_capture
from pzcap.scoring.records import BodyTrack
from pzcap.types import Camera, Mask, PzcapError, Reconstruction, Subject
from sim import truth as truth_files


def run_ours(given: Given) -> dict[str, Answered]:
    """The whole pipeline."""
    found, seconds, mib = given.ours
    return {"ours": Answered(results_of(found), seconds, mib)}


def run_triangulated(given: Given) -> dict[str, Answered]:
    """The detector's keypoints, triangulated and filtered, by our cameras and by the true ones."""
    if not any(camera.keypoints for camera in given.capture.cameras):
        missing = Answered(None, 0.0, None, "needs keypoints")
        return {"triangulated": missing, "triangulated_true_cameras": missing}
    return {
        "triangulated": attempted(partial(_triangulated, given)),
        "triangulated_true_cameras": attempted(partial(_triangulated_by_truth, given)),
    }


def _triangulated(given: Given) -> Answered:
    found, seconds, mib = given.ours
    start = time.perf_counter()
    body = body_track(triangulated(given.capture, partial(cameras_at, found)))
    results = replace(results_of(found), method="triangulated", body=body)
    return Answered(results, seconds + time.perf_counter() - start, mib)


def _triangulated_by_truth(given: Given) -> Answered:
    names = [given.truth.camera_names.index(camera.name) for camera in given.capture.cameras]

    def true(frame: int) -> list[Camera | None]:
        at = given.truth.timecodes.index(given.sets.timecodes[frame])
        return [given.truth.camera(name, at) for name in names]

    start = time.perf_counter()
    body = body_track(triangulated(given.capture, true))
    results = replace(given.results("triangulated_true_cameras"), body=body)
    return Answered(results, time.perf_counter() - start, None)


def run_fixed_tools(given: Given) -> dict[str, Answered]:
    """Tools for fixed cameras, on the keypoints carried over to virtual ones that stand for ours."""
    subject = given.capture.subject
    if subject is None or not any(camera.keypoints for camera in given.capture.cameras):
        return {tool: Answered(None, 0.0, None, "needs keypoints and measurements") for tool in TOOLS}
    return {tool: attempted(partial(_by_tool, given, subject, tool)) for tool in TOOLS}


def _by_tool(given: Given, subject: Subject, tool: str) -> Answered:
    if not installed(tool):
        return Answered(None, 0.0, None, "needs its own environment: make test-clients")
    found, seconds, mib = given.ours
    keyframe = np.zeros(len(found.timecodes), bool)
    keyframe[[key.frame for key in given.sets.keyframes]] = True
    start = time.perf_counter()
    with TemporaryDirectory() as work:
        places = TOOLS[tool](Take(found, given.capture), Path(work))
    joints = all_joints({name: places[:, k] for k, name in enumerate(LIMBS)}, subject)
    known: Mask = np.all(np.isfinite(joints), axis=2)
    results = replace(results_of(found), method=tool, body=BodyTrack(np.nan_to_num(joints), known, None, keyframe))
    return Answered(results, seconds + time.perf_counter() - start, mib)


def run_locked(given: Given) -> dict[str, Answered]:
    """The same motion, filmed by cameras that stand still and have all of its way in view: what panning is worth."""
    shoot = given.shot.shoot
    config = replace(shoot, operator=replace(shoot.operator, moves="none"))
    shot = footage.shot(config, Path(given.shot.output.captures), given.report, given.shot.output.light_gb)
    if not np.array_equal(truth_files.load(shot / "truth").joints_m, given.truth.joints_m):
        raise PzcapError(f"{shot}: another motion than that of {given.job}; make the split again")
    capture = replace(read_capture(shot / "capture"), keyframe_poses=given.capture.keyframe_poses)
    found, seconds, mib = reconstructed(capture, given.config, given.report)

    def answer(key: str, body: Callable[[], BodyTrack]) -> Answered:
        return attempted(lambda: Answered(replace(given.results(key), body=body()), seconds, mib))

    return {
        "locked": answer("locked", lambda: _own_body(found)),
        "locked_triangulated": answer("locked_triangulated", lambda: body_track(triangulate(capture, found))),
    }


def _own_body(found: Reconstruction) -> BodyTrack:
    if found.motion is None:
        raise PzcapError("found no body")
    return body_track(found.motion)


def run_trackers(given: Given) -> dict[str, Answered]:
    """Our tracker by true cameras, and by true cameras and masks."""
    gifts: dict[str, tuple[Known, ...]] = {
        "tracker_true_cameras": ("cameras",), "tracker_true_cameras_masks": ("cameras", "masks")
    }  # fmt: skip
    subject = given.capture.subject
    if subject is None or not given.sets.keyframes:
        return {key: Answered(None, 0.0, None, "needs keyframes") for key in gifts}
    found = replace(given.ours[0], motion=None)
    frames = frames_of(given.truth, found)[0]
    material = ablation.Material(given.capture, subject, given.sets, found, {}, given.truth, frames)

    def answer(key: str, known: tuple[Known, ...]) -> Answered:
        start = time.perf_counter()
        variant = Variant(key, key, "truth", known=frozenset(known))
        motion, _ = ablation.follow(material, variant, given.config.reconstruct, given.report)
        return Answered(replace(given.results(key), body=body_track(motion)), time.perf_counter() - start, None)

    return {key: attempted(partial(answer, key, known)) for key, known in gifts.items()}
