"""Matching of the frames of a pan sweep, and of single frames with them: first values for bundle adjustment.

The displacements between successive frames of the sweep (AKAZE) give a first chain of pans (section 3.5); in a sweep
of a full turn its end is matched with its beginning, so that the circle closes and fixes the focal length.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pzcap.calibration import features
from pzcap.calibration.bundle_adjustment import Link
from pzcap.calibration.features import Features
from pzcap.calibration.tuning import FEATURES
from pzcap.geometry import camera as geometry
from pzcap.geometry.camera import View
from pzcap.imaging.colour import grey
from pzcap.types import Array, Image, Mask, PzcapError

Frames = Iterable[tuple[int, Image]]
"""Index and image (H, W, 3), as `pzcap.io.video.VideoReader` yields them; iterated more than once."""


@dataclass(frozen=True, slots=True, eq=False)
class MappedFrames:
    """The ``frames`` of a sweep or a zoom run, each changed by ``change`` (index, image)."""

    frames: Frames
    change: Callable[[int, Image], Image]

    def __iter__(self) -> Iterator[tuple[int, Image]]:
        return ((number, self.change(number, image)) for number, image in self.frames)


@dataclass(frozen=True, slots=True)
class SweepConfig:
    """Settings of the matching of sweep and zoom run, and of the panorama."""

    threshold: float = 2e-4
    """Response of AKAZE from which on a feature counts: lower finds more in halls of little texture."""
    features: int = 1000
    """Features a frame, at most, the strongest first."""
    ratio: float = 0.85
    """Lowe's ratio test: distance of the nearest descriptor to that of the second nearest, at most."""
    overlaps: tuple[float, ...] = (0.25, 0.55)
    """Fields of view. Each frame is also matched with those so far on: the longer the lever, the better the scale."""
    min_matches: int = 12
    """Matches between two frames, at least; fewer do not count as a link."""
    zoom_frames: int = 24
    """Frames of the zoom run that are used, at most, evenly spaced."""
    smoothing: float = 0.64
    """Square pixels: variance by which frames are smoothed before their grey values are compared."""
    super_resolve: bool = False
    """Make the panorama that frames are aligned with finer than a pixel: takes some minutes a camera."""
    pixels: int = 700
    """Pixels of two overlapping frames whose grey values are compared, at most: more take longer."""


@dataclass(frozen=True, slots=True, eq=False)
class Chain:
    """The matched frames of a sweep; where it was panned slowly some are left out."""

    kept: NDArray[np.int64]  # (M,) which frames of the video these are
    images: tuple[Image, ...]  # (H, W) grey, a frame
    features: tuple[Features, ...]  # a frame
    pan_rad: Array  # (M,) from the displacements; the first frame's is 0
    links: tuple[Link, ...]
    closure_rad: float  # error of the chain over the full turn; 0 for a partial sweep
    full_turn: bool  # the circle is closed


def chain(frames: Frames, view: View, full_turn: bool, config: SweepConfig, report: Callable[[int], None]) -> Chain:
    """Match each frame of a sweep with the next, and the last with the first; ``view`` is a first guess, at pan 0. Of a
    sweep with gaps the longest part.

    Raises PzcapError where a full turn does not close, or a sweep has a gap and no part of it is long enough.
    """
    found: list[Features] = []
    images: list[Image] = []
    kept: list[int] = []
    links: list[Link] = []
    gaps: list[int] = []  # each after that frame
    pans = [0.0]
    for index, image in frames:
        report(index + 1)
        expected = None
        if len(kept) > 1:
            expected = (pans[-1] - pans[-2]) / (kept[-1] - kept[-2]) * (index - kept[-1])
            moved = abs(expected) * view.focal_px >= FEATURES.least_step * image.shape[1]
            if not moved and index - kept[-1] < FEATURES.most_skipped:
                continue
        kept.append(index)
        images.append(grey(image))
        found.append(detect(images[-1], config))
        last = len(kept) - 1
        if last > 0:
            before = len(links[-1].first_px) if links and last - 1 not in gaps else 0
            link = _link_to_next(found, last - 1, view, expected, before, config)
            if link is None:
                gaps.append(last - 1)
                pans.append(pans[-1] + (expected or 0.0))
            else:
                links.append(link)
                pans.append(pans[-1] + _turn(link, view))
    if len(found) < 3:
        raise PzcapError(f"sweep: {len(found)} frames are too few; record the whole pan")
    chained = Chain(np.array(kept), tuple(images), tuple(found), np.array(pans), tuple(links), 0.0, False)
    seam = _seam(chained, view, config) if full_turn else []
    if gaps:
        return _longest_part(chained, gaps, seam, view)
    return _closed(chained, seam, view) if full_turn else chained


