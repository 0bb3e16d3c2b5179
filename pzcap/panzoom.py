"""Pan and zoom of a frame, from its matches with the panorama (section 4).

`Localiser` takes one of two ways. ``paper`` unfolds the frame onto the reference cylinder and solves the linear system
of eq. 15, the paper's final solution. ``exact`` solves eq. 11 for the calibrated camera: the residual of a match is
where the panorama's point would be seen in the frame, minus where it was seen, in pixels of the frame, minimised over
pan and log focal with all of tilt, roll, principal point and distortion in place. Then `pzcap.align` refines it; and
where the frame before is known, the alignment alone is enough.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from pzcap import camera as geometry
from pzcap import cylinder, features
from pzcap.align import Aligner, Alignment
from pzcap.camera import View
from pzcap.features import Features
from pzcap.reference import ReferenceConfig
from pzcap.sweep import SweepConfig, consensus, grey
from pzcap.types import Array, Image, Lens, Localisation, Mask, Panorama, PanZoomCamera, PzcapError
from pzcap.unknowns import BeliefConfig

METHODS = ("exact", "paper")
FEWEST = 2  # matches that agree: a place to look at
WRAP = 64  # columns of a full turn repeated at its ends, for features on the seam


@dataclass(frozen=True, slots=True)
class PanZoomConfig:
    method: str = "exact"  # or "paper": no distortion, no tilt, stops at eq. 15
    free_tilt: bool = False  # the heads were tilted while the motion was recorded, too
    threshold: float = 1e-4  # of AKAZE's response
    frame_features: int = 1000
    panorama_features: int = 12000
    ratio: float = 0.85  # of Lowe's test
    zoom_range: tuple[float, float] = (0.5, 5.0)  # searched where nothing is known, relative to the reference
    search_deg: float = 8.0  # beyond the frame's edges, where the frame before is known
    min_inliers: int = 12
    sure_agreement: float = 0.85  # of an alignment (see `align.Alignment`) alone, or features are asked
    min_agreement: float = 0.5  # of one that features led to
    max_pan_sigma_deg: float = 0.05  # a frame whose matches tell less than this is not valid
    pixels: int = 4000  # of a frame that are aligned with the panorama: more take longer
    floor_deg: float = 0.0012  # systematic error of pan: the least standard deviation that is claimed
    floor_focal: float = 1.7e-4  # the same of the focal length, relative
    reference: ReferenceConfig = field(default_factory=ReferenceConfig)
    sweep: SweepConfig = field(default_factory=SweepConfig)
    beliefs: BeliefConfig = field(default_factory=BeliefConfig)

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise PzcapError(f"method {self.method!r} is not known; choose one of {', '.join(METHODS)}")
        if self.free_tilt and self.method == "paper":
            raise PzcapError("the paper's method knows no tilt; take method=exact, or free_tilt=false")


class Localiser:
    """Finds frames of one camera on its panorama."""

    def __init__(self, panorama: Panorama, camera: PanZoomCamera, config: PanZoomConfig) -> None:
        self._panorama = panorama
        self._camera = camera
        self._config = config
        self._features = panorama_features(panorama, config.threshold, config.panorama_features)
        self._aligner = None
        if config.method == "exact":
            self._aligner = Aligner(panorama, camera, pixels=config.pixels, free_tilt=config.free_tilt)
        self._azimuth, self._slope = cylinder.from_panorama(panorama, self._features.points_px)

    def localise(self, image: Image, prior: Localisation | None) -> Localisation:
        """Pan and focal length of ``image`` (H, W[, 3]).

        ``prior`` is the frame before, if that was found; without it, or when nothing is found near it, the whole
        panorama is searched. A frame whose matches do not determine it comes back with ``valid`` False.
        """
        if self._aligner is None:
            return self._localise_paper(image, prior)
        if prior is not None and prior.valid:
            for off_px in (1.5, 15.0):  # most often the frame is where it was expected
                aligned = self._aligner.align(image, prior.pan_rad, prior.tilt_rad, prior.focal_px, off_px)
                if aligned.settled and aligned.agreement > self._config.sure_agreement:
                    return self._aligned(aligned)
        for near in (prior, None) if prior is not None and prior.valid else (None,):
            for found in self._candidates(image, near):
                proven = self._proven(image, found)
                if proven is not None:
                    return proven
        return self._lost(prior)

    # ------------------------------------------------------------------------------------------ exact

    def _proven(self, image: Image, found: Localisation) -> Localisation | None:
        """What features found, as all pixels have it; None where that is nothing to rely on."""
        assert self._aligner is not None
        aligned = self._aligner.align(image, found.pan_rad, found.tilt_rad, found.focal_px, 1.5 if found.valid else 4.0)
        if not found.valid:  # few matches, as at a zoom far from the sweep's: the pixels have to be sure alone
            sure = aligned.settled and aligned.agreement > self._config.sure_agreement
            return self._aligned(aligned) if sure else None
        moved_px = abs(aligned.pan_rad - found.pan_rad) * self._panorama.px_per_rad
        if aligned.agreement <= self._config.min_agreement or moved_px >= 3.0:
            return None
        return replace(
            self._aligned(aligned),
            frame_points_px=found.frame_points_px, panorama_points_px=found.panorama_points_px,
        )  # fmt: skip

    def _candidates(self, image: Image, prior: Localisation | None) -> list[Localisation]:
        """Where features say that the frame may be, the best first: near ``prior``, or anywhere."""
        lens = self._camera.lens
        if prior is not None:
            zooms = [prior.focal_px / lens.reference_focal_px]
        else:
            # a frame is shrunk to the panorama's resolution; steps of 1.6 are what AKAZE bridges without loss
            low, high = self._config.zoom_range
            zooms = [float(z) for z in 1.6 ** np.arange(0, np.ceil(np.log(high) / np.log(1.6)) + 1) if z <= high]
            zooms = zooms if low <= 1 else [z for z in zooms if z >= low]
        found = [self._at_zoom(image, max(zoom, 1.0), prior) for zoom in zooms]
        places = [place for place in found if place is not None]
        return sorted(places, key=lambda place: (place.valid, len(place.frame_points_px)), reverse=True)

    def _at_zoom(self, image: Image, zoom: float, prior: Localisation | None) -> Localisation | None:
        """Match ``image``, shrunk by ``zoom``, and solve; None where matches do not agree at all."""
        config, lens = self._config, self._camera.lens
        low, high = config.zoom_range
        size = (round(image.shape[1] / zoom), round(image.shape[0] / zoom))
        small = np.asarray(cv2.resize(grey(image), size, interpolation=cv2.INTER_AREA), np.uint8)
        found = features.detect(small, config.threshold, config.frame_features)
        scale = np.array([image.shape[1] / size[0], image.shape[0] / size[1]])
        points = (found.points_px + 0.5) * scale - 0.5
        if prior is None:
            focals = lens.reference_focal_px * np.exp(np.arange(np.log(low), np.log(high), 0.02))
        else:
            focals = prior.focal_px * np.exp(np.arange(-0.2, 0.2001, 0.02))
        window = self._windows(prior)[0]
        pairs = features.match(found, self._features.subset(window), config.ratio)
        if len(pairs) < FEWEST:
            return None
        points, which = points[pairs[:, 0]], window[pairs[:, 1]]
        azimuth, slope = self._azimuth[which], self._slope[which]
        pan, focal, agree = consensus(self._view_at, points, azimuth, slope, focals, free_tilt=config.free_tilt)
        if agree.sum() < FEWEST:
            return None
        matches = points[agree], azimuth[agree], slope[agree]
        solution = solve(self._panorama, self._camera, pan, focal, *matches, free_tilt=config.free_tilt)
        return self._judge(solution, points[agree], self._features.points_px[which[agree]])

    def _view_at(self, focal_px: float) -> View:
        return geometry.view_at(self._camera, 0.0, self._camera.tilt_rad, focal_px)

    def _judge(self, solution: Solution, points_px: Array, panorama_px: Array) -> Localisation:
        config = self._config
        good = solution.inliers
        covariance = solution.covariance + self._systematic(solution.pan_rad, solution.focal_px)
        zoom = solution.focal_px / self._camera.lens.reference_focal_px
        valid = (
            good.sum() >= config.min_inliers
            and np.sqrt(solution.covariance[0, 0]) < np.deg2rad(config.max_pan_sigma_deg)
            and bool(np.all(np.ptp(points_px[good], axis=0) > 0.2 * self._camera.lens.height))
            and config.zoom_range[0] < zoom < config.zoom_range[1]
        )
        return Localisation(
            float(wrapped(np.array(solution.pan_rad))), solution.tilt_rad, solution.focal_px, covariance,
            bool(valid), points_px[good], panorama_px[good],
        )  # fmt: skip

    def _aligned(self, aligned: Alignment) -> Localisation:
        zoom = aligned.focal_px / self._camera.lens.reference_focal_px
        return Localisation(
            float(wrapped(np.array(aligned.pan_rad))), aligned.tilt_rad, aligned.focal_px,
            aligned.covariance + self._systematic(aligned.pan_rad, aligned.focal_px),
            self._config.zoom_range[0] < zoom < self._config.zoom_range[1],
            aligned.frame_points_px, aligned.panorama_points_px,
        )  # fmt: skip

    def _systematic(self, pan_rad: float, focal_px: float) -> Array:
        return systematic(self._config, self._camera, np.array(pan_rad), np.array(focal_px))

    def _lost(self, prior: Localisation | None) -> Localisation:
        pan, focal = (0.0, self._camera.lens.reference_focal_px) if prior is None else (prior.pan_rad, prior.focal_px)
        return Localisation(
            pan, self._camera.tilt_rad, focal, np.diag([np.pi**2, 1.0]), False, np.empty((0, 2)), np.empty((0, 2))
        )

    # ------------------------------------------------------------------------------------------ paper

    def _localise_paper(self, image: Image, prior: Localisation | None) -> Localisation:
        config, lens = self._config, self._camera.lens
        unfolded, covered, origin = cylinder.to_cylinder(image, lens.reference_focal_px)
        inside = np.asarray(cv2.erode(covered.astype(np.uint8), np.ones((9, 9), np.uint8)), np.uint8)
        found = features.detect(grey(unfolded), config.threshold, config.frame_features, inside)
        relative, places = np.empty((0, 2)), np.empty((0, 2))
        agree = np.zeros(0, bool)
        for window in self._windows(prior):
            pairs = features.match(found, self._features.subset(window), config.ratio)
            relative = found.points_px[pairs[:, 0]] - origin
            places = self._features.points_px[window[pairs[:, 1]]]
            agree = ransac_eq15(relative, places)
            if agree.sum() >= config.min_inliers:
                break
        else:
            return self._lost(None)
        (shrink, column, _), covariance = solve_eq15(relative[agree], places[agree])
        if shrink <= 0:
            return self._lost(None)
        per_rad = self._panorama.px_per_rad
        jacobian = np.array([[0.0, -1.0 / per_rad, 0.0], [-1.0 / shrink, 0.0, 0.0]])
        return Localisation(
            float((self._panorama.origin_px[0] - column) / per_rad), self._camera.tilt_rad,
            lens.reference_focal_px / float(shrink), jacobian @ covariance @ jacobian.T, True,
            cylinder.points_from_cylinder(relative[agree], lens.reference_focal_px, lens.width, lens.height),
            places[agree],
        )  # fmt: skip

    def _windows(self, prior: Localisation | None) -> list[NDArray[np.int64]]:
        """Which of the panorama's features to match with: those around ``prior``, then all."""
        everything = [np.arange(len(self._azimuth))]
        if prior is None or not prior.valid:
            return everything
        reach = np.arctan(self._camera.lens.width / 2 / prior.focal_px) + np.deg2rad(self._config.search_deg)
        return [np.flatnonzero(np.abs(wrapped(self._azimuth - prior.pan_rad)) < reach), *everything]


