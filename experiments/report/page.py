"""report.html: one self-contained page that says what was reconstructed, how well, and what it looks like."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from experiments import pages
from experiments.metrics import TARGETS, format_value, meets_target
from experiments.own_world import brought_in
from experiments.report import pictures, plots
from experiments.score import Score
from pzcap.body.skeleton import build
from pzcap.extras import keyframe_diagnostics
from pzcap.io.capture import frame_sets, read_image
from pzcap.scoring.metric import Metric
from pzcap.types import Array, Camera, Capture, FrameSet, Image, Reconstruction
from pzcap.viewer.drawing import OUTLINE_COLOUR, TRUTH_COLOUR, Colour, figures, instants
from sim.truth import Truth


@dataclass(frozen=True, slots=True, eq=False)
class Material:
    """Input of the report."""

    capture: Capture
    reconstruction: Reconstruction
    truth: Truth | None
    score: Score | None
    metrics: Sequence[Metric]
    run: Mapping[str, Any]
    outlines: Mapping[tuple[int, int], Sequence[Array]]  # (frame set, camera) -> closed lines (N, 2) px
    stage_s: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Picture:
    uri: str
    caption: str


HEADLINES: Final[Mapping[str, tuple[str, str]]] = {
    "panzoom.pan.rms": ("Pan", "RMS error. 0.02° turn a ray away by 5 mm at 15 m."),
    "panzoom.focal.rms": ("Focal length", "RMS error. 1 % moves a point 150 px off the centre by 22 mm at 15 m."),
    "panzoom.reprojection.rms": ("Reprojection", "Static points of the hall, estimated against true camera."),
    "panzoom.lost": ("Lost views", "Recorded views in which the camera was not found."),
    "foreground.iou": ("Silhouettes", "Intersection over union with the true masks; 1 is perfect."),
    "body.mpjpe.mean": ("Joints", "Mean distance of joint centres from the truth, in the world, nothing aligned."),
    "body.mpjpe.similarity": ("Joints, aligned", "Mean distance after one similarity of the whole motion."),
    "body.size.similarity": ("Size", "Of the motion before that, off the true one's."),
    "panzoom.position.similarity": (
        "Tripods, aligned", "The worst camera's place after the similarity of the motion."
    ),
    "body.keyframes": ("Keyframes", "Poses set by hand. Not scored."),
    "speed.fps": ("Speed", "Four views, from decoding to the body."),
}  # fmt: skip
"""Name of a figure, and what it says."""
ALIGNED: Final = {"body.mpjpe.similarity", "body.size.similarity", "panzoom.position.similarity"}
IN_THE_WORLD: Final = {"panzoom.pan.rms", "panzoom.reprojection.rms", "body.mpjpe.mean", "body.keyframes"}
"""Metrics in the place of `ALIGNED` where a calibration object says where the world begins."""
THUMBNAIL_PX: Final = 460
INSTANTS: Final = 5
WORST: Final = 3


def write_report(path: Path, material: Material, command: str) -> None:
    """Write the page. It needs no other file and no network."""
    pages.write(path, "report.html.j2", _context(material, command))


def _experiment(command: str) -> str | None:
    """The named experiment that a ``command`` runs: captures are named after their motion alone."""
    named = [word for word in shlex.split(command) if word.startswith("experiment=")]
    return named[-1].partition("=")[2] if named else None


def _by_camera(notes: Sequence[str], cameras: Sequence[str]) -> dict[str, list[str]]:
    """Notes, those that begin with a camera under its name and without it; the others come first, under none."""
    found: dict[str, list[str]] = {"": []}
    for camera in cameras:
        named = [note for note in notes if note.startswith(f"camera {camera}: ")]
        found |= {f"Camera {camera}": [note.removeprefix(f"camera {camera}: ") for note in named]} if named else {}
        notes = [note for note in notes if note not in named]
    return found | {"": list(notes)}


def _context(material: Material, command: str) -> dict[str, Any]:
    reconstruction = material.reconstruction
    truth, result = brought_in(material.truth, material.score, reconstruction.camera_names)
    material = replace(material, truth=truth, score=result)
    body = None if result is None else result.body
    by_key = {metric.key: metric for metric in material.metrics}
    own_world = result is not None and result.own_world
    headlines = [key for key in HEADLINES if key in by_key and key not in (IN_THE_WORLD if own_world else ALIGNED)]
    shown = _Frames(material)
    contradicted, next_keyframe = _advice(material)
    return {
        "title": reconstruction.capture_name,
        "experiment": _experiment(command),
        "method": reconstruction.method,
        "seed": material.run["seed"],
        "frames": len(reconstruction.timecodes),
        "cameras": len(reconstruction.camera_names),
        "frame_rate": float(reconstruction.frame_rate),
        "notes": _by_camera(reconstruction.notes, reconstruction.camera_names),
        "scored": result is not None,
        "headlines": _claims(reconstruction)
        if result is None
        else [_headline(by_key[key], *HEADLINES[key], _remark(by_key, key)) for key in headlines],
        "own_world": own_world,
        "references": _references(material),
        "camera_rows": _camera_rows(reconstruction, result),
        "panoramas": _panoramas(material),
        "pan_zoom": plots.pan_zoom(reconstruction, truth, result) if any(reconstruction.tracks) else None,
        "honesty": None if result is None or not any(reconstruction.tracks) else plots.honesty(reconstruction, result),
        "top_view": plots.top_view(reconstruction, truth, result) if any(reconstruction.tracks) else None,
        "sheet": shown.sheet(),
        "silhouettes": None
        if result is None or result.foreground is None
        else plots.silhouettes(reconstruction, result),
        "body_error": None if body is None else plots.body_error(body, contradicted, next_keyframe),
        "contradicted": contradicted,
        "joint_bars": None if body is None or not body.scored.any() else plots.joint_bars(body),
        "worst": shown.worst(),
        "stage_times": plots.stage_times(material.stage_s) if material.stage_s else None,
        "groups": [
            (name, [_row(metric) for metric in material.metrics if _group(metric) == name])
            for name in dict.fromkeys(_group(metric) for metric in material.metrics)
        ],
        "command": command,
        "versions": material.run["versions"],
        "machine": material.run["machine"],
        "config": json.dumps(material.run["config"], indent=2, ensure_ascii=False),
    }


def _group(metric: Metric) -> str:
    return metric.key.partition(".")[0]


def _row(metric: Metric) -> dict[str, Any]:
    return {
        "key": metric.key,
        "value": format_value(metric),
        "unit": "" if metric.unit == "1" else metric.unit,
        "target": _target(metric),
        "reached": meets_target(metric),
    }


def _target(metric: Metric) -> str | None:
    target = TARGETS.get(metric.key)
    return None if target is None else f"{'≤' if metric.direction == 'lower' else '≥'} {target:g}"


def _advice(material: Material) -> tuple[list[int], int | None]:
    """The keyframes that the images contradict, and the frame where the next one would help most."""
    capture, motion = material.capture, material.reconstruction.motion
    if motion is None or capture.subject is None:
        return [], None
    found = keyframe_diagnostics.contradictions(motion, frame_sets(capture).keyframes, build(capture.subject))
    next_one = keyframe_diagnostics.suggestion(motion)
    return [each.frame for each in found], None if next_one is None else next_one.frame


def _remark(by_key: Mapping[str, Metric], key: str) -> str:
    """A sentence on what a figure of this run holds that the next one's will not; "" if there is nothing."""
    compiling = by_key.get("speed.compiling")
    if key != "speed.fps" or compiling is None or not compiling.value:
        return ""
    return f" This run compiled its kernels for {compiling.value:.0f} s; the next one has them."


