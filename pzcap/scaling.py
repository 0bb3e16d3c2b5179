"""Records in other units of length: cameras, panoramas, motion, a whole reconstruction."""

from __future__ import annotations

from dataclasses import replace

from pzcap.calibration.calibrate import CalibratedCamera
from pzcap.geometry import camera as geometry
from pzcap.types import Array, Motion, Panorama, PanZoomCamera, Reconstruction, ReferenceCamera


def scaled_camera(one: CalibratedCamera, factor: float, world_T_head: Array) -> CalibratedCamera:
    """A camera whose head stands at ``world_T_head``, lengths of its own times ``factor``."""
    camera = scaled_head(one.camera, factor, world_T_head)
    there = geometry.at(camera, 0.0, camera.tilt_rad, one.reference.camera.focal_px)
    return CalibratedCamera(replace(one.reference, camera=there), _panorama(one.panorama, factor), camera)


def scaled_head(camera: PanZoomCamera, factor: float, world_T_head: Array) -> PanZoomCamera:
    """A head at ``world_T_head``, lengths of its own times ``factor``."""
    return replace(
        camera, world_T_head=world_T_head, offset_m=factor * camera.offset_m, travel_m=factor * camera.travel_m
    )


def scaled_pose(world_T: Array, factor: float) -> Array:
    """(4, 4) the pose in a world that is so many times as large."""
    found = world_T.copy()
    found[:3, 3] *= factor
    return found


def scaled(found: Reconstruction, factor: float) -> Reconstruction:
    """Everything in it so many times as large."""
    return replace(
        found,
        references=tuple(None if one is None else _reference(one, factor) for one in found.references),
        cameras=tuple(
            None if one is None else scaled_head(one, factor, scaled_pose(one.world_T_head, factor))
            for one in found.cameras
        ),
        panoramas=tuple(None if one is None else _panorama(one, factor) for one in found.panoramas),
        motion=None if found.motion is None else _motion(found.motion, factor),
    )


def _reference(one: ReferenceCamera, factor: float) -> ReferenceCamera:
    return replace(one, camera=replace(one.camera, world_T_cam=scaled_pose(one.camera.world_T_cam, factor)))


def _motion(motion: Motion, factor: float) -> Motion:
    own = motion.body
    body = own and replace(
        own, offsets_m=factor * own.offsets_m, ends_m=factor * own.ends_m, skin_m=factor * own.skin_m
    )
    return replace(
        motion, root_position_m=factor * motion.root_position_m, joints_m=factor * motion.joints_m,
        sigma_m=factor * motion.sigma_m, body=body,
    )  # fmt: skip


def _panorama(panorama: Panorama, factor: float) -> Panorama:
    hall = panorama.surroundings
    scaled = replace(hall, height_m=factor * hall.height_m, walls=hall.walls / factor)
    return replace(panorama, surroundings=scaled)
