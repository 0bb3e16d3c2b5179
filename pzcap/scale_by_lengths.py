"""Cameras brought to metres by the lengths of a capture: their marks seen by the cameras where they stand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from pzcap.calibration.calibrate import CalibratedCamera
from pzcap.geometry import camera as geometry
from pzcap.initialisation.known_lengths import Point, Ratio, Scale, Sight, meet, ratio_of, scale_of
from pzcap.initialisation.tuning import LENGTHS
from pzcap.io.video import VideoReader
from pzcap.localisation.rectification import is_sheared, rectified_points
from pzcap.types import Array, Capture, FrameSet, KnownLength, Localisation, Mark, PzcapError
from pzcap.views import ViewLocaliser

_FILE: Final = "lengths.json"
_ENDS: Final = ('one end ("from")', 'the other end ("to")')  # as the page names them, and the file


class Measured(NamedTuple):
    """Result of `scale_by_lengths`."""

    scale: Scale | None  # None: they tell nothing
    notes: tuple[str, ...]


def scale_by_lengths(
    capture: Capture, cameras: Sequence[CalibratedCamera | None], sigma_m: Array, floor_sigma_m: float,
    localise: ViewLocaliser,
) -> Measured:  # fmt: skip
    """The unit of length of ``cameras`` that stand to each other to ``sigma_m`` (C,), the floor at z = 0 to
    ``floor_sigma_m``. ``localise`` has localised the take by them, and forgets it.

    A length whose marks do not tell it is left out, and a note says why.
    """
    marks = _Marks(capture, cameras, sigma_m, floor_sigma_m, localise)
    ratios, notes = list[Ratio](), list[str]()
    for length in capture.lengths:
        try:
            ratios.append(_ratio(length, marks))
        except PzcapError as error:
            notes.append(f'{_FILE}: "{length.name}" is left out: {error}')
    localise.restart()
    if not ratios:
        return Measured(None, tuple(notes))
    used = [mark for length in capture.lengths for end in length.ends for mark in end]
    scale = scale_of(ratios, len(used) / len({_key(mark) for mark in used}))
    notes += [
        f'{_FILE}: "{name}" is left out: it contradicts the others; measure and mark it anew' for name in scale.apart
    ]
    if scale.torn:
        *some, last = (f'"{name}"' for name in scale.torn)
        notes.append(
            f"{_FILE}: {', '.join(some)} and {last} contradict each other, and nothing tells which is right: the mean "
            "counts; measure and mark them anew, or another"
        )
    return Measured(scale, tuple(notes))


def _key(mark: Mark) -> tuple[str, str, int, float, float]:
    return mark.camera, mark.video, mark.frame, float(mark.px[0]), float(mark.px[1])


def _ratio(length: KnownLength, marks: _Marks) -> Ratio:
    one, other = (marks.point(end, which) for end, which in zip(length.ends, _ENDS, strict=True))
    return ratio_of(length.name, length.length_m, length.sigma_m, (one, other))


@dataclass(frozen=True, slots=True, eq=False)
class _Marks:
    """Marks as lines of sight."""

    capture: Capture
    cameras: Sequence[CalibratedCamera | None]
    sigma_m: Array
    floor_sigma_m: float
    localise: ViewLocaliser

    def point(self, marks: Sequence[Mark], end: str) -> Point:
        """The point that ``marks`` of an ``end`` show. Raises PzcapError where they show none, or more than one."""
        sights = [self._sight(mark) for mark in marks]
        try:
            found = meet(sights, self.floor_sigma_m)
        except PzcapError as error:
            raise PzcapError(f"the marks of {end} show no point: {error}; mark it anew") from error
        if found.misfit > LENGTHS.most_misfit:
            raise PzcapError(
                f"the marks of {end} show different points: a line of sight passes the others by "
                f"{found.missed_m:.2f} m; mark it anew"
            )
        return found

    def _sight(self, mark: Mark) -> Sight:
        number = next(c for c, files in enumerate(self.capture.cameras) if files.name == mark.camera)
        if getattr(self.capture.cameras[number], mark.video) is None:
            raise PzcapError(f"camera {mark.camera} has no {mark.video}; mark another picture")
        camera, found = self.cameras[number], self._localised(mark, number)
        if camera is None or found is None or not found.valid:
            raise PzcapError(
                f"camera {mark.camera} is not located in picture {mark.frame} of its {mark.video}; mark another"
            )
        head, px = camera.camera, mark.px
        if is_sheared(head, found):
            px = rectified_points(px, head, found)
        return Sight(geometry.of_frame(head, found), px, float(self.sigma_m[number]))

    def _localised(self, mark: Mark, number: int) -> Localisation | None:
        """The marked picture, after some before it, which show how the camera turns there."""
        reader = VideoReader(getattr(self.capture.cameras[number], mark.video))
        first, last = reader.indices[[max(mark.frame - LENGTHS.before, 0), mark.frame]].tolist()
        self.localise.restart()
        found: Localisation | None = None
        for count, (_, image) in enumerate(reader.read(first, last + 1)):
            images = tuple(image if c == number else None for c in range(len(self.cameras)))
            found = self.localise(FrameSet(count, "", images), None).localisations[number]
        return found