def _headline(metric: Metric, name: str, text: str, remark: str) -> dict[str, Any]:
    return {
        "name": name,
        "value": format_value(metric),
        "unit": "" if metric.unit == "1" else {"deg": "°"}.get(metric.unit, metric.unit),
        "text": text + remark,
        "target": _target(metric),
        "reached": meets_target(metric),
    }


def _claims(reconstruction: Reconstruction) -> list[dict[str, Any]]:
    """The cards of a run that nothing scores: what was found, and how sure the run itself is of it."""
    tracks, motion = [track for track in reconstruction.tracks if track is not None], reconstruction.motion
    frames, found = len(reconstruction.timecodes), sum(int(track.valid.sum()) for track in tracks)
    share, claimed = 100.0 * found / max(frames * len(reconstruction.tracks), 1), "Standard deviation claimed, median."
    cards = [("Views located", f"{share:.0f}", "%", "Of all cameras and frames.")]
    if found:
        variances = np.concatenate([np.einsum("fii->fi", track.covariance[track.valid]) for track in tracks])
        pan, focal = np.sqrt(np.median(variances, axis=0))
        cards.append(("Pan", f"{np.degrees(pan):.2g}", "°", claimed))
        cards.append(("Focal length", f"{100.0 * focal:.2g}", "%", claimed))
    if motion is not None and motion.valid.any():
        sigma_m = float(np.median(motion.sigma_m[motion.valid]))
        cards.append(("Body tracked", f"{100.0 * motion.valid.mean():.0f}", "%", "Of the frames."))
        cards.append(("Joints", f"{1e3 * sigma_m:.2g}", "mm", claimed))
    names = ("name", "value", "unit", "text")
    return [dict(zip(names, card, strict=True)) | {"target": None, "reached": None} for card in cards]


