"""One camera made ready: reference image, sweep and zoom run in, panorama and pan-zoom camera out.

With ``method="exact"`` the matches of all three go into one adjustment (`pzcap.calibration.bundle_adjustment`): the
sweep's closed circle fixes the focal length, the zoom run the principal point and how distortion changes, the reference
image where pan 0 is. With ``method="paper"`` the camera turns about its own y axis and has no distortion (sections
3.4-4.1).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pzcap.calibration import features, photometric_bundle_adjustment, reference_camera, stitching
from pzcap.calibration.bundle_adjustment import Adjusted, Link, adjust, thinned
from pzcap.calibration.correspondences import AZIMUTHS, Matched, height_of, match
from pzcap.calibration.parameters import Model
from pzcap.calibration.sweep import Frames, grey
from pzcap.extras import leave_half_out
from pzcap.extras.superresolution import super_resolve
from pzcap.geometry import camera as geometry
from pzcap.geometry import cylinder
from pzcap.geometry.camera import View
from pzcap.imaging.bspline import stored
from pzcap.localisation.localise import PanZoomConfig, panorama_features
from pzcap.localisation.panzoom_solvers import ransac_eq15, solve_eq15
from pzcap.localisation.photometric_alignment import SURE_AGREEMENT, Aligner, Alignment
from pzcap.types import (
    CalibrationObject,
    Camera,
    Image,
    InverseDepthMap,
    Lens,
    Panorama,
    PanZoomCamera,
    PzcapError,
    ReferenceCamera,
)

PARTIAL_SCALE_SIGMA = 1e-3  # relative: where no circle closes, 0.02 pixels of compression or lens stretch the whole
NODES = (10, AZIMUTHS)  # slopes and azimuths at which the hall's distance is estimated from grey values


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    reference: ReferenceCamera
    panorama: Panorama
    camera: PanZoomCamera


def no_report(stage: str, done: int, total: int) -> None:
    """Progress goes nowhere."""


def prepare(
    reference_image: Image,
    calibration_object: CalibrationObject,
    sweep: Frames,
    zoom: Frames | None,
    full_turn: bool,
    config: PanZoomConfig,
    report: Callable[[str, int, int], None] = no_report,
) -> Prepared:
    """Calibrate one camera at its reference pose, and make its panorama.

    ``sweep`` and ``zoom`` are iterated more than once. ``report(stage, done, total)`` hears of the progress; a total of
    0 is not known yet. Raises PzcapError when the calibration object is not found or the sweep does not hold together.
    """
    first = reference_camera.calibrate(reference_image, calibration_object, config.reference)
    if config.method == "paper":
        return _prepare_paper(first, reference_image, sweep, config, report)
    return _prepare_exact(first, reference_image, calibration_object, sweep, zoom, full_turn, config, report)


def _prepare_exact(
    first: ReferenceCamera,
    reference_image: Image,
    calibration_object: CalibrationObject,
    sweep: Frames,
    zoom: Frames | None,
    full_turn: bool,
    config: PanZoomConfig,
    report: Callable[[str, int, int], None],
) -> Prepared:
    height, width = reference_image.shape[:2]
    matched = match(first.camera, reference_image, sweep, zoom, full_turn, config, report)
    chained, count = matched.chained, len(matched.chained.pan_rad)
    quick = adjust(matched.start, thinned(matched.links, 5), matched.sigmas, scale_px=4.0, iterations=12).model
    adjusted = adjust(quick, matched.links, matched.sigmas, prior=matched.start, scale_px=1.0, iterations=3)
    # features say where frames lie to a quarter of a pixel, grey values say it better
    brightness = stitching.fit_brightness(matched.sweep_links, count, adjusted.model.view(0), width, height)
    fitted = _fit_grey_values(matched, adjusted.model, brightness, config, report)
    model = fitted.model

    taken = model.view(count)
    known = replace(first.camera, focal_px=taken.focal_px, principal_px=taken.principal_px, k1=taken.k1)
    refined = reference_camera.resolve(first, known, reference_image, calibration_object, config.reference)
    scale = len(model.pan_rad)  # where the sweep's focal length stands among the unknowns
    camera, surroundings = _measured(model, taken.pan_rad, refined.camera)
    doubt = 0.0 if full_turn else PARTIAL_SCALE_SIGMA
    camera = replace(camera, focal_sigma=float(np.sqrt(fitted.covariance[scale, scale] + doubt**2)))
    sweep_pan_rad = model.pan_rad[:count] - taken.pan_rad  # the reference image's pan is 0
    swept = geometry.view_at(camera, 0.0, camera.tilt_rad, camera.lens.reference_focal_px)
    pasted = stitching.stitch(
        sweep, chained.kept, chained.images, sweep_pan_rad, swept, full_turn, brightness, surroundings,
        lambda done: report("paste sweep", done, 2 * count),
    )  # fmt: skip
    background = replace(
        pasted,
        sweep_inliers=_sweep_inliers(adjusted, matched.links, count),
        closure_rad=chained.closure_rad,
        residual_px=adjusted.residual_px,
    )
    if config.sweep.super_resolve:
        background = _super_resolved(background, camera, chained.images, brightness, swept, report)
    # every pan is counted from this one image, so its own error is all frames': there is time for all of its pixels
    aligner = Aligner(background, camera, pixels=reference_image.size)
    aligned = aligner.align(reference_image, 0.0, camera.tilt_rad, refined.camera.focal_px, 1.5)
    return Prepared(refined, _counted_from(background, aligned), camera)


def _super_resolved(
    background: Panorama,
    camera: PanZoomCamera,
    images: Sequence[Image],
    brightness: stitching.Brightness,
    view: View,
    report: Callable[[str, int, int], None],
) -> Panorama:
    """The panorama super-resolved from the sweep's grey frames, whose pans are found again for that."""
    height, width = images[0].shape
    flat = stitching.flatness(brightness, view, width, height)
    gains = np.exp(-brightness.log_gain).astype(np.float32)

    def level(k: int) -> NDArray[np.float32]:
        return np.asarray(images[k] * (flat * gains[k]), np.float32)

    pan_rad = leave_half_out.pans(background, camera, images, level, report)
    moved = replace(background, sweep_pan_rad=pan_rad)
    fine = super_resolve(moved, camera, level, lambda done, total: report("super-resolve", done, total))
    return replace(moved, fine=fine)


