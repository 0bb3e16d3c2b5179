"""The benchmark's command: `make`, `score` or `board`. docs/benchmark.md.

python -m experiments.benchmark make split=mini [freeze=true] [any override of Hydra's, such as a launcher]
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

from experiments.benchmark import board, make, score, theirs
from experiments.config import nearest
from experiments.errors import AlreadyReported, guard
from pzcap.types import PzcapError

WHERE: Final[dict[str, str]] = {"release": "1.0", "split": "mini", "out": str(make.OUT)}


def _split(arguments: list[str], keys: Mapping[str, str]) -> tuple[dict[str, str], list[str]]:
    """The values of ``keys`` (key -> default), and all other arguments."""
    values, others = dict(keys), []
    for argument in arguments:
        key, equals, value = argument.partition("=")
        if equals and key in keys:
            values[key] = value
        else:
            others.append(argument)
    return values, others


def _known(arguments: list[str], keys: Mapping[str, str]) -> dict[str, str]:
    """The values of ``keys`` (key -> default). Raises PzcapError for any other argument."""
    values, others = _split(arguments, keys)
    if others:
        key = others[0].partition("=")[0]
        raise PzcapError(f"unknown argument '{others[0]}'; {nearest(key, keys)}")
    return values


def _score(arguments: list[str]) -> None:
    theirs_keys = dict.fromkeys(("results", "estimator", "entry", *theirs.CONVENTIONS), "")
    values = _known(arguments, WHERE | {"methods": "", "again": "false"} | theirs_keys)
    folder = Path(values["out"]) / values["release"] / values["split"]
    entry, given = Path(values["entry"]), [key for key in ("results", "estimator") if values[key]]
    if len(given) != bool(values["entry"]):
        raise PzcapError(
            "results=FOLDER and entry=DESCRIPTION.json go together, or estimator=MODULE:FUNCTION and entry= "
            "(docs/benchmark.md); give both, or none for the methods of this tree"
        )
    said = theirs.conventions(values)
    if values["results"]:
        made = [theirs.score_results(folder, Path(values["results"]), entry, said)]
    elif values["estimator"]:
        made = [theirs.score_estimator(folder, values["estimator"], entry)]
    else:
        names = [name for name in values["methods"].strip("[]").split(",") if name]
        made = score.score_methods(folder, names, values["again"] == "true")
    for path in made:
        print(path)


def _board(arguments: list[str]) -> None:
    values = _known(arguments, WHERE | {"entries": ""})
    folder = Path(values["out"]) / values["release"] / values["split"]
    print(board.write(folder, Path(values["entries"]) if values["entries"] else folder / "entries"))


def _make(arguments: list[str]) -> None:
    values, others = _split(arguments, WHERE | {"freeze": "false"})
    lines = make.make(values["release"], values["split"], others, Path(values["out"]), values["freeze"] == "true")
    for line in lines:
        print(f"error: {line}", file=sys.stderr)
    if lines:
        raise AlreadyReported("the footage is not that of the release")


COMMANDS: Final[Mapping[str, Callable[[list[str]], None]]] = {"make": _make, "score": _score, "board": _board}


def main() -> int:
    """The command. Exit status 0, or 1 with a line on stderr."""
    name = sys.argv[1] if len(sys.argv) > 1 else ""
    if name in ("", "-h", "--help"):
        print((__doc__ or "").strip())
        return 0 if name else 1
    arguments = sys.argv[2:]

    def run() -> None:
        if name not in COMMANDS:
            raise PzcapError(f"no command '{name}'; {nearest(name, COMMANDS)}")
        COMMANDS[name](arguments)

    return guard(run)


if __name__ == "__main__":
    sys.exit(main())
