"""Plots for the report, as SVG to stand inside the page."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from typing import Any, Concatenate, ParamSpec

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from numpy.typing import NDArray

from experiments.report.style import COLOURS, INK, KEY, MUTED, literal, svg
from experiments.score import CameraErrors, Score
from pzcap.scoring.body_errors import BodyErrors
from pzcap.scoring.records import Series
from pzcap.types import JOINTS, Array, Mask, PanZoomCamera, Reconstruction
from sim.truth import Truth

P = ParamSpec("P")
INVERTED, AIRBORNE = "#7c4dff", "#00acc1"


def _as_svg(draw: Callable[Concatenate[Figure, P], None]) -> Callable[P, Markup]:
    """``draw(figure, ...)``, which sets the figure's size, as a function of the others that returns the SVG."""

    @wraps(draw)
    def drawn(*args: P.args, **kwargs: P.kwargs) -> Markup:
        return svg(1.0, 1.0, lambda figure: draw(figure, *args, **kwargs))

    return drawn


@_as_svg
def pan_zoom(figure: Figure, reconstruction: Reconstruction, truth: Truth | None, result: Score | None) -> None:
    """A column a camera: pan, focal length (Fig. 12), and their errors with the sigma that the estimate claims."""
    names, count = reconstruction.camera_names, len(reconstruction.camera_names)
    rows = 2 if result is None else 4
    figure.set_size_inches(11.5, 1.75 * rows + 0.5)
    axes = figure.subplots(rows, count, sharex=True, sharey="row", squeeze=False)
    for number, name in enumerate(names):
        track, camera, colour = reconstruction.tracks[number], reconstruction.cameras[number], COLOURS[number % 4]
        column: list[Axes] = list(axes[:, number])
        column[0].set_title(f"Camera {literal(name)}")
        column[-1].set_xlabel("frame")
        if track is None:
            column[0].text(0.5, 0.5, "not reconstructed", transform=column[0].transAxes, ha="center", color=MUTED)
            continue
        frames = np.arange(len(track.valid))
        if truth is not None and result is not None:
            at = truth.camera_names.index(name)
            pan = np.degrees(np.unwrap(truth.pan_rad[at, result.truth_frames]))
            column[0].plot(frames, pan, color=INK, lw=3.2, alpha=0.22)
            column[1].plot(
                frames, truth.focal_px[at, result.truth_frames], color=INK, lw=3.2, alpha=0.22, label="truth"
            )
        _line(column[0], Series(np.degrees(_unwrapped(track.pan_rad, track.valid)), track.valid), colour)
        _line(column[1], Series(track.focal_px.copy(), track.valid), colour, label="estimate")
        if camera is not None:
            column[1].axhline(camera.lens.reference_focal_px, color=MUTED, ls=":", lw=1.2, label="reference")
        if result is not None:
            errors = result.cameras[number]
            _error(column[2], errors.pan_rad, errors.pan_sigma_rad, np.degrees(1.0), colour)
            _error(column[3], errors.focal, errors.focal_sigma, 100.0, colour)
    for row, label in zip(axes, ("pan [deg]", "focal length [px]", "pan error [deg]", "focal error [%]"), strict=False):
        row[0].set_ylabel(label)
    drawn = next((plot for plot in axes[1] if plot.get_legend_handles_labels()[0]), None)
    if drawn is not None:
        drawn.legend(loc="best", handlelength=1.4)


@_as_svg
def honesty(figure: Figure, reconstruction: Reconstruction, result: Score) -> None:
    """A column a camera: the size of the errors between the bound and the claimed sigma; and whether the claim holds.

    Below, each frame is a dot: its errors of pan and log focal in units of their own covariance. If that is honest,
    half of the dots lie within the inner circle and 95 % within the outer one.
    """
    names, count = reconstruction.camera_names, len(reconstruction.camera_names)
    whitened = any(errors.normalised is not None for errors in result.cameras)
    figure.set_size_inches(11.5, 6.6 if whitened else 4.2)
    rows: Any = figure.subfigures(2, 1, height_ratios=[2.0, 1.15]) if whitened else [figure]
    axes = rows[0].subplots(2, count, sharex=True, sharey="row", squeeze=False)
    clouds = rows[1].subplots(1, count, squeeze=False)[0] if whitened else []
    for number, name in enumerate(names):
        errors, colour = result.cameras[number], COLOURS[number % 4]
        axes[0, number].set_title(f"Camera {literal(name)}")
        axes[1, number].set_xlabel("frame")
        pan, focal = np.degrees(1.0), 100.0
        _size(axes[0, number], errors.pan_rad, errors.pan_sigma_rad, errors.pan_bound_rad, pan, colour)
        _size(axes[1, number], errors.focal, errors.focal_sigma, errors.focal_bound, focal, colour)
        if whitened:
            _cloud(clouds[number], errors, colour)
    axes[0, 0].set_ylabel("size of pan error [deg]")
    axes[1, 0].set_ylabel("size of focal error [%]")
    if whitened:
        clouds[0].set_ylabel("focal error / sigma")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    if handles:
        rows[0].legend(handles, labels, loc="outside upper left", ncols=3, handlelength=1.6)


