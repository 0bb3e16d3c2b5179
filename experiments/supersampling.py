"""Error and cost of pictures against how finely they are rendered.

    python -m experiments.supersampling                     # 2, 2.25, 2.5, 3 and 4 pixels for each of the image
    python -m experiments.supersampling 2 3 --views 30

Pictures of the first camera, of a sweep and a zoom run of the floor exercise, are compared with the same ones rendered
eight times finer and without mipmaps. By least squares over all pixels it is found how far a picture stands beside that
one, and how much too large it is, as an error of pan, tilt and focal length would have it; and how far each field of
64 x 60 pixels stands beside itself. All are root mean squares over the pictures. The cost is CPU time of all threads.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from rich.console import Console

from experiments.errors import guard
from experiments.terminal import command_line, table, terminal
from pzcap.types import Array, Image
from sim.cameras.film import FilmCamera
from sim.cameras.sensor import SensorConfig
from sim.session import Run, Session, ShootConfig, assemble

SCALES: Final = (2.0, 2.25, 2.5, 3.0, 4.0)
EXACT: Final = SensorConfig(supersampling_hall=8.0, mipmaps=False)
FIELD_PX: Final = (60, 64)  # height, width
TEXTURED: Final = 3000.0  # sum of squared slopes of a field, grey levels^2: with less there is nothing to be displaced


@dataclass(frozen=True, slots=True)
class Errors:
    """Of some pictures, root mean squares."""

    across_mpx: float
    down_mpx: float
    focal_percent: float
    field_mpx: float


def pictures(config: ShootConfig, sensor: SensorConfig, views: int) -> tuple[list[Image], float]:
    """Pictures along the sweep and the zoom run as ``sensor`` would have them rendered; CPU seconds for each."""
    session = assemble(replace(config, sensor=sensor))
    stage = session.stage()
    try:
        camera = FilmCamera(stage, session.rigs[0], sensor)
        moments = _moments(session, views)
        run, time_s = moments[0]
        camera.instant(run.at, time_s, None)  # compiles what the first picture needs
        start = time.process_time()
        found = [camera.instant(run.at, time_s, None) for run, time_s in moments]
        return found, (time.process_time() - start) / len(found)
    finally:
        stage.close()


def _moments(session: Session, views: int) -> list[tuple[Run, float]]:
    """Two thirds of them through the sweep, the others through the zoom run."""
    parts = ((session.sweep(0), views - views // 3), (session.zoom(0), views // 3))
    return [
        (run, float(run.times_s[k]))
        for run, count in parts
        if len(run.times_s)
        for k in np.linspace(0, len(run.times_s) - 1, count).round().astype(int)
    ]


def compare(some: Sequence[Image], exact: Sequence[Image]) -> Errors:
    """Displacement and magnification of pictures against those that are ``exact``."""
    whole, fields = [], []
    for picture, right in zip(some, exact, strict=True):
        grey, wanted = (one.mean(axis=2, dtype=np.float64) for one in (picture, right))
        down, across = np.gradient((grey + wanted) / 2)
        v, u = np.indices(grey.shape) - (np.array(grey.shape)[:, None, None] - 1) / 2
        whole.append(_solve([across, down, across * u + down * v], grey - wanted)[:3])
        height, width = FIELD_PX
        for top in range(0, grey.shape[0], height):
            for left in range(0, grey.shape[1], width):
                part = np.s_[top : top + height, left : left + width]
                if min(np.sum(across[part] ** 2), np.sum(down[part] ** 2)) > TEXTURED:
                    fields.append(_solve([across[part], down[part]], (grey - wanted)[part])[:2])
    shift_across, shift_down, magnified = np.sqrt(np.mean(np.square(whole), axis=0)).tolist()
    return Errors(
        1e3 * shift_across, 1e3 * shift_down, 100 * magnified, 1e3 * float(np.sqrt(np.mean(np.square(fields))))
    )


def _solve(slopes: Sequence[Array], difference: Array) -> Array:
    """What, times the slopes, and a constant brightness give the ``difference``."""
    design = np.stack([*slopes, np.ones_like(difference)], axis=-1).reshape(-1, len(slopes) + 1)
    return np.asarray(np.linalg.lstsq(design, difference.ravel(), rcond=None)[0])


def measure(scales: Sequence[float], config: ShootConfig, views: int, out: Console) -> None:
    """Print the table."""
    exact, _ = pictures(config, EXACT, views)
    rows = []
    for scale in scales:
        some, seconds = pictures(config, SensorConfig(supersampling_hall=scale), views)
        found = compare(some, exact)
        values = (found.across_mpx, found.down_mpx, found.field_mpx)
        rows.append((
            f"{scale:g}", *(f"{value:.2f}" for value in values), f"{found.focal_percent:.5f}", f"{1e3 * seconds:.0f}",
        ))  # fmt: skip
    heads = ("rendered finer", ">across mpx", ">down mpx", ">fields mpx", ">focal %", ">CPU ms")
    out.print(table(f"{len(exact)} pictures of {config.width} x {config.height}", heads, rows))


def main() -> int:
    """The command. Exit status 0, or 1 with a line on stderr."""
    parser = command_line("supersampling", __doc__)
    parser.add_argument("scales", nargs="*", type=float, help="rendered pixels for each pixel of the image")
    parser.add_argument("--views", type=int, default=9, help="pictures, two thirds of them of the sweep")
    options = parser.parse_args()
    scales = options.scales or SCALES
    return guard(lambda: measure(scales, ShootConfig(motion="floor_exercise"), options.views, terminal()))


if __name__ == "__main__":
    sys.exit(main())
