"""Methods that find cameras and no body: the paper's, the peers', the self-calibrations."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np

from experiments.benchmark.methods.given import Answered, Given, reconstructed
from experiments.benchmark.tracks import PEERS_EVERY, SELF_CALIBRATION_EVERY
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
from pzcap.export.tables import results_of
from pzcap.geometry import camera as geometry
from pzcap.scoring.readers.instants import Instant, track
from pzcap.scoring.records import CameraTrack
from pzcap.types import PzcapError

PEERS: Final = tuple(name for name in bench.METHODS if name not in ("paper", "ecc_known"))
"""Of the peer bench; the one has a panorama of its own, the other is given true masks."""


def run_paper(given: Given) -> dict[str, Answered]:
    """The paper's own panorama, calibration and localisation (eqs. 6, 15); no body."""
    panzoom = replace(given.config.reconstruct.panzoom, method="paper")
    config = replace(given.config, reconstruct=replace(given.config.reconstruct, panzoom=panzoom))
    found, seconds, mib = reconstructed(replace(given.capture, subject=None), config, given.report)
    return {"paper": Answered(results_of(found), seconds, mib)}


def run_peers(given: Given) -> dict[str, Answered]:
    """The peer bench: pan and focal length of each view, on our panorama and by our calibrated camera."""
    material = from_capture(
        given.capture, given.truth, given.job / "given" / "panorama", given.config.reconstruct.panzoom, False,
        given.report,
    )  # fmt: skip
    found = bench.run(material, PEERS, PEERS_EVERY, given.report)
    return {f"peer_{result.name}": _of_peer(given, material, result) for result in found}


def _of_peer(given: Given, material: Material, result: bench.Result) -> Answered:
    if result.missing is not None:
        return Answered(None, 0.0, None, result.missing)
    timecodes = given.sets.timecodes
    names = tuple(camera.name for camera in given.capture.cameras)
    tracks = {}
    for number, name in enumerate(material.cameras):
        estimates = {a.frame: a.estimate for a in result.answers if a.camera == number and a.estimate is not None}
        camera = material.backgrounds[number].camera
        pan, instants = np.zeros(len(timecodes)), {}
        for frame, estimate in estimates.items():
            pan[frame] = estimate.pan_rad
            at = geometry.at(camera, estimate.pan_rad, camera.tilt_rad, estimate.focal_px)
            distortion = np.array([at.k1, at.k2, at.p1, at.p2])
            pose = at.world_T_cam
            instants[frame] = Instant(pose[:3, :3], pose[:3, 3], at.focal_px, at.principal_px, distortion)
        tracks[name] = replace(track(instants, len(timecodes)), pan_rad=pan)
    results = given.results(result.name, tuple(tracks.get(name) for name in names))
    return Answered(results, sum(answer.seconds for answer in result.answers), None)


def run_self_calibration(given: Given) -> dict[str, Answered]:
    """The three self-calibrations on frames of the motion, and no object; Wu and Radke's has the empty hall besides."""
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
            tracks[name].append(None if found is None else _own_track(found, motion.numbers, given))
    return {
        name: Answered(replace(given.results(name, tuple(tracks[name])), own_world=True), seconds[name], None)
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


def _own_track(found: Frames, numbers: tuple[int, ...], given: Given) -> CameraTrack:
    """Frames of the truth that were found, by the frame sets of the capture."""
    timecodes = given.sets.timecodes
    instants = {}
    for row, number in enumerate(numbers):
        if found.valid[row]:
            log_focal, cx, cy, k1 = found.lens[row]
            at = timecodes.index(given.truth.timecodes[number])
            lens = float(np.exp(log_focal)), np.array([cx, cy]), np.array([k1, 0.0, 0.0, 0.0])
            instants[at] = Instant(found.rotation[row], np.zeros(3), *lens)
    return track(instants, len(timecodes))