def _longest_part(chained: Chain, gaps: Sequence[int], seam: Sequence[Link], view: View) -> Chain:
    """The longest part of a sweep, across whose ``gaps``, each after a frame, nothing is seen twice: before a bare
    wall, as a rule. There the circle does not close; beginning and end of a full turn are one part, by the links of
    their ``seam``.

    Raises PzcapError where all parts are short.
    """
    parts = np.split(np.arange(len(chained.kept)), np.array(gaps) + 1)
    first, last, pan_rad = parts[0], parts[-1], chained.pan_rad.copy()
    seam = [link for link in seam if link.first in first and link.second in last]
    if seam:
        pan_rad[first] += np.median([pan_rad[link.second] - pan_rad[link.first] - _turn(link, view) for link in seam])
        parts = [np.concatenate([first, last]), *parts[1:-1]]
    part = max(parts, key=lambda numbers: float(np.ptp(pan_rad[numbers])))
    if np.ptp(pan_rad[part]) < FEATURES.least_part_rad:
        before, after = chained.kept[gaps[0] : gaps[0] + 2]
        raise PzcapError(f"sweep: frames {before} and {after} show nothing in common; pan more slowly, past texture")
    place = {number: k for k, number in enumerate(part.tolist())}
    links = [
        replace(link, first=place[link.first], second=place[link.second])
        for link in (*chained.links, *seam)
        if link.first in place and link.second in place
    ]
    images, found = (tuple(each[number] for number in part) for each in (chained.images, chained.features))
    pan_rad = pan_rad[part] - pan_rad[part[0]]
    return Chain(chained.kept[part], images, found, pan_rad, tuple(links), 0.0, False)


def held_by_few(chained: Chain, config: SweepConfig) -> set[int]:
    """Frames of a sweep that so few matches hold to the next that these may be chance."""
    sure = FEATURES.sure_links * config.min_matches
    return {link.first for link in chained.links if link.second == link.first + 1 and len(link.first_px) < sure}


def without_links(chained: Chain, wrong: Container[int], view: View) -> Chain:
    """The longest part of a sweep after the links of the frames that are ``wrong`` to the next are taken out of it.

    Raises PzcapError where all parts are short.
    """
    beside = [one for one in chained.links if one.second == one.first + 1 and one.first not in wrong]
    seam = [one for one in chained.links if one.second > one.first + 1]
    gaps = np.setdiff1d(np.arange(len(chained.kept) - 1), [one.first for one in beside]).tolist()
    return _longest_part(replace(chained, links=tuple(beside)), gaps, seam, view)


def _link_to_next(
    found: Sequence[Features], first: int, view: View, expected: float | None, before: int, config: SweepConfig
) -> Link | None:
    """`link_pan` of a frame and the next. Where few matches are near what is ``expected``, few also beside the link
    ``before``, the pan may have stopped, started or turned back, and these be chance: then by those of any pan, if they
    are more."""
    link = link_pan(found, first, first + 1, view, expected, config)
    sure = max(FEATURES.sure_links * config.min_matches, FEATURES.sure_share * before)
    if expected is None or (link is not None and len(link.first_px) >= sure):
        return link
    anywhere = link_pan(found, first, first + 1, view, None, config)
    return max(link, anywhere, key=lambda one: 0 if one is None else len(one.first_px))


def detect(image: Image, config: SweepConfig) -> Features:
    """Features of a frame (H, W[, 3]) of sweep or zoom run, or of the reference image; fainter ones where it shows
    few, as before a bare wall."""
    image = grey(image)
    found = features.detect(image, config.threshold, config.features, scales=FEATURES.few_scales)
    if len(found) >= FEATURES.few:
        return found
    return features.detect(image, FEATURES.faint * config.threshold, config.features, scales=FEATURES.few_scales)


