"""Correspondences between all frames of one camera in the empty hall, and first values of its parameters.

The sweep's frames are chained; the reference image and the zoom run are then placed among them. Unlike a sweep, the
zoom run, the head locked and the focal length going through its range, shows the principal point, towards which
everything moves, and how the lens changes with the zoom. From these first values the bundle adjustments start
(`pzcap.calibration.bundle_adjustment`, `pzcap.calibration.photometric_bundle_adjustment`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pzcap.calibration.agreement import torn
from pzcap.calibration.beliefs import BeliefConfig, Sigmas
from pzcap.calibration.bundle_adjustment import Link, adjust, enough
from pzcap.calibration.features import Features
from pzcap.calibration.parameters import CalibrationParameters
from pzcap.calibration.settings import PanZoomConfig
from pzcap.calibration.sweep import (
    Chain,
    Frames,
    chain,
    detect,
    held_by_few,
    link_further,
    link_views,
    place,
    spaced,
    without_links,
)
from pzcap.calibration.tuning import BELIEF, HALL, ZOOM
from pzcap.geometry import camera as geometry
from pzcap.geometry.camera import HIGHER, View
from pzcap.geometry.lens import NONE
from pzcap.imaging.colour import grey
from pzcap.types import FAR_AWAY, Array, Camera, Image, InverseDepthMap, PzcapError


@dataclass(frozen=True, slots=True, eq=False)
class Matched:
    """The sweep's frames, the reference image and some frames of the zoom run, in this order."""

    chained: Chain
    other_images: list[Image]  # grey: the reference image, then the frames of the zoom run
    zoom_numbers: list[int]  # where the latter stand in the run
    sweep_links: list[Link]  # between frames of the sweep
    links: list[Link]  # these and all others
    start: CalibrationParameters  # first values
    sigmas: Sigmas
    object_px: float | None = None  # focal length of the reference image, as the calibration object shows it by itself
    up: Callable[[View], Array] | None = None  # (3,) the way up in the reference image, by the lens of a view


def match(
    camera: Camera, reference_image: Image, sweep: Frames, zoom: Frames | None, full_turn: bool, config: PanZoomConfig,
    report: Callable[[str, int, int], None],
) -> Matched:  # fmt: skip
    """Chain the sweep, and place the reference image (taken by ``camera``) and the zoom run on it.

    Raises PzcapError where the sweep does not hold together, or shows nothing of what the reference image does.
    """
    height, width = reference_image.shape[:2]
    view = View(0.0, 0.0, 0.0, camera.focal_px, camera.principal_px, NONE)
    chained = chain(sweep, view, full_turn, config.sweep, lambda done: report("match sweep", done, 0))
    chained, coarse, sweep_links = _linked(chained, view, camera, width, config)
    count = len(chained.pan_rad)
    found = [*chained.features, detect(reference_image, config.sweep)]
    pan, links = _place_reference(found, coarse, width, config)
    links = [*sweep_links, *links]
    pans, focals = [*coarse.pan_rad, pan], [coarse.log_focal[0]] * 2
    pan_of, focal_of = [*range(count), count], [0] * count + [1]
    chosen = _zoom_frames(zoom, config)
    zoomed = [image for _, image in chosen]
    if zoomed:
        for done, image in enumerate(zoomed):
            report("match zoom run", done, len(zoomed) + 1)
            found.append(detect(image, config.sweep))
        pan, focals_px, zoom_links = _place_zoom(found, count + 1, coarse, width, config)
        report("match zoom run", len(zoomed) + 1, len(zoomed) + 1)
        links += zoom_links
        pans.append(pan)
        focals += list(np.log(focals_px))
        pan_of += [count + 1] * len(zoomed)
        focal_of += list(range(2, 2 + len(zoomed)))
    start = CalibrationParameters(
        np.array(pans), np.array(focals), np.array(pan_of), np.array(focal_of), coarse.tilt_rad, coarse.roll_rad,
        np.pad(coarse.principal_px, ((0, 1 if zoomed else 0), (0, 0))), np.pad(coarse.k1, (0, 2 if zoomed else 0)),
        np.zeros(HIGHER), coarse.offset, 0.0, _floor_and_walls(coarse.view(0), width, height, 2),
    )  # fmt: skip
    others = [grey(image) for image in [reference_image, *zoomed]]
    sigmas = sigmas_of(camera, config.beliefs, chained.full_turn, bool(zoomed))
    return Matched(chained, others, [number for number, _ in chosen], sweep_links, links, start, sigmas)


