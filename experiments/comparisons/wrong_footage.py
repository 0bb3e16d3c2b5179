"""Wrong footage and papers, one fault at a time on the same take: what it costs, and whether its cause is named.

    python -m experiments.compare wrong_footage seed=0
    python -m experiments.compare wrong_footage capture=CAPTURE faults=[lost_frame,late_clock]   # truth beside it

Cameras are calibrated once, and anew where their own files change. ``named`` is 1 where a note, or the error that the
run ends with, says what is wrong; ``notes`` counts all of those that right footage does not raise. What was said is in
said.txt.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.console import Console

from experiments.comparisons.harness import MEAN, P95, Column, Comparison, Row, body, labelled, scored_capture
from experiments.config import AppConfig
from experiments.progress import Bars
from pzcap.io.capture import frame_sets
from pzcap.io.files import written_whole
from pzcap.io.timecode import frames_to_timecode, timecode_to_frames
from pzcap.io.video import VideoReader
from pzcap.pipeline import reconstruct
from pzcap.types import Array, CameraFiles, Capture, Image, PzcapError, Reconstruction
from sim.capture_writer import write_video
from sim.truth import Truth

SAID: Final = "said.txt"


@dataclass(frozen=True, slots=True)
class WrongFootageConfig(AppConfig):
    """Everything that `python -m experiments.compare wrong_footage` can be told: what a run can, and this."""

    faults: tuple[str, ...] = ()
    """Of `FAULTS`; none: all."""


@dataclass(frozen=True, slots=True, eq=False)
class Fault:
    """Something that is wrong with a capture."""

    key: str
    label: str
    change: Callable[[Capture, Path], Capture]  # files that it makes go into the folder
    named: str  # what says so, a regular expression
    anew: bool = False  # the cameras' own files change


def recorded_again(
    capture: Capture, folder: Path, *, lost: int = 0, late: int = 0, mirrored: bool = False, shown_twice: int = 0
) -> Capture:
    """The motion of the first camera without so many pictures in the middle, the others one after the other, and its
    timecode so many frames later; no keyframe where that camera has nothing any more. ``shown_twice``: one picture in
    so many stands in the place of the next."""
    files = capture.cameras[0]
    assert files.motion is not None, "it has been scored"
    reader = VideoReader(files.motion)
    assert reader.timecode is not None, "the simulator writes one"
    middle = reader.frame_count // 2

    def pictures() -> Iterator[Image]:
        before: Image | None = None
        for at, (_, image) in enumerate(reader):
            if before is None or not shown_twice or (at + 1) % shown_twice:
                before = np.ascontiguousarray(image[:, ::-1]) if mirrored else image
            if not middle <= at < middle + lost:
                yield before

    timecode = frames_to_timecode(timecode_to_frames(reader.timecode, reader.frame_rate) + late, reader.frame_rate)
    path = folder / f"motion_{files.name}.mp4"
    write_video(path, pictures(), reader.frame_rate, crf=12, timecode=timecode)
    changed = with_files(capture, 0, replace(files, motion=path))
    common = set(frame_sets(replace(changed, keyframe_poses={})).timecodes)
    return replace(changed, keyframe_poses={k: pose for k, pose in capture.keyframe_poses.items() if k in common})


def with_files(capture: Capture, number: int, files: CameraFiles) -> Capture:
    return replace(capture, cameras=(*capture.cameras[:number], files, *capture.cameras[number + 1 :]))


def without_frames(many: int) -> Callable[[Capture, Path], Capture]:
    """Camera 1 lost so many frames in the middle, and the recording was closed up."""
    return lambda capture, folder: recorded_again(capture, folder, lost=many)


def with_pictures_twice(one_in: int) -> Callable[[Capture, Path], Capture]:
    """Of camera 1 one picture in so many is shown twice, as where a variable rate was converted."""
    return lambda capture, folder: recorded_again(capture, folder, shown_twice=one_in)


def by_a_clock(late: int) -> Callable[[Capture, Path], Capture]:
    """The timecode of camera 1 is so many frames high."""
    return lambda capture, folder: recorded_again(capture, folder, late=late)


def of_a_person(times: float) -> Callable[[Capture, Path], Capture]:
    """subject.json of somebody so many times as large."""

    def change(capture: Capture, _: Path) -> Capture:
        assert capture.subject is not None, "it has been scored"
        measured = {name: times * each for name, each in capture.subject.measurements_m.items()}
        return replace(capture, subject=replace(capture.subject, measurements_m=measured))

    return change


def of_an_object(times: float) -> Callable[[Capture, Path], Capture]:
    """object.json says that the object is so many times as large."""

    def change(capture: Capture, _: Path) -> Capture:
        written = capture.calibration_object
        assert written is not None, "it has been scored"
        markers = tuple(replace(each, corners_m=times * each.corners_m) for each in written.markers)
        return replace(capture, calibration_object=replace(written, markers=markers))

    return change


def with_keyframes(moved_m: Array, only: int | None = None) -> Callable[[Capture, Path], Capture]:
    """All keyframes somewhere else, or only one of them."""

    def change(capture: Capture, _: Path) -> Capture:
        moved = {
            timecode: replace(pose, root_position_m=pose.root_position_m + moved_m) if only in (None, k) else pose
            for k, (timecode, pose) in enumerate(sorted(capture.keyframe_poses.items()))
        }
        return replace(capture, keyframe_poses=moved)

    return change


def with_a_mirror(capture: Capture, folder: Path) -> Capture:
    """The motion of camera 1, left and right exchanged."""
    return recorded_again(capture, folder, mirrored=True)


def with_motions_exchanged(capture: Capture, _: Path) -> Capture:
    """The motions of the first two cameras, in each other's place."""
    one, other = capture.cameras[:2]
    exchanged = with_files(capture, 0, replace(one, motion=other.motion))
    return with_files(exchanged, 1, replace(other, motion=one.motion))


