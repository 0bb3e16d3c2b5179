"""Frames of a rolling shutter as if all their rows had been exposed at once, in the middle of the read-out, and in
the same light.

What stands at a pixel then is seen from where the camera was at that time; that the athlete moved meanwhile is left to
the tracker, which knows the time of a row.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import cv2
import numpy as np

from pzcap.geometry import camera as geometry
from pzcap.geometry.cylinder import smooth_map
from pzcap.imaging.row_bands import row_time, without_bands
from pzcap.localisation.tuning import READOUT
from pzcap.types import Array, Float32, FrameSet, Image, Localisation, PanZoomCamera

Resampled = Callable[[Image, Float32, Float32], Image]


def _resampled_quickly(image: Image, columns: Float32, rows: Float32) -> Image:
    """In half the time of `bspline.resampled`, to some hundredths of a pixel: enough for whatever moves."""
    return np.asarray(cv2.remap(image, columns, rows, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE), np.uint8)


def upright(image: Image, camera: PanZoomCamera, found: Localisation) -> Image:
    """The frame (H, W, 3) with its rows put right, in place and in brightness."""
    if found.bands.size:
        image = without_bands(image, found.bands)
    return rectified(image, camera, found) if is_sheared(camera, found) else image


def upright_views(
    frames: FrameSet, cameras: Sequence[PanZoomCamera | None], found: Sequence[Localisation | None]
) -> FrameSet:
    """``frames``, each view that was ``found`` with its rows put right, and its keypoints with them."""
    images, keypoints = list(frames.images), list(frames.keypoints)
    for index, (image, camera, one) in enumerate(zip(images, cameras, found, strict=True)):
        if image is None or camera is None or one is None:
            continue
        images[index] = upright(image, camera, one)
        if keypoints and is_sheared(camera, one):
            keypoints[index] = rectified_keypoints(keypoints[index], camera, one)
    return replace(frames, images=tuple(images), keypoints=tuple(keypoints))


def is_sheared(camera: PanZoomCamera, found: Localisation) -> bool:
    """True if rows of a frame are displaced by more than can be neglected."""
    across, edge = abs(found.shear[0]) * found.focal_px / 2, abs(found.shear[1]) * camera.lens.width / 4
    return bool(found.valid and max(across, edge) > READOUT.negligible_px)


def rectified(
    image: Image, camera: PanZoomCamera, found: Localisation, resampled: Resampled = _resampled_quickly
) -> Image:
    """The frame (H, W, 3) with all rows as they are seen at mid-exposure, ``resampled`` at columns and rows."""
    height, width = image.shape[:2]

    def exposed(points_px: Array) -> Array:
        return _sheared(camera, found, points_px)

    return resampled(image, *smooth_map(exposed, width, height))


def rectified_points(points_px: Array, camera: PanZoomCamera, found: Localisation) -> Array:
    """Places in the rectified frame of pixels (..., 2) of the frame as it was exposed."""
    there = points_px
    for _ in range(2):
        there = points_px - (_sheared(camera, found, there) - there)
    return np.asarray(there)


def _sheared(camera: PanZoomCamera, found: Localisation, points_px: Array) -> Array:
    """Pixels (..., 2) of the frame as it was exposed that show what stands at ``points_px`` (..., 2) of the rectified
    one. The lens changes with the zoom from row to row: it is a line in log focal, here between the first and the last
    row's."""
    view = geometry.view_at(camera, found.pan_rad, found.tilt_rad, found.focal_px, found.roll_rad)
    azimuth, slope = geometry.pixel_to_direction(view, points_px)
    ends = [
        geometry.view_at(camera, found.pan_rad, found.tilt_rad, focal_px, found.roll_rad)
        for focal_px in found.focal_px * np.exp(found.shear[1] * np.array([-0.5, 0.5]))
    ]
    there = points_px
    for _ in range(2):  # the row that shows it, and so the time, follows from where it is seen
        time = row_time(there[..., 1], camera.lens.height)
        turned = azimuth - found.shear[0] * time
        seen = [(geometry.direction_to_pixel(end, turned, slope)[0] - end.principal_px) / end.focal_px for end in ends]
        late = time[..., None] + 0.5
        principal_px, image = (
            (1.0 - late) * first + late * last for first, last in ([end.principal_px for end in ends], seen)
        )
        there = principal_px + found.focal_px * np.exp(found.shear[1] * time)[..., None] * image
    return np.asarray(there)


def rectified_keypoints(people: Array, camera: PanZoomCamera, found: Localisation) -> Array:
    """Keypoints (P, 26, 3) of a frame as they stand in the rectified one."""
    return np.concatenate([rectified_points(people[..., :2], camera, found), people[..., 2:]], axis=-1)
