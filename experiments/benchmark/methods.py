"""The methods of this tree that enter the benchmark, and the tracks that they enter.

Each takes the material of one capture and gives back plain results, which are scored as anybody's are. Methods that
share most of their work, such as those of the peer bench, are run together.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np

from experiments import footage, memory
from experiments.benchmark.make import CONFIG, BenchmarkConfig
from experiments.benchmark.tracks import PEERS_EVERY, SELF_CALIBRATION_EVERY
from experiments.comparisons.ablation import trial as ablation
from experiments.comparisons.ablation.variants import Known, Variant
from experiments.comparisons.fixed_tools import LIMBS, TOOLS
from experiments.comparisons.fixed_tools.clients import installed
from experiments.comparisons.peers import bench
from experiments.comparisons.peers.material import Material, from_capture
from experiments.comparisons.self_calibration import trial as self_calibration
from experiments.comparisons.self_calibration.baselines import (
    Frames,
    Shots,
    link,
    shum_szeliski,
    sinha_pollefeys,
    wu_radke,
)
from experiments.comparisons.self_calibration.material import hall_footage, motion_footage, shots_of
from experiments.comparisons.triangulation import all_joints, triangulate, triangulated
from experiments.config import AppConfig, structured
from experiments.score import frames_of
from pzcap.export.take import Take
from pzcap.extras import reconstruct
from pzcap.extras.plain_results import body_track, results_of
from pzcap.geometry import camera as geometry
from pzcap.io import results as reconstruction_files
from pzcap.io.capture import frame_sets, read_capture
from pzcap.scoring.records import BodyTrack, CameraPoses, CameraTrack, Results
from pzcap.types import Camera, Capture, Mask, PzcapError, Reconstruction
from sim import truth as truth_files
from sim.truth import Truth

Report = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True, eq=False)
class Answered:
    """Answer of a method on one capture, with its time and memory."""

    results: Results | None  # None: it could not run
    seconds: float  # wall time of all frames; of those that are run together, CPU time of their own part
    memory_mib: float | None
    missing: str | None = None  # why it could not run


@dataclass(frozen=True, eq=False)
class Given:
    """One capture of a split, and all that was made of it."""

    job: Path  # what `make` left: capture/, truth/, given/
    config: AppConfig
    report: Report

    @cached_property
    def capture(self) -> Capture:
        """The footage."""
        return read_capture(self.job / "capture")

    @cached_property
    def shot(self) -> BenchmarkConfig:
        """Configuration that it was shot by: for the same motion, filmed otherwise."""
        tree = json.loads((self.job / CONFIG).read_text(encoding="utf-8"))
        return structured(tree, BenchmarkConfig, f"{self.job / CONFIG}")

    @cached_property
    def truth(self) -> Truth:
        """The simulator's truth: for tracks that are given some of it."""
        return truth_files.load(self.job / "truth")

    @cached_property
    def calibrated(self) -> Reconstruction:
        """Our panoramas and calibrated cameras, as they are handed out."""
        return reconstruction_files.load(self.job / "given" / "panorama")

    @cached_property
    def ours(self) -> tuple[Reconstruction, float, float]:
        """Our reconstruction, from the footage alone; seconds and MiB."""
        return _reconstructed(self.capture, self.config, self.report)

    @cached_property
    def found(self) -> ablation.Material:
        """Our cameras in every frame, and the truth, for trackers that are given some of it."""
        if self.capture.subject is None or not frame_sets(self.capture).keyframes:
            raise PzcapError("needs keyframes")
        found = replace(self.ours[0], motion=None)
        frames = frames_of(self.truth, found)[0]
        return ablation.Material(
            self.capture, self.capture.subject, frame_sets(self.capture), found, self.truth, frames
        )


@dataclass(frozen=True, slots=True)
class Method:
    """One row of the board."""

    key: str
    label: str
    tracks: tuple[str, ...]
    run: str  # of RUNS
    published: str = ""  # what its authors reached on data of their own, and where they say it
    notes: str = ""


# --------------------------------------------------------------------------------------------------------------
# Runs: capture in, the answers of one or more methods out


