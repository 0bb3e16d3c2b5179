"""Forecast of `pzcap check`, and its word on right footage, against what is reached.

    python -m experiments.compare forecast seed=0                                    # all of EXPERIMENTS
    python -m experiments.compare forecast experiments=[own_clocks,mains_light] shoot.width=320 shoot.height=240

Each experiment of conf/experiment, its troubles and all, is shot, checked, reconstructed and scored as by
`experiments.run`; what that leaves, but for recording and report, is in DIR/NAME, and what the check said in
DIR/NAME/check.txt. Settings given here hold for all of them. Forecast over what was reached: between 1/2 and 2 it is
within a factor of two. The footage is right, so that nothing may have to be shot again.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from hydra import compose
from hydra.core.hydra_config import HydraConfig
from rich.console import Console

from experiments import footage
from experiments.comparisons.harness import Column, Comparison, Row
from experiments.config import CONVERTER, AppConfig, plain, structured
from experiments.progress import Bars
from experiments.run import run
from pzcap.command.check.findings import Level
from pzcap.command.check.forecast import Forecast
from pzcap.command.check.run import check_capture
from pzcap.io.capture import read_capture
from pzcap.io.files import write_bytes
from pzcap.types import PzcapError

EXPERIMENTS: Final = (
    "floor_exercise", "pedestrian", "partial_sweep", "hand_sweep", "lens_beyond", "mains_light", "own_clocks",
    "rolling_shutter", "rolling_clocks_mains", "sprung_floor", "auto_exposure", "interlaced", "all_cameras", "tilting",
    "fast_pan", "guessed_tape", "loose_clothing", "bystanders", "coach", "spotter", "crew", "crew_in_sweep",
    "lights_on", "keypoints", "full_turn_jump", "pirouette",
)  # fmt: skip
"""Right footage, each with another trouble."""


@dataclass(frozen=True, slots=True)
class ForecastConfig(AppConfig):
    """Everything that `python -m experiments.compare forecast` can be told: what a run can, and this."""

    experiments: tuple[str, ...] = EXPERIMENTS
    """Of conf/experiment."""


def compare(config: ForecastConfig, folder: Path, console: Console) -> Iterator[Row[Any]]:
    """Each experiment in turn. Raises PzcapError for a given capture."""
    if config.capture is not None:
        raise PzcapError("a comparison of forecasts shoots its own footage; leave capture=... out")
    given = [
        each for each in HydraConfig.get().overrides.task
        if not each.startswith(("experiment=", "experiments=", "seed=", "output.recording=", "output.report="))
    ]  # fmt: skip
    for name in config.experiments:
        overrides = [f"experiment={name}", f"seed={config.seed}", *given]
        tree = plain(compose(HydraConfig.get().job.config_name, overrides))
        one = structured(tree, ForecastConfig, name)
        yield judge(name, AppConfig(**{key: getattr(one, key) for key in _SHARED}), folder / name, console)


_SHARED: Final = tuple(AppConfig.__dataclass_fields__)


def judge(name: str, config: AppConfig, folder: Path, console: Console) -> Row[Any]:
    """Shoot, check, reconstruct and score one experiment, into ``folder``."""
    config = replace(config, output=replace(config.output, recording=False, report=False))
    folder.mkdir(parents=True, exist_ok=True)
    with Bars(console) as bars:
        capture = read_capture(footage.capture_of(config, bars.update))
        checked = check_capture(capture, bars.update)
    write_bytes(folder / "check.txt", "".join(f"{each.line()}\n" for each in checked.findings).encode())
    reached = {each.key: each.value for each in run(config, CONVERTER.unstructure(config), folder, console)}
    figures = compared(checked.forecast, reached)
    for level, key in ((Level.FAIL, "again"), (Level.WARN, "look")):
        figures[key] = float(sum(each.level is level for each in checked.findings))
    return Row(name, name, figures)


def compared(forecast: Forecast, reached: dict[str, float | None]) -> dict[str, float | None]:
    """Forecast, what was reached by the metrics of a run, and the first over the second."""
    figures: dict[str, float | None] = {}
    for key, expected, metric in (
        ("pan", forecast.pan_deg, "panzoom.pan.rms"),
        ("focal", forecast.focal_percent, "panzoom.focal.rms"),
        ("joints", forecast.joints_mm, "body.mpjpe.mean"),
    ):
        found = reached.get(metric)
        figures[f"{key}.forecast"], figures[f"{key}.reached"] = expected, found
        figures[f"{key}.ratio"] = expected / found if expected is not None and found else None
    return figures


def _columns(key: str, unit: str) -> tuple[Column, Column, Column]:
    return (
        Column(f"{key}.forecast", f"{key} {unit}", unit, "{:.2g}"),
        Column(f"{key}.reached", "reached", unit, "{:.2g}"),
        Column(f"{key}.ratio", "ratio", "", "{:.2f}"),
    )


COMPARISON: Final[Comparison[Any]] = Comparison(
    name="forecast",
    columns=(
        *_columns("pan", "deg"),
        *_columns("focal", "%"),
        *_columns("joints", "mm"),
        Column("again", "again", "", "{:.0f}"),
        Column("look", "look", "", "{:.0f}"),
    ),
    compare=compare,
    experiment="floor_exercise",
    variants="experiment",
    config=ForecastConfig,
    config_name="forecast",
)
