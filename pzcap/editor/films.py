"""Pictures of all that the cameras of a capture have filmed: sweeps, zoom runs, the motion."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any, Final

from pzcap.editor.footage import compressed
from pzcap.editor.on_demand import KEPT_BYTES, OnDemand
from pzcap.io.video import VideoReader
from pzcap.types import Capture, PzcapError

KINDS: Final = ("sweep", "zoom", "motion")


class Films:
    """The films of a capture, opened. Safe for threads."""

    def __init__(self, capture: Capture) -> None:
        paths = {
            (number, kind): path
            for number, camera in enumerate(capture.cameras)
            for kind in KINDS
            if (path := getattr(camera, kind)) is not None
        }
        if not paths:
            raise PzcapError(f"{capture.folder}: no camera has filmed anything yet; see docs/capture.md")
        self._films = {place: _Film(VideoReader(path), KEPT_BYTES // len(paths)) for place, path in paths.items()}

    def of(self, camera: int) -> list[dict[str, Any]]:
        """The films of a camera: kind, number of pictures, width and height."""
        readers = [(kind, film.reader) for (number, kind), film in self._films.items() if number == camera]
        return [{"kind": kind, "frames": one.frame_count, "size": [one.width, one.height]} for kind, one in readers]

    def jpeg(self, camera: int, kind: str, number: int) -> bytes | None:
        """A picture of a film as JPEG; None where there is none."""
        film = self._films.get((camera, kind))
        return None if film is None or not number < film.reader.frame_count else film.jpeg(number)


class _Film:
    """The pictures of one video, by their numbers."""

    def __init__(self, reader: VideoReader, kept_bytes: int) -> None:
        self.reader = reader
        self._lock = threading.Lock()
        self._kept = OnDemand[bytes](self._decode, len, kept_bytes)

    def jpeg(self, number: int) -> bytes:
        with self._lock:
            return self._kept[number]

    def _decode(self, start: int) -> Iterator[bytes]:
        return (compressed(image) for _, image in self.reader.read(int(self.reader.indices[start])))
