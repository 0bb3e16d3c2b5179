"""Reference image: the calibration object in it, how well it places the camera, and whether it is of this camera."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from pzcap.calibration import reference_camera
from pzcap.calibration.reference_camera import ReferenceConfig
from pzcap.command.check.findings import Finding, Level, graded
from pzcap.command.check.tuning import REFERENCE
from pzcap.command.check.views import mirrored
from pzcap.types import Array, CalibrationObject, Image, PzcapError, ReferenceCamera


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """A reference image, and the camera that took it where the object was found in it."""

    image: Image
    camera: ReferenceCamera | None

    @property
    def focal(self) -> float | None:
        """Focal length over the width of the picture."""
        return None if self.camera is None else self.camera.camera.focal_px / self.camera.camera.width


def check_reference(
    name: str, image: Image, calibration_object: CalibrationObject | None
) -> tuple[Reference, list[Finding]]:
    """The reference image of a camera, and what there is to say about it."""
    if calibration_object is None:
        return Reference(image, None), []
    try:
        camera = reference_camera.calibrate(image, calibration_object, ReferenceConfig())
    except PzcapError as error:
        flipped = _seen(mirrored(image), calibration_object)
        why = (
            f"{error}"
            if flipped < 3
            else f"it is mirrored: {flipped} markers are found in a mirror; record it straight"
        )
        return Reference(image, None), [Finding(Level.FAIL, name, "reference", why)]
    found = list(_of_object(image, camera, calibration_object)) + list(_of_pose(camera))
    return Reference(image, camera), [Finding(level, name, "reference", text) for level, text in found]


def _of_object(image: Image, found: ReferenceCamera, known: CalibrationObject) -> Iterator[tuple[Level, str]]:
    corners = found.points_px.reshape(-1, 4, 2)
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean(axis=1)
    yield (
        graded(-len(corners), -6.0, -2.0),
        f"{len(corners)} of {len(known.markers)} markers found, {sides.min():.0f} to {sides.max():.0f} px wide"
        + ("; more of them fix the pose better" if len(corners) < 6 else ""),
    )
    if np.median(sides) < REFERENCE.smallest_px:
        yield Level.WARN, f"its markers are {np.median(sides):.0f} px wide; 20 or more are good: zoom in, or go nearer"
    off = float(np.sqrt(np.mean(np.sum(found.residuals_px**2, axis=1))))
    yield (
        graded(off, 0.6, 2.0),
        f"corners agree with the object to {off:.2f} px"
        + ("; is object.json of this object, and measured to the millimetre?" if off > 0.6 else ""),
    )
    twice = _twice(image, known)
    if twice:
        yield (
            Level.WARN,
            f"marker {', '.join(map(str, twice))} is seen more than once; take away the other, or cover it",
        )
    columns, rows = found.points_px.round().astype(int).clip(0).T
    bright = image[rows.clip(max=image.shape[0] - 1), columns.clip(max=image.shape[1] - 1)]
    if np.mean(bright >= 254) > 0.3:
        yield Level.WARN, "the white of its markers is burnt out; expose less"


def _of_pose(found: ReferenceCamera) -> Iterator[tuple[Level, str]]:
    camera = found.camera
    pose, focal = camera.world_T_cam, camera.focal_px / camera.width
    roll = np.rad2deg(np.arctan2(-pose[2, 0], -pose[2, 1]))
    place = pose[:3, 3]
    if abs(roll) > REFERENCE.turned_deg:
        yield (
            Level.FAIL,
            f"the picture stands turned by {roll:.0f} degrees; record it upright, and remove no rotation tag",
        )
    if place[2] < 0.0:
        yield (
            Level.FAIL,
            f"the camera stands {-place[2]:.1f} m below the floor; is z up in object.json, its origin on the floor?",
        )
    field = 2.0 * np.rad2deg(np.arctan(0.5 / focal))
    distance = float(np.linalg.norm(found.points_m.mean(axis=0) - place))
    yield Level.OK, f"stands at {_metres(place)}, {distance:.1f} m from the object, and sees {field:.0f} degrees across"


def _metres(place: Array) -> str:
    return "(" + ", ".join(f"{value:.2f}" for value in place) + ") m"


def _markers(image: Image, known: CalibrationObject) -> list[int]:
    identifier = getattr(cv2.aruco, known.dictionary, None)
    if not isinstance(identifier, int):
        return []
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(identifier))
    _, ids, _ = detector.detectMarkers(image)
    ours = {marker.id for marker in known.markers}
    return [] if ids is None else [int(number) for number in ids.ravel() if int(number) in ours]


def _seen(image: Image, known: CalibrationObject) -> int:
    return len(set(_markers(image, known)))


def _twice(image: Image, known: CalibrationObject) -> list[int]:
    ids = _markers(image, known)
    return sorted({number for number in ids if ids.count(number) > 1})
