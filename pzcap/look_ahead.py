"""A camera that is lost in its first frame: looked for further on in the take, and from there followed back."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

from pzcap.io.capture import FrameSets
from pzcap.tuning import LOOK_AHEAD
from pzcap.types import FrameSet, Localisation

Beside: TypeAlias = Callable[[FrameSet, Localisation | None], Localisation | None]
"""Localises the camera's view of frames, beside one that was found if there is one; None where it has none."""


class LookAhead:
    """The places of one camera, by frame, that were found looking ahead in a ``take``."""

    def __init__(self, take: FrameSets | None, localise: Beside) -> None:
        self.places: dict[int, Localisation] = {}
        self._take, self._localise, self._begun = take, localise, False

    def first(self, frame: int, found: Localisation) -> bool:
        """Look ahead if the camera's first ``frame`` was not ``found``; False where it was not the first."""
        if self._begun:
            return False
        self._begun = True
        if not found.valid:
            self.places = self._found_back(frame)
        return True

    def _found_back(self, first: int) -> dict[int, Localisation]:
        """Places in the frames from the ``first`` one on, as far back as the camera can be followed from the first that
        it is found in; none where it is in none."""
        places = self._found_alone(first)
        if not places:
            return places
        for start in range(min(places) - LOOK_AHEAD.stride, first - 1, -LOOK_AHEAD.stride):
            for frames in reversed(self._read(start, LOOK_AHEAD.stride)):
                found = self._localise(frames, places[min(places)])
                if found is None:
                    continue
                if not found.valid:
                    return places
                places[frames.index] = found
        return places

    def _found_alone(self, first: int) -> dict[int, Localisation]:
        """The place in the first of the frames that are looked at in which the camera is found without the ones
        before; none where it is in none."""
        for number in range(first + LOOK_AHEAD.stride, first + LOOK_AHEAD.frames, LOOK_AHEAD.stride):
            for frames in self._read(number, 1):
                found = self._localise(frames, None)
                if found is not None and found.valid:
                    return {number: found}
        return {}

    def _read(self, start: int, count: int) -> list[FrameSet]:
        """So many frame sets of the take from ``start`` on; fewer at its end, none where it is not known."""
        return [] if self._take is None else list(self._take.between(start, min(start + count, len(self._take))))
