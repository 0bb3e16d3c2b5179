"""Limits of what is plausible for a capture: sizes beyond which a file is refused before anything of it is decoded.

A header of a few bytes can announce more than any machine holds. Each limit is some times what the largest take that
anybody films needs; docs/capture.md lists them.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Final

PICTURE_SIDE_PX: Final = 16_384  # columns, or rows, of a still or a frame: twice those of 8K
PICTURE_PX: Final = 2**26  # pixels of a still or a frame: twice those of 8K
PANORAMA_PX: Final = 2**28  # pixels of a saved panorama: a full turn of 4K cameras has half as many
FRAMES: Final = 1_000_000  # frames of a video: nine hours at 30 a second
SPARSEST: Final = 50  # one frame in so many is recorded at least, the others dropped
FEW: Final = 20  # frames by which a video may be sparser than that: a short one may have lost nearly all
LATEST_FRAME: Final = 10**8  # index of a frame, before and after 0: twice a day at 500 a second
FRAME_RATE: Final = (Fraction(1), Fraction(1000))  # frames a second of the motion
CAMERAS: Final = 64  # cameras of a capture
SYNC_S: Final = 86_400.0  # time between the starts of two cameras' recordings: a day
SYNC_RATE: Final = (0.01, 100.0)
"""Seconds that pass while a file shows one: slow motion of a hundred times, and time lapse."""
PAPER_BYTES: Final = 2**24  # bytes of a JSON file that a person or a program writes for a capture: 16 MiB
KEYPOINTS_BYTES: Final = 2**28  # bytes of a JSON file that a detector writes: 256 MiB
ARRAYS_BYTES: Final = 8 * 2**30  # bytes of the arrays of an npz file: 8 GiB
MEASUREMENT_M: Final = 3.0  # a length of the body, metres
READING_M: Final = 0.3
"""Standard deviation of a length that was read, or guessed by what is known of a population, metres."""
MASS_KG: Final = (20.0, 250.0)  # mass of the athlete, kilograms
MARKER_M: Final = (0.01, 5.0)  # a side of a marker, metres
HALL_M: Final = 500.0  # any place's distance from the origin of the world, along each axis, metres


def picture_problem(width: int, height: int) -> str | None:
    """A clause on a picture of this size, where it is not plausible."""
    if width < 1 or height < 1:
        return f"{width} x {height} pixels"
    if max(width, height) > PICTURE_SIDE_PX or width * height > PICTURE_PX:
        most = f"{PICTURE_SIDE_PX} a side, {PICTURE_PX / 1e6:.0f} million in all"
        return f"{width} x {height} pixels, where {most} are the most"
    return None