def link_further(found: Sequence[Features], views: Sequence[View], width: int, config: SweepConfig) -> list[Link]:
    """Links of each frame of a sweep, its ``views`` known roughly, with those ``config.overlaps`` of a field of view
    on: the longer the lever, the better are the shape of the lens and the sum of the pans known."""
    field = 2 * np.arctan(width / 2 / views[0].focal_px)
    pan = np.array([view.pan_rad for view in views])
    links = []
    for overlap in config.overlaps:
        for first in range(len(pan) - 2):
            beyond = np.flatnonzero(np.abs(pan[first + 2 :] - pan[first]) >= overlap * field)
            if len(beyond):
                second = first + 2 + int(beyond[0])
                links.append(link_views(found, first, second, (views[first], views[second]), 16.0, config))
    return [link for link in links if link is not None]


def link_pan(
    found: Sequence[Features], first: int, second: int, view: View, expected: float | None, config: SweepConfig
) -> Link | None:
    """Match two frames by one pan, near ``expected`` if that is given; None if too few matches agree."""
    near = None
    if expected is not None:
        directions = geometry.pixel_to_direction(view, found[first].points_px)
        predicted, _ = geometry.direction_to_pixel(replace(view, pan_rad=view.pan_rad + expected), *directions)
        reach = 24.0 + 0.1 * abs(expected) * view.focal_px  # tilt, roll and distortion are unknown as yet
        near = (predicted, reach)
    pairs = features.match(found[first], found[second], config.ratio, near)
    if len(pairs) < config.min_matches:
        return None
    link = _link(found, first, second, pairs)
    azimuth_a, slope_a = geometry.pixel_to_direction(view, link.first_px)
    azimuth_b, slope_b = geometry.pixel_to_direction(view, link.second_px)
    turn = azimuth_a - azimuth_b
    if expected is None:
        agree = features.densest(turn, 8.0 / view.focal_px)
        agree = np.abs(turn - np.median(turn[agree])) < 16.0 / view.focal_px
    else:
        agree = np.abs(turn - expected) < reach / view.focal_px
    if agree.any():
        agree &= np.abs(slope_a - slope_b) < 0.03 + 0.2 * abs(float(np.median(turn[agree])))
    return link.subset(agree) if agree.sum() >= config.min_matches else None


