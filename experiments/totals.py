"""Metrics of a run, summed up from its errors: those that need the truth."""

from __future__ import annotations

from typing import Final

import numpy as np

from experiments.metrics import Metric
from experiments.score import BodyErrors, Score
from experiments.silhouette_score import Series
from pzcap.types import Array

LOST_M: Final = 0.1
"""Error of a joint from which on a frame counts as lost, m."""


def metrics(result: Score) -> list[Metric]:
    """Every metric that needs the truth; its value is None where the run had not the material."""
    cameras = result.cameras
    pan = np.degrees(_joined([c.pan_rad for c in cameras]))
    focal = 100.0 * _joined([c.focal for c in cameras])
    sweeps = [c.sweep_pan_rad for c in cameras if c.sweep_pan_rad is not None]
    parts = [c.reprojection_points_px for c in cameras if c.reprojection_points_px is not None]
    points = np.concatenate(parts) if parts else np.zeros(0)
    positions = [c.position_m for c in cameras if c.position_m is not None]
    residuals = [c.reference_px for c in cameras if c.reference_px is not None]
    found = [
        Metric("reference.reprojection.rms", float(np.mean(residuals)) if residuals else None, "px"),
        Metric("reference.position.max", 1000.0 * max(positions) if positions else None, "mm"),
        Metric("panorama.pan.rms", _rms(np.degrees(np.concatenate(sweeps))) if sweeps else None, "deg"),
        *_spread("panzoom.pan", pan, "deg"),
        *_spread("panzoom.focal", focal, "%"),
        Metric("panzoom.refined.pan.rms", _rms(np.degrees(_joined([c.refined_pan_rad for c in cameras]))), "deg"),
        Metric("panzoom.refined.focal.rms", _rms(100.0 * _joined([c.refined_focal for c in cameras])), "%"),
        Metric("panzoom.reprojection.rms", _rms(points), "px"),
        Metric("panzoom.reprojection.p95", _percentile(points, 95), "px"),
        Metric("panzoom.lost", float(result.lost) if any(c.pan_rad for c in cameras) else None, "frames"),
        Metric("panzoom.bound_ratio.pan", _over([(c.pan_rad, c.pan_bound_rad) for c in cameras]), "1"),
        Metric("panzoom.bound_ratio.focal", _over([(c.focal, c.focal_bound) for c in cameras]), "1"),
        Metric("panzoom.nees", _mean(_joined([c.nees for c in cameras])), "1"),
    ]
    views = result.foreground or ()
    found += [
        Metric("foreground.iou", _mean(_joined([view.iou for view in views])), "1", "higher"),
        Metric("foreground.outline", _mean(_joined([view.outline_px for view in views])), "px"),
        Metric("foreground.shadow", _mean(100.0 * _joined([view.shadow for view in views])), "%"),
    ]
    return found + body_metrics(result.body)


def body_metrics(body: BodyErrors | None) -> list[Metric]:
    """The metrics of the body; all values are None if no motion was tracked."""
    if body is None:
        none = np.zeros((0, 16))
        scored = inverted = airborne = covered = none
        limbs = np.zeros(0)
        keyframes = lost = None
    else:
        millimetres = 1000.0 * body.joints_m
        scored = millimetres[body.scored]
        inverted = millimetres[body.scored & body.inverted]
        airborne = millimetres[body.scored & body.airborne]
        covered = 100.0 * (body.joints_m <= body.sigma_m)[body.scored].astype(np.float64)
        limbs = 100.0 * body.limbs
        keyframes = float(np.sum(body.keyframe))
        lost = float(np.sum(~body.valid | np.any(body.joints_m > LOST_M, axis=1)))
    return [
        Metric("body.mpjpe.mean", _mean(scored), "mm"),
        Metric("body.mpjpe.p95", _percentile(scored, 95), "mm"),
        Metric("body.mpjpe.max", float(scored.max()) if scored.size else None, "mm"),
        Metric("body.mpjpe.inverted", _mean(inverted), "mm"),
        Metric("body.mpjpe.airborne", _mean(airborne), "mm"),
        Metric("body.mpjpe.true_cameras", None, "mm"),
        Metric("body.covered", _mean(covered), "%", "higher"),  # by one sigma: 68 of an honest one
        Metric("body.limb.rms", _rms(limbs), "%"),
        Metric("body.limb.max", float(np.abs(limbs).max()) if limbs.size else None, "%"),
        Metric("body.keyframes", keyframes, "frames"),
        Metric("body.lost", lost, "frames"),
    ]


def _joined(series: list[Series | None] | list[Series]) -> Array:
    """The valid values of all ``series``, (N,)."""
    parts = [one.values[one.valid] for one in series if one is not None]
    return np.concatenate(parts) if parts else np.zeros(0)


def _over(pairs: list[tuple[Series | None, Series | None]]) -> float | None:
    """RMS error over the RMS of its bound, in the frames that have both."""
    both = [(e, b, e.valid & b.valid) for e, b in pairs if e is not None and b is not None]
    error = _rms(np.concatenate([e.values[at] for e, _, at in both])) if both else None
    least = _rms(np.concatenate([b.values[at] for _, b, at in both])) if both else None
    return None if error is None or not least else error / least


def _spread(key: str, errors: Array, unit: str) -> list[Metric]:
    """RMS, median, 95th percentile and maximum of errors (N,)."""
    size = np.abs(errors)
    return [
        Metric(f"{key}.rms", _rms(errors), unit),
        Metric(f"{key}.median", _percentile(size, 50), unit),
        Metric(f"{key}.p95", _percentile(size, 95), unit),
        Metric(f"{key}.max", float(size.max()) if size.size else None, unit),
    ]


def _rms(values: Array) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if values.size else None


def _mean(values: Array) -> float | None:
    return float(np.mean(values)) if values.size else None


def _percentile(values: Array, percent: float) -> float | None:
    return float(np.percentile(values, percent)) if values.size else None
