"""From light to grey levels: exposure, noise; and the camera's clock."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Final

import numpy as np
from numpy.typing import NDArray

from pzcap.types import Array, Image, Mask, PzcapError
from sim.ranges import Range

_RAMP_FRAMES: Final = 5  # in which an automatic exposure is where it wants to be
_STEPS: Final = 1000  # of an automatic exposure: more than any video has


@dataclass(frozen=True, slots=True)
class SensorConfig:
    """Exposure, noise, compression and clock, by default those of a good video camera in a lit hall.

    An effect whose size is 0 is exactly absent.
    """

    read_noise: Annotated[float, Range(0.0, 128.0)] = 2.0
    """Standard deviation, grey levels. It does not depend on the light; 2 of 255 is what a lit hall leaves."""
    shot_noise: Annotated[float, Range(0.0, 100.0)] = 0.02
    """Variance per grey level: at white (255) it adds as much as the read noise."""
    exposure_drift: Annotated[float, Range(0.0, 0.9)] = 0.03
    """Largest departure of the brightness from its mean, share of it, in waves of 4 to 60 s: lamps and exposure are
    never quite constant."""
    auto_exposure: Annotated[float, Range(0.0, 0.9)] = 0.0
    """Largest step by which the exposure's automatics change the brightness, share of it, each within five frames;
    0: the exposure is locked, as docs/capture.md asks for."""
    white_drift: Annotated[float, Range(0.0, 0.5)] = 0.0
    """Largest departure of each colour's brightness from its mean, share of it, by an automatic white balance; 0: it is
    locked."""
    shutter_s: Annotated[float, Range(0.0, 1.0)] = 1 / 250
    """Time that the shutter is open for a frame, s; 0: an instant. Short, as docs/capture.md asks for."""
    hall_shutter_s: Annotated[float, Range(0.0, 1.0)] = 0.0
    """Time that the shutter is open for a frame of the sweep and the zoom run, s; 0: as short as for the motion, which
    does not show in so slow a pan."""
    sub_exposures: Annotated[int, Range(1, 64)] = 2
    """Moments that a frame of the motion averages over the open shutter. More make the blur of a fast pan smooth; the
    sweep is too slow to need any."""
    supersampling: Annotated[float, Range(1.0, 16.0, step=0.25)] = 2.0
    """Rendered pixels for each pixel of the image, along each axis, in frames of the motion. Rendered edges are
    displaced a little, the less the finer the picture; 2 keeps a shoot short."""
    supersampling_hall: Annotated[float, Range(1.0, 16.0, step=0.25)] = 3.0
    """The same in frames of the sweep and the zoom run: more than in the motion, which is measured by these. 4 takes
    twice the time and is no better (`python -m experiments.supersampling`)."""
    supersampling_still: Annotated[float, Range(1.0, 16.0, step=0.25)] = 4.0
    """The same in the reference image: the camera's place comes from the markers in it alone."""
    grid_turn_deg: Annotated[float, Range(-45.0, 45.0)] = 0.0
    """Turn of the rendered grid about the optical axis, degrees. Turned, an upright edge crosses many of the grid's
    columns and is not displaced alike in all rows. Off, since it takes larger pictures; `experiment=clean` turns it."""
    mipmaps: bool = True
    """Textures that are seen small are blurred beforehand, and move by some thousandths of a pixel with the zoom.
    Without mipmaps, pictures have to be rendered much finer than the image, as in `experiment=clean`."""
    crf_motion: Annotated[int, Range(0, 51)] = 20
    """Constant rate factor of the motion's H.264; 0: lossless, larger: smaller files. 20: a good camera's recording."""
    crf_still: Annotated[int, Range(0, 51)] = 12
    """Constant rate factor of the sweep's and the zoom run's H.264: docs/capture.md asks for 12 or better."""
    largest_roll: Annotated[int, Range(0, 10_000)] = 5
    """Frames that a camera starts early or stops late, at most: nobody presses four buttons at once."""
    readout_s: Annotated[float, Range(-0.1, 0.1)] = 0.0
    """Time in which a rolling shutter reads a frame, s, from the first row to beyond the last: row v of H is exposed
    ((v + 0.5) / H - 0.5) times that later than the frame. Negative: the camera hangs upside down and reads from the
    bottom. 0: a global shutter; 0.016 is common."""
    field_s: Annotated[float, Range(0.0, 0.5)] = 0.0
    """Time between the two fields of which each frame is woven, s: even rows are seen at the frame's time, as timecode
    counts them, odd rows after. Half the frame period is interlaced video; 0: frames are whole."""
    bob: bool = False
    """Of interlaced video the first field alone is kept, at the frame's time, and the rows between are interpolated."""
    clock_offset: Annotated[float, Range(0.0, 0.5)] = 0.0
    """Largest offset of a camera's clock from the common time, share of the frame period. 0: all are genlocked; 0.5: by
    timecode alone, which is true to half a frame."""
    clock_drift_ppm: Annotated[float, Range(0.0, 1000.0)] = 0.0
    """Largest drift of a camera's clock against the common time, millionths; 50 is what a quartz in the cold has."""
    dropped_share: Annotated[float, Range(0.0, 0.95)] = 0.0
    """Share of the motion's frames that a camera loses, at random; 0: recorders do not drop frames unless they fail."""

    def __post_init__(self) -> None:
        if self.bob and not self.field_s:
            raise PzcapError(
                "bob takes one field of interlaced video, and there is none; give field_s, or leave it out"
            )