def _references(material: Material) -> list[Picture]:
    found = []
    target = material.capture.calibration_object
    for camera, reference in zip(material.capture.cameras, material.reconstruction.references, strict=True):
        if camera.reference is not None and reference is not None and target is not None:
            image = pictures.reference_picture(read_image(camera.reference), reference, target)
            found.append(Picture(pictures.data_uri(image, 640), f"Camera {camera.name}"))
    return found


def _camera_rows(reconstruction: Reconstruction, result: Score | None) -> list[dict[str, str]]:
    rows = []
    for number, name in enumerate(reconstruction.camera_names):
        reference, panorama = reconstruction.references[number], reconstruction.panoramas[number]
        track, camera = reconstruction.tracks[number], reconstruction.cameras[number]
        errors = None if result is None else result.cameras[number]
        row = {"camera": name}
        if reference is not None and len(reference.points_px):
            residual = float(np.sqrt(np.mean(np.sum(reference.residuals_px**2, axis=1))))
            row["corners"] = f"{len(reference.points_px)} at {residual:.2f} px"
        if errors is not None and errors.position_m is not None:
            row["position"] = f"{1000 * errors.position_m:.1f} mm"
        if camera is not None:
            row["lens"] = f"{camera.lens.reference_focal_px:.1f} px, tilt {np.degrees(camera.tilt_rad):.2f}°"
        if panorama is not None:
            row["closure"] = f"{np.degrees(panorama.closure_rad):.3f}°" if panorama.full_turn else "no full turn"
            row["residual"] = f"{panorama.residual_px:.2f} px"
        if track is not None:
            row["found"] = f"{int(track.valid.sum())} of {len(track.valid)}"
        pan, focal = (None, None) if errors is None else (errors.pan_rad, errors.focal)
        if result is None and track is not None and track.valid.any():
            sigma = np.sqrt(np.median(np.einsum("fii->fi", track.covariance[track.valid]), axis=0))
            row |= {"pan": f"{np.degrees(sigma[0]):.4f}°", "focal": f"{100.0 * sigma[1]:.3f} %"}
        if pan is not None and focal is not None and pan.valid.any():
            if result is not None and not result.own_world:
                row["pan"] = f"{np.degrees(np.sqrt(np.mean(pan.values[pan.valid] ** 2))):.4f}°"
            row["focal"] = f"{100 * np.sqrt(np.mean(focal.values[focal.valid] ** 2)):.3f} %"
        rows.append(row)
    return rows


