"""Pan and zoom of a frame: where it belongs on the panorama (section 4).

`Localiser` takes one of two ways. ``paper`` unfolds the frame onto the reference cylinder and solves eq. 15. ``exact``
aligns the frame with the panorama by its pixels (`pzcap.localisation.photometric_alignment`): from where the frame
before was, else from where the whole frame looks most alike (`pzcap.localisation.coarse_search`), else, as when
somebody covers much of it, from where its matches say by eq. 11 (`pzcap.localisation.panzoom_solvers`). What the pixels
do not bear out does not count.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from pzcap.calibration import features
from pzcap.calibration.features import Features
from pzcap.calibration.parameters import BeliefConfig
from pzcap.calibration.reference_camera import ReferenceConfig
from pzcap.calibration.sweep import SweepConfig, consensus, grey
from pzcap.geometry import camera as geometry
from pzcap.geometry import cylinder
from pzcap.geometry.camera import View, wrapped
from pzcap.localisation.coarse_search import Correlator
from pzcap.localisation.panzoom_solvers import Solution, ransac_eq15, solve_eq11, solve_eq15
from pzcap.localisation.photometric_alignment import Aligner, Alignment
from pzcap.types import Array, Image, Lens, Localisation, Mask, Panorama, PanZoomCamera, PzcapError

METHODS = ("exact", "paper")
FEWEST = 2  # matches that agree: a place to look at
SAME_PX = 0.1  # what two fits that have come to the same place differ by, at most
WRAP = 64  # columns of a full turn repeated at its ends, for features on the seam


@dataclass(frozen=True, slots=True)
class PanZoomConfig:
    method: str = "exact"
    """Or "paper": no distortion, no tilt, stops at eq. 15."""
    free_tilt: bool = False
    """The heads were tilted while the motion was recorded, too."""
    threshold: float = 1e-4
    """Of AKAZE's response."""
    frame_features: int = 400
    panorama_features: int = 12000
    ratio: float = 0.85
    """Of Lowe's test."""
    zoom_range: tuple[float, float] = (0.5, 5.0)
    """Searched where nothing is known, relative to the reference."""
    search_deg: float = 8.0
    """Beyond the frame's edges, where the frame before is known."""
    min_inliers: int = 12
    sure_agreement: float = 0.85
    """Of an alignment (see `align.Alignment`) alone, or features are asked."""
    same_agreement: float = 0.7
    """Of one that near and far starts led to alike."""
    min_agreement: float = 0.5
    """Of one that features led to."""
    max_pan_sigma_deg: float = 0.05
    """A frame whose matches tell less than this is not valid."""
    pixels: int = 4000
    """Of a frame that are aligned with the panorama: more take longer."""
    floor_px: float = 0.011
    """Systematic error of pan at the sweep's zoom: the least standard deviation claimed."""
    floor_edge_px: float = 0.025
    """The same of the focal length, by what it moves the left and right edges."""
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
            low, high = (zoom * camera.lens.reference_focal_px for zoom in config.zoom_range)
            self._aligner = Aligner(panorama, camera, pixels=config.pixels, free_tilt=config.free_tilt)
            self._correlator = Correlator(panorama, camera, (low, high), free_tilt=config.free_tilt)
        self._azimuth, self._slope = cylinder.from_panorama(panorama, self._features.points_px)

    def localise(
        self,
        image: Image,
        prior: Localisation | None,
        hidden: Callable[[Localisation], Mask | None] | None = None,
    ) -> Localisation:
        """Pan and focal length of ``image`` (H, W[, 3]).

        ``prior`` is where the frame is expected, if the one before was found; without it, or when it is not there, the
        whole panorama is searched. ``hidden`` says which pixels (H, W) somebody covers if the frame is where it
        is expected; it is asked when the others alone must do. A frame whose matches do not determine it, or whose
        grey values do not bear them out, comes back with ``valid`` False.
        """
        if self._aligner is None:
            return self._localise_paper(image, prior)
        if prior is not None and prior.valid:
            found = self._near(image, prior, hidden)
            if found is not None:
                return found
        for place in self._correlator.places(image):
            aligned = self._aligner.align(image, place.pan_rad, place.tilt_rad, place.focal_px, 4.0)
            if self._sure(aligned):
                return self._aligned(aligned)
        for near in (prior, None) if prior is not None and prior.valid else (None,):
            for found in _likeliest(self._candidates(image, near)):
                proven = self._proven(image, found)
                if proven is not None:
                    return proven
        return self._lost(prior)

    # ------------------------------------------------------------------------------------------ exact

    def _near(
        self, image: Image, prior: Localisation, hidden: Callable[[Localisation], Mask | None] | None
    ) -> Localisation | None:
        """The frame near where it is expected; None where it is not there for sure."""

        def align(off_px: float, body: Mask | None = None) -> Alignment:
            assert self._aligner is not None
            return self._aligner.align(image, prior.pan_rad, prior.tilt_rad, prior.focal_px, off_px, body)

        near = align(1.5)  # most often it is where it was expected
        if self._sure(near):
            return self._aligned(near)
        far = align(15.0)
        if self._sure(far):
            return self._aligned(far)
        body = None if hidden is None else hidden(prior)
        if body is not None:
            beside = align(4.0, body)
            if self._sure(beside):
                return self._aligned(beside)
        # noise and a bare wall agree less, however well the frame is found
        return self._aligned(far) if self._same(near, far) else None

    def _same(self, near: Alignment, far: Alignment) -> bool:
        """Whether a fit that saw all levels, and could have gone elsewhere, has come to where one from nearby has."""
        moved_px = abs(near.pan_rad - far.pan_rad) * self._panorama.px_per_rad
        edges_px = abs(np.log(near.focal_px / far.focal_px)) * self._camera.lens.width / 2
        steady = near.settled and far.settled and max(moved_px, edges_px) < SAME_PX
        return bool(steady and far.agreement > self._config.same_agreement)

    def _proven(self, image: Image, found: Localisation) -> Localisation | None:
        """What features found, as all pixels have it; None where that is nothing to rely on."""
        assert self._aligner is not None
        aligned = self._aligner.align(image, found.pan_rad, found.tilt_rad, found.focal_px, 1.5 if found.valid else 4.0)
        if not found.valid:  # few matches, as at a zoom far from the sweep's: the pixels have to be sure alone
            return self._aligned(aligned) if self._sure(aligned) else None
        moved_px = abs(aligned.pan_rad - found.pan_rad) * self._panorama.px_per_rad
        if aligned.agreement <= self._config.min_agreement or moved_px >= 3.0:
            return None
        return replace(
            self._aligned(aligned),
            frame_points_px=found.frame_points_px, panorama_points_px=found.panorama_points_px,
        )  # fmt: skip

    def _sure(self, aligned: Alignment) -> bool:
        return aligned.settled and aligned.agreement > self._config.sure_agreement

    def _candidates(self, image: Image, prior: Localisation | None) -> Iterator[Localisation]:
        """Where features say that the frame may be, one zoom after the other: near ``prior``, or anywhere."""
        lens = self._camera.lens
        if prior is not None:
            zooms = [prior.focal_px / lens.reference_focal_px]
        else:
            # a frame is shrunk to the panorama's resolution; steps of 1.6 are what AKAZE bridges without loss
            low, high = self._config.zoom_range
            zooms = [float(z) for z in 1.6 ** np.arange(0, np.ceil(np.log(high) / np.log(1.6)) + 1) if z <= high]
            zooms = zooms if low <= 1 else [z for z in zooms if z >= low]
        places = (self._at_zoom(image, max(zoom, 1.0), prior) for zoom in zooms)
        return (place for place in places if place is not None)

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
        solution = solve_eq11(self._panorama, self._camera, pan, focal, *matches, free_tilt=config.free_tilt)
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
            float(wrapped(solution.pan_rad)), solution.tilt_rad, solution.focal_px, covariance,
            bool(valid), points_px[good], panorama_px[good],
        )  # fmt: skip

    def _aligned(self, aligned: Alignment) -> Localisation:
        zoom = aligned.focal_px / self._camera.lens.reference_focal_px
        return Localisation(
            float(wrapped(aligned.pan_rad)), aligned.tilt_rad, aligned.focal_px,
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


def _likeliest(places: Iterator[Localisation]) -> Iterator[Localisation]:
    """Each place that is valid as soon as it is found, since finding the next takes long; then the others, those with
    the most matches first."""
    doubtful = []
    for place in places:
        if place.valid:
            yield place
        else:
            doubtful.append(place)
    yield from sorted(doubtful, key=lambda place: len(place.frame_points_px), reverse=True)


def systematic(config: PanZoomConfig, camera: PanZoomCamera, pan_rad: Array, focal_px: Array) -> Array:
    """The covariance (..., 2, 2) at pans and focal lengths (...) of what no single frame shows and all share: a floor;
    the scale of the sweep, which stretches focal lengths and shrinks pans together; and in the focal length what the
    distortion may do unseen. The paper's method knows of none."""
    pan_rad = wrapped(pan_rad)
    if config.method == "paper":
        return np.zeros((*pan_rad.shape, 2, 2))
    scale = np.stack([-pan_rad, np.ones_like(pan_rad)], axis=-1) * camera.focal_sigma
    lens = camera.lens
    floor = np.array([config.floor_px / lens.reference_focal_px, config.floor_edge_px / (0.5 * lens.width)])
    covariance = np.asarray(np.diag(floor**2) + scale[..., :, None] * scale[..., None, :])
    covariance[..., 1, 1] += _distortion_sigma(lens, focal_px, config.beliefs.k1) ** 2
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
    turned = float(wrapped(last.pan_rad - before.pan_rad))
    return replace(
        last,
        pan_rad=float(wrapped(last.pan_rad + turned)),
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
