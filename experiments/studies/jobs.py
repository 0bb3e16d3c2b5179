"""The jobs of a sweep on disk: a result is there whole or not at all, and says which configuration and code made it.

A job works in a hidden folder beside its own, ``.NAME.partial``, which takes the job's name when all is done. So a job
that was killed, at any moment, leaves nothing that looks like a result; what it left is swept away by the next sweep.
A job that failed leaves the reason in ``failed.txt``. Who works on a job holds the lock ``.NAME.partial.lock``.
"""

from __future__ import annotations

import errno
import hashlib
import json
import re
import shutil
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any, Final, TypeVar

import yaml
from omegaconf import DictConfig, OmegaConf
from omegaconf._utils import get_omega_conf_dumper

from experiments import estimators, footage, workers
from experiments.config import plain, structured
from experiments.errors import explain
from pzcap.io.files import checked, write_bytes
from pzcap.io.text import one_line
from pzcap.types import PzcapError
from sim.capture_cache import file_hashes
from sim.lock import locked
from sim.session import ShootConfig

T = TypeVar("T")

MARK: Final = "job.json"  # of a finished job
FAILED: Final = "failed.txt"  # of one that failed: its reason in the first line, a traceback below if it is a bug
HYDRA: Final = ".hydra"  # where users of Hydra look for a job's configuration
NO_HYDRA: Final = "hydra.output_subdir=null"
"""Override by which Hydra itself writes nothing there: it would before the job holds its lock."""
_CODE: Final = Path(__file__).parents[2]
_ABOVE: Final = ("experiment=", "study=")  # overrides that name the folders above a job's
_LONGEST: Final = 80  # letters of the overrides in a folder's name
_PATIENCE_S: Final = 6.0  # with another process at work: one whose sweep was killed ends within this
_LEFT: Final = re.compile(r"\.(.+)\.(?:partial|partial\.lock|stale)")
_TRIES: Final = 40  # a twentieth of a second each


def key(tree: Mapping[str, Any]) -> str:
    """Hash of all that a result depends on: configuration, our code, and a user's own files."""
    named = tree.get("estimator")
    theirs = estimators.source(str(named)) if named else None
    parts = [json.dumps(tree, sort_keys=True), _code(), theirs.read_bytes().hex() if theirs else ""]
    return hashlib.sha256(json.dumps(parts + _filmed_files(tree) + _given_files(tree)).encode()).hexdigest()


def _filmed_files(tree: Mapping[str, Any]) -> list[str]:
    """Hashes of what of a user's is filmed. None where it cannot be: the job itself fails, and says why."""
    try:
        return file_hashes(structured(tree.get("shoot"), ShootConfig, "shoot"))
    except PzcapError:
        return []


def _given_files(tree: Mapping[str, Any]) -> list[str]:
    """Content of a user's folders, by name, size and time: it takes too long to read footage for this."""
    means = {"capture": footage.capture_in, "cameras": footage.reconstruction_in}
    folders = [find(Path(str(tree[name])).resolve()) for name, find in means.items() if tree.get(name)]
    found = [(path, path.stat()) for folder in folders for path in sorted(folder.rglob("*")) if path.is_file()]
    return [f"{path} {state.st_size} {state.st_mtime_ns}" for path, state in found]