def _panoramas(material: Material) -> list[Picture]:
    reconstruction, motion = material.reconstruction, material.reconstruction.motion
    body = None if motion is None else figures(motion.joints_m, motion.rotations)
    found = []
    for number, name in enumerate(reconstruction.camera_names):
        camera, track = reconstruction.cameras[number], reconstruction.tracks[number]
        panorama = reconstruction.panoramas[number]
        if camera is None or track is None or panorama is None or not track.valid.any():
            continue
        located = np.flatnonzero(track.valid)
        some = located[np.unique(np.linspace(0, len(located) - 1, 6).astype(int))]
        cameras = instants(camera, track)
        drawn: list[tuple[Array, bool]] = []
        if motion is not None and body is not None:
            between = np.linspace(0, len(body) - 1, min(14, 1 + len(body) // 8)).astype(int)
            frames = sorted({int(f) for f in between if motion.valid[f]} | {int(f) for f in motion.keyframes})
            drawn = [(body[frame], frame in motion.keyframes) for frame in frames]
        borders = [at for frame in some if (at := cameras[frame]) is not None]
        colours = [_ramp(place) for place in np.linspace(0.0, 1.0, len(borders))]
        image = pictures.panorama_picture(panorama, camera, borders, colours, drawn)
        found.append(Picture(pictures.data_uri(image, quality=78), f"Camera {name}"))
    return found


def _ramp(place: float) -> Colour:
    """From blue (0) to yellow (1)."""
    ends = np.array([[66, 133, 244], [251, 202, 4]])
    red, green, blue = np.round((1 - place) * ends[0] + place * ends[1]).astype(int)
    return int(red), int(green), int(blue)


class _Frames:
    """Frames of the motion with what was found in them."""

    def __init__(self, material: Material) -> None:
        self._material = material
        self._sets = frame_sets(material.capture) if any(material.reconstruction.tracks) else None
        reconstruction, motion = material.reconstruction, material.reconstruction.motion
        self._cameras: list[list[Camera | None] | None] = [
            None if camera is None or track is None else instants(camera, track)
            for camera, track in zip(reconstruction.cameras, reconstruction.tracks, strict=True)
        ]
        self._body = None if motion is None else figures(motion.joints_m, motion.rotations)
        self._true = None
        if material.truth is not None and material.score is not None:
            at = material.score.truth_frames
            self._true = figures(material.truth.joints_m[at], material.truth.rotations[at])

    def sheet(self) -> list[list[Picture]]:
        """All views at a few instants: a row an instant."""
        if self._sets is None or not len(self._sets):
            return []
        return [
            self._row(int(frame), worst=False)
            for frame in np.unique(np.linspace(0, len(self._sets) - 1, INSTANTS).astype(int))
        ]

    def worst(self) -> list[dict[str, Any]]:
        """The instants where the body is most wrong, close up, with the truth in white."""
        score = self._material.score
        if self._sets is None or score is None or score.body is None:
            return []
        body, rows = score.body, []
        mean = np.where(body.scored, 1000.0 * body.joints_m.mean(axis=1), -1.0)
        for _ in range(WORST):
            frame = int(np.argmax(mean))
            if mean[frame] <= 0.0:
                break
            title = f"Frame {frame}: {mean[frame]:.0f} mm"
            rows.append({"title": title, "views": self._row(frame, worst=True)})
            mean[max(frame - 10, 0) : frame + 11] = -1.0  # its neighbours are wrong in the same way
        return rows

    def _row(self, frame: int, *, worst: bool) -> list[Picture]:
        assert self._sets is not None
        frames: FrameSet = next(iter(self._sets.between(frame, frame + 1)))
        row = []
        for number, name in enumerate(self._material.reconstruction.camera_names):
            if (image := frames.images[number]) is not None:
                picture = self._draw(image.copy(), frame, number, worst=worst)
                row.append(Picture(pictures.data_uri(picture, THUMBNAIL_PX), f"Camera {name}, frame {frame}"))
        return row

    def _draw(self, image: Image, frame: int, number: int, *, worst: bool) -> Image:
        cameras, motion = self._cameras[number], self._material.reconstruction.motion
        camera = None if cameras is None else cameras[frame]
        tracked = motion is not None and self._body is not None and bool(motion.valid[frame])
        if not worst or camera is None or self._body is None:
            pictures.draw_strips(image, self._material.outlines.get((frame, number), ()), OUTLINE_COLOUR)
        elif tracked:
            around = self._body[frame] if self._true is None else np.vstack([self._body[frame], self._true[frame]])
            image, camera = pictures.close_up(image, camera, around, THUMBNAIL_PX)
        if camera is None or self._body is None or not tracked:
            return image
        if worst and self._true is not None:
            pictures.draw_figure(image, camera, self._true[frame], TRUTH_COLOUR, 2)
        pictures.draw_figure(image, camera, self._body[frame], None, 2)
        return image
