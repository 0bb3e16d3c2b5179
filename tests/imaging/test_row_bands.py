"""Bands of mains light: of one frame against a panorama, and of all frames where they overlap."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from pzcap.imaging import row_bands
from pzcap.types import Array


def ratios(bands: Array, seed: int, noise: float = 0.1) -> tuple[Array, Array, Array]:
    """Ratio of frame to panorama, row time and squared distance of 3000 pixels, a tenth of them of somebody."""
    rng = np.random.default_rng(seed)
    time, squared = rng.uniform(-0.5, 0.5, 3000), rng.uniform(0.0, 1.0, 3000)
    ratio = (0.9 - 0.1 * squared) * row_bands.gain(bands, time) * rng.normal(1.0, noise, 3000)
    ratio[:300] *= rng.uniform(0.2, 3.0, 300)
    return ratio, time, squared


@settings(deadline=None)
@given(st.floats(0.5, 3.0), st.floats(0.0, 2 * np.pi), st.integers(0, 100))
def test_bands_of_any_frequency_and_phase_are_found(periods: float, phase: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    time, squared = rng.uniform(-0.5, 0.5, 4000), rng.uniform(0.0, 1.0, 4000)
    true = 1.0 + 0.25 * np.sin(2 * np.pi * periods * time + phase)
    bands = row_bands.fit(true * rng.normal(1.0, 0.05, 4000), time, squared)
    at = np.linspace(-0.45, 0.45, 91)
    here, wanted = row_bands.gain(bands, at), 1.0 + 0.25 * np.sin(2 * np.pi * periods * at + phase)
    np.testing.assert_allclose(here / here.mean(), wanted / wanted.mean(), atol=0.06)


def test_there_are_no_bands_where_the_light_is_even() -> None:
    for seed in range(10):
        assert row_bands.fit(*ratios(np.zeros(8), seed)).size == 0


def overlaps_of(bands: Array, seed: int) -> row_bands.Overlaps:
    """Overlaps of frames with ``bands`` (F, K), each with the three next and every fifth of further ones:
    400 pixels an overlap, of another exposure, noisy, a twentieth of them of somebody."""
    rng, count, size = np.random.default_rng(seed), len(bands), 400
    ends = np.array([(i, j) for i in range(count) for j in range(i + 1, count) if j - i < 4 or (j - i) % 5 == 0])
    time, lit = rng.uniform(-0.45, 0.45, (len(ends), size, 1)), rng.uniform(40.0, 200.0, (len(ends), size))
    time = np.concatenate([time, np.clip(time + rng.normal(0.0, 0.02, time.shape), -0.5, 0.5)], axis=2)
    seen = np.array([
        [row_bands.gain(bands[frame], time[n, :, side]) for side, frame in enumerate(pair)]
        for n, pair in enumerate(ends.tolist())
    ])  # fmt: skip
    exposure = rng.uniform(0.98, 1.02, (len(ends), 1))
    difference = lit * (exposure * seen[:, 1] - seen[:, 0]) + rng.normal(0.0, 2.0, lit.shape)
    difference[rng.uniform(size=lit.shape) < 0.05] += 60.0
    difference[:, 0] = np.inf  # outside the second frame
    return row_bands.Overlaps(
        ends, np.arange(0, lit.size + 1, size), lit.ravel().astype(np.float32),
        difference.ravel().astype(np.float32), time.reshape(-1, 2).astype(np.float32),
    )  # fmt: skip


@settings(deadline=None, max_examples=10)
@given(st.floats(0.8, 3.0), st.floats(0.05, 0.5), st.integers(0, 100))
def test_bands_that_drift_from_frame_to_frame_are_found_where_these_overlap(
    periods: float, drift: float, seed: int
) -> None:
    """But for what all frames have alike."""
    at = np.linspace(-0.4, 0.4, 81)
    true = np.array([1.0 + 0.05 * np.sin(2 * np.pi * periods * at + drift * frame) for frame in range(30)])
    cosines = np.cos(np.pi * np.arange(1, 13) * (at[:, None] + 0.5))
    bands = np.array([np.linalg.lstsq(cosines, row - row.mean(), rcond=1e-3)[0] for row in true])
    found = row_bands.fit_frames(overlaps_of(bands, seed), len(bands))
    assert found.shape == (30, 12)
    here, wanted = (np.array([row_bands.gain(one, at) for one in each]) for each in (found, bands))
    off = here - wanted
    off -= off.mean(axis=0)  # a gain of the frame's own is no band
    off -= off.mean(axis=1, keepdims=True)
    assert np.sqrt(np.mean(off**2)) < 0.12 * np.std(wanted - wanted.mean(axis=0))


def test_frames_of_even_light_have_no_bands_where_they_overlap() -> None:
    for seed in range(5):
        assert row_bands.fit_frames(overlaps_of(np.zeros((30, 1)), seed), 30).shape == (30, 0)


def test_bands_of_a_few_frames_are_found_where_the_others_have_none() -> None:
    """Those of a zoom run that are left, after the sweep's were divided out."""
    bands = np.zeros((30, 3))
    bands[-4:, 1] = 0.06, -0.06, 0.05, -0.05
    found = row_bands.fit_frames(overlaps_of(bands, 0), len(bands))
    assert found.shape == (30, 12)
    np.testing.assert_allclose(found[-4:, 1] - found[:-4, 1].mean(), bands[-4:, 1], atol=0.01)
