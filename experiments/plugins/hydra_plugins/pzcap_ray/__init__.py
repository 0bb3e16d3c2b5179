"""``hydra/launcher: ray``: a sweep's jobs on a Ray cluster, or on this machine where RAY_ADDRESS names none.

Hydra's own plugin of that name wants Amazon's client and a cloudpickle that joblib no longer takes; this one wants Ray.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any, Final

from hydra.core.config_store import ConfigStore
from hydra.core.singleton import Singleton
from hydra.core.utils import JobReturn, setup_globals
from hydra.plugins.launcher import Launcher
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig, OmegaConf

from experiments.studies.ray_job import require_plain, run_one

HERE: Final = {"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0"}
"""Ray's switch for machines that are to be no part of a cluster, read when it is imported and inherited by all that it
starts: it then uses the loopback address. Everywhere else it listens on all interfaces and lets anyone run code, and
does so even if told that the address of the node is 127.0.0.1, for which it substitutes an address of the network."""


class RayLauncher(Launcher):
    """A Ray task a job. ``init`` goes to ray.init, ``remote`` (what a job takes of its machine) to ray.remote."""

    def __init__(self, init: DictConfig, remote: DictConfig) -> None:
        self._init: Any = OmegaConf.to_container(init, resolve=True)
        self._remote: Any = OmegaConf.to_container(remote, resolve=True)

    def setup(self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig) -> None:
        """Keep what Hydra hands to every launcher before the sweep. PzcapError where it asks for what Ray's jobs have
        not."""
        require_plain(config)
        self._context, self._task, self._config = hydra_context, task_function, config

    def launch(self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int) -> Sequence[JobReturn]:
        """Run the jobs, as many at once as the cluster has room for; their returns in the order given."""
        start = self._init
        if not (os.environ.get("RAY_ADDRESS") or start.get("address")):
            os.environ.update(HERE)
            start = start | {"address": "local"}
        import ray  # an optional extra, wanted by nothing before this

        setup_globals()
        if not ray.is_initialized():
            ray.init(**start)
        job = ray.remote(**self._remote)(run_one)
        shared = ray.put((self._context, self._config, self._task, Singleton.get_state()))
        running = [job.remote([shared], number, given) for number, given in enumerate(job_overrides, initial_job_idx)]
        return list(ray.get(running))


ConfigStore.instance().store(
    group="hydra/launcher",
    name="ray",
    node={
        "_target_": f"{RayLauncher.__module__}.{RayLauncher.__name__}",
        "init": {"include_dashboard": False, "log_to_driver": False, "logging_level": "error"},
        "remote": {"num_cpus": 1},
    },
    provider="pzcap",
)
