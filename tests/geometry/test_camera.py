"""The camera's mathematics: round trips, derivatives, conventions, and MuJoCo's own camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pzcap.geometry import camera as geometry
from pzcap.geometry.lens import Distortion
from pzcap.types import Array, Camera, Lens, PanZoomCamera

angles = st.floats(-3.2, 3.2)
views = st.builds(
    lambda pan, tilt, roll, log_zoom, x, y, *distortion: geometry.View(
        pan, tilt, roll, 880.0 * np.exp(log_zoom), np.array([320.0 + x, 240.0 + y]), Distortion(*distortion)
    ),
    angles, st.floats(-0.3, 0.3), st.floats(-0.1, 0.1), st.floats(-0.4, 1.2), st.floats(-9, 9), st.floats(-9, 9),
    st.floats(-0.1, 0.1), st.floats(-0.03, 0.03), st.floats(-0.005, 0.005), st.floats(-0.005, 0.005),
)  # fmt: skip
PIXELS = np.stack(np.meshgrid(np.linspace(0, 639, 7), np.linspace(0, 479, 5)), axis=-1).reshape(-1, 2)


def pan_zoom_camera() -> PanZoomCamera:
    lens = Lens(640, 480, 880.0, np.array([[322.0, 236.0], [1.5, -0.7]]), np.array([-0.03, 0.05, 0.01]))
    world_T_head = np.eye(4)
    world_T_head[:3, 3] = (-10.5, -8.0, 1.7)
    return PanZoomCamera(lens, world_T_head, np.deg2rad(-4), np.deg2rad(0.5))


@given(views)
def test_looking_and_seeing_are_inverse(view: geometry.View) -> None:
    azimuth, slope = geometry.pixel_to_direction(view, PIXELS)
    seen, front = geometry.direction_to_pixel(view, azimuth, slope)
    assert front.all()
    np.testing.assert_allclose(seen, PIXELS, atol=1e-6)


@settings(deadline=None)  # the first call compiles
@given(views)
def test_kernels_look_as_the_arrays_do(view: geometry.View) -> None:
    azimuth, slope = geometry.pixel_to_direction(view, PIXELS)
    seen = np.empty((2, geometry.SEEN))
    for n, (u, v) in enumerate(PIXELS):
        np.testing.assert_allclose(
            geometry.pixel_to_direction_kernel(view.vector(), u, v), [azimuth[n], slope[n]], atol=1e-9
        )
        geometry.direction_to_pixel_with_derivatives(view.vector(), azimuth[n], slope[n], seen)
        np.testing.assert_allclose(seen[:, 0], [u, v], atol=1e-6)


def moved(view: geometry.View, step: Array) -> geometry.View:
    """``view`` after adding ``step`` (7,) in the order of `geometry.PARAMETERS`."""
    pan, tilt, log_focal, roll, _, _, k1 = step
    return replace(
        view, pan_rad=view.pan_rad + pan, tilt_rad=view.tilt_rad + tilt, roll_rad=view.roll_rad + roll,
        focal_px=view.focal_px * np.exp(log_focal), principal_px=view.principal_px + step[4:6],
        distortion=view.distortion._replace(k1=view.distortion.k1 + k1),
    )  # fmt: skip


@settings(deadline=None)
@given(views, st.integers(0, 6))
def test_derivatives_match_finite_differences(view: geometry.View, which: int) -> None:
    azimuth, slope = geometry.pixel_to_direction(view, PIXELS)
    analytic, _ = geometry.derivatives(view, azimuth, slope)
    step = np.zeros(7)
    step[which] = 1e-6
    ahead, behind = moved(view, step), moved(view, -step)
    numeric = (
        geometry.direction_to_pixel(ahead, azimuth, slope)[0] - geometry.direction_to_pixel(behind, azimuth, slope)[0]
    ) / 2e-6
    np.testing.assert_allclose(analytic[:, :, which], numeric, rtol=1e-5, atol=1e-3)


@given(views)
def test_direction_derivatives_match_finite_differences(view: geometry.View) -> None:
    azimuth, slope = geometry.pixel_to_direction(view, PIXELS)
    _, analytic = geometry.derivatives(view, azimuth, slope)
    for column, (da, dh) in enumerate(((1e-6, 0.0), (0.0, 1e-6))):
        ahead = geometry.direction_to_pixel(view, azimuth + da, slope + dh)[0]
        numeric = (ahead - geometry.direction_to_pixel(view, azimuth - da, slope - dh)[0]) / 2e-6
        np.testing.assert_allclose(analytic[:, :, column], numeric, rtol=1e-5, atol=1e-3)


@given(st.floats(-0.4, 1.2), angles)
def test_pan_zoom_derivatives_carry_the_lens_along(log_zoom: float, pan: float) -> None:
    head = pan_zoom_camera()
    focal = 880.0 * np.exp(log_zoom)
    view = geometry.view_at(head, pan, head.tilt_rad, focal)
    azimuth, slope = geometry.pixel_to_direction(view, PIXELS)
    analytic = geometry.pan_zoom_derivatives(head, view, azimuth, slope)
    step = 1e-6
    for column, (d_pan, d_log, d_tilt) in enumerate(step * np.eye(3)):
        ahead = geometry.view_at(head, pan + d_pan, head.tilt_rad + d_tilt, focal * np.exp(d_log))
        behind = geometry.view_at(head, pan - d_pan, head.tilt_rad - d_tilt, focal * np.exp(-d_log))
        numeric = (
            geometry.direction_to_pixel(ahead, azimuth, slope)[0]
            - geometry.direction_to_pixel(behind, azimuth, slope)[0]
        ) / (2 * step)
        np.testing.assert_allclose(analytic[:, :, column], numeric, rtol=1e-5, atol=2e-3)


def test_positive_pan_turns_left_and_positive_tilt_up_and_positive_roll_clockwise() -> None:
    level = geometry.head_T_cam(0.0, 0.0, 0.0)[:3, :3]
    assert geometry.head_T_cam(0.1, 0.0, 0.0)[1, 2] > 0  # optical axis towards +y, left
    assert geometry.head_T_cam(0.0, 0.1, 0.0)[2, 2] > 0
    right = geometry.head_T_cam(0.0, 0.0, 0.1)[:3, 0]
    assert right @ level[:, 1] > 0  # the camera's right edge sinks


@given(angles, st.floats(-0.3, 0.3), st.floats(0.7, 3.0))
def test_directions_of_the_head_agree_with_world_points(pan: float, tilt: float, zoom: float) -> None:
    head = pan_zoom_camera()
    turned = PanZoomCamera(
        head.lens, head.world_T_head @ geometry.head_T_cam(0.7, 0.2, 0.1), head.tilt_rad, head.roll_rad
    )
    azimuth, slope = geometry.pixel_to_direction(geometry.view_at(turned, pan, tilt, 880.0 * zoom), PIXELS)
    in_head = np.column_stack([np.cos(azimuth), np.sin(azimuth), slope]) * 7.0
    points = in_head @ turned.world_T_head[:3, :3].T + turned.world_T_head[:3, 3]
    instant = geometry.at(turned, pan, tilt, 880.0 * zoom)
    px, depth = geometry.project(instant, points)
    assert (depth > 0).all()
    np.testing.assert_allclose(px, PIXELS, atol=1e-6)
    directions = geometry.rays(instant, PIXELS)
    expected = points - instant.world_T_cam[:3, 3]
    np.testing.assert_allclose(directions, expected / np.linalg.norm(expected, axis=1)[:, None], atol=1e-9)


def test_mounting_gives_back_the_reference_pose() -> None:
    head = pan_zoom_camera()
    reference = geometry.at(head, 0.0, head.tilt_rad, 880.0)
    again = geometry.mount(reference, replace(head, world_T_head=np.eye(4)))
    np.testing.assert_allclose(again.world_T_head, head.world_T_head, atol=1e-12)


def test_projection_agrees_with_mujoco() -> None:
    """MuJoCo's own camera matrix (its renderer's conventions) and ours take a point to the same pixel."""
    mujoco = pytest.importorskip("mujoco")
    spec = mujoco.MjSpec()
    spec.worldbody.add_camera(
        name="c", pos=(1.0, -2.0, 1.5), xyaxes=(0.8, 0.6, 0.0, -0.06, 0.08, 0.995), resolution=(640, 480),
        sensor_size=(0.0064, 0.0048), focal_length=(0.0088, 0.0088), principal_length=(0.00002, -0.00003),
    )  # fmt: skip
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_camlight(model, data)
    f_x, _, p_x, p_y = model.cam_intrinsic[0]
    s_x, s_y = model.cam_sensorsize[0]
    world_T_cam = np.eye(4)
    world_T_cam[:3, :3] = data.cam_xmat[0].reshape(3, 3) @ np.diag([1.0, -1.0, -1.0])
    world_T_cam[:3, 3] = data.cam_xpos[0]
    principal = np.array([320 - p_x / s_x * 640 - 0.5, 240 - p_y / s_y * 480 - 0.5])
    ours = Camera(640, 480, world_T_cam, f_x / s_x * 640, principal, 0.0)

    # the frustum that MuJoCo hands to its renderer
    scene = mujoco.MjvScene(model, maxgeom=10)
    view = mujoco.MjvCamera()
    view.type, view.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, 0
    mujoco.mjv_updateScene(model, data, mujoco.MjvOption(), None, view, mujoco.mjtCatBit.mjCAT_ALL, scene)
    gl = scene.camera[0]
    near, top, bottom = gl.frustum_near, gl.frustum_top, gl.frustum_bottom
    left, right = gl.frustum_center - gl.frustum_width, gl.frustum_center + gl.frustum_width
    points = np.random.default_rng(0).uniform((-1, -1, 2), (1, 1, 9), (50, 3)) @ world_T_cam[:3, :3].T
    points += world_T_cam[:3, 3]
    eye = (points - data.cam_xpos[0]) @ data.cam_xmat[0].reshape(3, 3)
    on_near = eye[:, :2] * (near / -eye[:, 2])[:, None]
    column = (on_near[:, 0] - left) / (right - left) * 640 - 0.5
    row = (top - on_near[:, 1]) / (top - bottom) * 480 - 0.5
    px, depth = geometry.project(ours, points)
    np.testing.assert_allclose(depth, -eye[:, 2], atol=1e-9)
    np.testing.assert_allclose(px, np.column_stack([column, row]), atol=1e-3)
