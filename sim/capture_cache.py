"""Captures and light on disk, named by a hash of their configuration: the same one is not filmed twice."""

from __future__ import annotations

import hashlib
import json
import math
import re
import secrets
import shutil
import time
from collections.abc import Generator, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final, NamedTuple

from pzcap.io.files import checked
from pzcap.types import PzcapError
from sim import motion
from sim.develop import develop
from sim.hall.wallpaper import wall_pictures
from sim.light import film, light_of
from sim.lock import locked
from sim.session import ShootConfig
from sim.shoot import written
from sim.team import Progress

VERSION: Final = 12
"""Version of the simulator. Raise it with every change of a default or of pixels, so that captures are shot again."""

_TEMPORARY: Final = re.compile(r"\..+-\d+-[0-9a-f]{12}-\w{8}(\.lock)?")  # of a shoot at work, and its lock
LIGHT_GB: Final = 10.0
"""Light that is kept by default, GB: that of a dozen captures of five seconds."""

_LIGHT: Final = "light-"  # begins the names of its folders
_IN_USE_S: Final = 3600.0
_COMPLETE: Final = "complete"  # stands in a cached folder when its shoot has come to the end


class Kept(NamedTuple):
    """A capture, or light, on disk."""

    folder: Path
    is_light: bool
    size_bytes: int
    used_s: float  # seconds since it was last asked for


def shoot_cached(config: ShootConfig, root: Path, light_gb: float = LIGHT_GB) -> Generator[Progress, None, Path]:
    """Shoot into a folder of ``root`` named by a hash of config and files, or find it there; return the folder.

    Light is kept, too, beside the captures that were developed from it, up to ``light_gb``. A shoot that was killed
    leaves only a temporary folder behind, which is never used, and removed by the next.
    Raises PzcapError if the disk is full, GL is missing, the motion is unknown, or a file cannot be used.
    """
    folder = root / _name(config)
    _tidy(root)
    if not _found(folder):
        light = yield from _film_cached(light_of(config), root)
        with _temporary(folder) as temporary, written(temporary):
            yield from develop(config, light, temporary)
            _complete(temporary, folder)
        make_room(root, light_gb)
    return folder


def _film_cached(config: ShootConfig, root: Path) -> Generator[Progress, None, Path]:
    """The folder of ``root`` with the light of ``config``: filmed now, or before, or by another process meanwhile."""
    folder = root / f"{_LIGHT}{_name(config)}"
    root.mkdir(parents=True, exist_ok=True)
    with locked(root / f".{folder.name}.lock", f"{folder}: another process films it", patience_s=math.inf):
        if not _found(folder):
            with _temporary(folder) as temporary, written(temporary):
                yield from film(config, temporary)
                _complete(temporary, folder)
    return folder


def _name(config: ShootConfig) -> str:
    departures = _departures(asdict(config), asdict(ShootConfig()))
    canonical = json.dumps([VERSION, departures, *file_hashes(config)], sort_keys=True)
    return f"{motion.title(config.motion)}-{config.seed}-{hashlib.sha256(canonical.encode()).hexdigest()[:12]}"


def _found(folder: Path) -> bool:
    """Is it there whole? It has been used just now, then."""
    if not (folder / _COMPLETE).is_file():
        return False
    with suppress(OSError):  # a folder that may only be read
        (folder / _COMPLETE).touch()
    return True


def _complete(temporary: Path, folder: Path) -> None:
    (temporary / _COMPLETE).touch()
    if not (folder / _COMPLETE).is_file():  # else another process was faster
        shutil.rmtree(folder, ignore_errors=True)
        temporary.replace(folder)


def kept(root: Path) -> list[Kept]:
    """All that is kept in ``root``, what was used last at first."""
    found = []
    for mark in root.glob(f"*/{_COMPLETE}"):
        with suppress(FileNotFoundError):  # removed meanwhile
            size = sum(path.stat().st_size for path in mark.parent.rglob("*") if path.is_file())
            is_light = mark.parent.name.startswith(_LIGHT)
            found.append(Kept(mark.parent, is_light, size, time.time() - mark.stat().st_mtime))
    return sorted(found, key=lambda one: one.used_s)


def make_room(root: Path, light_gb: float) -> list[Kept]:
    """Remove the light that was not used for longest until ``light_gb`` are kept; return what was removed.

    What was used within the last hour stays: another process may be developing it.
    """
    lights, total, removed = [one for one in kept(root) if one.is_light], 0, []
    for light in lights:
        total += light.size_bytes
        if total > light_gb * 1e9 and abs(light.used_s) > _IN_USE_S:  # below 0: the clock was set back since
            remove(light.folder)
            removed.append(light)
    return removed


def remove(folder: Path) -> None:
    """Remove what is kept in ``folder``. Nothing takes half of it for the whole, whenever this is killed."""
    (folder / _COMPLETE).unlink(missing_ok=True)
    shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def _temporary(folder: Path) -> Iterator[Path]:
    """A folder beside ``folder`` that is gone in the end."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    own = folder.with_name(f".{folder.name}-{secrets.token_hex(4)}")
    with locked(_lock(own), f"{own}: another process works in it; give the command again", patience_s=10.0):
        try:
            own.mkdir()
            yield own
        finally:
            shutil.rmtree(own, ignore_errors=True)


def _tidy(root: Path) -> None:
    """Remove the temporary folders of processes that were killed: those that nobody holds the lock of."""
    left = (path for path in root.glob(".*") if _TEMPORARY.fullmatch(path.name))
    for path in {path.with_name(path.name.removesuffix(".lock")) for path in left}:
        with suppress(PzcapError, OSError), locked(_lock(path), "at work"):
            shutil.rmtree(path, ignore_errors=True)


def _lock(temporary: Path) -> Path:
    return temporary.with_name(f"{temporary.name}.lock")


def _departures(values: dict[str, Any], defaults: dict[str, Any]) -> dict[str, Any]:
    """Settings that differ from their defaults: a new effect that is off by default leaves cached captures valid."""
    return {
        key: _departures(value, defaults[key]) if isinstance(value, dict) else value
        for key, value in values.items()
        if value != defaults[key]
    }


def file_hashes(config: ShootConfig) -> list[str]:
    """Names and hashes of the user's files that a capture is made of: if they change, so does the capture.

    Raises PzcapError if one cannot be read.
    """
    acted = motion.file_of(config.motion)
    driven = Path(config.operator.trajectories) if config.operator.trajectories else None
    paths = [path for path in (acted, driven, *wall_pictures(config.gym.wall_pictures).values()) if path]
    try:
        return [f"{path.name} {hashlib.sha256(checked(path).read_bytes()).hexdigest()}" for path in paths]
    except OSError as error:
        raise PzcapError(f"{error.filename}: cannot be read: {error.strerror}") from error
