"""Layouts of the viewer, one a purpose: overview, calibration, tracking, and two runs side by side."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from pzcap.types import Reconstruction
from pzcap.viewer import columns, drawing
from pzcap.viewer.columns import path_part, plain, view_path
from pzcap.viewer.drawing import TRUNK_COLOUR, Colour

PANORAMA_REACH_RAD: Final = 1.0
OTHER: Final = "/other"
"""Under which the second of two compared runs stands."""
OTHER_COLOUR: Final[Colour] = (255, 120, 80)


def whole(content: rrb.Container, reconstruction: Reconstruction) -> rrb.Blueprint:
    """``content`` in a viewer whose panels are out of the way and whose clock counts frames."""
    return rrb.Blueprint(
        content,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=columns.TIMELINE, fps=float(reconstruction.frame_rate)),
    )


def overview(reconstruction: Reconstruction, *, scored: bool) -> rrb.Container:
    """The hall in the middle, the views about it as the cameras stand; panoramas, plots and totals below."""
    names = reconstruction.camera_names
    views = [_view(name) for name in names]
    left, right = views[0::4] + views[3::4], views[1::4] + views[2::4]
    hall = _hall(reconstruction)
    top = rrb.Horizontal(*views, hall)
    if left and right:
        sides = rrb.Vertical(*reversed(left)), rrb.Vertical(*reversed(right))
        top = rrb.Horizontal(sides[0], hall, sides[1], column_shares=[1.0, 2.1, 1.0])
    stages = _reference(reconstruction), _panoramas(reconstruction), _matches(reconstruction), _foreground(names)
    pictures = rrb.Tabs(*stages, name="Stages", active_tab=1)
    documents = [rrb.TextDocumentView(name=name, origin=f"/{name.lower()}") for name in ("Summary", "Notes")]
    texts = rrb.Tabs(*documents, name="Texts", active_tab=0 if scored else 1)
    plots = rrb.Tabs(_errors(), _tracks(), _pixels(), name="Plots", active_tab=0) if scored else _tracks()
    bottom = rrb.Horizontal(pictures, plots, texts, column_shares=[1.5, 1.3, 0.8])
    return rrb.Vertical(top, bottom, row_shares=[1.55, 1.0], name="Overview")


def calibration(reconstruction: Reconstruction) -> rrb.Container:
    """Each frame on its panorama and what was matched; pan and zoom over time, and their sigma."""
    pictures = rrb.Tabs(_panoramas(reconstruction), _matches(reconstruction), _reference(reconstruction), active_tab=0)
    hidden = rrb.PlotLegend(visible=False)
    plots = rrb.Vertical(
        *(
            rrb.TimeSeriesView(name=name, contents=[f"/error/{kind}/**" for kind in kinds], plot_legend=hidden)
            for name, kinds in (
                ("Pan error and sigma [deg]", ("pan", "pan_sigma")),
                ("Focal error and sigma [%]", ("focal", "focal_sigma")),
                ("Reprojection [px]", ("reprojection",)),
                ("NEES (1: honest)", ("nees",)),
            )
        ),
        name="Errors",
    )
    return rrb.Horizontal(
        pictures, rrb.Tabs(plots, _tracks(), active_tab=0), column_shares=[1.6, 1.0], name="Calibration"
    )


def tracking(reconstruction: Reconstruction) -> rrb.Container:
    """The views with body and outline, large; the silhouettes; the error of every joint."""
    names = reconstruction.camera_names
    views = rrb.Grid(*(_view(name) for name in names), grid_columns=2, name="Views")
    hidden = rrb.PlotLegend(visible=False)
    plots = rrb.Vertical(
        rrb.TimeSeriesView(name="Joint error [mm]", contents=["/error/joint/**", "/error/mpjpe"], plot_legend=hidden),
        rrb.TimeSeriesView(name="Silhouette IoU", contents=["/error/iou/**"], plot_legend=hidden),
        rrb.TimeSeriesView(name="Phase", contents=["/phase/**"]),
        row_shares=[2.0, 1.2, 0.7],
    )
    beside = rrb.Vertical(_hall(reconstruction), plots)
    return rrb.Horizontal(
        rrb.Tabs(views, _foreground(names), active_tab=0), beside, column_shares=[1.6, 1.0], name="Tracking"
    )


def comparison(reconstruction: Reconstruction, titles: tuple[str, str]) -> rrb.Container:
    """Two runs: one on the left, one (under `OTHER`) on the right; the joint errors of both in one plot."""
    sides = []
    for root, title in zip(("", OTHER), titles, strict=True):
        views = rrb.Grid(*(_view(name, root, title) for name in reconstruction.camera_names), grid_columns=2)
        plots = rrb.Horizontal(
            *(
                rrb.TimeSeriesView(
                    name=name, contents=[f"{root}/error/{kind}/**"], plot_legend=rrb.PlotLegend(visible=False)
                )
                for name, kind in (("Pan error [deg]", "pan"), ("Focal error [%]", "focal"))
            ),
            name="Errors",
        )
        summary = rrb.TextDocumentView(name="Summary", origin=f"{root}/summary")
        sides.append(rrb.Vertical(views, rrb.Tabs(plots, summary, active_tab=0), row_shares=[2.2, 1.0]))
    mean = [f"{root}/error/mpjpe" for root in ("", OTHER)]
    series = [
        rr.SeriesLines.from_fields(names=[plain(title)], colors=[colour], widths=[1.5]).visualizer()
        for title, colour in zip(titles, (TRUNK_COLOUR, OTHER_COLOUR), strict=True)
    ]
    both = rrb.TimeSeriesView(
        name="Joint error, mean [mm]", contents=mean, overrides=dict(zip(mean, series, strict=True))
    )
    return rrb.Vertical(rrb.Horizontal(*sides), both, row_shares=[3.0, 1.0], name="Comparison")


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
        eye_controls=_eye(reconstruction),
    )


def _eye(reconstruction: Reconstruction) -> rrb.EyeControls3D:
    """From before the hall, and so far away that no camera is cut off at the edge of a view that is wider than high."""
    places = np.array([camera.world_T_head[:2, 3] for camera in reconstruction.cameras if camera is not None])
    low, high = (places.min(axis=0), places.max(axis=0)) if len(places) else (np.zeros(2), np.zeros(2))
    (x, y), radius = (low + high) / 2.0, max(float(np.linalg.norm(high - low)) / 2.0, 6.0)
    return rrb.EyeControls3D(
        position=(x, y - 1.65 * radius, 0.8 * radius), look_target=(x, y - 0.1 * radius, 0.0), eye_up=(0.0, 0.0, 1.0)
    )


def _panorama(reconstruction: Reconstruction, number: int, hidden: str) -> rrb.Spatial2DView:
    """The view of the reference pose; the rest is a scroll away."""
    name, panorama = reconstruction.camera_names[number], reconstruction.panoramas[number]
    bounds = None
    if panorama is not None:
        shown = drawing.centred(panorama)
        low, high = shown.origin_px[0] + np.array([-1.0, 1.0]) * PANORAMA_REACH_RAD * panorama.px_per_rad
        bounds = rrb.VisualBounds2D(x_range=(low, high), y_range=(0.0, float(shown.image.shape[0])))
    return rrb.Spatial2DView(
        name=f"Panorama {plain(name)}",
        origin=f"/panorama/{path_part(name)}",
        contents=["$origin/**", f"- $origin/{hidden}"],
        visual_bounds=bounds,
    )


def _panoramas(reconstruction: Reconstruction) -> rrb.Grid:
    views = (_panorama(reconstruction, number, "matches") for number in range(len(reconstruction.camera_names)))
    return rrb.Grid(*views, grid_columns=2, name="Panoramas")


def _view(name: str, root: str = "", run: str = "") -> rrb.Spatial2DView:
    view = view_path(f"{root}/world", name)
    shown = [f"{view}/{part}" for part in ("image", "outline", "keypoints", "skeleton")]
    true = [] if root else [f"{view_path('/truth', name)}/skeleton"]  # it stands in the views of the first alone
    title = f"Camera {plain(name)}" + (f": {plain(run)}" if run else "")
    return rrb.Spatial2DView(name=title, origin=view, contents=[*shown, *true])


def _reference(reconstruction: Reconstruction) -> rrb.Grid:
    """The calibration object, close up."""
    views = []
    for name, reference in zip(reconstruction.camera_names, reconstruction.references, strict=True):
        bounds = None
        if reference is not None and len(reference.points_px):
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


def _tracks() -> rrb.Container:
    return rrb.Vertical(
        rrb.TimeSeriesView(name="Pan [deg]", contents=["/track/pan/**", "/truth/track/pan/**"]),
        rrb.TimeSeriesView(name="Focal length [px]", contents=["/track/focal/**", "/truth/track/focal/**"]),
        name="Pan and zoom",
    )


def _errors() -> rrb.Container:
    corner, hidden = rrb.PlotLegend(corner="RightTop"), rrb.PlotLegend(visible=False)
    return rrb.Vertical(
        rrb.TimeSeriesView(name="Pan error [deg]", contents=["/error/pan/**"], plot_legend=corner),
        rrb.TimeSeriesView(name="Focal error [%]", contents=["/error/focal/**"], plot_legend=corner),
        rrb.TimeSeriesView(name="Joint error [mm]", contents=["/error/joint/**", "/error/mpjpe"], plot_legend=hidden),
        name="Errors",
    )


def _pixels() -> rrb.Container:
    return rrb.Vertical(
        rrb.TimeSeriesView(name="Silhouette IoU", contents=["/error/iou/**"]),
        rrb.TimeSeriesView(name="Outline [px]", contents=["/error/outline/**"]),
        rrb.TimeSeriesView(name="Reprojection [px]", contents=["/error/reprojection/**"]),
        name="Pixels",
    )
