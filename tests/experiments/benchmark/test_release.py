"""A release names its captures: each one composes, none is there twice, and seeds that are sealed stay so."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from hydra import compose, initialize_config_dir
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra

from experiments.benchmark.make import BenchmarkConfig
from experiments.benchmark.release import FOLDER, captures_of, read_release
from experiments.config import default_tree, plain, structured
from experiments.run import CONF
from pzcap.types import PzcapError

RELEASES = sorted(FOLDER.glob("*.yaml"))
TINY: dict[str, Any] = {
    "release": "t",
    "common": ["a=1"],
    "axes": {"trouble": {"none": [], "pan": ["experiment=pan"]}, "noise": {"2": [], "8": ["noise=8"]}},
    "base": {"trouble": "none", "noise": "2"},
    "splits": {"s": {"common": ["b=2"], "captures": [{"seed": 1}, {"seed": 2, "noise": "8", "trouble": "pan"}]}},
}


def written(path: Path, **changes: Any) -> Path:
    path.write_text(yaml.safe_dump(TINY | changes, sort_keys=False))
    return path


@pytest.mark.parametrize("path", RELEASES, ids=lambda path: path.stem)
def test_every_capture_of_a_release_composes(path: Path) -> None:
    config = read_release(path)
    ConfigStore.instance().store(name="benchmark_test", node={
        "defaults": ["benchmark_test_base", {"experiment": "floor_exercise"}, "_self_"], "shoot": {"seed": "${seed}"},
    })  # fmt: skip
    ConfigStore.instance().store(name="benchmark_test_base", node=default_tree(BenchmarkConfig))
    GlobalHydra.instance().clear()
    seeds: dict[str, set[int]] = {}
    composed: set[tuple[tuple[str, str], ...]] = set()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        for split in config.splits:
            for capture in captures_of(config, split):
                seeds.setdefault(split, set()).add(capture.seed)
                values = tuple((axis, value) for axis, value in capture.values.items() if axis != "motion")
                if values in composed:
                    continue
                composed.add(values)
                tree = plain(compose("benchmark_test", overrides=list(capture.overrides)))
                built = structured(tree, BenchmarkConfig, capture.name)
                assert built.shoot.seed == built.seed == capture.seed
                assert built.shoot.detector.enabled  # of whatever trouble
                assert ("trouble", "fast_pan") not in values or built.shoot.operator.swing_deg_s > 0.0
                assert built.without_keyframes == (("keyframes", "0") in values)
    open_seeds = set().union(*(seeds[split] for split in seeds if split != "test"))
    assert max(open_seeds) < 100
    assert min(seeds.get("test", {2000})) >= 2000  # seeds that nobody who changes a method runs
    assert [split for split in config.splits if not config.splits[split].gives_truth] in ([], ["test"])


def test_the_releases_of_captures_have_three_sizes() -> None:
    for path in RELEASES:
        assert set(read_release(path).splits) == ({"small"} if path.stem == "breaks" else {"mini", "dev", "test"})


def test_a_capture_is_named_by_what_it_departs_in(tmp_path: Path) -> None:
    one, two = captures_of(read_release(written(tmp_path / "t.yaml")), "s")
    assert (one.name, one.overrides) == ("capture_1", ("a=1", "b=2", "seed=1"))
    assert two.name == "capture_2_trouble-pan_noise-8"
    assert two.overrides == ("a=1", "b=2", "experiment=pan", "noise=8", "seed=2")
    assert two.values == {"trouble": "pan", "noise": "8"}


@pytest.mark.parametrize(
    ("captures", "line"),
    [
        ([{"seed": 1}, {"seed": 1, "noise": "2"}], "'capture_1' is there twice"),
        ([{"seed": 1, "noise": "9"}], "noise has no '9'"),
        ([{"seed": 1, "nois": "8"}], "no axis 'nois'; did you mean noise"),
        ([{"noise": "8"}], "a capture has no seed"),
        ([{"seed": 1.5}], "a capture has no seed"),
    ],
)
def test_what_cannot_be_a_capture_is_refused(captures: list[dict[str, Any]], line: str, tmp_path: Path) -> None:
    config = read_release(written(tmp_path / "t.yaml", splits={"s": {"captures": captures}}))
    with pytest.raises(PzcapError, match=line):
        captures_of(config, "s")


def test_what_is_no_release_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PzcapError, match=r"no release '1.O' .*did you mean"):
        read_release(FOLDER / "1.O.yaml")
    with pytest.raises(PzcapError, match="unknown key 'splitz'"):
        read_release(written(tmp_path / "t.yaml", splitz={}))
    with pytest.raises(PzcapError, match="no split 'tset'"):
        captures_of(read_release(written(tmp_path / "t.yaml")), "tset")
