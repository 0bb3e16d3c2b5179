"""The pose from the markers' grey values: on pictures drawn here, by sampling each pixel finely, with noise."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pzcap.calibration import marker_pose, reference_camera
from pzcap.calibration.reference_camera import ReferenceConfig
from pzcap.calibration.tuning import MARKERS
from pzcap.types import Array, Camera, Image, ReferenceCamera
from tests.scenes import synthetic

pytestmark = pytest.mark.xdist_group("marker_pose")  # pictures are drawn once
CONFIG = ReferenceConfig()
OBJECT = synthetic.calibration_object()
FINE = 8  # samples along a pixel's side
BOARD = 720  # pixels to the metre of a drawn board: about one a sample, so that none falls between two
PAPER, INK, ELSEWHERE = 205.0, 28.0, 120.0
BLUR_PX = 0.35
NOISE = 2.0


def camera_at(number: int) -> Camera:
    """A camera some 8 m from the object; lens and pose depend on ``number``."""
    rng = np.random.default_rng(number)
    world_T_cam = np.eye(4)
    forward = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0.0]])
    world_T_cam[:3, :3] = Rotation.from_rotvec(rng.uniform(-0.04, 0.04, 3)).as_matrix() @ forward
    world_T_cam[:3, 3] = rng.uniform(-0.4, 0.4, 3) - np.array([0.0, 0.0, 0.5])
    return Camera(640, 480, world_T_cam, 880.0, np.array([319.5, 239.5]) + rng.uniform(-4, 4, 2), -0.05)


@lru_cache(maxsize=4)
def drawn(number: int) -> Array:
    """(480, 640) what `camera_at` sees: blurred light, shaded, without noise. Reads the boards at points, no more."""
    camera = camera_at(number)
    u = np.arange(640 * FINE).reshape(1, -1) / FINE + 0.5 / FINE - 0.5
    v = np.arange(480 * FINE).reshape(-1, 1) / FINE + 0.5 / FINE - 0.5
    fine = np.full((480 * FINE, 640 * FINE), ELSEWHERE, np.float32)
    corners = np.concatenate([marker.corners_m for marker in OBJECT.markers])
    seen = (corners - camera.world_T_cam[:3, 3]) @ camera.world_T_cam[:3, :3]
    around = camera.principal_px + camera.focal_px * seen[:, :2] / seen[:, 2:]
    (left, top), (right, bottom) = (np.floor(around.min(0)) - 20).astype(int), (np.ceil(around.max(0)) + 20).astype(int)
    window = np.s_[top * FINE : bottom * FINE, left * FINE : right * FINE]
    bent_x = (u[:, window[1]] - camera.principal_px[0]) / camera.focal_px
    bent_y = (v[window[0]] - camera.principal_px[1]) / camera.focal_px
    factor: Array | float = 1.0
    for _ in range(6):
        factor = 1.0 + camera.k1 * (bent_x**2 + bent_y**2) / np.square(factor)
    directions = np.stack([bent_x / factor, bent_y / factor, np.ones_like(bent_x + bent_y)], axis=-1)
    directions = directions @ camera.world_T_cam[:3, :3].T
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    for face, (corner, along) in enumerate(synthetic._faces()):
        board = np.full((2 * BOARD, 2 * BOARD), PAPER, np.float32)
        for i in range(9):
            tile = cv2.aruco.generateImageMarker(dictionary, 9 * face + i, 6).repeat(BOARD // 12, 0)
            x, y = round((0.15 + 0.6 * (i % 3)) * BOARD), round((0.15 + 0.6 * (i // 3)) * BOARD)
            board[y : y + BOARD // 2, x : x + BOARD // 2] = np.where(tile.repeat(BOARD // 12, 1) > 0, PAPER, INK)
        offset = corner - camera.world_T_cam[:3, 3]
        normal = np.cross(along, [0, 0, -1.0])
        met = directions * ((offset @ normal) / (directions @ normal))[..., None] - offset
        x, y = met @ along, met @ np.array([0, 0, -1.0])
        inside = (np.abs(x - 1.0) < 1.0) & (np.abs(y - 1.0) < 1.0)
        places = ((BOARD * axis[inside] - 0.5).astype(np.float32).reshape(-1, 1) for axis in (x, y))
        # OpenCV takes no more than 32767 rows at once
        read = [
            cv2.remap(board, *part, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            for part in zip(*(np.array_split(place, 200) for place in places), strict=True)
        ]
        fine[window][inside] = np.concatenate(read).ravel()
    fine = cv2.GaussianBlur(fine, (0, 0), BLUR_PX * FINE)
    image = fine.reshape(480, FINE, 640, FINE).mean(axis=(1, 3), dtype=np.float64)
    return image * (1.0 - 0.15 * ((np.arange(640) - 250) / 400) ** 2) * (1.0 + 2e-4 * (np.arange(480)[:, None] - 240))


def taken(light: Array, seed: int) -> Image:
    """(480, 640, 3) 8-bit, with noise."""
    noise = np.random.default_rng(seed).normal(0, NOISE, (*light.shape, 3))
    return np.clip(np.rint(light[..., None] + noise), 0, 255).astype(np.uint8)


def by_corners(image: Image, truth: Camera) -> ReferenceCamera:
    found = reference_camera.detect(image, OBJECT)
    return reference_camera.fit(truth, found.points_m, found.points_px, CONFIG, free_lens=False)


def error(camera: Camera, truth: Camera) -> Array:
    """(6,) the step of `moved` from ``camera`` to the truth."""
    turn = truth.world_T_cam[:3, :3].T @ camera.world_T_cam[:3, :3]
    shift = truth.world_T_cam[:3, :3].T @ (camera.world_T_cam[:3, 3] - truth.world_T_cam[:3, 3])
    return np.concatenate([Rotation.from_matrix(turn).as_rotvec(), shift])


def test_derivatives_match_finite_differences() -> None:
    camera = camera_at(0)
    image = taken(drawn(0), 0)
    blur_px2 = np.array([0.15, 0.25])
    for patch in marker_pose.cut(camera, image, OBJECT, [2, 13]):
        weight = np.ones(len(patch.grey))
        _, jacobian, slope = marker_pose.linearise(camera, patch, blur_px2, weight)
        shading = np.linalg.lstsq(jacobian[:, 8:], patch.grey, rcond=None)[0]

        def predicted(step: Array, blur: Array, patch=patch, weight=weight, shading=shading) -> Array:
            return marker_pose.linearise(marker_pose.moved(camera, step), patch, blur, weight)[1][:, 8:] @ shading

        for column in range(8):
            h = 1e-5 * np.eye(8)[column]
            ahead, behind = (predicted(s * h[:6], blur_px2 + s * h[6:]) for s in (1, -1))
            size = np.abs(jacobian[:, column]).max()
            np.testing.assert_allclose(
                jacobian[:, column], (ahead - behind) / 2e-5, atol=1e-2 * size
            )  # pixels' footprints change with the pose, too
        assert slope.max() > 50  # grey levels a pixel: an edge


def test_the_pose_is_twice_as_good_as_the_corners_and_as_good_as_it_says() -> None:
    corners, whole, surprise = [], [], []
    for number in range(3):
        truth = camera_at(number)
        for seed in range(4):
            image = taken(drawn(number), seed)
            start = by_corners(image, truth)
            found = marker_pose.fit_pose(start.camera, image, OBJECT, range(18))
            assert found is not None
            corners.append(np.linalg.norm(error(start.camera, truth)[3:]))
            missed = error(found.camera, truth)
            whole.append(np.linalg.norm(missed[3:]))
            surprise.append(missed @ np.linalg.solve(found.covariance, missed))
    assert np.sqrt(np.mean(np.square(whole))) < np.sqrt(np.mean(np.square(corners))) / 2
    assert max(whole) < 3e-4
    assert 2.0 < np.mean(surprise) < 12.0  # of six parameters


def test_what_covers_or_outshines_a_marker_does_not_pull(monkeypatch: pytest.MonkeyPatch) -> None:
    truth = camera_at(0)
    light = drawn(0).copy()
    clean = marker_pose.fit_pose(truth, taken(light, 3), OBJECT, range(18))
    centres = [camera_pixels(truth, OBJECT.markers[k].corners_m).mean(axis=0) for k in (4, 12)]
    (u, v), at = centres[0].astype(int), np.mgrid[:480, :640]
    light[v - 30 : v + 30, u - 4 : u + 30] = 90.0  # somebody's arm over half a marker
    light += 90.0 * np.exp(-((at[1] - centres[1][0]) ** 2 + (at[0] - centres[1][1]) ** 2) / 2 / 8.0**2)  # a lamp
    found = marker_pose.fit_pose(truth, taken(light, 3), OBJECT, range(18))
    assert clean is not None
    assert found is not None
    assert np.linalg.norm(error(found.camera, truth)[3:]) < 4e-4
    pulled = np.linalg.norm(error(found.camera, clean.camera)[3:])
    assert pulled < 2e-4
    monkeypatch.setattr(marker_pose, "_weigh", lambda scaled, tight: np.ones_like(scaled))  # noqa: ARG005
    trusting = marker_pose.fit_pose(truth, taken(light, 3), OBJECT, range(18))
    assert trusting is None or np.linalg.norm(error(trusting.camera, clean.camera)[3:]) > 5 * pulled


def camera_pixels(camera: Camera, points_m: Array) -> Array:
    seen = (points_m - camera.world_T_cam[:3, 3]) @ camera.world_T_cam[:3, :3]
    return camera.principal_px + camera.focal_px * seen[:, :2] / seen[:, 2:]


def test_the_corners_decide_where_the_grey_values_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    truth = camera_at(0)
    image = taken(drawn(0), 5)
    start = by_corners(image, truth)
    better = reference_camera.resolve(start, truth, image, OBJECT, CONFIG)
    assert np.linalg.norm(error(better.camera, truth)) < 0.5 * np.linalg.norm(error(start.camera, truth))
    seen = camera_pixels_bent(better.camera, better.points_m)
    np.testing.assert_allclose(better.residuals_px, better.points_px - seen, atol=1e-9)

    # corners that are all a third of a pixel off: one of the two is wrong, and nobody knows which
    shifted = replace(start, points_px=start.points_px + np.array([0.33, 0.0]))
    kept = reference_camera.resolve(shifted, truth, image, OBJECT, CONFIG)
    expected = reference_camera.fit(start.camera, shifted.points_m, shifted.points_px, CONFIG, free_lens=False)
    np.testing.assert_allclose(kept.camera.world_T_cam, expected.camera.world_T_cam, atol=1e-6)

    monkeypatch.setattr(marker_pose, "MARKERS", MARKERS._replace(steps=3))  # no time to converge
    kept = reference_camera.resolve(start, truth, image, OBJECT, CONFIG)
    expected = reference_camera.fit(start.camera, start.points_m, start.points_px, CONFIG, free_lens=False)
    np.testing.assert_allclose(kept.camera.world_T_cam, expected.camera.world_T_cam, atol=1e-6)


def camera_pixels_bent(camera: Camera, points_m: Array) -> Array:
    seen = (points_m - camera.world_T_cam[:3, 3]) @ camera.world_T_cam[:3, :3]
    xy = seen[:, :2] / seen[:, 2:]
    return camera.principal_px + camera.focal_px * (1 + camera.k1 * np.sum(xy**2, axis=1, keepdims=True)) * xy


@pytest.mark.parametrize("identity", [3, 30])
def test_a_pattern_of_the_hall_that_passes_for_a_marker_is_left_out(identity: int) -> None:
    truth = camera_at(0)
    light = drawn(0).copy()
    tile = cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50), identity, 36)
    light[16:72, 16:72] = PAPER
    light[26:62, 26:62] = np.where(tile > 0, PAPER, INK)
    found = reference_camera.detect(taken(light, 1), OBJECT)
    assert found.ids == reference_camera.detect(taken(drawn(0), 1), OBJECT).ids
    assert np.abs(found.points_px - camera_pixels_bent(truth, found.points_m)).max() < 0.3
