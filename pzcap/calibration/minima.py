"""Calibration from two starts, the projection centre before and behind the pan axis: the likelier minimum is taken.

A projection centre behind the axis, walls all alike and a longer focal length explain the features nearly as well as
one before it and walls as they are. From one start it is chance which is found.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from operator import itemgetter

import numpy as np

from pzcap.calibration.bundle_adjustment import adjust, enough
from pzcap.calibration.correspondences import Matched
from pzcap.calibration.fitting import CameraFit, fit_camera
from pzcap.calibration.parameters import CalibrationParameters
from pzcap.calibration.settings import PanZoomConfig
from pzcap.calibration.tuning import BELIEF, HALL, PHOTOMETRIC
from pzcap.progress import no_report


def starts(matched: Matched, config: PanZoomConfig) -> list[CalibrationParameters]:
    """The better minimum of the features' cost, and another one if it may be as good: a part of the grey values decides
    with all else that is known, and where it cannot, the whole has to."""
    some = enough(matched.links)
    one = adjust(matched.start, some, matched.sigmas, scale_px=4.0, iterations=12)
    beside, nearness = BELIEF.other_side
    opposite = replace(
        matched.start, offset=np.array([-math.copysign(beside, one.parameters.offset[0]), 0.0]),
        surroundings=replace(matched.start.surroundings, walls=np.full(HALL.azimuths, nearness)),
    )  # fmt: skip
    other = adjust(opposite, some, matched.sigmas, prior=matched.start, scale_px=4.0, iterations=12)
    better, worse = sorted((one, other), key=lambda each: each.residual_px)
    same = abs(one.parameters.log_focal[0] - other.parameters.log_focal[0]) < BELIEF.same_focal
    excess = (worse.residual_px / better.residual_px - 1.0) * math.sqrt(sum(len(link.first_px) for link in some))
    if same or excess > BELIEF.worse_by_features:
        return [better.parameters]
    few = replace(config, sweep=replace(config.sweep, pixels=config.sweep.pixels // BELIEF.deciding))
    fits = [fit_camera(replace(matched, links=some), each.parameters, few, no_report) for each in (one, other)]
    (best, by), (worst, worse_by) = sorted(zip(fits, _deviances(fits, matched), strict=True), key=itemgetter(1))
    found, other_found = (_without_departures(fit.fitted.parameters, matched.start) for fit in (best, worst))
    same = abs(float(other_found.log_focal[0] - found.log_focal[0])) < BELIEF.same_focal
    return [found] if same or worse_by - by > BELIEF.worse_by_some else [found, other_found]


def likeliest(fits: Sequence[CameraFit], matched: Matched) -> tuple[CameraFit, float]:
    """The likeliest of one or two fits, and the deviation of log focal length for the odds that the other is right."""
    if len(fits) == 1:
        return fits[0], 0.0
    (best, by), (other, worse_by) = sorted(zip(fits, _deviances(fits, matched), strict=True), key=itemgetter(1))
    apart = abs(float(other.fitted.parameters.log_focal[0] - best.fitted.parameters.log_focal[0]))
    odds = math.exp(-0.5 * (worse_by - by))
    return best, apart * math.sqrt(odds / (1.0 + odds))


def _deviances(fits: Sequence[CameraFit], matched: Matched) -> list[float]:
    """Minus twice the log likelihood of each fit, up to a constant: of the overlaps, by how little they agree with it;
    of what was believed before; and of the focal length that the calibration object shows by itself.

    The sum of squared residuals does not count: where the projection centre is far from the axis, the distances of the
    hall are free to make up for colours that the lens sets apart, and the wrong minimum has had the lower one.
    """
    variance = min(fit.fitted.sigma for fit in fits) ** 2
    width, deviances = matched.chained.images[0].shape[1], []
    for each in fits:
        fit = each.fitted
        deviance = fit.overlap_misfit / (PHOTOMETRIC.doubt * variance) + fit.prior_misfit
        if matched.object_px is not None:
            off = float(fit.parameters.log_focal[1]) - math.log(matched.object_px)  # the reference image's
            deviance += (off * width / BELIEF.object_px) ** 2
        deviances.append(deviance)
    return deviances


def _without_departures(model: CalibrationParameters, start: CalibrationParameters) -> CalibrationParameters:
    """The same with as many departures as a ``start`` has, all of them 0."""
    return replace(model, surroundings=replace(model.surroundings, departures=start.surroundings.departures))
