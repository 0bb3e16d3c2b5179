"""Forecast: how accurate pan, focal length and joints will be, from the footage alone, and what limits them.

A picture of the motion is laid to the panorama by its grey levels. The Cramer-Rao bound of that, with slopes ``g`` of
the picture and noise ``s``, is ``inverse(sum J' J / s^2)``, ``J = (f g_x, g . r)`` for pan and log focal. To this come
the floor that no footage has gone below, twice as high where rows are twice as far apart; the scale of a sweep that
does not come round; the distortion where there is no zoom run; and lamps whose light lies over it in bands. Joints
are known to a share of a pixel at the athlete, and no better than the body's own lengths and its clothes let them be.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from pzcap.calibration.settings import PanZoomConfig
from pzcap.command.check.findings import Finding, Level
from pzcap.command.check.tuning import FORECAST
from pzcap.types import Array, Image

_FAINT: Final = {"pan": 0.01, "focal": 0.1, "joints": 15.0}
"""Degrees, percent and millimetres from which on there is something to look at."""


@dataclass(frozen=True, slots=True, eq=False)
class CameraForecast:
    """Standard deviations of one camera over the motion, root mean squares."""

    pan_rad: float
    log_focal: float
    footprint_m: float | None  # of a pixel at the athlete; None: how far away that is nobody has measured
    limits: tuple[str, ...]  # what they come from, most important first


@dataclass(frozen=True, slots=True)
class Shutter:
    """Shutter of a camera: the order in which it exposes rows, and the light that they get."""

    interlaced: bool = False
    banded: bool = False  # its rows are lit differently, by lamps that flicker while it rolls


def forecast_camera(
    images: Sequence[Image], focal_px: Array, pan_rad: Array, distance_m: float | None, reference_px: float,
    span_rad: float | None, zoomed: bool, shutter: Shutter,
) -> CameraForecast:  # fmt: skip
    """Forecast of a camera from pictures of the motion at ``focal_px`` (N,) and ``pan_rad`` (N,) from the reference
    pose. ``reference_px``: focal length of the sweep; ``span_rad``: of a sweep that does not come round; ``zoomed``:
    there is a zoom run."""
    config = PanZoomConfig()
    height, width = images[0].shape[:2]
    bounds = np.array([bound(image, focal) for image, focal in zip(images, focal_px, strict=True)])
    pan, zoom = (FORECAST.worth * float(np.mean(bounds[:, k, k])) for k in range(2))
    parts = {"noise and bare walls": (pan, zoom)}
    floor = np.array([
        config.floor_px * max(1.0, FORECAST.coarse_px / width) / reference_px, config.floor_edge_px / (0.5 * width),
    ])  # fmt: skip
    if shutter.interlaced:
        parts["interlaced pictures, of half the rows"] = _squares(2.0 * floor)
    else:
        parts["what no footage has gone below"] = _squares(floor)
    if shutter.banded:
        parts["bands of light, by lamps that flicker while the shutter rolls"] = _squares(floor * FORECAST.bands)
    if span_rad is not None:
        scale = FORECAST.partial_scale * (np.deg2rad(120.0) / max(span_rad, 0.1)) ** FORECAST.partial_power
        parts[f"a sweep of {np.rad2deg(span_rad):.0f} degrees, which does not fix its scale"] = (
            float(np.mean((scale * pan_rad) ** 2)),
            scale**2,
        )
    if not zoomed:
        radius = (width**2 + height**2) / 12.0
        off = config.beliefs.k1 * np.abs(np.log(focal_px / reference_px)) * 1.4 * radius / focal_px**2
        parts["no zoom run, so that distortion passes for focal length"] = (0.0, float(np.mean(off**2)))
    total = np.sum(list(parts.values()), axis=0)
    order = sorted(parts, key=lambda name: -max(np.array(parts[name]) / total))
    limits = tuple(name for name in order if max(np.array(parts[name]) / total) > 0.25)
    footprint = None if distance_m is None else distance_m / float(np.median(focal_px))
    return CameraForecast(float(np.sqrt(total[0])), float(np.sqrt(total[1])), footprint, limits)


def _squares(sigmas: Array) -> tuple[float, float]:
    pan, zoom = np.square(sigmas).tolist()
    return pan, zoom


def bound(image: Image, focal_px: float) -> Array:
    """(2, 2) Cramer-Rao bound of pan and log focal of a picture, its noise taken from itself."""
    grey = (cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image).astype(np.float32)
    sigma = noise(grey)
    across, down = (
        cv2.Sobel(grey, cv2.CV_32F, *way, ksize=1, scale=0.5).astype(np.float64) for way in ((1, 0), (0, 1))
    )
    height, width = grey.shape
    rows, columns = np.mgrid[:height, :width]
    right, below = columns - (width - 1) / 2, rows - (height - 1) / 2
    pan = (focal_px + right**2 / focal_px) * across + right * below / focal_px * down
    zoom = right * across + below * down
    blank = sigma**2 / 2.0  # that noise alone makes of a slope, squared
    moved = focal_px**2 * blank * grey.size, blank * float((right**2 + below**2).sum())
    floor = 0.05
    information = np.array([
        [max(float((pan * pan).sum()) - moved[0], floor * float((pan * pan).sum())), float((pan * zoom).sum())],
        [float((pan * zoom).sum()), max(float((zoom * zoom).sum()) - moved[1], floor * float((zoom * zoom).sum()))],
    ])  # fmt: skip
    return np.asarray(np.linalg.pinv(information) * max(sigma, 0.5) ** 2)


def noise(grey: Array | Image | np.ndarray) -> float:
    """Standard deviation of the noise of a picture (H, W), by the median of its second differences (Immerkaer 1996)."""
    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
    return float(np.median(np.abs(cv2.filter2D(np.asarray(grey, np.float32), cv2.CV_32F, kernel)[1:-1, 1:-1]))) / 4.05


def joints_mm(cameras: Sequence[CameraForecast], keyframe_s: float, loose_m: float) -> float:
    """Mean distance of the joints from the truth. ``loose_m``: how far clothes stand off the skin, mean of all limbs; a
    limb is anywhere between the middle of its sleeve and the cloth, by half of that on average."""
    pixel = 1000.0 * float(np.sqrt(np.mean(np.square(_footprints_m(cameras)))))
    share = FORECAST.joint_px * np.sqrt(FORECAST.full / len(cameras)) * max(1.0, keyframe_s / FORECAST.dense_s) ** 0.5
    return float(np.linalg.norm([FORECAST.body_mm, share * pixel, 500.0 * loose_m]))


def _footprints_m(cameras: Sequence[CameraForecast]) -> list[float]:
    return [each.footprint_m for each in cameras if each.footprint_m is not None]


@dataclass(frozen=True, slots=True, eq=False)
class Forecast:
    """Forecast of a capture."""

    cameras: Mapping[str, CameraForecast]
    keyframe_s: float | None  # between keyframes; None: the body is not tracked by any
    loose_m: float = 0.0  # how far clothes stand off the skin, mean of all segments

    @property
    def pan_deg(self) -> float:
        """Of the pan, root mean square of all cameras; NaN without one."""
        return float(np.rad2deg(_root_mean_square([each.pan_rad for each in self.cameras.values()])))

    @property
    def focal_percent(self) -> float:
        """Of the focal length, root mean square of all cameras; NaN without one."""
        return 100.0 * _root_mean_square([each.log_focal for each in self.cameras.values()])

    @property
    def joints_mm(self) -> float | None:
        """Of the joints; None where no body can be tracked."""
        if self.keyframe_s is None or len(_footprints_m(list(self.cameras.values()))) < 2:
            return None
        return joints_mm(list(self.cameras.values()), self.keyframe_s, self.loose_m)


def _root_mean_square(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if values else float("nan")


def findings(forecast: Forecast) -> Iterator[Finding]:
    """The forecast, in lines."""
    cameras, keyframe_s, joints = forecast.cameras, forecast.keyframe_s, forecast.joints_mm
    for name, each in cameras.items():
        pan, focal = float(np.rad2deg(each.pan_rad)), 100.0 * each.log_focal
        faint = pan > _FAINT["pan"] or focal > _FAINT["focal"]
        text = f"pan to {pan:.2g} degrees, focal length to {focal:.2g} %; limited by {' and '.join(each.limits)}"
        yield Finding(Level.WARN if faint else Level.OK, name, "forecast", text)
    if keyframe_s is None or joints is None:
        return
    pixel = 1000.0 * float(np.median(_footprints_m(list(cameras.values()))))
    reasons = [f"a pixel is {pixel:.0f} mm at the athlete", f"{len(cameras)} cameras"]
    if keyframe_s > 1.2 * FORECAST.dense_s:
        reasons.append(f"a keyframe every {keyframe_s:.1f} s only")
    if forecast.loose_m > 0.0:
        reasons.append(f"clothes {1000.0 * forecast.loose_m:.0f} mm off the skin")
    else:
        reasons.append("tight clothes")
    text = f"joints to {joints:.0f} mm on average: {', '.join(reasons)}"
    yield Finding(Level.WARN if joints > _FAINT["joints"] else Level.OK, "", "forecast", text)
