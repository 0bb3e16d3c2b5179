"""Is anything worse than it was? A fixed small set of experiments against a committed baseline.

    python -m experiments.gate                                  # make gate
    python -m experiments.gate --renew                          # make baseline: what is reached now is the new measure
    python -m experiments.gate estimator=module:function        # anyone's against ours; other overrides work as well

conf/gate.yaml says what is run and how much worse a figure may be, conf/baseline.json what was reached. Exit status 1,
and a table of what moved, where a figure got worse by more than that.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from fnmatch import fnmatch
from pathlib import Path
from typing import Any, Final, Literal

from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from omegaconf import OmegaConf
from rich.console import Console
from rich.table import Table
from rich.text import Text

from experiments.config import build, plain, structured
from experiments.errors import AlreadyReported, guard
from experiments.metrics import format_value, run_info
from experiments.run import CONF, run
from experiments.terminal import command_line, print_whole, table, terminal
from pzcap.io.files import write_json
from pzcap.scoring.metric import Direction, Metric
from pzcap.types import PzcapError

GATE: Final = CONF / "gate.yaml"
BASELINE: Final = CONF / "baseline.json"
FOLDER: Final = Path("outputs/gate")

Verdict = Literal["worse", "gone", "better", "new", "same"]


@dataclass(frozen=True, slots=True)
class Tolerance:
    """Tolerance of the metrics that fit the pattern ``metric``: relative * |baseline| + absolute."""

    metric: str
    relative: float = 0.0
    absolute: float = 0.0
    ignored: bool = False


@dataclass(frozen=True, slots=True)
class GateConfig:
    common: tuple[str, ...]
    """Overrides of every case."""
    cases: dict[str, tuple[str, ...]]
    """Name -> overrides."""
    tolerances: tuple[Tolerance, ...]

    def overrides(self, case: str) -> list[str]:
        return [*self.common, *self.cases[case]]

    def tolerance(self, key: str) -> Tolerance | None:
        """The first that fits the metric ``key``; None where it is ignored."""
        found = next((one for one in self.tolerances if fnmatch(key, one.metric)), None)
        if found is None:
            raise PzcapError(f"{GATE.name}: no tolerance fits {key}; add a line for it, or a last one for '*'")
        return None if found.ignored else found


@dataclass(frozen=True, slots=True)
class Figure:
    """A metric when the baseline was made, and how much worse it may be since."""

    value: float
    unit: str
    direction: Direction
    tolerance: float


@dataclass(frozen=True, slots=True)
class Case:
    overrides: tuple[str, ...]  # it is a baseline of these alone
    figures: dict[str, Figure]


@dataclass(frozen=True, slots=True)
class Move:
    """One figure then and now."""

    case: str
    key: str
    then: Figure | None
    now: Metric | None
    verdict: Verdict

    @property
    def fails(self) -> bool:
        return self.verdict in ("worse", "gone")


def read_config(path: Path) -> GateConfig:
    """Content of gate.yaml."""
    return structured(OmegaConf.to_container(OmegaConf.load(path), resolve=True), GateConfig, path.name)


def figures(found: Sequence[Metric], config: GateConfig) -> dict[str, Figure]:
    """The part of a run's metrics that goes into the baseline."""
    kept = {}
    for metric in found:
        tolerance = config.tolerance(metric.key)
        if tolerance is not None and metric.value is not None:
            allowed = tolerance.relative * abs(metric.value) + tolerance.absolute
            kept[metric.key] = Figure(float(metric.value), metric.unit, metric.direction, allowed)
    return kept


def moves(
    case: str, then: Mapping[str, Figure], found: Sequence[Metric], config: GateConfig, *, partial: bool = False
) -> list[Move]:
    """Every figure of ``case`` then and now. ``partial``: what is not estimated now is nobody's fault."""
    now = {m.key: m for m in found if m.value is not None and config.tolerance(m.key) is not None}
    result = []
    for key in [*then, *(key for key in now if key not in then)]:
        before, after = then.get(key), now.get(key)
        if after is None and partial:
            continue
        result.append(Move(case, key, before, after, _verdict(before, after)))
    return result


def _verdict(then: Figure | None, now: Metric | None) -> Verdict:
    if then is None:
        return "new"
    if now is None or now.value is None:
        return "gone"
    worse = now.value - then.value if then.direction == "lower" else then.value - now.value
    if worse > then.tolerance:
        return "worse"
    return "better" if worse < -then.tolerance else "same"


