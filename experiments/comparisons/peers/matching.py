"""Peers that match features of the frame with features of the panorama, sort them with MAGSAC, and solve.

`Features` leaves the solution open: pan and focal length of our calibrated camera, fitted to the inliers, or the
homography, decomposed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from experiments.comparisons.peers.material import Background, Estimate, Shot
from pzcap.geometry import camera as geometry
from pzcap.geometry import cylinder
from pzcap.imaging.colour import grey
from pzcap.types import Array, Image, Mask

RATIO: Final = 0.8  # of Lowe's test
WINDOW_RAD: Final = np.deg2rad(60.0)  # of the panorama that MAGSAC looks at: where most matches are
THRESHOLD_PX: Final = 2.0  # of MAGSAC
LEAST: Final = 8  # matches that must agree
FIT_SCALE_PX: Final = 0.5  # beyond this the fit's loss (Cauchy) grows slowly
RUNGS: Final = (1.25, 2.2)  # AKAZE bridges no more than such a step of zoom: the frame is shrunk


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    points_px: Array  # (N, 2)
    descriptors: NDArray[Any]  # (N, D)


class Detector:
    """AKAZE or SIFT, with what finds the nearest of their descriptors."""

    def __init__(self, name: str) -> None:
        self.name = name
        # how many are looked for: more cost time and gain nothing
        self.frame_limit, self.panorama_limit = (1500, 12000) if name == "akaze" else (3000, 20000)
        self.rungs: Sequence[float] = RUNGS if name == "akaze" else (1.0,)

    def detect(self, image: Image, mask: Image | None, limit: int) -> Found:
        if self.name == "akaze":  # upright: the head does not roll
            akaze = cv2.AKAZE.create(cv2.AKAZE_DESCRIPTOR_MLDB_UPRIGHT, threshold=1e-4, max_points=limit)
            keypoints, descriptors = akaze.detectAndCompute(image, mask)
        else:
            sift = cv2.SIFT.create(nfeatures=limit, enable_precise_upscale=True)
            keypoints, descriptors = sift.detectAndCompute(image, mask)
        if len(keypoints) < 2:
            return Found(np.empty((0, 2)), np.empty((0, 1), np.uint8))
        return Found(np.array([keypoint.pt for keypoint in keypoints]), np.asarray(descriptors))

    def matcher(self, known: Found) -> cv2.DescriptorMatcher:
        """Trained with the descriptors of ``known``."""
        if self.name == "akaze":
            matcher: cv2.DescriptorMatcher = cv2.BFMatcher(cv2.NORM_HAMMING)
        else:
            matcher = cv2.FlannBasedMatcher({"algorithm": 1, "trees": 4}, {"checks": 64})
        matcher.add([known.descriptors])
        matcher.train()
        return matcher


class Features:
    """Locates frames by features alone, from nothing."""

    def __init__(self, background: Background, detector: str, solution: str) -> None:
        self._background = background
        self._detector = Detector(detector)
        self._solution = solution
        panorama = background.panorama
        inside = np.asarray(cv2.erode(panorama.valid.astype(np.uint8), np.ones((9, 9), np.uint8)), np.uint8)
        known = self._detector.detect(grey(panorama.image), inside, self._detector.panorama_limit)
        self._azimuth, self._slope = cylinder.from_panorama(panorama, known.points_px)
        self._points_m = background.points(known.points_px)
        self._matcher = self._detector.matcher(known)

    def locate(self, shot: Shot, start: Estimate | None) -> Estimate | None:
        del start
        best: tuple[Array, Array, Estimate] | None = None
        for rung in self._detector.rungs:
            found = self._at(grey(shot.image), rung)
            if found is not None and (best is None or len(found[0]) > len(best[0])):
                best = found
        if best is None:
            return None
        points_px, which, rough = best
        if self._solution == "homography":
            return rough
        return fit(self._background, points_px, self._points_m[which], rough)

    def _at(self, image: Image, rung: float) -> tuple[Array, Array, Estimate] | None:
        """Inliers in ``image`` shrunk by ``rung``: points (N, 2), indices (N,), and what their homography says."""
        size = (round(image.shape[1] / rung), round(image.shape[0] / rung))
        small = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
        found = self._detector.detect(small, None, self._detector.frame_limit)
        if len(found.points_px) < LEAST:
            return None
        pairs = self._matcher.knnMatch(found.descriptors, k=2)
        good = [pair[0] for pair in pairs if len(pair) == 2 and pair[0].distance < RATIO * pair[1].distance]
        if len(good) < LEAST:
            return None
        scale = np.array([image.shape[1] / size[0], image.shape[0] / size[1]])
        points = (found.points_px[[match.queryIdx for match in good]] + 0.5) * scale - 0.5
        which = np.array([match.trainIdx for match in good])
        return self._sorted(points, which)

    def _sorted(self, points_px: Array, which: Array) -> tuple[Array, Array, Estimate] | None:
        """MAGSAC on a plane in front of where most matches are; the frame straightened for the zoom that this gives."""
        background = self._background
        near = _densest(self._azimuth[which], WINDOW_RAD)
        points_px, which = points_px[near], which[near]
        some = float(self._azimuth[which[0]])  # angles about one of them have no seam
        ahead = some + float(np.median([geometry.wrapped(azimuth - some) for azimuth in self._azimuth[which]]))
        focal = plane_focal = background.camera.lens.reference_focal_px
        turned = self._azimuth[which] - ahead
        plane = plane_focal * np.column_stack([-np.tan(turned), -self._slope[which] / np.cos(turned)])
        level = geometry.head_T_cam(ahead, 0.0, 0.0)[:3, :3]
        pan = 0.0
        for _ in range(3):  # how the frame is to be straightened depends on its focal length
            if len(points_px) < LEAST:
                return None
            straight = background.straight(points_px, focal) - background.centre
            homography, mask = cv2.findHomography(
                plane, straight, cv2.USAC_MAGSAC, THRESHOLD_PX, maxIters=10000, confidence=0.9999
            )
            if homography is None:
                return None
            agree = mask.ravel() > 0
            points_px, which, plane = points_px[agree], which[agree], plane[agree]
            decomposed = decompose(np.asarray(homography, np.float64), plane_focal)
            if decomposed is None or not 0.2 < decomposed[1] / plane_focal < 10.0:
                return None
            pan, focal = background.pan_of(level @ decomposed[0].T), decomposed[1]
        return (points_px, which, Estimate(pan, focal)) if len(points_px) >= LEAST else None


def decompose(homography: Array, plane_focal_px: float) -> tuple[Array, float] | None:
    """Rotation (3, 3), plane to frame, and focal length of the frame, from a homography between two straight views.

    Both principal points are at (0, 0). The rows of ``homography K_plane`` are the rotation's, the first two as much
    longer as the frame's focal length. Where the last one points hangs on the perspective alone, which small views
    hardly show: that the first two are normal to it says it far better. None where the homography is degenerate.
    """
    rows = homography @ np.diag([plane_focal_px, plane_focal_px, 1.0])
    rows = rows * np.sign(np.linalg.det(rows))
    length = np.linalg.norm(rows, axis=1)
    if not np.all(length > 1e-12):
        return None
    ahead = np.cross(rows[0], rows[1])
    u, _, vt = np.linalg.svd(np.vstack([rows[:2] / length[:2, None], ahead / np.linalg.norm(ahead)]))
    return u @ vt, float(np.sqrt(length[0] * length[1]) / length[2])


def fit(background: Background, points_px: Array, points_m: Array, start: Estimate) -> Estimate:
    """Pan and log focal of the calibrated camera, from points of the hall (N, 3) and their places in a frame (N, 2)."""
    camera = background.camera

    def residuals(unknowns: Array) -> Array:
        now = geometry.at(camera, float(unknowns[0]), camera.tilt_rad, float(np.exp(unknowns[1])))
        return (geometry.project(now, points_m)[0] - points_px).ravel()

    return _solved(residuals, start)


def fit_directions(
    background: Background, points_px: Array, azimuth_rad: Array, slope: Array, start: Estimate
) -> Estimate:
    """The same from directions (N,) of the head frame, as they are seen from the projection centre."""
    camera = background.camera

    def residuals(unknowns: Array) -> Array:
        view = geometry.view_at(camera, float(unknowns[0]), camera.tilt_rad, float(np.exp(unknowns[1])))
        return (geometry.direction_to_pixel(view, azimuth_rad, slope)[0] - points_px).ravel()

    return _solved(residuals, start)


def _solved(residuals: Callable[[Array], Array], start: Estimate) -> Estimate:
    solved = least_squares(
        residuals, np.array([start.pan_rad, np.log(start.focal_px)]), loss="cauchy", f_scale=FIT_SCALE_PX, xtol=1e-12,
        ftol=1e-12, gtol=1e-12,
    )  # fmt: skip
    return Estimate(float(solved.x[0]), float(np.exp(solved.x[1])))


def _densest(azimuth_rad: Array, width_rad: float) -> Mask:
    """Mask (N,) of the azimuths (N,) in that window of the turn which holds most of them."""
    order = np.sort(np.mod(azimuth_rad, 2 * np.pi))
    twice = np.concatenate([order, order + 2 * np.pi])
    counts = np.searchsorted(twice, order + width_rad, side="right") - np.arange(len(order))
    middle = float(order[int(np.argmax(counts))]) + width_rad / 2
    return np.abs(geometry.wrapped(azimuth_rad - middle)) <= width_rad / 2 + 1e-9
