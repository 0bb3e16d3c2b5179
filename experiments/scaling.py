"""Growth of time and memory with the size of the images, the number of cameras and the length of the take.

    python -m experiments.scaling                              # all three: films for half an hour, once
    python -m experiments.scaling frames --values 150 600 3000
    python -m experiments.scaling --out FOLDER

Captures of the pedestrian that are small but for what grows are reconstructed in processes of their own. CPU seconds
are of all threads and processes; memory is the peak of all together. The exponent is that of a power law through the
values, by least squares in logarithms: 1 where twice as much takes twice as long. `index.html` in the folder draws it.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
import psutil
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullFormatter, NullLocator
from rich.console import Console

from experiments import pages
from experiments.config import AppConfig
from experiments.errors import guard
from experiments.footage import SMALL, shot
from experiments.memory import watched
from experiments.report.style import COLOURS, svg
from experiments.terminal import command_line, table, terminal
from pzcap.events import FrameLocalised
from pzcap.io.capture import read_capture
from pzcap.io.files import write_json
from pzcap.pipeline import Config, stages
from pzcap.types import PzcapError
from sim.session import ShootConfig

FOLDER: Final = Path("outputs/scaling")
BASE: Final = replace(SMALL, motion_frames=24)


@dataclass(frozen=True, slots=True)
class Axis:
    """A quantity that grows, and the shoots of some of its values."""

    label: str
    values: tuple[int, ...]
    shoot: Callable[[int], ShootConfig]
    amount: Callable[[int], int]  # that time is to be in proportion to


AXES: Final[Mapping[str, Axis]] = {
    "width": Axis(
        "pixels of an image", (320, 640, 960, 1280, 1920),
        lambda width: replace(BASE, width=width, height=width * 3 // 4), lambda width: width * (width * 3 // 4),
    ),
    "cameras": Axis(
        "cameras", (2, 4, 8),  # larger images: from along a wall markers are seen obliquely
        lambda cameras: replace(BASE, width=640, height=480, cameras=cameras), lambda cameras: cameras,
    ),
    "frames": Axis(
        "frame sets", (150, 600, 3000),
        lambda frames: replace(BASE, motion="to_and_fro", motion_frames=frames), lambda frames: frames,
    ),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Spent:
    """Time and memory that a reconstruction took."""

    calibration_s: float  # CPU
    motion_s: float  # CPU
    peak_mib: float


QUANTITIES: Final = {"calibration_s": "calibration, CPU s", "motion_s": "motion, CPU s", "peak_mib": "peak, MiB"}


def reconstructed(capture: Path) -> Spent:
    """Reconstruct a capture in this process."""
    calibrated_s = start_s = _family_s()
    with watched() as peak:
        for event in stages(read_capture(capture), Config()):
            if isinstance(event, FrameLocalised) and calibrated_s == start_s:
                calibrated_s = _family_s()
        end_s = _family_s()
    return Spent(calibrated_s - start_s, end_s - calibrated_s, peak.mib)


def _family_s() -> float:
    """CPU time so far of this process and its children, those that have ended included, seconds."""
    here = psutil.Process()
    times = [here.cpu_times(), *(child.cpu_times() for child in here.children(recursive=True))]
    return sum(each.user + each.system for each in times) + times[0].children_user + times[0].children_system


def in_a_process_of_its_own(capture: Path) -> Spent:
    """The same in another process, whose memory holds nothing else. Raises PzcapError if that fails."""
    line = [sys.executable, "-m", "experiments.scaling", "--reconstruct", str(capture)]
    done = subprocess.run(line, capture_output=True, text=True, check=False)
    if done.returncode:
        raise PzcapError(f"{capture}: {done.stderr.strip().splitlines()[-1] if done.stderr.strip() else 'killed'}")
    return Spent(**json.loads(done.stdout.splitlines()[-1]))


def exponent(amounts: Sequence[float], spent: Sequence[float]) -> float:
    """Of the power law through ``spent`` at ``amounts``."""
    return float(np.polyfit(np.log(amounts), np.log(spent), 1)[0])


def measure(names: Sequence[str], values: Sequence[int], folder: Path, out: Console) -> None:
    """Print a table an axis, and write the page. Raises PzcapError, after that, where a value could not be measured."""
    drawn, failed = {}, []
    for name in names:
        axis = AXES[name]
        found: dict[int, Spent] = {}
        for value in values or axis.values:
            out.print(f"{name} {value}: filming", highlight=False)
            capture = shot(axis.shoot(value), Path(AppConfig().output.captures)) / "capture"
            out.print(f"{name} {value}: reconstructing", highlight=False)
            try:
                found[value] = in_a_process_of_its_own(capture)
            except PzcapError as error:  # half an hour of what was measured is not lost with it
                failed.append(f"{name} {value}: {error}")
                out.print(failed[-1], highlight=False)
        if not found:
            continue
        amounts = [axis.amount(value) for value in found]
        apart = amounts != list(found)  # one column is enough where the value is the amount
        rows = [
            [str(value), *([f"{amount:,}"] if apart else []), *(f"{getattr(spent, key):.1f}" for key in QUANTITIES)]
            for amount, (value, spent) in zip(amounts, found.items(), strict=True)
        ]
        if len(found) > 1:
            slopes = (exponent(amounts, [getattr(spent, key) for spent in found.values()]) for key in QUANTITIES)
            rows.append(["exponent", *([""] if apart else []), *(f"{slope:.2f}" for slope in slopes)])
        heads = (name, *([f">{axis.label}"] if apart else []), *(f">{label}" for label in QUANTITIES.values()))
        out.print(table(axis.label, heads, rows))
        drawn[name] = (axis.label, amounts, list(found.values()), [head.removeprefix(">") for head in heads], rows)
    figures = {
        name: [{"amount": amount, **asdict(spent)} for amount, spent in zip(amounts, spents, strict=True)]
        for name, (_, amounts, spents, _, _) in drawn.items()
    }
    write_json(folder / "scaling.json", figures)
    sections = [
        {"title": label, "figure": _figure(label, amounts, spents), "heads": heads, "rows": rows}
        for label, amounts, spents, heads, rows in drawn.values()
    ]
    pages.write(folder / "index.html", "scaling.html.j2", {"sections": sections})
    out.print(f"{folder / 'index.html'}", highlight=False)
    if failed:
        raise PzcapError("; ".join(failed))


def _short(amount: float) -> str:
    return next(
        (f"{amount / unit:.3g}{sign}" for unit, sign in ((1e6, "M"), (1e3, "k")) if amount >= unit), f"{amount:g}"
    )


def _figure(label: str, amounts: Sequence[float], spents: Sequence[Spent]) -> object:
    """A panel a quantity, logarithmic both ways, beside what would be in proportion."""

    def draw(figure: Figure) -> None:
        for axes, (key, name), colour in zip(figure.subplots(1, 3), QUANTITIES.items(), COLOURS, strict=False):
            values = [getattr(spent, key) for spent in spents]
            axes.loglog(amounts, values, "o-", color=colour)
            axes.loglog(amounts, [values[0] * amount / amounts[0] for amount in amounts], "--", color="#9aa0a6")
            axes.set_title(name)
            axes.set_xlabel(label)
            axes.xaxis.set_major_locator(FixedLocator(list(amounts)))
            axes.xaxis.set_major_formatter(FuncFormatter(lambda amount, _: _short(amount)))
            axes.xaxis.set_minor_locator(NullLocator())
            axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.10g}"))
            axes.yaxis.set_minor_formatter(NullFormatter())
            axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))

    return svg(11.0, 3.2, draw)


def main() -> int:
    """The command. Exit status 0, or 1 with a line on stderr."""
    parser = command_line("scaling", __doc__)
    parser.add_argument("axes", nargs="*", choices=[*AXES, []], help="what grows; all if none is given")
    parser.add_argument("--values", nargs="+", type=int, default=[], help="of the one axis that is given")
    parser.add_argument("--out", type=Path, default=FOLDER)
    parser.add_argument("--reconstruct", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()

    def work() -> None:
        if options.reconstruct:
            print(json.dumps(asdict(reconstructed(options.reconstruct))))
            return
        if options.values and len(options.axes) != 1:
            raise PzcapError("--values are of one axis; name one of " + ", ".join(AXES))
        measure(options.axes or list(AXES), options.values, options.out, terminal())

    return guard(work)


if __name__ == "__main__":
    sys.exit(main())
