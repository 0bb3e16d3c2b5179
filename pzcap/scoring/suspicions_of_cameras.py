"""Suspicions about cameras, against the truth: each undoes one mistake, and speaks where that fits far better."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pzcap.scoring.misreadings import AXES, UNITS, another_world, better, reordered
from pzcap.scoring.projection import angle_between, wrapped
from pzcap.scoring.records import CameraPoses, CameraTrack, TrueCapture
from pzcap.types import Array

SHIFTS: Final = tuple(sorted((shift for shift in range(-30, 31) if shift), key=abs))
TURN_RAD: Final = np.deg2rad(1.0)  # rotations and pans nearer to the truth than this are meant as they are written
STAND_M: Final = 0.5  # cameras nearer to the truth than this stand where it is meant
SHIFT_RAD: Final = np.deg2rad(0.02)
"""The same for frames that are counted otherwise: a frame's worth of panning is little."""
GL_AXES: Final = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """One camera of the results, and where the truth about it stands."""

    name: str
    track: CameraTrack
    true: int  # index among the truth's cameras
    at: NDArray[np.int64]  # (N,) its valid frames
    frames: NDArray[np.int64]  # (N,) the truth's


def suspicious_cameras(seen: Sequence[Seen], truth: TrueCapture, own_world: bool) -> Iterator[str]:
    """Suspicions: what is probably not meant as it is written. Of rotations in an ``own_world`` nothing can be said."""
    if own_world:
        for one in seen:
            yield from _strange_focal(one, truth)
        return
    posed = [one for one in seen if one.track.poses is not None]
    elsewhere = list(_elsewhere(posed, truth)) or list(_swapped(posed, truth))
    yield from elsewhere
    for one in seen:
        yield from _strange_pan(one, truth)
        yield from _strange_focal(one, truth)
        yield from _strange_claim(one, truth)
        if not elsewhere:
            yield from _strange_frames(one, truth)
        if one.track.poses is not None and not elsewhere:
            yield from _strange_pose(one, truth)
            yield from _strange_lens(one, truth)
    yield from _half_pixel(posed, truth)