@_as_svg
def top_view(figure: Figure, reconstruction: Reconstruction, truth: Truth | None, result: Score | None) -> None:
    """The athlete's path and the cameras from above at four instants, on a grid of 2 m (Fig. 11)."""
    frames = len(reconstruction.timecodes)
    instants = np.unique(np.linspace(0, frames - 1, 4).astype(int))
    low, high = _extent(reconstruction)
    figure.set_size_inches(11.5, 0.9 + 2.5 * (high[1] - low[1]) / (high[0] - low[0]) * 4 / len(instants))
    axes = figure.subplots(1, len(instants), sharex=True, sharey=True, squeeze=False)[0]
    axes[0].set_ylabel("y [m]")
    for plot, frame in zip(axes, instants, strict=True):
        _hall(plot, reconstruction, int(frame))
        plot.set_xlabel("x [m]")
        if truth is not None and result is not None:
            path = truth.joints_m[result.truth_frames, 0]
            plot.plot(path[:, 0], path[:, 1], color=INK, lw=3.0, alpha=0.2)
        motion = reconstruction.motion
        if motion is not None:
            path = motion.joints_m[motion.valid, 0]
            plot.plot(path[:, 0], path[:, 1], color="#34a853", lw=1.6)
            if motion.valid[frame]:
                plot.plot(*motion.joints_m[frame, 0, :2], "o", color=KEY, ms=5)
        plot.set_title(f"frame {frame}")


@_as_svg
def body_error(figure: Figure, body: BodyErrors, contradicted: Sequence[int], suggested: int | None) -> None:
    """Joint errors over time, and what made each stretch hard. The keyframes that the images contradict are crossed,
    and a line stands where another keyframe would help most."""
    figure.set_size_inches(11.5, 3.2)
    plot = figure.subplots()
    frames = np.arange(len(body.valid))
    millimetres = 1000.0 * body.joints_m
    _shade(plot, body.airborne, AIRBORNE, "airborne")
    _shade(plot, body.inverted, INVERTED, "inverted")
    mean, worst = millimetres.mean(axis=1), millimetres.max(axis=1)
    _line(plot, Series(worst.copy(), body.valid), MUTED, label="worst joint", lw=1.0)
    _line(plot, Series(mean.copy(), body.valid), INK, label="mean of the 16 joints", lw=1.8)
    keys = np.flatnonzero(body.keyframe)
    if len(keys):
        plot.plot(keys, np.zeros(len(keys)), "^", color=KEY, ms=6, clip_on=False, label="keyframe", zorder=5)
    if contradicted:
        crosses = np.zeros(len(contradicted))
        plot.plot(contradicted, crosses, "x", color=INK, ms=9, mew=2, clip_on=False, label="contradicted", zorder=6)
    if suggested is not None:
        plot.axvline(suggested, color=KEY, ls=":", lw=1.4, label="next keyframe")
    plot.set(xlabel="frame", ylabel="joint error [mm]", xlim=(0, max(frames[-1], 1)))
    # A single joint that is lost for a moment shall not flatten all the rest.
    top = max(1.3 * mean.max(), float(np.percentile(worst, 97)), 10.0)
    plot.set_ylim(0, top)
    if worst.max() > 1.1 * top:
        said = f"worst joint up to {worst.max():.0f} mm, in frame {int(worst.argmax())}"
        plot.set_title(said, loc="right", color="#5f6368", fontsize=8.5, fontweight="normal")
    plot.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=7, borderaxespad=0.2)


