"""An error budget of the body in millimetres: what each piece of evidence is worth, and what each error costs.

    python -m experiments.comparisons.ablation seed=0 hydra.run.dir=DIR       # conf/experiment/ablation.yaml
    python -m experiments.comparisons.ablation experiment=pedestrian          # of another motion
    python -m experiments.comparisons.ablation capture=FOLDER                 # with truth/ beside it

prints a table and leaves DIR/{metrics.json, ablation.csv, ablation.png, keyframes.png}. The cameras are prepared and
found once; then the body is tracked under one variant after the other (`experiments.comparisons.ablation.variants`):

switched off  one piece of evidence, or one step, is left out.
keyframes     fewer of those that the capture has, or more, posed with the error of a hand as those are. The second plot
              is the joint error against keyframes a second.
cameras       the body may not correct them (`pzcap.tracking.camera_refinement`); or each pan is made wrong, and the
tracker told by how
              much it may be.
known         the experiment puts the truth in place of an estimate: cameras, masks (before a hall that shows them, so
              that colours agree), the athlete's lengths and girths, the keyframes' poses. The tracker is the same, and
              does not know.

Joints are scored as in a run, in frames that are keyframes neither by default nor in the variant.
"""

from __future__ import annotations

import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from rich.console import Console

from experiments import footage
from experiments.command import command
from experiments.comparisons.ablation import show
from experiments.comparisons.ablation.trial import Outcome, attempt, prepare
from experiments.comparisons.ablation.variants import VARIANTS, Variant
from experiments.config import AppConfig
from experiments.metrics import run_info, write_metrics
from experiments.progress import Bars
from pzcap.io.capture import read_capture
from pzcap.types import PzcapError


def run(config: AppConfig, tree: dict[str, Any], folder: Path, console: Console) -> list[Outcome]:
    """Everything from the shoot to the plots, into ``folder``. PzcapError for what the user can mend."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in show.RESULTS:
        (folder / name).unlink(missing_ok=True)
    with Bars(console) as bars:
        shot = footage.capture_of(config, bars.update)
        truth = footage.truth_beside(shot)
        if truth is None:
            raise PzcapError(f"{shot}: an ablation needs the truth; give a capture with truth/ beside it, or none")
        material = prepare(read_capture(shot), truth, config.reconstruct, bars.update)
    with Bars(console) as bars, ThreadPoolExecutor(config.reconstruct.threads) as pool:

        def one(variant: Variant) -> Outcome:
            return attempt(material, variant, config.reconstruct, bars.update)

        outcomes = list(pool.map(one, VARIANTS))
    write_metrics(folder / "metrics.json", show.metrics_of(outcomes), run_info(tree, config.seed))
    show.write_csv(folder / "ablation.csv", outcomes)
    show.plot_budget(folder / "ablation.png", outcomes)
    show.plot_keyframes(folder / "keyframes.png", outcomes)
    return outcomes


def main() -> int:
    """The command. Exit status 0, or 1 with a line on stderr."""
    return command("ablation", run, show.print_budget)


if __name__ == "__main__":
    sys.exit(main())
