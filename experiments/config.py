"""The typed configuration of a run. Defaults stand in Python alone; Hydra sees them as a plain tree.

Hydra composes, this file checks: a key that nobody knows, a value of the wrong type or one left out fails before any
work begins, and says what was meant.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from typing import Annotated, Any, TypeVar

import cattrs
from cattrs.errors import ForbiddenExtraKeysError
from omegaconf import DictConfig, OmegaConf

from pzcap.extras import reconstruct as extras
from pzcap.types import PzcapError
from sim.capture_cache import LIGHT_GB
from sim.ranges import Range, out_of_range
from sim.session import ShootConfig

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class OutputConfig:
    """Files that a run leaves behind, beside metrics.json."""

    recording: bool = True
    """Recording.rrd, for the Rerun viewer."""
    report: bool = True
    """Report.html."""
    jpeg_quality: Annotated[int, Range(1, 100)] = 75
    """Of the images in the recording."""
    captures: str = "outputs/captures"
    """Folder in which shoots are kept for the next run of the same shoot config."""
    light_gb: Annotated[float, Range(0.0, 1e6)] = LIGHT_GB
    """Light kept there, GB: that of a dozen captures of five seconds. Other noise is developed from it in seconds."""


@dataclass(frozen=True, slots=True)
class AppConfig:
    """Everything that `python -m experiments.run` can be told."""

    seed: Annotated[int, Range(0, 2**32 - 1)] = 0
    """Of the shoot; stands at shoot.seed, too."""
    method: str = "exact"
    """Or "paper"; stands at reconstruct.panzoom.method, too."""
    estimator: str | None = None
    """Module:function in place of the pipeline (docs/estimators.md)."""
    settings: dict[str, Any] = field(default_factory=dict)
    """Keyword arguments of that function, such as +settings.ratio=0.8."""
    capture: str | None = None
    """A capture folder made by anyone (docs/capture.md); null: shoot one."""
    cameras: str | None = None
    """Results of another take by the same cameras, not moved since: not calibrated again."""
    shoot: ShootConfig = field(default_factory=ShootConfig)
    reconstruct: extras.Config = field(default_factory=extras.Config)
    output: OutputConfig = field(default_factory=OutputConfig)


def _exactly(kind: type, words: str) -> Any:
    """A structure hook that converts nothing, but for whole numbers to float."""

    def structure(value: Any, _: Any) -> Any:
        if kind is float and type(value) is int:
            return float(value)
        if type(value) is not kind:
            raise TypeError(f"{value!r} is not {words}")
        return value

    return structure


def _converter() -> cattrs.Converter:
    converter = cattrs.Converter(forbid_extra_keys=True)
    for kind, words in ((int, "a whole number"), (float, "a number"), (bool, "true or false"), (str, "text")):
        converter.register_structure_hook(kind, _exactly(kind, words))
    return converter


CONVERTER = _converter()


OmegaConf.register_new_resolver(  # names the folder of a run: nobody's estimator overwrites the results of ours
    "estimator_or", lambda estimator, method: method if estimator is None else str(estimator).replace(":", ".")
)
OmegaConf.register_new_resolver("share", lambda whole, part: round(whole * part))  # of pixels


def default_tree(kind: type[AppConfig] = AppConfig) -> dict[str, Any]:
    """The defaults as plain dicts and lists, for Hydra."""
    tree: dict[str, Any] = CONVERTER.unstructure(kind())
    return tree


def build(tree: Mapping[str, Any]) -> AppConfig:
    """The typed configuration of a composed tree. PzcapError, in one line, for everything that does not fit."""
    return structured(tree, AppConfig, "configuration")


def structured(tree: Any, kind: type[T], what: str) -> T:
    """``tree`` as a ``kind``, a dataclass. PzcapError, in one line that begins with ``what``, where it does not fit."""
    try:
        config = CONVERTER.structure(tree, kind)
    except Exception as error:
        complaints = list(_complaints(error, ""))
        if not complaints:
            raise
        raise PzcapError(f"{what}: " + "; ".join(complaints)) from error
    if is_dataclass(config) and (misfits := list(out_of_range(config))):
        raise PzcapError(f"{what}: " + "; ".join(misfits))
    return config


def plain(composed: DictConfig) -> dict[str, Any]:
    """Hydra's composed configuration as dicts and lists, everything resolved."""
    tree: dict[str, Any] = OmegaConf.to_container(composed, resolve=True, throw_on_missing=True)  # type: ignore[assignment]
    return tree


def nearest(key: str, known: Iterable[str]) -> str:
    """The keys that were probably meant, for the end of a message."""
    known = sorted(known)
    by_leaf = {name: name.rpartition(".")[2] for name in known}
    close = difflib.get_close_matches(key, known, n=3, cutoff=0.6)
    leaves = difflib.get_close_matches(key.rpartition(".")[2], set(by_leaf.values()), n=3, cutoff=0.65)
    close += [name for name in known if by_leaf[name] in leaves and name not in close]
    if close:
        return f"did you mean {', '.join(close[:3])}?"
    depth = min(name.count(".") for name in known)
    return f"the keys are {', '.join(name for name in known if name.count('.') == depth)}"


def keys(tree: Mapping[str, Any], prefix: str = "") -> list[str]:
    """All dotted keys of ``tree``."""
    found = []
    for key, value in tree.items():
        found.append(prefix + key)
        if isinstance(value, Mapping):
            found += keys(value, f"{prefix}{key}.")
    return found


def leaves(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Dotted key -> value, of everything in ``tree`` that is no group."""
    found: dict[str, Any] = {}
    for key, value in tree.items():
        found |= leaves(value, f"{prefix}{key}.") if isinstance(value, Mapping) else {prefix + key: value}
    return found


def _complaints(error: BaseException, path: str) -> Iterable[str]:
    """One sentence for each thing that cattrs found wrong, with its dotted path."""
    if isinstance(error, cattrs.ClassValidationError | cattrs.IterableValidationError):
        for part in error.exceptions:
            note = next((n for n in getattr(part, "__notes__", ()) if hasattr(n, "name") or hasattr(n, "index")), None)
            step = "" if note is None else str(getattr(note, "name", getattr(note, "index", "")))
            yield from _complaints(part, f"{path}.{step}" if path and step else path or step)
    elif isinstance(error, ForbiddenExtraKeysError):
        known = {} if error.cl is None else _defaults(error.cl)
        for key in sorted(error.extra_fields):
            name = f"{path}.{key}" if path else key
            yield f"unknown key '{name}'; {nearest(name, keys(known, f'{path}.' if path else ''))}"
    else:
        yield f"{path or 'the whole'}: {error}"


def _defaults(kind: type) -> Mapping[str, Any]:
    """The tree of a dataclass, or its keys alone where it cannot be made without values."""
    needed = [field for field in fields(kind) if field.default is MISSING and field.default_factory is MISSING]
    return {field.name: None for field in fields(kind)} if needed else CONVERTER.unstructure(kind())
