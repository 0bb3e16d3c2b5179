"""Worth of what a crew brings, in millimetres: each thing left at home by itself, and the useful combinations.

    python -m experiments.compare burden seed=0              # conf/experiment/burden.yaml shoots with a detector
    python -m experiments.compare burden capture=CAPTURE     # with keypoints, and the truth beside it

The footage stays the same, and what is left at home is taken out of the capture; only a sweep that does not go all the
way round, and recordings without timecode (nor genlock; brought together by three claps), are shot anew, which a
capture of anyone's own goes without. Cameras are calibrated again where their own material changes, and are the same
otherwise. Without a calibration object nobody knows where the world begins: then the motion is compared after one
similarity.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console

from experiments.comparisons.harness import (
    COVERED,
    LOST,
    MEAN,
    P95,
    Bar,
    Column,
    Comparison,
    Row,
    body,
    draw_bars,
    labelled,
    scored_capture,
    with_differences,
    without_keypoints,
)
from experiments.config import AppConfig
from experiments.progress import Bars
from pzcap.extras.reconstruct import reconstruct
from pzcap.io.capture import frame_sets
from pzcap.progress import Report
from pzcap.types import Capture, PzcapError, Reconstruction
from sim.session import ShootConfig
from sim.truth import Truth

PARTIAL_DEG: Final = 120.0
"""Sweep in place of a full turn."""
FOOTAGE: Final[Mapping[str, Callable[[ShootConfig], ShootConfig]]] = {
    "usual": lambda shoot: shoot,
    "partial": lambda shoot: replace(shoot, sweep_deg=PARTIAL_DEG),
    "no_timecode": lambda shoot: replace(
        shoot, crew=replace(shoot.crew, sync="sound"),
        sensor=replace(shoot.sensor, largest_roll=45, clock_offset=0.5, clock_drift_ppm=50.0),
    ),
}  # fmt: skip
"""Captures that were filmed, by the shoot of the usual."""
ALIGNED: Final = "body.mpjpe.similarity"
CUT_OFF: Final = 4.0
"""Times the error with everything, where a bar ends."""


def _without_zoom(capture: Capture) -> Capture:
    return replace(capture, cameras=tuple(replace(camera, zoom=None) for camera in capture.cameras))


def _without_keyframes(capture: Capture) -> Capture:
    return replace(capture, keyframe_poses={})


def _one_keyframe(capture: Capture) -> Capture:
    """The one in the middle: nobody says which is best."""
    timecodes = sorted(capture.keyframe_poses)
    middle = timecodes[len(timecodes) // 2]
    return replace(capture, keyframe_poses={middle: capture.keyframe_poses[middle]})


def _stature_alone(capture: Capture) -> Capture:
    assert capture.subject is not None, "it has been scored"
    known = {"stature": capture.subject.measurements_m["stature"]}
    return replace(capture, subject=replace(capture.subject, measurements_m=known))


def _without_object(capture: Capture) -> Capture:
    return replace(capture, calibration_object=None)


@dataclass(frozen=True, slots=True, eq=False)
class Variant:
    """A crew that leaves something at home."""

    key: str
    label: str
    group: str
    changes: tuple[Callable[[Capture], Capture], ...] = ()
    footage: str = "usual"  # of FOOTAGE

    @property
    def cameras(self) -> tuple[object, ...]:
        """The material that its cameras are calibrated from: variants that agree in it have the same ones. Without a
        calibration object that is all of it."""
        placed_by = self.changes if _without_object in self.changes else ()
        return (self.footage, _without_zoom in self.changes, *placed_by)

    def of(self, capture: Capture) -> Capture:
        """The part of the ``capture`` that this crew brings home."""
        for change in self.changes:
            capture = change(capture)
        return capture


VARIANTS: Final = (
    Variant("everything", "everything", "everything"),
    Variant("no_object", "no object, no keyframe *", "cameras", (_without_object, _without_keyframes)),
    Variant("partial_sweep", f"{PARTIAL_DEG:.0f} degrees, no full turn", "cameras", footage="partial"),
    Variant("no_zoom", "no zoom run", "cameras", (_without_zoom,)),
    Variant("no_timecode", "no timecode, claps", "cameras", footage="no_timecode"),
    Variant("stature", "stature, no tape", "body", (_stature_alone,)),
    Variant("no_keypoints", "no detector", "body", (without_keypoints,)),
    Variant("one_keyframe", "one keyframe by hand", "body", (_one_keyframe,)),
    Variant("one_alone", "one keyframe, no detector", "body", (_one_keyframe, without_keypoints)),
    Variant("no_keyframes", "no keyframe by hand", "body", (_without_keyframes,)),
    Variant("neither", "neither keyframe nor detector", "body", (_without_keyframes, without_keypoints)),
    Variant("no_hand", "no keyframe, no tape", "together", (_without_keyframes, _stature_alone)),
    Variant("least", "no keyframe, tape or zoom run", "together",
            (_without_keyframes, _stature_alone, _without_zoom)),
    Variant("least_partial", "the same, no full turn", "together",
            (_without_keyframes, _stature_alone, _without_zoom), footage="partial"),
    Variant("stature_and_detector", "no keyframe, tape or object *", "together",
            (_without_keyframes, _stature_alone, _without_object)),
)  # fmt: skip


def compare(config: AppConfig, folder: Path, console: Console) -> Sequence[Row[Any]]:
    """Each crew in turn. Raises PzcapError where the capture has no keypoints or no keyframes to leave at home."""
    del folder
    with Bars(console) as bars:
        capture, truth = scored_capture(config, bars.update)
        if not any(camera.keypoints for camera in capture.cameras) or not capture.keyframe_poses:
            raise PzcapError(f"{capture.folder}: to leave keyframes or keypoints at home it has to have both")
        shot: dict[str, tuple[Capture, Truth] | None] = {"usual": (capture, truth)}
        known: dict[tuple[object, ...], Reconstruction] = {}
        rows: list[Row[Any]] = []
        for variant in VARIANTS:
            if variant.footage not in shot:
                shot[variant.footage] = _shot(config, variant.footage, bars.update)
            material = shot[variant.footage]
            if material is None:
                rows.append(Row(variant.key, variant.label, {}, variant.group, "would have to be shot"))
            else:
                rows.append(_row(variant, *material, config, known, bars.update))
    return with_differences(rows, MEAN.key)


def _shot(config: AppConfig, footage: str, report: Report) -> tuple[Capture, Truth] | None:
    """The same take by a crew that filmed otherwise; None where the capture is somebody's own."""
    if config.capture is not None:
        return None
    return scored_capture(replace(config, shoot=FOOTAGE[footage](config.shoot)), report)


