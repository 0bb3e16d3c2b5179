"""The parameters of a camera fitted to its matches, then to grey values."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pzcap.calibration import photometric_bundle_adjustment, stitching
from pzcap.calibration.bundle_adjustment import Adjusted, adjust
from pzcap.calibration.correspondences import Matched
from pzcap.calibration.parameters import CalibrationParameters
from pzcap.calibration.settings import PanZoomConfig
from pzcap.calibration.tuning import BELIEF, HALL, PHOTOMETRIC
from pzcap.geometry import camera as geometry
from pzcap.imaging.bspline import stored
from pzcap.progress import Report
from pzcap.types import Array


class CameraFit(NamedTuple):
    """The parameters fitted to features, then to grey values."""

    adjusted: Adjusted
    brightness: stitching.Brightness
    fitted: photometric_bundle_adjustment.Fitted


def fit_camera(matched: Matched, start: CalibrationParameters, config: PanZoomConfig, report: Report) -> CameraFit:
    """Fit the parameters of a camera from a ``start``, right to some pixels, to its matches and then to grey values."""
    unusual = is_unusual(start.higher, matched.sigmas.higher)
    if unusual:  # what a footage does not ask for would only add to its noise
        matched = _of_any_lens(matched)
    adjusted = adjust(start, matched.links, matched.sigmas, prior=matched.start, scale_px=1.0, iterations=3)
    # where no circle closes a focal length makes up for k2, which is hardly drawn from 0
    if not (unusual or matched.chained.full_turn) and abs(adjusted.k2_drawn) > BELIEF.unusual:
        matched = _of_any_lens(matched)
        adjusted = adjust(adjusted.parameters, matched.links, matched.sigmas, prior=matched.start, scale_px=1.0)
    adjusted = replace(adjusted, parameters=with_lean(adjusted.parameters, matched))
    # features place frames to a quarter of a pixel, grey values better
    height, width = matched.chained.images[0].shape
    count, first = len(matched.chained.pan_rad), adjusted.parameters.view(0)
    brightness = stitching.fit_brightness(matched.sweep_links, count, first, width, height)
    return CameraFit(adjusted, brightness, _fit_grey_values(matched, adjusted.parameters, brightness, config, report))


def is_unusual(higher: Array, sigmas: Array) -> bool:
    """True if k2, p1 or p2 (3,) were drawn further from 0 than their usual ``sigmas`` (3,) let one expect."""
    return bool(np.any(np.abs(higher) > BELIEF.unusual * sigmas))


def _of_any_lens(matched: Matched) -> Matched:
    """The same with k2, p1 and p2 believed to be as large as any lens's."""
    return replace(matched, sigmas=replace(matched.sigmas, higher=matched.sigmas.higher / BELIEF.usual_lens))


def _fit_grey_values(
    matched: Matched, model: CalibrationParameters, brightness: stitching.Brightness, config: PanZoomConfig,
    report: Report,
) -> photometric_bundle_adjustment.Fitted:  # fmt: skip
    """Fit the parameters to the grey values of all frames, their gains and vignetting taken out before."""
    images = [*matched.chained.images, *matched.other_images]
    height, width = images[0].shape
    flat = stitching.flatness(brightness, model.view(0), width, height)
    gains = [*np.exp(-brightness.log_gain), *[1.0] * len(matched.other_images)]
    kept = np.empty((len(images), height, width), np.uint16)
    for number, (image, gain) in enumerate(zip(images, gains, strict=True)):
        view = model.view(number)
        lens = view.focal_px, float(view.principal_px[0])
        kept[number] = stored(image * (flat * np.float32(gain)), lens, config.sweep.smoothing)
    rounds = PHOTOMETRIC.rounds * PHOTOMETRIC.steps_of_round
    most = PHOTOMETRIC.steps_on_some + PHOTOMETRIC.open_steps + rounds + PHOTOMETRIC.steps
    return photometric_bundle_adjustment.adjust(
        _with_departures(model), kept, matched.links, matched.sigmas, prior=_with_departures(matched.start),
        config=config.sweep, report=lambda done: report("adjust grey values", done, most),
    )  # fmt: skip


def with_lean(model: CalibrationParameters, matched: Matched) -> CalibrationParameters:
    """The same with the floor's lean against the pan axis, by the way up in the reference image; unchanged where
    nothing has told that.

    Seen from a centre that is beside the axis, a floor that leans the other way looks like pans that are off: they
    swing to and fro once in a turn.
    """
    if matched.up is None:
        return model
    view = model.view(len(matched.chained.pan_rad))
    up = geometry.head_T_cam(view.pan_rad, view.tilt_rad, view.roll_rad)[:3, :3] @ matched.up(view)
    return replace(model, surroundings=replace(model.surroundings, lean=-up[:2] / up[2]))


def _with_departures(model: CalibrationParameters) -> CalibrationParameters:
    """Add departures at all nodes of the hall, 0 as yet: features are too few to estimate them."""
    return replace(model, surroundings=replace(model.surroundings, departures=np.zeros((HALL.slopes, HALL.azimuths))))
