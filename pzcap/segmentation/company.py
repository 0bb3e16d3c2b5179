"""Other people in the hall, found by all views together: where they stand on its floor, and what they hide.

One view cannot tell somebody who stands before or behind the athlete, dressed alike, from the athlete; but others of
the views see the two apart. A person may stand at a place of the floor if every view that shows it has foreground in
the middle of such a person, and in more than one view of that is what the athlete is not expected to cover. Foreground
where others stand is unknown: it may be theirs. And of the athlete nothing is seen through who is nearer to the camera.

Whole views are looked at, at a low resolution. Three views have to show the place: rays of two people may meet by
chance, of three hardly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final
from weakref import WeakKeyDictionary

import cv2
import numpy as np

from pzcap.geometry.camera import at
from pzcap.geometry.pinhole import projected
from pzcap.localisation.panorama_sampler import place_of, warp_background
from pzcap.segmentation.background_model import ForegroundConfig, compare, shrink
from pzcap.segmentation.expected import Expected
from pzcap.segmentation.foreground import match_gain
from pzcap.segmentation.others import BEFORE, BESIDE
from pzcap.segmentation.tuning import COMPANY, OTHERS
from pzcap.types import Array, Camera, Image, Localisation, Mask, Panorama, PanZoomCamera, Silhouette


@dataclass(frozen=True, slots=True, eq=False)
class WholeView:
    """Everybody who is seen in a view, and where the athlete may be."""

    camera: Camera
    foreground: Mask  # (h, w)
    athlete: Mask  # (h, w) pixels that the athlete may cover
    scale: int  # pixels of the view to a pixel of the masks
    expected: Expected
    pelvis_m: Array  # (3,) of the athlete


def whole_view(
    image: Image, panorama: Panorama, camera: PanZoomCamera, localisation: Localisation, config: ForegroundConfig,
    expected: Expected,
) -> WholeView | None:  # fmt: skip
    """Who is seen in a view that was found on its ``panorama``. None where the athlete, who is ``expected`` in it, is
    lost: nobody can be told from the athlete then."""
    if expected.pelvis_m is None:
        return None
    every = max(round(image.shape[1] / COMPANY.columns), 1)
    place = place_of(localisation)
    coarser = max(round(every * panorama.px_per_rad / place.focal_px), 1)
    frame = shrink(image, every)
    hall, known = warp_background(_shrunk(panorama, coarser), camera, place, every=every)
    hall = match_gain(frame, hall, known, COMPANY.gain_px)
    view = at(camera, *place[:4])
    seen = replace(
        view, width=frame.shape[1], height=frame.shape[0], focal_px=view.focal_px / every,
        principal_px=(view.principal_px + 0.5) / every - 0.5,
    )  # fmt: skip
    odds = compare(frame, hall, known, seen, (0, 0), COMPANY.blur_px, config).log_odds()
    foreground = cv2.blur(np.maximum(odds, COMPANY.least_log_odds), (3, 3)) > 0.0
    athlete = _covered(expected, 2 * every, foreground.shape)
    return WholeView(view, foreground, athlete, 2 * every, expected, expected.pelvis_m)


_SHRUNK: Final[WeakKeyDictionary[Panorama, dict[int, Panorama]]] = WeakKeyDictionary()


def _shrunk(panorama: Panorama, by: int) -> Panorama:
    """A panorama at so many times less the resolution. It is kept as long as the panorama is."""
    kept = _SHRUNK.setdefault(panorama, {})
    if by not in kept:
        kept[by] = _shrink(panorama, by)
    return kept[by]


def _shrink(panorama: Panorama, by: int) -> Panorama:
    valid = shrink(panorama.valid.astype(np.float32), by) > 0.99
    origin = (panorama.origin_px + 0.5) / by - 0.5
    return replace(
        panorama, image=shrink(panorama.image, by), valid=valid, px_per_rad=panorama.px_per_rad / by, origin_px=origin
    )


def _covered(expected: Expected, scale: int, shape: tuple[int, ...]) -> Mask:
    """The pixels, ``scale`` of the view's each, that the athlete may cover."""
    reach_px = OTHERS.apart_px + OTHERS.apart_sigmas * expected.sigma_px
    near = (expected.distance_px > -reach_px).astype(np.uint8)
    corner = 0.5 * (scale - 2) - np.array([expected.left, expected.top])  # of the first pixel, half pixels are 2
    to_window = np.column_stack([0.5 * scale * np.eye(2), 0.5 * corner])
    flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
    return cv2.warpAffine(near, to_window, shape[::-1], flags=flags).view(np.bool_)


