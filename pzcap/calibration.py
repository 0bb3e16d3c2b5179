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
from pzcap import cylinder, direct, features, panorama, reference
from pzcap.align import Aligner, Alignment
from pzcap.bundle import Adjusted, Link, adjust, thinned
from pzcap.camera import View
from pzcap.features import Features
from pzcap.panzoom import PanZoomConfig, panorama_features, ransac_eq15, solve_eq15
from pzcap.sampling import stored
from pzcap.sweep import Frames, chain, grey, link_further, link_views, place, spaced
from pzcap.types import (
    FAR_AWAY,
    Array,
    CalibrationObject,
    Camera,
    Image,
    Lens,
    Panorama,
    PanZoomCamera,
    PzcapError,
    ReferenceCamera,
    Surroundings,
)
from pzcap.unknowns import BeliefConfig, Model, Sigmas
from pzcap.zoom import link_zoom

MIN_HEIGHT_M = 0.2  # a camera lower than this over the world's origin does not stand on its floor
PARTIAL_SCALE_SIGMA = 1e-3  # relative: where no circle closes, 0.02 pixels of compression or lens stretch the whole
NODES = (10, 72)  # slopes and azimuths at which the hall's distance is estimated from grey values
WALL_NEARNESS = 0.15  # inverse distance of a wall before anything is known, in inverse heights of the camera
SURE_AGREEMENT = 0.5  # of the reference image with the panorama (see `align.Alignment`)
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
    chained = chain(sweep, view, full_turn, config.sweep, lambda done: report("match sweep", done, 0))
    count = len(chained.pan_rad)
    sigmas = _sigmas(first.camera, config.beliefs, full_turn, zoom=False)
    coarse = adjust(_start(view, chained.pan_rad), chained.links, sigmas, iterations=6).model
    further = link_further(chained.features, [coarse.view(i) for i in range(count)], width, config.sweep)

    # the reference image and the zoom run find their places among the sweep's frames, then all is adjusted at once
    found = [*chained.features, _detect(reference_image, config)]
    pan, links = _place_reference(found, coarse, width, config)
    links = [*chained.links, *further, *links]
    pans, focals = [*coarse.pan_rad, pan], [coarse.log_focal[0]] * 2
    pan_of, focal_of = [*range(count), count], [0] * count + [1]
    zoomed = _zoom_frames(zoom, config)
    if zoomed:
        report("match zoom run", 0, 1)
        found += [_detect(image, config) for image in zoomed]
        run = link_zoom(found, coarse.pan_rad, count + 1, coarse.view(0), width, config)
        links += run.links
        pans.append(run.pan_rad)
        focals += list(run.log_focal)
        pan_of += [count + 1] * len(run.log_focal)
        focal_of += list(range(2, 2 + len(run.log_focal)))
    start = Model(
        np.array(pans), np.array(focals), np.array(pan_of), np.array(focal_of), coarse.tilt_rad, coarse.roll_rad,
        _padded(coarse.principal_px, 2 if zoomed else 1), _padded(coarse.k1[:, None], 3 if zoomed else 1)[:, 0],
        coarse.offset, 0.0, _floor_and_walls(coarse.view(0), width, height, 2),
    )  # fmt: skip
    sigmas = _sigmas(first.camera, config.beliefs, full_turn, zoom=bool(zoomed))
    quick = adjust(start, thinned(links, 5), sigmas, scale_px=4.0, iterations=12).model
    matched = adjust(quick, links, sigmas, prior=start, scale_px=1.0, iterations=3)

    # features say where frames lie to a quarter of a pixel, grey values say it better
    brightness = panorama.fit_brightness([*chained.links, *further], count, matched.model.view(0), width, height)
    flat = panorama.flatness(brightness, matched.model.view(0), width, height)
    gains = [*np.exp(-brightness.log_gain), *[1.0] * (1 + len(zoomed))]
    images = [*chained.images, *(grey(image) for image in [reference_image, *zoomed])]
    kept = np.empty((len(images), height, width), np.uint16)
    for smooth, image, gain in zip(kept, images, gains, strict=True):
        smooth[:] = stored(image * (flat * np.float32(gain)))
    pairs = dict.fromkeys((link.first, link.second) for link in links)
    fitted = direct.adjust(
        _refined(matched.model), kept, list(pairs), sigmas, prior=_refined(start),
        pixels=config.sweep.pixels, report=lambda done: report("adjust grey values", done, direct.ITERATIONS),
    )  # fmt: skip
    model = fitted.model
    del kept, images

    taken = model.view(count)
    known = replace(first.camera, focal_px=taken.focal_px, principal_px=taken.principal_px, k1=taken.k1)
    refined = reference.resolve(first, known, reference_image, calibration_object, config.reference)
    scale = len(model.pan_rad)  # where the sweep's focal length stands among the unknowns
    camera, surroundings = _measured(model, taken.pan_rad, refined.camera)
    doubt = 0.0 if full_turn else PARTIAL_SCALE_SIGMA
    camera = replace(camera, focal_sigma=float(np.sqrt(fitted.covariance[scale, scale] + doubt**2)))
    sweep_pan_rad = model.pan_rad[:count] - taken.pan_rad  # the reference image's pan is 0
    swept = geometry.view_at(camera, 0.0, camera.tilt_rad, camera.lens.reference_focal_px)
    pasted = panorama.stitch(
        sweep, chained.kept, chained.images, sweep_pan_rad, swept, full_turn, brightness, surroundings,
        lambda done: report("paste sweep", done, 2 * count),
    )  # fmt: skip
    background = replace(
        pasted,
        sweep_inliers=_sweep_inliers(matched, links, count),
        closure_rad=chained.closure_rad,
        residual_px=matched.residual_px,
    )
    aligner = Aligner(background, camera, pixels=config.pixels)
    aligned = aligner.align(reference_image, 0.0, camera.tilt_rad, refined.camera.focal_px, 1.5)
    return Prepared(refined, _counted_from(background, aligned), camera)


