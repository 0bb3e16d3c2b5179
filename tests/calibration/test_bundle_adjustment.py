"""The adjustment: derivatives, exactness on perfect matches, and what wrong matches do to it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from pzcap.calibration import bundle_adjustment
from pzcap.calibration.beliefs import Sigmas
from pzcap.calibration.bundle_adjustment import Link
from pzcap.calibration.parameters import CalibrationParameters, hall_size, retract, to_vector, view_jacobians
from pzcap.calibration.transfer import new_transfer, transfer
from pzcap.calibration.tuning import BELIEF
from pzcap.geometry import camera as geometry
from pzcap.geometry.camera import HIGHER, VIEW
from pzcap.geometry.cylinder import kernel_hall
from pzcap.types import FAR_AWAY, Array, InverseDepthMap

HALL = InverseDepthMap(1.0, np.full(36, 0.15), np.zeros((4, 36)), np.array([-0.4, 0.3]))
NEAR = replace(HALL, walls=np.linspace(0.1, 0.9, 36), departures=np.linspace(0.0, 0.1, 144).reshape(4, 36))
SIGMAS = Sigmas(0.05, 0.2, np.array([6.4, 6.4]), np.array([0.1, 0.1, 0.05]), np.array([0.03, 0.001, 0.001]))


def truth() -> CalibrationParameters:
    """A full turn of 24 frames and a zoom run of six."""
    pans = np.append(np.arange(24) * 2 * np.pi / 24, 0.03)
    focals = np.log([880.0, 620.0, 880.0, 1200.0, 1600.0, 2100.0, 2600.0])
    return CalibrationParameters(
        pans, focals, np.array([*range(24)] + [24] * 6), np.array([0] * 24 + [*range(1, 7)]), -0.07, 0.009,
        np.array([[323.0, 236.5], [1.0, -0.6]]), np.array([-0.04, 0.05, -0.01]),
        np.array([0.03, 0.001, -0.0007]), np.zeros(2), 0.0, FAR_AWAY,
    )  # fmt: skip


def link(model: CalibrationParameters, first: int, second: int, rng: np.random.Generator, noise: float) -> Link | None:
    views = model.view(first), model.view(second)
    points = rng.uniform((0, 0), (639, 479), (60, 2))
    seen, front = geometry.direction_to_pixel(views[1], *geometry.pixel_to_direction(views[0], points))
    inside = front & (seen >= 0).all(axis=1) & (seen[:, 0] < 640) & (seen[:, 1] < 480)
    if inside.sum() < 8:
        return None
    jitter = rng.normal(0, noise, (inside.sum(), 2)) if noise else 0.0
    return Link(first, second, points[inside], seen[inside] + jitter, np.zeros(inside.sum()))


def links(model: CalibrationParameters, noise: float = 0.0, wrong: float = 0.0) -> list[Link]:
    rng = np.random.default_rng(0)
    pairs = [(i, (i + 1) % 24) for i in range(24)] + [(i, (i + 2) % 24) for i in range(24)]
    pairs += [(0, k) for k in range(24, 30)] + [(1, k) for k in range(24, 27)] + [(k, k + 1) for k in range(24, 29)]
    made = [found for a, b in pairs if (found := link(model, a, b, rng, noise)) is not None]
    for found in made:
        bad = rng.random(len(found.first_px)) < wrong
        found.second_px[bad] += rng.uniform(-12, 12, (bad.sum(), 2))
    return made


def start() -> CalibrationParameters:
    true, rng = truth(), np.random.default_rng(1)
    pans = true.pan_rad + rng.normal(0, 0.003, len(true.pan_rad))
    pans[0] = 0.0
    focals = true.log_focal + rng.normal(0, 0.01, len(true.log_focal))
    return CalibrationParameters(
        pans, focals, true.pan_of, true.focal_of, -0.06, 0.0, np.array([[319.5, 239.5], [0, 0]]), np.zeros(3),
        np.zeros(3), np.zeros(2), 0.0, FAR_AWAY,
    )  # fmt: skip


def test_perfect_matches_give_the_truth() -> None:
    loose = Sigmas(1e3, 1e3, np.full(2, 1e5), np.full(3, 1e3), np.full(3, 1e3))
    found = bundle_adjustment.adjust(start(), links(truth()), loose).parameters
    np.testing.assert_allclose(found.pan_rad, truth().pan_rad, atol=1e-6)
    np.testing.assert_allclose(found.log_focal, truth().log_focal, atol=1e-6)
    np.testing.assert_allclose([found.tilt_rad, found.roll_rad], [-0.07, 0.009], atol=1e-6)
    np.testing.assert_allclose(found.principal_px, truth().principal_px, atol=1e-3)
    np.testing.assert_allclose(found.k1, truth().k1, atol=1e-4)
    np.testing.assert_allclose(found.higher, truth().higher, atol=1e-4)


@pytest.mark.parametrize("wrong", [0.0, 0.3])
def test_wrong_matches_do_not_pull(wrong: float) -> None:
    found = bundle_adjustment.adjust(start(), links(truth(), noise=0.3, wrong=wrong), SIGMAS)
    assert np.sqrt(np.mean((found.parameters.pan_rad - truth().pan_rad) ** 2)) < np.deg2rad(0.02)
    np.testing.assert_allclose(found.parameters.log_focal, truth().log_focal, atol=1e-3)
    np.testing.assert_allclose(found.parameters.principal_px[0], truth().principal_px[0], atol=0.7)
    assert 0.2 < found.residual_px < 1.0


def test_a_lens_that_is_none_of_the_usual_shows_where_no_circle_closes() -> None:
    """Hardly drawn from 0, since a focal length makes up for it, but by far more than chance draws a usual one's."""
    usual = replace(SIGMAS, higher=0.03 * SIGMAS.higher)

    def drawn(k2: float, seed: int) -> tuple[float, float]:
        model, rng = replace(truth(), higher=np.array([k2, 0.0, 0.0])), np.random.default_rng(seed)
        pairs = (
            [(i, i + step) for step in (1, 2) for i in range(24 - step)]
            + [(0, 24)]
            + [(k, k + 1) for k in range(24, 29)]
        )
        made = [found for a, b in pairs if (found := link(model, a, b, rng, 0.3)) is not None]
        found = bundle_adjustment.adjust(model, made, usual, prior=replace(model, higher=np.zeros(3)))
        return found.k2_drawn, float(found.parameters.higher[0])

    by_chance = np.array([drawn(0.0, seed)[0] for seed in range(20)])
    assert 0.5 < np.sqrt(np.mean(by_chance**2)) < 1.5
    of_any, k2 = np.transpose([drawn(0.05, seed) for seed in range(5)])
    assert of_any.mean() > BELIEF.unusual
    assert np.all(np.abs(k2) < 0.5 * usual.higher[0])


