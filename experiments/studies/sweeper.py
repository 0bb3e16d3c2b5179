"""A Hydra sweeper that runs only what is missing. `experiments.studies.jobs` says what a finished job is.

It is chosen by ``hydra/sweeper: resuming``; Hydra finds it in experiments/plugins. Which launcher runs the jobs
(hydra/launcher=joblib, submitit_slurm, ray, ...) is chosen as always: the launcher is given the missing jobs, and how
they go is read off the disk.
"""

from __future__ import annotations

import gc
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, cast

from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.conf import HydraConf
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import DictConfig, OmegaConf

from experiments import workers
from experiments.errors import AlreadyReported
from experiments.studies import jobs
from experiments.studies.composer import Composer
from experiments.terminal import terminal
from pzcap.io.text import one_line
from pzcap.types import PzcapError

POLL_S: Final = 0.2


@dataclass(frozen=True, slots=True)
class Job:
    """One job of the sweep."""

    overrides: tuple[str, ...]  # with which it is launched; its folder is among them
    folder: Path
    key: str

    @property
    def ended(self) -> bool:
        return jobs.finished(self.folder, self.key) or jobs.failure(self.folder) is not None


class Resuming(BasicSweeper):
    """Hydra's own grid of ``a=1,2 b=3,4``, or ``listed`` jobs, without those that are done already.

    ``listed`` are the overrides of each job, for sweeps that are no grid; those of the command line hold for all.
    """

    def __init__(
        self,
        max_batch_size: int | None = None,
        params: dict[str, str] | None = None,
        listed: Sequence[Sequence[str]] | None = None,
    ) -> None:
        super().__init__(max_batch_size, params)
        self._listed = listed

    def sweep(self, arguments: list[str]) -> Any:
        """Run what is missing, and show all. AlreadyReported if any job failed: each was said when it did."""
        assert self.launcher is not None
        assert self.config is not None
        gc.freeze()  # what has been imported stays: planning takes half the time without a look for garbage in it
        plan = self._plan(arguments)
        jobs.tidy({job.folder.parent for job in plan})
        workers.announce()
        if isinstance(options := getattr(self.launcher, "joblib", None), dict):  # joblib's workers may wait for a job
            options["initializer"] = workers.end_with_sweep
        missing = [job for job in plan if not jobs.finished(job.folder, job.key)]
        for job in missing:
            (job.folder / jobs.FAILED).unlink(missing_ok=True)
        size = self.max_batch_size or max(len(missing), 1)
        results: list[Any] = []
        with _progress(plan, missing):
            for start in range(0, len(missing), size):
                batch = [job.overrides for job in missing[start : start + size]]
                try:
                    results.append(self.launcher.launch(batch, initial_job_idx=start))
                except Exception as error:
                    why = one_line(f"{type(error).__name__}: {error}")
                    raise PzcapError(f"the launcher gave up ({why}); the same command goes on from here") from error
        _show(Path(self.config.hydra.sweep.dir), plan)
        _account(plan, missing)
        return results

    def _plan(self, arguments: list[str]) -> list[Job]:
        """Every job of the sweep, composed, so that one that cannot be is refused before any work."""
        assert self.hydra_context is not None
        assert self.config is not None
        if self._listed is None:
            parser = OverridesParser.create(config_loader=self.hydra_context.config_loader)
            parsed = parser.parse_overrides([*self._of_study(arguments), *arguments])
            (batch,) = self.split_arguments(parsed, None)
        else:
            batch = [[*map(str, overrides), *arguments] for overrides in self._listed]
        composer = Composer(self.hydra_context.config_loader, self.config)
        plan = (_planned(composer.compose(overrides, number), overrides) for number, overrides in enumerate(batch))
        return list({job.folder: job for job in plan}.values())

    def _of_study(self, arguments: Sequence[str]) -> list[str]:
        """The axes in hydra.sweeper.params, but for those that the command line has its own values for."""
        given = {argument.partition("=")[0] for argument in arguments}
        return [axis for axis in self._parse_config() if axis.partition("=")[0] not in given]


def _planned(config: DictConfig, overrides: Sequence[str]) -> Job:
    """The job of a composed configuration."""
    with _as_hydra(config):
        place, name = (str(OmegaConf.select(config, f"hydra.sweep.{part}")) for part in ("dir", "subdir"))
        wanted = jobs.key(jobs.tree_of(config))
    quoted = name.replace("\\", "\\\\").replace("'", "\\'")
    return Job((*overrides, f"hydra.sweep.subdir='{quoted}'", jobs.NO_HYDRA), Path(place) / name, wanted)


@contextmanager
def _as_hydra(config: DictConfig) -> Iterator[None]:
    """``${hydra:...}`` means that of ``config``: itself, not a copy of that part of it, as Hydra would have it."""
    before = HydraConfig.instance().cfg
    HydraConfig.instance().cfg = cast("HydraConf", config)
    try:
        yield
    finally:
        HydraConfig.instance().cfg = before


@contextmanager
def _progress(plan: Sequence[Job], missing: Sequence[Job]) -> Iterator[None]:
    """Say of each job that it ended, as it does, and how long the rest will take."""
    if len(plan) > 1:
        _say(f"{len(plan)} jobs: {len(plan) - len(missing)} done before, {len(missing)} to do")
    over = threading.Event()
    watcher = threading.Thread(target=_watch, args=(plan, missing, over), name="sweep", daemon=True)
    watcher.start()
    try:
        yield
    finally:
        over.set()
        watcher.join()


def _watch(plan: Sequence[Job], missing: Sequence[Job], over: threading.Event) -> None:
    start, running = time.perf_counter(), list(missing)
    while running:
        last = over.wait(POLL_S)
        for job in [job for job in running if job.ended]:
            running.remove(job)
            name = job.folder.name
            reason = None if jobs.finished(job.folder, job.key) else jobs.failure(job.folder)
            if reason is not None:
                _say(f"error: {name}: {reason}" if len(plan) > 1 else f"error: {reason}")
            elif len(plan) > 1:
                ended = len(missing) - len(running)
                left = (time.perf_counter() - start) / ended * len(running)
                about = f", about {_words(left)} left" if running else ""
                _say(f"{len(plan) - len(running)} of {len(plan)}: {name} is done{about}")
        if last:
            return


def _account(plan: Sequence[Job], missing: Sequence[Job]) -> None:
    """Raise AlreadyReported if any job of the sweep is without a result."""
    without = [job for job in missing if not jobs.finished(job.folder, job.key)]
    for job in without:
        if jobs.failure(job.folder) is None:
            changed = (job.folder / jobs.MARK).exists()  # other processes read the code later than this one
            why = "the code changed while it ran" if changed else "ended without a result or a reason"
            _say(f"error: {job.folder.name}: {why}")
    if without and len(plan) > 1:
        _say(f"{len(without)} of {len(plan)} jobs failed; the same command runs them again")
    if without:
        raise AlreadyReported(f"{len(without)} jobs failed")


def _show(folder: Path, plan: Sequence[Job]) -> None:
    """The table and the page of the sweep, where its jobs are such as have metrics."""
    from experiments.studies import page

    if page.write_study(folder, [job.folder for job in plan if job.ended]):
        _say(f"{folder}/{page.PAGE}")


def _words(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _say(line: str) -> None:
    terminal(stderr=True).print(line, highlight=False, soft_wrap=True)