def systematic(config: PanZoomConfig, camera: PanZoomCamera, pan_rad: Array, focal_px: Array) -> Array:
    """The covariance (..., 2, 2) at pans and focal lengths (...) of what no single frame shows and all share: a floor;
    the scale of the sweep, which stretches focal lengths and shrinks pans together; and in the focal length what the
    distortion may do unseen. The paper's method knows of none."""
    pan_rad = wrapped(pan_rad)
    if config.method == "paper":
        return np.zeros((*pan_rad.shape, 2, 2))
    scale = np.stack([-pan_rad, np.ones_like(pan_rad)], axis=-1) * camera.focal_sigma
    floor = np.diag([np.deg2rad(config.floor_deg) ** 2, config.floor_focal**2])
    covariance = np.asarray(floor + scale[..., :, None] * scale[..., None, :])
    covariance[..., 1, 1] += _distortion_sigma(camera.lens, focal_px, config.beliefs.k1) ** 2
    return covariance


def _distortion_sigma(lens: Lens, focal_px: Array, k1_sigma: float) -> Array:
    """Sigma (...) of log focal length, from a distortion whose change, for each unit of that, is known to ``k1_sigma``.

    Only a zoom run shows how it changes: without one the lens has the sweep's (one coefficient) at every zoom. What is
    missing, k r^3, passes for a longer focal length, a r, by least squares over the image a = k sum r^4 / sum r^2.
    """
    if len(lens.k1) > 1:
        return np.zeros_like(focal_px)
    across, down = lens.width**2, lens.height**2
    mean_square, mean_fourth = (across + down) / 12, (across**2 + down**2) / 80 + across * down / 72
    return k1_sigma * np.abs(np.log(focal_px / lens.reference_focal_px)) * mean_fourth / mean_square / focal_px**2


