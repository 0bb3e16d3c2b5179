"""Metrics of a run, summed up from its errors: those that need the truth."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from experiments.score import Score
from pzcap.scoring.metric import Metric, mean, rms
from pzcap.scoring.totals import angle_metrics, body_metrics, completeness, joined, scene_metrics


def metrics(result: Score) -> list[Metric]:
    """Every metric that needs the truth; its value is None where the run had not the material.

    Those that files alone can be scored by come from `pzcap.scoring.totals`, one by one, so that they stand in order.
    """
    cameras = result.cameras
    sweeps = [c.sweep_pan_rad for c in cameras if c.sweep_pan_rad is not None]
    positions = [c.position_m for c in cameras if c.position_m is not None]
    residuals = [c.reference_px for c in cameras if c.reference_px is not None]
    readouts = np.array([c.readout_s for c in cameras if c.readout_s is not None])
    clocks = np.array([c.clock_s for c in cameras if c.clock_s is not None])
    views = result.foreground or ()
    found = [
        Metric("reference.reprojection.rms", float(np.mean(residuals)) if residuals else None, "px"),
        Metric("reference.position.max", 1000.0 * max(positions) if positions else None, "mm"),
        Metric("panorama.pan.rms", rms(np.degrees(np.concatenate(sweeps))) if sweeps else None, "deg"),
        *angle_metrics(cameras),
        Metric("panzoom.refined.pan.rms", rms(np.degrees(joined([c.refined_pan_rad for c in cameras]))), "deg"),
        Metric("panzoom.refined.focal.rms", rms(100.0 * joined([c.refined_focal for c in cameras])), "%"),
        *scene_metrics(cameras, result.lost),
        Metric("cameras.readout.rms", 1000.0 * float(np.sqrt(np.mean(readouts**2))) if len(readouts) else None, "ms"),
        Metric("cameras.clock.rms", 1000.0 * float(clocks.std()) if len(clocks) else None, "ms"),
        Metric("foreground.iou", mean(joined([view.iou for view in views])), "1", "higher"),
        Metric("foreground.outline", mean(joined([view.outline_px for view in views])), "px"),
        Metric("foreground.shadow", mean(100.0 * joined([view.shadow for view in views])), "%"),
        *completeness(result.plain),
        *body_metrics(result.body),
    ]
    return [replace(metric, value=None) if result.own_world and _of_world(metric.key) else metric for metric in found]


def _of_world(key: str) -> bool:
    """True where a metric means nothing in a world that is not that of the truth: nobody says where it begins."""
    return not key.endswith("similarity") and key.startswith(_OF_WORLD)


_OF_WORLD: Final = (
    "reference.", "panzoom.pan.", "panzoom.refined.pan", "panzoom.reprojection", "panzoom.jac", "panzoom.rotation.rms",
    "panzoom.position", "panzoom.bound_ratio.pan", "panzoom.nees", "body.mpjpe", "body.covered", "body.beyond3",
    "body.lost",
)  # fmt: skip
