"""The paper's own method: no distortion, no tilt, a panorama chained frame to frame, eq. 15 as the final solution."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np

from pzcap.calibration import features, reference_camera
from pzcap.calibration.calibrate import CalibratedCamera, Footage
from pzcap.calibration.settings import PanZoomConfig
from pzcap.extras.paper.similarity import ransac_eq15, solve_eq15
from pzcap.extras.paper.stitching import stitch
from pzcap.extras.paper.unfolding import points_from_cylinder, to_cylinder
from pzcap.geometry import camera as geometry
from pzcap.geometry import cylinder
from pzcap.imaging.colour import grey
from pzcap.localisation.feature_search import near_prior, panorama_features
from pzcap.localisation.localise import lost
from pzcap.localisation.tuning import FEATURES
from pzcap.pipeline import Method
from pzcap.progress import Report, no_report
from pzcap.types import Array, Image, Lens, Localisation, Mask, Panorama, PanZoomCamera, PzcapError


def without_floor(config: PanZoomConfig) -> PanZoomConfig:
    """``config`` without the systematic errors that covariances have as their floor: the paper's method knows of
    none."""
    return replace(config, floor_px=0.0, floor_edge_px=0.0, beliefs=replace(config.beliefs, k1=0.0))


def calibrate(footage: Footage, config: PanZoomConfig, report: Report = no_report) -> CalibratedCamera:
    """Calibrate one camera as sections 3.4 to 3.5 do. Raises PzcapError where object or sweep are not found."""
    reference_image, sweep = footage.reference_image, footage.sweep
    if footage.calibration_object is None:
        raise PzcapError("method=paper needs a calibration object; take method=exact, which does without")
    first = reference_camera.calibrate(reference_image, footage.calibration_object, config.reference)
    height, width = reference_image.shape[:2]
    focal = first.camera.focal_px
    pasted = stitch(sweep, focal, config.sweep, lambda done: report("stitch sweep", done, 0))
    unfolded, covered, origin = to_cylinder(reference_image, focal)
    inside = np.asarray(covered, np.uint8)
    found = features.detect(grey(unfolded), config.threshold, FEATURES.of_frame, inside)
    landmarks = panorama_features(pasted, config.threshold)
    pairs = features.match(found, landmarks, config.ratio)
    relative, places = found.points_px[pairs[:, 0]] - origin, landmarks.points_px[pairs[:, 1]]
    agree = ransac_eq15(relative, places)
    if agree.sum() < FEATURES.least_inliers:
        raise PzcapError("reference image: it shows nothing of what the sweep showed; sweep past the reference pose")
    (_, column, row), _ = solve_eq15(relative[agree], places[agree])
    shift = (column - pasted.origin_px[0]) / pasted.px_per_rad
    background = replace(pasted, origin_px=np.array([column, row]), sweep_pan_rad=pasted.sweep_pan_rad + shift)
    lens = Lens(width, height, focal, first.camera.principal_px[None], np.zeros(1))
    level = PanZoomCamera(lens, np.eye(4), 0.0, 0.0)
    return CalibratedCamera(first, background, geometry.mount(replace(first.camera, k1=0.0), level))


class PaperLocaliser:
    """Finds frames of one camera on its panorama by eq. 15."""

    def __init__(self, panorama: Panorama, camera: PanZoomCamera, config: PanZoomConfig) -> None:
        self._panorama = panorama
        self._camera = camera
        self._config = config
        self._features = panorama_features(panorama, config.threshold)
        self._azimuth: Array = cylinder.from_panorama(panorama, self._features.points_px)[0]

    def localise(
        self, image: Image, prior: Localisation | None, hidden: Callable[[Localisation], Mask | None] | None = None
    ) -> Localisation:
        """Pan and focal length of ``image`` (H, W[, 3]), by features near ``prior``, else anywhere; ``hidden`` is of no
        use to features."""
        del hidden
        config, lens = self._config, self._camera.lens
        unfolded, covered, origin = to_cylinder(image, lens.reference_focal_px)
        inside = np.asarray(cv2.erode(covered.astype(np.uint8), np.ones((9, 9), np.uint8)), np.uint8)
        found = features.detect(grey(unfolded), config.threshold, FEATURES.of_frame, inside)
        relative, places = np.empty((0, 2)), np.empty((0, 2))
        agree = np.zeros(0, bool)
        near = near_prior(self._azimuth, prior, self._camera)
        for window in (near, np.arange(len(self._azimuth))):
            pairs = features.match(found, self._features.subset(window), config.ratio)
            relative = found.points_px[pairs[:, 0]] - origin
            places = self._features.points_px[window[pairs[:, 1]]]
            agree = ransac_eq15(relative, places)
            if agree.sum() >= FEATURES.least_inliers:
                break
        else:
            return lost(self._camera, None)
        (shrink, column, _), covariance = solve_eq15(relative[agree], places[agree])
        if shrink <= 0:
            return lost(self._camera, None)
        per_rad = self._panorama.px_per_rad
        jacobian = np.array([[0.0, -1.0 / per_rad, 0.0], [-1.0 / shrink, 0.0, 0.0]])
        return Localisation(
            float((self._panorama.origin_px[0] - column) / per_rad), self._camera.tilt_rad,
            lens.reference_focal_px / float(shrink), jacobian @ covariance @ jacobian.T, True,
            points_from_cylinder(relative[agree], lens.reference_focal_px, lens.width, lens.height),
            places[agree],
        )  # fmt: skip


PAPER = Method("paper", calibrate, PaperLocaliser)
