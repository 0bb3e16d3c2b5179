"""Rolling shutter: what each row shows is what the camera of the row's own time sees."""

from __future__ import annotations

from dataclasses import dataclass, replace

import mujoco
import numpy as np
import pytest

from pzcap.types import Array, Image, Indices, Pose, PzcapError
from sim.cameras.film import FilmCamera
from sim.cameras.operator import PanTiltZoom
from sim.cameras.optics import Rig
from sim.cameras.plate import Moment, fine_size, plate_under, roll, rolled_maps
from sim.cameras.render import Stage
from sim.cameras.sensor import SensorConfig, field_delay_s, row_delay_s
from tests.sim.test_optics import make_rig

READOUTS = (0.016, -0.025)
PAN_RATE, LOG_RATE, TILT_RATE, ROLL_RATE = np.deg2rad(60.0), 0.4, 0.05, -0.03
FRAME_S = 0.3


def moving(time_s: float) -> PanTiltZoom:
    """A camera that pans fast, zooms, and is shaken."""
    since = time_s - FRAME_S
    pan_rad = PAN_RATE * since + 40.0 * since**2
    return PanTiltZoom(pan_rad, 620.0 * float(np.exp(LOG_RATE * since)), TILT_RATE * since, ROLL_RATE * since)


def moment(rig: Rig, time_s: float) -> Moment:
    aim = moving(time_s)
    return Moment(rig.world_T_cam(*aim), aim.focal_px)


def rolled(rig: Rig, readout_s: float, points_m: Array, exposed_s: float = FRAME_S) -> Array:
    """Pixels (N, 2) of points in a frame, by fixed point: each is seen when the row is read that it is seen in."""
    pixels = np.full((len(points_m), 2), rig.height / 2)
    for _ in range(8):
        delays_s = row_delay_s(pixels[:, 1], rig.height, readout_s)
        cameras = [moment(rig, exposed_s + delay) for delay in delays_s.tolist()]
        pixels = np.array(
            [rig.project(*camera, point[None])[0][0] for camera, point in zip(cameras, points_m, strict=True)]
        )
    return pixels


@pytest.mark.parametrize("readout_s", READOUTS)
@pytest.mark.parametrize(("scale", "turned_rad"), [(1.5, 0.0), (2.0, 0.2)])
@pytest.mark.parametrize("rows", [(0, 1.0), (0.31, 0.47)])
def test_the_maps_are_of_the_camera_of_the_rows_time(
    readout_s: float, scale: float, turned_rad: float, rows: tuple[float, float]
) -> None:
    rig = make_rig()
    width, height = fine_size(rig, scale).tolist()
    part = range(*(int(share * height) for share in rows))
    plate_s = FRAME_S + 0.001

    def cameras_of(v: Array) -> tuple[Array, Array]:
        cameras = [moment(rig, FRAME_S + delay) for delay in row_delay_s(v, rig.height, readout_s).tolist()]
        turns = np.array([camera.world_T_cam[:3, :3] for camera in cameras])
        return turns, np.array([camera.focal_px for camera in cameras])

    camera = moment(rig, plate_s)
    piece = roll(rig, camera, cameras_of, part, turned_rad, scale)
    plate = plate_under([piece], turned_rad, scale)
    [(columns, lines)] = rolled_maps(piece, plate, scale, width)
    assert columns.shape == lines.shape == (len(part), width)
    plate_width, plate_height = plate.size(scale)
    assert min(columns.min(), lines.min()) >= -0.5
    assert columns.max() <= plate_width - 0.5
    assert lines.max() <= plate_height - 0.5
    assert (plate.height > 0.9 * rig.height) == (len(part) == height)

    rng = np.random.default_rng(1)
    row, column = rng.integers(0, len(part), 300), rng.integers(0, width, 300)
    x = (columns[row, column] - (plate_width - 1) / 2) / scale
    y = -(lines[row, column] - (plate_height - 1) / 2) / scale - plate.up_px
    cos, sin = np.cos(turned_rad), np.sin(turned_rad)
    rays = np.column_stack([cos * x - sin * y, sin * x + cos * y, np.full(300, camera.focal_px)])
    points_m = camera.world_T_cam[:3, 3] + 0.015 * rays @ camera.world_T_cam[:3, :3].T  # 15 m off
    seen = np.column_stack([column + 0.5, part.start + row + 0.5]) / scale - 0.5
    assert np.abs(rolled(rig, readout_s, points_m) - seen).max() < 0.02