def residuals(state: CalibrationParameters, link: Link) -> tuple[Array, Array]:
    """Residuals (N, 2) of a link's matches, and their derivatives (N, 2, U) by the vector of parameters."""
    views, chains, columns, higher = view_jacobians(state)
    count, hall = len(to_vector(state)), kernel_hall(state.surroundings)
    residual, jacobian = np.empty((len(link.first_px), 2)), np.zeros((len(link.first_px), 2, count))
    for n, (first_px, second_px) in enumerate(zip(link.first_px, link.second_px, strict=True)):
        seen = new_transfer()
        transfer(views[link.first], views[link.second], first_px[0], first_px[1], hall, seen)
        residual[n] = seen.pixel - second_px
        for side, frame in enumerate((link.first, link.second)):
            part = seen.by_views[:, side * VIEW : (side + 1) * VIEW] @ chains[frame]
            np.add.at(jacobian[n].T, columns[frame], part.T)
        jacobian[n, :, higher : higher + HIGHER] = seen.by_views[:, 2 * VIEW :]
        if hall_size(state):
            np.add.at(jacobian[n].T, count - hall_size(state) + seen.nodes, np.outer(seen.shares, seen.by_near))
    return residual, jacobian


@settings(deadline=None, max_examples=20)
@given(st.floats(-0.2, 0.2), st.floats(-0.1, 0.1), st.floats(-0.05, 0.05), st.floats(-3e-3, 3e-3), st.booleans())
def test_derivatives_match_finite_differences(
    tilt: float, roll: float, k1: float, beside: float, hall_is_near: bool
) -> None:
    """With respect to every unknown: the chain rule through pans, zooms, lens, offset, travel and walls."""
    model = replace(
        truth(), tilt_rad=tilt, roll_rad=roll, k1=np.array([k1, 0.05, -0.01]), offset=np.array([3e-3, beside]),
        travel=2e-3, surroundings=NEAR if hall_is_near else FAR_AWAY,
    )  # fmt: skip
    points = np.stack(np.meshgrid(np.linspace(0, 639, 5), np.linspace(0, 479, 4)), axis=-1).reshape(-1, 2)
    match = Link(1, 25, points, points, np.zeros(len(points)))
    _, analytic = residuals(model, match)
    for column in range(analytic.shape[2]):
        step = np.zeros(analytic.shape[2])
        step[column] = 1e-6
        ahead = residuals(retract(model, step), match)[0]
        behind = residuals(retract(model, -step), match)[0]
        numeric = (ahead - behind) / 2e-6
        # how the parallax itself turns with the view is left out: some thousandths
        atol = 0.005 * np.abs(numeric).max() + 0.02
        np.testing.assert_allclose(analytic[:, :, column], numeric, rtol=0.01, atol=atol)