def _reconstructed(capture: Capture, config: AppConfig, report: Report) -> tuple[Reconstruction, float, float]:
    start = time.perf_counter()
    with memory.watched() as peak:
        found = reconstruct.reconstruct(capture, config.reconstruct, report)
    return found, time.perf_counter() - start, peak.mib


def run_ours(given: Given) -> dict[str, Answered]:
    """The whole pipeline."""
    found, seconds, mib = given.ours
    return {"ours": Answered(results_of(found), seconds, mib)}


def run_paper(given: Given) -> dict[str, Answered]:
    """The paper's own panorama, calibration and localisation (eqs. 6, 15); no body."""
    panzoom = replace(given.config.reconstruct.panzoom, method="paper")
    config = replace(given.config, reconstruct=replace(given.config.reconstruct, panzoom=panzoom))
    found, seconds, mib = _reconstructed(replace(given.capture, subject=None), config, given.report)
    return {"paper": Answered(results_of(found), seconds, mib)}


def run_peers(given: Given) -> dict[str, Answered]:
    """The peer bench: pan and focal length of each view, on our panorama and by our calibrated camera."""
    names = tuple(method.key.removeprefix("peer_") for method in METHODS if method.run == "peers")
    material = from_capture(
        given.capture, given.truth, given.job / "given" / "panorama", given.config.reconstruct.panzoom, False,
        given.report,
    )  # fmt: skip
    found = bench.run(material, names, PEERS_EVERY, given.report)
    return {f"peer_{result.name}": _of_peer(given, material, result) for result in found}


def _of_peer(given: Given, material: Material, result: bench.Result) -> Answered:
    if result.missing is not None:
        return Answered(None, 0.0, None, result.missing)
    timecodes = frame_sets(given.capture).timecodes
    names = tuple(camera.name for camera in given.capture.cameras)
    tracks = {}
    for number, name in enumerate(material.cameras):
        estimates = {a.frame: a.estimate for a in result.answers if a.camera == number and a.estimate is not None}
        camera = material.backgrounds[number].camera
        pan, instants = np.zeros(len(timecodes)), {}
        for frame, estimate in estimates.items():
            pan[frame] = estimate.pan_rad
            instants[frame] = geometry.at(camera, estimate.pan_rad, camera.tilt_rad, estimate.focal_px)
        tracks[name] = replace(_track(instants, len(timecodes)), pan_rad=pan)
    results = _results(given, result.name, tuple(tracks.get(name) for name in names))
    return Answered(results, sum(answer.seconds for answer in result.answers), None)


def run_self_calibration(given: Given) -> dict[str, Answered]:
    """The three self-calibrations on frames of the motion, and no object; Wu and Radke's has the empty hall besides."""
    frames = frame_sets(given.capture).timecodes
    names = ("shum_szeliski", "sinha_pollefeys", "wu_radke")
    tracks: dict[str, list[CameraTrack | None]] = {name: [] for name in names}
    seconds = dict.fromkeys(names, 0.0)
    motions = motion_footage(given.capture, given.truth, SELF_CALIBRATION_EVERY)
    for number, (files, motion) in enumerate(zip(given.capture.cameras, motions, strict=True)):
        given.report("self-calibrations", number, len(motions))
        filmed = shots_of(motion, False)
        runs: dict[str, Callable[[], Frames]] = {
            "shum_szeliski": partial(_mosaic, shum_szeliski, filmed),
            "sinha_pollefeys": partial(_mosaic, sinha_pollefeys, filmed),
        }
        if files.sweep is not None and files.zoom is not None:
            hall, sweep = hall_footage(files, given.truth, given.truth.camera_names.index(files.name))
            runs["wu_radke"] = partial(_by_library, shots_of(hall, False, sweep, given.capture.full_turn), filmed)
        for name in names:
            start = time.perf_counter()
            try:
                found = runs[name]() if name in runs else None
            except PzcapError:
                found = None
            seconds[name] += time.perf_counter() - start
            tracks[name].append(None if found is None else _own_track(found, motion.numbers, given, len(frames)))
    return {
        name: Answered(replace(_results(given, name, tuple(tracks[name])), own_world=True), seconds[name], None)
        for name in names
    }


