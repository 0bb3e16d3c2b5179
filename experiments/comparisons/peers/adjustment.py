"""OpenCV's stitching pipeline, `cv2.detail`: SIFT, its own matcher, and the bundle adjustment over rays."""

from __future__ import annotations

from typing import Any, Final

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from experiments.comparisons.peers.material import Background, Estimate, Shot
from pzcap.imaging.colour import grey
from pzcap.types import Image

FEATURES: Final = 2000  # a frame
LINKS: Final = 200  # matches between two frames that are adjusted: time grows with them
LEAST: Final = 8  # that must agree
STOP: Final = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 60, 1e-9)
PAD_PX: Final = 1  # to the left and on top: `cv2.detail` has the principal point at W / 2, half a pixel off


class RayAdjustment:
    """Adjusts the frame together with the frames of the sweep around it.

    All begin where they are known to be, the frame at the start (the estimators that OpenCV has for that give wrong
    zooms). The adjustment leaves open how the whole is turned, and its scale hardly fixed: both are then set so that
    the sweep's frames come to lie where they were.
    """

    def __init__(self, background: Background) -> None:
        self._background = background
        self._matcher = cv2.detail.BestOf2NearestMatcher(False, 0.3)
        focal = background.camera.lens.reference_focal_px
        self._sweep = [self._features(view.image, focal) for view in background.sweep]
        self._links: dict[tuple[int, int], Any] = {}

    def locate(self, shot: Shot, start: Estimate | None) -> Estimate | None:
        if start is None:
            return None
        around = self._background.around(start.pan_rad, start.focal_px)
        frame = self._features(shot.image, start.focal_px)
        features = [*(self._sweep[i] for i in around), frame]
        count = len(features)
        links = {(i, j): self._link(around[i], around[j]) for i in range(count - 1) for j in range(i + 1, count - 1)}
        links |= {(i, count - 1): self._thinned(self._matcher.apply(features[i], frame)) for i in range(count - 1)}
        if not any(links[i, count - 1].confidence > 0 for i in range(count - 1)):
            return None
        # the adjustment reads above the diagonal only, but wants something everywhere
        matches = [
            links[min(i, j), max(i, j)] if i != j else links[0, count - 1] for i in range(count) for j in range(count)
        ]
        focal = self._background.camera.lens.reference_focal_px
        known = [(self._background.sweep[i].pan_rad, focal) for i in around]
        # what Python itself makes as CameraParams is not initialised, and crashes it: let the estimator make them
        _, cameras = cv2.detail.HomographyBasedEstimator().apply(features, matches, [])
        for camera, (pan, focal_px) in zip(cameras, [*known, (start.pan_rad, start.focal_px)], strict=True):
            self._set(camera, pan, focal_px)
        adjuster = cv2.detail.BundleAdjusterRay()
        adjuster.setConfThresh(0.5)
        adjuster.setTermCriteria(STOP)
        try:
            done, adjusted = adjuster.apply(features, matches, cameras)
        except cv2.error:  # it has no answer to a focal length that goes below 0
            return None
        if not done or not all(camera.focal > 0 and np.isfinite(camera.R).all() for camera in adjusted):
            return None
        return self._placed(adjusted, known)

    def _placed(self, adjusted: Any, known: list[tuple[float, float]]) -> Estimate:
        """Turn and scale the whole so that the sweep's frames lie where they are known to be."""
        frames = list(zip(adjusted[:-1], known, strict=True))
        turns = [self._background.rotation(pan) @ np.asarray(camera.R, np.float64).T for camera, (pan, _) in frames]
        turn = Rotation.from_matrix(turns).mean().as_matrix()
        scale = np.mean([np.log(focal / camera.focal) for camera, (_, focal) in frames])
        pan = self._background.pan_of(turn @ np.asarray(adjusted[-1].R, np.float64))
        return Estimate(pan, float(adjusted[-1].focal * np.exp(scale)))

    def _features(self, image: Image, focal_px: float) -> Any:
        sift = cv2.SIFT.create(nfeatures=FEATURES, enable_precise_upscale=True)
        found = cv2.detail.computeImageFeatures2(sift, grey(image))
        keypoints = found.getKeypoints()
        if keypoints:
            straight = self._background.straight(np.array([keypoint.pt for keypoint in keypoints]), focal_px) + PAD_PX
            for keypoint, (x, y) in zip(keypoints, straight, strict=True):
                keypoint.pt = (float(x), float(y))
        found.keypoints = keypoints
        found.img_size = (image.shape[1] + PAD_PX, image.shape[0] + PAD_PX)
        return found

    def _link(self, first: int, second: int) -> Any:
        """Matches of two frames of the sweep, found once."""
        if (first, second) not in self._links:
            self._links[first, second] = self._thinned(self._matcher.apply(self._sweep[first], self._sweep[second]))
        return self._links[first, second]

    def _thinned(self, link: Any) -> Any:
        """At most ``LINKS`` inliers of a link. OpenCV distrusts frames that agree too well; here all inliers count."""
        kept = np.flatnonzero(np.asarray(link.inliers_mask) > 0)
        if len(kept) < LEAST:
            link.confidence, link.num_inliers = 0.0, 0
            return link
        if len(kept) > LINKS:
            kept = kept[np.linspace(0, len(kept) - 1, LINKS).astype(int)]
        matches = link.matches
        link.matches = [matches[i] for i in kept]
        link.inliers_mask = [1] * len(kept)
        link.num_inliers, link.confidence = len(kept), 1.0
        return link

    def _set(self, camera: Any, pan_rad: float, focal_px: float) -> None:
        camera.focal, camera.aspect = focal_px, 1.0
        camera.ppx = (self._background.camera.lens.width + PAD_PX) / 2
        camera.ppy = (self._background.camera.lens.height + PAD_PX) / 2
        camera.R = self._background.rotation(pan_rad).astype(np.float32)
