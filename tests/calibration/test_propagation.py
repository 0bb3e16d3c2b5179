"""Errors of calibration, as they reach the frames of the motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from pzcap.calibration.parameters import CalibrationParameters, retract, to_vector
from pzcap.calibration.photometric_bundle_adjustment import Fitted
from pzcap.calibration.propagation import propagated
from pzcap.calibration.tuning import PROPAGATION
from pzcap.geometry.camera import direction_to_pixel, pixel_to_direction
from pzcap.solver.gauss_newton import SolveReport
from pzcap.types import FAR_AWAY, Array
from tests.scenes import synthetic

OPTICS = synthetic.Optics()
SIZE = OPTICS.width, OPTICS.height
PANS = np.deg2rad(np.arange(-30.0, 31.0, 6.0))
COUNT = len(PANS)
K1 = COUNT + 1 + 2 + 2 + 4  # after pans, log focals, tilt and roll, and the principal point's coefficients


def model() -> CalibrationParameters:
    """A short sweep, and the reference image at pan 0."""
    return CalibrationParameters(
        np.append(PANS, 0.0), np.log([OPTICS.reference_focal_px] * 2), np.arange(COUNT + 1),
        np.array([0] * COUNT + [1]), OPTICS.tilt_rad, OPTICS.roll_rad,
        np.array([OPTICS.principal_px, OPTICS.principal_slope_px]), np.array([OPTICS.k1, OPTICS.k1_slope]),
        np.zeros(3), np.zeros(2), 0.0, FAR_AWAY,
    )  # fmt: skip


def off_by(error: Array) -> Array:
    """Covariances of frames by a calibration that is off by ``error`` (U,), or by its opposite."""
    report, no_bands = SolveReport(True, 1, 0.0), np.zeros((1, 0))
    return propagated(Fitted(model(), np.outer(error, error), 1.0, 0.0, 0.0, no_bands, report), COUNT, SIZE)


def registered(error: Array, sweep_frame: int, zoom: float) -> Array:
    """Pan, from the reference image's, and log focal, minus the true ones, at which a frame at the pan of one of the
    sweep's fits these by cameras that are off."""
    true, wrong = model(), retract(model(), error)
    column, row = np.meshgrid(np.linspace(0, SIZE[0] - 1, 12), np.linspace(0, SIZE[1] - 1, 9))
    pixels = np.stack([column, row], axis=-1).reshape(-1, 2)

    def at(state: CalibrationParameters, pan: float, log_focal: float) -> CalibrationParameters:
        return replace(
            state, pan_rad=np.append(state.pan_rad, pan), log_focal=np.append(state.log_focal, log_focal),
            pan_of=np.append(state.pan_of, COUNT + 1), focal_of=np.append(state.focal_of, 2),
        )  # fmt: skip

    there = true.pan_rad[sweep_frame], true.log_focal[0] + np.log(zoom)
    directions = pixel_to_direction(at(true, *there).view(COUNT + 1), pixels)
    seen = []
    for number in range(COUNT):
        frame, front = direction_to_pixel(true.view(number), *directions)
        inside = front & np.all((frame >= 0) & (frame <= np.array(SIZE) - 1), axis=1)
        if inside.any() and abs(number - sweep_frame) <= 1:
            seen.append((number, frame[inside], inside))

    def residuals(place: Array) -> Array:
        view = at(wrong, *place).view(COUNT + 1)
        directions = pixel_to_direction(view, pixels)
        return np.concatenate([
            (direction_to_pixel(wrong.view(number), *(one[inside] for one in directions))[0] - frame).ravel()
            for number, frame, inside in seen
        ])  # fmt: skip

    found = least_squares(residuals, there, x_scale=1e-4, xtol=1e-14, ftol=1e-14).x
    return np.array([found[0] - wrong.pan_rad[COUNT] - there[0], found[1] - there[1]])


@pytest.mark.parametrize(
    ("place", "size"), [(4, 1e-4), (COUNT, 1e-4), (COUNT + 1, 1e-4), (COUNT + 3, 1e-4), (K1, 1e-3), (K1 + 1, 1e-3)]
)
def test_a_frame_is_off_by_what_the_calibration_makes_of_it(place: int, size: float) -> None:
    """A pan of the sweep, that of the reference image, the sweep's focal length, tilt, and both coefficients of k1."""
    error = np.zeros(len(to_vector(model())))
    error[place] = size
    zoom = PROPAGATION.zooms.index(3.3)
    wanted = registered(error, COUNT // 2, 3.3)
    np.testing.assert_allclose(off_by(error)[0, zoom], np.outer(wanted, wanted), rtol=0.15, atol=(0.03 * size) ** 2)


def test_a_sweep_of_another_scale_stretches_focal_lengths_and_shrinks_pans() -> None:
    error, share = np.zeros(len(to_vector(model()))), 1e-4
    error[: COUNT + 1] = -share * model().pan_rad
    error[COUNT + 1] = share
    left = 1
    pan = PANS[np.abs(PANS - 2 * np.pi * left / PROPAGATION.pans).argmin()]
    wanted = share * np.array([-pan, 1.0])
    for zoom in (1.0, 2.2):
        found = off_by(error)[left, PROPAGATION.zooms.index(zoom)]
        np.testing.assert_allclose(found, np.outer(wanted, wanted), rtol=0.1, atol=(0.03 * share) ** 2)


def test_where_the_sweep_has_not_been_the_nearest_of_its_frames_stands_for_it() -> None:
    error = np.zeros(len(to_vector(model())))
    error[COUNT + 1] = 1e-4
    assert np.isfinite(off_by(error)).all()
    behind = PROPAGATION.pans // 2
    assert off_by(error)[behind, 1, 1, 1] > 0.0
