"""Frame rates as they are written, and SMPTE timecode, drop-frame and not, to and from a number of frames."""

from __future__ import annotations

import re
from fractions import Fraction
from typing import Final

from pzcap.io import limits
from pzcap.types import PzcapError

_RATE: Final = re.compile(r"\d{1,9}(\.\d{1,9}|/\d{1,9})?")
_TIMECODE: Final = re.compile(r"(\d\d):(\d\d):(\d\d)([:;])(\d{2,3})")


def rate_of(text: str) -> Fraction | None:
    """Frames a second, of a fraction such as "30000/1001" or "25"; None for anything else. An exponent is none: it
    would make a number of a billion digits. Raises PzcapError, with a clause, for a rate that nothing films at."""
    if _RATE.fullmatch(text) is None or (rate := _fraction(text)) is None:
        return None
    slowest, fastest = limits.FRAME_RATE
    if not slowest <= rate <= fastest:
        raise PzcapError(f"is {float(rate):g} frames a second; {slowest} to {fastest} are plausible")
    return rate


def _fraction(text: str) -> Fraction | None:
    try:
        return Fraction(text)
    except ZeroDivisionError:
        return None


def frames_per_day(rate: Fraction, drop: bool = False) -> int:
    """Timecodes repeat after this many frames. Non-drop timecode counts ``round(rate)`` frames a second."""
    return 24 * 3600 * round(rate) - (24 * 54 * _dropped(rate) if drop else 0)


def _dropped(rate: Fraction) -> int:
    """Frame numbers that drop-frame timecode leaves out in each minute but every tenth (SMPTE 12M)."""
    return round(rate) // 15


def timecode_to_frames(timecode: str, rate: Fraction) -> int:
    """Frames since midnight of an SMPTE ``timecode``: "hh:mm:ss:ff", or "hh:mm:ss;ff" if it is drop-frame.

    Raises PzcapError if it is malformed or does not exist at this frame rate.
    """
    match = _TIMECODE.fullmatch(timecode)
    if match is None:
        raise PzcapError(f'timecode "{timecode}" is not "hh:mm:ss:ff", nor "hh:mm:ss;ff" (drop-frame); correct it')
    hours, minutes, seconds, frames = (int(match.group(number)) for number in (1, 2, 3, 5))
    drop = match.group(4) == ";"
    if drop and (rate.denominator != 1001 or round(rate) % 30):
        raise PzcapError(f'timecode "{timecode}" is drop-frame, which {rate} frames/s have not; check the clock')
    left_out = drop and seconds == 0 and minutes % 10 and frames < _dropped(rate)
    if hours > 23 or minutes > 59 or seconds > 59 or frames >= round(rate) or left_out:
        raise PzcapError(f'timecode "{timecode}" does not exist at {rate} frames/s; check the clock\'s frame rate')
    total = ((hours * 60 + minutes) * 60 + seconds) * round(rate) + frames
    minutes += 60 * hours
    return total - (_dropped(rate) * (minutes - minutes // 10) if drop else 0)


def frames_to_timecode(frames: int, rate: Fraction, drop: bool = False) -> str:
    """The inverse of `timecode_to_frames`; wraps at midnight."""
    frames %= frames_per_day(rate, drop)
    if drop:
        numbers = _dropped(rate)
        minute = 60 * round(rate) - numbers
        tens, rest = divmod(frames, 10 * minute + numbers)
        frames += numbers * (9 * tens + max(0, rest - numbers) // minute)
    seconds, frame = divmod(frames, round(rate))
    return f"{seconds // 3600:02}:{seconds // 60 % 60:02}:{seconds % 60:02}{';' if drop else ':'}{frame:02}"
