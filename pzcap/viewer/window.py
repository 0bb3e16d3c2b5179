"""A window of the Rerun viewer: started as a process of its own, on this machine's loopback address alone."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sysconfig
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final

from rerun.experimental import ViewerClient

from pzcap.types import PzcapError
from pzcap.viewer.columns import TIMELINE

START_S: Final = 30.0


def show(
    recordings: Sequence[tuple[Path, int | None]], *, headless: bool = False
) -> tuple[subprocess.Popen[bytes], ViewerClient]:
    """Start a viewer with all ``recordings``, the first one in front, the clock of each on its frame.

    Raises PzcapError where no viewer starts, for want of a screen or a graphics driver.
    """
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    binary = Path(sysconfig.get_path("scripts")) / "rerun"
    line = [str(binary), "--port", str(port), "--bind", "127.0.0.1", "--hide-welcome-screen"]
    quiet = subprocess.DEVNULL
    process = subprocess.Popen(
        [*line, "--headless"] if headless else line, stdin=quiet, stdout=quiet, stderr=quiet, start_new_session=True
    )
    try:
        client = _connected(process, port)
        for path, frame in reversed(recordings):
            client.open(str(path.resolve()))
            if frame is not None:
                client.set_time(TIMELINE, sequence=frame, play_state="paused")
    except ConnectionError:  # it never answered, or had, and ended
        close(process)
        files = " ".join(str(path) for path, _ in recordings)
        raise PzcapError(
            f"the viewer does not start here, for want of a screen or a graphics driver; elsewhere: rerun {files}"
        ) from None
    except BaseException:
        close(process)
        raise
    return process, client


def close(viewer: subprocess.Popen[bytes]) -> None:
    """End a viewer of `show`: `rerun` is a script, and the viewer its child."""
    with suppress(ProcessLookupError):
        os.killpg(viewer.pid, signal.SIGTERM)
    viewer.wait()


def _connected(process: subprocess.Popen[bytes], port: int) -> ViewerClient:
    """The viewer that the ``process`` has started. ConnectionError where there is none in time."""
    start = time.monotonic()
    while True:
        try:
            client = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
            client.get_state()  # its server answers before it does
        except (ConnectionError, RuntimeError):
            if process.poll() is not None or time.monotonic() - start > START_S:
                raise ConnectionError from None
            time.sleep(0.2)
        else:
            return client
