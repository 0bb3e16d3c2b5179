"""One job of a sweep in a process of a Ray cluster, which knows nothing yet and imports this module by its name."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.core.singleton import Singleton
from hydra.core.utils import JobReturn, run_job, setup_globals
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig, open_dict


def run_one(
    shared: tuple[HydraContext, DictConfig, TaskFunction, dict[Any, Any]], number: int, overrides: Sequence[str]
) -> JobReturn:
    """Run job ``number`` of what the launcher has ``shared``; its return."""
    context, config, task, singletons = shared
    setup_globals()
    Singleton.set_state(singletons)
    composed = context.config_loader.load_sweep_config(config, list(overrides))
    with open_dict(composed):
        composed.hydra.job.num, composed.hydra.job.id = number, str(number)
    HydraConfig.instance().set_config(composed)
    return run_job(
        hydra_context=context,
        task_function=task,
        config=composed,
        job_dir_key="hydra.sweep.dir",
        job_subdir_key="hydra.sweep.subdir",
    )
