"""Lengths of the hall that somebody marks in pictures, on their way into lengths.json.

A length stands in the file once it is whole: named, measured, both ends marked. All of them, those that are only begun
as well, stand in a file of the editor's own, which is written first: whenever the process is killed, the one tells what
the other was to become.
"""

from __future__ import annotations

import copy
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from pzcap.editor.alone import BACKUPS, FOLDER, alone
from pzcap.editor.paper import Paper, digest_of
from pzcap.io.capture import check_mark
from pzcap.io.files import write_json
from pzcap.io.known_lengths import mark_entry, metres, read_known_length, read_known_lengths, read_mark
from pzcap.io.manifest import Json, load_json
from pzcap.types import Capture, PzcapError

Entry = dict[str, Any]  # a length as lengths.json has it; what is not known yet is None, or an empty list of marks

ENDS: Final = ("from", "to")
NUMBERS: Final = ("length_m", "sigma_m")
_WORDS: Final = {
    "length_m": "how long it is", "sigma_m": "how well that is known", "from": "a mark of one end",
    "to": "a mark of the other end",
}  # fmt: skip
_BEGUN: Final = "lengths.json"  # in the editor's folder
_NOWHERE: Final = Path("length")  # where a length stands that is in no file yet
_SIGMA_M: Final = 0.01  # of a tape, until somebody says otherwise


class Lengths:
    """The lengths of a capture that is being edited. Raises PzcapError where they cannot be. Safe for threads.

    Each change says which ``seen`` version it was made of, and is refused where somebody else has changed them since.
    """

    def __init__(self, capture: Capture) -> None:
        self.capture = capture
        folder = capture.folder / FOLDER
        self._only = alone(folder)
        self._paper, self._begun = Paper(capture.folder, "lengths", folder / BACKUPS), folder / _BEGUN
        self._lock = threading.Lock()
        self._digest = self._paper.digest()
        self._past: list[list[Entry]] = []
        self._future: list[list[Entry]] = []
        self.version = 0
        self.entries = self._kept()

    def close(self) -> None:
        """Let others edit the capture."""
        self._only.close()

    def refresh(self) -> None:
        """Take in what somebody else has written into lengths.json. Raises PzcapError where it cannot be read."""
        with self._lock:
            self._adopt()

    def shown(self) -> dict[str, Any]:
        """All that a page shows of them."""
        with self._lock:
            lengths = [entry | {"lacks": lacking(entry)} for entry in self.entries]
            steps = {"can_undo": bool(self._past), "can_redo": bool(self._future)}
            return {"version": self.version, "lengths": lengths, **steps}

    # ----------------------------------------------------------------------------------------------------------
    # Commands

    def begin(self, seen: int) -> None:
        """Begin a length of which nothing is known."""
        names = {entry["name"] for entry in self.entries}
        name = next(name for n in range(1, len(names) + 2) if (name := f"length {n}") not in names)
        entry: Entry = {"name": name, "length_m": None, "sigma_m": _SIGMA_M, **{end: [] for end in ENDS}}
        self._change(seen, lambda entries: entries.append(entry))

    def remove(self, seen: int, number: int) -> None:
        """Remove a length."""
        self._change(seen, lambda entries: entries.pop(self._known(number)))

    def tell(self, seen: int, number: int, what: str, value: Any) -> None:
        """Say the "name" of a length, its "length_m" or its "sigma_m"; None is not known."""
        if what == "name":
            if not (isinstance(value, str) and value.strip()):
                raise PzcapError("give the length a name, by which a run's notes call it")
            value = Json(value.strip(), _NOWHERE, what).name()
            if any(entry["name"] == value for n, entry in enumerate(self.entries) if n != number):
                raise PzcapError(f'another length is called "{value}"; give each a name of its own')
        elif what in NUMBERS:
            try:
                value = None if value is None else metres(Json(value, _NOWHERE, what))
            except PzcapError as error:
                raise PzcapError(_in_words(error)) from error
        else:
            raise PzcapError(f"a length has no {what}")
        self._change(seen, lambda entries: entries[self._known(number)].update({what: value}))

    def mark(self, seen: int, number: int, end: str, mark: Any) -> None:
        """Mark an end where a picture shows it, in place of what the same camera had marked of it."""
        placed = read_mark(Json(mark, _NOWHERE, "mark"))
        check_mark(placed, self.capture.cameras)

        def put(entries: list[Entry]) -> None:
            others = _without(entries[self._known(number)][_known_end(end)], placed.camera)
            entries[number][end] = [*others, mark_entry(placed)]

        self._change(seen, put)

    def share(self, seen: int, number: int, end: str, other: int, its: str) -> None:
        """Say that an end is the same place as that of another length, a corner of two sides: its marks are taken."""

        def take(entries: list[Entry]) -> None:
            marks = entries[self._known(other)][_known_end(its)]
            entries[self._known(number)][_known_end(end)] = copy.deepcopy(marks)

        self._change(seen, take)

    def unmark(self, seen: int, number: int, end: str, camera: str) -> None:
        """Forget what a camera has marked of an end."""

        def forget(entries: list[Entry]) -> None:
            entry = entries[self._known(number)]
            entry[end] = _without(entry[_known_end(end)], camera)

        self._change(seen, forget)

    def undo(self, seen: int) -> None:
        """Take the latest change back."""
        self._step(seen, self._past, self._future, "nothing to undo")

    def redo(self, seen: int) -> None:
        """Make the change again that was undone last."""
        self._step(seen, self._future, self._past, "nothing to do again")

    # ----------------------------------------------------------------------------------------------------------

    def _known(self, number: int) -> int:
        if not 0 <= number < len(self.entries):
            raise PzcapError(f"there is no length {number}")
        return number

    def _change(self, seen: int, change: Callable[[list[Entry]], Any]) -> None:
        with self._lock:
            self._check_seen(seen)
            after = copy.deepcopy(self.entries)
            change(after)
            if after != self.entries:
                self._past.append(self.entries)
                self._future.clear()
                self._write(after)

    def _step(self, seen: int, taken: list[list[Entry]], kept: list[list[Entry]], otherwise: str) -> None:
        with self._lock:
            self._check_seen(seen)
            if not taken:
                raise PzcapError(otherwise)
            kept.append(self.entries)
            self._write(taken.pop())

    def _check_seen(self, seen: int) -> None:
        self._adopt()
        if seen != self.version:
            raise PzcapError("somebody else has changed the lengths meanwhile; look, and do it again")

    # ----------------------------------------------------------------------------------------------------------
    # Files

    def _write(self, entries: list[Entry]) -> None:
        whole = [entry for entry in entries if not lacking(entry)]
        after = digest_of(whole)
        write_json(self._begun, {"lengths": entries, "file": [self._digest, after]})
        if after != self._digest:
            self._digest = self._paper.replace(whole)
        self.entries = entries
        self.version += 1

    def _kept(self) -> list[Entry]:
        """The lengths as an editor has left them, if lengths.json is what it left or was about to; else merged."""
        if not self._begun.is_file():
            return self._merged([])
        content = load_json(self._begun, "remove it: what is whole stands in lengths.json")
        kept = [_shaped(entry) for entry in content["lengths"].list()]
        left = [digest.value for digest in content["file"].list()]
        return kept if self._digest in left else self._merged(kept)

    def _merged(self, kept: list[Entry]) -> list[Entry]:
        """The lengths that lengths.json has, and those of the ``kept`` ones that were only begun."""
        entries = [dict(entry) for entry in self._paper.entries()]
        names = {entry["name"] for entry in entries}
        return entries + [entry for entry in kept if lacking(entry) and entry["name"] not in names]

    def _adopt(self) -> None:
        """Take in what somebody else has written into lengths.json since it was last read."""
        digest = self._paper.digest()
        if digest == self._digest:
            return
        if digest:
            read_known_lengths(self._paper.path)
        self._digest = digest
        self._past.append(self.entries)
        self._future.clear()
        self.entries = self._merged(self.entries)
        self.version += 1