@_as_svg
def joint_bars(figure: Figure, body: BodyErrors) -> None:
    """Mean and 95th percentile of every joint."""
    figure.set_size_inches(11.5, 2.8)
    plot = figure.subplots()
    millimetres = 1000.0 * body.joints_m[body.scored]
    at = np.arange(len(JOINTS))
    plot.bar(at, np.percentile(millimetres, 95, axis=0), color="#dadce0", width=0.72, label="95th percentile")
    plot.bar(at, millimetres.mean(axis=0), color="#3b8ec2", width=0.72, label="mean")
    plot.set_xticks(at, [name.replace("_", "\n") for name in JOINTS])
    plot.set_ylabel("joint error [mm]")
    plot.grid(axis="x", visible=False)
    plot.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, borderaxespad=0.2)


@_as_svg
def silhouettes(figure: Figure, reconstruction: Reconstruction, result: Score) -> None:
    """Intersection over union and outline error of every camera over time."""
    figure.set_size_inches(11.5, 2.6)
    one, two = figure.subplots(1, 2, sharex=True)
    for number, (name, view) in enumerate(zip(reconstruction.camera_names, result.foreground or (), strict=True)):
        _line(one, view.iou, COLOURS[number % 4], label=f"camera {literal(name)}")
        _line(two, view.outline_px, COLOURS[number % 4])
    one.set(xlabel="frame", ylabel="intersection over union")
    two.set(xlabel="frame", ylabel="distance of the outlines [px]")
    two.set_ylim(0, None)
    one.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, borderaxespad=0.2, handlelength=1.4)


@_as_svg
def stage_times(figure: Figure, stage_s: Mapping[str, float]) -> None:
    """Wall time of each stage."""
    figure.set_size_inches(8.0, 0.5 + 0.32 * len(stage_s))
    plot = figure.subplots()
    names, seconds = list(stage_s), list(stage_s.values())
    bars = plot.barh(names, seconds, color="#3b8ec2", height=0.62)
    plot.bar_label(bars, [f"{value:.1f} s" for value in seconds], padding=4, color=INK)
    plot.invert_yaxis()
    plot.grid(axis="y", visible=False)
    plot.set(xlabel="wall time [s]", xlim=(0, 1.12 * max(seconds)))


# --------------------------------------------------------------------------------------------------------------


def _unwrapped(angles_rad: Array, valid: Mask) -> Array:
    """Angles (F,) without jumps of a turn between those that are ``valid``."""
    found = angles_rad.copy()
    found[valid] = np.unwrap(found[valid])
    return found


def _line(plot: Axes, series: Series, colour: str, **style: Any) -> None:
    """A line with gaps where the series is not valid."""
    frames = np.arange(len(series.valid))
    plot.plot(frames, np.ma.masked_array(series.values, ~series.valid), color=colour, **style)


def _error(plot: Axes, error: Series | None, sigma: Series | None, scale: float, colour: str) -> None:
    plot.axhline(0.0, color=MUTED, lw=0.8)
    if error is None:
        return
    if sigma is not None:
        frames = np.arange(len(error.valid))
        band = np.ma.masked_array(scale * sigma.values, ~sigma.valid)
        plot.fill_between(frames, -2 * band, 2 * band, color=colour, alpha=0.18, lw=0)
    _line(plot, Series(scale * error.values, error.valid), colour)


def _size(
    plot: Axes, error: Series | None, sigma: Series | None, least: Series | None, scale: float, colour: str
) -> None:
    """Size of the error on a logarithmic axis, the sigma that the estimate claims, and the bound."""
    plot.set_yscale("log")
    plot.grid(visible=True, which="major")
    plot.minorticks_off()
    if error is None:
        return
    frames = np.arange(len(error.valid))
    # an error that happens to be next to nothing shall not stretch the axis
    floor = 0.3 * float(least.values[least.valid].min()) if least is not None and least.valid.any() else 1e-9
    size = np.ma.masked_array(scale * np.maximum(np.abs(error.values), floor), ~error.valid)
    plot.plot(frames, size, ".", color=colour, ms=2.5, label="error")
    if sigma is not None:
        _line(plot, Series(scale * sigma.values, sigma.valid), colour, label="sigma claimed", lw=1.8)
    if least is not None:
        _line(plot, Series(scale * least.values, least.valid), INK, label="bound", lw=1.2, ls=(0, (4, 2)))


CHI_50, CHI_95, REACH = 1.1774, 2.4477, 4.0
"""Radii that hold half, and 95 %, of a plane's standard normal distribution; and of the plot."""