def _row(
    variant: Variant, capture: Capture, truth: Truth, config: AppConfig,
    known: dict[tuple[object, ...], Reconstruction], report: Report,
) -> Row[Any]:  # fmt: skip
    """The figures of one crew. Its cameras are ``known`` where another's were calibrated from the same."""
    mine = variant.of(capture)
    try:
        found = reconstruct(mine, config.reconstruct, labelled(report, variant.label), known.get(variant.cameras))
    except PzcapError as error:
        return Row(variant.key, variant.label, {}, variant.group, str(error))
    known.setdefault(variant.cameras, found)
    figures: dict[str, float | None] = {}
    if found.motion is not None:
        # all are scored in the same frames: those that no hand has posed for anybody
        posed = np.array([key.frame for key in frame_sets(capture).keyframes], np.int64)
        figures = body(replace(found, motion=replace(found.motion, keyframes=posed)), truth)
        if mine.calibration_object is None:
            figures = {key: value for key, value in figures.items() if key.endswith("similarity")}
    if figures.get(ALIGNED) is None:  # a hand's keyframes may be all that there is
        return Row(variant.key, variant.label, {}, variant.group, found.notes[0])
    return Row(variant.key, variant.label, figures, variant.group)


def draw(figure: Figure, rows: Sequence[Row[Any]]) -> None:
    """A bar a crew, cut off where it is far longer than that of the one with everything."""
    bars = [
        Bar(row, next((each for name in (MEAN.key, ALIGNED) if (each := row.figures.get(name)) is not None), None),
            row.figures.get(LOST.key))
        for row in rows
    ]  # fmt: skip
    longest = CUT_OFF * (rows[0].figures.get(MEAN.key) or 10.0)
    draw_bars(figure, bars, longest, "mean joint error [mm]; *: after one similarity of the whole motion")


COMPARISON: Final[Comparison[Any]] = Comparison(
    name="burden",
    columns=(
        MEAN,
        P95,
        Column("more", "± mean", "mm", "{:+.1f}"),
        Column(ALIGNED, "aligned mm", "mm", "{:.1f}"),
        Column("body.size.similarity", "size %", "%", "{:.2f}"),
        LOST,
        COVERED,
    ),
    compare=compare,
    plots={"burden.png": ((7.2, 0.27 * 1.15 * len(VARIANTS) + 0.9), draw)},
    experiment="burden",
    variants="brought",
    note="aligned: after one similarity of the whole motion; size: of the motion before that, over the true one",
)
