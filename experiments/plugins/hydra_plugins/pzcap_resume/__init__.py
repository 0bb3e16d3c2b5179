"""``hydra/sweeper: resuming``. Hydra takes plugins from this namespace alone; the work is in
`experiments.studies.sweeper`."""

from hydra.core.config_store import ConfigStore

from experiments.studies.sweeper import Resuming


class ResumingSweeper(Resuming):
    """Runs the jobs that are missing."""


ConfigStore.instance().store(
    group="hydra/sweeper",
    name="resuming",
    node={
        "_target_": f"{ResumingSweeper.__module__}.{ResumingSweeper.__name__}",
        "max_batch_size": None,
        "params": None,
        "listed": None,
    },
    provider="pzcap",
)
