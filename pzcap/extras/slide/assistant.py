"""From the frames of a pan to what to do with the slide head."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from pzcap.calibration import features
from pzcap.extras.slide.adjustment import Fit, Priors, State, adjust, from_centre, placed, started
from pzcap.extras.slide.near import boxed, moving, nearer
from pzcap.extras.slide.tracks import MIN_TRACKS, Tracks, follow
from pzcap.geometry import camera as geometry
from pzcap.geometry.camera import View
from pzcap.geometry.lens import NONE
from pzcap.imaging.colour import grey
from pzcap.types import Array, Image, Mask, PzcapError

FIELD_WIDTHS = 1.2  # focal length, in image widths, where nobody knows it
LENS_SIGMAS = (0.2, 0.2, 0.01, 0.01, 0.1)  # tilt, roll, principal point (x, y; image widths), k1
OFFSET_SIGMA_M = 0.3  # a camera further off is not on the head
LOOSE_PX, LEAST_SCALE_PX = 4.0, 0.5  # of the robust weights: for sorting; at last
EDGE = 0.03  # image widths about the border of the crew's box, where nobody knows what is near


@dataclass(frozen=True, slots=True)
class SlideConfig:
    threshold: float = 2e-4
    """Of AKAZE's response."""
    features: int = 1500
    """A frame, at most."""
    ratio: float = 0.8
    """Of Lowe's test."""
    frames: int = 12
    """Of the pan, at most."""
    distance_sigma: float = 0.03
    """Of the distances that the crew measured, relative."""
    depth: float = 0.05
    """Depth of the near object; relative standard deviation."""
    far_depth: float = 0.4
    """And what is behind it."""
    focal_sigma: float = 0.3
    """Of log focal."""


@dataclass(frozen=True, slots=True, eq=False)
class Slide:
    """Advice on the slide head."""

    slide_m: Array  # (2,) how far to slide the camera forward and to the left; the parallax is then gone
    covariance_m2: Array  # (2, 2)
    pan_rad: Array  # (F,) of the frames used; the first is 0
    focal_px: float
    residual_px: float  # RMS of one coordinate of the inliers
    tracks: Tracks
    near: Mask  # (T,) on the near object
    far: Mask  # (T,) behind it; what is neither, nobody could tell
    parallax_px: Array  # (T, 2) what each feature moved by, first to last seen, against something far behind it

    @property
    def sigma_m(self) -> Array:
        """(2,) Standard deviations of ``slide_m``."""
        return np.sqrt(np.diag(self.covariance_m2))

    @property
    def aligned(self) -> bool:
        """True where this pan cannot tell the camera's place from the right one."""
        return bool((np.abs(self.slide_m) < 2.0 * self.sigma_m).all())

    @property
    def sentence(self) -> str:
        """The advice in words."""
        parts = [
            f"{1000 * abs(way):.1f} +- {1000 * sigma:.1f} mm {words[int(way < 0)]}"
            for way, sigma, words in zip(
                self.slide_m, self.sigma_m, (("forward", "back"), ("to the left", "to the right")), strict=True
            )
        ]
        advice = "slide the camera " + " and ".join(parts)
        return advice + (" (as far as this pan can tell, it is right already)" if self.aligned else "")


def advise(
    frames: Iterable[Image],
    near_m: float,
    far_m: float,
    *,
    near_box_px: tuple[float, float, float, float] | None = None,
    focal_px: float | None = None,
    config: SlideConfig | None = None,
) -> Slide:
    """Advise on sliding the camera, from the frames (H, W[, 3]) of a short pan.

    ``near_m`` and ``far_m`` are horizontal distances from the head. ``near_box_px`` (left, top, right, bottom) is where
    the near object stands in the middle frame; without it the features are told apart by how they move, and those that
    take up less of the width are taken for the near ones. Some are then mistaken, which the sigmas do not know of: in
    one of thirty draws of a test the error was 3.4 sigmas, with a box never more than 3. Raises PzcapError where too
    little is seen of either, or they cannot be told apart.
    """
    config = config or SlideConfig()
    images = list(frames)
    if len(images) < 3:
        raise PzcapError(f"pan: {len(images)} frames are too few; pan over the near and the far object once")
    chosen = np.unique(np.round(np.linspace(0, len(images) - 1, config.frames)).astype(int))
    height, width = images[0].shape[:2]
    found = [features.detect(grey(images[i]), config.threshold, config.features) for i in chosen]
    focal = FIELD_WIDTHS * width if focal_px is None else focal_px
    view = View(0.0, 0.0, 0.0, focal, np.array([(width - 1) / 2, (height - 1) / 2]), NONE)
    tracks, pan_rad = follow(found, view, config.ratio)
    return solve(tracks, pan_rad, view, width, near_m, far_m, near_box_px=near_box_px, config=config)


