"""Silhouettes against true masks, and against faults put in on purpose: exposure, shadow, a camera that is off."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.ndimage import convolve1d

from experiments.silhouette_score import outline_distance
from pzcap.segmentation import background_model, boundary_refinement, foreground
from pzcap.segmentation.background_model import COLOUR_LEVELS, floor_plane
from pzcap.segmentation.foreground import ForegroundConfig
from pzcap.segmentation.parts import main_parts, without_holes
from pzcap.segmentation.tuning import BACKGROUND, BODY
from pzcap.types import Camera, Image, Lens, Localisation, Mask, Panorama, PanZoomCamera
from tests.scenes.body_scene import HEIGHT, WIDTH, Clip, Shot, shoot

CONFIG = ForegroundConfig()


@pytest.fixture(scope="module")
def clip() -> Clip:
    return shoot(2)


def overlap(probability: Image, mask: Mask) -> float:
    found = probability > 127
    return float((found & mask).sum() / (found | mask).sum())


def cut(shot: Shot, image: Image, background: Image) -> Image:
    known = np.ones(shot.mask.shape, bool)
    return foreground.subtract(image, background, known, shot.camera, 0.0, CONFIG).probability


def expected(mask: Mask) -> foreground.Expected:
    """That the body is where ``mask`` (H, W) has it, as a tracker would say it."""
    inside = mask.astype(np.uint8)
    apart = cv2.distanceTransform(inside, cv2.DIST_L2, 3) - cv2.distanceTransform(1 - inside, cv2.DIST_L2, 3)
    return foreground.Expected(0, 0, np.asarray(apart[::2, ::2], np.float32), 3.0)


def test_what_the_body_may_cover_is_the_body_and_little_more(clip: Clip) -> None:
    mask = clip.shots[0][0].mask
    covered = expected(mask).covered(*mask.shape)
    assert covered[mask].all()
    assert not covered[cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 3) > 14.0].any()


def test_the_athlete_is_found_and_the_shadow_is_not(clip: Clip) -> None:
    scores = [overlap(cut(shot, shot.image, shot.empty), shot.mask) for row in clip.shots for shot in row]
    assert np.mean(scores) > 0.96
    assert min(scores) > 0.94


def test_the_outline_is_found_to_half_a_pixel(clip: Clip) -> None:
    errors = [
        outline_distance(cut(shot, shot.image, shot.empty) > 127, shot.mask) for row in clip.shots for shot in row
    ]
    assert np.mean(errors) < 0.5


def test_probabilities_are_what_they_say(clip: Clip) -> None:
    shots = [shot for row in clip.shots for shot in row]
    said = np.concatenate([cut(shot, shot.image, shot.empty).ravel() for shot in shots]) / 255
    true = np.concatenate([shot.mask.ravel() for shot in shots])
    for low in (0.0, 0.25, 0.5, 0.75):
        group = (said >= low) & (said < low + 0.25)
        assert true[group].mean() == pytest.approx(said[group].mean(), abs=0.25)


def test_exposure_and_vignetting_make_no_difference(clip: Clip) -> None:
    shot = clip.shots[0][0]
    x = (np.arange(WIDTH) - WIDTH / 2) / (WIDTH / 2)
    y = (np.arange(HEIGHT) - HEIGHT / 2) / (WIDTH / 2)
    gain = 1.06 * (1.0 - 0.12 * (x[None, :] ** 2 + y[:, None] ** 2))
    darker = np.clip(shot.image * gain[..., None], 0, 255).astype(np.uint8)
    assert (
        overlap(cut(shot, darker, shot.empty), shot.mask) > overlap(cut(shot, shot.image, shot.empty), shot.mask) - 0.03
    )


def test_a_camera_that_is_half_a_pixel_off_draws_no_outlines_of_the_hall(clip: Clip) -> None:
    shot = clip.shots[0][1]
    shifted = cv2.warpAffine(
        shot.empty, np.array([[1.0, 0.0, 0.5], [0.0, 1.0, -0.3]]), (WIDTH, HEIGHT), borderMode=cv2.BORDER_REPLICATE
    )
    assert overlap(cut(shot, shot.image, np.asarray(shifted, np.uint8)), shot.mask) > 0.85


def test_an_empty_hall_has_no_athlete(clip: Clip) -> None:
    shot = clip.shots[0][2]
    assert (cut(shot, shot.empty, shot.empty) > 127).mean() < 1e-3


@pytest.mark.parametrize("light", [0.45, 0.6, 0.8])
def test_a_shadow_on_the_floor_is_no_body(clip: Clip, light: float) -> None:
    shot = clip.shots[0][0]
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    edge = ((columns - 0.5 * WIDTH) / 70) ** 2 + ((rows - 0.9 * HEIGHT) / 14) ** 2
    shade = cv2.GaussianBlur(np.where(edge < 1, light, 1.0), (0, 0), 1.0)
    shaded = np.where(shot.mask[..., None], shot.image, np.rint(shot.image * shade[..., None])).astype(np.uint8)
    found = cut(shot, shaded, shot.empty) > 127
    wrong = found & ~shot.mask & (cv2.dilate(shot.mask.astype(np.uint8), np.ones((7, 7))) == 0)
    assert wrong.sum() < 0.01 * shot.mask.sum()


def test_a_hall_as_soft_as_a_panorama_at_three_times_its_magnification(clip: Clip) -> None:
    shot = clip.shots[0][1]
    soft = np.asarray(cv2.GaussianBlur(shot.empty, (0, 0), 2.0), np.uint8)
    known = np.ones(shot.mask.shape, bool)
    found = foreground.subtract(shot.image, soft, known, shot.camera, 2.0, CONFIG).probability
    assert overlap(found, shot.mask) > 0.94
    empty = foreground.subtract(shot.empty, soft, known, shot.camera, 2.0, CONFIG).probability
    assert (empty > 127).mean() < 1e-3


def test_specks_far_from_the_body_go(clip: Clip) -> None:
    shot = clip.shots[0][0]
    speckled = shot.image.copy()
    for x, y in ((20, 30), (WIDTH - 40, 60), (30, HEIGHT - 50)):
        cv2.circle(speckled, (x, y), 5, (250, 250, 30), -1)
    assert overlap(cut(shot, speckled, shot.empty), shot.mask) > 0.94


def test_a_body_behind_a_pillar_keeps_both_halves(clip: Clip) -> None:
    shot = clip.shots[0][1]
    rows = np.flatnonzero(shot.mask.any(axis=1))
    middle = (rows[0] + rows[-1]) // 2
    beam = np.s_[middle - 12 : middle + 12]
    image, mask = shot.image.copy(), shot.mask.copy()
    image[beam], mask[beam] = shot.empty[beam], False
    assert overlap(cut(shot, image, shot.empty), mask) > 0.92


def test_a_line_of_the_hall_in_the_colour_of_the_trousers_does_not_cut_the_leg(clip: Clip) -> None:
    shot = clip.shots[0][1]
    rows = np.flatnonzero(shot.mask.any(axis=1))
    knee = int(0.3 * rows[0] + 0.7 * rows[-1])
    line = np.zeros_like(shot.mask)
    line[knee : knee + 3] = True
    trousers = np.median(shot.image[shot.mask & line], axis=0).astype(np.uint8)
    empty, image = shot.empty.copy(), shot.image.copy()
    empty[line], image[line & ~shot.mask] = trousers, trousers
    found = cut(shot, image, empty) > 127
    assert (found & shot.mask & line).sum() > 0.7 * (shot.mask & line).sum()
    assert overlap(cut(shot, image, empty), shot.mask) > 0.94


def test_what_is_expected_finds_a_limb_in_the_colour_of_the_hall(clip: Clip) -> None:
    shot = clip.shots[0][0]
    rows = np.flatnonzero(shot.mask.any(axis=1))
    shin = np.zeros_like(shot.mask)
    shin[int(0.25 * rows[0] + 0.75 * rows[-1]) : int(0.12 * rows[0] + 0.88 * rows[-1])] = True
    near_hall = np.clip(shot.empty + np.array([10.0, -10.0, 10.0]), 0, 255)
    image = np.where((shin & shot.mask)[..., None], near_hall, shot.image).astype(np.uint8)
    known = np.ones(shot.mask.shape, bool)
    there = expected(shot.mask)
    alone = foreground.subtract(image, shot.empty, known, shot.camera, 0.0, CONFIG).probability
    helped = foreground.subtract(image, shot.empty, known, shot.camera, 0.0, CONFIG, there).probability
    assert overlap(helped, shot.mask) > overlap(alone, shot.mask) + 0.02
    elsewhere = expected(np.roll(shot.mask, 60, axis=1))
    misled = foreground.subtract(shot.image, shot.empty, known, shot.camera, 0.0, CONFIG, elsewhere).probability
    assert overlap(misled, shot.mask) > 0.85


def test_a_gap_in_which_the_hall_is_hardly_seen_stays_open_where_one_is_expected() -> None:
    """As between an arm and the trunk."""
    solid, log_odds = np.zeros((40, 30), np.uint8), np.full((40, 30), -6.0, np.float32)
    solid[5:35, 5:25], log_odds[5:35, 5:25] = 1, 4.0
    gap = np.s_[10:30, 14:16]
    solid[gap], log_odds[gap] = 0, -1.0
    body, open_there = np.full(solid.shape, 1.5, np.float32), np.full(solid.shape, 1.5, np.float32)
    open_there[gap] = -1.0
    assert without_holes(solid, log_odds, None)[gap].all()
    assert without_holes(solid, log_odds, body)[gap].all()
    assert not without_holes(solid, log_odds, open_there)[gap].any()
    log_odds[gap] = -4.0  # the hall is seen
    assert not without_holes(solid, log_odds, body)[gap].any()


def test_a_part_that_is_apart_and_small_is_kept_where_it_is_expected() -> None:
    """As a hand, of whose arm nothing is seen before a wall of its colour."""
    log_odds = np.full((60, 40), -4.0, np.float32)
    trunk, hand = np.s_[5:55, 5:20], np.s_[30:34, 30:34]
    log_odds[trunk], log_odds[hand] = 5.0, 2.0
    there, elsewhere = np.full_like(log_odds, -1.5), np.full_like(log_odds, -1.5)
    there[trunk] = there[hand] = elsewhere[trunk] = 2.5
    kept = [main_parts(log_odds, each) for each in (None, elsewhere, there)]
    assert [bool(each[hand].any()) for each in kept] == [False, False, True]
    assert all(each[trunk].all() for each in kept)


def test_where_colours_tell_nothing_the_outline_is_where_it_is_expected() -> None:
    """Sleeves of the wall's colour, seen as softly as a panorama is; where they stand out, it does not matter that they
    are expected two pixels further."""
    rng = np.random.default_rng(4)
    columns = np.broadcast_to(np.arange(40), (40, 40))
    wall = np.full((80, 80, 3), 90.0)
    expected = np.clip(2.0 * (21.0 - columns) - 1.0, -BACKGROUND.prediction_against, BACKGROUND.prediction_for)
    evidence = np.select([columns < 17, columns < 20], [3.0, 0.0], -0.8)
    for colour, edge in ((170.0, 40), (90.0, 42)):
        image = np.where(np.arange(80)[:, None] < 40, colour, wall) + rng.normal(0.0, 2.0, wall.shape)
        frame, hall = (np.clip(np.rint(each), 0, 255).astype(np.uint8) for each in (image, wall))
        drawn = foreground._probability(
            frame, hall, (evidence + expected).astype(np.float32), expected.astype(np.float32)
        )
        found = np.sum(drawn[8:-8] > 127, axis=1)
        assert abs(np.mean(found) - edge) < 0.5


def test_only_where_it_is_expected_is_the_body_sought(clip: Clip) -> None:
    shot = clip.shots[1][0]
    whole = foreground.subtract(shot.image, shot.empty, np.ones(shot.mask.shape, bool), shot.camera, 0.0, CONFIG)
    rows, columns = (np.flatnonzero(shot.mask.any(axis=axis)) for axis in (1, 0))
    top, bottom, left, right = (
        (edge + d) // 2 for line in (rows, columns) for edge, d in ((line[0], -20), (line[-1], 20))
    )
    half, part = np.s_[top:bottom, left:right], np.s_[2 * top : 2 * bottom, 2 * left : 2 * right]
    around = foreground.Expected(2 * left, 2 * top, expected(shot.mask).distance_px[half], 3.0)
    known = np.ones(shot.mask[part].shape, bool)
    found = foreground.subtract(shot.image[part], shot.empty[part], known, shot.camera, 0.0, CONFIG, around)
    assert overlap(found.probability, shot.mask[part]) >= overlap(whole.probability, shot.mask)
    # what the colours say does not depend on where the window begins
    apart = np.abs(found.evidence - whole.evidence[half])[3:-3, 3:-3]
    assert np.mean(apart < 1.0) > 0.9


def test_gain_is_matched_to_a_percent(clip: Clip) -> None:
    shot = clip.shots[0][3]
    brighter = np.clip(shot.empty * 1.08, 0, 255).astype(np.uint8)
    matched = foreground.match_gain(brighter, shot.empty, np.ones(shot.mask.shape, bool))
    ratio = matched.astype(float).sum() / brighter.astype(float).sum()
    assert ratio == pytest.approx(1.0, abs=0.01)


def test_unknown_background_is_no_evidence(clip: Clip) -> None:
    shot = clip.shots[0][0]
    known = np.ones(shot.mask.shape, bool)
    known[:, :60] = False
    background = shot.empty.copy()
    background[:, :60] = 0
    found = foreground.subtract(shot.image, background, known, shot.camera, 0.0, CONFIG).probability
    assert not (found[:, :50] > 127).any()


def test_a_camera_that_is_lost_gives_no_silhouette() -> None:
    width, height = 64, 48
    panorama = Panorama(
        np.full((60, 200, 3), 90, np.uint8), np.ones((60, 200), bool), 60.0, np.array([100.0, 30.0]), False,
        np.zeros(1), np.zeros(1, np.int64), 0.0, 0.0,
    )  # fmt: skip
    lens = Lens(width, height, 60.0, np.array([[31.5, 23.5]]), np.zeros(1))
    camera = PanZoomCamera(lens, np.eye(4), 0.0, 0.0)
    nowhere = Localisation(0.0, 0.0, 60.0, np.eye(2), False, np.zeros((0, 2)), np.zeros((0, 2)))
    silhouette = foreground.separate(np.zeros((height, width, 3), np.uint8), panorama, camera, nowhere, CONFIG)
    assert not silhouette.valid
    assert silhouette.probability.shape == (height, width)


def test_the_floor_ends_at_the_horizon(clip: Clip) -> None:
    camera: Camera = clip.shots[0][0].camera
    plane = floor_plane(camera, 25.0)
    for u, v in ((0, 0), (WIDTH / 2, HEIGHT - 1), (WIDTH - 1, HEIGHT * 0.7)):
        ray = camera.world_T_cam[:3, :3] @ np.array(
            [(u - camera.principal_px[0]) / camera.focal_px, (v - camera.principal_px[1]) / camera.focal_px, 1.0]
        )
        meets = ray[2] < 0 and camera.world_T_cam[2, 3] / -ray[2] < 25.0
        assert (plane @ [u, v, 1.0] < 0) == meets


def test_a_palette_is_the_colours_seen_blurred() -> None:
    frame = np.random.default_rng(0).normal(90.0, 60.0, (40, 30, 3)).clip(0, 255).astype(np.uint8)
    where = np.zeros((40, 30), np.uint8)
    where[5:25, 8:20] = 1
    counts = np.histogramdd(frame[where > 0].astype(float), bins=[np.linspace(0, 256, COLOUR_LEVELS + 1)] * 3)[0]
    for axis in range(3):
        counts = convolve1d(counts, [0.25, 0.5, 0.25], axis, mode="nearest")
    expected = np.log(BACKGROUND.any_colour + (1.0 - BACKGROUND.any_colour) * counts / counts.sum() * COLOUR_LEVELS**3)
    counted = np.zeros((COLOUR_LEVELS,) * 3, np.int64)
    background_model.count_colours(frame, where, counted)
    np.testing.assert_allclose(background_model.log_shares(counted), expected, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("angle_deg", [10.0, 35.0, 80.0])
def test_a_pixel_that_is_half_body_is_body_however_rough_the_cloth(angle_deg: float) -> None:
    """An even wall, and cloth whose colour is known less well: mixtures of both are near neither, and split evenly."""
    rng = np.random.default_rng(3)
    rows, columns = np.mgrid[:800, :800] / 10.0 - 40.0
    inside = columns * np.cos(np.radians(angle_deg)) + rows * np.sin(np.radians(angle_deg)) > 0.3
    covered = inside.reshape(80, 10, 80, 10).mean(axis=(1, 3))
    wall = np.full((80, 80, 3), 90.0)
    cloth = 170.0 + cv2.GaussianBlur(rng.normal(0.0, 60.0, (80, 80, 3)), (0, 0), 1.0)
    image = covered[..., None] * cloth + (1.0 - covered[..., None]) * wall + rng.normal(0.0, 2.0, (80, 80, 3))
    hint = cv2.GaussianBlur((8.0 * covered - 4.0).astype(np.float32), (0, 0), 1.5)
    frame, hall, solid = np.clip(np.rint(image), 0, 255).astype(np.uint8), wall.astype(np.uint8), covered > 0.5
    drawn = boundary_refinement.refine(frame, hall, hint, BODY.alone * hint, solid.astype(np.uint8))
    mixed = (covered > 0.15) & (covered < 0.85)
    mixed[:6], mixed[-6:], mixed[:, :6], mixed[:, -6:] = False, False, False, False
    assert abs(np.mean(drawn[mixed] > 0.5) - np.mean(covered[mixed] > 0.5)) < 0.07
    assert np.mean((drawn > 0.5)[mixed] == (covered > 0.5)[mixed]) > 0.9