def with_another_sweep(capture: Capture, _: Path) -> Capture:
    """The second camera with the sweep of the first."""
    return with_files(capture, 1, replace(capture.cameras[1], sweep=capture.cameras[0].sweep))


FAULTS: Final = (
    Fault("right", "nothing", lambda capture, _: capture, "(?!)"),
    Fault("lost_frame", "camera 1 lost a frame, closed up", without_frames(1),
          r"camera 1: from frame \d+ .* 1 frame lost there, and the recording closed up"),
    Fault("lost_frames", "camera 1 lost three, closed up", without_frames(3),
          r"camera 1: from frame \d+ .* 3 frames lost there, and the recording closed up"),
    Fault("pictures_twice", "one picture of camera 1 in ten twice", with_pictures_twice(10),
          r"camera 1: in \d+ frames, .* its picture is the one before once more"),
    Fault("late_clock", "clock of camera 1 a frame off", by_a_clock(1), "camera 1: .* timecode is 1 frame too high"),
    Fault("late_clock_3", "clock of camera 1 three off", by_a_clock(3), "camera 1: .* timecode is 3 frames too high"),
    Fault("larger_subject", "subject 10 % larger than written", of_a_person(1 / 1.1),
          "athlete is [0-9.]+% larger than it"),
    Fault("smaller_subject", "subject 10 % smaller", of_a_person(1 / 0.9), "athlete is [0-9.]+% smaller than it"),
    Fault("larger_object", "object 10 % larger than written", of_an_object(1 / 1.1), "object is about .* larger", True),
    Fault("smaller_object", "object 10 % smaller", of_an_object(1 / 0.9), "object is about .* smaller", True),
    Fault("far_keyframes", "keyframes a kilometre off", with_keyframes(np.array([1000.0, 0.0, 0.0])),
          "no view shows anybody where any of the keyframes|is not a person's"),
    Fault("keyframe_behind_wall", "one keyframe behind the walls", with_keyframes(np.array([0.0, 30.0, 0.0]), 1),
          "no view shows anybody where it stands"),
    Fault("motions_exchanged", "motions of cameras 1 and 2 exchanged", with_motions_exchanged,
          "camera 1: its motion fits the sweep of camera 2, and not its own"),
    Fault("mirrored", "motion of camera 1 mirrored", with_a_mirror, "camera 1: its motion is mirrored against"),
    Fault("another_sweep", "sweep of camera 1 given to camera 2", with_another_sweep,
          "camera 2: .*it is another camera's", True),
)  # fmt: skip


def compare(config: WrongFootageConfig, folder: Path, console: Console) -> Iterator[Row[Any]]:
    """Each fault in turn. Raises PzcapError for one that there is not."""
    unknown = set(config.faults) - {fault.key for fault in FAULTS}
    if unknown:
        raise PzcapError(f"no fault '{min(unknown)}'; one of {', '.join(fault.key for fault in FAULTS)}")
    said: list[str] = []
    with Bars(console) as bars:
        capture, truth = scored_capture(config, bars.update)
        usual = reconstruct(capture, config.reconstruct, bars.update)
        for fault in FAULTS:
            if not config.faults or fault.key in config.faults or fault.key == "right":
                figures, told = _tried(fault, capture, truth, usual, config, folder, bars)
                found = ", ".join(f"{key} {value:.3g}" for key, value in figures.items() if value is not None)
                said += [f"{fault.label} ({found}):", *(f"  {each}" for each in told)]
                with written_whole(folder / SAID) as partial:
                    partial.write_text("\n".join(said) + "\n", encoding="utf-8")
                yield Row(fault.key, fault.label, figures)


def _tried(
    fault: Fault, capture: Capture, truth: Truth, usual: Reconstruction, config: WrongFootageConfig, folder: Path,
    bars: Bars,
) -> tuple[dict[str, float | None], list[str]]:  # fmt: skip
    """Cost of a fault, and the notes that right footage does not raise."""
    figures: dict[str, float | None] = {}
    try:
        wrong = fault.change(capture, folder)
        told, known = labelled(bars.update, fault.label), None if fault.anew else usual
        found = usual if wrong is capture else reconstruct(wrong, config.reconstruct, told, known)
    except PzcapError as error:
        notes = [str(error)]
    else:
        raised = {re.sub(r"[0-9.]+", "", each) for each in usual.notes}
        notes = [
            each for each in found.notes
            if found is usual or (re.sub(r"[0-9.]+", "", each) not in raised and "at the take before" not in each)
        ]  # fmt: skip
        if found.motion is not None:
            scored = body(found, truth)
            figures = {key: scored[key] for key in (MEAN.key, P95.key) if key in scored}
    figures["notes"] = float(len(notes))
    if fault.key != "right":
        figures["named"] = float(any(re.search(fault.named, each) is not None for each in notes))
    return figures, notes


COMPARISON: Final[Comparison[Any]] = Comparison(
    name="wrong_footage",
    columns=(MEAN, P95, Column("named", "named", "", "{:.0f}", "higher"), Column("notes", "notes", "", "{:.0f}")),
    compare=compare,
    experiment="floor_exercise",
    variants="wrong",
    config=WrongFootageConfig,
    config_name="wrong_footage",
    others=(SAID,),
)
