"""The simulated cameras: mount, lens and plate, against formulas written here and against MuJoCo's own camera."""

from __future__ import annotations

from dataclasses import replace

import cv2
import mujoco
import numpy as np
import pytest

from pzcap.types import Array
from sim.cameras.optics import OpticsConfig, Rig, build_rig, vignette
from sim.cameras.plate import lens_maps, plate_for, through_lens
from sim.cameras.render import Stage

CLEAN = OpticsConfig(
    k1_wide=0.0, k1_long=0.0, principal_offset=0.0, vignetting=1.0, axis_beside_m=0.0, axis_behind_m=0.0,
    centre_travel_m=0.0, roll_deg=0.0, axis_lean_deg=0.0,
)  # fmt: skip
ZOOMS = (0.7, 1.0, 1.7, 3.0)


def make_rig(config: OpticsConfig | None = None, camera: int = 0, seed: int = 5, width: int = 640) -> Rig:
    config = config or OpticsConfig()
    return build_rig(camera, width, width * 3 // 4, config, np.random.default_rng(seed))


def project(rig: Rig, pan_rad: float, focal_px: float, points_m: Array) -> Array:
    """(N, 2) pixels, by the formulas of `pzcap.types`."""
    cam_T_world = np.linalg.inv(rig.world_T_cam(pan_rad, focal_px))
    points = points_m @ cam_T_world[:3, :3].T + cam_T_world[:3, 3]
    xy = points[:, :2] / points[:, 2:]
    return rig.principal_px + focal_px * (1 + rig.k1(focal_px) * np.sum(xy**2, axis=1, keepdims=True)) * xy


@pytest.mark.parametrize("camera", range(4))
def test_cameras_look_over_the_middle_of_the_hall(camera: int) -> None:
    rig = make_rig(camera=camera)
    focal_px = rig.reference_focal_px
    assert focal_px == 880
    assert 1.5 <= rig.world_T_head[2, 3] <= 2.0
    centre = project(rig, 0.0, focal_px, np.array([[0.0, 0.0, 0.9]]))[0]
    assert abs(centre[0] - 320) < 40
    assert abs(centre[1] - 240) < 80


def test_positive_pan_turns_the_view_to_the_left() -> None:
    rig = make_rig(CLEAN)
    ahead = rig.world_T_cam(0.0, 880.0)
    turned = rig.world_T_cam(0.1, 880.0)
    left = -ahead[:3, 0]
    assert turned[:3, 2] @ left > 0.09
    assert ahead[2, 2] < 0  # tilted down


def test_positive_roll_turns_the_camera_clockwise_seen_from_behind() -> None:
    rig = replace(make_rig(CLEAN), roll_rad=0.1)
    right = rig.world_T_cam(0.0, 880.0)[:3, 0]
    assert right[2] < -0.09  # what was its right points down


def test_the_projection_centre_circles_the_axis() -> None:
    config = replace(CLEAN, axis_beside_m=0.003, axis_behind_m=0.005)
    rig = make_rig(config)
    centres = np.array([rig.world_T_cam(pan, 880.0)[:3, 3] for pan in np.linspace(0, 2 * np.pi, 13)[:-1]])
    np.testing.assert_allclose(centres[0], rig.world_T_head[:3, 3], atol=1e-12)
    axis = centres.mean(axis=0)
    np.testing.assert_allclose(np.linalg.norm(centres - axis, axis=1), np.hypot(0.003, 0.005), atol=1e-9)
    offset = rig.world_T_head[:3, :3].T @ (axis - rig.world_T_head[:3, 3])
    np.testing.assert_allclose(offset[[0, 2]], [-0.005, 0.0], atol=1e-9)
    assert abs(offset[1]) == pytest.approx(0.003, abs=1e-9)


def test_the_projection_centre_travels_along_the_optical_axis() -> None:
    rig = make_rig(replace(CLEAN, centre_travel_m=0.005))
    wide, long = (rig.world_T_cam(0.3, 880 * zoom) for zoom in (0.7, 3.0))
    np.testing.assert_allclose(long[:3, 3] - wide[:3, 3], 0.005 * wide[:3, 2], atol=1e-12)
    np.testing.assert_allclose(rig.world_T_cam(0.0, 880.0)[:3, 3], rig.world_T_head[:3, 3], atol=1e-12)


def test_distortion_is_linear_in_log_focal() -> None:
    rig = make_rig()
    assert rig.k1(880 * 0.7) == pytest.approx(-0.08)
    assert rig.k1(880 * 3.0) == pytest.approx(0.02)
    assert rig.k1(880 * np.sqrt(0.7 * 3.0)) == pytest.approx(-0.03)


def test_effects_of_size_zero_are_exactly_absent() -> None:
    rig = make_rig(CLEAN)
    assert rig.k1(700.0) == 0.0
    np.testing.assert_array_equal(rig.principal_px, [319.5, 239.5])
    assert (vignette(rig) == 1.0).all()
    plate = plate_for(rig, 700.0)
    assert plate.size(1.0) == (640, 480)
    picture = np.random.default_rng(0).integers(0, 255, (480, 640, 3), dtype=np.uint8)
    seen = through_lens(picture[::-1], [lens_maps(rig, plate, 700.0, 1.0)], rig)
    np.testing.assert_array_equal(seen, picture)
    np.testing.assert_allclose(rig.world_T_cam(0.7, 700.0)[:3, 3], rig.world_T_cam(0.0, 1900.0)[:3, 3], atol=1e-12)
    np.testing.assert_allclose(rig.world_T_head[:3, 2], [0, 0, 1], atol=1e-12)


@pytest.mark.parametrize("zoom", ZOOMS)
@pytest.mark.parametrize(("scale", "turned_rad"), [(1.0, 0.0), (1.5, 0.0), (2.0, 0.0), (2.0, 0.2), (1.5, -0.4)])
def test_the_maps_invert_the_distortion_and_stay_on_the_plate(zoom: float, scale: float, turned_rad: float) -> None:
    rig = make_rig()
    focal_px = 880 * zoom
    plate = plate_for(rig, focal_px, turned_rad)
    columns, rows = lens_maps(rig, plate, focal_px, scale)
    width, height = plate.size(scale)
    assert columns.shape == (round(480 * scale), round(640 * scale))
    assert columns.min() >= -0.5
    assert columns.max() <= width - 0.5
    assert rows.min() >= -0.5
    assert rows.max() <= height - 0.5
    v, u = np.mgrid[: columns.shape[0], : columns.shape[1]]
    x = (columns - (width - 1) / 2) / (focal_px * scale)
    y = ((height - 1) / 2 - rows) / (focal_px * scale)
    cos, sin = np.cos(turned_rad), np.sin(turned_rad)
    x, y = cos * x - sin * y, sin * x + cos * y
    bend = 1 + rig.k1(focal_px) * (x**2 + y**2)
    np.testing.assert_allclose(rig.principal_px[0] + focal_px * bend * x, (u + 0.5) / scale - 0.5, atol=0.006)
    np.testing.assert_allclose(rig.principal_px[1] + focal_px * bend * y, (v + 0.5) / scale - 0.5, atol=0.006)


def test_vignetting_reaches_its_size_in_the_corners() -> None:
    shade = vignette(make_rig(replace(CLEAN, vignetting=0.8)))
    assert shade.shape == (480, 640, 1)
    assert shade[0, 0, 0] == pytest.approx(0.8, abs=0.002)
    assert shade[240, 320, 0] == pytest.approx(1.0, abs=1e-4)
    assert shade[240, 0, 0] == pytest.approx(1 - 0.2 * 0.64, abs=0.002)


def test_mujoco_sees_points_where_the_formulas_put_them() -> None:
    rig = make_rig(width=320)
    rng = np.random.default_rng(0)
    forward = rig.world_T_head[:3, 0]
    points = rig.world_T_head[:3, 3] + 9 * forward + rng.uniform([-2, -2, -1.2], [2, 2, 0.2], (12, 3))
    spec = mujoco.MjSpec()
    spec.visual.headlight.ambient = [1, 1, 1]
    spec.visual.headlight.diffuse = [0, 0, 0]
    spec.stat.extent = 10.0
    for point in points:
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.03, 0, 0], pos=point, rgba=[1, 1, 1, 1])
    stage = Stage(spec, 1000, 800, athlete_group=1, object_group=3)
    errors = []
    for zoom, pan_rad in ((0.7, 0.0), (1.0, 0.05), (1.6, -0.03)):
        focal_px = rig.reference_focal_px * zoom
        plate = plate_for(rig, focal_px)
        stage.aim(rig.world_T_cam(pan_rad, focal_px), plate.vertical_view_deg(focal_px))
        image = through_lens(
            stage.picture(plate.size(2.0), athlete=True), [lens_maps(rig, plate, focal_px, 2.0)], rig
        )  # fmt: skip
        _, _, _, centroids = cv2.connectedComponentsWithStats((image[..., 0] > 0).astype(np.uint8))
        weights = image[..., 0].astype(float)
        for u, v in project(rig, pan_rad, focal_px, points):
            near = centroids[np.argmin(np.hypot(*(centroids - [u, v]).T))]
            if np.hypot(*(near - [u, v])) > 2 or not (8 < u < 312 and 8 < v < 232):
                continue
            x, y = round(u), round(v)
            window = weights[y - 7 : y + 8, x - 7 : x + 8]
            if window[[0, -1]].any() or window[:, [0, -1]].any():
                continue  # a neighbour is too close
            rows, columns = np.mgrid[y - 7 : y + 8, x - 7 : x + 8]
            errors.append([(window * columns).sum() / window.sum() - u, (window * rows).sum() / window.sum() - v])
    stage.close()
    assert len(errors) > 15
    assert np.abs(np.mean(errors, axis=0)).max() < 0.03
    assert np.abs(errors).max() < 0.15