@cache
def _code() -> str:
    """Hash of our own sources: a result of yesterday's code is not one of today's."""
    digest = hashlib.sha256()
    for package in ("pzcap", "sim", "experiments"):
        for path in sorted((_CODE / package).rglob("*.py")):
            digest.update(path.relative_to(_CODE).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()


def name(config: DictConfig) -> str:
    """The folder of a job that is to be run with ``config`` (with its ``hydra`` node): readable, and its alone.

    What was overridden comes first, cut where it is long; then a hash of the whole configuration.
    """
    overrides = [str(o) for o in config.hydra.overrides.task if not str(o).startswith(_ABOVE)]
    shorter = r"['\"]|^[^=]*\.(?=[^=.]+=)|(?<==).*/"  # of keys the last part, of paths too
    leaves = sorted(re.sub(shorter, "", override.lstrip("+~")) for override in overrides)
    readable = re.sub(r"[^\w.,=+-]+", "_", ",".join(leaves))[:_LONGEST]
    tree = _tree(config, throw_on_missing=False)
    digest = hashlib.sha256(json.dumps(tree, sort_keys=True).encode()).hexdigest()[:10]
    return f"{readable}-{digest}" if readable else digest


OmegaConf.register_new_resolver("job_name", lambda *, _root_: name(_root_))


def tree_of(config: DictConfig) -> dict[str, Any]:
    """The application's part of a composed configuration, as `plain` gives it."""
    return _tree(config, throw_on_missing=True)


def _tree(config: DictConfig, throw_on_missing: bool) -> dict[str, Any]:
    """The application's part of a composed configuration; a copy of all of it would take four times as long."""
    return {
        str(name): OmegaConf.to_container(part, resolve=True, throw_on_missing=throw_on_missing)
        if OmegaConf.is_config(part := config[name])
        else part
        for name in config
        if name != "hydra"
    }


def finished(folder: Path, wanted: str) -> bool:
    """Tell if ``folder`` holds the result of the job whose `key` is ``wanted``."""
    try:
        return bool(json.loads(checked(folder / MARK).read_text(encoding="utf-8"))["key"] == wanted)
    except (OSError, ValueError, KeyError, TypeError, RecursionError, PzcapError):
        return False


def marked(folder: Path) -> tuple[tuple[str, ...], float]:
    """Overrides and seconds of the finished job of ``folder``. Raises PzcapError if its mark cannot be read."""
    try:
        mark = json.loads(checked(folder / MARK).read_text(encoding="utf-8"))
        return tuple(str(each) for each in mark["overrides"]), float(mark["seconds"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise PzcapError(f"{folder / MARK}: not readable ({error}); remove its folder and run again") from error


def failure(folder: Path) -> str | None:
    """Reason why the job of ``folder`` failed, in one line; None if it did not."""
    try:
        return checked(folder / FAILED).read_text(encoding="utf-8", errors="replace").partition("\n")[0]
    except OSError:
        return None
    except PzcapError as error:
        return str(error)


def carry_out(
    folder: Path, composed: DictConfig, overrides: Sequence[str], work: Callable[[dict[str, Any], Path], T]
) -> T | None:
    """Do ``work(tree, partial)`` for ``folder``, if that is not done yet; None where it was done, or failed.

    ``composed`` is the configuration without Hydra's own. An exception ends in ``folder/failed.txt`` and goes no
    further: the other jobs of the sweep are not to hear of it, on whatever machine they run.
    """
    workers.end_with_sweep()
    partial = folder.with_name(f".{folder.name}.partial")
    wanted = ""
    try:
        tree = plain(composed)
        wanted = key(tree)
        if finished(folder, wanted):
            return None
        with _at_work(partial):
            if finished(folder, wanted):  # by now: by whom this process has waited for
                return None
            _clear(folder)
            (partial / HYDRA).mkdir()
            (partial / HYDRA / "config.yaml").write_text(_yaml(OmegaConf.to_container(composed)), encoding="utf-8")
            (partial / HYDRA / "overrides.yaml").write_text(_yaml(list(overrides)), encoding="utf-8")
            start = time.perf_counter()
            result = work(tree, partial)
            mark = {"key": wanted, "overrides": list(overrides), "seconds": round(time.perf_counter() - start, 3)}
            (partial / MARK).write_text(json.dumps(mark, indent=2) + "\n", encoding="utf-8")
            _publish(partial, folder)
        return result
    except Exception as error:
        line = explain(error)
        if line is None:
            bug = one_line(f"{type(error).__name__}: {error}")
            line = f"{bug} (a bug: traceback in {folder / FAILED})\n\n{traceback.format_exc()}"
        if not finished(folder, wanted):
            write_bytes(folder / FAILED, (line.rstrip() + "\n").encode(errors="replace"))
        return None


class _Dumper(yaml.CSafeDumper):
    """Writes what `OmegaConf.to_yaml` does, by LibYAML: in two milliseconds for six."""


_Dumper.add_representer(str, get_omega_conf_dumper().str_representer)


def _yaml(tree: object) -> str:
    return str(yaml.dump(tree, Dumper=_Dumper, default_flow_style=False, allow_unicode=True, sort_keys=False))


def tidy(folders: Iterable[Path]) -> None:
    """Remove what jobs left in ``folders`` whose processes were killed."""
    for folder in folders:
        names = {found[1] for path in folder.glob(".*") if (found := _LEFT.fullmatch(path.name))}
        for partial, stale in ((folder / f".{name}.partial", folder / f".{name}.stale") for name in names):
            if partial.is_file():
                continue  # of a page or a table that is being written
            with suppress(PzcapError, OSError), locked(_lock(partial), "at work"):
                _remove(partial)
                _remove(stale)


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """``folder``, made where it is missing, while no other run works in it. PzcapError if one does."""
    folder.mkdir(parents=True, exist_ok=True)
    where = "wait for it, or choose another folder with hydra.run.dir=FOLDER"
    with locked(folder / ".lock", f"{folder}: another run works in this folder; {where}"):
        yield


@contextmanager
def _at_work(partial: Path) -> Iterator[None]:
    """``partial``, empty, while no other process works in it; it is gone in the end."""
    partial.parent.mkdir(parents=True, exist_ok=True)
    busy = f"{partial}: another process works on this job; wait for it, then give the command again"
    with locked(_lock(partial), busy, _PATIENCE_S):
        _remove(partial)
        partial.mkdir()
        try:
            yield
        finally:
            _remove(partial)


def _lock(partial: Path) -> Path:
    return partial.with_name(f"{partial.name}.lock")


def _publish(partial: Path, folder: Path) -> None:
    """The one step that makes it a result: what it replaces is an empty folder.

    What another process has put there since, that it found this one at work, is taken out before.
    """
    for attempt in range(_TRIES):
        (folder / FAILED).unlink(missing_ok=True)
        try:
            partial.rename(folder)
        except OSError as error:
            if error.errno not in (errno.ENOTEMPTY, errno.EEXIST) or attempt == _TRIES - 1:
                raise
            time.sleep(0.05)
        else:
            return


def _clear(folder: Path) -> None:
    """Remove what an earlier job left in ``folder``."""
    left = {path.name for path in folder.iterdir()} if folder.is_dir() else set()
    if MARK not in left and left - {FAILED, f".{FAILED}.partial", HYDRA}:
        raise PzcapError(f"{folder}: holds what no sweep left there; choose another folder with hydra.sweep.dir=FOLDER")
    if left:
        stale = folder.with_name(f".{folder.name}.stale")
        _remove(stale)
        folder.rename(stale)  # at once: half an old result is no better than half a new one
        _remove(stale)


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
