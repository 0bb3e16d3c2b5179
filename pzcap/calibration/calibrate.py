"""The calibration of one camera: reference image, sweep and zoom run in, panorama and pan-zoom camera out.

The matches of all three go into one bundle adjustment (`pzcap.calibration.bundle_adjustment`), which is then refined on
grey values (`pzcap.calibration.photometric_bundle_adjustment`): the sweep's closed circle fixes the focal length, the
zoom run the principal point and how distortion changes with the zoom, the reference image pan 0.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from pzcap.calibration import photometric_bundle_adjustment, reference_camera, stitching
from pzcap.calibration.bundle_adjustment import Adjusted, Link, adjust, enough
from pzcap.calibration.correspondences import Matched, height_of, match
from pzcap.calibration.focal_from_sweep import camera_of_sweep, levelled
from pzcap.calibration.parameters import CalibrationParameters
from pzcap.calibration.propagation import propagated
from pzcap.calibration.settings import PanZoomConfig
from pzcap.calibration.sweep import Frames
from pzcap.calibration.tuning import BELIEF, FEATURES, HALL, PHOTOMETRIC, PROPAGATION
from pzcap.geometry import camera as geometry
from pzcap.geometry.camera import View
from pzcap.imaging.bspline import stored
from pzcap.types import (
    Array,
    CalibrationObject,
    Camera,
    Image,
    InverseDepthMap,
    Panorama,
    PanZoomCamera,
    PzcapError,
    ReferenceCamera,
)

Report: TypeAlias = Callable[[str, int, int], None]
"""Called with a stage, how much of it is done, and of how much (0: not known)."""


class Footage(NamedTuple):
    """Footage of one camera in the empty hall."""

    reference_image: Image  # (H, W, 3) of the calibration object, at the reference pose; without one, any of the sweep
    calibration_object: CalibrationObject | None
    sweep: Frames  # iterated more than once, as the zoom run is
    zoom: Frames | None
    full_turn: bool  # the sweep's circle closes
    sweep_period_s: float = 0.0  # from one frame of the sweep to the next; 0: not known


@dataclass(frozen=True, slots=True, eq=False)
class CalibratedCamera:
    """Result of the calibration of one camera, before the motion."""

    reference: ReferenceCamera
    panorama: Panorama
    camera: PanZoomCamera


def no_report(stage: str, done: int, total: int) -> None:
    """Discard progress."""


def calibrate(
    footage: Footage, config: PanZoomConfig, report: Report = no_report
) -> tuple[CalibratedCamera, stitching.SweptFrames, stitching.ZoomedFrames, Array]:
    """Calibrate one camera at its reference pose, and stitch its panorama; the frames that it is made of, and the bands
    of mains light (F, K) in those of the sweep, the reference image and those of the zoom run.

    Without a calibration object it stands levelled in a world of its own (`focal_from_sweep`), to be placed later.
    Raises PzcapError when the calibration object is not found or the sweep does not hold together.
    """
    first, matched = _matched(footage, config, report)
    chained, count = matched.chained, len(matched.chained.pan_rad)
    fits = [_fit(matched, start, config, report) for start in _starts(matched, config)]
    (adjusted, brightness, fitted), undecided = _likeliest(fits, matched)
    model = fitted.parameters
    _require_whole(adjusted, matched.sweep_links, chained.kept)

    taken = model.view(count)
    refined = _with_lens_of(taken, first, footage, config)
    size = refined.camera.width, refined.camera.height
    scale = len(model.pan_rad)  # index of the sweep's focal length among the parameters
    camera, surroundings = _in_metres(model, taken.pan_rad, refined.camera)
    fitted = fitted.less_sure(scale, BELIEF.parallax_scale_sigma_m * float(np.linalg.norm(camera.offset_m)))
    doubt = np.hypot(0.0 if chained.full_turn else BELIEF.partial_scale_sigma, undecided)
    if footage.calibration_object is not None:
        doubt = np.hypot(doubt, contradiction(first.camera.focal_px, taken.focal_px, size[0]))
    sweep_pan_rad = model.pan_rad[:count] - taken.pan_rad  # the reference image's pan is 0
    camera = replace(
        camera, focal_sigma=float(np.sqrt(fitted.covariance[scale, scale] + doubt**2)),
        shared_zooms=np.array(PROPAGATION.zooms), shared_covariance=propagated(fitted, count, size, doubt),
    )  # fmt: skip
    view = geometry.view_at(camera, 0.0, camera.tilt_rad, camera.lens.reference_focal_px)
    swept = stitching.SweptFrames(chained.images, chained.kept, brightness, view)
    pasted = stitching.stitch(
        footage.sweep, swept, sweep_pan_rad, chained.full_turn, surroundings,
        lambda done: report("paste sweep", done, 2 * count),
    )  # fmt: skip
    inliers = _sweep_inliers(adjusted, matched.links, count)
    panorama = replace(pasted, sweep_inliers=inliers, closure_rad=chained.closure_rad, residual_px=adjusted.residual_px)
    zoom_pan_rad = float(model.pan_rad[-1] - taken.pan_rad)
    zoomed = stitching.ZoomedFrames(np.array(matched.zoom_numbers, np.int64), model.log_focal[2:], zoom_pan_rad)
    return CalibratedCamera(refined, panorama, camera), swept, zoomed, fitted.bands


def _matched(footage: Footage, config: PanZoomConfig, report: Report) -> tuple[ReferenceCamera, Matched]:
    """The camera of the reference image by itself, and all frames matched. Raises PzcapError as `calibrate` does."""
    image, calibration_object, sweep, zoom, full_turn, _ = footage
    if calibration_object is None:
        first = _unplaced(camera_of_sweep(sweep, config))
    else:
        first = reference_camera.calibrate(image, calibration_object, config.reference)
    matched = match(first.camera, image, sweep, zoom, full_turn, config, report)
    if calibration_object is None:
        if not matched.chained.full_turn:
            raise PzcapError(
                "sweep: it has a gap where nothing is seen twice, and without a calibration object nothing but a "
                "closed circle tells the focal length; film a calibration object"
            )
        return first, matched

    def up(view: View) -> Array:
        return np.asarray(_with_lens_of(view, first, footage, config).camera.world_T_cam[2, :3])

    matched = replace(matched, object_px=first.camera.focal_px, up=up)
    return first, replace(matched, start=_with_lean(matched.start, matched))


def _with_lens_of(view: View, first: ReferenceCamera, footage: Footage, config: PanZoomConfig) -> ReferenceCamera:
    """The camera of the reference image with the lens of a ``view``; without a calibration object it stands levelled in
    a world of its own."""
    lens = {"focal_px": view.focal_px, "principal_px": view.principal_px, **view.distortion._asdict()}
    known = replace(first.camera, **lens)
    if footage.calibration_object is None:
        return replace(first, camera=replace(known, world_T_cam=levelled(view.tilt_rad, view.roll_rad)))
    return reference_camera.resolve(first, known, footage.reference_image, footage.calibration_object, config.reference)


def contradiction(object_px: float, sweep_px: float, width: int) -> float:
    """By how much the focal length of the reference image, of so many columns, that a sweep has led to contradicts the
    one that the calibration object shows by itself, relative; 0 where it does not: a minimum that is not the right
    one."""
    departure = abs(float(np.log(sweep_px / object_px)))
    return departure if departure * width > BELIEF.implausible_px else 0.0


def _unplaced(camera: Camera) -> ReferenceCamera:
    """A reference camera that no calibration object has been seen by."""
    return ReferenceCamera(camera, np.zeros((0, 3)), np.zeros((0, 2)), np.zeros((0, 2)))


def _starts(matched: Matched, config: PanZoomConfig) -> list[CalibrationParameters]:
    """The better minimum of the features' cost, and another one if it may be as good.

    A projection centre behind the axis, walls all alike and a longer focal length explain the features nearly as well
    as one before it and walls as they are. From one start it is chance which is found: the other side is tried, too,
    and a part of the grey values decides with all else that is known. Where it cannot, the whole has to.
    """
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
    fits = [_fit(replace(matched, links=some), each.parameters, few, no_report) for each in (one, other)]
    (best, by), (worst, worse_by) = sorted(zip(fits, _deviances(fits, matched), strict=True), key=itemgetter(1))
    found, other_found = (_without_departures(fit.fitted.parameters, matched.start) for fit in (best, worst))
    same = abs(float(other_found.log_focal[0] - found.log_focal[0])) < BELIEF.same_focal
    return [found] if same or worse_by - by > BELIEF.worse_by_some else [found, other_found]


class _Fit(NamedTuple):
    """The parameters fitted to features, then to grey values."""

    adjusted: Adjusted
    brightness: stitching.Brightness
    fitted: photometric_bundle_adjustment.Fitted


def _fit(matched: Matched, start: CalibrationParameters, config: PanZoomConfig, report: Report) -> _Fit:
    if is_unusual(start.higher, matched.sigmas.higher):  # what a footage does not ask for would only add to its noise
        wide = matched.sigmas.higher / BELIEF.usual_lens
        matched = replace(matched, sigmas=replace(matched.sigmas, higher=wide))
    adjusted = adjust(start, matched.links, matched.sigmas, prior=matched.start, scale_px=1.0, iterations=3)
    adjusted = replace(adjusted, parameters=_with_lean(adjusted.parameters, matched))
    # features place frames to a quarter of a pixel, grey values better
    height, width = matched.chained.images[0].shape
    count, first = len(matched.chained.pan_rad), adjusted.parameters.view(0)
    brightness = stitching.fit_brightness(matched.sweep_links, count, first, width, height)
    return _Fit(adjusted, brightness, _fit_grey_values(matched, adjusted.parameters, brightness, config, report))


def _likeliest(fits: Sequence[_Fit], matched: Matched) -> tuple[_Fit, float]:
    """The likeliest of one or two fits, and the deviation of log focal length for the odds that the other is right."""
    if len(fits) == 1:
        return fits[0], 0.0
    (best, by), (other, worse_by) = sorted(zip(fits, _deviances(fits, matched), strict=True), key=itemgetter(1))
    apart = abs(float(other.fitted.parameters.log_focal[0] - best.fitted.parameters.log_focal[0]))
    odds = math.exp(-0.5 * (worse_by - by))
    return best, apart * math.sqrt(odds / (1.0 + odds))


def _deviances(fits: Sequence[_Fit], matched: Matched) -> list[float]:
    """Minus twice the log likelihood of each fit, up to a constant: of the overlaps, by how little they agree with it;
    of what was believed before; and of the focal length that the calibration object shows by itself.

    The sum of squared residuals does not count: where the projection centre is far from the axis, the distances of the
    hall are free to make up for colours that the lens sets apart, and the wrong minimum has had the lower one.
    """
    variance = min(fit.fitted.sigma for fit in fits) ** 2
    width, deviances = matched.chained.images[0].shape[1], []
    for fit in (each.fitted for each in fits):
        deviance = fit.disagreement / (PHOTOMETRIC.doubt * variance) + fit.surprise
        if matched.object_px is not None:
            off = float(fit.parameters.log_focal[1]) - math.log(matched.object_px)  # the reference image's
            deviance += (off * width / BELIEF.object_px) ** 2
        deviances.append(deviance)
    return deviances


def is_unusual(higher: Array, sigmas: Array) -> bool:
    """True if k2, p1 or p2 (3,) were drawn further from 0 than their usual ``sigmas`` (3,) let one expect."""
    return bool(np.any(np.abs(higher) > BELIEF.unusual * sigmas))


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


def _in_metres(model: CalibrationParameters, origin_rad: float, taken: Camera) -> tuple[PanZoomCamera, InverseDepthMap]:
    """Convert the parameters, in camera heights, to metres; azimuths count from the reference image's pan.

    The floor is taken to be at world height 0, where the calibration object stands. If it is not, offset and distances
    are wrong by the same factor, and the parallax, which depends on their ratio alone, is still right.
    """
    height_m = height_of(taken)
    camera = PanZoomCamera(
        model.lens(taken.width, taken.height), np.eye(4), model.tilt_rad, model.roll_rad,
        offset_m=model.offset * height_m, travel_m=model.travel * height_m,
    )  # fmt: skip
    return geometry.mount(taken, camera), _rotated(model.surroundings, origin_rad, height_m)


def _rotated(hall: InverseDepthMap, origin_rad: float, height_m: float) -> InverseDepthMap:
    """Convert a map in camera heights to metres, its azimuths counted from ``origin_rad``."""
    places = np.mod(origin_rad / (2 * np.pi), 1.0) * len(hall.walls)
    walls = ndimage.shift(hall.walls, -places, order=1, mode="grid-wrap")
    departures = ndimage.shift(hall.departures, (0.0, -places), order=1, mode="grid-wrap")
    cos, sin = np.cos(origin_rad), np.sin(origin_rad)
    lean = np.array([[cos, sin], [-sin, cos]]) @ hall.lean
    return InverseDepthMap(height_m, walls / height_m, departures, hall.slopes, lean=lean)


def _with_lean(model: CalibrationParameters, matched: Matched) -> CalibrationParameters:
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


def _without_departures(model: CalibrationParameters, start: CalibrationParameters) -> CalibrationParameters:
    """The same with as many departures as a ``start`` has, all of them 0."""
    return replace(model, surroundings=replace(model.surroundings, departures=start.surroundings.departures))


def _require_whole(adjusted: Adjusted, links: Sequence[Link], kept: NDArray[np.int64]) -> None:
    """Raise PzcapError where of the matches of a sweep's frames ``kept`` (M,) with those beyond hardly any agree: there
    the sweep is torn, and the circle does not fix the focal length. ``links`` come first in what was adjusted."""
    matches, agreed = np.zeros(len(kept) - 1, np.int64), np.zeros(len(kept) - 1, np.int64)
    for link, inliers in zip(links, adjusted.inliers, strict=False):
        if link.second - link.first < len(kept) // 2:  # the others are across the seam
            matches[link.first : link.second] += len(link.first_px)
            agreed[link.first : link.second] += inliers
    torn = np.flatnonzero(agreed < FEATURES.least_agreed * matches)
    if len(torn):
        first = int(torn[0])
        raise PzcapError(
            f"sweep: of {matches[first]} matches across frames {kept[first]} and {kept[first + 1]} {agreed[first]} "
            "agree with the rest: it does not hold together there; pan evenly and slowly, with nothing nearer "
            "than a metre, and shoot the sweep again"
        )


def _sweep_inliers(adjusted: Adjusted, links: Sequence[Link], count: int) -> NDArray[np.int64]:
    """(M,) inlier matches of each frame with the next (of the last, with the one before)."""
    inliers = np.zeros(count, np.int64)
    for link, agreed in zip(links, adjusted.inliers, strict=True):
        if link.second == link.first + 1 < count:
            inliers[link.first] = agreed
    inliers[-1] = inliers[-2]
    return inliers
