"""Tables of text, as any language writes them: a line of names, a line a row, commas between. Errors name file and
line."""

from __future__ import annotations

import csv
import difflib
import json
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from pzcap.io.files import checked, written_whole
from pzcap.types import PzcapError

GUIDE: Final = "see docs/benchmark.md"
LARGEST: Final = 1e100  # beyond it squares overflow, and nothing that is measured lies there


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """One line of a table."""

    path: Path
    line: int  # from 1, as editors count
    cells: dict[str, str]

    def wrong(self, what: str) -> PzcapError:
        """The error about this line."""
        return PzcapError(f"{self.path} line {self.line}: {what}")

    def blank(self, columns: Iterable[str]) -> bool:
        """True where the table has none of these columns, or nothing stands in them."""
        return all(not self.cells.get(column, "") for column in columns)

    def number(self, column: str) -> float:
        """A finite number. Raises PzcapError where it is none."""
        text = self.cells.get(column, "")
        try:
            value = float(text)
        except ValueError as error:
            hint = "write a point, not a comma" if ";" in text or "," in text else "write a number"
            what = f"'{text}' is no number" if text else "is empty"
            raise self.wrong(f"{column} {what}; {hint}, or leave the row out") from error
        if not abs(value) <= LARGEST:
            raise self.wrong(f"{column} is {text}; leave the row out where nothing is known, or set valid to 0")
        return value

    def numbers(self, columns: Sequence[str]) -> list[float]:
        """A finite number each."""
        return [self.number(column) for column in columns]

    def whole(self, column: str) -> int:
        """A whole number. Raises PzcapError where it is none."""
        value = self.number(column)
        if value != int(value):
            raise self.wrong(f"{column} is {self.cells[column]}; write a whole number")
        return int(value)

    def flag(self, column: str) -> bool:
        """0 or 1. Raises PzcapError where it is neither."""
        text = self.cells.get(column, "").lower()
        if text not in ("0", "1", "true", "false"):
            raise self.wrong(f"{column} is '{text}'; write 0 or 1")
        return text in ("1", "true")


def read_table(path: Path, required: Collection[str], optional: Collection[str]) -> tuple[list[str], list[Row]]:
    """The columns and rows of a table. Raises PzcapError for an unknown or missing column, or a line cut short."""
    try:
        with checked(path).open(encoding="utf-8-sig", newline="") as file:
            lines = list(csv.reader(file, strict=True))
    except FileNotFoundError as error:
        raise PzcapError(f"{path} is missing; {GUIDE}") from error
    except UnicodeDecodeError as error:
        raise PzcapError(
            f"{path}: is no text in UTF-8 ({error.reason} at byte {error.start}); save it as UTF-8"
        ) from error
    except (OSError, ValueError, csv.Error) as error:
        raise PzcapError(f"{path}: is no table of text ({error}); {GUIDE}") from error
    if not any(cell.strip() for line in lines for cell in line):
        raise PzcapError(f"{path}: is empty; the first line names the columns, {GUIDE}")
    columns = [name.strip() for name in lines[0]]
    _check_columns(path, columns, required, optional)
    rows = []
    for number, cells in enumerate(lines[1:], start=2):
        if not any(cell.strip() for cell in cells):
            continue
        if len(cells) != len(columns):
            raise PzcapError(
                f"{path} line {number}: {len(cells)} cells where the first line names {len(columns)} columns; "
                "numbers have a point, not a comma, and every row all columns"
            )
        rows.append(Row(path, number, {name: cell.strip() for name, cell in zip(columns, cells, strict=True)}))
    return columns, rows


def _check_columns(path: Path, columns: Sequence[str], required: Collection[str], optional: Collection[str]) -> None:
    known = [*required, *optional]
    if len(columns) == 1 and any(mark in columns[0] for mark in "; \t"):
        raise PzcapError(f"{path}: one column, '{columns[0]}'; write commas between columns, and points in numbers")
    if not any(columns):
        raise PzcapError(f"{path} line 1: is blank; the first line names the columns, {GUIDE}")
    for name in columns:
        if name not in known:
            raise PzcapError(f"{path}: unknown column '{name}'; {nearest(name, known)}")
    if len(set(columns)) < len(columns):
        raise PzcapError(f"{path}: a column is named twice; name each once")
    missing = [name for name in required if name not in columns]
    if missing:
        raise PzcapError(f"{path}: no column '{missing[0]}'; the first line names the columns, {GUIDE}")


def nearest(name: str, known: Iterable[str]) -> str:
    """Guess of what was meant, for the end of a message."""
    names = list(known)
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    return f"did you mean '{close[0]}'?" if close else f"there are {', '.join(names)}"


def write_table(path: Path, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write a table whole or not at all. Numbers keep every digit: read again they are the same."""
    with written_whole(path) as partial, partial.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows([_cell(value) for value in row] for row in rows)


def _cell(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, str | int):
        return str(int(value)) if isinstance(value, bool) else str(value)
    return repr(float(value))  # type: ignore[arg-type]


def read_header(path: Path, form: str, version: int, known: Collection[str], required: Collection[str]) -> Any:
    """The JSON object at ``path``. Raises PzcapError where it is another format or version, or a key is unknown."""
    try:
        header = json.loads(checked(path).read_text(encoding="utf-8-sig"))
    except FileNotFoundError as error:
        raise PzcapError(f"{path} is missing; {GUIDE}") from error
    except (OSError, ValueError, RecursionError) as error:
        raise PzcapError(f"{path}: is no JSON ({error}); {GUIDE}") from error
    if not isinstance(header, dict) or header.get("format") != form:
        raise PzcapError(f'{path}: its "format" is not "{form}"; {GUIDE}')
    if header.get("version") != version:
        raise PzcapError(f"{path}: version {header.get('version')}; this scorer reads version {version}")
    names = ["format", "version", *known]
    for name in header:
        if name not in names:
            raise PzcapError(f"{path}: unknown key '{name}'; {nearest(name, names)}")
    for name in required:
        if name not in header:
            raise PzcapError(f"{path}: no '{name}'; {GUIDE}")
    return header


def field(path: Path, header: dict[str, Any], name: str, fits: Callable[[Any], bool], words: str) -> Any:
    """The value of a header's key, None where it is missing. Raises PzcapError where it does not fit."""
    value = header.get(name)
    if value is not None and not fits(value):
        raise PzcapError(f"{path}: {name} is {json.dumps(value)[:60]}; give {words}")
    return value


def texts(value: Any) -> bool:
    """True for a list of texts, none twice."""
    return isinstance(value, list) and all(isinstance(one, str) for one in value) and len(set(value)) == len(value)


def count(value: Any) -> bool:
    """True for a whole number from 0."""
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def counts(value: Any) -> bool:
    """True for a list of whole numbers from 0."""
    return isinstance(value, list) and all(map(count, value))
