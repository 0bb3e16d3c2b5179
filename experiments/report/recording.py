"""Parts of a recording that only the experiments know: the truth under /truth, errors under /error, totals, layout."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr

from experiments.config import CONVERTER, build, leaves
from experiments.metrics import format_value, meets_target
from experiments.own_world import brought_in
from experiments.score import Score
from pzcap.scoring.metric import Metric
from pzcap.scoring.records import Series
from pzcap.types import JOINTS, Reconstruction
from pzcap.viewer import columns, drawing, layouts
from pzcap.viewer.columns import path_part, plain, view_path
from pzcap.viewer.drawing import CAMERA_COLOURS, TRUTH_COLOUR
from pzcap.viewer.recording import Recorder
from sim.truth import Truth


def finish(recorder: Recorder, reconstruction: Reconstruction, truth: Truth | None, result: Score | None) -> None:
    """Send everything that is known once the reconstruction is done: results, truth and errors of all frames."""
    recorder.drain()
    truth, result = brought_in(truth, result, reconstruction.camera_names)
    with recorder.timed() as rec:
        columns.send_reconstruction(rec, reconstruction, recorder.capture.subject)
        if truth is not None and result is not None:
            _send_truth(rec, reconstruction, truth, result)
        if result is not None:
            _send_errors(rec, reconstruction, result)


def summarise(
    recorder: Recorder, reconstruction: Reconstruction, found: Sequence[Metric], run: Mapping[str, Any]
) -> None:
    """Totals as recording properties and as a page, and the layout."""
    rec = recorder.rec
    values = {metric.key: metric.value for metric in found if metric.value is not None}
    columns.send_properties(
        rec,
        {
            "metrics": values,
            "config": _settings(run["config"]),
            "run": {"seed": run["seed"], "machine": json.dumps(run["machine"])},
            "versions": run["versions"],
        },
    )
    rec.log("/summary", rr.TextDocument(plain(_page(found, run)), media_type="text/markdown"), static=True)
    scored = any(metric.key.startswith("panzoom") for metric in found)
    rec.send_blueprint(layouts.whole(layouts.overview(reconstruction, scored=scored), reconstruction))


def _settings(tree: Mapping[str, Any]) -> dict[str, Any]:
    """Dotted key -> value of all that was set, each of the one type that it has in every recording of a catalog."""
    typed = leaves(CONVERTER.unstructure(build(tree)))
    return {key: json.dumps(value) if isinstance(value, list | tuple) else value for key, value in typed.items()}


def _send_truth(rec: rr.RecordingStream, reconstruction: Reconstruction, truth: Truth, result: Score) -> None:
    frames = result.truth_frames
    everywhere = np.ones(len(frames), bool)
    figure = drawing.figures(truth.joints_m[frames], truth.rotations[frames])
    columns.send_figures(rec, "/truth/body/skeleton", figure, everywhere, TRUTH_COLOUR, 0.006)
    for name in reconstruction.camera_names:
        at = truth.camera_names.index(name)
        cameras = [truth.camera(at, frame) for frame in frames.tolist()]
        columns.send_cameras(rec, "/truth", name, cameras, float(truth.reference_focal_px[at]), TRUTH_COLOUR)
        pan, focal = truth.pan_rad[at, frames], truth.focal_px[at, frames]
        columns.send_tracks(rec, "/truth/track", name, pan, focal, everywhere, TRUTH_COLOUR, 0.8)  # within the estimate
        path = f"{view_path('/truth', name)}/skeleton"
        rec.log(path, rr.CoordinateFrame(f"tf#{view_path('/world', name)}"), static=True)  # it is drawn over the image
        columns.send_projected(rec, path, cameras, figure, TRUTH_COLOUR, 0.5)


def _send_errors(rec: rr.RecordingStream, reconstruction: Reconstruction, result: Score) -> None:
    for number, (name, errors) in enumerate(zip(reconstruction.camera_names, result.cameras, strict=True)):
        colour, part = CAMERA_COLOURS[number % len(CAMERA_COLOURS)], path_part(name)
        views = None if result.foreground is None else result.foreground[number]
        plots: list[tuple[str, Series | None, float, str]] = [
            ("pan", errors.pan_rad, np.degrees(1.0), "deg"),
            ("pan_sigma", errors.pan_sigma_rad, np.degrees(1.0), "deg"),
            ("pan_bound", errors.pan_bound_rad, np.degrees(1.0), "deg"),
            ("pan_refined", errors.refined_pan_rad, np.degrees(1.0), "deg"),
            ("focal", errors.focal, 100.0, "%"),
            ("focal_sigma", errors.focal_sigma, 100.0, "%"),
            ("focal_bound", errors.focal_bound, 100.0, "%"),
            ("focal_refined", errors.refined_focal, 100.0, "%"),
            ("reprojection", errors.reprojection_px, 1.0, "px"),
            ("nees", errors.nees, 1.0, "1"),
            ("iou", None if views is None else views.iou, 1.0, "1"),
            ("outline", None if views is None else views.outline_px, 1.0, "px"),
            ("shadow", None if views is None else views.shadow, 100.0, "%"),
        ]
        for kind, series, scale, unit in plots:
            if series is not None:
                label = f"{kind} {plain(name)} [{unit}]"
                columns.send_series(rec, f"/error/{kind}/{part}", scale * series.values, series.valid, colour, label)
    body = result.body
    if body is None:
        return
    everywhere = np.ones(len(body.valid), bool)
    mean = 1000.0 * body.joints_m.mean(axis=1)
    columns.send_series(rec, "/error/mpjpe", mean, body.valid, (250, 240, 130), "MPJPE [mm]", 2.5)
    for joint, joint_name in enumerate(JOINTS):
        values = 1000.0 * body.joints_m[:, joint]
        columns.send_series(
            rec, f"/error/joint/{joint_name}", values, body.valid, (150, 150, 158), f"{joint_name} [mm]", 0.7
        )
    for kind in ("keyframe", "inverted", "airborne"):
        values = getattr(body, kind).astype(float)
        columns.send_series(rec, f"/phase/{kind}", values, everywhere, (150, 150, 158), kind)


def _page(found: Sequence[Metric], run: Mapping[str, Any]) -> str:
    marks = {True: "reached", False: "**missed**", None: ""}
    rows = [
        f"| {metric.key} | {format_value(metric)}{_unit(metric)} | {marks[meets_target(metric)]} |"
        for metric in found
        if metric.value is not None
    ]
    table = "\n".join(["| metric | value | target |", "|---|---:|---|", *rows])
    versions = ", ".join(f"{name} {version}" for name, version in run["versions"].items())
    machine = run["machine"]
    return f"# Totals\n\n{table}\n\nSeed {run['seed']}; {machine['cpu']}, {machine['cores']} cores; {versions}.\n"


def _unit(metric: Metric) -> str:
    return "" if metric.unit == "1" else f" {metric.unit}"
