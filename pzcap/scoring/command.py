"""The command `pzcap-score`: score results against the truth, or check them. docs/benchmark.md.

Exit status: 0 all is well, 1 refused (one line on stderr says what is wrong, where, and what to do), 2 wrong command
line, 3 scored or checked, and something is suspicious (a line on stderr each).
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from pzcap.io.files import written_whole
from pzcap.scoring import truth_files
from pzcap.scoring.files import HEADER
from pzcap.scoring.metric import Metric
from pzcap.scoring.readers.conventions import METRES, Conventions, joint_names
from pzcap.scoring.readers.read import read
from pzcap.scoring.records import thinned
from pzcap.scoring.score import score
from pzcap.scoring.suspicions import suspicions
from pzcap.scoring.totals import metrics
from pzcap.types import PzcapError

REFUSED: Final = 1
SUSPICIOUS: Final = 3


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; its exit status."""
    options = _parser().parse_args(arguments)
    try:
        return _run(options)
    except PzcapError as error:
        print(f"error: {error}", file=sys.stderr)
        return REFUSED
    except OSError as error:
        print(f"error: {error.filename}: {error.strerror}", file=sys.stderr)
        return REFUSED


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="pzcap-score", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("results", type=Path, help="results of one capture, or a folder with a folder a capture")
    parser.add_argument("truth", type=Path, nargs="?", help="the truth of that capture, or a folder with one a capture")
    parser.add_argument("--check", action="store_true", help="only say what is wrong")
    parser.add_argument("--json", type=Path, help="write the metrics there, too")
    parser.add_argument("--joints", type=Path, help="of TRC, C3D, BVH: a table of names, columns theirs,joint")
    parser.add_argument("--axes", help="of TRC, C3D, BVH: our axis along each of the file's, such as y,z,x or x,z,-y")
    parser.add_argument("--unit", choices=[name for name in METRES if len(name) < 3], help="of TRC, C3D, BVH")
    parser.add_argument("--every", type=int, default=1, help="of cameras, only each so many-th frame counts")
    parser.add_argument("--first-frame", type=int, help="of TRC, C3D, BVH: the frame that they begin with")
    parser.add_argument(
        "--rate", type=_positive, help="of TRC, C3D, BVH: frames a second, where they are not the capture's"
    )
    return parser


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not 0.0 < value < np.inf:
        raise argparse.ArgumentTypeError(f"{text} is no number above 0")
    return value


def _run(options: argparse.Namespace) -> int:
    names = {} if options.joints is None else joint_names(options.joints)
    said = Conventions(options.axes, options.unit, options.first_frame, names, options.rate)
    if options.truth is None:
        if not options.check:
            raise PzcapError("a score needs the truth; give RESULTS TRUTH, or --check RESULTS")
        folders = sorted(path.parent for path in options.results.glob(f"*/{HEADER}"))  # of a split, one a capture
        alone = not folders or (options.results / HEADER).exists()
        places = [options.results] if alone else folders
        return max(_say(f"{place}", suspicions(read(place, None, said), None)) for place in places)
    pairs = captures(options.results, options.truth)
    found: dict[str, list[Metric]] = {}
    status = 0
    for name, (results, folder) in pairs.items():
        truth = thinned(truth_files.read_truth(folder), options.every)
        if results is None:
            found[name] = []
            print(f"{name}: no results", file=sys.stderr)
            continue
        given = read(results, truth, said)
        status = max(status, _say(name, suspicions(given, truth)))
        found[name] = [] if options.check else metrics(score(given, truth))
    if options.check:
        return status
    totals = next(iter(found.values())) if len(found) == 1 else over(found)
    if options.json is not None:
        _write(options.json, totals, found if len(found) > 1 else {})
    try:
        _print(totals, len(found))
        sys.stdout.flush()
    except BrokenPipeError:  # whoever reads has read enough, such as head
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return status


def captures(results: Path, truth: Path) -> dict[str, tuple[Path | None, Path]]:
    """Name of each capture that ``truth`` has -> its results, None where there are none, and its truth."""
    if (truth / truth_files.HEADER).exists():
        name = truth.resolve().name
        inner = None if (results / HEADER).exists() else _results_in(results, name)
        if inner is not None and (inner.is_file() or (inner / HEADER).exists()):  # results of a split
            results = inner
        return {name: (results, truth)}
    folders = sorted(path.parent for path in truth.glob(f"*/{truth_files.HEADER}"))
    if not folders:
        hint = f"give {truth / 'truth'}" if (truth / "truth").is_dir() else "give the truth's folder"
        raise PzcapError(f"{truth}: holds no {truth_files.HEADER}, nor do its folders; {hint}")
    pairs = {folder.name: (_results_in(results, folder.name), folder) for folder in folders}
    if not any(found for found, _ in pairs.values()):
        alike = next((name for name in (results.name, results.stem) if name in pairs), None)
        if alike is not None:
            raise PzcapError(f"{results}: is of one capture, and the truth of {len(pairs)}; give {truth / alike}")
        raise PzcapError(f"{results}: has no folder named as a capture ({', '.join(list(pairs)[:3])}, ...)")
    return pairs


def _results_in(results: Path, name: str) -> Path | None:
    """The results of a capture: its folder, or a file of its name."""
    return next((path for path in sorted(results.glob(f"{name}*")) if name in (path.name, path.stem)), None)


def over(found: dict[str, list[Metric]]) -> list[Metric]:
    """The mean of each metric over the captures that have it. Where there are no results nothing is complete."""
    by_key: dict[str, list[Metric]] = {}
    for some in found.values():
        for metric in some:
            by_key.setdefault(metric.key, []).append(metric)
    missing = sum(not some for some in found.values())
    totals = []
    for key, some in by_key.items():
        values = [metric.value for metric in some if metric.value is not None]
        values += [0.0] * missing if key.endswith("completeness") and values else []
        totals.append(replace(some[0], value=float(np.mean(values)) if values else None))
    return totals


def _say(where: str, found: Sequence[str]) -> int:
    for line in found:
        print(f"suspicious: {where}: {line}", file=sys.stderr)
    return SUSPICIOUS if found else 0


def _print(found: Sequence[Metric], captures: int) -> None:
    if captures > 1:
        print(f"means over {captures} captures")
    for metric in found:
        if metric.value is not None:
            print(f"{metric.key:32} {metric.value:12.6g} {metric.unit}")


def _write(path: Path, totals: Sequence[Metric], each: dict[str, list[Metric]]) -> None:
    content: dict[str, Any] = _plain(totals)
    if each:
        content["_captures"] = {name: _plain(found) for name, found in each.items()}
    with written_whole(path) as partial:
        partial.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def _plain(found: Sequence[Metric]) -> dict[str, Any]:
    return {m.key: {"value": m.value, "unit": m.unit, "direction": m.direction} for m in found}


if __name__ == "__main__":
    sys.exit(main())
