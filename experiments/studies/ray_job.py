"""One job of a sweep in a process of a Ray cluster, which knows nothing yet and imports this module by its name."""

from __future__ import annotations

import gc
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from hydra.core.hydra_config import HydraConfig
from hydra.core.singleton import Singleton
from hydra.core.utils import JobReturn, JobStatus, configure_log, env_override, setup_globals
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig, open_dict, read_write

from experiments.studies.composer import Composer
from pzcap.types import PzcapError

if TYPE_CHECKING:
    from ray import ObjectRef

Shared: TypeAlias = tuple[HydraContext, DictConfig, TaskFunction, dict[Any, Any]]
"""All that the jobs of a sweep have in common, as the launcher has it."""


def require_plain(config: DictConfig) -> None:
    """Raise PzcapError where ``config`` asks for what `run_one` does not do."""
    if config.hydra.callbacks or config.hydra.job.chdir:
        raise PzcapError("hydra/launcher=ray: it has no hydra.callbacks and no hydra.job.chdir; leave them out")


def run_one(shared: list[ObjectRef[Shared]], number: int, overrides: Sequence[str]) -> JobReturn:
    """Run job ``number`` of what the launcher has ``shared``, in a list: else Ray would read it anew for every job.

    It does what Hydra's own `run_job` does, but for four copies of the configuration, which take it longer than all
    that a sweep adds to a job, and for hydra.output_subdir, which our sweeper's jobs have none of.
    """
    task, composer = _of_sweep(shared[0])
    config = composer.compose(overrides, number)
    folder = Path(config.hydra.sweep.dir).absolute() / str(config.hydra.sweep.subdir)
    with read_write(config.hydra.runtime), open_dict(config.hydra.runtime):
        config.hydra.runtime.output_dir = str(folder)
    HydraConfig.instance().set_config(config)
    folder.mkdir(parents=True, exist_ok=True)
    configure_log(config.hydra.job_logging, config.hydra.verbose)
    variables = config.hydra.job.env_set
    with read_write(config), open_dict(config):
        del config["hydra"]
    done = JobReturn(overrides=overrides)
    with env_override(variables):
        try:
            done.return_value, done.status = task(config), JobStatus.COMPLETED
        except Exception as error:
            done.return_value, done.status = error, JobStatus.FAILED
    return done


@lru_cache(maxsize=1)
def _of_sweep(shared: ObjectRef[Shared]) -> tuple[TaskFunction, Composer]:
    """The task and the composer of a sweep, once for all of its jobs that this process runs."""
    import ray

    context, config, task, singletons = ray.get(shared)
    setup_globals()
    Singleton.set_state(singletons)
    gc.freeze()  # 300,000 objects that stay: looking for garbage among them took half of a job's overhead
    return task, Composer(context.config_loader, config)
