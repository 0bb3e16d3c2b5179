"""The camera at its reference pose, from one image of the calibration object (section 3.4).

Tsai's method (Tsai, 1986, noncoplanar points): the radial alignment constraint gives the orientation and two thirds of
the position by linear equations that neither focal length nor radial distortion can disturb, a second linear system
the focal length and the distance; then everything is refined together with the distortion by Levenberg-Marquardt. Once
the lens is known from elsewhere, the pose is fitted to the grey values of the whole markers
(`pzcap.calibration.marker_pose`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from pzcap.calibration import marker_pose
from pzcap.calibration.tuning import REFERENCE
from pzcap.geometry.camera import project
from pzcap.imaging.colour import grey
from pzcap.solver.robust import normal_sigma
from pzcap.types import Array, CalibrationObject, Camera, Image, PzcapError, ReferenceCamera

MISFIT: Final = "the calibration object's markers do not fit one camera"


@dataclass(frozen=True, slots=True)
class ReferenceConfig:
    """Settings of the fit to the corners of the calibration object's markers."""

    k1_sigma: float = 0.05
    """Prior standard deviation of k1 about 0; the calibration object alone hardly determines it."""
    outlier_px: float = 1.0
    """Pixels. Residuals beyond this count less and less: a corner may be partly hidden. Where most are smaller, so do
    those far beyond most."""


@dataclass(frozen=True, slots=True, eq=False)
class Detection:
    """Corners of the markers found in an image."""

    ids: tuple[int, ...]
    points_m: Array  # (N, 3) world
    points_px: Array  # (N, 2)


def detect(image: Image, calibration_object: CalibrationObject) -> Detection:
    """Find the markers of ``calibration_object`` in ``image`` (H, W[, 3]), their corners to a fraction of a pixel.

    Raises PzcapError when fewer than three are found, or only markers of one plane.
    """
    identifier = getattr(cv2.aruco, calibration_object.dictionary, None)
    if not isinstance(identifier, int):
        raise PzcapError(
            f"calibration object: no marker dictionary is called {calibration_object.dictionary!r}; "
            "use a name of cv2.aruco, such as DICT_4X4_50"
        )
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    parameters.adaptiveThreshWinSizeMax = 43
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(identifier), parameters)
    shown = grey(image)
    corners, found, _ = detector.detectMarkers(shown)
    known = {marker.id: marker.corners_m for marker in calibration_object.markers}
    quads = [(int(i), quad[0]) for quad, i in zip(corners, [] if found is None else found.ravel(), strict=True)]
    seen = _consistent([(i, quad) for i, quad in quads if i in known], known, *shown.shape[::-1])
    ids = tuple(sorted(seen))
    if len(ids) < REFERENCE.min_markers:
        raise PzcapError(
            f"{len(ids)} of the calibration object's {len(known)} markers found, {REFERENCE.min_markers} are needed; "
            "let it fill more of the picture, in focus and evenly lit"
        )
    points_m = np.concatenate([known[i] for i in ids]).astype(np.float64)
    if np.linalg.svd(points_m - points_m.mean(axis=0), compute_uv=False)[2] < 1e-2 * np.ptp(points_m):
        raise PzcapError("all markers found lie in one plane; turn the calibration object so that two faces are seen")
    points_px = np.concatenate([refine_corners(shown, seen[i].astype(np.float64)) for i in ids])
    return Detection(ids, points_m, points_px)