def predicted(before: Localisation | None, last: Localisation | None) -> Localisation | None:
    """Where the next frame is expected, if the head and the ring turn on as they did; None if the last was lost."""
    if before is None or last is None:
        return last
    turned = float(wrapped(np.array(last.pan_rad - before.pan_rad)))
    return replace(
        last,
        pan_rad=float(wrapped(np.array(last.pan_rad + turned))),
        tilt_rad=2 * last.tilt_rad - before.tilt_rad,
        focal_px=last.focal_px**2 / before.focal_px,
    )


def panorama_features(panorama: Panorama, threshold: float, limit: int) -> Features:
    """AKAZE features of a panorama, away from its ragged edge."""
    border = WRAP if panorama.full_turn else 0
    image = cv2.copyMakeBorder(grey(panorama.image), 0, 0, border, border, cv2.BORDER_WRAP)
    known = cv2.copyMakeBorder(panorama.valid.astype(np.uint8), 0, 0, border, border, cv2.BORDER_WRAP)
    inside = np.asarray(cv2.erode(known, np.ones((9, 9), np.uint8)), np.uint8)
    found = features.detect(np.asarray(image, np.uint8), threshold, limit, inside)
    points = found.points_px - np.array([border, 0.0])
    own = (points[:, 0] >= -0.5) & (points[:, 0] < panorama.image.shape[1] - 0.5)
    return Features(points[own], found.descriptors[own], found.brightness[own])


