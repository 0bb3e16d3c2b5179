"""Forecast of a check, and what it says of the athlete's size: their parts, on drawn material."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from pzcap.calibration.features import Features
from pzcap.command.check import body_check
from pzcap.command.check.body_check import Seen, judged
from pzcap.command.check.findings import Level
from pzcap.command.check.forecast import (
    CameraForecast,
    Forecast,
    Shutter,
    bound,
    findings,
    forecast_camera,
    joints_mm,
    noise,
)
from pzcap.command.check.motion_check import Places, row_flicker
from pzcap.command.check.views import Relation, View

FOCAL = 500.0


def wall(seed: int = 0, sigma: float = 2.0, blur: float = 2.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    clean = cv2.GaussianBlur(rng.uniform(0, 255, (240, 320)).astype(np.float32), (0, 0), blur)
    clean = 128 + 40 * (clean - clean.mean()) / clean.std()
    return np.clip(clean + sigma * rng.normal(size=clean.shape), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("sigma", [1.5, 4.0, 8.0])
def test_noise_is_told_from_texture(sigma: float) -> None:
    assert noise(wall(sigma=sigma, blur=4.0)) == pytest.approx(sigma, rel=0.15)


def test_the_bound_is_what_least_squares_reach() -> None:
    """Two noisy pictures of one wall, one pan apart: the scatter of the fitted pan against the bound."""
    clean = wall(sigma=0.0, blur=4.0).astype(np.float64)
    rng, sigma = np.random.default_rng(3), 4.0
    slope = np.gradient(clean, axis=1)
    found = []
    for _ in range(200):
        noisy = clean + sigma * rng.normal(size=clean.shape)
        columns = np.arange(320) - 159.5
        along = (FOCAL + columns**2 / FOCAL) * slope
        found.append(float((along * (noisy - clean)).sum() / (along * along).sum()))
    picture = np.clip(clean + sigma * rng.normal(size=clean.shape), 0, 255).astype(np.uint8)
    assert np.sqrt(bound(picture, FOCAL)[0, 0]) == pytest.approx(np.std(found), rel=0.35)


def camera(**changes: object) -> CameraForecast:
    given = {
        "images": [wall(k) for k in range(3)], "focal_px": np.full(3, FOCAL), "pan_rad": np.array([-0.2, 0.0, 0.2]),
        "distance_m": 12.0, "reference_px": FOCAL, "span_rad": None, "zoomed": True, "shutter": Shutter(),
    }  # fmt: skip
    return forecast_camera(**(given | changes))  # type: ignore[arg-type]


def test_what_is_missing_costs_accuracy_and_is_named() -> None:
    whole = camera()
    short = camera(span_rad=np.deg2rad(60.0))
    assert short.log_focal > 2 * whole.log_focal
    assert short.pan_rad > 1.2 * whole.pan_rad
    assert any("a sweep of 60 degrees" in each for each in short.limits)
    bare = camera(zoomed=False, focal_px=np.full(3, 2.0 * FOCAL))
    assert bare.log_focal > whole.log_focal
    assert any("no zoom run" in each for each in bare.limits)
    assert camera(images=[wall(k, sigma=25.0) for k in range(3)]).pan_rad > whole.pan_rad


def test_shutters_cost_accuracy_and_are_named() -> None:
    whole, fields = camera(), camera(shutter=Shutter(interlaced=True))
    lit, both = camera(shutter=Shutter(banded=True)), camera(shutter=Shutter(interlaced=True, banded=True))
    assert whole.pan_rad < fields.pan_rad < lit.pan_rad < both.pan_rad
    assert whole.log_focal < fields.log_focal < lit.log_focal < both.log_focal
    assert any("interlaced" in each for each in fields.limits)
    assert any("bands of light" in each for each in both.limits)


def test_bands_of_light_are_told_from_a_lamp_that_flickers_and_a_camera_that_turns() -> None:
    """Bands that wander over the picture, by 20 %; the whole picture 20 % brighter and darker; a pan."""
    hall = cv2.GaussianBlur(np.random.default_rng(0).uniform(0, 255, (240, 500)).astype(np.float32), (0, 0), 2.0)
    still = 110 + 3 * (hall - hall.mean())
    panned = [still[:, 8 * k : 8 * k + 320] for k in range(8)]
    bands = [1 + 0.2 * np.sin(np.arange(240) / 30 + 2.1 * k)[:, None] for k in range(8)]

    def flicker(pictures: list[np.ndarray]) -> float:
        return row_flicker([np.clip(each, 0, 255).astype(np.uint8) for each in pictures])

    assert flicker(panned) < 0.02
    assert flicker([each * (1 + 0.2 * (-1) ** k) for k, each in enumerate(panned)]) < 0.02
    assert flicker([each * band for each, band in zip(panned, bands, strict=True)]) > 0.1
    assert flicker(panned[:1]) == 0.0


def test_joints_get_worse_with_pixels_cameras_and_keyframes() -> None:
    near, far = camera(distance_m=6.0), camera(distance_m=18.0)
    assert joints_mm([near] * 4, 1.0, 0.0) < joints_mm([far] * 4, 1.0, 0.0) < joints_mm([far] * 2, 1.0, 0.0)
    assert joints_mm([far] * 4, 1.0, 0.0) < joints_mm([far] * 4, 3.0, 0.0)
    assert joints_mm([near] * 4, 1.0, 0.03) == pytest.approx(np.hypot(joints_mm([near] * 4, 1.0, 0.0), 15.0))
    [*_, last] = findings(Forecast({"1": far, "2": far}, 3.0))
    assert last.line().startswith("look   forecast: joints to ")
    assert "a keyframe every 3.0 s only, tight clothes" in last.text
    [*_, dressed] = findings(Forecast({"1": far, "2": far}, 3.0, loose_m=0.02))
    assert "clothes 20 mm off the skin" in dressed.text
    assert len(list(findings(Forecast({"1": far}, 1.0)))) == 1  # one camera alone follows no body


def test_cameras_that_nothing_places_have_a_forecast_and_joints_have_none() -> None:
    anywhere = camera(distance_m=None)
    assert anywhere.pan_rad == camera().pan_rad
    assert [each.camera for each in findings(Forecast({"1": anywhere, "2": anywhere}, 1.0))] == ["1", "2"]


def test_a_silhouette_is_found_at_its_size() -> None:
    """A figure drawn a tenth larger than expected, beside where it is expected, among clutter."""
    points = np.array([[0, 0], [30, 0], [30, 120], [0, 120], [12, 40], [60, 45], [12, 55]], float)
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6]])
    changed = np.zeros((300, 400), np.uint8)
    for corners in np.round(1.1 * points[faces] + [150, 90]).astype(np.int32):
        cv2.fillConvexPoly(changed, corners, 255)
    changed[np.random.default_rng(0).uniform(size=changed.shape) < 0.02] = 255
    found = body_check._covered(changed, points + np.array([140, 100]), faces, 120.0)
    assert found is not None
    assert found.ratio == pytest.approx(1.1, abs=0.021)
    assert found.away < 0.15
    assert body_check._covered(np.zeros_like(changed), points + np.array([140, 100]), faces, 120.0) is None


@pytest.mark.parametrize(
    ("ratio", "away", "level", "says"),
    [
        (0.99, 0.1, Level.OK, "looks 0.99 times"),
        (1.12, 0.1, Level.WARN, "looks 1.12 times as large as subject.json makes them; is it of another person"),
        (1.0, 0.7, Level.FAIL, "stands 0.7 body heights from where the keyframes put them"),
    ],
)
def test_the_athlete_is_judged_by_most_pictures(ratio: float, away: float, level: Level, says: str) -> None:
    [found] = judged([Seen(ratio, away)] * 5 + [Seen(0.7, 1.0)])
    assert found.level is level
    assert says in found.text
    assert list(judged([Seen(ratio, away)] * 3)) == []  # too few to say


def test_rows_lit_otherwise_are_not_taken_for_the_athlete() -> None:
    """The empty hall and a darker square, under bands of light: the square is what differs."""
    hall = np.clip(wall(sigma=0.0), 40, 255)
    here = hall.copy()
    here[100:140, 150:190] = 10
    bands = 1 + 0.3 * np.sin(np.arange(240) / 40)[:, None]
    lit = np.clip(here * bands, 0, 255).astype(np.uint8)
    nothing = Features(np.empty((0, 2)), np.empty((0, 61), np.uint8), np.empty(0))
    changed = body_check._changed(View(lit, nothing), View(hall, nothing), Relation(100)) > 0
    assert changed[102:138, 152:188].mean() > 0.9
    changed[98:142, 148:192] = False
    assert changed.mean() < 0.03


def test_a_sign_on_the_wall_is_no_sweep_of_the_camera() -> None:
    """Seen from elsewhere it fits above or below the middle; the camera's own pictures lie level, however zoomed."""
    image = np.zeros((2, 2, 3), np.uint8)
    sign, own, wide = Relation(30, 0.2, 0.52, 2.1), Relation(20, 0.1, 0.02, 0.34), Relation(40, 0.0, -0.15, 2.0)
    places = Places((image,) * 3, (sign, own, wide), np.zeros(3))
    assert places.strength == 30.0
    assert places.level_strength == 20.0