def _consistent(
    quads: Sequence[tuple[int, Array]], known: Mapping[int, Array], width: int, height: int
) -> dict[int, Array]:
    """Select the quads (id, (4, 2) pixels) that one camera can see together, at most one for an id: a pattern of the
    hall passes for a marker now and then. If not all agree, the largest set that agrees with the camera of three of
    them (RANSAC; Fischler and Bolles, 1981)."""
    points_m = np.array([known[i] for i, _ in quads], np.float64).reshape(-1, 4, 3)
    points_px = np.array([quad for _, quad in quads], np.float64).reshape(-1, 4, 2)
    sides = np.linalg.norm(points_px - np.roll(points_px, 1, axis=1), axis=2).mean(axis=1)

    def agreeing(sample: NDArray[np.int64]) -> dict[int, Array]:
        try:
            camera = tsai(points_m[sample].reshape(-1, 3), points_px[sample].reshape(-1, 2), width, height)
        except (PzcapError, np.linalg.LinAlgError):
            return {}
        off = project(camera, points_m.reshape(-1, 3))[0].reshape(-1, 4, 2) - points_px
        agree = np.abs(off).max(axis=(1, 2)) < REFERENCE.corner_tolerance * sides
        return {i: quad for (i, quad), good in zip(quads, agree, strict=True) if good}

    everything = dict(quads)
    if len(quads) < REFERENCE.min_markers or len(best := agreeing(np.arange(len(quads)))) == len(quads):
        return everything
    rng = np.random.default_rng(0)
    for _ in range(REFERENCE.triples):
        best = max(best, agreeing(rng.choice(len(quads), 3, replace=False)), key=len)
    return best if len(best) >= REFERENCE.min_markers else everything


def refine_corners(image: Image, corners_px: Array) -> Array:
    """Refine the corners (4, 2) of a dark square on a bright ground, as the intersections of its four edges.

    Blur rounds corners, so that `cv2.cornerSubPix` pulls them towards the square's middle; it does not move edges away
    from them. Each side is sampled across at many places, the first moment of the gradient locates the edge in each,
    and a line is fitted through them.
    """
    lines = []
    for start, end in zip(corners_px, np.roll(corners_px, -1, axis=0), strict=True):
        length = float(np.hypot(*(end - start)))
        along = (end - start) / length
        normal = np.array([along[1], -along[0]])  # out of the square: corners run clockwise, y is down
        places = start + np.linspace(0.15, 0.85, max(8, int(length)))[:, None] * (end - start)
        reach = float(np.clip(0.08 * length, 2.0, 4.0))  # stays inside the marker's black border and its white margin
        across = np.arange(-reach, reach + 1e-9, 0.25)
        for _ in range(2):
            at = places[:, None, :] + across[None, :, None] * normal
            profile = cv2.remap(image, at[..., 0].astype(np.float32), at[..., 1].astype(np.float32), cv2.INTER_LINEAR)
            slope = np.clip(np.diff(profile.astype(np.float64), axis=1), 0.0, None)
            total = slope.sum(axis=1)
            offset = (slope @ ((across[1:] + across[:-1]) / 2)) / np.maximum(total, 1e-9)
            good = total > 0.5 * np.median(total)
            places = places + np.where(good, offset, 0.0)[:, None] * normal
        middle = places[good].mean(axis=0)
        direction = np.linalg.svd(places[good] - middle)[2][0]
        lines.append((middle, np.array([direction[1], -direction[0]])))
    refined = corners_px.copy()
    for i in range(4):  # corner i is where the sides before and after it meet
        (point_a, normal_a), (point_b, normal_b) = lines[i - 1], lines[i]
        refined[i] = np.linalg.solve(np.array([normal_a, normal_b]), [normal_a @ point_a, normal_b @ point_b])
    moved = np.hypot(*(refined - corners_px).T)
    return np.where((moved < 3.0)[:, None], refined, corners_px)  # a side that is partly hidden can send a corner away


def calibrate(image: Image, calibration_object: CalibrationObject, config: ReferenceConfig) -> ReferenceCamera:
    """Estimate pose, focal length and k1 of the camera that took ``image``; the principal point is its centre. Raises
    PzcapError when the object is not found, or is not as its file says."""
    height, width = image.shape[:2]
    detection = detect(image, calibration_object)
    try:
        camera = tsai(detection.points_m, detection.points_px, width, height)
    except PzcapError as error:
        raise PzcapError(f"{error}; {_other_order(detection, width, height)}") from error
    found = fit(camera, detection.points_m, detection.points_px, config, free_lens=True)
    if not _fits(found.residuals_px, detection.points_px):
        raise PzcapError(f"{MISFIT}; {_other_order(detection, width, height)}")
    return found