def wrapped(angle_rad: Array) -> Array:
    """Angles brought into [-pi, pi)."""
    return np.asarray(np.mod(angle_rad + np.pi, 2 * np.pi) - np.pi)


# --------------------------------------------------------------------------------------------------------------
# The exact solution of eq. 11


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    pan_rad: float
    tilt_rad: float
    focal_px: float
    covariance: Array  # (2, 2) of (pan, log focal), from the residuals alone
    inliers: Mask  # (N,)


def solve(
    panorama: Panorama,
    camera: PanZoomCamera,
    pan_rad: float,
    focal_px: float,
    points_px: Array,
    azimuth_rad: Array,
    slope: Array,
    *,
    free_tilt: bool = False,
) -> Solution:
    """Pan, log focal, and tilt if that is free, by Gauss-Newton with falling weights (Geman and McClure), from matches
    (N,) and a start at the camera's tilt."""
    scale, tilt_rad = 8.0, camera.tilt_rad
    free = 3 if free_tilt else 2
    if free_tilt:
        view = geometry.view_at(camera, pan_rad, tilt_rad, focal_px)
        tilt_rad += float(np.median(slope - geometry.look(view, points_px)[1]))
    for _ in range(30):
        view = geometry.view_at(camera, pan_rad, tilt_rad, focal_px)
        directions = cylinder.from_centre(panorama, view, azimuth_rad, slope)
        seen, _ = geometry.see(view, *directions)
        residual = seen - points_px
        length = np.hypot(residual[:, 0], residual[:, 1])
        weight = (scale**2 / (scale**2 + length**2)) ** 2
        jacobian = geometry.pan_zoom_derivatives(camera, view, *directions)[:, :, :free]
        weighted = (jacobian * weight[:, None, None]).reshape(-1, free)
        normal = weighted.T @ jacobian.reshape(-1, free) + 1e-9 * np.eye(free)
        step = -np.linalg.solve(normal, weighted.T @ residual.ravel())
        pan_rad += float(step[0])
        focal_px *= float(np.exp(np.clip(step[1], -0.3, 0.3)))
        tilt_rad += float(step[2]) if free_tilt else 0.0
        next_scale = max(3.0 * float(np.median(length)) / 1.1774, 0.3)
        if np.abs(step).max() < 1e-8 and abs(next_scale - scale) < 0.01 * scale:
            break
        scale = max(next_scale, scale / 2)
    inliers = length < 2.0 * scale
    variance = float(np.sum(weight * length**2) / (2 * weight.sum()))
    covariance = np.asarray(variance * np.linalg.inv(normal)[:2, :2], np.float64)
    return Solution(pan_rad, tilt_rad, focal_px, covariance, inliers)


