"""The hall looks like one to a feature detector, and the calibration object stands where it says it does."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import mujoco
import numpy as np
import pytest

from sim.cameras.optics import OpticsConfig, build_rig
from sim.hall.gym import HALL_GROUP, OBJECT_GROUP, GymConfig, build_gym, calibration_object
from sim.hall.scenery import HALL_M, WALLS
from sim.hall.textures import Canvas, courses, flecks, grain, tint
from tests.scenes.hall import CORNERS, Hall


@pytest.fixture(scope="module")
def hall() -> Iterator[Hall]:
    hall = Hall(GymConfig(), seed=0)
    yield hall
    hall.close()


@pytest.fixture(scope="module")
def akaze() -> cv2.AKAZE:
    return cv2.AKAZE.create(threshold=1e-4)


def compiled(config: GymConfig, seed: int) -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    build_gym(spec, config, np.random.default_rng(seed))
    return spec.compile()


# --- textures


def test_canvas_is_painted_in_metres() -> None:
    canvas = Canvas.blank(2.0, 1.0, 100, (0, 0, 0))
    canvas.rectangle(0.5, 0.2, 1.0, 0.5, (255, 255, 255))
    rows, columns = np.nonzero(canvas.image[..., 0] > 127)
    assert (columns.min(), columns.max() + 1) == pytest.approx((50, 150), abs=1)
    assert (rows.min(), rows.max() + 1) == pytest.approx((30, 80), abs=1)


def test_a_part_shares_the_pixels_and_clips() -> None:
    canvas = Canvas.blank(2.0, 1.0, 100, (0, 0, 0))
    part = canvas.part(1.5, 0.5, 1.0, 1.0)
    part.fill((9, 9, 9))
    assert (part.width_m, part.height_m) == (0.5, 0.5)
    assert np.count_nonzero(canvas.image[..., 0]) == 50 * 50
    assert canvas.image[:50, 150:].all()


@pytest.mark.parametrize("shape", [(300, 500), (511, 130), (64, 2000)])
def test_grain_has_structure_at_every_scale_and_no_bias(shape: tuple[int, int]) -> None:
    field = grain(shape, np.random.default_rng(3), 6.0, persistence=1.0, octaves=5).astype(float)
    assert field.shape == shape
    assert abs(field.mean()) < 1.5
    for k in range(4):
        band = cv2.GaussianBlur(field, (0, 0), 0.7 * 2**k) - cv2.GaussianBlur(field, (0, 0), 1.4 * 2**k)
        assert band.std() > 0.6


def test_flecks_cover_their_share_and_tint_saturates() -> None:
    image = np.full((400, 600, 3), 10, np.uint8)
    mask = flecks(image.shape, np.random.default_rng(1), 6.0, 0.1)
    assert mask.mean() == pytest.approx(0.1, abs=0.03)
    tint(image, mask, (-30, 20, 250))
    np.testing.assert_array_equal(image[mask], np.tile([0, 30, 255], (mask.sum(), 1)))
    assert (image[~mask] == 10).all()


def test_courses_fill_the_canvas_with_joints() -> None:
    canvas = Canvas.blank(3.0, 1.03, 100, (1, 2, 3))
    courses(
        canvas, np.random.default_rng(0), [(100, 100, 100)], unit_m=(0.4, 0.2), joint_m=0.02, joint=(0, 0, 0), spread=0
    )
    assert set(np.unique(canvas.image)) == {0, 100}
    assert (canvas.image == 0).mean() == pytest.approx(1 - 0.95 * 0.9, abs=0.03)


@pytest.mark.parametrize("unit_m", [(1.1, 0.12), (0.3, 0.2), (2.4, 0.14), (0.5, 0.25)])
def test_joints_lie_on_every_texel_of_the_coarser_levels_alike(unit_m: tuple[float, float]) -> None:
    """Else a coarse level of the texture moves all of them to one side."""
    canvas = Canvas.blank(1.0, 40.0, 100, (1, 2, 3))
    rng = np.random.default_rng(0)
    courses(canvas, rng, [(100, 100, 100)], unit_m=unit_m, joint_m=0.01, joint=(0, 0, 0), spread=0)
    rows = np.flatnonzero((canvas.image == 0).all(axis=(1, 2)))
    assert len(rows) == pytest.approx(40.0 / unit_m[1], rel=0.15)
    for level in (2, 4, 8):
        shares = np.bincount(rows % level, minlength=level) / len(rows)
        np.testing.assert_allclose(shares, 1 / level, atol=0.04)


# --- the hall


def test_the_same_seed_builds_the_same_hall() -> None:
    config = GymConfig(texture_px_per_m=50)
    first, again, other = (compiled(config, seed) for seed in (4, 4, 5))
    np.testing.assert_array_equal(first.tex_data, again.tex_data)
    np.testing.assert_array_equal(first.geom_pos, again.geom_pos)
    assert (first.tex_data != other.tex_data).mean() > 0.5


def test_geoms_are_grouped_and_nothing_collides(hall: Hall) -> None:
    model = hall.model
    names = [model.geom(i).name for i in range(model.ngeom)]
    groups = {name: int(model.geom_group[i]) for i, name in enumerate(names) if name != "post"}
    ours = ("marker", "board", "edge")
    assert all(
        group == (OBJECT_GROUP if name.startswith(ours) and "back" not in name else HALL_GROUP)
        for name, group in groups.items()
    )
    scenery = np.array([name != "post" for name in names])
    assert not model.geom_contype[scenery].any()
    assert not model.geom_conaffinity[scenery].any()
    assert model.tex_data.nbytes < 150e6


def test_walls_face_inwards() -> None:
    for wall in WALLS.values():
        middle = wall.at(wall.length / 2, 0.0, 1.0)
        assert np.linalg.norm(wall.at(wall.length / 2, 1.0, 1.0)[:2]) == pytest.approx(np.linalg.norm(middle[:2]) - 1)
        for u in (0.0, wall.length):
            np.testing.assert_allclose(np.abs(wall.at(u, 0.0, 0.0)[:2]), np.array(HALL_M[:2]) / 2)


def test_depth_varies_along_the_walls(hall: Hall) -> None:
    """Rays at knee to head height from the centre: a good part ends on something that stands off the wall."""
    rng = np.random.default_rng(0)
    azimuth, ends = rng.uniform(-np.pi, np.pi, 400), []
    group = np.array([1, 0, 0, 0, 0, 0], np.uint8)
    for a in azimuth:
        start, ray = np.array([0, 0, rng.uniform(0.2, 2.2)]), np.array([np.cos(a), np.sin(a), 0.0])
        distance = mujoco.mj_ray(hall.model, hall.data, start, ray, group, 1, -1, np.zeros(1, np.int32))
        assert distance > 0
        ends.append(start + distance * ray)
    gap = (np.array(HALL_M[:2]) / 2 - np.abs(ends)[:, :2]).min(axis=1)
    assert gap.min() > -1e-6
    assert (gap > 0.1).mean() > 0.3
    assert (gap < 0.01).mean() > 0.1


@pytest.mark.parametrize("corner", range(4))
def test_every_direction_is_rich_and_well_exposed(hall: Hall, akaze: cv2.AKAZE, corner: int) -> None:
    means = []
    for pan_rad in np.radians(np.arange(0, 360, 45) + 10 * corner):
        hall.look(corner, pan_rad)
        image = hall.image()
        assert len(akaze.detect(image)) > 800
        assert ((image >= 254).all(axis=2) | (image <= 1).all(axis=2)).mean() < 0.01
        means.append(image.mean())
    assert min(means) > 80
    assert 95 < np.mean(means) < 140
    assert max(means) < 150


@pytest.mark.parametrize(("zoom", "least"), [(0.7, 250), (1.5, 200), (2.0, 80), (3.0, 8)])
def test_zoomed_views_match_the_view_at_1x(hall: Hall, akaze: cv2.AKAZE, zoom: float, least: int) -> None:
    for corner, pan_rad in ((0, 0.1), (1, 2.4), (3, -2.2)):
        hall.look(corner, pan_rad)
        points, descriptors = akaze.detectAndCompute(hall.image(), None)
        wide = hall.homography()
        hall.look(corner, pan_rad + 0.04, zoom)
        zoomed_points, zoomed_descriptors = akaze.detectAndCompute(hall.image(), None)
        pairs = cv2.BFMatcher(cv2.NORM_HAMMING).knnMatch(zoomed_descriptors, descriptors, k=2)
        matches = [first for first, second in pairs if first.distance < 0.8 * second.distance]
        zoomed = np.array([(*zoomed_points[pair.queryIdx].pt, 1.0) for pair in matches])
        mapped = zoomed @ (wide @ np.linalg.inv(hall.homography())).T
        error = mapped[:, :2] / mapped[:, 2:] - [points[pair.trainIdx].pt for pair in matches]
        right = np.linalg.norm(error, axis=1) < 2.0
        assert right.sum() >= least
        assert right.mean() > 0.4


def test_shadows_fall_on_the_carpet_unless_switched_off(hall: Hall) -> None:
    hall.look(1, 0.4)
    without = hall.image()
    for shadow in (True, False):
        hall.model.light("light_main").castshadow[:] = shadow
        bare, posted = hall.image().astype(float), hall.image(post=True).astype(float)
        column, row = hall.project(np.array([[-3.7, -3.82, 0.0]])).round().astype(int)[0]
        darker = (posted - bare)[row - 2 : row + 3, column - 2 : column + 3].mean()
        assert (darker < -8) == shadow
    hall.model.light("light_main").castshadow[:] = True
    np.testing.assert_array_equal(hall.image(), without)
    assert compiled(GymConfig(texture_px_per_m=50), 0).light("light_main").castshadow
    assert not compiled(GymConfig(texture_px_per_m=50, shadows=False), 0).light("light_main").castshadow


# --- the calibration object


def test_markers_are_square_upright_and_face_outwards() -> None:
    definition = calibration_object()
    assert [marker.id for marker in definition.markers] == list(range(36))
    for marker in definition.markers:
        sides = np.roll(marker.corners_m, -1, axis=0) - marker.corners_m
        np.testing.assert_allclose(np.linalg.norm(sides, axis=1), 0.5)
        np.testing.assert_allclose(sides[1], (0, 0, -0.5), atol=1e-12)
        normal = np.cross(sides[1], sides[0])
        centre = marker.corners_m.mean(axis=0)
        assert normal @ centre > 0
        assert np.abs(marker.corners_m).max() <= 2.0
        assert (marker.corners_m[:, 2] > 0).all()
    assert definition.wireframe_m.shape == (12, 2, 3)
    np.testing.assert_allclose(np.linalg.norm(np.diff(definition.wireframe_m, axis=1), axis=2), 2.0)


@pytest.mark.parametrize("camera", range(8))
def test_each_camera_sees_two_faces_of_the_object(camera: int) -> None:
    """And neither by less than a sixth of a right angle."""
    place = build_rig(camera, 640, 480, OpticsConfig(), np.random.default_rng(camera)).world_T_head[:3, 3]
    facing = []
    for marker in calibration_object().markers[4::9]:  # the middle one of each face
        right, up = marker.corners_m[1] - marker.corners_m[0], marker.corners_m[0] - marker.corners_m[3]
        ray, normal = place - marker.corners_m.mean(axis=0), np.cross(right, up)
        facing.append(ray @ normal / np.linalg.norm(ray) / np.linalg.norm(normal))
    assert sorted(facing)[-2] > np.sin(np.deg2rad(15.0))


def detector() -> cv2.aruco.ArucoDetector:
    definition = calibration_object()
    return cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, definition.dictionary)))


@pytest.mark.parametrize("corner", range(4))
def test_each_camera_detects_both_faces(hall: Hall, corner: int) -> None:
    corners_m = np.stack([marker.corners_m for marker in calibration_object().markers])
    hall.look(corner, 0.0)
    found, ids, _ = detector().detectMarkers(hall.image(calibration_object=True))
    assert len(ids) == 18
    errors = np.concatenate(found) - np.stack([hall.project(corners) for corners in corners_m[ids.ravel()]])
    assert np.abs(errors).max() < 1.5  # the detector's corners are those of the black pixels, half a pixel inside
    np.testing.assert_allclose(errors.mean(axis=(0, 1)), 0, atol=0.1)


def test_marker_corners_are_rendered_where_they_are_declared(hall: Hall) -> None:
    """Seen at 12 times the focal length, so that the detector's own error counts little: < 0.05 px at 1x."""
    position = np.array([*CORNERS[0], 1.75])
    for marker in (m for m in calibration_object().markers if m.id in (0, 4, 8, 27, 31, 35)):
        hall.aim(position, marker.corners_m.mean(axis=0), zoom=12.0)
        found, ids, _ = detector().detectMarkers(hall.image(calibration_object=True))
        corners = found[ids.ravel().tolist().index(marker.id)][0]
        refined = cv2.cornerSubPix(
            cv2.cvtColor(hall.image(calibration_object=True), cv2.COLOR_BGR2GRAY), corners[:, None].copy(), (9, 9),
            (-1, -1), (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-3),
        )[:, 0]  # fmt: skip
        np.testing.assert_allclose(refined, hall.project(marker.corners_m), atol=0.05 * 12)


def test_the_object_is_hidden_by_its_group(hall: Hall) -> None:
    hall.look(2, 0.0)
    _, ids, _ = detector().detectMarkers(hall.image())
    assert ids is None
