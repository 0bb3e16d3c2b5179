"""Constants of the synchronisation that no user sets, a table a topic."""

from __future__ import annotations

from typing import Final, NamedTuple


class SoundTuning(NamedTuple):
    """Sound of the recordings."""

    sound_m_per_s: float = 343.0  # at 20 degrees
    longest_s: float = 1_200.0  # sound of a recording that is listened to, from its beginning
    band_hz: tuple[float, float] = (200.0, 3_500.0)  # that is compared
    sure: float = 9.0  # height of a peak, in standard deviations of the correlation, from which on it is one
    next: float = 0.65
    """Height of the next peak, apart from its neighbourhood, as a share of it, up to which there is no
    doubt."""
    neighbourhood_s: float = 0.12  # echoes, and sounds from elsewhere in the hall
    spread_s: float = 0.0015  # standard deviation of what peaks are widened by
    recorder_s: float = 0.005  # between sound and picture of a camera
    middle_m: float = 2.0  # of the sound from the middle, difference of two cameras
    anywhere_m: float = 6.0  # where cameras' places are not known
    bang: float = 8.0  # times the usual energy of a frame
    frame: int = 32  # samples
    held: tuple[int, int] = (1, 12)  # frames before and after a bang that are kept
    window_s: float = 20.0  # of the parts that a drift is told by
    drift: float = 2e-5  # standard deviation of a rate that is believed
    windows: int = 5  # of these, at least


class MotionTuning(NamedTuple):
    """Motion of the athlete beside the background, which all cameras see."""

    width: int = 320  # pixels, of the pictures that are compared
    moves_px: float = 0.7  # a frame, beside the background
    corners: int = 300  # that are followed, at most
    fewest: int = 12  # corners that a background's motion is known by
    least_s: float = 1.5  # that two recordings have to have in common
    least_share: float = 0.5  # of the shorter one
    grid: int = 4  # steps a frame
    sure: float = 0.6  # correlation
    next: float = 0.85  # of the next peak, as a share
    frames_sigma: float = 0.6  # standard deviation of an offset, frames


class FlashTuning(NamedTuple):
    """A lamp that goes on and off."""

    blocks: tuple[int, int] = (12, 8)  # columns and rows of the picture: most have to grow brighter
    step: float = 0.05  # of the logarithm of the brightness
    clear: float = 8.0  # times what is usual from frame to frame


SOUND: Final = SoundTuning()
MOTION: Final = MotionTuning()
FLASH: Final = FlashTuning()
