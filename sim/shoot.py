"""Films a capture: a session to ``capture/``, as a crew brings it home, and ``truth/`` beside it."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from pzcap.types import PzcapError
from sim.develop import develop
from sim.light import film, light_of
from sim.session import ShootConfig
from sim.team import Progress


def shoot(config: ShootConfig, folder: Path) -> Iterator[Progress]:
    """Write ``folder/capture`` and ``folder/truth``; yield the progress.

    Raises PzcapError if GL is missing, the disk is full, or a file that the config names cannot be used.
    """
    with written(folder), TemporaryDirectory(dir=folder, prefix=".light-") as light:
        yield from film(light_of(config), Path(light))
        yield from develop(config, Path(light), folder)


@contextmanager
def written(folder: Path) -> Iterator[None]:
    """Make ``folder``; say in one line why it cannot be written to. Raises PzcapError then."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield
    except OSError as error:
        reason = "the disk is full; free some space" if error.errno == errno.ENOSPC else error.strerror
        raise PzcapError(f"{folder}: cannot write the capture: {reason}") from error
