"""Pan and zoom of a frame: its place on the panorama (section 4).

`Localiser` aligns a frame's grey values with the panorama (`photometric_alignment`): starting from where the frame
before leads to, else from where the whole frame correlates best (`coarse_search`), else, as when somebody covers much
of it, from where its features are (`feature_search`). No place counts with which the grey values do not agree.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np

from pzcap.calibration.settings import PanZoomConfig
from pzcap.geometry.camera import wrapped
from pzcap.imaging.colour import colours_aligned
from pzcap.localisation.coarse_search import Correlator
from pzcap.localisation.covariance import systematic
from pzcap.localisation.feature_search import Candidate, FeatureSearch
from pzcap.localisation.frame_prior import FramePrior
from pzcap.localisation.panorama_sampler import ViewPlace, place_of
from pzcap.localisation.photometric_alignment import Aligner, Alignment
from pzcap.localisation.tuning import ALIGNMENT, FEATURES, READOUT
from pzcap.types import Array, Image, Localisation, Mask, Panorama, PanZoomCamera

_KICKED: Final = np.full(2, ALIGNMENT.kicked_rad)
"""Sway (2,) of tilt and roll of a tripod that was kicked, standard deviations."""


class Localiser:
    """Finds frames of one camera on its panorama."""

    def __init__(
        self, panorama: Panorama, camera: PanZoomCamera, config: PanZoomConfig, aligner: type[Aligner] = Aligner
    ) -> None:
        self._panorama = panorama
        self._camera = camera
        self._config = config
        low, high = (zoom * camera.lens.reference_focal_px for zoom in config.zoom_range)
        self._aligner = aligner(panorama, camera, pixels=config.pixels)
        self._correlator = Correlator(panorama, camera, (low, high), free_tilt=config.free_tilt)
        self._features = FeatureSearch(panorama, camera, config)

    def localise(
        self, image: Image, prior: Localisation | None, hidden: Callable[[Localisation], Mask | None] | None = None
    ) -> Localisation:
        """Pan and focal length of ``image`` (H, W[, 3]); not ``valid`` where neither matches nor grey values determine
        them.

        ``prior`` is where the frame is expected, if the one before was found; without it, or when it is not there, the
        whole panorama is searched. ``hidden`` says which pixels (H, W) the athlete covers if the frame is where it is
        expected; it is asked when the others alone must do.
        """
        expected = prior if prior is not None and prior.valid else None
        if expected is not None and (found := self._align_near(image, expected, hidden)) is not None:
            return found
        if (correlated := self._align_correlated(image)) is not None:
            return correlated
        for near in (None,) if expected is None else (expected, None):
            for candidate in self._features.candidates(image, near):
                if (verified := self._verified(image, candidate)) is not None:
                    return verified
        return lost(self._camera, prior)

    def _align_correlated(self, image: Image) -> Localisation | None:
        """The frame, aligned from where it correlates best with the panorama; None where it is reliably at none of
        these places."""
        likely: list[tuple[ViewPlace, Alignment]] = []
        for place in self._correlator.places(image):
            start = ViewPlace(place.pan_rad, place.tilt_rad, place.focal_px)
            if self._is_reliable(near := self._align(image, start, 4.0)):
                return self._localisation(near)
            if near.agreement > self._config.same_agreement:
                likely.append((start, near))
        for start, near in likely:  # a long zoom shows what the panorama does not, and mains light lies across both
            if self._coincide(near, self._align(image, start, 15.0)):
                return self._localisation(near)
        return None

    def _align_near(
        self, image: Image, prior: Localisation, hidden: Callable[[Localisation], Mask | None] | None
    ) -> Localisation | None:
        """The frame, aligned from where it is expected; None where it is not reliably there."""

        def align(off_px: float, body: Mask | None = None) -> Alignment:
            return self._align(image, place_of(prior), off_px, body, prior)

        if self._is_reliable(near := align(1.5)):  # most often it is where it was expected
            return self._localisation(near)
        if self._is_reliable(far := align(15.0)):
            return self._localisation(far)
        body = None if hidden is None else hidden(prior)
        if body is not None and self._is_reliable(beside := align(4.0, body)):
            return self._localisation(beside)
        # noise and a bare wall agree less, however well the frame is found
        if self._coincide(near, far):
            return self._localisation(far)
        kicked = self._align(image, place_of(prior), 15.0, None, replace(prior, sway_sigma=_KICKED))
        return self._localisation(kicked) if self._is_reliable(kicked) else None

    def _align(
        self, image: Image, start: ViewPlace, off_px: float, body: Mask | None = None,
        expected: Localisation | None = None,
    ) -> Alignment:  # fmt: skip
        """Align from a ``start`` that is off by up to ``off_px`` pixels of the panorama: 1.5, 4 or 15, the reaches of
        one, two and all three `LEVELS`. Its sway and shear are known as well as ``expected``, else as a frame's are;
        where it sways by far more, its tripod was kicked: it is aligned once more as if nothing were known of that."""
        beliefs, camera = self._config.beliefs, self._camera
        sway, shear = np.full(2, np.deg2rad(beliefs.sway_deg)), beliefs.readout * np.array(READOUT.fastest)
        if expected is not None:
            sway, shear = expected.sway_sigma, expected.shear_sigma
        locked = not self._config.free_tilt
        mean = start._replace(tilt_rad=camera.tilt_rad if locked else start.tilt_rad, roll_rad=0.0)

        def align(start: ViewPlace, off_px: float, sway: Array) -> Alignment:
            tilt_sigma = float(sway[0]) if locked else ALIGNMENT.free_tilt_rad
            prior = FramePrior(mean, tilt_sigma, float(sway[1]), *shear.tolist())
            return self._aligner.align(image, start, off_px, body, prior)

        aligned = align(start, off_px, sway)
        off = np.abs([aligned.at.tilt_rad - mean.tilt_rad, aligned.at.roll_rad])
        if locked and np.any(off > np.minimum(ALIGNMENT.kicked_sigmas * sway, _KICKED)):
            return align(aligned.at, 15.0, _KICKED)
        return aligned

    def _coincide(self, near: Alignment, far: Alignment) -> bool:
        """True if a fit on all levels, which could have gone elsewhere, has come to where one on the finest has."""
        moved_px = abs(near.at.pan_rad - far.at.pan_rad) * self._panorama.px_per_rad
        edges_px = abs(np.log(near.at.focal_px / far.at.focal_px)) * self._camera.lens.width / 2
        converged = near.report.converged and far.report.converged
        same = max(moved_px, edges_px) < ALIGNMENT.same_px
        return bool(converged and same and far.agreement > self._config.same_agreement)

    def _verified(self, image: Image, found: Candidate) -> Localisation | None:
        """The place that features ``found``, aligned; None where the grey values do not agree with it."""
        off_px = 1.5 if found.determined else 4.0
        aligned = self._align(image, ViewPlace(found.pan_rad, found.tilt_rad, found.focal_px), off_px)
        if not found.determined:  # few matches, as at a zoom far from the sweep's: grey values have to do alone
            return self._localisation(aligned) if self._is_reliable(aligned) else None
        moved_px = abs(aligned.at.pan_rad - found.pan_rad) * self._panorama.px_per_rad
        if aligned.agreement <= FEATURES.least_agreement or moved_px >= ALIGNMENT.features_moved_px:
            return None
        frame_px, panorama_px = found.frame_points_px, found.panorama_points_px
        return replace(self._localisation(aligned), frame_points_px=frame_px, panorama_points_px=panorama_px)

    def _is_reliable(self, aligned: Alignment) -> bool:
        return aligned.report.converged and aligned.agreement > self._config.sure_agreement

    def _localisation(self, aligned: Alignment) -> Localisation:
        (low, high), lens, at = self._config.zoom_range, self._camera.lens, aligned.at
        shared = systematic(self._config, self._camera, np.array(at.pan_rad), np.array(at.focal_px))
        sigma = np.zeros(6)  # of what is held
        sigma[: len(aligned.covariance)] = np.sqrt(ALIGNMENT.doubt * np.diag(aligned.covariance))
        return Localisation(
            float(wrapped(at.pan_rad)), at.tilt_rad, at.focal_px, aligned.clustered + shared,
            low < at.focal_px / lens.reference_focal_px < high, aligned.frame_points_px, aligned.panorama_points_px,
            at.roll_rad, sigma[2:4], np.array([at.pan_shear_rad, at.zoom_shear]), sigma[4:], aligned.bands,
        )  # fmt: skip


def lost(camera: PanZoomCamera, prior: Localisation | None) -> Localisation:
    """A frame of ``camera`` that was not found: not valid, where ``prior`` expected it, but possibly anywhere."""
    pan, focal = (0.0, camera.lens.reference_focal_px) if prior is None else (prior.pan_rad, prior.focal_px)
    return Localisation(
        pan, camera.tilt_rad, focal, np.diag([np.pi**2, 1.0]), False, np.empty((0, 2)), np.empty((0, 2))
    )


def count_from_reference(
    panorama: Panorama, camera: PanZoomCamera, image: Image, focal_px: float, aligner: type[Aligner] = Aligner
) -> Panorama:
    """The panorama, its azimuths counted from where the reference ``image``, of ``focal_px``, lies on it. The bundle
    adjustment has determined that already; but found as each frame's pan is later, an error that all share cancels."""
    # an error of this one pan is all frames' error, so all pixels are compared
    start, image = ViewPlace(0.0, camera.tilt_rad, focal_px), colours_aligned(image, camera.lens.lateral_colour)
    reference = aligner(panorama, camera, pixels=image.size).align(image, start, 1.5)
    if reference.agreement < ALIGNMENT.sure_agreement:
        return panorama
    origin_px = panorama.origin_px - np.array([reference.at.pan_rad * panorama.px_per_rad, 0.0])
    return replace(panorama, origin_px=origin_px, sweep_pan_rad=panorama.sweep_pan_rad - reference.at.pan_rad)