def row_delay_s(rows: Array, height: int, readout_s: float) -> Array:
    """Time (N,) from the exposure of a frame, which is that of its middle, to that of its ``rows`` (N,)."""
    return ((rows + 0.5) / height - 0.5) * readout_s


def by_rows(seen: Callable[[float], Array], time_s: float, height: int, readout_s: float) -> Array:
    """Pixels (N, 2) in a frame of which each row sees at its own time; ``seen`` gives those of a time."""
    if not readout_s:
        return seen(time_s)
    half_s = abs(readout_s) / 2
    before, now, after = (seen(time_s + by_s) for by_s in (-half_s, 0.0, half_s))
    pixels = now
    for _ in range(4):  # a fixed point: a row is read in less time than it takes to cross
        share = np.clip(row_delay_s(pixels[:, 1:], height, readout_s) / half_s, -1.0, 1.0)
        pixels = now + share * (after - before) / 2 + share**2 * ((after + before) / 2 - now)
    return pixels


def field_delay_s(rows: Array, config: SensorConfig) -> Array:
    """Time (N,) from that of a frame to that of the fields which its ``rows`` (N,) are of."""
    return (rows % 2) * (0.0 if config.bob else config.field_s)


class Automatics:
    """Brightness over time by an automatic exposure and white balance, 1 in the mean: (3,) blue, green and red."""

    def __init__(self, config: SensorConfig, frame_s: float, rng: np.random.Generator) -> None:
        self._steps_s = frame_s * np.cumsum(rng.uniform(15.0, 60.0, _STEPS))
        self._ramp_s = _RAMP_FRAMES * frame_s
        signs = rng.choice([-1.0, 1.0]) * (-1.0) ** np.arange(_STEPS + 1)
        self._levels = 1 + signs * config.auto_exposure / 2 * rng.uniform(0.5, 1.0, _STEPS + 1)
        self._white = [Exposure(config.white_drift, rng) for _ in range(3)]

    def __call__(self, time_s: float) -> Array:
        share = np.clip((time_s - self._steps_s) / self._ramp_s, 0.0, 1.0)
        return float(self._levels[0] + np.diff(self._levels) @ share) * np.array([one(time_s) for one in self._white])


class Exposure:
    """Brightness over time: three slow waves of random phase, together never beyond ``drift``."""

    def __init__(self, drift: float, rng: np.random.Generator) -> None:
        self._drift = drift
        self._periods_s = rng.uniform([4.0, 8.0, 20.0], [8.0, 20.0, 60.0])
        self._phases = rng.uniform(0, 2 * np.pi, 3)

    def __call__(self, time_s: float) -> float:
        return 1.0 + self._drift * float(np.mean(np.sin(2 * np.pi * time_s / self._periods_s + self._phases)))


class Sensor:
    """Turns brightness into noisy grey levels.

    Each frame draws its own stretch, at a random place, of one long table of normal numbers: drawing 900 000 of them
    anew would cost more than all else that happens to a frame.
    """

    _SPARE = 1 << 22

    def __init__(self, config: SensorConfig, vignette: NDArray[np.float32], rng: np.random.Generator) -> None:
        self._config = config
        self._vignette = vignette
        self._table = rng.standard_normal(vignette.size * 3 + self._SPARE, dtype=np.float32)

    def develop(
        self, light: NDArray[np.uint8] | NDArray[np.uint16], gain: float | Array, rng: np.random.Generator
    ) -> Image:
        """(H, W, 3) red-green-blue light in grey levels, times ``gain``, to the image that is recorded.

        gain: of all pixels, or by row, column and channel of the image that is recorded, as far as they differ.
        """
        level = light[..., ::-1] * (self._vignette * np.asarray(gain, np.float32))
        noise = self._table[(start := int(rng.integers(self._SPARE))) : start + level.size].reshape(level.shape)
        sigma = np.sqrt(level * np.float32(self._config.shot_noise) + np.float32(self._config.read_noise**2))
        level += sigma * noise
        return np.rint(np.clip(level, 0, 255)).astype(np.uint8)


def draw_clocks(cameras: int, config: SensorConfig, period_s: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Offset (cameras,), s, and drift (cameras,), s/s, of each camera's clock; the common time is the mean of all."""
    offset, drift = rng.uniform(-1.0, 1.0, (2, cameras))
    offset, drift = offset - offset.mean(), drift - drift.mean()
    return offset * config.clock_offset * period_s, drift * config.clock_drift_ppm * 1e-6


def rolls(cameras: int, largest: int, rng: np.random.Generator) -> tuple[list[int], list[int]]:
    """Number of frames that each camera starts early and stops late; one starts, and one stops, just in time."""
    early, late = (rng.integers(0, largest + 1, cameras) for _ in range(2))
    early[rng.integers(cameras)] = late[rng.integers(cameras)] = 0
    return early.tolist(), late.tolist()


def draw_dropped(frames: int, share: float, rng: np.random.Generator) -> Mask:
    """(frames,) which frames are lost; never the first or the last, which say how long the recording is."""
    dropped = rng.uniform(size=frames) < share
    dropped[[0, -1]] = False
    return dropped


def nearest_frames(offset_s: Array, period_s: float) -> Array:
    """The offsets (C,) of clocks that do not count together: of each camera's frames those nearest to the first one's
    belong to it. None is further off than four tenths of a frame, so that there is no doubt about which are nearest."""
    apart = offset_s - offset_s[0]
    apart = np.clip(apart - period_s * np.round(apart / period_s), -0.4 * period_s, 0.4 * period_s)
    return np.asarray(apart - apart.mean())