def _linked(
    chained: Chain, view: View, camera: Camera, width: int, config: PanZoomConfig
) -> tuple[Chain, CalibrationParameters, list[Link]]:
    """The sweep that is ``chained``, first values of its parameters, and all its links. Where the few matches that hold
    a frame to the next contradict all others, as chance ones before a bare wall do, it is cut: its longest part.

    Raises PzcapError where all parts are short.
    """
    while True:
        count, few = len(chained.pan_rad), held_by_few(chained, config.sweep)
        sigmas = sigmas_of(camera, config.beliefs, chained.full_turn, zoom=False)
        coarse = adjust(first_values(view, chained.pan_rad), enough(chained.links), sigmas, iterations=6).parameters
        further = link_further(chained.features, [coarse.view(i) for i in range(count)], width, config.sweep)
        links = [*chained.links, *further]
        wrong = few.intersection(torn(adjust(coarse, links, sigmas, iterations=6), links, count)) if few else few
        if not wrong:
            return chained, coarse, links
        chained = without_links(chained, wrong, view)


def first_values(view: View, pan_rad: Array) -> CalibrationParameters:
    """First values of the parameters of a chained sweep: one lens, that of ``view``, and nothing near."""
    count = len(pan_rad)
    return CalibrationParameters(
        pan_rad, np.array([np.log(view.focal_px)]), np.arange(count), np.zeros(count, np.int64), 0.0, 0.0,
        view.principal_px[None], np.array([view.distortion.k1]), np.zeros(HIGHER), np.zeros(2), 0.0,
        FAR_AWAY,
    )  # fmt: skip


def _floor_and_walls(view: View, width: int, height: int, rows: int) -> InverseDepthMap:
    """The prior mean of the hall's inverse distances, in camera heights, with departures at ``rows`` slopes."""
    border = np.stack(np.meshgrid(np.linspace(0, width - 1, 32), [0.0, height - 1.0]), axis=-1)
    _, slope = geometry.pixel_to_direction(view, border)
    slopes = np.array([slope.min(), slope.max()])
    return InverseDepthMap(1.0, np.full(HALL.azimuths, HALL.wall_nearness), np.zeros((rows, HALL.azimuths)), slopes)


def sigmas_of(camera: Camera, beliefs: BeliefConfig, full_turn: bool, zoom: bool) -> Sigmas:
    """Prior standard deviations of the parameters of a camera and its hall."""
    # a closed circle fixes the focal length far better than the calibration object does
    focal = 10.0 * BELIEF.focal_sigma if full_turn else BELIEF.focal_sigma
    principal = np.full(2 if zoom else 1, beliefs.principal * camera.width)
    k1 = beliefs.k1 * np.array([1.0, 1.0, 0.5] if zoom else [1.0])
    offset, travel = np.array([beliefs.offset_m, beliefs.travel_m]) / height_of(camera)
    higher = BELIEF.usual_lens * np.array([beliefs.k2, beliefs.decentring, beliefs.decentring])
    return Sigmas(focal, np.deg2rad(beliefs.tilt_deg), principal, k1, higher, float(offset), float(travel))


def _place_reference(
    found: Sequence[Features], sweep: CalibrationParameters, width: int, config: PanZoomConfig
) -> tuple[float, list[Link]]:
    """Find the pan of the reference image, the last of ``found``, and its links to the frames of the sweep."""
    view = sweep.view(0)
    field = 2 * np.arctan(width / 2 / view.focal_px)
    pan, focal, agreed = _place_on_sweep(found[-1], found, sweep, 0.3 * field, np.arange(-0.1, 0.101, 0.01), config)
    seen = replace(view, pan_rad=pan, focal_px=focal)
    links = _link_to_sweep(found, len(found) - 1, sweep, seen, field * np.arange(-0.6, 0.61, 0.1), config)
    if agreed < config.sweep.min_matches or not links:
        raise PzcapError("reference image: it shows nothing of what the sweep showed; sweep past the reference pose")
    return pan, links


