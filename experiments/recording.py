"""What only the experiments can add to a recording: the truth under /truth, errors under /error, totals, the layout."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from experiments.metrics import Metric, format_value, meets_target
from experiments.score import Score
from experiments.silhouettes import Series
from pzcap import rerun_columns as columns
from pzcap.rerun_columns import CAMERA_COLOURS, TRUTH_COLOUR, path_part, plain, view_path
from pzcap.rerun_log import Recorder
from pzcap.types import JOINTS, Camera, Reconstruction
from sim.truth import Truth

PANORAMA_REACH_RAD: Final = 1.0


def finish(recorder: Recorder, reconstruction: Reconstruction, truth: Truth | None, result: Score | None) -> None:
    """Send everything that is known once the reconstruction is done: results, truth and errors of all frames."""
    recorder.drain()
    with recorder.timed() as rec:
        columns.send_reconstruction(rec, reconstruction, recorder.capture.subject)
        if truth is not None and result is not None:
            _send_truth(rec, reconstruction, truth, result)
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
            "run": {"seed": run["seed"], "config": json.dumps(run["config"]), "machine": json.dumps(run["machine"])},
            "versions": run["versions"],
        },
    )
    rec.log("/summary", rr.TextDocument(plain(_page(found, run)), media_type="text/markdown"), static=True)
    scored = any(metric.key.startswith("panzoom") for metric in found)
    rec.send_blueprint(layout(reconstruction, scored=scored))


def _send_truth(rec: rr.RecordingStream, reconstruction: Reconstruction, truth: Truth, result: Score) -> None:
    frames = result.truth_frames
    everywhere = np.ones(len(frames), bool)
    figure = columns.figures(truth.joints_m[frames], truth.rotations[frames])
    columns.send_figures(rec, "/truth/body/skeleton", figure, everywhere, TRUTH_COLOUR, 0.006)
    for name in reconstruction.camera_names:
        at = truth.camera_names.index(name)
        cameras = [
            Camera(
                truth.width,
                truth.height,
                truth.world_T_cam[at, frame],
                float(truth.focal_px[at, frame]),
                truth.principal_px[at, frame],
                float(truth.k1[at, frame]),
            )
            for frame in frames
        ]
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
            ("focal", errors.focal, 100.0, "%"),
            ("focal_sigma", errors.focal_sigma, 100.0, "%"),
            ("focal_bound", errors.focal_bound, 100.0, "%"),
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


def layout(reconstruction: Reconstruction, *, scored: bool) -> rrb.Blueprint:
    """The hall in the middle, the views about it as the cameras stand; panoramas, plots and totals below."""
    names = reconstruction.camera_names
    views = [_view(name) for name in names]
    left, right = views[0::4] + views[3::4], views[1::4] + views[2::4]
    hall = _hall(reconstruction)
    top = rrb.Horizontal(*views, hall)
    if left and right:
        sides = rrb.Vertical(*reversed(left)), rrb.Vertical(*reversed(right))
        top = rrb.Horizontal(sides[0], hall, sides[1], column_shares=[1.0, 2.1, 1.0])
    panoramas = rrb.Grid(
        *(_panorama(reconstruction, number, "matches") for number in range(len(names))),
        grid_columns=2,
        name="Panoramas",
    )
    stages = _reference(reconstruction), panoramas, _matches(reconstruction), _foreground(names)
    pictures = rrb.Tabs(*stages, name="Stages", active_tab=1)
    summary = rrb.TextDocumentView(name="Summary", origin="/summary")
    bottom = rrb.Horizontal(pictures, _plots(scored), summary, column_shares=[1.5, 1.3, 0.8])
    return rrb.Blueprint(
        rrb.Vertical(top, bottom, row_shares=[1.55, 1.0]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=columns.TIMELINE, fps=float(reconstruction.frame_rate)),
    )


def _hall(reconstruction: Reconstruction) -> rrb.Spatial3DView:
    located = [
        view_path("/world", name)
        for name, track in zip(reconstruction.camera_names, reconstruction.tracks, strict=True)
        if track is not None and track.valid.any()
    ]
    return rrb.Spatial3DView(
        name="Hall",
        origin="/",
        contents=[
            *(f"/world/{part}/**" for part in ("floor", "object", "body", "keyframes")),
            "/truth/body/**",
            *located,
            *(f"{view}/image" for view in located),
        ],
        overrides={view: rr.Pinhole.from_fields().visualizer() for view in located},  # without its axes
        background=(24, 25, 30),
        line_grid=False,
        eye_controls=rrb.EyeControls3D(
            position=(0.0, -16.0, 8.5), look_target=(0.0, -1.2, 0.0), eye_up=(0.0, 0.0, 1.0)
        ),
    )


def _panorama(reconstruction: Reconstruction, number: int, hidden: str) -> rrb.Spatial2DView:
    """What lies before the reference pose; the rest is a scroll away."""
    name, panorama = reconstruction.camera_names[number], reconstruction.panoramas[number]
    bounds = None
    if panorama is not None:
        shown = columns.centred(panorama)
        low, high = shown.origin_px[0] + np.array([-1.0, 1.0]) * PANORAMA_REACH_RAD * panorama.px_per_rad
        bounds = rrb.VisualBounds2D(x_range=(low, high), y_range=(0.0, float(shown.image.shape[0])))
    return rrb.Spatial2DView(
        name=f"Panorama {plain(name)}",
        origin=f"/panorama/{path_part(name)}",
        contents=["$origin/**", f"- $origin/{hidden}"],
        visual_bounds=bounds,
    )


def _view(name: str) -> rrb.Spatial2DView:
    view, true = view_path("/world", name), view_path("/truth", name)
    return rrb.Spatial2DView(
        name=f"Camera {plain(name)}",
        origin=view,
        contents=[*(f"{view}/{part}" for part in ("image", "outline", "keypoints", "skeleton")), f"{true}/skeleton"],
    )


def _reference(reconstruction: Reconstruction) -> rrb.Grid:
    """The calibration object, close up."""
    views = []
    for name, reference in zip(reconstruction.camera_names, reconstruction.references, strict=True):
        bounds = None
        if reference is not None:
            low, high = reference.points_px.min(axis=0), reference.points_px.max(axis=0)
            margin = 0.2 * (high - low)
            bounds = rrb.VisualBounds2D(
                x_range=(low[0] - margin[0], high[0] + margin[0]), y_range=(low[1] - margin[1], high[1] + margin[1])
            )
        path = f"/reference/{path_part(name)}"
        views.append(rrb.Spatial2DView(name=f"Reference {plain(name)}", origin=path, visual_bounds=bounds))
    return rrb.Grid(*views, name="Reference")


def _foreground(names: Sequence[str]) -> rrb.Grid:
    views = []
    for name in names:
        path = f"/foreground/{path_part(name)}"
        views.append(rrb.Spatial2DView(name=f"Background {plain(name)}", origin=f"{path}/background"))
        views.append(rrb.Spatial2DView(name=f"Foreground {plain(name)}", origin=f"{path}/probability"))
    return rrb.Grid(*views, name="Foreground", grid_columns=4)


def _matches(reconstruction: Reconstruction) -> rrb.Grid:
    """Frame and panorama side by side; where a frame was followed without features there are none."""
    views = []
    for number, name in enumerate(reconstruction.camera_names):
        view = view_path("/world", name)
        contents = [f"{view}/image", f"{view}/matches"]
        views.append(rrb.Spatial2DView(name=f"Frame {plain(name)}", origin=view, contents=contents))
        views.append(_panorama(reconstruction, number, "sweep"))
    return rrb.Grid(*views, name="Matches", grid_columns=4)


def _plots(scored: bool) -> rrb.Container:
    corner, hidden = rrb.PlotLegend(corner="RightTop"), rrb.PlotLegend(visible=False)
    tracks = rrb.Vertical(
        rrb.TimeSeriesView(name="Pan [deg]", contents=["/track/pan/**", "/truth/track/pan/**"]),
        rrb.TimeSeriesView(name="Focal length [px]", contents=["/track/focal/**", "/truth/track/focal/**"]),
        name="Pan and zoom",
    )
    if not scored:
        return tracks
    errors = rrb.Vertical(
        rrb.TimeSeriesView(name="Pan error [deg]", contents=["/error/pan/**"], plot_legend=corner),
        rrb.TimeSeriesView(name="Focal error [%]", contents=["/error/focal/**"], plot_legend=corner),
        rrb.TimeSeriesView(name="Joint error [mm]", contents=["/error/joint/**", "/error/mpjpe"], plot_legend=hidden),
        name="Errors",
    )
    silhouettes = rrb.Vertical(
        rrb.TimeSeriesView(name="Silhouette IoU", contents=["/error/iou/**"]),
        rrb.TimeSeriesView(name="Outline [px]", contents=["/error/outline/**"]),
        rrb.TimeSeriesView(name="Reprojection [px]", contents=["/error/reprojection/**"]),
        name="Pixels",
    )
    return rrb.Tabs(errors, tracks, silhouettes, name="Plots", active_tab=0)


def _page(found: Sequence[Metric], run: Mapping[str, Any]) -> str:
    marks = {True: "reached", False: "**missed**", None: ""}
    rows = [
        f"| {metric.key} | {format_value(metric)} | {metric.unit} | {marks[meets_target(metric)]} |"
        for metric in found
        if metric.value is not None
    ]
    table = "\n".join(["| metric | value | unit | target |", "|---|---:|---|---|", *rows])
    versions = ", ".join(f"{name} {version}" for name, version in run["versions"].items())
    machine = run["machine"]
    return f"# Totals\n\n{table}\n\nSeed {run['seed']}; {machine['cpu']}, {machine['cores']} cores; {versions}.\n"
