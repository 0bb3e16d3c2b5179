"""Other people on the floor: found by all views together, and unknown to the tracker wherever they stand."""

from __future__ import annotations

import gc
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pzcap.localisation.panorama_sampler import ViewPlace, warp_background
from pzcap.segmentation import company
from pzcap.segmentation.background_model import ForegroundConfig, shrink
from pzcap.segmentation.company import WholeView, others_on_floor, whole_view, with_others
from pzcap.segmentation.expected import Expected
from pzcap.segmentation.others import BEFORE, BESIDE
from pzcap.segmentation.tuning import OTHERS
from pzcap.types import Array, Camera, Image, Localisation, Mask, Silhouette
from tests.scenes import synthetic
from tests.scenes.body_scene import aim
from tests.scenes.cylinders import camera_of, whole_turn

ATHLETE_M = np.array([0.2, -0.1, 0.95])
CORNERS_M = ((-7.0, -6.0), (7.0, -6.0), (7.0, 6.0), (-7.0, 6.0))
SCALE = 4


def cameras() -> list[Camera]:
    """Four, in the corners of a hall."""
    return [aim(np.array([*corner, 2.0]), ATHLETE_M) for corner in CORNERS_M]


def somebody(camera: Camera, place: Array) -> Image:
    """Somebody who stands at a ``place`` (2,) in a view, half pixels."""
    mask = np.zeros((camera.height // 2, camera.width // 2), np.uint8)
    outline = company._outline(camera, place)
    assert outline is not None
    cv2.fillPoly(mask, [outline], 1)
    return mask


def seen(camera: Camera, others: list[Array]) -> WholeView:
    """A view of the athlete and ``others``."""
    athlete = somebody(camera, ATHLETE_M[:2])
    people = np.maximum.reduce([athlete, *(somebody(camera, each) for each in others)])

    def coarse(mask: Image) -> Mask:
        return shrink(mask.astype(np.float32), SCALE // 2) > 0.4

    apart = cv2.distanceTransform(athlete, cv2.DIST_L2, 3) - cv2.distanceTransform(1 - athlete, cv2.DIST_L2, 3)
    expected = Expected(0, 0, np.asarray(2.0 * apart, np.float32), 0.0, ATHLETE_M)
    around = company._covered(expected, SCALE, (athlete.shape[0] * 2 // SCALE, athlete.shape[1] * 2 // SCALE))
    return WholeView(camera, coarse(people), around, SCALE, expected, ATHLETE_M)


def is_there(place: Array, found: Array) -> bool:
    """True if one of those ``found`` stands at a ``place``."""
    return bool((np.linalg.norm(found - place, axis=1) < 0.3).any())


def test_nobody_is_found_where_the_athlete_is_alone() -> None:
    assert others_on_floor([seen(camera, []) for camera in cameras()]).shape == (0, 2)
    assert others_on_floor([]).shape == (0, 2)


@given(st.floats(0.0, 2 * np.pi), st.floats(0.9, 1.6))
def test_somebody_is_found_wherever_he_stands(direction: float, away_m: float) -> None:
    place = ATHLETE_M[:2] + away_m * np.array([np.cos(direction), np.sin(direction)])
    found = others_on_floor([seen(camera, [place]) for camera in cameras()])
    assert is_there(place, found)


def test_somebody_behind_the_athlete_in_two_views_is_found_by_the_others() -> None:
    corners = np.array(CORNERS_M)
    place = ATHLETE_M[:2] + 1.2 * (corners[0] - corners[2]) / np.linalg.norm(corners[0] - corners[2])
    views = [seen(camera, [place]) for camera in cameras()]
    apart = [float((view.foreground & ~view.athlete).sum() / view.foreground.sum()) for view in views]
    assert max(apart[0], apart[2]) < 0.3 < min(apart[1], apart[3])
    (found,) = others_on_floor(views)
    assert np.linalg.norm(found - place) < 0.2


def test_a_view_that_shows_nobody_there_rules_it_out() -> None:
    place = ATHLETE_M[:2] + np.array([1.5, 0.0])
    views = [seen(camera, [place]) for camera in cameras()]
    assert is_there(place, others_on_floor(views))
    assert not is_there(place, others_on_floor([*views[:3], seen(cameras()[3], [])]))
    # one that looks elsewhere does not
    away = aim(np.array([-7.0, 6.0, 2.0]), np.array([-14.0, 12.0, 1.0]))
    nothing = np.zeros_like(views[3].foreground)
    assert is_there(
        place, others_on_floor([*views[:3], WholeView(away, nothing, nothing, SCALE, views[3].expected, ATHLETE_M)])
    )


def test_foreground_of_others_is_unknown_and_they_hide_who_is_behind() -> None:
    camera = cameras()[0]
    towards = camera.world_T_cam[:2, 3] - ATHLETE_M[:2]
    towards /= np.linalg.norm(towards)
    for away_m, kind in ((1.2, BEFORE), (-1.2, BESIDE), (0.5, BESIDE)):
        place = ATHLETE_M[:2] + away_m * towards
        people = np.maximum(somebody(camera, ATHLETE_M[:2]), somebody(camera, place))
        evidence = np.where(people > 0, np.float32(4.0), np.float32(-4.0))
        nothing = np.zeros((camera.height, camera.width), np.uint8)
        silhouette = Silhouette(nothing, np.dstack([nothing] * 3), evidence, True, np.zeros(evidence.shape, np.uint8))
        view = seen(camera, [place])
        told = with_others(silhouette, view, place[None])
        hers = view.expected.within(OTHERS.beside_px, people.shape)
        theirs = (somebody(camera, place) > 0) & ~(hers & (away_m == 0.5))
        assert (told.others[theirs] == kind).all()
        assert not told.evidence[theirs].any()
        assert not told.others[~theirs].any()
        assert (told.evidence[~theirs] == evidence[~theirs]).all()
        assert not silhouette.others.any()  # what was given stays as it was


def test_who_stands_behind_the_camera_hides_nothing() -> None:
    camera = cameras()[0]
    behind = camera.world_T_cam[:2, 3] + 0.3 * (camera.world_T_cam[:2, 3] - ATHLETE_M[:2])
    evidence = np.full((camera.height // 2, camera.width // 2), 4.0, np.float32)
    nothing = np.zeros((camera.height, camera.width), np.uint8)
    silhouette = Silhouette(nothing, np.dstack([nothing] * 3), evidence, True, np.zeros(evidence.shape, np.uint8))
    assert not with_others(silhouette, seen(camera, []), behind[None]).others.any()


@pytest.mark.parametrize("gain", [1.0, 0.8])
def test_whole_view_shows_who_is_not_hall(gain: float) -> None:
    panorama, optics = whole_turn(3), synthetic.Optics()
    camera, focal_px = camera_of(optics), 1.3 * optics.reference_focal_px
    place = ViewPlace(0.4, optics.tilt_rad, focal_px)
    hall, known = warp_background(panorama, camera, place)
    assert known.all()
    image = np.asarray(gain * hall, np.uint8)
    height, width = known.shape
    person = np.s_[height // 4 : 3 * height // 4, width // 2 : width // 2 + width // 12]
    image[person] = (40, 160, 60)
    found = Localisation(0.4, optics.tilt_rad, focal_px, np.eye(2), True, np.zeros((0, 2)), np.zeros((0, 2)))
    window = Expected(width // 4, height // 4, np.full((20, 20), -50.0, np.float32), 2.0, ATHLETE_M)
    view = whole_view(image, panorama, camera, found, ForegroundConfig(), window)
    assert view is not None
    assert not view.athlete.any()
    truth = np.zeros(known.shape, np.float32)
    truth[person] = 1.0
    share = shrink(truth, view.scale)
    assert view.foreground[share > 0.9].all()
    assert view.foreground[share == 0.0].mean() < 0.02
    lost = replace(window, pelvis_m=None)
    assert whole_view(image, panorama, camera, found, ForegroundConfig(), lost) is None


def test_the_athlete_is_where_expected_in_a_whole_view() -> None:
    expected = Expected(40, 24, np.full((30, 20), 5.0, np.float32), 0.0, ATHLETE_M)
    covered = company._covered(expected, 4, (60, 80))
    rows, columns = np.nonzero(covered)
    assert (rows.min(), rows.max()) == (6, 20)
    assert (columns.min(), columns.max()) == (10, 19)


def test_a_coarse_hall_is_the_fine_one_shrunk() -> None:
    panorama, optics = whole_turn(3), synthetic.Optics()
    place = ViewPlace(-0.7, optics.tilt_rad, optics.reference_focal_px)
    fine, _ = warp_background(panorama, camera_of(optics), place)
    by = 4
    coarser = round(by * panorama.px_per_rad / optics.reference_focal_px)
    coarse, known = warp_background(company._shrunk(panorama, coarser), camera_of(optics), place, every=by)
    assert coarse.shape[:2] == (fine.shape[0] // by, fine.shape[1] // by)
    assert known.all()
    off = cv2.GaussianBlur(coarse, (0, 0), 1.0).astype(float) - cv2.GaussianBlur(shrink(fine, by), (0, 0), 1.0)
    assert np.sqrt(np.mean(off[2:-2, 2:-2] ** 2)) < 2.0


def test_a_shrunk_hall_is_made_once_and_kept_no_longer_than_the_hall() -> None:
    panorama = whole_turn(4)
    assert company._shrunk(panorama, 3) is company._shrunk(panorama, 3)
    kept = len(company._SHRUNK)
    del panorama
    gc.collect()
    assert len(company._SHRUNK) == kept - 1
