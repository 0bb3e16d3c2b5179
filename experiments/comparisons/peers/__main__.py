"""Other people's ways to pan and focal length beside ours, on the same frames. docs/peers.md.

    python -m experiments.comparisons.peers experiment=floor_exercise seed=0 every=10
    python -m experiments.comparisons.peers capture=FOLDER methods=[ours,sift,hugin]
    reconstruction=RESULTS/reconstruction python -m experiments.comparisons.peers capture=FOLDER_OF_FRAMES

prints a table, and leaves metrics.json, answers.csv and errors.png in outputs/peers/EXPERIMENT/SEED, or in the folder
given by hydra.run.dir=FOLDER.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import hydra
from hydra.core.config_store import ConfigStore
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig
from rich.console import Console

from experiments import footage
from experiments.comparisons.peers import bench, show
from experiments.comparisons.peers.folder import from_folder, is_folder_of_frames
from experiments.comparisons.peers.material import Material, from_capture
from experiments.config import AppConfig, default_tree, plain, structured
from experiments.errors import guard, reported
from experiments.metrics import run_info, write_metrics
from experiments.progress import Bars
from experiments.run import CONF
from experiments.studies.jobs import alone
from experiments.terminal import terminal
from pzcap.io.capture import MANIFEST, read_capture
from pzcap.types import PzcapError


@dataclass(frozen=True, slots=True)
class PeersConfig(AppConfig):
    """Everything that `python -m experiments.comparisons.peers` can be told: what a run can, and this."""

    every: int = 10
    """Locate every so many-th frame."""
    methods: tuple[str, ...] = ()
    """Of bench.METHODS; none: all."""
    reconstruction: str | None = None
    """A folder that a run left of the same capture; null: calibrate now."""


def run(config: PeersConfig, tree: dict[str, Any], folder: Path, console: Console) -> tuple[bench.Result, ...]:
    """The bench, its results into ``folder``. PzcapError for what the user can mend."""
    names = bench.choose(config.methods)
    if config.method != AppConfig().method:
        raise PzcapError(f"method={config.method}: the bench runs all methods; choose with methods=[ours,paper,...]")
    folder.mkdir(parents=True, exist_ok=True)
    for name in show.RESULTS:
        (folder / name).unlink(missing_ok=True)
    with Bars(console) as bars:
        material = _material(config, "paper" in names, bars)
    with Bars(console) as bars:
        results = bench.run(material, names, config.every, bars.update)
    show.write_answers(folder / "answers.csv", material, results)
    show.write_plot(folder / "errors.png", results)
    write_metrics(folder / "metrics.json", bench.metrics(results), run_info(tree, config.seed))
    return results


def _material(config: PeersConfig, with_paper: bool, bars: Bars) -> Material:
    named = None if config.capture is None else Path(config.capture).resolve()
    panzoom = config.reconstruct.panzoom
    if named is not None and is_folder_of_frames(named):
        return from_folder(named, panzoom, bars.update)
    shot = footage.capture_of(config, bars.update)
    if not (shot / MANIFEST).exists():
        raise PzcapError(
            f"{shot}: holds neither {MANIFEST} (docs/capture.md) nor camera.json (docs/peers.md); give a folder of one"
        )
    finished = None if config.reconstruction is None else Path(config.reconstruction)
    truth = footage.truth_beside(shot)
    return from_capture(read_capture(shot), truth, finished, panzoom, with_paper, bars.update)


ConfigStore.instance().store(name="peers_base", node=default_tree(PeersConfig))


@hydra.main(version_base="1.3", config_path=str(CONF), config_name="peers")
def _job(composed: DictConfig) -> None:
    out, err = terminal(), terminal(stderr=True)
    with reported():
        tree = plain(composed)
        config = structured(tree, PeersConfig, "configuration")
        folder = Path(HydraConfig.get().runtime.output_dir)
        with alone(folder):
            results = run(config, tree, folder, err)
    what = config.capture or f"{HydraConfig.get().runtime.choices['experiment']}, seed {config.seed}"
    show.print_table(out, f"{what}, every {config.every}. frame", results)
    shown = os.path.relpath(folder) if folder.is_relative_to(Path.cwd()) else folder
    for name in show.RESULTS:
        out.print(f"{shown}/{name}", highlight=False, soft_wrap=True)


def main() -> int:
    """The command. Exit status 0, or 1 with a line on stderr."""
    command: Callable[[], object] = _job
    return guard(command, PeersConfig)


if __name__ == "__main__":
    sys.exit(main())
