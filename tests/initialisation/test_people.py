"""The athlete among others, and left from right, over views and frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pzcap.initialisation.people import Detections, Sighting, athlete
from pzcap.initialisation.triangulation import rays_of, triangulate
from pzcap.types import Array
from tests.scenes.detected import Faults, detections

FRAMES = 12


def people(sightings: list[Sighting]) -> Array:
    """(F, V, 26, 3)"""
    return np.array([[view[1] for view in sighting if view is not None] for sighting in sightings])


@pytest.fixture(scope="module")
def plain() -> Array:
    return people(athlete(detections(FRAMES, Faults())))


def test_who_is_alone_and_well_seen_stays_as_found(plain: Array) -> None:
    found = np.array([[view[1][0] for view in each.views if view] for each in detections(FRAMES, Faults())])
    np.testing.assert_array_equal(plain, found)


@pytest.mark.parametrize("faults", [[(3, 1)], [(4, 2), (5, 2), (6, 2)], [(0, 0)], [(7, 0), (7, 3), (8, 0), (8, 3)]])
def test_sides_that_are_exchanged_in_some_views_are_put_right(plain: Array, faults: list[tuple[int, int]]) -> None:
    """Even in half of the views, since in the frames before nobody stood the other way round."""
    right = people(athlete(detections(FRAMES, Faults(backward=tuple(faults)))))
    np.testing.assert_array_equal(right, plain)


@pytest.mark.parametrize("count", [2, 6])
def test_three_views_of_four_may_err_alike_for_some_frames(plain: Array, count: int) -> None:
    """A detector that errs in a frame errs in the next one, too, and nobody changes sides meanwhile."""
    faults = tuple((frame, view) for frame in range(3, 3 + count) for view in (0, 1, 3))
    np.testing.assert_array_equal(people(athlete(detections(FRAMES, Faults(backward=faults)))), plain)


def test_of_two_people_the_one_whom_the_cameras_follow(plain: Array) -> None:
    found = athlete(detections(FRAMES, Faults(other=True)))
    off = np.linalg.norm((people(found) - plain)[..., :2], axis=-1)
    assert np.median(off) < 5.0  # the noise is drawn anew
    assert off.max() < 40.0


def test_a_view_without_a_camera_or_a_person_is_left_out() -> None:
    some = detections(FRAMES, Faults())
    blind = [Detections((None, *each.views[1:])) for each in some]
    assert all(sighting[0] is None and sighting[1] is not None for sighting in athlete(blind))
    camera, _ = some[2].views[3] or pytest.fail("it has a camera")
    some[2] = Detections((*some[2].views[:3], (camera, np.zeros((0, 26, 3)))))
    assert athlete(some)[2][3] is None


def test_one_view_that_is_turned_over_does_not_move_the_points() -> None:
    true, turned = (athlete(detections(3, Faults(noise_px=0.5, turned=faults))) for faults in ((), ((1, 2),)))
    points = [triangulate(rays_of([view for view in seen[1] if view], 0.1), 0.15).points_m for seen in (true, turned)]
    assert np.median(np.linalg.norm(points[0] - points[1], axis=1)) < 0.01


def test_a_camera_that_may_look_elsewhere_is_believed_less(plain: Array) -> None:
    some = detections(FRAMES, Faults())
    doubted = people(athlete([replace(each, sigma_rad=(0.0, 0.004, 1e-6, 0.0)) for each in some]))
    np.testing.assert_array_equal(doubted[..., :2], plain[..., :2])
    np.testing.assert_allclose(doubted[:, [0, 2, 3], :, 2], plain[:, [0, 2, 3], :, 2], rtol=1e-4)
    assert doubted[:, 1, :, 2].max() < 0.5  # 30 mm at 8 m, where a sure detector errs by 15
