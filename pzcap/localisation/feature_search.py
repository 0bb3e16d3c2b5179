"""Search for a frame by the features that it shares with the panorama, solved by eq. 11.

Features find a frame of which much is covered, as long as its zoom is not far from the sweep's.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from pzcap.calibration import features
from pzcap.calibration.features import Features
from pzcap.calibration.settings import PanZoomConfig
from pzcap.calibration.sweep import consensus
from pzcap.geometry import camera as geometry
from pzcap.geometry import cylinder
from pzcap.geometry.camera import View, wrapped
from pzcap.imaging.colour import grey
from pzcap.localisation.panorama_sampler import ViewPlace
from pzcap.localisation.tuning import FEATURES
from pzcap.solver.gauss_newton import NormalEquations, Schedule, minimise
from pzcap.solver.robust import geman_mcclure, planar_sigma
from pzcap.types import Array, Image, Localisation, Mask, Panorama, PanZoomCamera


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A place where a frame may be."""

    pan_rad: float
    tilt_rad: float
    focal_px: float
    determined: bool  # by the matches alone; else they only say where to look
    frame_points_px: Array  # (N, 2) matches that agree
    panorama_points_px: Array  # (N, 2)


class _Known(NamedTuple):
    """Features of a panorama."""

    features: Features
    azimuth_rad: Array  # (N,) of each
    slope: Array  # (N,)


class FeatureSearch:
    """Finds frames of one camera by the features that its panorama shows."""

    def __init__(self, panorama: Panorama, camera: PanZoomCamera, config: PanZoomConfig) -> None:
        self._panorama = panorama
        self._camera = camera
        self._config = config

    @cached_property
    def _known(self) -> _Known:
        """The panorama's features, found when they are first asked for: most takes do without."""
        found = panorama_features(self._panorama, self._config.threshold)
        return _Known(found, *cylinder.from_panorama(self._panorama, found.points_px))

    def candidates(self, image: Image, prior: Localisation | None) -> Iterator[Candidate]:
        """Places of ``image`` (H, W[, 3]), near ``prior`` or anywhere: each that is determined as soon as it is found,
        since the next takes long; then the others, those with the most matches first."""
        vague = []
        for zoom in self._zooms(prior):
            candidate = self._match(image, max(zoom, 1.0), prior)
            if candidate is not None and candidate.determined:
                yield candidate
            elif candidate is not None:
                vague.append(candidate)
        yield from sorted(vague, key=lambda candidate: len(candidate.frame_points_px), reverse=True)

    def _zooms(self, prior: Localisation | None) -> list[float]:
        """Times by which a frame is shrunk to the panorama's resolution; AKAZE bridges steps of 1.6 without loss."""
        if prior is not None:
            return [prior.focal_px / self._camera.lens.reference_focal_px]
        low, high = self._config.zoom_range
        zooms = 1.6 ** np.arange(0, np.ceil(np.log(high) / np.log(1.6)) + 1)
        return [float(zoom) for zoom in zooms if zoom <= high and (low <= 1 or zoom >= low)]

    def _match(self, image: Image, zoom: float, prior: Localisation | None) -> Candidate | None:
        """Place by the features of ``image``, shrunk by ``zoom``; None where their matches do not agree at all."""
        config, lens = self._config, self._camera.lens
        low, high = config.zoom_range
        size = (round(image.shape[1] / zoom), round(image.shape[0] / zoom))
        small = np.asarray(cv2.resize(grey(image), size, interpolation=cv2.INTER_AREA), np.uint8)
        found = features.detect(small, config.threshold, FEATURES.of_frame)
        scale = np.array([image.shape[1] / size[0], image.shape[0] / size[1]])
        points = (found.points_px + 0.5) * scale - 0.5
        if prior is None:
            focals = lens.reference_focal_px * np.exp(np.arange(np.log(low), np.log(high), 0.02))
        else:
            focals = prior.focal_px * np.exp(np.arange(-0.2, 0.2001, 0.02))
        known = self._known
        window = near_prior(known.azimuth_rad, prior, self._camera)
        pairs = features.match(found, known.features.subset(window), config.ratio)
        if len(pairs) < 2:
            return None
        points, which = points[pairs[:, 0]], window[pairs[:, 1]]
        azimuth, slope = known.azimuth_rad[which], known.slope[which]

        def view_at(focal_px: float) -> View:
            return geometry.view_at(self._camera, 0.0, self._camera.tilt_rad, focal_px)

        pan, focal, agree = consensus(view_at, points, azimuth, slope, focals, free_tilt=config.free_tilt)
        if agree.sum() < 2:
            return None
        points, which = points[agree], which[agree]
        matches = points, azimuth[agree], slope[agree]
        solution = solve_eq11(self._panorama, self._camera, pan, focal, *matches, free_tilt=config.free_tilt)
        points, which = points[solution.inliers], which[solution.inliers]
        determined = (
            len(points) >= FEATURES.least_inliers
            and np.sqrt(solution.covariance[0, 0]) < FEATURES.most_pan_sigma_rad
            and bool(np.all(np.ptp(points, axis=0) > 0.2 * lens.height))
            and low < solution.focal_px / lens.reference_focal_px < high
        )
        return Candidate(
            float(wrapped(solution.pan_rad)), solution.tilt_rad, solution.focal_px, bool(determined), points,
            known.features.points_px[which],
        )  # fmt: skip


