"""Tables that are none, and headers of another capture: a line says what is wrong."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pzcap.scoring.command import REFUSED, main
from tests.scenes.plain import header, written

TABLES: dict[str, tuple[Callable[[str], bytes], str]] = {
    "empty": (lambda _: b"", "joints.csv: is empty; the first line names the columns"),
    "blank first line": (lambda text: b"\n" + text.encode(), "joints.csv line 1: is blank"),
    "UTF-16": (lambda text: text.encode("utf-16"), "is no text in UTF-8 (invalid start byte at byte 0); save it as"),
    "semicolons": (lambda text: text.replace(",", ";").encode(), "write commas between columns, and points"),
    "spaces": (lambda text: text.replace(",", " ").encode(), "write commas between columns, and points"),
    "decimal commas": (lambda text: text.replace(".", ",").encode(), "line 2: 10 cells where the first line names 6"),
    "overflow": (lambda text: re.sub("pelvis,[^,]*", "pelvis,1e300", text, count=1).encode(), "line 2: x_m is 1e300;"),
    "frame of many digits": (lambda text: text.replace("\n0,", "\n1e300,", 1).encode(), "line 2: frame is 1e300;"),
}


@pytest.mark.parametrize("mistake", TABLES)
def test_a_table_that_is_none_is_refused(mistake: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    results, truth = written(tmp_path)
    edit, line = TABLES[mistake]
    table = results / "joints.csv"
    table.write_bytes(edit(table.read_text(encoding="utf-8")))
    assert main([str(results), str(truth)]) == REFUSED
    said = capsys.readouterr().err
    assert line in said
    assert said.count("\n") == 1
    assert len(said) < 300 + len(str(table))


@pytest.mark.parametrize("edit", [lambda text: "\ufeff" + text, lambda text: text.replace("\n", "\r\n")])
def test_a_byte_order_mark_and_ends_of_lines_do_not_count(
    edit: Callable[[str], str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    results, truth = written(tmp_path)
    assert main([str(results), str(truth)]) == 0
    as_written = capsys.readouterr().out
    table = results / "joints.csv"
    table.write_bytes(edit(table.read_text(encoding="utf-8")).encode())
    assert main([str(results), str(truth)]) == 0
    assert capsys.readouterr().out == as_written


@pytest.mark.parametrize(
    ("values", "line"),
    [
        ({"cameras": ["cam1", "1", "2", "3", "4"]}, "knows no 'cam1', which the results name as a camera; its cameras"),
        ({"timecodes": [f"23:00:00:{frame:02d}" for frame in range(20)]}, "leave timecodes out where frames are"),
    ],
)
def test_a_header_of_another_capture_says_what_to_do(
    values: dict[str, Any], line: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    results, truth = written(tmp_path)
    header(results, **values)
    assert main([str(results), str(truth)]) == REFUSED
    assert line in capsys.readouterr().err
