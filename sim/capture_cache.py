"""Captures on disk, named by a hash of their configuration: the same one is not filmed twice."""

from __future__ import annotations

import hashlib
import json
import re
import secrets
import shutil
from collections.abc import Generator, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from pzcap.io.files import checked
from pzcap.types import PzcapError
from sim import motion
from sim.hall.wallpaper import wall_pictures
from sim.lock import locked
from sim.session import ShootConfig
from sim.shoot import Progress, shoot

VERSION: Final = 6
"""Version of the simulator. Raise it with every change of a default or of pixels, so that captures are shot again."""

_TEMPORARY: Final = re.compile(r"\..+-\d+-[0-9a-f]{12}-\w{8}(\.lock)?")  # of a shoot at work, and its lock
_COMPLETE: Final = "complete"  # stands in a cached folder when its shoot has come to the end


def shoot_cached(config: ShootConfig, root: Path) -> Generator[Progress, None, Path]:
    """Shoot into a folder of ``root`` named by a hash of config and files, or find it there; return the folder.

    A shoot that was killed leaves only a temporary folder behind, which is never used, and removed by the next.
    Raises PzcapError if the disk is full, GL is missing, the motion is unknown, or a file cannot be used.
    """
    departures = _departures(asdict(config), asdict(ShootConfig()))
    canonical = json.dumps([VERSION, departures, *file_hashes(config)], sort_keys=True)
    name = f"{motion.title(config.motion)}-{config.seed}-{hashlib.sha256(canonical.encode()).hexdigest()[:12]}"
    folder = root / name
    _tidy(root)
    if (folder / _COMPLETE).is_file():
        return folder
    with _temporary(folder) as temporary:
        yield from shoot(config, temporary)
        (temporary / _COMPLETE).touch()
        if not (folder / _COMPLETE).is_file():  # else another process was faster
            shutil.rmtree(folder, ignore_errors=True)
            temporary.replace(folder)
    return folder


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
