"""Comparisons: one thing changed at a time on the same material, and what that does to the figures.

    python -m experiments.compare ablation seed=0                       # error budget of the body
    python -m experiments.compare operators seed=0                      # pan and zoom, pan only, locked (section 6.2)
    python -m experiments.compare keypoints seed=0                      # without keypoints, with them, from them alone
    python -m experiments.compare detectors seed=0                      # a hand, simulated detectors, a real one
    python -m experiments.compare fixed_tools seed=0                    # Pose2Sim, aniposelib, on virtual fixed cameras
    python -m experiments.compare burden seed=0                         # what each thing that a crew brings is worth
    python -m experiments.compare forecast seed=0                       # what `pzcap check` foresees, what is reached
    python -m experiments.compare wrong_footage seed=0                  # is what is wrong with a capture named?
    python -m experiments.compare treated_footage seed=0                # dates, bars, filters: what each costs
    python -m experiments.compare peers every=10 methods=[ours,sift]    # other ways to pan and zoom, docs/peers.md
    python -m experiments.compare self_calibration seed=0               # against three self-calibrations

Every comparison takes what a run takes (capture=FOLDER, experiment=..., any setting), prints a table, and leaves
metrics.json, NAME.csv and its plots in the folder given by hydra.run.dir=FOLDER. `--about` after a name says more of
it.
"""

from __future__ import annotations

import importlib
import os
import sys
from pathlib import Path
from typing import Any, Final

import hydra
from hydra.core.config_store import ConfigStore
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from experiments.comparisons.harness import Comparison, execute, print_rows
from experiments.config import default_tree, nearest, plain, structured
from experiments.errors import guard, reported
from experiments.run import CONF
from experiments.studies.jobs import alone
from experiments.terminal import terminal
from pzcap.types import PzcapError

NAMES: Final = (
    "ablation", "operators", "keypoints", "detectors", "burden", "fixed_tools", "forecast", "wrong_footage",
    "treated_footage", "peers", "self_calibration",
)  # fmt: skip


def comparison(name: str) -> tuple[Comparison[Any], str]:
    """The comparison of that name, and what is said of it. Raises PzcapError, with those that there are, where there is
    none."""
    if name not in NAMES:
        raise PzcapError(f"no comparison '{name}'; {nearest(name, NAMES)}: one of {', '.join(NAMES)}")
    module = importlib.import_module(f"experiments.comparisons.{name}")
    return module.COMPARISON, (module.__doc__ or "").strip()


def _run(name: str) -> None:
    chosen, about = comparison(name)
    if "--about" in sys.argv:
        print(about)
        return
    ConfigStore.instance().store(name=f"{name}_base", node=default_tree(chosen.config))

    @hydra.main(version_base="1.3", config_path=str(CONF), config_name=chosen.config_name)
    def job(composed: DictConfig) -> None:
        out, err = terminal(), terminal(stderr=True)
        with reported():
            tree = plain(composed)
            config = structured(tree, chosen.config, "configuration")
            folder = Path(HydraConfig.get().runtime.output_dir)
            with alone(folder):
                rows = execute(chosen, config, tree, folder, err)
        title = f"{config.capture or HydraConfig.get().runtime.choices['experiment']}, seed {config.seed}"
        print_rows(out, chosen, title, rows)
        shown = os.path.relpath(folder) if folder.is_relative_to(Path.cwd()) else folder
        for file in chosen.results:
            out.print(f"{shown}/{file}", highlight=False, soft_wrap=True)

    if not any(argument.startswith("experiment=") for argument in sys.argv[1:]):
        sys.argv.append(f"experiment={chosen.experiment}")
    job()


def main() -> int:
    """The command. Exit status 0, or 1 with a line on stderr."""
    name = sys.argv.pop(1) if len(sys.argv) > 1 and not sys.argv[1].startswith("-") else ""
    if not name:
        print((__doc__ or "").strip())
        return 0 if len(sys.argv) > 1 else 1
    config = comparison(name)[0].config if name in NAMES else None
    return guard(lambda: _run(name), config) if config else guard(lambda: _run(name))


if __name__ == "__main__":
    sys.exit(main())
