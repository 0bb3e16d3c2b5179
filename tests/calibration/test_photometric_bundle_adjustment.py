"""The adjustment on grey values: better than features, unbiased by a person, honest about its own error."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pzcap.calibration import photometric_bundle_adjustment
from pzcap.calibration.beliefs import Sigmas
from pzcap.calibration.bundle_adjustment import Link
from pzcap.calibration.compared_pixels import edge_pixels, overlap_of
from pzcap.calibration.parameters import CalibrationParameters, retract, to_vector
from pzcap.calibration.photometric_bundle_adjustment import Fitted
from pzcap.calibration.sweep import SweepConfig
from pzcap.geometry.camera import direction_to_pixel, pixel_to_direction
from pzcap.imaging import row_bands
from pzcap.imaging.bspline import STEPS, Stored, stored
from pzcap.imaging.colour import grey
from pzcap.imaging.row_bands import row_time
from pzcap.solver.gauss_newton import SolveReport
from pzcap.types import FAR_AWAY, Array
from tests.scenes import synthetic

OPTICS = synthetic.Optics(vignetting=0.0)
PANS = np.deg2rad(np.arange(0.0, 40.0, 5.0))
FOCALS = np.log(OPTICS.reference_focal_px * np.array([1.0, 0.8, 1.4, 2.0]))
SIGMAS = Sigmas(0.05, 0.2, np.array([6.4, 6.4]), np.array([0.1, 0.1]), np.array([0.03, 0.001, 0.001]))
PAIRS = [(i, i + k) for k in (1, 2) for i in range(len(PANS) - k)] + [
    (i, len(PANS) + k) for i in (2, 3, 4) for k in range(3)
]


def truth() -> CalibrationParameters:
    """Eight frames of a sweep, and three of a zoom run at the fourth's pan."""
    return CalibrationParameters(
        np.append(PANS, PANS[3]), FOCALS, np.array([*range(8)] + [8] * 3), np.array([0] * 8 + [1, 2, 3]),
        OPTICS.tilt_rad, OPTICS.roll_rad, np.array([OPTICS.principal_px, OPTICS.principal_slope_px]),
        np.array([OPTICS.k1, OPTICS.k1_slope]), np.zeros(3), np.zeros(2), 0.0, FAR_AWAY,
    )  # fmt: skip


@pytest.fixture(scope="module")
def frames() -> Stored:
    model = truth()
    views = [model.view(frame) for frame in range(len(model.pan_of))]
    images = [synthetic.render(OPTICS, v.pan_rad, v.focal_px, noise_seed=i) for i, v in enumerate(views)]
    return np.stack([stored(grey(image)) for image in images])


def off(seed: int) -> CalibrationParameters:
    """The truth, as wrong as features leave it."""
    true, rng = truth(), np.random.default_rng(seed)
    step = np.zeros(len(to_vector(true)))
    step[1:9] = rng.normal(0, 3e-4, 8)
    step[9:13] = rng.normal(0, 1e-3, 4)
    step[13:15] = rng.normal(0, 5e-4, 2)
    return retract(true, step)


PIXELS = 700
SETTINGS = SweepConfig(pixels=PIXELS, smoothing=0.64)


def links() -> list[Link]:
    """Matches on a grid of each pair of frames, a quarter of a pixel off, as features are."""
    rng, model, found = np.random.default_rng(7), truth(), []
    grid = np.stack(np.meshgrid(np.linspace(0, 319, 20), np.linspace(0, 239, 15)), axis=-1).reshape(-1, 2)
    for first, second in PAIRS:
        seen, _ = direction_to_pixel(model.view(second), *pixel_to_direction(model.view(first), grid))
        inside = np.all((seen >= 0.0) & (seen <= np.array([319.0, 239.0])), axis=1)
        noisy = seen[inside] + rng.normal(0.0, 0.25, (int(inside.sum()), 2))
        found.append(Link(first, second, grid[inside], noisy, np.zeros(len(noisy))))
    return found


def silent(done: int) -> None:
    del done


def adjusted(frames: Stored, start: CalibrationParameters) -> photometric_bundle_adjustment.Fitted:
    return photometric_bundle_adjustment.adjust(
        start, frames, links(), SIGMAS, prior=start, config=SETTINGS, report=silent
    )


def errors(found: CalibrationParameters) -> tuple[Array, Array]:
    """Of the pans (9,) rad, but for their scale, which so short a sweep hardly shows; and of the zoom ratios (3,)."""
    pan = found.pan_rad - truth().pan_rad
    zoom = found.log_focal - found.log_focal[0] - (truth().log_focal - truth().log_focal[0])
    line = np.polynomial.Polynomial.fit(truth().pan_rad, pan, 1)
    return pan - line(truth().pan_rad), zoom[1:]