def others_on_floor(views: Sequence[WholeView]) -> Array:
    """(N, 2) Where others stand about the athlete, metres, as the ``views`` of an instant show them together."""
    if sum(bool((view.foreground & ~view.athlete).any()) for view in views) < 2:
        return np.zeros((0, 2))
    steps = np.arange(-COMPANY.range_m, COMPANY.range_m + COMPANY.step_m / 2, COMPANY.step_m)
    apart = np.stack(np.meshgrid(steps, steps), axis=-1)
    near = np.hypot(apart[..., 0], apart[..., 1]) < COMPANY.range_m
    places = views[0].pelvis_m[:2] + apart[near]
    filled, others = np.stack([_shares(view, places) for view in views], axis=1)  # (C, N) each
    shown = np.isfinite(filled)
    apart_in = np.where(shown, others, 0.0).sum(axis=0)
    possible = (np.where(shown, filled, 1.0).min(axis=0) > COMPANY.filled) & (apart_in > COMPANY.views_apart)
    possible &= shown.sum(axis=0) >= min(COMPANY.least_views, len(views))
    weight = np.where(possible, apart_in, 0.0)
    grid = np.zeros(near.shape, np.uint8)
    grid[near] = possible
    count, labels = cv2.connectedComponents(grid, connectivity=8)
    total, *sums = (np.bincount(labels[near], each, count)[1:] for each in (weight, *(weight * places.T)))
    return np.column_stack(sums) / total[:, None]


def _shares(view: WholeView, places: Array) -> tuple[Array, Array]:
    """Shares (N,) of the middle of a person at each of ``places`` (N, 2) that are foreground, and foreground that the
    athlete does not cover; NaN where the view shows too little of such a person."""
    ends = (np.column_stack([places, np.full(len(places), each)]) for each in (COMPANY.hips_m, COMPANY.head_m))
    (hips, depth), (head, _) = (projected(each, view.camera) for each in ends)
    half = COMPANY.half_width_m * view.camera.focal_px / np.maximum(depth, COMPANY.nearest_m)
    low = np.column_stack([hips[:, 0] - half, head[:, 1]]) / view.scale
    high = np.column_stack([hips[:, 0] + half, hips[:, 1]]) / view.scale
    (left, top), (right, bottom) = (
        np.clip(np.rint(each), 0, view.foreground.shape[::-1]).astype(np.int64).T for each in (low, high)
    )
    area = (right - left) * (bottom - top)
    shown = (depth > COMPANY.nearest_m) & (area > 0) & (area >= COMPANY.least_shown * np.prod(high - low, axis=1))

    def share(mask: Mask) -> Array:
        sums = cv2.integral(mask.view(np.uint8))
        inside = sums[bottom, right] - sums[top, right] - sums[bottom, left] + sums[top, left]
        return np.where(shown, inside / np.maximum(area, 1), np.nan)

    return share(view.foreground), share(view.foreground & ~view.athlete)


def with_others(silhouette: Silhouette, view: WholeView, places: Array) -> Silhouette:
    """The ``silhouette`` of a view in which others stand at ``places`` (N, 2): what is foreground there is unknown.
    Limbs of those who are within reach are both before and behind the athlete's: they take nothing that is expected to
    be the athlete's."""
    evidence, others = silhouette.evidence.copy(), silhouette.others.copy()
    centre = view.camera.world_T_cam[:2, 3]
    away = np.linalg.norm(view.pelvis_m[:2] - centre)
    people = (silhouette.evidence > 0.0) | (silhouette.others > 0)
    outside = people & ~view.expected.within(OTHERS.beside_px, people.shape)
    for place in places:
        outline = _outline(view.camera, place)
        if outline is None:
            continue
        covered = np.zeros(evidence.shape, np.uint8)
        cv2.fillPoly(covered, [outline], 1)
        within_reach = np.linalg.norm(place - view.pelvis_m[:2]) < COMPANY.reach_m
        before = not within_reach and np.linalg.norm(place - centre) < away
        theirs = (covered > 0) & (outside if within_reach else people)
        others[theirs] = np.maximum(others[theirs], BEFORE if before else BESIDE)
        evidence[theirs] = 0.0
    return replace(silhouette, evidence=evidence, others=others)


def _outline(camera: Camera, place: Array) -> Array | None:
    """(K, 2) Outline of anybody who stands or walks at a ``place`` (2,), half pixels; None where that is not before the
    camera."""
    height, half_m = np.array(COMPANY.profile_m).T
    pixels, depth = projected(np.column_stack([np.tile(place, (len(height), 1)), height]), camera)
    if depth.min() < COMPANY.nearest_m:
        return None
    half = np.outer(half_m * camera.focal_px / depth, [1.0, 0.0])
    return np.rint(np.vstack([pixels - half, (pixels + half)[::-1]]) / 2.0).astype(np.int32)