def _seam(chained: Chain, view: View, config: SweepConfig) -> list[Link]:
    """Links across the seam of a full turn, between its beginning and its end."""
    found, pan = chained.features, chained.pan_rad
    field, turn = 2 * np.arctan(chained.images[0].shape[1] / 2 / view.focal_px), _full_turn(pan)
    apart = np.abs(pan[None, :] - pan[:, None] - turn)
    firsts, seconds = np.nonzero((apart < 0.75 * field) & (np.arange(len(pan))[:, None] < np.arange(len(pan))))
    order = np.argsort(apart[firsts, seconds], kind="stable")
    seam: list[Link] = []
    misses: list[float] = []
    for which in order[:: max(1, len(order) // 40)]:
        first, second = int(firsts[which]), int(seconds[which])
        chained_rad = float(pan[second] - pan[first])
        expected = chained_rad - turn - float(np.median(misses)) if misses else None
        link = link_pan(found, first, second, view, expected, config)
        if link is not None and len(link.first_px) >= 2 * config.min_matches:
            seam.append(link)
            misses.append(chained_rad - turn - _turn(link, view))
    return seam


def _closed(chained: Chain, seam: Sequence[Link], view: View) -> Chain:
    """A full turn with the links of its ``seam``, the closure error distributed over the pans.

    Raises PzcapError where there are none.
    """
    if not seam:
        raise PzcapError(
            "sweep: its end does not show what its beginning showed, so the circle cannot close; "
            "pan a little more than a full turn, or say that it is a partial sweep"
        )
    pan, turn = chained.pan_rad, _full_turn(chained.pan_rad)
    closure = float(np.median([pan[link.second] - pan[link.first] - turn - _turn(link, view) for link in seam]))
    pan_rad, links = pan * (turn / (turn + closure)), (*chained.links, *seam)
    return replace(chained, pan_rad=pan_rad, links=links, closure_rad=closure, full_turn=True)


def _full_turn(pan_rad: Array) -> float:
    """A turn the way that a sweep goes, at ``pan_rad`` (M,)."""
    return float(np.sign(pan_rad[-1])) * 2 * np.pi


def _turn(link: Link, view: View) -> float:
    """Pan of the second frame minus that of the first: the median over the matches."""
    first, second = (geometry.pixel_to_direction(view, points)[0] for points in (link.first_px, link.second_px))
    return float(np.median(first - second))


def consensus(
    view_at: Callable[[float], View], points_px: Array, azimuth_rad: Array, slope: Array, focals_px: Array, *,
    free_tilt: bool = False,
) -> tuple[float, float, Mask]:  # fmt: skip
    """Find the pan and the focal length, of those proposed, on which most matches agree, and these matches (N,).

    ``view_at`` gives the view of a focal length at pan 0, where one match determines the pan and its slope tells
    whether it fits. Every match votes under every focal length, and the densest cluster of pans wins: exhaustive RANSAC
    (Fischler and Bolles, 1981). With ``free_tilt`` the slopes of the cluster may share an offset.
    """
    best, winner = np.zeros(len(points_px), bool), (0.0, float(focals_px[0]))
    for focal in focals_px:
        seen_azimuth, seen_slope = geometry.pixel_to_direction(view_at(float(focal)), points_px)
        off = seen_slope - slope
        fits = np.arange(len(off)) if free_tilt else np.flatnonzero(np.abs(off) < 5.0 / focal)
        if len(fits) <= best.sum():
            continue
        pans = np.mod(azimuth_rad - seen_azimuth, 2 * np.pi)[fits]
        both = np.concatenate([pans, pans + 2 * np.pi])  # a cluster may lie across 0
        cluster = features.densest(both, 8.0 / float(focal))
        agree = np.zeros(len(points_px), bool)
        agree[fits] = cluster[: len(fits)] | cluster[len(fits) :]
        if free_tilt:
            level = features.densest(off[agree], 10.0 / float(focal))
            agree[np.flatnonzero(agree)[~level]] = False
        if agree.sum() > best.sum():
            best, winner = agree, (float(np.median(both[cluster])), float(focal))
    return *winner, best


def place(
    query: Features, known: Features, taken: View, view: View, focals_px: Array, ratio: float
) -> tuple[float, float, int]:
    """Estimate pan and focal length of a frame from matches with a ``known`` one, ``taken`` with a view; and the number
    of inliers. But for the focal length ``view`` is the frame's at pan 0."""
    pairs = features.match(known, query, ratio)
    if len(pairs) < 2:
        return 0.0, taken.focal_px, 0
    azimuth, slope = geometry.pixel_to_direction(taken, known.points_px[pairs[:, 0]])
    points_px = query.points_px[pairs[:, 1]]
    pan, focal, agree = consensus(lambda f: replace(view, focal_px=f), points_px, azimuth, slope, focals_px)
    return pan, focal, int(agree.sum())


def link_views(
    found: Sequence[Features], first: int, second: int, views: tuple[View, View], tolerance_px: float,
    config: SweepConfig,
) -> Link | None:  # fmt: skip
    """Match two frames whose views are known roughly; None if too few matches lie within ``tolerance_px`` of them."""
    directions = geometry.pixel_to_direction(views[0], found[first].points_px)
    predicted, front = geometry.direction_to_pixel(views[1], *directions)
    pairs = features.match(found[first], found[second], config.ratio, (predicted, tolerance_px))
    link, matched = _link(found, first, second, pairs), pairs[:, 0]
    agree = front[matched] & (np.hypot(*(predicted[matched] - link.second_px).T) < tolerance_px)
    return link.subset(agree) if agree.sum() >= config.min_matches else None


def spaced(pan_rad: Array, step_rad: float) -> list[int]:
    """Indices of frames at least ``step_rad`` apart, from the first on."""
    chosen = [0]
    for index, pan in enumerate(pan_rad):
        if abs(pan - pan_rad[chosen[-1]]) >= step_rad:
            chosen.append(index)
    return chosen


def _link(found: Sequence[Features], first: int, second: int, pairs: NDArray[np.int64]) -> Link:
    a, b = found[first], found[second]
    i, j = pairs[:, 0], pairs[:, 1]
    log_ratio = np.log(np.maximum(b.brightness[j], 1.0) / np.maximum(a.brightness[i], 1.0))
    return Link(first, second, a.points_px[i], b.points_px[j], log_ratio)
