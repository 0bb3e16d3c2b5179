"""The panorama: brightness, pasting, the seam, and the paper's chain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pzcap.calibration import bundle_adjustment, correspondences, stitching, sweep
from pzcap.calibration.beliefs import Sigmas
from pzcap.calibration.bundle_adjustment import Link
from pzcap.calibration.parameters import CalibrationParameters
from pzcap.calibration.settings import PanZoomConfig
from pzcap.calibration.sweep import SweepConfig
from pzcap.extras.paper import stitching as paper
from pzcap.geometry.camera import View, at, pixel_to_direction, wrapped
from pzcap.geometry.lens import NONE, Distortion
from pzcap.imaging.colour import grey
from pzcap.types import FAR_AWAY, Array, Image, Panorama, PzcapError
from tests.scenes import synthetic
from tests.scenes.cylinders import camera_of

OPTICS = synthetic.Optics()
WIDTH, HEIGHT, FOCAL = OPTICS.width, OPTICS.height, OPTICS.reference_focal_px
VIEW = View(0.0, OPTICS.tilt_rad, OPTICS.roll_rad, FOCAL, np.array(OPTICS.principal_px), Distortion(OPTICS.k1))


LOOSE = SweepConfig(ratio=0.98, min_matches=4)  # with chance matches


def silent(done: int) -> None:
    del done


def stitched(taken: list[tuple[int, Image]], pans: Array, full_turn: bool, bright: stitching.Brightness) -> Panorama:
    greys = [grey(image) for _, image in taken]
    swept = stitching.SweptFrames(greys, np.arange(len(pans)), bright, VIEW)
    return stitching.stitch(taken, swept, pans, full_turn, FAR_AWAY, silent)


def test_a_partial_sweep_is_pasted_where_it_belongs() -> None:
    pans = np.deg2rad(np.arange(0.0, 40.0, 5.0))
    bright = stitching.Brightness(np.zeros(len(pans)), np.array([-0.2, -0.02]))  # log(1 - 0.2 r^2)
    found = stitched(synthetic.frames(OPTICS, pans), pans, False, bright)
    row, column = np.nonzero(found.valid)
    azimuth = (found.origin_px[0] - column) / found.px_per_rad
    slope = (found.origin_px[1] - row) / found.px_per_rad
    here = np.abs(found.image[row, column] - synthetic.hall_at(azimuth, slope)).mean()
    beside = np.abs(found.image[row, column] - synthetic.hall_at(azimuth + 1 / found.px_per_rad, slope)).mean()
    assert here < 0.7 * beside
    assert azimuth.max() == pytest.approx(pans[-1] + np.arctan(WIDTH / 2 / FOCAL), abs=0.02)
    assert azimuth.min() == pytest.approx(-np.arctan(WIDTH / 2 / FOCAL), abs=0.02)
    assert found.valid.mean() > 0.8


def test_a_full_turn_wraps_and_shows_no_seam() -> None:
    pans = np.deg2rad(np.arange(0.0, 360.0, 12.0))
    bright = stitching.Brightness(np.zeros(len(pans)), np.array([-0.2, -0.02]))
    found = stitched(synthetic.frames(OPTICS, pans), pans, True, bright)
    assert found.image.shape[1] == pytest.approx(2 * np.pi * found.px_per_rad)
    assert found.valid[40:-40].all()
    row, column = np.nonzero(found.valid)
    azimuth, slope = ((o - p) / found.px_per_rad for o, p in zip(found.origin_px, (column, row), strict=True))
    difference = np.abs(found.image[row, column] - synthetic.hall_at(azimuth, slope)).mean(axis=1)
    at_the_seam = (column < 5) | (column >= found.image.shape[1] - 5)
    assert difference[at_the_seam].mean() < 1.3 * difference.mean()


def test_somebody_who_walks_through_the_sweep_leaves_no_ghost() -> None:
    pans = np.deg2rad(np.arange(0.0, 40.0, 2.5))
    quiet = stitching.Brightness(np.zeros(len(pans)), np.array([-0.2, -0.02]))
    alone = synthetic.frames(OPTICS, pans)
    walked = [(i, image.copy()) for i, image in alone]
    for (_, image), left in zip(walked[5:9], (200, 170, 140, 110), strict=True):
        image[60:200, left : left + 40] = (30, 40, 200)
    clean, found = (stitched(taken, pans, False, quiet) for taken in (alone, walked))
    ghost = np.abs(found.image.astype(float) - clean.image).max(axis=2)
    assert ghost.max() > 0  # she was in the pictures
    assert np.percentile(ghost, 99.9) < 12
    assert ghost.mean() < 0.3


def test_a_sweep_panned_slowly_is_thinned_and_comes_to_the_same() -> None:
    pans = np.deg2rad(np.concatenate([np.zeros(5), np.arange(0.0, 30.0, 0.5)]))
    guess = View(0.0, OPTICS.tilt_rad, OPTICS.roll_rad, FOCAL, np.array(OPTICS.principal_px), Distortion(OPTICS.k1))
    found = sweep.chain(synthetic.frames(OPTICS, pans), guess, False, SweepConfig(), silent)
    assert len(found.kept) < 0.5 * len(pans)
    assert len(found.kept) == len(found.pan_rad) == len(found.images) == len(found.features)
    np.testing.assert_allclose(np.rad2deg(found.pan_rad - pans[found.kept]), 0.0, atol=0.1)


def test_gains_and_vignetting_come_from_the_overlaps() -> None:
    rng = np.random.default_rng(0)
    gains, shape = rng.normal(0, 0.03, 20), np.array([-0.25, -0.03])
    links = []
    for first in range(19):
        a, b = rng.uniform((0, 0), (WIDTH, HEIGHT), (2, 200, 2))
        radial = stitching._radial(b, VIEW, WIDTH, HEIGHT) - stitching._radial(a, VIEW, WIDTH, HEIGHT)
        ratio = radial @ shape + gains[first + 1] - gains[first] + rng.normal(0, 0.02, 200)
        ratio[:20] += rng.uniform(-1, 1, 20)
        links.append(Link(first, first + 1, a, b, ratio))
    found = stitching.fit_brightness(links, 20, VIEW, WIDTH, HEIGHT)
    np.testing.assert_allclose(found.log_gain, gains - gains.mean(), atol=0.01)
    radius = np.linspace(0, 1, 20)
    darker = np.column_stack([radius**2, radius**4])
    np.testing.assert_allclose(darker @ found.vignetting, darker @ shape, atol=0.01)


def test_a_partial_sweep_is_adjusted_without_closure() -> None:
    pans = np.deg2rad(np.arange(0.0, 60.0, 4.0))
    guess = View(0.0, 0.0, 0.0, FOCAL * 1.002, np.array([(WIDTH - 1) / 2, (HEIGHT - 1) / 2]), NONE)
    chain = sweep.chain(synthetic.frames(OPTICS, pans), guess, False, SweepConfig(), silent)
    count = len(pans)
    start = CalibrationParameters(
        chain.pan_rad, np.array([np.log(guess.focal_px)]), np.arange(count), np.zeros(count, np.int64), 0.0, 0.0,
        guess.principal_px[None], np.zeros(1), np.zeros(3), np.zeros(2), 0.0, FAR_AWAY,
    )  # fmt: skip
    sigmas = Sigmas(0.002, 0.2, np.array([3.2]), np.array([0.1]), np.array([0.03, 0.001, 0.001]))
    found = bundle_adjustment.adjust(start, chain.links, sigmas).parameters
    assert np.abs(np.rad2deg(found.pan_rad - pans)).max() < 0.15
    assert np.exp(found.log_focal[0]) == pytest.approx(FOCAL, rel=3e-3)
    assert found.roll_rad == pytest.approx(OPTICS.roll_rad, abs=2e-3)
    assert chain.closure_rad == 0.0


def test_a_pan_that_went_on_unexpectedly_is_found_where_it_went() -> None:
    """Chance matches near the pan that was expected, in a texture that repeats, are fewer than those where it is."""
    guess = replace(VIEW, tilt_rad=0.0, roll_rad=0.0)
    found = [sweep.detect(image, LOOSE) for _, image in synthetic.frames(OPTICS, np.deg2rad([0.0, 9.0]))]
    misled = sweep.link_pan(found, 0, 1, guess, np.deg2rad(1.0), LOOSE)
    assert misled is not None
    content = replace(LOOSE, min_matches=len(misled.first_px) // 5)  # with which the chance matches are enough
    for before, config in ((0, LOOSE), (3 * len(misled.first_px), content)):
        link = sweep._link_to_next(found, 0, guess, np.deg2rad(1.0), before, config)
        assert link is not None
        assert len(link.first_px) > 3 * len(misled.first_px)
        assert np.rad2deg(sweep._turn(link, guess)) == pytest.approx(9.0, abs=0.2)
    believed = sweep._link_to_next(found, 0, guess, np.deg2rad(1.0), 0, content)
    assert believed is not None
    assert len(believed.first_px) == len(misled.first_px)


WALL = np.deg2rad([100.0, 150.0])
"""Azimuths between which the hall of `before_a_wall` has a bare wall."""


def before_a_wall(pans: Array, wall: Array = WALL) -> list[tuple[int, Image]]:
    """Frames of a hall in which nothing is seen between two azimuths."""
    shown = []
    for index, image in synthetic.frames(OPTICS, pans):
        columns = np.stack([np.arange(WIDTH), np.full(WIDTH, HEIGHT / 2)], axis=-1)
        azimuth, _ = pixel_to_direction(replace(VIEW, pan_rad=float(pans[index])), columns)
        bare = (wrapped(azimuth - wall[0]) > 0.0) & (wrapped(azimuth - wall[1]) < 0.0)
        shown.append((index, np.where(bare[:, None], np.uint8(150), image)))
    return shown


@pytest.mark.parametrize("start_deg", [-30.0, 60.0])
def test_of_a_turn_past_a_bare_wall_the_rest_is_one_part(start_deg: float) -> None:
    """End and beginning show the same: the sweep goes on from the one to the other, and stops before the wall."""
    pans = np.deg2rad(start_deg + np.arange(0.0, 380.0, 5.0))
    found = sweep.chain(before_a_wall(pans), VIEW, True, SweepConfig(), silent)
    assert not found.full_turn
    assert found.closure_rad == 0.0
    assert 0 < len(pans) - len(found.kept) < 12
    left_out = pans[np.setdiff1d(np.arange(len(pans)), found.kept)]
    assert np.all((left_out > WALL[0]) & (left_out < WALL[1]))
    turned, expected = (each - each[0] for each in (found.pan_rad, pans[found.kept]))
    np.testing.assert_allclose(np.rad2deg(wrapped(turned - expected)), 0.0, atol=0.6)
    assert np.ptp(found.pan_rad) < 2 * np.pi
    apart = [found.pan_rad[link.second] - found.pan_rad[link.first] for link in found.links]
    assert np.abs(apart).max() < 0.8  # those across the seam, too
    assert any(link.second - link.first > len(pans) // 2 for link in found.links)


def test_few_matches_that_contradict_all_others_hold_nothing_together() -> None:
    """Across the bare wall some matches agree by chance: by these the circle would close, by degrees too early."""
    pans = np.deg2rad(60.0 + np.arange(0.0, 380.0, 5.0))
    config, camera = PanZoomConfig(), at(camera_of(OPTICS), 0.0, OPTICS.tilt_rad, OPTICS.reference_focal_px)
    right = sweep.chain(before_a_wall(pans), VIEW, True, config.sweep, silent)
    (gap,) = np.flatnonzero(np.diff(right.kept) > 1)
    rng = np.random.default_rng(0)
    places = rng.uniform([20.0, 20.0], [WIDTH - 20.0, HEIGHT - 20.0], (20, 2))
    chance = Link(int(gap), int(gap) + 1, places, places + rng.normal(0.0, 8.0, (20, 2)), np.zeros(20))
    links = sorted((*right.links, chance), key=lambda link: link.first)
    found, coarse, _ = correspondences._linked(replace(right, links=tuple(links)), VIEW, camera, WIDTH, config)
    assert len(found.links) == len(right.links)
    assert not any(link.first == gap and link.second == gap + 1 for link in found.links)
    np.testing.assert_array_equal(found.kept, right.kept)
    turned, expected = (each - each[0] for each in (coarse.pan_rad, pans[found.kept]))
    np.testing.assert_allclose(np.rad2deg(wrapped(turned - expected)), 0.0, atol=0.6)


def test_few_matches_that_agree_are_kept() -> None:
    pans = np.deg2rad(np.arange(0.0, 100.0, 5.0))
    config, camera = PanZoomConfig(), at(camera_of(OPTICS), 0.0, OPTICS.tilt_rad, OPTICS.reference_focal_px)
    whole = sweep.chain(synthetic.frames(OPTICS, pans), VIEW, False, config.sweep, silent)
    some = np.arange(len(whole.links[7].first_px)) % 10 == 0
    links = (*whole.links[:7], whole.links[7].subset(some), *whole.links[8:])
    assert sweep.held_by_few(replace(whole, links=links), config.sweep) == {7}
    found, *_ = correspondences._linked(replace(whole, links=links), VIEW, camera, WIDTH, config)
    assert found.links == links


def test_of_a_partial_sweep_with_a_gap_the_longer_part_counts() -> None:
    pans = np.deg2rad(np.arange(60.0, 260.0, 5.0))
    found = sweep.chain(before_a_wall(pans), VIEW, False, SweepConfig(), silent)
    assert np.rad2deg(pans[found.kept[0]]) > 120.0
    assert found.kept[-1] == len(pans) - 1
    assert np.array_equal(np.diff(found.kept), np.ones(len(found.kept) - 1))
    assert all(link.second == link.first + 1 for link in found.links)


def test_fainter_features_are_sought_where_few_are_seen() -> None:
    [(_, image)] = synthetic.frames(OPTICS, np.zeros(1))
    faint = np.rint(128.0 + 0.12 * (grey(image).astype(float) - 128.0)).astype(np.uint8)
    usual = sweep.features.detect(faint, SweepConfig().threshold, 1000, scales=(2, 2))
    assert len(usual) < 60
    assert len(sweep.detect(faint, SweepConfig())) > 3 * len(usual)


def test_gaps_and_open_circles_are_said_in_one_line() -> None:
    guess = replace(VIEW, tilt_rad=0.0, roll_rad=0.0)
    jump = synthetic.frames(OPTICS, np.deg2rad([0.0, 4.0, 90.0]))
    with pytest.raises(PzcapError, match="frames 1 and 2 show nothing in common"):
        sweep.chain(jump, guess, False, SweepConfig(), silent)
    half = synthetic.frames(OPTICS, np.deg2rad(np.arange(0.0, 60.0, 6.0)))
    with pytest.raises(PzcapError, match="circle cannot close"):
        sweep.chain(half, guess, True, SweepConfig(), silent)
    with pytest.raises(PzcapError, match="too few"):
        paper.stitch(synthetic.frames(OPTICS, np.zeros(1)), FOCAL, SweepConfig(), silent)
