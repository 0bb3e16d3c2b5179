"""Frames decoded on demand, few of them kept.

Long groups of pictures make a step back dear, since a decoder has to begin at the picture that stands for itself. So
the frames just before a wanted one are kept when they have to be decoded anyhow, and a step forward goes on where the
decoder stands.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterator
from typing import Final, Generic, TypeVar

from pzcap.editor.tuning import FOOTAGE

T = TypeVar("T")

KEPT_BYTES: Final = 300 << 20  # compressed frames that an editor keeps in memory
_NONE: Final = -FOOTAGE.on  # no frame comes next


class OnDemand(Generic[T]):
    """Frames of a film by their numbers. ``decode`` gives them in order from a number on, ``size`` how many bytes one
    takes; beyond ``kept_bytes`` the one that was not wanted for longest is forgotten. Not safe for threads."""

    def __init__(
        self, decode: Callable[[int], Iterator[T]], size: Callable[[T], int], kept_bytes: int = KEPT_BYTES
    ) -> None:
        self._decode, self._size, self._kept_bytes = decode, size, kept_bytes
        self._kept: OrderedDict[int, T] = OrderedDict()
        self._coming: Iterator[T] = iter(())
        self._next = _NONE

    def __getitem__(self, number: int) -> T:
        """The frame, decoded with those before it that have to be decoded for it."""
        if number not in self._kept:
            coming, self._next = self._next, _NONE  # after a frame that cannot be decoded, the next one begins anew
            if not coming <= number < coming + FOOTAGE.on:
                coming = max(number - FOOTAGE.before, 0)
                self._coming = self._decode(coming)
            for at in range(coming, number + 1):
                self._kept[at] = next(self._coming)
            self._next = number + 1
            self._forget(number)
        self._kept.move_to_end(number)
        return self._kept[number]

    def _forget(self, wanted: int) -> None:
        total = sum(map(self._size, self._kept.values()))
        while total > self._kept_bytes and (oldest := next(iter(self._kept))) != wanted:
            total -= self._size(self._kept.pop(oldest))
