"""The smoother: honest and better where its model holds, and harmless where there is nothing to smooth."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from pzcap.extras.reconstruct import Config, smoothed
from pzcap.extras.rts_smoother import SmoothConfig, jerk, smooth
from pzcap.localisation.covariance import systematic
from pzcap.types import Array, PanZoomTrack, PzcapError
from tests.scenes import synthetic
from tests.scenes.cylinders import camera_of

RATE = Fraction(30)
NONE = np.zeros((2, 2))
PAN_JERK, ZOOM_JERK = np.deg2rad(20.0), 1.0
GIVEN = SmoothConfig(pan_deg_s3=20.0, zoom_s3=ZOOM_JERK)


def drawn(seed: int, frames: int = 120, sigma: tuple[float, float] = (2e-4, 1e-3)) -> tuple[Array, PanZoomTrack]:
    """True pan and log focal (F, 2) of a motion of white jerk, and a track of it with correlated, uneven noise."""
    rng = np.random.default_rng(seed)
    step = float(1 / RATE)
    states = np.array([[0.2, 0.3, 0.1], [np.log(900.0), -0.1, 0.05]])
    truth = np.empty((frames, 2))
    for frame in range(frames):
        truth[frame] = states[:, 0]
        push = rng.normal(size=2) * [PAN_JERK, ZOOM_JERK]
        value, rate, acceleration = states.T
        states = np.column_stack([
            value + rate * step + acceleration * step**2 / 2 + push * step**3 / 6,
            rate + acceleration * step + push * step**2 / 2,
            acceleration + push * step,
        ])  # fmt: skip
    correlation = np.array([[1.0, 0.5], [0.5, 1.0]]) * np.outer(sigma, sigma)
    covariance = correlation * rng.uniform(0.3, 3.0, (frames, 1, 1))
    noisy = truth + np.einsum("fij,fj->fi", np.linalg.cholesky(covariance), rng.normal(size=(frames, 2)))
    return truth, track_of(noisy, covariance)


def track_of(values: Array, covariance: Array) -> PanZoomTrack:
    frames = len(values)
    return PanZoomTrack(
        pan_rad=(values[:, 0] + np.pi) % (2 * np.pi) - np.pi,
        tilt_rad=np.full(frames, -0.07), roll_rad=np.zeros(frames),
        focal_px=np.exp(values[:, 1]), covariance=covariance, inliers=np.full(frames, 50), valid=np.ones(frames, bool),
    )  # fmt: skip


def errors(track: PanZoomTrack, truth: Array) -> Array:
    """(F, 2)"""
    pan = (track.pan_rad - truth[:, 0] + np.pi) % (2 * np.pi) - np.pi
    return np.column_stack([pan, np.log(track.focal_px) - truth[:, 1]])


def without(track: PanZoomTrack, *missing: int) -> PanZoomTrack:
    valid = track.valid.copy()
    valid[list(missing)] = False
    pan, focal, covariance = track.pan_rad.copy(), track.focal_px.copy(), track.covariance.copy()
    pan[~valid], focal[~valid], covariance[~valid] = 1.0, 1.0, 0.0  # meaningless, and finite
    return replace(track, pan_rad=pan, focal_px=focal, covariance=covariance, valid=valid)


@pytest.mark.parametrize("config", [GIVEN, SmoothConfig()], ids=["jerk given", "jerk found"])
def test_the_covariance_of_the_result_is_honest(config: SmoothConfig) -> None:
    """NEES at frames far apart, of 100 tracks, the gaps that were filled among them, within chi-square bounds."""
    looked_at = [0, 40, 61, 100, 119]  # 61 lies in a gap
    squares = np.empty((100, len(looked_at)))
    for seed in range(len(squares)):
        truth, track = drawn(seed)
        result = smooth(without(track, 60, 61, 62), RATE, config, NONE)
        assert result.valid.all()
        error = errors(result, truth)[looked_at]
        squares[seed] = np.einsum("fi,fij,fj->f", error, np.linalg.inv(result.covariance[looked_at]), error)
    degrees = 2 * squares.size
    low, high = chi2.ppf([0.0005, 0.9995], degrees) / degrees
    slack = 1.0 if config is GIVEN else 1.1  # a jerk that was found is not the true one
    assert low / slack < squares.mean() / 2 < high * slack
    degrees = 2 * len(squares)
    low, high = chi2.ppf([0.0001, 0.9999], degrees) / degrees
    for column in squares.T:
        assert low / slack < column.mean() / 2 < high * slack


def test_a_rough_track_becomes_three_times_better() -> None:
    before, after = [], []
    for seed in range(10):
        truth, track = drawn(seed)
        before.append(errors(track, truth))
        after.append(errors(smooth(track, RATE, SmoothConfig(), NONE), truth))
    rms = [np.sqrt(np.mean(np.concatenate(parts) ** 2, axis=0)) for parts in (before, after)]
    assert np.all(rms[1] < rms[0] / [3.0, 2.0])  # of pan, of zoom


def test_where_the_measurements_are_exact_they_stay() -> None:
    truth, _ = drawn(0)
    for sigma in (1e-7, 1e-10):
        exact = track_of(truth, np.tile(np.eye(2) * sigma**2, (len(truth), 1, 1)))
        result = smooth(exact, RATE, SmoothConfig(), NONE)
        np.testing.assert_allclose(errors(result, truth), 0.0, atol=1e-6 * max(sigma / 1e-7, 1e-3))


def test_the_jerk_is_found() -> None:
    found = []
    for seed in range(10):
        truth, track = drawn(seed)
        values = truth + errors(track, truth)
        found.append([jerk(values[:, k], track.covariance[:, k, k], track.valid, float(1 / RATE)) for k in range(2)])
    np.testing.assert_allclose(np.exp(np.mean(np.log(found), axis=0)), [PAN_JERK, ZOOM_JERK], rtol=0.2)


def test_short_gaps_are_filled_with_growing_covariance_and_long_ones_are_not() -> None:
    truth, track = drawn(3)
    track = replace(track, covariance=np.tile(track.covariance.mean(axis=0), (len(truth), 1, 1)))
    lacking = without(track, 0, 1, 30, 31, 32, 33, 34, *range(70, 77), 119)
    result = smooth(lacking, RATE, SmoothConfig(pan_deg_s3=2000.0, zoom_s3=1.0), NONE)
    assert list(np.flatnonzero(~result.valid)) == [0, 1, *range(70, 77), 119]
    inside = np.sqrt(result.covariance[29:36, 0, 0])
    assert np.all(np.diff(inside[:4]) > 0)
    assert np.all(np.diff(inside[3:]) < 0)
    assert np.all(np.abs(errors(result, truth)[30:35, 0]) < 4 * inside[1:-1])
    np.testing.assert_allclose(result.tilt_rad[30:35], -0.07)
    np.testing.assert_array_equal(result.focal_px[70:77], lacking.focal_px[70:77])


def test_what_neighbours_share_is_set_aside_and_put_back() -> None:
    """A common offset with its covariance: the same result, that covariance added."""
    _, track = drawn(4)
    common = np.array([[4e-6, 1e-6], [1e-6, 9e-6]])
    shifted = replace(track, covariance=track.covariance + common)
    one, two = smooth(track, RATE, GIVEN, NONE), smooth(shifted, RATE, GIVEN, common)
    np.testing.assert_allclose(two.pan_rad, one.pan_rad, atol=1e-9)
    np.testing.assert_allclose(two.covariance, one.covariance + common, rtol=1e-6)


def test_a_covariance_smaller_than_what_is_shared_stays_positive() -> None:
    _, track = drawn(5)
    result = smooth(track, RATE, GIVEN, np.diag([1e-3, 1e-3]))
    assert np.all(np.linalg.eigvalsh(result.covariance) > 0)


def test_a_track_of_a_few_frames_is_left_alone() -> None:
    _, track = drawn(6, frames=20)
    few = without(track, *range(3, 18))
    assert smooth(few, RATE, SmoothConfig(), NONE) is few


def test_negative_settings_are_refused() -> None:
    with pytest.raises(PzcapError, match="negative"):
        SmoothConfig(max_gap_s=-1.0)


def test_the_pipeline_smooths_when_it_is_told_to() -> None:
    """And sets aside what all frames of a camera share: the floor, and the scale of its sweep."""
    _, track = drawn(7)
    camera = replace(camera_of(synthetic.Optics()), focal_sigma=1e-3)
    off = smoothed((track, None), (camera, None), RATE, Config())
    assert off == (track, None)
    config = Config(smooth=SmoothConfig(enabled=True))
    common = systematic(config.panzoom, camera, track.pan_rad, track.focal_px)
    assert np.all(common[:, 1, 1] > 1e-6)
    whole = replace(track, covariance=track.covariance + common)
    on, missing = smoothed((whole, None), (camera, None), RATE, config)
    assert missing is None
    assert on is not None
    alone = smooth(track, RATE, SmoothConfig(), NONE)
    np.testing.assert_allclose(on.pan_rad, alone.pan_rad, atol=1e-9)
    np.testing.assert_allclose(on.covariance, alone.covariance + common, rtol=1e-4)


# --------------------------------------------------------------------------------------------------------------
# Laws

seeds = st.integers(0, 1000)


@settings(max_examples=15, deadline=None)
@given(seeds, st.floats(-7.0, 7.0), st.floats(0.3, 3.0))
def test_turning_the_head_and_changing_the_unit_of_focal_length_change_nothing(
    seed: int, turn: float, factor: float
) -> None:
    _, track = drawn(seed, 40)
    moved = replace(
        track, pan_rad=(track.pan_rad + turn + np.pi) % (2 * np.pi) - np.pi, focal_px=track.focal_px * factor
    )
    one, two = smooth(track, RATE, SmoothConfig(), NONE), smooth(moved, RATE, SmoothConfig(), NONE)
    apart = (two.pan_rad - one.pan_rad - turn + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(apart, 0.0, atol=1e-8)
    np.testing.assert_allclose(two.focal_px, one.focal_px * factor, rtol=1e-7)


@settings(max_examples=15, deadline=None)
@given(seeds, st.sets(st.integers(1, 38), max_size=6))
@example(0, {1, 2, 3})
def test_time_has_no_direction(seed: int, missing: set[int]) -> None:
    _, track = drawn(seed, 40)
    track = without(track, *missing)
    back = replace(
        track, pan_rad=track.pan_rad[::-1], tilt_rad=track.tilt_rad[::-1], roll_rad=track.roll_rad[::-1],
        focal_px=track.focal_px[::-1],
        covariance=track.covariance[::-1], inliers=track.inliers[::-1], valid=track.valid[::-1],
    )  # fmt: skip
    one, two = smooth(track, RATE, GIVEN, NONE), smooth(back, RATE, GIVEN, NONE)
    np.testing.assert_array_equal(one.valid, two.valid[::-1])
    np.testing.assert_allclose(one.pan_rad[one.valid], two.pan_rad[::-1][one.valid], atol=1e-7)
    # to a hundredth: what is believed of the first rate and acceleration stands at one end, and shows beside a gap
    np.testing.assert_allclose(one.covariance[one.valid], two.covariance[::-1][one.valid], rtol=1e-2, atol=1e-14)


@settings(max_examples=15, deadline=None)
@given(seeds)
def test_what_was_measured_is_never_known_worse(seed: int) -> None:
    _, track = drawn(seed, 40)
    result = smooth(track, RATE, SmoothConfig(), NONE)
    gained = track.covariance - result.covariance
    assert np.all(np.linalg.eigvalsh(gained) > -1e-6 * np.trace(track.covariance, axis1=1, axis2=2)[:, None])
    assert np.all(np.linalg.eigvalsh(result.covariance) > 0)