def _place_zoom(
    found: Sequence[Features], offset: int, sweep: CalibrationParameters, width: int, config: PanZoomConfig
) -> tuple[float, Array, list[Link]]:
    """Find the pan of the zoom run, frames ``found[offset:]``, their focal lengths, and their links to each other and
    to the sweep. Raises PzcapError if it shows nothing of the sweep."""
    zoomed, view = found[offset:], sweep.view(0)
    field = 2 * np.arctan(width / 2 / view.focal_px)
    low, high = np.log(config.zoom_range)
    every = np.arange(low, high, 0.02)
    best, anchor, pan, focal = 0, 0, 0.0, view.focal_px
    for k in dict.fromkeys((len(zoomed) // 4, len(zoomed) // 2, 0, 3 * len(zoomed) // 4, len(zoomed) - 1)):
        candidate = _place_on_sweep(zoomed[k], found, sweep, 0.4 * field, every, config)
        if candidate[2] > best:
            (pan, focal, best), anchor = candidate, k
        if best >= ZOOM.sure_matches:
            break
    if best < 2 * config.sweep.min_matches:
        raise PzcapError(
            "zoom run: it shows nothing of what the sweep showed; record it with the head locked in between"
        )

    locked, focals = replace(view, pan_rad=pan), np.zeros(len(zoomed))
    focals[anchor] = focal
    for direction, order in ((1, range(anchor + 1, len(zoomed))), (-1, range(anchor - 1, -1, -1))):
        for k in order:
            before = replace(locked, focal_px=focals[k - direction])
            near = before.focal_px * np.exp(np.arange(-0.4, 0.401, 0.01))
            _, focals[k], agreed = place(zoomed[k], zoomed[k - direction], before, view, near, config.sweep.ratio)
            if agreed < config.sweep.min_matches:
                raise PzcapError(
                    f"zoom run: it jumps near {k / len(zoomed):.0%} of its length; zoom slowly, head locked"
                )
    views = [replace(locked, focal_px=focal_px) for focal_px in focals]
    links: list[Link] = []
    for k, seen in enumerate(views):
        for further in [k + step for step in ZOOM.steps if k + step < len(zoomed)]:
            link = link_views(found, offset + k, offset + further, (seen, views[further]), 12.0, config.sweep)
            links += [] if link is None else [link]
        links += _link_to_sweep(found, offset + k, sweep, seen, field * np.array(ZOOM.spread), config)
    return pan, focals, links


def _place_on_sweep(
    query: Features, found: Sequence[Features], sweep: CalibrationParameters, step_rad: float, log_zooms: Array,
    config: PanZoomConfig,
) -> tuple[float, float, int]:  # fmt: skip
    """`place` of a frame by that of the sweep's frames, ``step_rad`` apart, with which most matches agree."""
    view = sweep.view(0)
    focals = view.focal_px * np.exp(log_zooms)
    placed = (
        place(query, found[index], sweep.view(index), view, focals, config.sweep.ratio)
        for index in spaced(sweep.pan_rad, step_rad)
    )
    return max(placed, key=lambda one: one[2])


def _link_to_sweep(
    found: Sequence[Features], number: int, sweep: CalibrationParameters, seen: View, beside_rad: Array,
    config: PanZoomConfig,
) -> list[Link]:  # fmt: skip
    """Links of a frame, ``seen`` from a view, to the frames of the sweep that stand ``beside_rad`` (N,) of it."""
    links = []
    for beside in beside_rad:
        index = int(np.argmin(np.abs(geometry.wrapped(sweep.pan_rad - seen.pan_rad - beside))))
        links.append(link_views(found, index, number, (sweep.view(index), seen), 12.0, config.sweep))
    return [link for link in links if link is not None]


def _zoom_frames(zoom: Frames | None, config: PanZoomConfig) -> list[tuple[int, Image]]:
    """Some frames of the zoom run, evenly spaced, with their numbers."""
    if zoom is None:
        return []
    count = sum(1 for _ in zoom)
    chosen = set(np.round(np.linspace(0, count - 1, min(count, config.sweep.zoom_frames))).astype(int).tolist())
    return [frame for number, frame in enumerate(zoom) if number in chosen]


def height_of(camera: Camera) -> float:
    """Height of a camera over the floor, metres; 1 where it stands on no floor."""
    height_m = float(camera.world_T_cam[2, 3])
    return height_m if height_m > HALL.min_height_m else 1.0
