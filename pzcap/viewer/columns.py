"""The second half of `pzcap.viewer.recording`: what is a number a frame, sent in columns at a hundredth of the cost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import rerun as rr
from scipy.spatial.transform import Rotation

from pzcap.body import kinematics
from pzcap.body import skeleton as body_model
from pzcap.geometry import camera as geometry
from pzcap.types import SEGMENTS, Array, Camera, Mask, Motion, Panorama, PanZoomCamera, Pose, Reconstruction, Subject
from pzcap.viewer.drawing import (
    BONE_COLOURS,
    BONES,
    CAMERA_COLOURS,
    KEYFRAME_COLOUR,
    SKIN_COLOUR,
    TRUNK_COLOUR,
    Colour,
    centred,
    figures,
    footprint,
    instants,
)

TIMELINE: Final = "frame"

PIXEL_CENTRE: Final = 0.5
"""Rerun puts (0, 0) at the corner of the top-left pixel, pzcap in its centre."""
REFERENCE_PLANE_M: Final = 2.0
"""Distance before its camera at which an image stands in 3D at the reference focal length. It moves out in proportion
to the focal length, so the frustum grows long and narrow as the camera zooms in (as in the paper's Fig. 11)."""


def plain(text: str) -> str:
    """``text`` in ASCII, other characters as escapes: the viewer's font has few, and it dies of one that is missing."""
    return text.encode("ascii", "backslashreplace").decode("ascii")


def path_part(name: str) -> str:
    """A camera's name as part of an entity path."""
    return rr.escape_entity_path_part(plain(name))


def camera_path(root: str, name: str) -> str:
    """Path of a camera in 3D, under ``root`` ("/world" or "/truth")."""
    return f"{root}/camera/{path_part(name)}"


def view_path(root: str, name: str) -> str:
    """The image plane of that camera."""
    return f"{camera_path(root, name)}/view"


def send_reconstruction(rec: rr.RecordingStream, reconstruction: Reconstruction, subject: Subject | None) -> None:
    """Cameras, tracks and motion of a whole reconstruction. ``subject`` gives the body its skin."""
    motion, frames = reconstruction.motion, len(reconstruction.timecodes)
    figure = None if motion is None else figures(motion.joints_m, motion.rotations)
    for number, name in enumerate(reconstruction.camera_names):
        camera, track, panorama = (
            getattr(reconstruction, field)[number] for field in ("cameras", "tracks", "panoramas")
        )
        if camera is None or track is None:
            continue
        colour = CAMERA_COLOURS[number % len(CAMERA_COLOURS)]
        cameras = instants(camera, track)
        send_cameras(rec, "/world", name, cameras, camera.lens.reference_focal_px, colour)
        send_tracks(rec, "/track", name, track.pan_rad, track.focal_px, track.valid, colour)
        if panorama is not None:
            send_footprints(rec, name, panorama, camera, cameras, colour)
        if motion is not None and figure is not None:
            seen = [c if motion.valid[frame] else None for frame, c in enumerate(cameras)]
            send_projected(rec, f"{view_path('/world', name)}/skeleton", seen, figure)
    if motion is not None and figure is not None:
        send_figures(rec, "/world/body/skeleton", figure, motion.valid, BONE_COLOURS)
        path = rr.LineStrips3D([motion.joints_m[motion.valid, 0]], colors=TRUNK_COLOUR, radii=0.008)
        rec.log("/world/body/path", path, static=True)
        for frame in motion.keyframes:
            bones = rr.LineStrips3D(figure[frame][np.array(BONES)], colors=KEYFRAME_COLOUR, radii=0.012)
            rec.log(f"/world/keyframes/{frame}", bones, static=True)
        if subject is not None:
            send_skin(rec, "/world/body/skin", subject, motion)
    notes = "\n".join(f"- {note}" for note in reconstruction.notes) or "Every stage ran."
    rec.log(
        "/notes", rr.TextDocument(plain(f"{frames} frame sets.\n\n{notes}"), media_type="text/markdown"), static=True
    )


def send_cameras(
    rec: rr.RecordingStream,
    root: str,
    name: str,
    cameras: Sequence[Camera | None],
    reference_focal_px: float,
    colour: Colour,
) -> None:
    """A camera that pans and zooms, a pose and a pinhole a frame. Rerun knows no distortion: k1 is left out."""
    found = [(frame, camera) for frame, camera in enumerate(cameras) if camera is not None]
    if not found:
        return
    index = [rr.TimeColumn(TIMELINE, sequence=[frame for frame, _ in found])]
    poses = np.array([camera.world_T_cam for _, camera in found])
    focal = np.array([camera.focal_px for _, camera in found])
    intrinsics = np.zeros((len(found), 3, 3))
    intrinsics[:, 0, 0] = intrinsics[:, 1, 1] = focal
    intrinsics[:, 2, 2] = 1.0
    intrinsics[:, :2, 2] = np.array([camera.principal_px for _, camera in found]) + PIXEL_CENTRE
    rotation = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    rec.send_columns(
        camera_path(root, name), index, rr.Transform3D.columns(translation=poses[:, :3, 3], quaternion=rotation)
    )
    rec.log(view_path(root, name), rr.Pinhole.from_fields(color=colour), static=True)
    # A row replaces the whole pinhole of the row before: what does not change has to stand in each.
    pinholes = rr.Pinhole.columns(
        image_from_camera=intrinsics,
        resolution=np.array([(camera.width, camera.height) for _, camera in found], float),
        image_plane_distance=REFERENCE_PLANE_M * focal / reference_focal_px,
    )
    rec.send_columns(view_path(root, name), index, pinholes)


def send_tracks(
    rec: rr.RecordingStream,
    root: str,
    name: str,
    pan_rad: Array,
    focal_px: Array,
    valid: Mask,
    colour: Colour,
    width: float = 3.0,
) -> None:
    """Pan in degrees and focal length in pixels, as plots."""
    part = path_part(name)
    send_series(rec, f"{root}/pan/{part}", np.degrees(pan_rad), valid, colour, f"pan {plain(name)} [deg]", width)
    send_series(rec, f"{root}/focal/{part}", focal_px, valid, colour, f"focal {plain(name)} [px]", width)


def send_series(
    rec: rr.RecordingStream, path: str, values: Array, valid: Mask, colour: Colour, label: str, width: float = 1.5
) -> None:
    """A number (F,) a frame, where it is valid."""
    rec.log(path, rr.SeriesLines(colors=[colour], names=[label], widths=[width]), static=True)
    frames = np.flatnonzero(valid)
    if len(frames):
        rec.send_columns(path, [rr.TimeColumn(TIMELINE, sequence=frames)], rr.Scalars.columns(scalars=values[frames]))


def send_footprints(
    rec: rr.RecordingStream,
    name: str,
    panorama: Panorama,
    camera: PanZoomCamera,
    cameras: Sequence[Camera | None],
    colour: Colour,
) -> None:
    """The border of every frame on the panorama (Fig. 5)."""
    shown = centred(panorama)
    strips = [[] if at is None else [strip + PIXEL_CENTRE for strip in footprint(shown, camera, at)] for at in cameras]
    _send_strips(rec, f"/panorama/{path_part(name)}/frame", strips, rr.LineStrips2D, colour, 2.0)


def send_figures(
    rec: rr.RecordingStream,
    path: str,
    figure: Array,
    valid: Mask,
    colours: Sequence[Colour] | Colour,
    radius_m: float = 0.014,
) -> None:
    """Figures (F, 21, 3) as lines in 3D."""
    bones = figure[:, np.array(BONES)]
    strips = [list(bones[frame]) if valid[frame] else [] for frame in range(len(figure))]
    _send_strips(rec, path, strips, rr.LineStrips3D, colours, radius_m)


def send_projected(
    rec: rr.RecordingStream,
    path: str,
    cameras: Sequence[Camera | None],
    figure: Array,
    colours: Sequence[Colour] | Colour = BONE_COLOURS,
    radius_px: float = 1.2,
) -> None:
    """Figures (F, 21, 3) as the cameras see them."""
    strips: list[list[Array]] = []
    for camera, points in zip(cameras, figure, strict=True):
        bones: list[Array] = []
        if camera is not None:
            pixels, depth = geometry.project(camera, points)
            # All or none: every bone has its own colour, and a figure that near the lens is of no use.
            bones = list(pixels[np.array(BONES)] + PIXEL_CENTRE) if np.all(depth > 0.2) else []
        strips.append(bones)
    _send_strips(rec, path, strips, rr.LineStrips2D, colours, radius_px)


def send_skin(rec: rr.RecordingStream, path: str, subject: Subject, motion: Motion) -> None:
    """The body's surface: a mesh a segment, moved by its transforms."""
    person = body_model.build(subject)
    frames = np.flatnonzero(motion.valid)
    if not len(frames):
        return
    placed = np.array(
        [kinematics.forward(person, Pose(motion.root_position_m[f], motion.rotations[f])) for f in frames]
    )
    index = [rr.TimeColumn(TIMELINE, sequence=frames)]
    for segment, name in enumerate(SEGMENTS):
        own = np.flatnonzero(person.surface.segment == segment)
        faces = person.surface.faces[np.isin(person.surface.faces, own).all(axis=1)] - own[0]
        mesh = rr.Mesh3D(
            vertex_positions=person.surface.points_m[own],
            vertex_normals=person.surface.normals[own],
            triangle_indices=faces,
            albedo_factor=SKIN_COLOUR,
        )
        rec.log(f"{path}/{name}", mesh, static=True)
        rotation = Rotation.from_matrix(placed[:, segment, :3, :3]).as_quat()
        move = rr.Transform3D.columns(translation=placed[:, segment, :3, 3], quaternion=rotation)
        rec.send_columns(f"{path}/{name}", index, move)


def send_properties(rec: rr.RecordingStream, properties: Mapping[str, Mapping[str, Any]]) -> None:
    """Recording properties: group -> name -> value (text or number)."""
    for group, values in properties.items():
        rec.send_property(group, rr.AnyValues(**{name: _encodable(value) for name, value in values.items()}))


def _encodable(value: Any) -> Any:
    """``value``; of a text that UTF-8 does not hold, such as a path in another encoding, its escapes."""
    return value.encode(errors="backslashreplace").decode() if isinstance(value, str) else value


def _send_strips(
    rec: rr.RecordingStream,
    path: str,
    strips: Sequence[Sequence[Array]],
    archetype: type[rr.LineStrips2D] | type[rr.LineStrips3D],
    colours: Sequence[Colour] | Colour,
    radius: float,
) -> None:
    """Strips a frame; a frame without any shows none."""
    rec.log(path, archetype.from_fields(colors=colours, radii=radius), static=True)
    sizes = [len(frame) for frame in strips]
    flat = [strip for frame in strips for strip in frame]
    columns = archetype.columns(strips=flat).partition(sizes)
    rec.send_columns(path, [rr.TimeColumn(TIMELINE, sequence=range(len(strips)))], columns)
