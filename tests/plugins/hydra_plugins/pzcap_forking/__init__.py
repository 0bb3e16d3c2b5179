"""A Hydra launcher for the tests: two jobs at a time, each in a process of its own that shares nothing but the disk."""

from __future__ import annotations

import multiprocessing
import pickle
from collections.abc import Sequence
from typing import Any

from hydra.core.config_store import ConfigStore
from hydra.core.utils import JobReturn, run_job
from hydra.plugins.launcher import Launcher
from omegaconf import open_dict


class ForkingLauncher(Launcher):
    def setup(self, *, hydra_context: Any, task_function: Any, config: Any) -> None:
        self.context, self.task, self.config = hydra_context, task_function, config

    def launch(self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int) -> Sequence[JobReturn]:
        """Numbers the jobs from behind, as a queue would that knows no order."""
        waiting = list(enumerate(job_overrides, initial_job_idx))
        running: list[Any] = []
        while waiting or running:
            while waiting and len(running) < 2:
                process = multiprocessing.get_context("fork").Process(target=self._job, args=waiting.pop())
                process.start()
                running.append(process)
            running[0].join(0.01)
            running = [process for process in running if process.is_alive()]
        return []

    def _job(self, number: int, overrides: Sequence[str]) -> None:
        config = self.context.config_loader.load_sweep_config(self.config, list(overrides))
        with open_dict(config):
            config.hydra.job.num = number
        done = run_job(
            hydra_context=self.context,
            task_function=self.task,
            config=config,
            job_dir_key="hydra.sweep.dir",
            job_subdir_key="hydra.sweep.subdir",
        )
        pickle.dumps(done.return_value)  # other launchers send it home


ConfigStore.instance().store(
    group="hydra/launcher",
    name="forking",
    node={"_target_": "hydra_plugins.pzcap_forking.ForkingLauncher"},
    provider="tests",
)