def test_it_improves_on_features(frames: Stored) -> None:
    before, after = errors(off(0)), errors(adjusted(frames, off(0)).parameters)
    assert np.rad2deg(np.abs(after[0])).max() < 0.004  # a thirtieth of a pixel
    assert np.abs(after[1]).max() < 3e-4
    for first, then in zip(before, after, strict=True):
        assert np.sqrt(np.mean(then**2)) < 0.4 * np.sqrt(np.mean(first**2))


def test_where_it_starts_does_not_matter(frames: Stored) -> None:
    one, other = (adjusted(frames, off(seed)).parameters for seed in (1, 2))
    for first, then in zip(errors(one), errors(other), strict=True):
        np.testing.assert_allclose(first, then, atol=2e-4)  # other pixels are looked at


def test_a_person_and_a_lamp_do_not_pull(frames: Stored) -> None:
    walked = frames.copy()
    walked[2][60:200, 150:210] = 20 * int(STEPS)
    walked[4] = (walked[4] * 1.1).astype(np.uint16)
    plain, disturbed = (errors(adjusted(taken, off(0)).parameters) for taken in (frames, walked))
    for first, then in zip(plain, disturbed, strict=True):
        np.testing.assert_allclose(first, then, atol=5e-5)


def test_bands_of_mains_light_are_found(frames: Stored) -> None:
    """As the residuals show them, another phase in each frame."""
    rows = row_time(np.arange(frames.shape[1]), frames.shape[1])
    gain = np.array([1.0 + 0.04 * np.sin(2 * np.pi * 1.6 * rows + 0.9 * frame) for frame in range(len(frames))])
    banded = (frames * gain[:, :, None]).astype(np.uint16)
    assert adjusted(frames, off(0)).bands.shape == (len(frames), 0)
    found = np.array([row_bands.gain(bands, rows) for bands in adjusted(banded, off(0)).bands])
    for frame in range(1, 8):  # of two that overlap the difference shows
        seen, true = found[frame] - found[frame - 1], gain[frame] - gain[frame - 1]
        off_by = (seen - seen.mean() - true + true.mean())[20:-20]
        assert np.sqrt(np.mean(off_by**2)) < 0.25 * np.std(true)


def test_its_sigmas_are_of_the_size_of_the_errors(frames: Stored) -> None:
    found = adjusted(frames, off(3))
    sigma = np.sqrt(np.diag(found.covariance))
    normalised = (to_vector(found.parameters) - to_vector(truth()))[1:13] / sigma[1:13]
    assert 0.05 < np.sqrt(np.mean(normalised**2)) < 3.0


def test_frames_without_overlap_are_not_compared(frames: Stored) -> None:
    edges = [edge_pixels(frame, PIXELS, 0.64) for frame in frames]
    assert overlap_of(frames, edges, truth(), (0, 7), PIXELS, 0.64) is not None
    far = retract(truth(), np.concatenate([np.zeros(7), [1.0], np.zeros(len(to_vector(truth())) - 8)]))
    assert overlap_of(frames, edges, far, (0, 7), PIXELS, 0.64) is None


@given(st.integers(0, 2**31), st.floats(0.0, 10.0))
def test_what_is_less_sure_keeps_how_the_others_follow(seed: int, sigma: float) -> None:
    """The variance grows by what is added; given the parameter, the others are known as before."""
    root = np.random.default_rng(seed).normal(size=(5, 8))
    before = root @ root.T
    fitted = Fitted(truth(), before, 1.0, 0.0, 0.0, np.zeros((1, 0)), SolveReport(True, 1, 0.0))
    after = fitted.less_sure(2, sigma).covariance
    assert after[2, 2] == pytest.approx(before[2, 2] + sigma**2)
    others = np.delete(np.arange(5), 2)

    def given_it(covariance: Array) -> tuple[Array, Array]:
        """Regression of the others on the parameter, and their covariance where it is known."""
        along = covariance[others, 2] / covariance[2, 2]
        return along, covariance[np.ix_(others, others)] - np.outer(along, along) * covariance[2, 2]

    for known, was in zip(given_it(after), given_it(before), strict=True):
        np.testing.assert_allclose(known, was, rtol=1e-6, atol=1e-9 * (1.0 + sigma**2) * before.max() / before[2, 2])
