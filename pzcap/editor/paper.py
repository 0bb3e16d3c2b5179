"""A paper of a capture, such as keyframes.json, as a page writes it: whole or not at all, what it replaces is kept, and
capture.json names it while there is one."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from pzcap.io.capture import MANIFEST
from pzcap.io.files import checked, write_bytes, write_json
from pzcap.io.manifest import load_json


@dataclass(slots=True)
class Paper:
    """The paper that ``folder``'s capture.json calls ``kind``, a JSON list. ``backups`` is a folder for what was
    replaced."""

    folder: Path
    kind: str
    backups: Path
    _backed_up: bool = False

    @property
    def path(self) -> Path:
        """The file that capture.json names, or will."""
        return self.folder / (self._named() or f"{self.kind}.json")

    def digest(self) -> str:
        """Of the file's content; empty where capture.json names none."""
        path = self.path
        return hashlib.sha256(checked(path).read_bytes()).hexdigest() if self._named() and path.is_file() else ""

    def entries(self) -> list[Any]:
        """Its list as it stands in the file; empty where there is none."""
        return list(load_json(self.path).value) if self.digest() else []

    def replace(self, entries: list[Any]) -> str:
        """Put ``entries`` in place of those that it has; the new digest. Without any there is no file, and capture.json
        says so."""
        path = self.path
        self._back_up(path)
        if not entries:
            self._name(None)
            path.unlink(missing_ok=True)
            return ""
        write_bytes(path, _written(entries))
        self._name(path.name)
        return digest_of(entries)

    def _back_up(self, path: Path) -> None:
        """Keep what this run of the editor finds."""
        if self._backed_up or not path.is_file():
            return
        now = datetime.now(UTC).strftime("%Y%m%dT%H%M%S.%f")
        write_bytes(self.backups / f"{self.kind}-{now}.json", path.read_bytes())
        self._backed_up = True

    def _named(self) -> str | None:
        name: str | None = load_json(self.folder / MANIFEST).value.get(self.kind)
        return name

    def _name(self, name: str | None) -> None:
        """Have capture.json name the file, or none."""
        path = self.folder / MANIFEST
        content = load_json(path).value
        if content.get(self.kind) == name or (content.get(self.kind) and name):
            return
        content[self.kind] = name
        write_json(path, content)


def digest_of(entries: list[Any]) -> str:
    """Digest of the file that holds ``entries``."""
    return hashlib.sha256(_written(entries)).hexdigest() if entries else ""


def _written(entries: list[Any]) -> bytes:
    return (json.dumps(entries, indent=1, ensure_ascii=False) + "\n").encode()