def test_without_a_movement_the_rows_are_those_of_the_lens() -> None:
    """The readout alone moves nothing: a locked camera's picture of a still hall is as by a global shutter."""
    rig = make_rig(width=320)
    stage = pebbles(rig)
    locked = PanTiltZoom(0.02, rig.reference_focal_px * 1.2)
    config = SensorConfig(grid_turn_deg=0.0)
    pictures = [
        FilmCamera(stage, rig, replace(config, readout_s=readout_s)).instant(lambda _: locked, 0.0, None)
        for readout_s in (0.0, 0.02)
    ]
    stage.close()
    assert pictures[0].max() > 200
    assert np.abs(pictures[0].astype(int) - pictures[1]).max() <= 12  # of 255: plates of two sizes, edges of pebbles


@pytest.mark.parametrize("readout_s", READOUTS)
def test_the_picture_shows_points_where_the_rows_camera_sees_them(readout_s: float) -> None:
    rig = make_rig(width=320)
    stage = pebbles(rig)
    config = SensorConfig(readout_s=readout_s, shutter_s=0.0, supersampling=4.0)
    picture = FilmCamera(stage, rig, config).instant(moving, FRAME_S, None)
    stage.close()
    errors = off_by(picture, rolled(rig, readout_s, pebbles_m(rig)))
    assert len(errors) > 15
    assert np.abs(np.mean(errors, axis=0)).max() < 0.03
    assert np.abs(errors).max() < 0.15
    still = off_by(picture, rolled(rig, 0.0, pebbles_m(rig)))
    assert np.abs(still).max() > 1.0  # the effect is there


def test_an_open_shutter_is_the_mean_of_moments_of_the_same_rolling_frame() -> None:
    rig = make_rig(width=320)
    stage = pebbles(rig)
    open_s, readout_s = 0.004, 0.016
    config = SensorConfig(readout_s=readout_s, shutter_s=open_s, sub_exposures=2, supersampling=4.0)
    camera = FilmCamera(stage, rig, config)
    camera._pose = lambda *_: None  # type: ignore[method-assign]  # there is nobody in this hall
    blurred = camera.exposure(moving, FRAME_S, nobody)
    sharp = [camera._exposed(moving, FRAME_S + by, np.zeros(1), None, 3.0) for by in (-open_s / 4, open_s / 4)]
    stage.close()
    mean = np.mean(np.array(sharp, float), axis=0)
    assert np.abs(mean - sharp[0]).max() > 50
    assert np.percentile(np.abs(mean - blurred), 99) < 12
    assert np.abs((mean - blurred).mean()) < 0.05


@pytest.mark.parametrize("readout_s", [0.016, -0.016])
def test_a_body_moves_by_the_row_to_within_a_step(readout_s: float) -> None:
    """Of a pole that flies sideways past a locked camera, each row shows the place of its own time."""
    rows, seen, crossed = flying_pole(SensorConfig(readout_s=readout_s, shutter_s=0.0))
    delays_s = row_delay_s(rows.astype(float), crossed.height, readout_s)
    expected = crossed.expected_px(rows, delays_s)
    assert np.abs(seen - expected).max() < crossed.px_per_s * 3.3e-3 / 2 + 0.5
    slope = np.polyfit(delays_s, seen - expected, 1)[0]
    assert abs(slope) < 0.1 * crossed.px_per_s


def test_rows_of_woven_video_are_of_two_times() -> None:
    config = SensorConfig(field_s=1 / 60, shutter_s=0.0)
    rows, seen, crossed = flying_pole(config)
    expected = crossed.expected_px(rows, field_delay_s(rows.astype(float), config))
    comb = crossed.px_per_s / 60
    assert comb > 3.0
    assert np.abs(seen - expected).max() < 0.8
    teeth = np.diff(seen) * np.where(rows[:-1] % 2, -1.0, 1.0)
    assert teeth.mean() == pytest.approx(-comb, abs=0.4)  # to the left


def test_half_of_the_rows_is_of_the_frames_time_and_between_them_is_interpolated() -> None:
    config = SensorConfig(field_s=1 / 60, bob=True, shutter_s=0.0)
    rows, seen, crossed = flying_pole(config)
    assert not field_delay_s(rows.astype(float), config).any()
    assert np.abs(seen - crossed.expected_px(rows, np.zeros(len(rows)))).max() < 0.8
    picture = crossed.picture.astype(float)
    between = picture[1:-2:2] - (picture[:-3:2] + picture[2:-1:2]) / 2
    assert np.abs(between).max() <= 0.5


def test_a_field_without_another_is_refused() -> None:
    with pytest.raises(PzcapError, match="field_s"):
        SensorConfig(bob=True)


