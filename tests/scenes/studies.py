"""Finished runs of a study, made up: their metrics without their footage, or their recordings."""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Sequence
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.types import RunMode
from omegaconf import DictConfig

from experiments import run
from experiments.config import default_tree
from experiments.metrics import run_info, write_metrics
from experiments.report import recording
from experiments.studies import jobs
from experiments.studies.composer import Composer
from pzcap.scoring.metric import Metric
from pzcap.types import Capture
from pzcap.viewer.recording import Recorder
from tests.scenes import fabricated

NOISE, ZOOM = "shoot.sensor.read_noise", "shoot.optics.zoom_max"


def composed(*overrides: str, hydra: bool = False) -> DictConfig:
    """Hydra's configuration that ``overrides`` give."""
    GlobalHydra.instance().clear()
    with initialize_config_dir(str(run.CONF), version_base="1.3"):
        return compose("config", overrides=list(overrides), return_hydra_config=hydra)


@cache
def _composer() -> Composer:
    """Composer of a sweep's jobs: Hydra itself, which composes the same, takes fifteen times as long."""
    GlobalHydra.instance().clear()
    with initialize_config_dir(str(run.CONF), version_base="1.3"):
        hydra = GlobalHydra.instance().hydra
        assert hydra is not None
        loader = hydra.config_loader
        return Composer(loader, loader.load_configuration("config", [], run_mode=RunMode.MULTIRUN))


def job_tree(*overrides: str) -> dict[str, Any]:
    """The configuration of a job, as a sweep composes it."""
    return jobs.tree_of(_composer().compose(overrides, 0))


def fabricate(
    folder: Path, overrides: Sequence[str], *, bounded: bool = True, lost: float = 0.0, notes: Sequence[str] = ()
) -> Path:
    """A finished run whose errors are three times their bound, and whose reconstruction said ``notes``."""
    config = job_tree(*overrides)
    noise, zoom = config["shoot"]["sensor"]["read_noise"], config["shoot"]["optics"]["zoom_max"]
    error = (1.0 + noise + 0.1 * config["seed"]) / zoom / 1000
    found = [
        Metric("panzoom.pan.rms", error, "deg"),
        Metric("panzoom.focal.rms", 10 * error, "%"),
        Metric("panzoom.bound_ratio.pan", 3.0 if bounded else None, "1"),
        Metric("panzoom.bound_ratio.focal", 3.0 if bounded else None, "1"),
        Metric("panzoom.lost", lost, "frames"),
        Metric("body.mpjpe.mean", None, "mm"),
    ]
    place = folder / re.sub(r"[^\w.,=]", "_", ",".join(overrides))
    place.mkdir(parents=True)
    write_metrics(place / "metrics.json", found, run_info(config, config["seed"], notes))
    (place / jobs.MARK).write_text(json.dumps({"key": "", "overrides": list(overrides), "seconds": 1.5}))
    (place / "report.html").write_text("a report")
    return place


def grid(folder: Path, values: dict[str, Sequence[Any]], **how: Any) -> list[Path]:
    """A finished run for every combination of ``values``."""
    jobs_ = itertools.product(*([f"{key}={value}" for value in values[key]] for key in values))
    return [fabricate(folder, overrides, **how) for overrides in jobs_]


def record(path: Path, noise: float, seed: int) -> None:
    """A run without footage, of some pan error."""
    path.parent.mkdir(parents=True)
    capture = Capture(path.parent, "fabricated", Fraction(30), (), None, None, {}, full_turn=True)
    tree = default_tree()
    tree["shoot"]["sensor"]["read_noise"], tree["seed"] = noise, seed
    found = [Metric("panzoom.pan.rms", 0.001 * (noise + seed), "deg"), Metric("body.mpjpe.mean", None, "mm")]
    with Recorder(path, capture, name=f"noise {noise}") as recorder:
        recording.summarise(recorder, fabricated.reconstruction(), found, run_info(tree, seed))
