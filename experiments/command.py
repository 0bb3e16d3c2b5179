"""What the commands have in common that do more than one run on an experiment's configuration."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig
from rich.console import Console

from experiments.config import AppConfig, build, plain
from experiments.errors import guard, reported
from experiments.run import CONF
from experiments.studies.jobs import alone
from experiments.terminal import terminal

T = TypeVar("T")


def command(
    experiment: str,
    run: Callable[[AppConfig, dict[str, Any], Path, Console], T],
    show: Callable[[Console, str, T], None],
) -> int:
    """``run`` what Hydra composes, into its folder, and ``show`` under a title what came of it.

    ``experiment`` is taken where the command line names none. Exit status 0, or 1 with a line on stderr.
    """

    @hydra.main(version_base="1.3", config_path=str(CONF), config_name="config")
    def job(composed: DictConfig) -> None:
        out, err = terminal(), terminal(stderr=True)
        with reported():
            tree = plain(composed)
            config = build(tree)
            folder = Path(HydraConfig.get().runtime.output_dir)
            with alone(folder):
                found = run(config, tree, folder, err)
        show(out, f"{config.capture or config.shoot.motion}, seed {config.seed}", found)

    if not any(argument.startswith("experiment=") for argument in sys.argv[1:]):
        sys.argv.append(f"experiment={experiment}")
    return guard(job)