def solve(
    tracks: Tracks,
    pan_rad: Array,
    view: View,
    width: int,
    near_m: float,
    far_m: float,
    *,
    near_box_px: tuple[float, float, float, float] | None = None,
    config: SlideConfig | None = None,
) -> Slide:
    """The offset from tracked features, with first values ``pan_rad`` (F,) and ``view``. See `advise`."""
    config = config or SlideConfig()
    if not 0 < near_m <= 0.8 * far_m:
        raise PzcapError(f"near {near_m} m, far {far_m} m: the near object must be much nearer, best less than half")
    count = int(tracks.track.max(initial=-1)) + 1
    if count < 2 * MIN_TRACKS:
        raise PzcapError(f"pan: only {count} features could be followed; pan slowly over things with texture")
    state = started(tracks, pan_rad, view, np.full(count, 1.0 / far_m))
    lens = np.array(LENS_SIGMAS) * np.array([1.0, 1.0, width, width, 1.0])
    sigmas = np.concatenate([[config.focal_sigma], lens, np.full(2, OFFSET_SIGMA_M)])
    scene = _Scene(tracks, near_m, far_m, config, state.shared(), sigmas)
    found = [_sorted_out(scene, *start) for start in _starts(scene, state, near_box_px, EDGE * width)]
    fit, near, far = min(found, key=lambda each: each[0].spread_px)
    # an error of the crew's tape is common to all
    q = np.array([1.0 / near_m, 1.0 / far_m])
    scale = config.distance_sigma * np.hypot(*q) / (q[0] - q[1])
    offset = fit.state.offset_m
    return Slide(
        -offset, fit.covariance + scale**2 * np.outer(offset, offset), fit.state.pan_rad, fit.state.view.focal_px,
        fit.spread_px, tracks, near, far, _parallax(tracks, fit.state, far_m),
    )  # fmt: skip


Groups = tuple[Mask, Mask]  # (T,) near, (T,) far


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    """The tracks, and what is believed before they are looked at."""

    tracks: Tracks
    near_m: float
    far_m: float
    config: SlideConfig
    shared: Array  # (8,) as in `adjustment.State`
    sigmas: Array  # (8,)

    def priors(self, near: Mask, far: Mask) -> Priors:
        nearness = np.where(near, 1.0 / self.near_m, 1.0 / self.far_m)
        deep = nearness * np.where(near, self.config.depth, self.config.far_depth)
        return Priors(self.shared, self.sigmas, nearness, deep, near | far)


def _starts(
    scene: _Scene, state: State, near_box_px: tuple[float, float, float, float] | None, edge_px: float
) -> list[tuple[Fit, Groups, Groups | None]]:
    """Fits as if there were no parallax, the groups that the features then fall into, and what the crew said."""
    everything = np.ones(len(state.points), bool)
    still = np.concatenate([scene.sigmas[:-2], np.full(2, 1e-9)])
    priors = replace(scene.priors(~everything, everything), sigmas=still)
    fit = adjust(scene.tracks, state, priors, LEAST_SCALE_PX)
    if near_box_px is not None:
        said = boxed(fit.state, len(state.pan_rad) // 2, near_box_px, edge_px)
        return [(fit, said, said)]
    # what moves against the rest is near: where about half of the features are, loose weights tell them apart; where
    # few are, tight ones
    fits = [fit, adjust(scene.tracks, state, priors, LOOSE_PX)]
    starts: list[tuple[Fit, Groups, Groups | None]] = [
        (each, groups, None) for each in fits if (groups := moving(each, scene.tracks)) is not None
    ]
    if not starts:
        raise PzcapError(
            "pan: nothing moves clearly against the rest, so near and far cannot be told apart; either the camera "
            "sits right already, or say where the near object stands"
        )
    return starts


def _sorted_out(scene: _Scene, fit: Fit, groups: Groups, said: Groups | None) -> tuple[Fit, Mask, Mask]:
    """Fit and groups by turns, until they agree."""
    between = 0.5 / scene.near_m + 0.5 / scene.far_m
    for _ in range(6):
        fit = _fit(scene, fit, groups, LOOSE_PX)
        again = nearer(scene.tracks, fit, between, said)
        if all((now == before).all() for now, before in zip(again, groups, strict=True)):
            break
        groups = again
    return _fit(scene, fit, groups, LEAST_SCALE_PX), *groups


def _fit(scene: _Scene, before: Fit, groups: Groups, least_scale_px: float) -> Fit:
    _check(*groups)
    priors = scene.priors(*groups)
    return adjust(scene.tracks, placed(before.state, priors), priors, least_scale_px)


def _check(near: Mask, far: Mask) -> None:
    """Raise PzcapError unless enough features of either kind were followed."""
    for count, what in ((int(near.sum()), "near object"), (int(far.sum()), "background")):
        if count < MIN_TRACKS:
            raise PzcapError(
                f"pan: {count} features were followed on the {what}, {MIN_TRACKS} are needed; choose one with more "
                "texture, which passes from one side of the picture to the other, or say where the near object stands"
            )


def _parallax(tracks: Tracks, state: State, far_m: float) -> Array:
    """(T, 2) Where each feature was last seen, minus where it were if it had stood far away when first seen."""
    count = len(state.points)
    order = np.lexsort((tracks.frame, tracks.track))
    first = order[np.searchsorted(tracks.track[order], np.arange(count))]
    last = order[np.searchsorted(tracks.track[order], np.arange(count), side="right") - 1]
    azimuth, slope = geometry.pixel_to_direction(state.view, tracks.points_px[first])
    x, y = np.cos(azimuth) * far_m + state.offset_m[0], np.sin(azimuth) * far_m + state.offset_m[1]
    distance = np.hypot(x, y)
    axis = np.arctan2(y, x) + state.pan_rad[tracks.frame[first]]
    pan = state.pan_rad[tracks.frame[last]]
    seen, _, _ = from_centre(axis, slope * far_m / distance, 1.0 / distance, pan, state.offset_m)
    return tracks.points_px[last] - geometry.direction_to_pixel(state.view, seen[:, 0] - pan, seen[:, 1])[0]