def near_prior(azimuth_rad: Array, prior: Localisation | None, camera: PanZoomCamera) -> NDArray[np.int64]:
    """Indices of those of the panorama's features (azimuths (N,)) that lie near what ``prior`` shows; without it
    all."""
    if prior is None or not prior.valid:
        return np.arange(len(azimuth_rad))
    reach = np.arctan(camera.lens.width / 2 / prior.focal_px) + FEATURES.search_rad
    return np.flatnonzero(np.abs(wrapped(azimuth_rad - prior.pan_rad)) < reach)


def panorama_features(panorama: Panorama, threshold: float) -> Features:
    """AKAZE features of a panorama, away from its ragged edge."""
    border = 64 if panorama.full_turn else 0  # columns repeated at the ends, for features on the seam
    image = cv2.copyMakeBorder(grey(panorama.image), 0, 0, border, border, cv2.BORDER_WRAP)
    known = cv2.copyMakeBorder(panorama.valid.astype(np.uint8), 0, 0, border, border, cv2.BORDER_WRAP)
    inside = np.asarray(cv2.erode(known, np.ones((9, 9), np.uint8)), np.uint8)
    found = features.detect(np.asarray(image, np.uint8), threshold, FEATURES.of_panorama, inside)
    points = found.points_px - np.array([border, 0.0])
    own = (points[:, 0] >= -0.5) & (points[:, 0] < panorama.image.shape[1] - 0.5)
    return Features(points[own], found.descriptors[own], found.brightness[own])


# --------------------------------------------------------------------------------------------------------------
# Equation 11, for the calibrated camera: with tilt, roll, principal point and distortion in place


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    pan_rad: float
    tilt_rad: float
    focal_px: float
    covariance: Array  # (2, 2) of (pan, log focal), from the residuals alone
    inliers: Mask  # (N,)


def solve_eq11(
    panorama: Panorama, camera: PanZoomCamera, pan_rad: float, focal_px: float, points_px: Array, azimuth_rad: Array,
    slope: Array, *, free_tilt: bool = False,
) -> Solution:  # fmt: skip
    """Pan, log focal, and tilt if that is free, of a frame whose ``points_px`` (N, 2) show directions of the panorama
    (N,), from a start at the camera's tilt: the least Geman-McClure cost of their distances, in pixels of the frame."""
    at, free = ViewPlace(pan_rad, camera.tilt_rad, focal_px), 3 if free_tilt else 2
    if free_tilt:
        seen = geometry.pixel_to_direction(geometry.view_at(camera, *at[:4]), points_px)[1]
        at = at._replace(tilt_rad=at.tilt_rad + float(np.median(slope - seen)))
    length, weight = np.empty(len(points_px)), np.empty(len(points_px))

    def linearise(at: ViewPlace, scale: float) -> NormalEquations:
        view = geometry.view_at(camera, *at[:4])
        directions = cylinder.from_centre(panorama, view, azimuth_rad, slope)
        residual = geometry.direction_to_pixel(view, *directions)[0] - points_px
        length[:] = np.hypot(*residual.T)
        weight[:] = geman_mcclure(length, scale)
        jacobian = geometry.pan_zoom_derivatives(camera, view, *directions)[:, :, :free]
        weighted = (jacobian * weight[:, None, None]).reshape(-1, free)
        normal = weighted.T @ jacobian.reshape(-1, free) + 1e-9 * np.eye(free)
        return NormalEquations(
            normal, weighted.T @ residual.ravel(), planar_sigma(length), float(np.sum(weight * length**2))
        )

    solution = minimise(
        at, linearise, lambda at, step: at.stepped(step, 0.3), lambda step: np.abs(step).max() < 1e-8,
        Schedule(30, 8.0, least_scale=0.3, fall=2.0, steady=0.01),
    )  # fmt: skip
    variance = solution.report.cost / float(2 * weight.sum())
    covariance = np.asarray(variance * np.linalg.inv(solution.normal)[:2, :2], np.float64)
    return Solution(*solution.state[:3], covariance, length < 2.0 * solution.scale)
