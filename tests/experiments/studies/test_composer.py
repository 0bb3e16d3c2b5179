"""Configurations of a sweep's jobs: what Hydra itself would compose, in less time."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from hydra import initialize_config_dir
from hydra.core.config_loader import ConfigLoader
from hydra.core.global_hydra import GlobalHydra
from hydra.errors import ConfigCompositionException, MissingConfigException
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf, open_dict

from experiments.run import CONF
from experiments.studies import jobs, ray_job
from experiments.studies.composer import Composer
from pzcap.types import PzcapError


@pytest.fixture
def sweep() -> Iterator[tuple[ConfigLoader, DictConfig]]:
    with initialize_config_dir(str(CONF), version_base="1.3"):
        hydra = GlobalHydra.instance().hydra
        assert hydra is not None
        given = ["hydra/launcher=joblib"]
        yield hydra.config_loader, hydra.config_loader.load_configuration("config", given, run_mode=RunMode.MULTIRUN)


@pytest.mark.parametrize(
    "overrides",
    [
        [],
        ["seed=3", "shoot.sensor.read_noise=2.5", "estimator=null"],
        ["method=paper", "experiment=clean", "seed=1"],
        ["study=noise", "shoot.sensor.read_noise=0.5", "hydra.sweep.subdir='a b=c'", "hydra.output_subdir=null"],
        ["output={report: false, jpeg_quality: 9}", "output.jpeg_quality=${seed}"],
        ["+beside=1", "seed=2"],
        ["~output.report", "seed=2"],
    ],
    ids=" ".join,
)
def test_a_job_is_composed_as_by_hydra(sweep: tuple[ConfigLoader, DictConfig], overrides: list[str]) -> None:
    """The second of its kind, too, which is a copy of the first with other values."""
    loader, config = sweep
    wanted = loader.load_sweep_config(config, overrides)
    with open_dict(wanted):
        wanted.hydra.job.num, wanted.hydra.job.id = 7, "7"
    composer = Composer(loader, config)
    for number in (3, 7):
        found = composer.compose(overrides, number)
    assert OmegaConf.to_container(found, resolve=False) == OmegaConf.to_container(wanted, resolve=False)


@pytest.mark.parametrize(
    ("wrong", "error"), [("sed=3", ConfigCompositionException), ("experiment=no", MissingConfigException)]
)
def test_what_cannot_be_is_refused_in_hydras_words(
    sweep: tuple[ConfigLoader, DictConfig], wrong: str, error: type[Exception]
) -> None:
    loader, config = sweep
    with pytest.raises(error) as by_hydra:
        loader.load_sweep_config(config, [wrong])
    with pytest.raises(error) as found:
        Composer(loader, config).compose(["seed=1", wrong], 0)
    assert str(found.value) == str(by_hydra.value)


def test_jobs_do_not_share_what_one_of_them_changes(sweep: tuple[ConfigLoader, DictConfig]) -> None:
    composer = Composer(*sweep)
    first = composer.compose(["seed=1"], 0)
    first.shoot.width = 1
    assert composer.compose(["seed=2"], 1).shoot.width == 640


def test_a_configuration_is_written_as_omegaconf_writes_it() -> None:
    tree = {"name": "1e3", "on": "yes", "none": None, "list": [1, 2.5, "ä: b"], "deep": {"empty": {}, "flag": True}}
    assert jobs._yaml(tree) == OmegaConf.to_yaml(OmegaConf.create(tree))


@pytest.mark.parametrize("given", ["hydra.job.chdir=true", "+hydra.callbacks.one._target_=a.B"])
def test_what_ray_jobs_do_not_do_is_refused(sweep: tuple[ConfigLoader, DictConfig], given: str) -> None:
    loader, config = sweep
    ray_job.require_plain(config)
    asked = loader.load_configuration("config", [given], run_mode=RunMode.MULTIRUN)
    with pytest.raises(PzcapError, match="leave them out"):
        ray_job.require_plain(asked)
