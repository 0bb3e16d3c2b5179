"""Keyframes by a hand, by simulated detectors and by a real one, on the same footage.

    python -m experiments.compare detectors seed=0
    python -m experiments.compare detectors capture=CAPTURE  # with the truth beside it

The simulated detectors are the kind one that every shoot can have (experiment=no_hand) and one that errs like a real
one (experiment=harsh_detector). The real one is BlazePose over the rendered videos, whose weights come inside the
package mediapipe; where that is not installed its row says so. Beside the joints stands what the keypoints are like:
how often somebody is found in a picture, how far off on the body the joints are, and in how many pictures every left is
a right. Nobody poses a keyframe but in the first row. Where the real detector ran, its keypoints are left in the folder
of the results, and blazepose.json holds those of a few frames with the cameras (tests/scenes/blazepose.json is one).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from omegaconf import OmegaConf
from rich.console import Console

from experiments.comparisons.fixed_tools import LIMBS
from experiments.comparisons.harness import (
    COVERED,
    LOST,
    MEAN,
    P95,
    Column,
    Comparison,
    Row,
    body,
    labelled,
    scored_capture,
    without_keypoints,
)
from experiments.config import AppConfig
from experiments.progress import Bars
from experiments.run import CONF
from pzcap.extras.detectors import coco_results, detector
from pzcap.extras.reconstruct import reconstruct
from pzcap.geometry.camera import of_track, project
from pzcap.io.capture import frame_sets
from pzcap.io.detections import KEYPOINTS
from pzcap.io.files import written_whole
from pzcap.io.video import VideoReader
from pzcap.progress import Report
from pzcap.types import JOINTS, Array, Capture, PzcapError, Reconstruction
from sim.people.detector import DetectorConfig
from sim.session import ShootConfig
from sim.truth import Truth

SAMPLE: Final = "blazepose.json"
_SAMPLED: Final = 12
"""Instants in the sample."""
_KEYPOINT: Final = np.array([KEYPOINTS.index(name) for name in LIMBS])
_JOINT: Final = np.array([JOINTS.index(name) for name in LIMBS])
_OTHER_SIDE: Final = np.roll(np.arange(len(LIMBS)), len(LIMBS) // 2)


def compare(config: AppConfig, folder: Path, console: Console) -> Sequence[Row[Any]]:
    """Each detector in turn. Raises PzcapError where the capture has nothing to compare."""
    rows: list[Row[Any]] = []
    cameras: Reconstruction | None = None
    with Bars(console) as bars:
        for key, label, group, shoot in _shoots(config):
            capture, truth = scored_capture(config if shoot is None else replace(config, shoot=shoot), bars.update)
            capture = without_keypoints(capture) if key == "hand" else replace(capture, keyframe_poses={})
            row, cameras = _row((key, label, group), capture, truth, config, cameras, bars.update)
            rows.append(row)
        capture = replace(capture, keyframe_poses={})
        try:
            real = _detected(capture, folder, bars.update)
        except PzcapError as error:
            return [*rows, Row("blazepose", "BlazePose", {}, "real", str(error))]
        row, cameras = _row(("blazepose", "BlazePose", "real"), real, truth, config, cameras, bars.update)
        with written_whole(folder / SAMPLE) as partial:
            partial.write_text(json.dumps(sample(real, truth, cameras), separators=(",", ":")) + "\n", encoding="utf-8")
    return [*rows, row]


def _shoots(config: AppConfig) -> list[tuple[str, str, str, ShootConfig | None]]:
    """Rows before the real detector: key, label, group, and what is shot for each; None: what is there."""
    if config.capture is not None:
        return [("hand", "keyframes by hand", "hand", None), ("own", "the capture's keypoints", "simulated", None)]
    shoot = config.shoot
    harsh: dict[str, Any] = OmegaConf.to_container(  # type: ignore[assignment]
        OmegaConf.load(CONF / "experiment" / "harsh_detector.yaml").shoot.detector
    )
    by_hand = replace(shoot, crew=replace(shoot.crew, keyframes="hand"), detector=DetectorConfig())
    none = replace(shoot, crew=replace(shoot.crew, keyframes="none"))
    kind = replace(none, detector=DetectorConfig(enabled=True))
    return [
        ("hand", "keyframes by hand", "hand", by_hand),
        ("kind", "simulated, kind", "simulated", kind),
        ("harsh", "simulated, harsh", "simulated", replace(kind, detector=DetectorConfig(enabled=True, **harsh))),
    ]


def _row(
    named: tuple[str, str, str], capture: Capture, truth: Truth, config: AppConfig, cameras: Reconstruction | None,
    report: Report,
) -> tuple[Row[Any], Reconstruction]:  # fmt: skip
    """The figures of one way to keyframes, and its reconstruction; ``cameras``, where known, are not calibrated
    again."""
    key, label, group = named
    found = reconstruct(capture, config.reconstruct, labelled(report, label), cameras)
    if found.motion is None:
        return Row(key, label, {}, group, found.notes[-1]), found
    figures = body(found, truth) | ({} if key == "hand" else likeness(capture, truth))
    return Row(key, label, figures, group), found


def likeness(capture: Capture, truth: Truth) -> dict[str, float | None]:
    """Errors of a capture's keypoints against the truth, of the person nearest to the athlete in each
    picture."""
    sets = frame_sets(capture)
    frame_of = {timecode: number for number, timecode in enumerate(truth.timecodes)}
    pictures, found, exchanged, off_mm = 0, 0, 0, []
    for index, timecode in enumerate(sets.timecodes):
        frame = frame_of.get(timecode)
        people = sets.people(index)
        if frame is None or not people:
            continue
        for number in range(len(capture.cameras)):
            if not truth.recorded[number, frame]:
                continue
            pictures += 1
            camera = truth.camera(number, frame)
            pixels, depth = project(camera, truth.joints_m[frame, _JOINT])
            mm_per_px = 1000.0 * depth / camera.focal_px
            offs = [_off(person[_KEYPOINT], pixels, mm_per_px) for person in people[number]]
            straight, crossed = min(offs, key=lambda pair: min(map(float, map(np.median, pair))), default=(None, None))
            if straight is None or crossed is None or not len(straight):
                continue
            found += 1
            if len(crossed) and np.median(crossed) < np.median(straight):
                exchanged += 1
                off_mm.append(crossed)
            else:
                off_mm.append(straight)
    if not found:
        return {"found": 0.0 if pictures else None}
    off = np.concatenate(off_mm)
    return {"found": 100.0 * found / pictures, "off": float(np.median(off)), "exchanged": 100.0 * exchanged / found}


def _off(person: Array, pixels: Array, mm_per_px: Array) -> tuple[Array, Array]:
    """Distances on the body, mm, of the keypoints (12, 3) that were found from the joints, and from those of the other
    side."""
    there = person[:, 2] > 0.0
    ways = (np.arange(len(person)), _OTHER_SIDE)
    straight, crossed = (np.linalg.norm(person[:, :2] - pixels[way], axis=1) * mm_per_px[way] for way in ways)
    return straight[there], crossed[there]


def _detected(capture: Capture, folder: Path, report: Report) -> Capture:
    """The capture with the keypoints that BlazePose finds in its videos. Raises PzcapError where it is not there."""
    detect = detector("mediapipe", ())
    cameras = []
    for done, files in enumerate(capture.cameras):
        report("BlazePose", done, len(capture.cameras))
        if files.motion is None:
            cameras.append(files)
            continue
        reader = VideoReader(files.motion)
        pictures = (image for _, image in reader.read(int(reader.indices[0]), int(reader.indices[-1]) + 1))
        path = folder / f"blazepose_{files.name}.json"
        with written_whole(path) as partial:
            text = json.dumps(list(coco_results(pictures, detect)), separators=(",", ":"))
            partial.write_text(text + "\n", encoding="utf-8")
        cameras.append(replace(files, keypoints=path, keypoints_from=0))
    return replace(capture, cameras=tuple(cameras))


def sample(capture: Capture, truth: Truth, found: Reconstruction) -> dict[str, Any]:
    """Some instants: for each camera its parameters, as they were estimated, and the people that were found, in pixels;
    and the true joints."""
    sets, instants = frame_sets(capture), []
    frame_of = {timecode: number for number, timecode in enumerate(truth.timecodes)}
    for index in np.unique(np.linspace(0, len(sets) - 1, _SAMPLED).round().astype(int)).tolist():
        views: list[dict[str, Any] | None] = []
        for head, track, people in zip(found.cameras, found.tracks, sets.people(index), strict=True):
            if head is None or track is None or not track.valid[index]:
                views.append(None)
                continue
            camera = of_track(head, track, index)
            views.append({
                "size": [camera.width, camera.height],
                "world_T_cam": np.round(camera.world_T_cam, 6).tolist(),
                "focal_px": round(camera.focal_px, 3),
                "principal_px": np.round(camera.principal_px, 3).tolist(),
                "k1": round(float(camera.k1), 5),
                "people": np.round(people, 2).tolist(),
            })  # fmt: skip
        joints = truth.joints_m[frame_of[sets.timecodes[index]]]
        instants.append({"frame": index, "views": views, "joints_m": np.round(joints, 4).tolist()})
    return {"capture": capture.name, "detector": "BlazePose, mediapipe, model_complexity=1", "instants": instants}


COMPARISON: Final[Comparison[Any]] = Comparison(
    name="detectors",
    columns=(
        MEAN,
        P95,
        LOST,
        COVERED,
        Column("found", "found %", "%", "{:.0f}", "higher"),
        Column("off", "off mm", "mm", "{:.0f}"),
        Column("exchanged", "exchanged %", "%", "{:.0f}"),
    ),
    compare=compare,
    experiment="no_hand",
    variants="keyframes",
    note="found: pictures with somebody; off: median distance on the body; exchanged: left for right",
)