# --------------------------------------------------------------------------------------------------------------
# The paper's solution, eq. 15


def solve_eq15(relative_px: Array, places_px: Array) -> tuple[Array, Array]:
    """Eq. 15 for matches (N, 2) on the frame's cylinder, relative to its origin, and on the panorama.

    Returns ``(1 / zoom ratio, p_0, q_0)`` and its covariance (3, 3).
    """
    count = len(relative_px)
    system = np.zeros((count, 2, 3))
    system[:, :, 0] = relative_px
    system[:, 0, 1] = system[:, 1, 2] = 1.0
    flat = system.reshape(-1, 3)
    solution = np.linalg.lstsq(flat, places_px.ravel(), rcond=None)[0]
    residual = flat @ solution - places_px.ravel()
    variance = float(residual @ residual) / max(2 * count - 3, 1)
    covariance = variance * np.linalg.pinv(flat.T @ flat)
    return np.asarray(solution, np.float64), np.asarray(covariance, np.float64)


def ransac_eq15(relative_px: Array, places_px: Array, *, draws: int = 1000, tolerance_px: float = 5.0) -> Mask:
    """Which matches (N,) agree on one zoom ratio and place: random samples of two, always the same ones."""
    best = np.zeros(len(relative_px), bool)
    if len(relative_px) < 2:
        return best
    rng = np.random.default_rng(0)
    for i, j in rng.integers(len(relative_px), size=(draws, 2)):
        span = relative_px[j] - relative_px[i]
        squared = float(span @ span)
        if squared < 20.0**2:
            continue
        shrink = float(span @ (places_px[j] - places_px[i])) / squared
        if not 0.1 < shrink < 10:
            continue
        off = places_px - places_px[i] - shrink * (relative_px - relative_px[i])
        agree = np.hypot(off[:, 0], off[:, 1]) < tolerance_px
        if agree.sum() > best.sum():
            best = agree
    return best
