"""Where a run's footage comes from: shot now, kept from before, or brought by anyone."""

from __future__ import annotations

from pathlib import Path

from experiments.config import AppConfig
from experiments.progress import Bars
from pzcap.types import PzcapError
from sim import truth as truth_files
from sim.shoot import shoot_cached
from sim.truth import Truth


def capture_in(folder: Path) -> Path:
    """The capture that a user means: ``folder``, or the one inside it where it holds a truth, too."""
    inside = folder / "capture"
    return inside if inside.is_dir() and not (folder / "capture.json").exists() else folder


def shoot(config: AppConfig, bars: Bars) -> Path:
    """The capture of the shoot's config: shot now, or kept from before."""
    shooting = shoot_cached(config.shoot, Path(config.output.captures))
    while True:
        try:
            step = next(shooting)
        except StopIteration as end:
            return Path(end.value) / "capture"
        bars.update(step.stage, step.done, step.total)


def truth_beside(capture: Path) -> Truth | None:
    """The truth that lies beside a capture, if any."""
    folder = capture.resolve().parent / "truth"
    if not folder.is_dir():
        return None
    try:
        return truth_files.load(folder)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise PzcapError(f"{folder}: not a readable truth ({error}); remove it to go on without a score") from error