def _mosaic(method: Callable[..., Frames], filmed: Shots) -> Frames:
    pairs = link(filmed)
    if not pairs:
        raise PzcapError("self-calibration: no three frames show the same")
    return method(filmed, pairs)


def _by_library(hall: Shots, filmed: Shots) -> Frames:
    calibrated, model = wu_radke(hall, link(hall))
    return self_calibration.corrected(hall, calibrated, model, filmed)


def _own_track(found: Frames, numbers: tuple[int, ...], given: Given, count: int) -> CameraTrack:
    """Frames of the truth that were found, by the frame sets of the capture."""
    timecodes = frame_sets(given.capture).timecodes
    instants = {}
    for row, number in enumerate(numbers):
        if found.valid[row]:
            log_focal, cx, cy, k1 = found.lens[row]
            pose = np.eye(4)
            pose[:3, :3] = found.rotation[row]
            at = timecodes.index(given.truth.timecodes[number])
            size = given.truth.width, given.truth.height
            instants[at] = Camera(*size, pose, float(np.exp(log_focal)), np.array([cx, cy]), float(k1))
    return _track(instants, count)


def run_triangulated(given: Given) -> dict[str, Answered]:
    """The detector's keypoints, triangulated and filtered, by our cameras and by the true ones."""
    if not any(camera.keypoints for camera in given.capture.cameras):
        missing = Answered(None, 0.0, None, "needs keypoints")
        return {"triangulated": missing, "triangulated_true_cameras": missing}
    found, seconds, mib = given.ours
    heads = zip(found.cameras, found.tracks, strict=True)
    tracks = [None if c is None or t is None else (c, t) for c, t in heads]

    def ours(frame: int) -> list[Camera | None]:
        return [
            None if one is None or not one[1].valid[frame]
            else geometry.at(one[0], one[1].pan_rad[frame], one[1].tilt_rad[frame], one[1].focal_px[frame])
            for one in tracks
        ]  # fmt: skip

    def true(frame: int) -> list[Camera | None]:
        at = given.truth.timecodes.index(found.timecodes[frame])
        return [given.truth.camera(given.truth.camera_names.index(n), at) for n in found.camera_names]

    answers = {}
    for key, cameras, spent in (("triangulated", ours, seconds), ("triangulated_true_cameras", true, 0.0)):
        start = time.perf_counter()
        body = body_track(triangulated(given.capture, cameras))
        whole = results_of(found) if cameras is ours else _results(given, key, (None,) * len(found.camera_names))
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
    keyframe[[key.frame for key in frame_sets(given.capture).keyframes]] = True
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
    found, seconds, mib = _reconstructed(capture, given.config, given.report)
    body = {"locked": None if found.motion is None else body_track(found.motion)}
    if any(camera.keypoints for camera in capture.cameras):
        body["locked_triangulated"] = body_track(triangulate(capture, found))
    nobody = (None,) * len(found.camera_names)
    return {
        key: Answered(None, 0.0, None, "found no body")
        if track is None
        else Answered(replace(_results(given, key, nobody), body=track), seconds, mib)
        for key, track in body.items()
    }


def run_trackers(given: Given) -> dict[str, Answered]:
    """Our tracker by true cameras, and by true cameras and masks."""
    answers = {}
    gifts: dict[str, tuple[Known, ...]] = {
        "tracker_true_cameras": ("cameras",), "tracker_true_cameras_masks": ("cameras", "masks")
    }  # fmt: skip
    for key, known in gifts.items():
        try:
            material = given.found
        except PzcapError as error:
            answers[key] = Answered(None, 0.0, None, str(error))
            continue
        start = time.perf_counter()
        variant = Variant(key, key, "truth", known=frozenset(known))
        motion, _ = ablation.follow(material, variant, given.config.reconstruct, given.report)
        results = _results(given, key, (None,) * len(given.capture.cameras))
        answers[key] = Answered(replace(results, body=body_track(motion)), time.perf_counter() - start, None)
    return answers


