"""Runs the methods of this tree on a split, and makes entries of the board of them; anybody's stand in `theirs`.

    python -m experiments.benchmark score split=mini                             # all methods of this tree
    python -m experiments.benchmark score split=mini methods=[ours,peer_sift]

leaves in outputs/benchmark/RELEASE/SPLIT `results/KEY/CAPTURE` (files of results), `entries/KEY.json`, and in
`entries/KEY/` pictures of its worst frames and a recording. What is there already is not run again, unless the code has
changed since or `again=true`.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Final

from experiments.benchmark.entries import Description, check
from experiments.benchmark.make import described
from experiments.benchmark.methods.given import Answered, Given
from experiments.benchmark.methods.rows import METHODS, RUNS, Method
from experiments.benchmark.write import commit, this_machine, write
from experiments.config import AppConfig, nearest
from experiments.progress import Bars
from experiments.run import CONF
from experiments.terminal import terminal
from pzcap.io.files import write_json
from pzcap.scoring.files import read_results, write_results
from pzcap.scoring.score import score
from pzcap.scoring.totals import metrics
from pzcap.scoring.truth_files import read_truth
from pzcap.types import PzcapError

SOURCES: Final = ("pzcap", "experiments/comparisons", "experiments/benchmark/methods")
"""Of what the answers of a method depend on; the score itself is none of it."""
SCORING: Final = "pzcap/scoring"


def score_methods(folder: Path, names: Sequence[str], again: bool) -> list[Path]:
    """Run these methods (none: all) on the split in ``folder``; the entries that were made."""
    split = described(folder)
    known = {method.key: method for method in METHODS}
    for name in names:
        if name not in known:
            raise PzcapError(f"no method '{name}'; {nearest(name, known)}")
    chosen = [method for method in METHODS if not names or method.key in names]
    with Bars(terminal(stderr=True)) as bars:
        for capture in split["captures"]:
            given = Given(folder / "jobs" / capture, AppConfig(), bars.update)
            for run in dict.fromkeys(method.run for method in chosen):
                _run(folder, given, capture, run, again)
    return [path for method in chosen if (path := _enter(folder, split, method)) is not None]


def _run(folder: Path, given: Given, capture: str, run: str, again: bool) -> None:
    """Let the methods of one run answer, where they have not by this code."""
    keys = [method.key for method in METHODS if method.run == run]
    if not again and all(_took(folder, key, capture).get("code") == _code() for key in keys):
        return
    try:
        answers = RUNS[run](given)
    except PzcapError as error:  # on this footage: it is a capture without an answer
        answers = {key: Answered(None, 0.0, None, str(error)) for key in keys}
    for key, answered in answers.items():
        _keep(folder, key, capture, answered)


@cache
def _code() -> str:
    digest = hashlib.sha256()
    root = CONF.parent
    for source in SOURCES:
        for path in sorted((root / source).rglob("*.py")) if (root / source).is_dir() else [root / source]:
            name = path.relative_to(root).as_posix()
            if not name.startswith(SCORING):
                digest.update(name.encode() + path.read_bytes())
    return digest.hexdigest()


def _took(folder: Path, key: str, capture: str) -> dict[str, Any]:
    """Time and memory of a method on a capture, and the code it ran; empty where it has not run."""
    try:
        took: dict[str, Any] = json.loads((folder / "runs" / key / f"{capture}.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return took


def _keep(folder: Path, key: str, capture: str, answered: Answered) -> None:
    place, took = folder / "results" / key / capture, folder / "runs" / key / f"{capture}.json"
    shutil.rmtree(place, ignore_errors=True)
    if answered.results is not None:
        write_results(answered.results, place)
        true = read_truth(folder / "truth" / capture)
        if metrics(score(read_results(place), true)) != metrics(score(answered.results, true)):
            raise PzcapError(f"{place}: files score otherwise than what they were written from; report this bug")
    what = {
        "code": _code(), "seconds": answered.seconds, "memory_mib": answered.memory_mib, "missing": answered.missing
    }  # fmt: skip
    write_json(took, what, indent=None)


def _enter(folder: Path, split: Mapping[str, Any], method: Method) -> Path | None:
    """The entry of a method of this tree; None where it could run on no capture."""
    took = [_took(folder, method.key, capture) for capture in split["captures"]]
    missing = sorted({str(one["missing"]) for one in took if one.get("missing")})
    results = folder / "results" / method.key
    if not any(results.glob("*")):
        terminal(stderr=True).print(f"{method.label}: {', '.join(missing)}", highlight=False)
        return None
    memory = [one["memory_mib"] for one in took if one.get("memory_mib")]
    where = f"release={split['release']} split={split['split']}"
    description = Description(
        key=method.key,
        label=method.label,
        tracks=method.tracks,
        claim="reproduced",
        command=f"python -m experiments.benchmark score {where} methods=[{method.key}]",
        commit=commit(),
        machine=this_machine(),
        seconds=round(sum(one.get("seconds", 0.0) for one in took), 1),
        memory_mib=round(max(memory), 0) if memory else None,
        published=method.published,
        notes="; ".join([*([method.notes] if method.notes else []), *(f"some captures: {line}" for line in missing)]),
    )
    return write(folder, split, check(description, method.key), results)
