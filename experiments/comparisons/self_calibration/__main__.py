"""Ours against self-calibration after Shum and Szeliski, Sinha and Pollefeys, and Wu and Radke, on the same captures.

    python -m experiments.comparisons.self_calibration seed=0 hydra.run.dir=DIR      #
    conf/experiment/self_calibration.yaml python -m experiments.comparisons.self_calibration capture=FOLDER
    # with truth/ beside it

prints a table and leaves DIR/{metrics.json, self_calibration.png}. Three sets of frames of each camera:

empty    some of the sweep and the zoom run: nobody in the hall. All methods calibrate from these frames alone, but for
         ours, which has the whole sweep and the image of the calibration object, too.
athlete  some of the motion, as it was filmed. The mosaic methods calibrate from these frames alone; ours and Wu and
         Radke's find them by what they learnt from the empty hall.
masked   the same frames without the athlete: no features where the true masks, 6 px wider, have him. (Ours is given
         the frames with that part painted over.)

Self-calibration knows no reference pose: rotations, of all methods alike, are compared after the one rotation a camera
that brings them all nearest to the truth. A frame fails where it is not linked or found, its focal length is off by
more than 5 %, or its pan by more than a degree, or fewer than five of its camera's are left; medians are over the
others.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from rich.console import Console

from experiments import footage
from experiments.command import command
from experiments.comparisons.self_calibration.show import PLOT, metrics_of, plot, print_comparison
from experiments.comparisons.self_calibration.trial import compare
from experiments.config import AppConfig
from experiments.metrics import Metric, run_info, write_metrics
from experiments.progress import Bars
from pzcap.io.capture import read_capture
from pzcap.types import PzcapError


def run(config: AppConfig, tree: dict[str, Any], folder: Path, console: Console) -> list[Metric]:
    """Everything from the shoot to the plot, into ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    with Bars(console) as bars:
        shot = footage.capture_of(config, bars.update)
    capture = read_capture(shot)
    truth = footage.truth_beside(shot)
    if truth is None:
        raise PzcapError(f"{shot}: a comparison needs the truth; give a capture with truth/ beside it, or none")
    with Bars(console) as bars:
        found = metrics_of(compare(capture, truth, config, bars.update))
    write_metrics(folder / "metrics.json", found, run_info(tree, config.seed))
    plot(folder / PLOT, found)
    return found


def main() -> int:
    """The command. Exit status 0, or 1 with a line on stderr."""
    return command("self_calibration", run, print_comparison)


if __name__ == "__main__":
    sys.exit(main())