def _cloud(plot: Axes, errors: CameraErrors, colour: str) -> None:
    plot.set(xlim=(-REACH, REACH), ylim=(-REACH, REACH), aspect="equal", xlabel="pan error / sigma")
    for radius in (CHI_50, CHI_95):
        plot.add_patch(Circle((0.0, 0.0), radius, fill=False, ec=MUTED, lw=1.2))
    if errors.normalised is None or errors.nees is None:
        return
    dots = errors.normalised[errors.nees.valid]
    beyond = np.max(np.abs(dots), axis=1) > REACH
    plot.plot(*dots[~beyond].T, ".", color=colour, ms=3.5)
    edge = dots[beyond] / np.max(np.abs(dots[beyond]), axis=1, keepdims=True) * (REACH - 0.1)
    plot.plot(*edge.T, "x", color=KEY, ms=4)  # further out than the plot reaches
    nees = float(np.mean(errors.nees.values[errors.nees.valid]))
    verdict, ink = _verdict(nees)
    plot.set_title(f"NEES {nees:.3g}: {verdict}", color=ink, loc="center")
    inside = 100.0 * np.mean(np.hypot(*dots.T) < CHI_95)
    plot.text(0.02, 0.02, f"{inside:.0f} % inside", transform=plot.transAxes, color=INK, fontsize=8.0)


def _verdict(nees: float) -> tuple[str, str]:
    """In words, and a colour for them; the limits are those of the realistic case."""
    if 0.5 <= nees <= 2.0:
        return "believable", "#137a43"
    if nees < 0.5:
        return f"sigma {1.0 / np.sqrt(max(nees, 1e-6)):.2g}x too large", "#b06000"
    return f"sigma {np.sqrt(nees):.2g}x too small", KEY


def _shade(plot: Axes, where: Mask, colour: str, label: str) -> None:
    edges = np.diff(np.concatenate([[0], where.astype(np.int8), [0]]))
    for start, stop in zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True):
        plot.axvspan(start - 0.5, stop - 0.5, color=colour, alpha=0.13, lw=0, label=label)
        label = "_"


def triangle(camera: PanZoomCamera, pan_rad: float, focal_px: float) -> Array:
    """(4, 2) closed: the camera from above, its height the focal length, 4 m at the reference, its base the image."""
    apex, ahead = camera.world_T_head[:2, 3], camera.world_T_head[:2, :2] @ np.array([np.cos(pan_rad), np.sin(pan_rad)])
    scale = 4.0 / camera.lens.reference_focal_px
    side = np.array([-ahead[1], ahead[0]]) * scale * camera.lens.width / 2
    end = apex + scale * focal_px * ahead
    return np.array([apex, end + side, end - side, apex])


def _extent(reconstruction: Reconstruction) -> Array:
    """The least and the greatest (2, 2) x and y to show: at least a hall about the origin, with all cameras in it."""
    places = [camera.world_T_head[:2, 3] for camera in reconstruction.cameras if camera is not None]
    spanned = np.vstack([[-13.0, -10.5], [13.0, 10.5], *(place + off for place in places for off in (-1.0, 1.0))])
    return np.array([spanned.min(axis=0), spanned.max(axis=0)])


def _hall(plot: Axes, reconstruction: Reconstruction, frame: int) -> None:
    """The floor, and each camera as a triangle as long as its focal length."""
    low, high = _extent(reconstruction)
    plot.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    for axis, first, last in ((plot.xaxis, low[0], high[0]), (plot.yaxis, low[1], high[1])):
        ticks: NDArray[np.int64] = np.arange(2 * np.ceil(first / 2), last, 2).astype(int)
        axis.set_ticks(ticks, ["" if tick % 6 else str(tick) for tick in ticks])
    for number, (camera, track) in enumerate(zip(reconstruction.cameras, reconstruction.tracks, strict=True)):
        if camera is None or track is None:
            continue
        colour, apex = COLOURS[number % 4], camera.world_T_head[:2, 3]
        plot.plot(*apex, "o", color=colour, ms=4)
        if not track.valid[frame]:
            continue
        corners = triangle(camera, float(track.pan_rad[frame]), float(track.focal_px[frame]))
        plot.fill(corners[:, 0], corners[:, 1], color=colour, alpha=0.18, lw=0)
        plot.plot(corners[:, 0], corners[:, 1], color=colour, lw=1.0)