BEYOND = OpticsConfig(k2=0.05, p1=0.001)


def seen_by_opencv(rig: Rig, world_T_cam: Array, focal_px: float, points_m: Array) -> Array:
    """(N, 2) pixels, by OpenCV's own program."""
    cam_T_world = np.linalg.inv(world_T_cam)
    turn, _ = cv2.Rodrigues(cam_T_world[:3, :3])
    inside = np.array([[focal_px, 0, rig.principal_px[0]], [0, focal_px, rig.principal_px[1]], [0, 0, 1]])
    lens = np.array([rig.k1(focal_px), rig.config.k2, rig.config.p1, 0.0])
    return np.asarray(cv2.projectPoints(points_m, turn, cam_T_world[:3, 3], inside, lens)[0][:, 0])


@pytest.mark.parametrize("zoom", ZOOMS)
def test_the_lens_beyond_k1_is_that_of_opencv(zoom: float) -> None:
    rig = make_rig(BEYOND)
    focal_px = 880 * zoom
    world_T_cam = rig.world_T_cam(0.1, focal_px)
    rng = np.random.default_rng(0)
    points_m = np.column_stack([rng.uniform(-0.36, 0.36, (50, 2)) * 880 / focal_px, np.ones(50)]) * 9.0
    points_m = world_T_cam[:3, 3] + points_m @ world_T_cam[:3, :3].T
    seen, depth = rig.project(world_T_cam, focal_px, points_m)
    np.testing.assert_allclose(depth, 9.0)
    np.testing.assert_allclose(seen, seen_by_opencv(rig, world_T_cam, focal_px, points_m), atol=1e-9)
    assert np.abs(seen - project(rig, 0.1, focal_px, points_m)).max() > 0.05


