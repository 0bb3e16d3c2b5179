"""Footage that somebody, or the camera itself, has worked on: what each treatment of the pictures costs.

    python -m experiments.compare treated_footage seed=0 shoot.width=480 shoot.height=360 shoot.motion_frames=60
    python -m experiments.compare treated_footage capture=CAPTURE treatments=[date,bars]      # truth beside it

Every file is decoded, treated and encoded anew, so that ``copied``, which is encoded anew and nothing else, is what
the others are compared with. Cameras are calibrated from the treated files. ``notes`` counts the notes that the footage
does not raise as it was shot; they are in said.txt, with what would help. Of pictures that show things larger, smaller
or elsewhere than the lens had them the truth does not know the focal lengths, or the pan.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import cv2
import numpy as np
from rich.console import Console

from experiments.comparisons.harness import COVERED, LOST, MEAN, P95, Column, Comparison, Row, labelled, scored_capture
from experiments.config import AppConfig
from experiments.progress import Bars
from experiments.score import score
from experiments.totals import metrics
from pzcap.extras.keyframe_diagnostics import is_advice
from pzcap.extras.reconstruct import reconstruct
from pzcap.io.capture import FOOTAGE, read_image
from pzcap.io.files import written_whole
from pzcap.io.video import VideoReader
from pzcap.types import Array, CameraFiles, Capture, Image, PzcapError, Reconstruction
from sim.capture_writer import write_video
from sim.truth import Truth

SAID: Final = "said.txt"
PAN: Final = Column("panzoom.pan.rms", "pan deg", "deg", "{:.2g}")
FOCAL: Final = Column("panzoom.focal.rms", "focal %", "%", "{:.2g}")
LOST_VIEWS: Final = Column("panzoom.lost", "views lost", "views", "{:.0f}")
NEES: Final = Column("panzoom.nees", "NEES", "1", "{:.1f}")
OF_SIZE: Final = (FOCAL.key, NEES.key)
"""Columns that are not compared where things come out larger or smaller than the lens had them."""
CRF: Final = 16
"""x264's, of what is encoded anew: an editor's usual export."""
NOISE: Final = 12.0
"""Grey levels of a change that a filter of noise takes for none."""
MIXED: Final = 0.75
"""Share of the picture before that it mixes in where nothing changes."""
HELD_PX: Final = 8.0
"""Most by which a stabiliser shifts a picture, and the margin that it cuts off for it."""
RECENTRED: Final = 0.1
"""Share of its shift that it gives up with each frame."""
FLASH_EVERY: Final = 15
"""Pictures from a flash to the next."""
HUNTING_EVERY: Final = 60
"""Pictures from where focus is lost to where it is lost again."""
BLUR_PX: Final = 3.0
"""Standard deviation of the blur where focus is furthest off."""


@dataclass(frozen=True, slots=True)
class TreatedFootageConfig(AppConfig):
    """Everything that `python -m experiments.compare treated_footage` can be told: what a run can, and this."""

    treatments: tuple[str, ...] = ()
    """Of `TREATMENTS`; none: all."""


@dataclass(frozen=True, slots=True, eq=False)
class Treatment:
    """Something that is done to the pictures of a capture."""

    key: str
    label: str
    treat: Callable[[Iterator[Image]], Iterator[Image]]  # the pictures of one file
    camera: int | None = None  # which is treated; None: all
    only: str | None = None  # file of `FOOTAGE` that is treated; None: all
    not_compared: tuple[str, ...] = ()  # keys of columns in which the truth is of other pictures
    crf: int = CRF


def pictured(change: Callable[[Image], Image]) -> Callable[[Iterator[Image]], Iterator[Image]]:
    """The same done to each picture."""
    return lambda pictures: map(change, pictures)


def scaled(times: float) -> Callable[[Image], Image]:
    """Pictures of so many times the size, to the next even number."""

    def change(image: Image) -> Image:
        height, width = (2 * round(times * side / 2) for side in image.shape[:2])
        kind = cv2.INTER_AREA if times < 1.0 else cv2.INTER_CUBIC
        return np.asarray(cv2.resize(image, (width, height), interpolation=kind), np.uint8)

    return change


def closer(times: float) -> Callable[[Image], Image]:
    """The middle of a picture, so many times as large."""

    def change(image: Image) -> Image:
        middle = 0.5 * np.array([image.shape[1] - 1.0, image.shape[0] - 1.0])
        return _moved(image, np.column_stack([times * np.eye(2), (1.0 - times) * middle]))

    return change


def _moved(image: Image, place: Array) -> Image:
    """Each pixel at ``place`` (2, 3) of itself; beyond the borders their own colours."""
    size = image.shape[1], image.shape[0]
    moved = cv2.warpAffine(image, place, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(moved, np.uint8)


def with_date(pictures: Iterator[Image]) -> Iterator[Image]:
    """A running clock at the foot, a name at the head, and a red light that blinks."""
    for number, image in enumerate(pictures):
        height, width = image.shape[:2]
        size, shown = height / 500.0, image.copy()
        clock = f"2026-11-29 10:24:{number // 30 % 60:02d}"
        for text, at in ((clock, (0.55 * width, 0.95 * height)), ("HALL CAM", (0.04 * width, 0.08 * height))):
            place = (int(at[0]), int(at[1]))
            cv2.putText(shown, text, place, cv2.FONT_HERSHEY_SIMPLEX, size, (0, 0, 0), 3, cv2.LINE_AA)
            cv2.putText(shown, text, place, cv2.FONT_HERSHEY_SIMPLEX, size, (255, 255, 255), 1, cv2.LINE_AA)
        if number // 15 % 2 == 0:
            cv2.circle(shown, (int(0.95 * width), int(0.06 * height)), int(8 * size), (30, 30, 220), -1, cv2.LINE_AA)
        yield shown


def with_bars(image: Image) -> Image:
    """A sixth of the width black on either side."""
    bar, barred = image.shape[1] // 6, image.copy()
    barred[:, :bar] = barred[:, -bar:] = 0
    return barred


def sharpened(image: Image) -> Image:
    """Unsharp mask: 0.8 of what a blur of 1.2 pixels takes away."""
    return np.asarray(cv2.addWeighted(image, 1.8, cv2.GaussianBlur(image, (0, 0), 1.2), -0.8, 0.0), np.uint8)


def graded(image: Image) -> Image:
    """A curve of more contrast, as a colourist draws it."""
    grey = np.linspace(0.0, 1.0, 256)
    curve = grey + 0.4 * (grey * grey * (3.0 - 2.0 * grey) - grey)
    return np.rint(255.0 * curve).astype(np.uint8)[image]


def less_noisy(pictures: Iterator[Image]) -> Iterator[Image]:
    """Noise filtered over time, as camcorders do it: what hardly changes is mixed with what it was."""
    kept: np.ndarray | None = None
    for image in pictures:
        shown = image.astype(np.float32)
        if kept is not None:
            change = np.abs(cv2.blur(shown - kept, (3, 3))).max(axis=2, keepdims=True)
            share = MIXED * np.clip(1.0 - change / NOISE, 0.0, 1.0)
            shown = share * kept + (1.0 - share) * shown
        kept = shown
        yield np.rint(shown).astype(np.uint8)


def stabilised(pictures: Iterator[Image]) -> Iterator[Image]:
    """Shifts held back by a stabiliser, which lags behind a pan, and the margin that it needs cut off."""
    grey: np.ndarray | None = None
    shift = np.zeros(2)
    for image in pictures:
        height, width = image.shape[:2]
        before, grey = grey, cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(np.float32)
        if before is not None:
            moved, _ = cv2.phaseCorrelate(before, grey)
            shift = np.clip((1.0 - RECENTRED) * (shift - moved), -HELD_PX, HELD_PX)
        scale = width / (width - 2.0 * HELD_PX)
        middle = 0.5 * np.array([width - 1.0, height - 1.0])
        place = np.column_stack([scale * np.eye(2), middle - scale * (middle - shift)])
        yield _moved(image, place)


def flashed(pictures: Iterator[Image]) -> Iterator[Image]:
    """Somebody's flash in one picture of fifteen: a band of rows, since the shutter rolls, twice as bright."""
    for number, image in enumerate(pictures):
        if number % FLASH_EVERY == FLASH_EVERY - 1:
            height, image = len(image), image.copy()
            band = slice(number * height // 40 % height, None)
            image[band] = np.minimum(2 * image[band].astype(np.uint16), 255)
        yield image


def hunting(pictures: Iterator[Image]) -> Iterator[Image]:
    """Focus lost and found again in the first third of each two seconds."""
    for number, image in enumerate(pictures):
        lost = float(np.sin(np.pi * min(number % HUNTING_EVERY / (HUNTING_EVERY / 3), 1.0)))
        yield image if lost < 0.05 else np.asarray(cv2.GaussianBlur(image, (0, 0), BLUR_PX * lost), np.uint8)


TREATMENTS: Final = (
    Treatment("copied", "encoded anew", iter),
    Treatment("date", "a date, a name and a red light in them", with_date),
    Treatment("bars", "black bars on either side", pictured(with_bars)),
    Treatment("sharpened", "sharpened", pictured(sharpened)),
    Treatment("graded", "a curve of more contrast", pictured(graded)),
    Treatment("noise_filter", "noise filtered over time", less_noisy),
    Treatment("flashes", "flashes in the motion", flashed, only="motion"),
    Treatment("hunting", "focus of camera 1 hunts in the motion", hunting, camera=0, only="motion"),
    Treatment("stabilised", "a stabiliser left on", stabilised, not_compared=(PAN.key, *OF_SIZE)),
    Treatment("messenger", "two thirds as large, crf 30, by a messenger", pictured(scaled(2 / 3)), crf=30,
              not_compared=OF_SIZE),
    Treatment("enlarged", "half again as large", pictured(scaled(1.5)), not_compared=OF_SIZE),
    Treatment("cut_closer", "the motion cut closer, by 1.1", pictured(closer(1.1)), only="motion",
              not_compared=(PAN.key, *OF_SIZE)),
    Treatment("another_size", "camera 2 two thirds as large", pictured(scaled(2 / 3)), camera=1, not_compared=OF_SIZE),
)  # fmt: skip


def compare(config: TreatedFootageConfig, folder: Path, console: Console) -> Iterator[Row[Any]]:
    """Each treatment in turn. Raises PzcapError for one that there is not."""
    unknown = set(config.treatments) - {treatment.key for treatment in TREATMENTS}
    if unknown:
        known = ", ".join(treatment.key for treatment in TREATMENTS)
        raise PzcapError(f"no treatment '{min(unknown)}'; one of {known}")
    said: list[str] = []
    with Bars(console) as bars:
        capture, truth = scored_capture(config, bars.update)
        usual = reconstruct(capture, config.reconstruct, bars.update)
        yield Row("as_shot", "as it was shot", _figures(usual, truth))
        for treatment in TREATMENTS:
            if config.treatments and treatment.key not in config.treatments:
                continue
            figures, notes = _tried(treatment, capture, truth, usual, config, bars, folder)
            said += [f"{treatment.label}:", *(f"  {each}" for each in notes)]
            with written_whole(folder / SAID) as partial:
                partial.write_text("\n".join(said) + "\n", encoding="utf-8")
            yield Row(treatment.key, treatment.label, figures)


def _tried(
    treatment: Treatment, capture: Capture, truth: Truth, usual: Reconstruction, config: TreatedFootageConfig,
    bars: Bars, folder: Path,
) -> tuple[dict[str, float | None], list[str]]:  # fmt: skip
    """Figures of a treatment, and the notes that the footage does not raise without it."""
    with TemporaryDirectory(dir=folder) as files:
        treated = treat(treatment, capture, Path(files))
        try:
            found = reconstruct(treated, config.reconstruct, labelled(bars.update, treatment.label))
        except PzcapError as error:
            return {"notes": 1.0}, [str(error)]
        figures = {key: each for key, each in _figures(found, truth).items() if key not in treatment.not_compared}
    raised = {_without_figures(note) for note in usual.notes}
    notes = [note for note in found.notes if _without_figures(note) not in raised]
    return {**figures, "notes": float(sum(not is_advice(note) for note in notes))}, notes


def _without_figures(note: str) -> str:
    return re.sub(r"[0-9.]+", "", note)


def treat(treatment: Treatment, capture: Capture, folder: Path) -> Capture:
    """The capture with treated files, which go into ``folder``."""
    return replace(
        capture,
        cameras=tuple(
            _treated(treatment, files, folder) if treatment.camera in (None, number) else files
            for number, files in enumerate(capture.cameras)
        ),
    )


def _treated(treatment: Treatment, files: CameraFiles, folder: Path) -> CameraFiles:
    changed: dict[str, Any] = {}
    for kind in FOOTAGE if treatment.only is None else (treatment.only,):
        source: Path | None = getattr(files, kind)
        if source is not None and kind == "reference":
            changed[kind] = folder / f"{kind}_{files.name}.png"
            cv2.imwrite(str(changed[kind]), next(treatment.treat(iter([read_image(source)]))))
        elif source is not None:
            changed[kind], reader = folder / f"{kind}_{files.name}.mp4", VideoReader(source)
            pictures = treatment.treat(image for _, image in reader)
            write_video(changed[kind], pictures, reader.frame_rate, crf=treatment.crf, timecode=reader.timecode)
    return replace(files, **changed)


def _figures(found: Reconstruction, truth: Truth) -> dict[str, float | None]:
    scored = {metric.key: metric.value for metric in metrics(score(found, truth, None))}
    return {column.key: scored[column.key] for column in COMPARISON.columns if column.key in scored}


COMPARISON: Final[Comparison[Any]] = Comparison(
    name="treated_footage",
    columns=(
        PAN, FOCAL, NEES, LOST_VIEWS, MEAN, P95, LOST, COVERED, Column("body.beyond3", "beyond %", "%", "{:.1f}"),
        Column("notes", "notes", "", "{:.0f}"),
    ),
    compare=compare,
    experiment="floor_exercise",
    variants="treated",
    config=TreatedFootageConfig,
    config_name="treated_footage",
    others=(SAID,),
)  # fmt: skip
