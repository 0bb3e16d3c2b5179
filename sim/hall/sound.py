"""Sound of the hall as each camera's microphone records it: claps, landings, a fan, each camera's own hiss and echo.

A clap is heard 2.9 ms later for each metre that it is away. The echo of a hall reaches every microphone from all sides:
it is drawn for each, with the loudness over time that halls have.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from pzcap.types import Array

SAMPLES_PER_S: Final = 48_000
SOUND_M_PER_S: Final = 343.0
_CLAP_S: Final = 0.004  # in which a clap dies away
_ECHO_S: Final = 0.35  # in which the echo does, to 1 / e
_ECHO: Final = 0.05  # of what a metre's distance makes, a sample's standard deviation
_LOUD: Final = 0.5
_FAN: Final = 0.02
_HISS: Final = 0.002


def clap(rng: np.random.Generator, softness: float = 1.0) -> Array:
    """Samples of a clap; a landing is a softer one, of lower tones."""
    decay_s = _CLAP_S * softness
    times = np.arange(round(8 * decay_s * SAMPLES_PER_S)) / SAMPLES_PER_S
    noise = rng.normal(size=len(times))
    if softness > 1.0:
        noise = np.convolve(noise, np.ones(round(4 * softness)) / np.sqrt(4 * softness), "same")
    return np.asarray(noise * np.exp(-times / decay_s))


def recorded(
    events: list[tuple[float, Array, Array]], fan_m: Array, fan: Array, microphone_m: Array, begin_s: float,
    rate: float, duration_s: float, rng: np.random.Generator,
) -> NDArray[np.float32]:  # fmt: skip
    """(N,) samples, -1 to 1, by a microphone at ``microphone_m`` (3,) that starts at ``begin_s`` and whose clock lets
    ``rate`` seconds pass in one of its own. events: time, place (3,) and samples of each sound. ``fan``: samples of one
    that hums all the time at ``fan_m``, from 10 s before time 0."""
    count = round(duration_s * SAMPLES_PER_S)
    heard = np.zeros(count + SAMPLES_PER_S)
    for time_s, place_m, samples in events:
        away_m = float(np.linalg.norm(place_m - microphone_m))
        arrives = (time_s + away_m / SOUND_M_PER_S - begin_s) / rate * SAMPLES_PER_S
        first = int(np.floor(arrives))
        if 0 <= first < count - len(samples) - 1:  # between two samples: a part to each
            for shift, share in ((0, 1.0 - (arrives - first)), (1, arrives - first)):
                heard[first + shift : first + shift + len(samples)] += share * samples * _LOUD * 10 / away_m
    away_m = float(np.linalg.norm(fan_m - microphone_m))
    times = (begin_s + rate * np.arange(count) / SAMPLES_PER_S - away_m / SOUND_M_PER_S + 10.0) * SAMPLES_PER_S
    heard[:count] += _FAN * 10 / away_m * np.interp(times, np.arange(len(fan)), fan)
    tail = np.arange(round(3 * _ECHO_S * SAMPLES_PER_S)) / SAMPLES_PER_S
    echo = _ECHO / 10 * rng.normal(size=len(tail)) * np.exp(-tail / _ECHO_S)
    from scipy.signal import fftconvolve  # brings all of scipy.stats: half a second, of every start otherwise

    heard = heard[:count] + fftconvolve(heard, echo)[:count] + _HISS * rng.normal(size=count)
    return np.clip(heard, -1.0, 1.0).astype(np.float32)