@pytest.mark.parametrize("zoom", ZOOMS)
@pytest.mark.parametrize("stretch", [1.0, 1.0012])
def test_the_maps_invert_the_lens_beyond_k1(zoom: float, stretch: float) -> None:
    rig = make_rig(replace(BEYOND, lateral_colour_px=0.5))
    focal_px = 880 * zoom
    plate = plate_for(rig, focal_px)
    columns, rows = lens_maps(rig, plate, focal_px, 1.0, stretch)
    width, height = plate.size(1.0)
    assert min(columns.min(), rows.min()) >= -0.5
    assert columns.max() <= width - 0.5
    assert rows.max() <= height - 0.5
    v, u = (axis.ravel()[::97] for axis in np.mgrid[:480, :640])
    x, y = columns[v, u] - (width - 1) / 2, (height - 1) / 2 - rows[v, u]
    ahead = np.column_stack([x, y, np.full(len(x), focal_px)])
    green, _ = rig.project(np.eye(4), focal_px, ahead)
    seen = rig.principal_px + stretch * (green - rig.principal_px)
    np.testing.assert_allclose(seen, np.column_stack([u, v]), atol=0.006)


def test_lateral_colour_parts_red_from_blue_in_the_corners() -> None:
    rig = make_rig(replace(CLEAN, lateral_colour_px=0.5))
    assert np.diff(rig.stretches) == pytest.approx([-0.00125, -0.00125])
    assert rig.stretches @ np.array([0.299, 0.587, 0.114]) == pytest.approx(1.0, abs=1e-9)  # in white light
    plate = plate_for(rig, 880.0)
    maps = [lens_maps(rig, plate, 880.0, 1.0, stretch) for stretch in rig.stretches]
    width, height = plate.size(1.0)
    v, u = np.mgrid[:height, :width]
    wave = (127 + 100 * np.sin(np.hypot(u - (width - 1) / 2, v - (height - 1) / 2) / 6)).astype(np.uint8)
    seen = through_lens(np.dstack([wave] * 3), maps, rig).astype(float)
    red, green, blue = (seen[30:60, 30:60, k] for k in range(3))
    outward = np.gradient(green)
    slope = np.sqrt(0.5) * -(outward[0] + outward[1]) + 1e-9  # to the upper left, roughly
    assert np.mean((green - red) * slope) / np.mean(slope**2) == pytest.approx(0.43, abs=0.12)
    assert np.mean((green - blue) * slope) / np.mean(slope**2) == pytest.approx(-0.43, abs=0.12)
    np.testing.assert_array_equal(through_lens(wave, maps, rig), seen[..., 1])  # a mask is green


def test_many_rotations_at_once_are_those_of_each() -> None:
    rig = make_rig()
    angles = np.random.default_rng(0).normal(0, 0.3, (3, 5))
    each = [rig.world_T_cam(pan, 700.0, raised, rolled)[:3, :3] for pan, raised, rolled in angles.T.tolist()]
    np.testing.assert_allclose(rig.turns(*angles), each, atol=1e-12)
