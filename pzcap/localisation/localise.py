"""Pan and zoom of a frame: where it belongs on the panorama (section 4).

`Localiser` aligns the frame with the panorama by its pixels (`pzcap.localisation.photometric_alignment`): from where
the frame before was, else from where the whole frame looks most alike (`pzcap.localisation.coarse_search`), else, as
when somebody covers much of it, from where its matches say by eq. 11 (`pzcap.localisation.panzoom_solvers`). A place
that the pixels do not bear out does not count.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from pzcap.calibration import features
from pzcap.calibration.features import Features
from pzcap.calibration.settings import PanZoomConfig
from pzcap.calibration.sweep import consensus, grey
from pzcap.geometry import camera as geometry
from pzcap.geometry import cylinder
from pzcap.geometry.camera import View, wrapped
from pzcap.localisation.coarse_search import Correlator
from pzcap.localisation.covariance import systematic
from pzcap.localisation.panzoom_solvers import Solution, solve_eq11
from pzcap.localisation.photometric_alignment import Aligner, Alignment
from pzcap.localisation.tuning import ALIGNMENT
from pzcap.types import Array, Image, Localisation, Mask, Panorama, PanZoomCamera

FEWEST = 2  # matches that agree: a place to look at
SAME_PX = 0.1  # what two fits that have come to the same place differ by, at most
WRAP = 64  # columns of a full turn repeated at its ends, for features on the seam


class Localiser:
    """Finds frames of one camera on its panorama."""

    def __init__(self, panorama: Panorama, camera: PanZoomCamera, config: PanZoomConfig) -> None:
        self._panorama = panorama
        self._camera = camera
        self._config = config
        self._features = panorama_features(panorama, config.threshold, config.panorama_features)
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
        return lost(self._camera, prior)

    def _near(
        self, image: Image, prior: Localisation, hidden: Callable[[Localisation], Mask | None] | None
    ) -> Localisation | None:
        """The frame near where it is expected; None where it is not there for sure."""

        def align(off_px: float, body: Mask | None = None) -> Alignment:
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
        steady = near.report.converged and far.report.converged and max(moved_px, edges_px) < SAME_PX
        return bool(steady and far.agreement > self._config.same_agreement)

    def _proven(self, image: Image, found: Localisation) -> Localisation | None:
        """What features found, as all pixels have it; None where that is nothing to rely on."""
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
        return aligned.report.converged and aligned.agreement > self._config.sure_agreement

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
        window = near_prior(self._azimuth, prior, self._camera, config.search_deg)
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


def lost(camera: PanZoomCamera, prior: Localisation | None) -> Localisation:
    """A frame of ``camera`` that was not found: where ``prior`` expected it, not valid, anywhere in its covariance."""
    pan, focal = (0.0, camera.lens.reference_focal_px) if prior is None else (prior.pan_rad, prior.focal_px)
    return Localisation(
        pan, camera.tilt_rad, focal, np.diag([np.pi**2, 1.0]), False, np.empty((0, 2)), np.empty((0, 2))
    )


def near_prior(
    azimuth_rad: Array, prior: Localisation | None, camera: PanZoomCamera, search_deg: float
) -> NDArray[np.int64]:
    """Indices of the panorama's features (azimuths (N,)) within ``search_deg`` of what ``prior`` sees; without it
    all."""
    if prior is None or not prior.valid:
        return np.arange(len(azimuth_rad))
    reach = np.arctan(camera.lens.width / 2 / prior.focal_px) + np.deg2rad(search_deg)
    return np.flatnonzero(np.abs(wrapped(azimuth_rad - prior.pan_rad)) < reach)


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


def count_from_reference(panorama: Panorama, camera: PanZoomCamera, image: Image, focal_px: float) -> Panorama:
    """The panorama, its azimuths counted from where the reference ``image``, of ``focal_px``, lies on it.

    The adjustment knows that already; but found in the same way as later the pan of every frame, what is wrong with all
    of them alike is not wrong with their difference.
    """
    # every pan is counted from this one image, so its own error is all frames': there is time for all of its pixels
    aligner = Aligner(panorama, camera, pixels=image.size)
    reference = aligner.align(image, 0.0, camera.tilt_rad, focal_px, 1.5)
    if reference.agreement < ALIGNMENT.sure_agreement:
        return panorama
    origin_px = panorama.origin_px - np.array([reference.pan_rad * panorama.px_per_rad, 0.0])
    return replace(panorama, origin_px=origin_px, sweep_pan_rad=panorama.sweep_pan_rad - reference.pan_rad)


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
