"""Tripods that do not stand still."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim.cameras.operator import through
from sim.cameras.optics import OpticsConfig
from sim.cameras.tripod import Unrest
from sim.session import ShootConfig, assemble

QUIET = Unrest(0.0, np.zeros(0), np.zeros((0, 2)), 8.0, np.inf, np.zeros(3))


def test_a_tripod_that_has_settled_stays_so() -> None:
    unrest = replace(QUIET, settled_rad=-0.001)
    np.testing.assert_array_equal([unrest.at(t) for t in (-1.0, 0.0, 5.0)], [[0.0, -0.001, 0.0]] * 3)


def test_a_landing_sets_tilt_and_roll_ringing_and_it_dies_away() -> None:
    unrest = replace(QUIET, landings_s=np.array([1.0]), rings_rad=np.array([[0.002, -0.001]]))
    times_s = np.arange(0.0, 3.0, 1e-3)
    moved = np.array([unrest.at(t) for t in times_s.tolist()])
    assert not moved[times_s <= 1.0].any()
    assert not moved[:, 0].any()
    np.testing.assert_allclose(moved[:, 2], -0.5 * moved[:, 1])
    assert 0.8 * 0.002 < moved[:, 1].max() < 0.002
    assert np.abs(moved[times_s > 2.0]).max() < 0.02 * 0.002
    ups = times_s[1:][(moved[1:, 1] > 0) & (moved[:-1, 1] <= 0)]
    np.testing.assert_allclose(np.diff(ups)[:3], 1 / 8, atol=2e-3)


def test_a_bump_is_for_good() -> None:
    unrest = replace(QUIET, bump_s=2.0, bump_rad=np.array([0.01, 0.02, 0.03]))
    way = replace(through(np.array([0.0, 4.0]), np.array([0.1, 0.1]), np.array([900.0, 900.0])), unrest=unrest)
    assert way.at(1.999) == pytest.approx((0.1, 900.0, 0.0, 0.0))
    assert way.at(2.0) == way.at(3.5) == pytest.approx((0.11, 900.0, 0.02, 0.03))


def test_a_session_shakes_its_tripods_as_configured() -> None:
    optics = OpticsConfig(settled_deg=0.05, sprung_deg=0.03, bump_deg=0.1)
    session = assemble(ShootConfig(optics=optics))
    unrest = [session.unrest(c) for c in range(session.config.cameras)]
    assert all(one is not None for one in unrest)
    settled = np.rad2deg([one.settled_rad for one in unrest if one])
    np.testing.assert_allclose(np.abs(settled), 0.05)
    landings_s = session.clip.landings_s
    assert len(landings_s) >= 3  # round-off, handspring, somersault
    assert all(session.clip.airborne(t - 1e-3) and not session.clip.airborne(t) for t in landings_s.tolist())
    for one in unrest:
        assert one is not None
        np.testing.assert_allclose(np.abs(np.rad2deg(one.rings_rad)), 0.03)
        assert 0.3 * session.times_s[-1] <= one.bump_s <= 0.7 * session.times_s[-1]
    bumps = [np.linalg.norm(np.rad2deg(one.bump_rad)) for one in unrest if one]
    assert sorted(bumps) == pytest.approx([0.0, 0.0, 0.0, 0.1])
    assert assemble(ShootConfig()).unrest(0) is None
