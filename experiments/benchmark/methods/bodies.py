"""Methods that find the body: ours, keypoints triangulated, tools for fixed cameras, our tracker with truth given."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from experiments import footage
from experiments.benchmark.methods.given import Answered, Given, reconstructed
from experiments.comparisons.ablation import trial as ablation
from experiments.comparisons.ablation.variants import Known, Variant
from experiments.comparisons.fixed_tools import LIMBS, TOOLS
from experiments.comparisons.fixed_tools.clients import installed
from experiments.comparisons.triangulation import all_joints, cameras_at, triangulate, triangulated
from experiments.score import frames_of
from pzcap.export.take import Take
from pzcap.extras.plain_results import body_track, results_of
from pzcap.io.capture import read_capture
from pzcap.scoring.records import BodyTrack
from pzcap.types import Camera, Mask, PzcapError
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
    found, seconds, mib = given.ours
    ours = partial(cameras_at, found)

    def true(frame: int) -> list[Camera | None]:
        at = given.truth.timecodes.index(found.timecodes[frame])
        return [given.truth.camera(given.truth.camera_names.index(n), at) for n in found.camera_names]

    answers = {}
    for key, cameras, spent in (("triangulated", ours, seconds), ("triangulated_true_cameras", true, 0.0)):
        start = time.perf_counter()
        body = body_track(triangulated(given.capture, cameras))
        whole = results_of(found) if cameras is ours else given.results(key)
        answers[key] = Answered(
            replace(whole, method=key, body=body), spent + time.perf_counter() - start, mib if cameras is ours else None
        )
    return answers


def run_fixed_tools(given: Given) -> dict[str, Answered]:
    """Tools for fixed cameras, on the keypoints carried over to virtual ones that stand for ours."""
    subject = given.capture.subject
    if subject is None or not any(camera.keypoints for camera in given.capture.cameras):
        return {tool: Answered(None, 0.0, None, "needs keypoints and measurements") for tool in TOOLS}
    found, seconds, mib = given.ours
    keyframe = np.zeros(len(found.timecodes), bool)
    keyframe[[key.frame for key in given.sets.keyframes]] = True
    answers = {}
    for tool, triangulation in TOOLS.items():
        if not installed(tool):
            answers[tool] = Answered(None, 0.0, None, "needs its own environment: make test-clients")
            continue
        start = time.perf_counter()
        try:
            with TemporaryDirectory() as work:
                places = triangulation(Take(found, given.capture), Path(work))
        except PzcapError as error:  # of this tool: the other may do it
            answers[tool] = Answered(None, 0.0, None, str(error))
            continue
        joints = all_joints({name: places[:, k] for k, name in enumerate(LIMBS)}, subject)
        known: Mask = np.all(np.isfinite(joints), axis=2)
        results = replace(results_of(found), method=tool, body=BodyTrack(np.nan_to_num(joints), known, None, keyframe))
        answers[tool] = Answered(results, seconds + time.perf_counter() - start, mib)
    return answers


def run_locked(given: Given) -> dict[str, Answered]:
    """The same motion, filmed by cameras that stand still and have all of its way in view: what panning is worth."""
    shoot = given.shot.shoot
    config = replace(shoot, operator=replace(shoot.operator, moves="none"))
    shot = footage.shot(config, Path(given.shot.output.captures), given.report, given.shot.output.light_gb)
    if not np.array_equal(truth_files.load(shot / "truth").joints_m, given.truth.joints_m):
        raise PzcapError(f"{shot}: another motion than that of {given.job}; make the split again")
    capture = replace(read_capture(shot / "capture"), keyframe_poses=given.capture.keyframe_poses)
    found, seconds, mib = reconstructed(capture, given.config, given.report)
    body = {"locked": None if found.motion is None else body_track(found.motion)}
    if any(camera.keypoints for camera in capture.cameras):
        body["locked_triangulated"] = body_track(triangulate(capture, found))
    return {
        key: Answered(None, 0.0, None, "found no body")
        if track is None
        else Answered(replace(given.results(key), body=track), seconds, mib)
        for key, track in body.items()
    }


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
    answers = {}
    for key, known in gifts.items():
        start = time.perf_counter()
        variant = Variant(key, key, "truth", known=frozenset(known))
        motion, _ = ablation.follow(material, variant, given.config.reconstruct, given.report)
        answered = replace(given.results(key), body=body_track(motion))
        answers[key] = Answered(answered, time.perf_counter() - start, None)
    return answers