def _results(given: Given, method: str, tracks: tuple[CameraTrack | None, ...]) -> Results:
    timecodes = frame_sets(given.capture).timecodes
    names = tuple(camera.name for camera in given.capture.cameras)
    size = given.truth.width, given.truth.height
    return Results(method, given.capture.name, len(timecodes), timecodes, size, names, tracks, None)


def _track(instants: Mapping[int, Camera], count: int) -> CameraTrack:
    """A track of cameras of some frames."""
    valid, focal = np.zeros(count, bool), np.ones(count)
    poses = CameraPoses(
        np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3)), np.zeros((count, 2)), np.zeros((count, 4))
    )
    for frame, camera in instants.items():
        valid[frame], focal[frame] = True, camera.focal_px
        poses.rotation[frame], poses.position_m[frame] = camera.world_T_cam[:3, :3], camera.world_T_cam[:3, 3]
        poses.principal_px[frame] = camera.principal_px
        poses.distortion[frame] = camera.k1, camera.k2, camera.p1, camera.p2
    return CameraTrack(valid, focal, None, None, poses)


RUNS: Final[Mapping[str, Callable[[Given], dict[str, Answered]]]] = {
    "ours": run_ours,
    "paper": run_paper,
    "peers": run_peers,
    "self_calibration": run_self_calibration,
    "triangulated": run_triangulated,
    "fixed_tools": run_fixed_tools,
    "locked": run_locked,
    "trackers": run_trackers,
}

_LOCKED: Final = (
    "other footage: the same motion by cameras that stand still and have all of its way in view; cameras are not scored"
)
GIVEN_PANORAMA: Final = ("cameras_given_panorama",)
METHODS: Final[tuple[Method, ...]] = (
    Method("ours", "pzcap", ("everything", "cameras"), "ours"),
    Method(
        "paper",
        "Yamamoto's method (eqs. 6, 15)",
        ("cameras",),
        "paper",
        published="no figure: the paper shows an overlay on the calibration object (Fig. 8)",
    ),
    *(
        Method(
            f"peer_{key}",
            method.label.replace("ours", "pzcap"),
            GIVEN_PANORAMA,
            "peers",
            notes="CPU time of one thread, decoding and calibration not counted",
        )
        for key, method in bench.METHODS.items()
        if key not in ("paper", "ecc_known")  # the one has a panorama of its own, the other is given true masks
    ),
    Method("shum_szeliski", "Shum and Szeliski (2000)", ("self_calibration",), "self_calibration"),
    Method("sinha_pollefeys", "Sinha and Pollefeys (2006)", ("self_calibration",), "self_calibration"),
    Method("wu_radke", "Wu and Radke (2013)", ("self_calibration",), "self_calibration"),
    Method("triangulated", "keypoints triangulated, pzcap's cameras", ("everything",), "triangulated"),
    Method(
        "pose2sim",
        "Pose2Sim 0.10, virtual fixed cameras",
        ("everything",),
        "fixed_tools",
        published="joint angles of the legs, mean error: walking 3.0, running 4.1, cycling 4.0 deg "
        "(Pagnon et al. 2022, Sensors 22, 2712)",
        notes="triangulation and filter; virtual cameras that stand for pzcap's, keypoints carried over",
    ),
    Method(
        "aniposelib",
        "aniposelib 0.8, virtual fixed cameras",
        ("everything",),
        "fixed_tools",
        notes="triangulation alone; virtual cameras that stand for pzcap's, keypoints carried over",
    ),
    Method("locked", "pzcap, locked cameras", ("everything",), "locked", notes=_LOCKED),
    Method("locked_triangulated", "keypoints triangulated, locked cameras", ("everything",), "locked", notes=_LOCKED),
    Method("triangulated_true_cameras", "keypoints triangulated", ("body_given_cameras",), "triangulated"),
    Method("tracker_true_cameras", "pzcap's tracker", ("body_given_cameras",), "trackers"),
    Method("tracker_true_cameras_masks", "pzcap's tracker", ("body_given_cameras_masks",), "trackers"),
)