@dataclass(frozen=True)
class Pole:
    """What a locked camera sees of a pole that flies sideways."""

    rig: Rig
    picture: Image

    @property
    def height(self) -> int:
        return self.rig.height

    @property
    def px_per_s(self) -> float:
        return 5.0 / 9.0 * self.rig.reference_focal_px

    def expected_px(self, rows: Indices, delays_s: Array) -> Array:
        """Columns (N,) of the pole's axis in ``rows`` (N,) that are exposed so long after the frame (N,)."""
        focal_px = self.rig.reference_focal_px
        expected = []
        for v, delay_s in zip(rows.tolist(), delays_s.tolist(), strict=True):
            along = pole_m(self.rig, FRAME_S + delay_s) + np.linspace(1.5, -1.5, 200)[:, None] * [0.0, 0.0, 1.0]
            pixels, _ = self.rig.project(self.rig.world_T_cam(0.0, focal_px), focal_px, along)
            expected.append(np.interp(v, pixels[:, 1], pixels[:, 0]))
        return np.array(expected)


def pole_m(rig: Rig, time_s: float) -> Array:
    forward, left = rig.world_T_head[:3, 0], rig.world_T_head[:3, 1]
    return np.asarray(rig.world_T_head[:3, 3] + 9.0 * forward + 5.0 * (time_s - FRAME_S) * left)


def flying_pole(config: SensorConfig) -> tuple[Indices, Array, Pole]:
    """Rows (N,) that show the pole, the columns (N,) of its middle there, and the picture."""
    rig = make_rig(width=320)
    spec = mujoco.MjSpec()
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [1, 1, 1], [0, 0, 0]
    spec.stat.extent = 10.0
    body = spec.worldbody.add_body(name="pole")
    body.add_freejoint()
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.1, 0.1, 1.5], rgba=[1, 1, 1, 1], group=1)
    stage = Stage(spec, 800, 600, athlete_group=1, object_group=3)
    camera = FilmCamera(stage, rig, config)
    camera._pose = lambda _, t: stage.data.qpos.__setitem__(slice(0, 3), pole_m(rig, t))  # type: ignore[method-assign]
    picture = camera.exposure(lambda _: PanTiltZoom(0.0, rig.reference_focal_px), FRAME_S, nobody)
    stage.close()
    light = picture[..., 0].astype(float)
    rows = np.flatnonzero(light.max(axis=1) > 200)[5:-5]
    columns = np.arange(light.shape[1])
    return rows, light[rows] @ columns / light[rows].sum(axis=1), Pole(rig, picture)


def nobody(_: float) -> Pose:
    return Pose(np.zeros(3), np.tile([1.0, 0.0, 0.0, 0.0], (16, 1)))


def pebbles_m(rig: Rig) -> Array:
    """(N, 3) points spread over the picture, some ten metres off."""
    forward = rig.world_T_head[:3, 0]
    rng = np.random.default_rng(0)
    left, up = np.meshgrid(np.linspace(-2.1, 2.1, 7), np.linspace(-2.2, 0.6, 5))
    ahead = np.column_stack([rng.uniform(9.9, 10.1, left.size), left.ravel(), up.ravel()])
    ahead[:, 1:] += rng.uniform(-0.1, 0.1, (left.size, 2))
    axes = np.column_stack([forward, np.cross([0, 0, 1.0], forward), [0, 0, 1.0]])
    return np.asarray(rig.world_T_head[:3, 3] + ahead @ axes.T)


def pebbles(rig: Rig) -> Stage:
    """White balls at `pebbles_m`."""
    spec = mujoco.MjSpec()
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [1, 1, 1], [0, 0, 0]
    spec.stat.extent = 10.0
    for point in pebbles_m(rig):
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.04, 0, 0], pos=point, rgba=[1, 1, 1, 1])
    return Stage(spec, 400, 300, athlete_group=1, object_group=3)


def off_by(picture: Image, expected_px: Array) -> Array:
    """(N, 2) how far from ``expected_px`` the white balls stand that are well within the picture."""
    errors = []
    height, width = picture.shape[:2]
    for u, v in expected_px:
        x, y = round(u), round(v)
        if 12 < x < width - 12 and 12 < y < height - 12:
            window = picture[y - 9 : y + 10, x - 9 : x + 10, 0].astype(float)
            rows, columns = np.mgrid[y - 9 : y + 10, x - 9 : x + 10]
            errors.append([(window * columns).sum() / window.sum() - u, (window * rows).sum() / window.sum() - v])
    return np.array(errors)