def _counted_from(panorama: Panorama, reference: Alignment) -> Panorama:
    """The panorama, its azimuths counted from where the reference image lies on it.

    The adjustment knows that already; but found in the same way as later the pan of every frame, what is wrong with all
    of them alike is not wrong with their difference.
    """
    if reference.agreement < SURE_AGREEMENT:
        return panorama
    origin_px = panorama.origin_px - np.array([reference.pan_rad * panorama.px_per_rad, 0.0])
    return replace(panorama, origin_px=origin_px, sweep_pan_rad=panorama.sweep_pan_rad - reference.pan_rad)


def _measured(model: Model, origin_rad: float, taken: Camera) -> tuple[PanZoomCamera, Surroundings]:
    """The model in metres, as it took the reference image, azimuths from its pan on.

    The floor is where the calibration object stands, at world height 0. Were it elsewhere, offset and distances would
    be wrong by one factor, and what is made of them, their product, would still be right.
    """
    height_m = _height(taken)
    camera = PanZoomCamera(
        model.lens(taken.width, taken.height), np.eye(4), model.tilt_rad, model.roll_rad,
        offset_m=model.offset * height_m, travel_m=model.travel * height_m,
    )  # fmt: skip
    return geometry.mount(taken, camera), _turned(model.surroundings, origin_rad, height_m)


def _height(camera: Camera) -> float:
    """Of a camera over its floor, metres."""
    height_m = float(camera.world_T_cam[2, 3])
    return height_m if height_m > MIN_HEIGHT_M else 1.0


def _turned(hall: Surroundings, origin_rad: float, height_m: float) -> Surroundings:
    """Surroundings in camera heights, in metres and with azimuths from ``origin_rad`` on."""
    around = len(hall.walls)
    place = np.mod(origin_rad / (2 * np.pi), 1.0) * around + np.arange(around)
    below = np.floor(place).astype(np.int64)
    share, below, above = place - below, below % around, (below + 1) % around
    walls = (1 - share) * hall.walls[below] + share * hall.walls[above]
    departures = (1 - share) * hall.departures[:, below] + share * hall.departures[:, above]
    return Surroundings(height_m, walls / height_m, departures, hall.slopes)


def _start(view: View, pan_rad: Array) -> Model:
    count = len(pan_rad)
    return Model(
        pan_rad, np.array([np.log(view.focal_px)]), np.arange(count), np.zeros(count, np.int64), 0.0, 0.0,
        view.principal_px[None], np.array([view.k1]),
        np.zeros(2), 0.0, FAR_AWAY,
    )  # fmt: skip


def _floor_and_walls(view: View, width: int, height: int, rows: int) -> Surroundings:
    """What is believed of a hall before anything is known, in camera heights; its departures at ``rows`` slopes."""
    edge = np.linspace(0, width - 1, 32)
    border = np.array([(u, v) for v in (0.0, height - 1.0) for u in edge])
    _, slope = geometry.look(view, border)
    slopes = np.array([slope.min(), slope.max()])
    return Surroundings(1.0, np.full(NODES[1], WALL_NEARNESS), np.zeros((rows, NODES[1])), slopes)


def _refined(model: Model) -> Model:
    """The model with departures at all NODES, still 0: features are too few to tell them, and the fewer the faster."""
    return replace(model, surroundings=replace(model.surroundings, departures=np.zeros(NODES)))


def _sigmas(camera: Camera, beliefs: BeliefConfig, full_turn: bool, zoom: bool) -> Sigmas:
    # a circle that closes fixes the focal length far better than the calibration object can
    focal = 10.0 * FOCAL_SIGMA if full_turn else FOCAL_SIGMA
    principal = np.full(2 if zoom else 1, beliefs.principal * camera.width)
    k1 = beliefs.k1 * np.array([1.0, 1.0, 0.5] if zoom else [1.0])
    height_m = _height(camera)
    return Sigmas(
        focal, np.deg2rad(beliefs.tilt_deg), principal, k1, beliefs.offset_m / height_m, beliefs.travel_m / height_m
    )


def _padded(coefficients: Array, order: int) -> Array:
    """Polynomial coefficients (p, D) with zeros up to ``order`` terms."""
    return np.vstack([coefficients, np.zeros((order - len(coefficients), coefficients.shape[1]))])


def _detect(image: Image, config: PanZoomConfig) -> Features:
    return features.detect(grey(image), config.sweep.threshold, config.sweep.features, scales=features.FEW_SCALES)


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


def _zoom_frames(zoom: Frames | None, config: PanZoomConfig) -> list[Image]:
    """Some frames of the zoom run, evenly spaced."""
    if zoom is None:
        return []
    count = sum(1 for _ in zoom)
    chosen = set(np.round(np.linspace(0, count - 1, min(count, config.sweep.zoom_frames))).astype(int).tolist())
    return [image for number, (_, image) in enumerate(zoom) if number in chosen]


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
    level = PanZoomCamera(lens, np.eye(4), 0.0, 0.0)
    return Prepared(first, background, geometry.mount(replace(first.camera, k1=0.0), level))
