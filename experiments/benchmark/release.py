"""A release of the benchmark: its axes, its splits, and the captures in them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from omegaconf import OmegaConf

from experiments.config import nearest, structured
from experiments.run import CONF
from pzcap.io.files import checked
from pzcap.types import PzcapError

FOLDER: Final = CONF / "benchmark"
SEED: Final = "seed"


@dataclass(frozen=True, slots=True)
class Split:
    """Some captures of a release."""

    captures: tuple[dict[str, Any], ...]
    """Axis -> value, and the seed; what is not named is the base's."""
    gives_truth: bool = False
    """True cameras and masks are handed out for the tracks that are given them."""
    common: tuple[str, ...] = ()
    """Overrides of every capture of the split."""


@dataclass(frozen=True, slots=True)
class ReleaseConfig:
    """Content of conf/benchmark/VERSION.yaml."""

    release: str
    axes: dict[str, dict[str, tuple[str, ...]]]
    """Axis -> value -> overrides."""
    base: dict[str, str]
    splits: dict[str, Split]
    common: tuple[str, ...] = ()
    """Overrides of every capture."""
    units: dict[str, str] = field(default_factory=dict)
    """Axis -> unit of its values, for the board; an axis whose values are names has none."""


@dataclass(frozen=True, slots=True)
class BenchmarkCapture:
    """One capture of a split."""

    name: str
    seed: int
    values: Mapping[str, str] = field(hash=False)  # axis -> value
    overrides: tuple[str, ...]  # that shoot it


def read_release(path: Path) -> ReleaseConfig:
    """The release at ``path``. Raises PzcapError, in one line, where it is not one."""
    if not path.is_file():
        known = sorted(found.stem for found in path.parent.glob("*.yaml"))
        raise PzcapError(f"no release '{path.stem}' in {path.parent}; {nearest(path.stem, known) if known else 'none'}")
    return structured(OmegaConf.to_container(OmegaConf.load(checked(path)), resolve=True), ReleaseConfig, path.name)


def split_of(config: ReleaseConfig, name: str) -> Split:
    """The split of that name. Raises PzcapError, with those that there are, where there is none."""
    if name not in config.splits:
        raise PzcapError(f"no split '{name}' in release {config.release}; {nearest(name, config.splits)}")
    return config.splits[name]


def captures_of(config: ReleaseConfig, name: str) -> tuple[BenchmarkCapture, ...]:
    """The captures of the split ``name``. Raises PzcapError for one that cannot be, or is there twice."""
    split = split_of(config, name)
    found = tuple(_capture(config, split, wanted) for wanted in split.captures)
    names = [capture.name for capture in found]
    twice = next((one for one in names if names.count(one) > 1), None)
    if twice is not None:
        raise PzcapError(f"release {config.release}, {name}: '{twice}' is there twice; remove one")
    return found


def _capture(config: ReleaseConfig, split: Split, wanted: Mapping[str, Any]) -> BenchmarkCapture:
    seed = wanted.get(SEED)
    if type(seed) is not int:
        raise PzcapError(f"release {config.release}: a capture has no seed ({dict(wanted)}); give it a whole number")
    values = {axis: config.base[axis] for axis in config.axes if axis in config.base}
    values |= {axis: str(value) for axis, value in wanted.items() if axis != SEED}
    overrides = [*config.common, *split.common]
    for axis, value in values.items():
        if axis not in config.axes:
            raise PzcapError(f"release {config.release}: no axis '{axis}'; {nearest(axis, config.axes)}")
        if value not in config.axes[axis]:
            known = config.axes[axis]
            raise PzcapError(f"release {config.release}: {axis} has no '{value}'; {nearest(value, known)}")
    for axis, by_value in config.axes.items():
        overrides += by_value[values[axis]]
    departures = [
        f"{axis}-{values[axis]}" for axis in config.axes if values[axis] != config.base[axis] and axis != "motion"
    ]
    name = "_".join([values.get("motion", "capture"), str(seed), *departures])
    return BenchmarkCapture(name, seed, values, (*overrides, f"seed={seed}"))
