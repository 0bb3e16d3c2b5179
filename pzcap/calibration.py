"""One camera made ready: reference image, sweep and zoom run in, panorama and pan-zoom camera out.

With ``method="exact"`` the matches of all three go into one adjustment (`pzcap.bundle`): the sweep's closed circle
fixes the focal length, the zoom run the principal point and how distortion changes, the reference image where pan 0
is. With ``method="paper"`` the camera turns about its own y axis and has no distortion (sections 3.4-4.1).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pzcap import camera as geometry
from pzcap import cylinder, features, panorama, reference
from pzcap.bundle import Adjusted, Link, Model, Sigmas, adjust, thinned
from pzcap.camera import View
from pzcap.features import Features
from pzcap.panorama import Frames
from pzcap.panzoom import PanZoomConfig, panorama_features, ransac_eq15, solve_eq15
from pzcap.sweep import chain, grey, link_further, link_views, place, spaced
from pzcap.types import (
    Array,
    CalibrationObject,
    Image,
    Lens,
    Panorama,
    PanZoomCamera,
    PzcapError,
    ReferenceCamera,
)
from pzcap.zoom import link_zoom

PRINCIPAL_SHARE = 0.01  # standard deviation of the principal point about the centre, of the image's width
ANGLE_SIGMA_RAD = 0.2  # of tilt and roll
K1_SIGMA = 0.1
MIN_HEIGHT_M = 0.2  # a camera lower than this over the world's origin does not stand on its floor
WALLS = 36  # azimuths at which the walls' distance is estimated
WALL_NEARNESS = 0.15  # inverse distance of a wall before anything is known, in inverse heights of the camera
FOCAL_SIGMA = 0.005  # relative, of the reference calibration


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
    first = reference.calibrate(reference_image, calibration_object, config.reference)
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
    view = View(0.0, 0.0, 0.0, first.camera.focal_px, first.camera.principal_px, 0.0)
    chained = chain(
        (image for _, image in sweep), view, full_turn, config.sweep, lambda done: report("match sweep", done, 0)
    )
    count = len(chained.pan_rad)
    sigmas = _sigmas(width, full_turn, zoom=False)
    coarse = adjust(_start(view, chained.pan_rad), chained.links, sigmas, iterations=6).model
    further = link_further(chained.features, [coarse.view(i) for i in range(count)], width, config.sweep)

    # the reference image and the zoom run find their places among the sweep's frames, then all is adjusted at once
    found = [*chained.features, _detect(reference_image, config)]
    pan, links = _place_reference(found, coarse, width, config)
    links = [*chained.links, *further, *links]
    pans, focals = [*coarse.pan_rad, pan], [coarse.log_focal[0]] * 2
    pan_of, focal_of = [*range(count), count], [0] * count + [1]
    if zoom is not None:
        found += _zoom_features(zoom, config, report)
        run = link_zoom(found, coarse.pan_rad, count + 1, coarse.view(0), width, config)
        links += run.links
        pans.append(run.pan_rad)
        focals += list(run.log_focal)
        pan_of += [count + 1] * len(run.log_focal)
        focal_of += list(range(2, 2 + len(run.log_focal)))
    start = Model(
        np.array(pans), np.array(focals), np.array(pan_of), np.array(focal_of), coarse.tilt_rad, coarse.roll_rad,
        _padded(coarse.principal_px, 2 if zoom else 1), _padded(coarse.k1[:, None], 3 if zoom else 1)[:, 0],
        coarse.offset, np.full(WALLS, WALL_NEARNESS),
    )  # fmt: skip
    sigmas = _sigmas(width, full_turn, zoom is not None)
    quick = adjust(start, thinned(links, 5), sigmas, scale_px=4.0, iterations=12).model
    adjusted = adjust(quick, links, sigmas, prior=start, scale_px=1.0, iterations=6)
    model = adjusted.model

    taken = model.view(count)
    known = replace(first.camera, focal_px=taken.focal_px, principal_px=taken.principal_px, k1=taken.k1)
    refined = reference.resolve(first, known, reference_image, calibration_object, config.reference)
    surroundings = _surroundings(model, taken.pan_rad, float(refined.camera.world_T_cam[2, 3]))
    brightness = panorama.fit_brightness([*chained.links, *further], count, model.view(0), width, height)
    sweep_pan_rad = model.pan_rad[:count] - taken.pan_rad  # the reference image's pan is 0
    pasted = panorama.stitch(
        sweep, sweep_pan_rad, model.view(0), full_turn, brightness, surroundings,
        lambda done: report("paste sweep", done, count),
    )  # fmt: skip
    background = replace(
        pasted,
        sweep_inliers=_sweep_inliers(adjusted, links, count),
        closure_rad=chained.closure_rad,
        residual_px=adjusted.residual_px,
    )
    lens = model.lens(width, height)
    camera = geometry.mount(refined.camera, lens, model.tilt_rad, model.roll_rad, surroundings.offset_m)
    return Prepared(refined, background, camera)


def _surroundings(model: Model, origin_rad: float, camera_height_m: float) -> panorama.Surroundings:
    """The model's, in metres, azimuths from the reference pose's pan on.

    The floor is where the calibration object stands, at world height 0. Were it elsewhere, offset and distances would
    be wrong by one factor, and what is made of them, their product, would still be right.
    """
    height_m = camera_height_m if camera_height_m > MIN_HEIGHT_M else 1.0
    azimuth = origin_rad + np.arange(WALLS) * 2 * np.pi / WALLS
    return panorama.Surroundings(
        model.offset * height_m, height_m, cylinder.periodic(model.nearness, azimuth) / height_m
    )


def _start(view: View, pan_rad: Array) -> Model:
    count = len(pan_rad)
    return Model(
        pan_rad, np.array([np.log(view.focal_px)]), np.arange(count), np.zeros(count, np.int64), 0.0, 0.0,
        view.principal_px[None], np.array([view.k1]),
        np.zeros(2), np.zeros(0),
    )  # fmt: skip


def _sigmas(width: int, full_turn: bool, zoom: bool) -> Sigmas:
    principal = PRINCIPAL_SHARE * width
    # a circle that closes fixes the focal length far better than the calibration object can
    focal = 10.0 * FOCAL_SIGMA if full_turn else FOCAL_SIGMA
    if not zoom:
        return Sigmas(focal, ANGLE_SIGMA_RAD, np.array([principal]), np.array([K1_SIGMA]))
    return Sigmas(focal, ANGLE_SIGMA_RAD, np.full(2, principal), np.array([K1_SIGMA, K1_SIGMA, 0.5 * K1_SIGMA]))


def _padded(coefficients: Array, order: int) -> Array:
    """Polynomial coefficients (p, D) with zeros up to ``order`` terms."""
    return np.vstack([coefficients, np.zeros((order - len(coefficients), coefficients.shape[1]))])


def _detect(image: Image, config: PanZoomConfig) -> Features:
    return features.detect(grey(image), config.sweep.threshold, config.sweep.features)


def _place_reference(
    found: Sequence[Features], sweep: Model, width: int, config: PanZoomConfig
) -> tuple[float, list[Link]]:
    """Pan of the last frame of ``found``, the reference image, and its links to the frames of the sweep."""
    view = sweep.view(0)
    field = 2 * np.arctan(width / 2 / view.focal_px)
    focals = view.focal_px * np.exp(np.arange(-0.1, 0.101, 0.01))
    best, pan, focal = 0, 0.0, view.focal_px
    for index in spaced(sweep.pan_rad, 0.3 * field):
        taken = sweep.view(index)
        candidate = place(
            found[-1], found[index], taken, lambda f: replace(view, focal_px=f), focals, config.sweep.ratio
        )
        if candidate[2] > best:
            pan, focal, best = candidate
    seen = replace(view, pan_rad=pan, focal_px=focal)
    links = []
    for share in np.arange(-0.6, 0.61, 0.1):
        apart = np.mod(sweep.pan_rad - pan - share * field + np.pi, 2 * np.pi) - np.pi
        index = int(np.argmin(np.abs(apart)))
        links.append(link_views(found, index, len(found) - 1, (sweep.view(index), seen), 12.0, config.sweep))
    kept = [link for link in links if link is not None]
    if best < config.sweep.min_matches or not kept:
        raise PzcapError("reference image: it shows nothing of what the sweep showed; sweep past the reference pose")
    return pan, kept


def _zoom_features(zoom: Frames, config: PanZoomConfig, report: Callable[[str, int, int], None]) -> list[Features]:
    """Features of some frames of the zoom run, evenly spaced."""
    count = sum(1 for _ in zoom)
    chosen = set(np.round(np.linspace(0, count - 1, min(count, config.sweep.zoom_frames))).astype(int).tolist())
    result = []
    for number, (_, image) in enumerate(zoom):
        if number in chosen:
            result.append(_detect(image, config))
            report("match zoom run", len(result), len(chosen))
    return result


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
    pasted = panorama.stitch_paper(sweep, focal, config.sweep, lambda done: report("stitch sweep", done, 0))
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
    camera = replace(first.camera, k1=0.0)
    return Prepared(first, background, geometry.mount(camera, lens, 0.0, 0.0))
