"""The paper's figures from two finished runs, a floor exercise and a pedestrian's.

    python -m experiments.run experiment=floor_exercise
    python -m experiments.run experiment=pedestrian
    python -m experiments.paper_figures                                   # of these two
    python -m experiments.paper_figures EXERCISE PEDESTRIAN --folder outputs/figures

leaves FOLDER/{index.html, figures.rrd} and a PNG and an SVG of each figure.
"""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import matplotlib as mpl

from experiments.errors import guard
from experiments.paper_figures import calibration, material, page, panoramas, zooming
from experiments.paper_figures.canvas import STYLE, Drawn
from experiments.paper_figures.common_field import common_field
from experiments.paper_figures.material import Run
from experiments.paper_figures.skeletons import skeletons
from experiments.terminal import terminal


def draw(exercise: Run, walk: Run) -> Iterator[Drawn]:
    """All figures, in the paper's order. Call it within the style of `canvas`."""
    yield common_field([exercise, walk])
    yield panoramas.panoramas(exercise)
    yield panoramas.located_frames(exercise)
    shot = calibration.shoot_again(exercise)
    yield calibration.wireframe(exercise, shot)
    yield calibration.matches(shot)
    yield skeletons(exercise)
    of_walk: tuple[Callable[[Run], Drawn], ...] = (zooming.top_view, zooming.focal_lengths, zooming.fixed_focus)
    yield from (figure(walk) for figure in of_walk)


def make(exercise: Run, walk: Run, folder: Path, command: str, report: Callable[[str], object]) -> list[Drawn]:
    """Draw all figures into ``folder``, with the page and the recording; ``report`` hears what is drawn."""
    folder.mkdir(parents=True, exist_ok=True)
    drawn = []
    with mpl.rc_context(STYLE):
        for one in draw(exercise, walk):
            report(f"figure {one.number}: {one.title}")
            page.save(one, folder)
            drawn.append(one)
    page.write_page(folder, drawn, [exercise, walk], command)
    page.write_recording(folder, drawn, walk)
    return drawn


def _options(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser("python -m experiments.paper_figures", description=__doc__.partition("\n")[0])
    runs = Path("outputs")
    for name, motion in (("exercise", "floor_exercise"), ("walk", "pedestrian")):
        default = runs / motion / "exact" / "0"
        parser.add_argument(name, type=Path, nargs="?", default=default, help=f"a finished run, by default {default}")
    parser.add_argument("--folder", type=Path, default=runs / "figures", help="where all of it goes")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command. Exit status 0, or 1 with a line on stderr."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    options = _options(given)
    console = terminal(stderr=True)

    def command() -> None:
        exercise = material.load(options.exercise, f"experiment=floor_exercise hydra.run.dir={options.exercise}")
        walk = material.load(options.walk, f"experiment=pedestrian hydra.run.dir={options.walk}")
        said = shlex.join(["python", "-m", "experiments.paper_figures", *given])
        make(exercise, walk, options.folder, said, lambda text: console.print(text, highlight=False))
        for name in (page.PAGE, page.RECORDING):
            print(options.folder / name)

    return guard(command)


if __name__ == "__main__":
    sys.exit(main())