def _fits(residuals_px: Array, points_px: Array) -> bool:
    """True where most corners (N, 2) are where a camera sees them, by the size of their markers."""
    quads = points_px.reshape(-1, 4, 2)
    sides = np.linalg.norm(quads - np.roll(quads, 1, axis=1), axis=2).mean(axis=1)
    off = np.linalg.norm(residuals_px.reshape(-1, 4, 2), axis=2).max(axis=1)
    return bool(np.median(off / sides) < REFERENCE.corner_tolerance)


def _other_order(detection: Detection, width: int, height: int) -> str:
    """A clause on what makes the markers that were found fit one camera: an order of their corners, or axes of the
    other hand; else on the object's dimensions."""
    quads = detection.points_m.reshape(-1, 4, 3)
    turned = [np.roll(quads, turn, axis=1) for turn in (1, 2, 3)]
    causes = {
        "all corners are listed from another one than the upper left of the marker's own picture": turned,
        "all corners are listed anticlockwise as seen from the front": [each[:, ::-1] for each in (quads, *turned)],
        "its axes are left-handed": [quads * [-1.0, 1.0, 1.0]],
    }
    for cause, orders in causes.items():
        for points_m in orders:
            try:
                camera = tsai(points_m.reshape(-1, 3), detection.points_px, width, height)
            except PzcapError:
                continue
            if _fits(detection.points_px - project(camera, points_m.reshape(-1, 3))[0], detection.points_px):
                return f"{cause} (object.json, docs/capture.md)"
    return "check its dimensions (object.json)"


def tsai(points_m: Array, points_px: Array, width: int, height: int) -> Camera:
    """Estimate a camera with k1 = 0 by Tsai's linear stages, from N >= 7 points (N, 3) not in one plane, and their
    pixels (N, 2).

    The radial alignment constraint ``x (r2 P + t2) = y (r1 P + t1)`` is solved for the first two rows of ``[R | t]``
    up to scale (unit-norm solution in place of Tsai's division by t2, which fails where t2 = 0).
    """
    centre = np.array([(width - 1) / 2, (height - 1) / 2])
    xy = points_px - centre
    middle = points_m.mean(axis=0)
    size = float(np.abs(points_m - middle).max())
    scaled = (points_m - middle) / size
    homogeneous = np.column_stack([scaled, np.ones(len(scaled))])
    constraint = np.hstack([xy[:, 1:] * homogeneous, -xy[:, :1] * homogeneous]) / np.abs(xy).max()
    rows = np.linalg.svd(constraint)[2][-1].reshape(2, 4)
    rows = rows / np.linalg.norm(rows[:, :3], axis=1).mean()
    # points lie on the same side of the optical axis as their images, which fixes the sign
    if np.sum(xy * (homogeneous @ rows.T)) < 0:
        rows = -rows
    left, _, right = np.linalg.svd(np.vstack([rows[:, :3], np.cross(rows[0, :3], rows[1, :3])]))
    rotation = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right

    # f (r1 P + t1) - x t3 = x (r3 P), the same for y: focal length and distance
    planar = scaled @ rotation[:2].T + rows[:, 3]
    depth = scaled @ rotation[2]
    system = np.column_stack([planar.ravel(), -xy.ravel()])
    focal, distance = np.linalg.lstsq(system, (xy * depth[:, None]).ravel(), rcond=None)[0]
    if focal <= 0 or distance <= 0:
        raise PzcapError(MISFIT)
    translation = size * np.array([rows[0, 3], rows[1, 3], distance]) - rotation @ middle
    world_T_cam = np.eye(4)
    world_T_cam[:3] = np.column_stack([rotation.T, -rotation.T @ translation])
    return Camera(width, height, world_T_cam, float(focal), centre, 0.0)