def _fit_grey_values(
    matched: Matched,
    model: Model,
    brightness: stitching.Brightness,
    config: PanZoomConfig,
    report: Callable[[str, int, int], None],
) -> photometric_bundle_adjustment.Fitted:
    """The model fitted to all frames, each made as bright as the others and as bright at its edge as in its middle."""
    images = [*matched.chained.images, *matched.beside]
    height, width = images[0].shape
    flat = stitching.flatness(brightness, model.view(0), width, height)
    gains = [*np.exp(-brightness.log_gain), *[1.0] * len(matched.beside)]
    kept = np.empty((len(images), height, width), np.uint16)
    for number, (image, gain) in enumerate(zip(images, gains, strict=True)):
        view = model.view(number)
        lens = view.focal_px, float(view.principal_px[0])
        kept[number] = stored(image * (flat * np.float32(gain)), lens, config.sweep.smoothing)
    pairs = dict.fromkeys((link.first, link.second) for link in matched.links)
    return photometric_bundle_adjustment.adjust(
        _refined(model), kept, list(pairs), matched.sigmas, prior=_refined(matched.start),
        pixels=config.sweep.pixels, smoothing=config.sweep.smoothing,
        report=lambda done: report("adjust grey values", done, photometric_bundle_adjustment.ITERATIONS),
    )  # fmt: skip


