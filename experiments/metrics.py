"""The file that holds the metrics of a run, their targets, and how people read them."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Final

from pzcap.io.files import checked, write_bytes
from pzcap.scoring.metric import Metric
from pzcap.types import PzcapError

TARGETS: Final[Mapping[str, float]] = {
    "panzoom.pan.rms": 0.003,
    "panzoom.focal.rms": 0.03,
    "panzoom.reprojection.rms": 0.12,
    "panzoom.lost": 0.0,
    "foreground.iou": 0.93,
    "foreground.outline": 0.7,
    "foreground.shadow": 1.0,
    "body.mpjpe.mean": 10.0,
    "body.mpjpe.p95": 25.0,
    "body.mpjpe.inverted": 15.0,
    "body.mpjpe.airborne": 15.0,
    "body.lost": 0.0,
    "speed.panzoom": 15.0,
    "speed.fps": 15.0,
    "memory.peak": 1500.0,
}
"""Targets of the floor exercise and the pedestrian with all troubles of optics and sensor on, on two cores."""


def meets_target(metric: Metric) -> bool | None:
    """True if ``metric`` reaches its target; None where it has no target or no value."""
    target = TARGETS.get(metric.key)
    if target is None or metric.value is None:
        return None
    return metric.value <= target if metric.direction == "lower" else metric.value >= target


def run_info(config: Mapping[str, Any], seed: int, notes: Sequence[str] = ()) -> dict[str, Any]:
    """Everything needed to run it again: configuration, seed, versions, and the kind of machine (never its name); and
    the ``notes`` of the reconstruction, what it said of the footage by itself."""
    info = {"config": dict(config), "seed": seed, "versions": versions(), "machine": machine()}
    return {**info, "notes": list(notes)}


@cache
def versions() -> dict[str, str]:
    """Versions of everything that the numbers can depend on."""
    found = {"python": platform.python_version()}
    for package in ("pzcap", "numpy", "scipy", "opencv-python-headless", "av", "numba", "mujoco", "rerun-sdk"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


def machine() -> dict[str, Any]:
    """CPU model and cores."""
    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        for line in cpuinfo.read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                model = line.partition(":")[2].strip()
                break
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {"cpu": model, "cores": cores, "system": platform.system()}


def write_metrics(path: Path, metrics: Iterable[Metric], run: Mapping[str, Any]) -> None:
    """Write metrics.json. Whole or not at all."""
    write_bytes(path, metrics_text(metrics, run).encode(errors="backslashreplace"))  # as JSON has it


def metrics_text(metrics: Iterable[Metric], run: Mapping[str, Any]) -> str:
    """Contents of metrics.json: key -> {value, unit, direction}, and ``_run``."""
    content: dict[str, Any] = {
        metric.key: {"value": metric.value, "unit": metric.unit, "direction": metric.direction} for metric in metrics
    }
    content["_run"] = dict(run)
    return json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def read_metrics(path: Path) -> tuple[tuple[Metric, ...], dict[str, Any]]:
    """The metrics of metrics.json, and its ``_run``. Raises PzcapError if it holds anything else."""
    try:
        content = json.loads(checked(path).read_text(encoding="utf-8"))
        run = content.pop("_run")
        metrics = tuple(Metric(key, **entry) for key, entry in content.items())
        known = all(isinstance(metric.value, int | float | None) and isinstance(metric.unit, str) for metric in metrics)
        notes = run.setdefault("notes", [])  # which older files have not
        known &= isinstance(notes, list) and all(isinstance(note, str) for note in notes)
        if not known or not isinstance(run["config"], dict) or not isinstance(run["versions"], dict):
            raise ValueError("a value of another kind")
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise PzcapError(f"{path}: not readable metrics ({error}); remove its folder and run again") from error
    return metrics, run


def format_value(metric: Metric) -> str:
    """The value as people read it: three significant digits, counts whole, a dash where there is none."""
    if metric.value is None:
        return "–"
    if float(metric.value).is_integer():
        return f"{metric.value:.0f}"
    magnitude = abs(metric.value)
    if magnitude >= 100:
        return f"{metric.value:.0f}"
    if magnitude >= 10:
        return f"{metric.value:.1f}"
    if magnitude >= 1:
        return f"{metric.value:.2f}"
    return f"{metric.value:.3g}"