def fit(
    camera: Camera, points_m: Array, points_px: Array, config: ReferenceConfig, *, free_lens: bool
) -> ReferenceCamera:
    """Refine the pose of ``camera``, and its focal length and k1 if ``free_lens``, to the points by
    Levenberg-Marquardt: on Huber's cost, whose minimum a distant start finds, then on Geman and McClure's, which
    forgets what is far off by the scale of the others. Of corners of markers a dozen pixels wide, which are right to
    0.05 pixels, some are off by 2."""

    def by_huber(length: Array) -> Array:
        bound = np.minimum(length, config.outlier_px)
        return np.sqrt(bound * (2.0 * length - bound))

    def off_px(step: Array) -> Array:
        return project(_stepped(camera, step), points_m)[0] - points_px

    def fitted(start: Array, cost: Callable[[Array], Array]) -> Array:
        """The step of least ``cost``, which is its root for residuals of a length (N,)."""

        def residuals(step: Array) -> Array:
            """The root of each point's cost, along its residual, and the prior of k1."""
            off = off_px(step)
            length = np.maximum(np.hypot(*off.T), 1e-12)
            of_k1 = _stepped(camera, step).k1 / config.k1_sigma * REFERENCE.corner_sigma_px
            return np.append((cost(length) / length)[:, None] * off, of_k1)

        found = least_squares(residuals, start, method="lm", x_scale="jac", ftol=1e-15, xtol=1e-12, gtol=1e-15)
        return np.asarray(found.x, np.float64)

    near = fitted(np.zeros(8 if free_lens else 6), by_huber)
    sigma = max(normal_sigma(off_px(near)), REFERENCE.least_corner_error_px)
    scale = min(REFERENCE.outlier_sigmas * sigma, config.outlier_px)
    step = fitted(near, lambda length: length / np.hypot(1.0, length / scale))
    found = _stepped(camera, step)
    return ReferenceCamera(found, points_m, points_px, points_px - project(found, points_m)[0])


def _stepped(camera: Camera, step: Array) -> Camera:
    """``camera`` after a step: six numbers for `marker_pose.moved`, and, if the lens is free, log focal and k1."""
    stepped = marker_pose.moved(camera, step[:6])
    if len(step) == 6:
        return stepped
    return replace(stepped, focal_px=camera.focal_px * float(np.exp(step[6])), k1=camera.k1 + float(step[7]))


def resolve(
    reference: ReferenceCamera, lens_camera: Camera, image: Image, calibration_object: CalibrationObject,
    config: ReferenceConfig,
) -> ReferenceCamera:  # fmt: skip
    """Fit the pose again with the intrinsics of ``lens_camera``, which the sweep and the zoom run determine better.

    It is fitted to the corners, then to all grey values of the markers in ``image`` (H, W[, 3]); the corners' pose
    stays where that does not converge, or disagrees by more than their errors allow. The residuals are those of the
    corners. Raises PzcapError as `detect` does.
    """
    start = replace(lens_camera, world_T_cam=reference.camera.world_T_cam)
    points_m, points_px = reference.points_m, reference.points_px
    by_corners = fit(start, points_m, points_px, config, free_lens=False)
    found = marker_pose.fit_pose(by_corners.camera, image, calibration_object, detect(image, calibration_object).ids)
    if found is None:
        return by_corners
    residuals_px = points_px - project(found.camera, points_m)[0]
    shift = np.square(residuals_px - by_corners.residuals_px).sum(axis=1)
    # six parameters fitted to N corners move them by sqrt(3 / N) of the corners' own error
    error_px = max(1.2 * float(np.median(np.hypot(*by_corners.residuals_px.T))), REFERENCE.least_corner_error_px)
    if np.sqrt(shift.mean()) > REFERENCE.pose_agreement * np.sqrt(3.0 / len(shift)) * error_px:
        return by_corners
    return ReferenceCamera(found.camera, points_m, points_px, residuals_px)