def _counted_from(panorama: Panorama, reference: Alignment) -> Panorama:
    """The panorama, its azimuths counted from where the reference image lies on it.

    The adjustment knows that already; but found in the same way as later the pan of every frame, what is wrong with all
    of them alike is not wrong with their difference.
    """
    if reference.agreement < SURE_AGREEMENT:
        return panorama
    origin_px = panorama.origin_px - np.array([reference.pan_rad * panorama.px_per_rad, 0.0])
    return replace(panorama, origin_px=origin_px, sweep_pan_rad=panorama.sweep_pan_rad - reference.pan_rad)


def _measured(model: Model, origin_rad: float, taken: Camera) -> tuple[PanZoomCamera, InverseDepthMap]:
    """The model in metres, as it took the reference image, azimuths from its pan on.

    The floor is where the calibration object stands, at world height 0. Were it elsewhere, offset and distances would
    be wrong by one factor, and what is made of them, their product, would still be right.
    """
    height_m = height_of(taken)
    camera = PanZoomCamera(
        model.lens(taken.width, taken.height), np.eye(4), model.tilt_rad, model.roll_rad,
        offset_m=model.offset * height_m, travel_m=model.travel * height_m,
    )  # fmt: skip
    return geometry.mount(taken, camera), _turned(model.surroundings, origin_rad, height_m)


def _turned(hall: InverseDepthMap, origin_rad: float, height_m: float) -> InverseDepthMap:
    """Surroundings in camera heights, in metres and with azimuths from ``origin_rad`` on."""
    around = len(hall.walls)
    place = np.mod(origin_rad / (2 * np.pi), 1.0) * around + np.arange(around)
    below = np.floor(place).astype(np.int64)
    share, below, above = place - below, below % around, (below + 1) % around
    walls = (1 - share) * hall.walls[below] + share * hall.walls[above]
    departures = (1 - share) * hall.departures[:, below] + share * hall.departures[:, above]
    return InverseDepthMap(height_m, walls / height_m, departures, hall.slopes)


def _refined(model: Model) -> Model:
    """The model with departures at all NODES, still 0: features are too few to tell them, and the fewer the faster."""
    return replace(model, surroundings=replace(model.surroundings, departures=np.zeros(NODES)))


def _sweep_inliers(adjusted: Adjusted, links: Sequence[Link], count: int) -> NDArray[np.int64]:
    """(M,) matches of each frame with the next (of the last, with the one before) that agreed."""
    inliers = np.zeros(count, np.int64)
    for link, agreed in zip(links, adjusted.inliers, strict=True):
        if link.second == link.first + 1 < count:
            inliers[link.first] = agreed
    inliers[-1] = inliers[-2]
    return inliers


def _prepare_paper(
    first: ReferenceCamera,
    reference_image: Image,
    sweep: Frames,
    config: PanZoomConfig,
    report: Callable[[str, int, int], None],
) -> Prepared:
    height, width = reference_image.shape[:2]
    focal = first.camera.focal_px
    pasted = stitching.stitch_paper(sweep, focal, config.sweep, lambda done: report("stitch sweep", done, 0))
    unfolded, covered, origin = cylinder.to_cylinder(reference_image, focal)
    inside = np.asarray(covered, np.uint8)
    found = features.detect(grey(unfolded), config.threshold, config.frame_features, inside)
    landmarks = panorama_features(pasted, config.threshold, config.panorama_features)
    pairs = features.match(found, landmarks, config.ratio)
    relative, places = found.points_px[pairs[:, 0]] - origin, landmarks.points_px[pairs[:, 1]]
    agree = ransac_eq15(relative, places)
    if agree.sum() < config.min_inliers:
        raise PzcapError("reference image: it shows nothing of what the sweep showed; sweep past the reference pose")
    (_, column, row), _ = solve_eq15(relative[agree], places[agree])
    shift = (column - pasted.origin_px[0]) / pasted.px_per_rad
    background = replace(pasted, origin_px=np.array([column, row]), sweep_pan_rad=pasted.sweep_pan_rad + shift)
    lens = Lens(width, height, focal, first.camera.principal_px[None], np.zeros(1))
    level = PanZoomCamera(lens, np.eye(4), 0.0, 0.0)
    return Prepared(first, background, geometry.mount(replace(first.camera, k1=0.0), level))