def test_normal_equations_are_those_of_the_residuals() -> None:
    """The sums over all links, compiled, against the weighted products of the derivatives of each match."""
    model = replace(start(), offset=np.array([3e-3, -2e-3]), surroundings=NEAR)
    made, scale = links(truth(), noise=0.3), 2.0
    unknowns = len(to_vector(model))
    normal, gradient = np.zeros((unknowns, unknowns)), np.zeros(unknowns)
    for one in made:
        residual, jacobian = residuals(model, one)
        weight = (scale**2 / (scale**2 + np.sum(residual**2, axis=1))) ** 2
        normal += np.einsum("n,nci,ncj->ij", weight, jacobian, jacobian)
        gradient += np.einsum("n,nci,nc->i", weight, jacobian, residual)
    matches = bundle_adjustment.matches_of(made)
    found = bundle_adjustment.normal_equations(model, matches, scale, np.empty(len(matches.pixels)))
    np.testing.assert_allclose(found[0], normal, rtol=1e-9, atol=1e-9 * np.abs(normal).max())
    np.testing.assert_allclose(found[1], gradient, rtol=1e-9, atol=1e-9 * np.abs(gradient).max())


def test_a_projection_centre_beside_the_axis_is_found_and_does_not_disturb() -> None:
    """A box of a hall in three dimensions; the library knows a floor and some walls, and first-order parallax."""
    model, rng = truth(), np.random.default_rng(3)
    offset, walls = np.array([3e-3, -2e-3]), np.array([9.0, 5.0, -1.5, -3.0])  # +x, +y, -x, -y in camera heights
    points = []
    for _ in range(12000):
        direction = np.array([*rng.normal(size=2), rng.uniform(-0.45, 0.35)])
        direction[:2] /= np.hypot(*direction[:2])
        reach = [walls[0 if direction[0] > 0 else 2] / direction[0], walls[1 if direction[1] > 0 else 3] / direction[1]]
        points.append(direction * min(*reach, -1.0 / min(direction[2], -1e-3)))
    world = np.array(points)

    def seen(frame: int) -> tuple[Array, NDArray[np.bool_]]:
        view = model.view(frame)
        c, s = np.cos(view.pan_rad), np.sin(view.pan_rad)
        p = world - np.array([c * offset[0] - s * offset[1], s * offset[0] + c * offset[1], 0.0])
        px, front = geometry.direction_to_pixel(
            view, np.arctan2(p[:, 1], p[:, 0]), p[:, 2] / np.hypot(p[:, 0], p[:, 1])
        )
        return px, front & (px >= 0).all(axis=1) & (px < (640, 480)).all(axis=1)

    made = []
    for a, b in [(i, (i + k) % 24) for i in range(24) for k in (1, 2)] + [(0, k) for k in range(24, 30)]:
        (in_a, ok_a), (in_b, ok_b) = seen(a), seen(b)
        both = np.flatnonzero(ok_a & ok_b)
        if len(both) > 10:
            noise = rng.normal(0, 0.1, (len(both), 2))
            made.append(Link(a, b, in_a[both], in_b[both] + noise, np.zeros(len(both))))
    blind = bundle_adjustment.adjust(start(), made, SIGMAS).parameters
    found = bundle_adjustment.adjust(replace(start(), surroundings=HALL), made, SIGMAS).parameters
    np.testing.assert_allclose(found.offset, offset, rtol=0.15)
    assert np.abs(found.log_focal[0] - model.log_focal[0]) < 2e-4
    assert np.abs(found.pan_rad - model.pan_rad).max() < np.deg2rad(0.01)
    assert np.abs(blind.pan_rad - model.pan_rad).max() > np.deg2rad(0.03)