def enough(shift: int, frames: int) -> int:
    """Frames, of so many, that have to be left of a shift that is to be believed: of a long one more."""
    return max(3 if abs(shift) <= 3 else 10, frames // 2)


def _true(one: Seen, truth: TrueCapture) -> CameraPoses:
    poses = truth.cameras[one.true].track.poses
    assert poses is not None
    return poses


def _posed(one: Seen) -> tuple[Array, Array]:
    assert one.track.poses is not None
    return one.track.poses.rotation[one.at], one.track.poses.position_m[one.at]


def _off(rotation: Array, true: Array) -> float:
    return float(np.median(angle_between(rotation, true)))


def _elsewhere(seen: Sequence[Seen], truth: TrueCapture) -> Iterator[str]:
    """All cameras in a world that is not the calibration object's."""
    if not seen:
        return
    rotation, position = (np.concatenate([_posed(one)[part] for one in seen]) for part in (0, 1))
    true = [_true(one, truth) for one in seen]
    true_rotation = np.concatenate([poses.rotation[one.frames] for one, poses in zip(seen, true, strict=True)])
    true_position = np.concatenate([poses.position_m[one.frames] for one, poses in zip(seen, true, strict=True)])
    turn, apart = _off(rotation, true_rotation), _apart(position, true_position)
    if turn <= TURN_RAD and apart <= STAND_M:
        return
    for words, axes in AXES.items():
        turned = _off(axes @ rotation, true_rotation)
        if (
            np.linalg.det(axes) > 0.0
            and better(turned, turn)
            and better(_apart(position @ axes.T, true_position), apart)
        ):
            yield f"the cameras' world has other axes ({words}): write z up, as the calibration object has it"
            return
    if len(seen) < 3 or any(abs(_size_of(position) / _size_of(true_position) / factor - 1.0) < 0.2 for factor in UNITS):
        return
    found = another_world(position, true_position)
    if found is not None:
        similarity, words = found
        turned = _off(similarity.rotation @ rotation, true_rotation)
        moved = _apart(similarity.apply(position), true_position)
        if turned < TURN_RAD and (better(turned, turn) or turn < TURN_RAD) and better(moved, apart):
            yield f"the cameras' world is another one ({words}): write that of the calibration object"


def _size_of(position: Array) -> float:
    """Median distance from the origin."""
    return float(np.median(np.linalg.norm(position, axis=1)))


def _apart(position: Array, true: Array) -> float:
    return float(np.median(np.linalg.norm(position - true, axis=1)))


def _swapped(seen: Sequence[Seen], truth: TrueCapture) -> Iterator[str]:
    places = [np.median(_true_positions(truth, camera), axis=0) for camera in range(len(truth.cameras))]
    for one in seen:
        apart = [float(np.linalg.norm(np.median(_posed(one)[1], axis=0) - place)) for place in places]
        nearest = int(np.argmin(apart))
        if nearest != one.true and apart[one.true] > 1.0 and better(apart[nearest], apart[one.true]):
            yield f"camera {one.name} stands where camera {truth.camera_names[nearest]} does: cameras swapped?"


def _true_positions(truth: TrueCapture, camera: int) -> Array:
    poses = truth.cameras[camera].track.poses
    assert poses is not None
    return poses.position_m


def _strange_pose(one: Seen, truth: TrueCapture) -> Iterator[str]:
    (rotation, position), true = _posed(one), _true(one, truth)
    true_rotation, true_position = true.rotation[one.frames], true.position_m[one.frames]
    turn = _off(rotation, true_rotation)
    apart = _apart(position, true_position)
    inverse, place = rotation.transpose(0, 2, 1), -np.einsum("fji,fj->fi", rotation, position)
    ratio = _size_of(position) / _size_of(true_position)
    for factor, unit in UNITS.items():
        if abs(ratio / factor - 1.0) < 0.2:
            yield f"camera {one.name}: stands {unit}? write metres"
            return
    if turn > TURN_RAD and better(_off(inverse, true_rotation), turn):
        if better(_apart(place, true_position), apart):
            yield f"camera {one.name}: pose is world to camera: write camera to world, and the projection centre"
        else:
            yield f"camera {one.name}: rotation is transposed: write r11 r12 r13 as the first row of camera to world"
        return
    if turn > TURN_RAD and better(_off(rotation @ GL_AXES, true_rotation), turn):
        yield f"camera {one.name}: camera axes are y up, z back: write x right, y down, z forward"
        return
    if turn > TURN_RAD and better(min(_off(other, true_rotation) for other in reordered(rotation)), turn):
        yield f"camera {one.name}: rotation is of a quaternion in another order (x y z w, or w x y z): exchange them"
        return
    for words, axes in AXES.items():
        if apart > STAND_M and better(_apart(position @ axes.T, true_position), apart):
            yield f"camera {one.name}: world has other axes ({words}): write z up, as the calibration object has it"
            return


def _strange_pan(one: Seen, truth: TrueCapture) -> Iterator[str]:
    pan, true_pan = one.track.pan_rad, truth.cameras[one.true].track.pan_rad
    if pan is None or true_pan is None:
        return
    found, true = pan[one.at], true_pan[one.frames]
    off = _size(found - true)
    if off <= TURN_RAD:
        return
    middle, unsteady = _steady(found - true)
    mirror, mirrored = _steady(-found - true)
    degrees = _size(np.deg2rad(found) - true)
    if len(found) > 2 and unsteady < TURN_RAD and better(unsteady, off):
        yield (
            f"camera {one.name}: pan_rad is off by {np.degrees(middle):.1f} degrees in every frame: pan 0 is the "
            "reference pose"
        )
    elif better(degrees, off) and better(degrees, _size(true)):
        yield f"camera {one.name}: pan_rad is in degrees: write radians"
    elif better(_size(-found - true), off):
        yield f"camera {one.name}: pan_rad is positive to the right: write it positive to the left"
    elif len(found) > 2 and mirrored < TURN_RAD and better(mirrored, off):
        yield (
            f"camera {one.name}: pan_rad is positive to the right, and off by {abs(np.degrees(mirror)):.1f} degrees in "
            "every frame: write it positive to the left, from the reference pose"
        )


def _size(apart: Array) -> float:
    """Median size of angles."""
    return float(np.median(np.abs(wrapped(apart))))


def _steady(apart: Array) -> tuple[float, float]:
    """The middle of angles, and how far they lie from it."""
    middle = float(np.angle(np.exp(1j * apart).mean()))
    return middle, _size(apart - middle)


def _strange_focal(one: Seen, truth: TrueCapture) -> Iterator[str]:
    ratio = one.track.focal_px[one.at] / truth.cameras[one.true].track.focal_px[one.frames]
    middle = float(np.median(ratio))
    steady = float(np.percentile(np.abs(ratio / middle - 1.0), 75)) < 0.02
    if not 0.5 < middle < 2.0:
        yield f"camera {one.name}: focal_px is {middle:.3g} of the true one: millimetres? write pixels"
    elif steady and abs(middle - 1.0) > 0.1:
        yield f"camera {one.name}: focal_px is {middle:.3g} of the true one in every frame: of a resized image?"


def _strange_claim(one: Seen, truth: TrueCapture) -> Iterator[str]:
    covariance, pan, true_pan = one.track.covariance, one.track.pan_rad, truth.cameras[one.true].track.pan_rad
    if covariance is None or pan is None or true_pan is None:
        return
    sigma = float(np.median(np.sqrt(covariance[one.at, 0, 0])))
    off = float(np.median(np.abs(wrapped(pan[one.at] - true_pan[one.frames]))))
    if sigma > 0.0 and (sigma > 300.0 * max(off, 1e-9) and sigma > np.deg2rad(0.1)):
        yield f"camera {one.name}: var_pan claims {np.degrees(sigma):.2g} degrees where the error is " \
              f"{np.degrees(off):.2g}: sigma, or degrees? write radians squared"  # fmt: skip


def _strange_frames(one: Seen, truth: TrueCapture) -> Iterator[str]:
    """Frames that are counted from another start: the poses are those of others."""

    def off(shift: int) -> float:
        there = one.frames + shift
        inner = (there >= 0) & (there < len(truth.timecodes))
        if inner.sum() < enough(shift, len(inner)):
            return np.inf
        if one.track.poses is not None:
            return _off(_posed(one)[0][inner], _true(one, truth).rotation[there[inner]])
        pan, true_pan = one.track.pan_rad, truth.cameras[one.true].track.pan_rad
        assert pan is not None
        assert true_pan is not None
        return float(np.median(np.abs(wrapped(pan[one.at[inner]] - true_pan[there[inner]]))))

    as_written = off(0)
    best = min(SHIFTS, key=off)
    if as_written > SHIFT_RAD and better(off(best), as_written):
        yield f"camera {one.name}: frames are those {abs(best)} {'later' if best > 0 else 'earlier'}: count them from 0"


def _strange_lens(one: Seen, truth: TrueCapture) -> Iterator[str]:
    assert one.track.poses is not None
    k1 = float(np.median(one.track.poses.distortion[one.at, 0]))
    true = float(np.median(_true(one, truth).distortion[one.frames, 0]))
    if abs(true) > 0.005 and abs(k1 + true) < 0.3 * abs(true):
        yield f"camera {one.name}: k1 has the other sign: write that from undistorted to distorted coordinates"


def _half_pixel(seen: Sequence[Seen], truth: TrueCapture) -> Iterator[str]:
    """Principal points that are all off by half a pixel, right and down or left and up."""
    off = []
    for one in seen:
        assert one.track.poses is not None
        off.append(np.median(one.track.poses.principal_px[one.at] - _true(one, truth).principal_px[one.frames], axis=0))
    if not off:
        return
    middle = np.median(off, axis=0)
    for sign in (0.5, -0.5):
        if np.all(np.abs(middle - sign) < 0.12) and np.all(np.abs(np.array(off) - sign) < 0.3):
            yield f"cx_px and cy_px are {sign:+.1f} px off: (0, 0) is the centre of the top-left pixel, not its corner"