def read_baseline(path: Path, config: GateConfig) -> dict[str, Case]:
    """The baseline. PzcapError if there is none, or if it was made of other experiments."""
    if not path.is_file():
        raise PzcapError(f"{path}: there is no baseline yet; `make baseline` makes one")
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise PzcapError(f"{path}: no JSON ({error}); take it from git, or make it anew by `make baseline`") from error
    cases = structured(content["cases"], dict[str, Case], path.name)
    if {name: list(case.overrides) for name, case in cases.items()} != {n: config.overrides(n) for n in config.cases}:
        raise PzcapError(f"{path}: made of other experiments than {GATE.name} names; `make baseline` makes it anew")
    return cases


def write_baseline(path: Path, cases: Mapping[str, Case], info: Mapping[str, Any]) -> None:
    """Write the baseline: case -> overrides, and metric -> value, unit, direction, tolerance. Whole or not at all."""
    content = {
        "made_with": {"versions": info["versions"], "machine": info["machine"]},
        "cases": {name: asdict(case) for name, case in cases.items()},
    }
    write_json(path, content)


def measure(config: GateConfig, case: str, extra: Sequence[str], console: Console) -> tuple[list[Metric], bool]:
    """The metrics of one case, and whether an estimator of somebody's made them."""
    GlobalHydra.instance().clear()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        tree = plain(compose("config", overrides=[*config.overrides(case), *extra]))
    app = build(tree)
    return run(app, tree, FOLDER / case, console), app.estimator is not None


def moves_table(found: Sequence[Move]) -> Table:
    """Then and now."""
    rows = []
    colours = {"worse": "red", "gone": "red", "better": "green", "new": "yellow", "same": "dim"}
    for move in found:
        then, now = move.then, move.now
        before = "–" if then is None else format_value(Metric(move.key, then.value, then.unit))
        after = "–" if now is None else format_value(now)
        change = "–"
        if then is not None and now is not None and now.value is not None:
            change = f"{now.value - then.value:+.3g}"
        unit = then.unit if then is not None else now.unit if now is not None else ""
        sign = "" if then is None else "+" if then.direction == "lower" else "−"
        allowed = "–" if then is None else f"{sign}{then.tolerance:.3g}"
        verdict = Text(move.verdict, colours[move.verdict])
        rows.append((move.case, move.key, before, after, change, allowed, unit, verdict))
    columns = ("case", "metric", ">baseline", ">now", ">change", ">allowed", "unit", "")
    return table("What moved", columns, rows, plain=True)


def judge(found: Sequence[Move], console: Console) -> None:
    """Print what moved, and raise AlreadyReported if anything is worse."""
    moved = [move for move in found if move.verdict != "same"]
    if moved:
        print_whole(console, moves_table(sorted(moved, key=lambda move: not move.fails)))
    failed = sum(move.fails for move in found)
    better = sum(move.verdict == "better" for move in found)
    if failed:
        console.print(f"{failed} of {len(found)} figures are worse. If that is meant, `make baseline` and say why.")
        raise AlreadyReported(f"{failed} figures are worse")
    hint = f"; {better} are better: `make baseline` makes that the measure" if better else ""
    console.print(f"None of {len(found)} figures is worse{hint}.")


def _compare(config: GateConfig, extra: Sequence[str], out: Console, err: Console) -> None:
    baseline = read_baseline(BASELINE, config)
    found: list[Move] = []
    for case in config.cases:
        metrics, partial = measure(config, case, extra, err)
        found += moves(case, baseline[case].figures, metrics, config, partial=partial)
    judge(found, out)


def _renew(config: GateConfig, extra: Sequence[str], out: Console, err: Console) -> None:
    if extra:
        raise PzcapError(f"a baseline is what the defaults reach; leave out {' '.join(extra)}")
    cases = {
        case: Case(tuple(config.overrides(case)), figures(measure(config, case, [], err)[0], config))
        for case in config.cases
    }
    write_baseline(BASELINE, cases, run_info({}, 0))
    out.print(f"{sum(len(case.figures) for case in cases.values())} figures in {BASELINE.name}; commit it")


def main() -> int:
    """The command. Exit status 0, or 1."""
    parser = command_line("gate", __doc__)
    parser.add_argument("--renew", action="store_true", help="make the baseline of what is reached now")
    options, extra = parser.parse_known_args()
    task = _renew if options.renew else _compare
    return guard(lambda: task(read_config(GATE), extra, terminal(), terminal(stderr=True)))


if __name__ == "__main__":
    sys.exit(main())