def lacking(entry: Entry) -> str:
    """Why a length cannot stand in lengths.json yet; empty where it can."""
    if missing := [words for part, words in _WORDS.items() if entry[part] in (None, [])]:
        return "lacks " + " and ".join([", ".join(missing[:-1]), missing[-1]] if missing[1:] else missing)
    try:
        read_known_length(Json(entry, _NOWHERE))
    except PzcapError as error:
        return _in_words(error)
    return ""


def _in_words(error: PzcapError) -> str:
    """An error of `Json`, its field named as the page names it."""
    text = str(error).removeprefix(f"{_NOWHERE}: ")
    for field, words in _WORDS.items():
        if text.startswith(f"{field}: "):
            return f"{words}: {text.removeprefix(f'{field}: ')}"
    return text


def _shaped(entry: Json) -> Entry:
    """A length of the editor's own file. Raises PzcapError where it is none."""
    entry.only("name", *NUMBERS, *ENDS)
    numbers = {key: float(entry[key].array()) if entry[key].value is not None else None for key in NUMBERS}
    marks = {end: [mark_entry(read_mark(mark)) for mark in entry[end].list()] for end in ENDS}
    return {"name": entry["name"].name(), **numbers, **marks}


def _known_end(end: str) -> str:
    if end not in ENDS:
        raise PzcapError(f"a length has no end {end}")
    return end


def _without(marks: list[Entry], camera: str) -> list[Entry]:
    return [mark for mark in marks if mark["camera"] != camera]
