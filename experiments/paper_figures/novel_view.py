"""The athlete and the floor from where no camera stood, painted with what the cameras saw.

The skin of the tracked body is placed in the world; every pixel that shows it takes its colour from the cameras that
see the same point, the more the squarer they look at it. The floor takes its colour from the panoramas. Nothing of the
truth enters.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from experiments.paper_figures.material import Located, Run
from pzcap.body import kinematics
from pzcap.body.skeleton import Body
from pzcap.geometry import camera as geometry
from pzcap.geometry import cylinder
from pzcap.geometry.pinhole import projected
from pzcap.tracking import visibility
from pzcap.types import Array, Camera, Image, Mask, Pose

FINER: Final = 2  # rendered so much finer than shown, to smooth edges
HEIGHT_M: Final = 3.6  # what of the world the picture is high, where the athlete is
FOCAL: Final = 1.9  # image heights
DOWN_DEG: Final = 30.0
HIDDEN_M: Final = 0.03  # behind what a camera sees first
BARE: Final = np.array([165.0, 165.0, 165.0])  # skin that no camera sees
BEYOND: Final = np.array([228.0, 226.0, 224.0])  # where the floor ends
ROOM: Final = 1.12  # of the floor, in extents of the square that the tripods stand in: walls follow behind them


def virtual_camera(run: Run, centre_m: Array, width: int, height: int) -> Camera:
    """Looks down at ``centre_m`` from between the first two cameras, further from all than they are from each other."""
    places = np.array([one.camera.world_T_head[:2, 3] for one in run.located()])
    toward = places[:2].mean(axis=0) - places.mean(axis=0)
    length = float(np.hypot(*toward))
    toward = toward / length if length > 1e-6 else np.array([0.0, -1.0])
    down = np.radians(DOWN_DEG)
    back = FOCAL * HEIGHT_M
    ahead = np.array([*(-np.cos(down) * toward), -np.sin(down)])
    right = np.array([-toward[1], toward[0], 0.0])
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([right, np.cross(ahead, right), ahead])
    pose[:3, 3] = centre_m - back * ahead
    return Camera(width, height, pose, FOCAL * height, np.array([(width - 1) / 2, (height - 1) / 2]), 0.0)


def finer(camera: Camera, times: int) -> Camera:
    """The same view with ``times`` as many pixels each way."""
    principal = times * camera.principal_px + 0.5 * (times - 1)
    return Camera(
        times * camera.width, times * camera.height, camera.world_T_cam, times * camera.focal_px, principal, camera.k1
    )


def render(run: Run, body: Body, frame: int, camera: Camera) -> Image:
    """The hall's floor and the athlete in a frame set, (H, W, 3), as ``camera`` would see them."""
    motion = run.reconstruction.motion
    assert motion is not None
    fine = finer(camera, FINER)
    picture = paint_floor(fine, run.located())
    if motion.valid[frame]:
        pose = Pose(motion.root_position_m[frame], motion.rotations[frame])
        points, normals = kinematics.place(body, kinematics.forward(body, pose))
        images = run.views(frame)
        views = [
            (image, at) for one in run.located()
            if (image := images[one.number]) is not None and (at := one.at[frame]) is not None
        ]  # fmt: skip
        _paint_body(picture, fine, (points, normals, body.surface.faces), views)
    size = camera.width, camera.height
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA).clip(0, 255), np.uint8)


def paint_floor(camera: Camera, located: Sequence[Located]) -> Array:
    """(H, W, 3) the floor z = 0 as the panoramas saw it, the nearest one most, and nothing beyond it."""
    rays = _rays(camera)
    centre = camera.world_T_cam[:3, 3]
    down = rays[:, 2] < -1e-3
    points = centre + rays * (centre[2] / np.where(down, -rays[:, 2], 1.0))[:, None]
    total, weights = np.zeros((len(rays), 3)), np.zeros(len(rays))
    places = np.array([one.camera.world_T_head[:2, 3] for one in located])
    middle = (places.min(axis=0) + places.max(axis=0)) / 2
    inside = down & np.all(np.abs(points[:, :2] - middle) <= ROOM * np.ptp(places, axis=0) / 2, axis=1)
    for one in located:
        head = (points - one.camera.world_T_head[:3, 3]) @ one.camera.world_T_head[:3, :3]
        away = np.hypot(head[:, 0], head[:, 1])
        pixels = cylinder.to_panorama(one.panorama, np.arctan2(head[:, 1], head[:, 0]), head[:, 2] / away)
        colour, known = _sample(one.panorama.image, pixels)
        pasted, _ = _sample(one.panorama.valid.astype(np.uint8), pixels)
        weight = np.where(known & inside & (pasted[:, 0] > 0.5), np.maximum(away, 0.5) ** -4, 0.0)
        total, weights = total + weight[:, None] * colour, weights + weight
    picture = np.where(weights[:, None] > 0, total / np.maximum(weights, 1e-12)[:, None], BEYOND)
    return picture.reshape(camera.height, camera.width, 3)


Skin = tuple[Array, Array, NDArray[np.int64]]
"""Points (V, 3), normals (V, 3), triangles (T, 3)."""


def _paint_body(picture: Array, camera: Camera, skin: Skin, views: Sequence[tuple[Image, Camera]]) -> None:
    points, normals, _ = skin
    depth = _depth(camera, skin)
    shown = np.isfinite(depth)
    if not shown.any():
        return
    rays = _rays(camera)[shown.ravel()]
    along = rays @ camera.world_T_cam[:3, 2]
    surface = camera.world_T_cam[:3, 3] + rays * (depth[shown] / along)[:, None]
    found: tuple[Array, NDArray[np.int64]] = cKDTree(points).query(surface, k=4)  # type: ignore[assignment]
    normal = np.sum(normals[found[1]] / (found[0][..., None] + 1e-3), axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    total, weights = np.zeros_like(surface), np.zeros(len(surface))
    for image, view in views:
        colour, weight = _seen(image, view, skin, surface, normal)
        total, weights = total + weight[:, None] * colour, weights + weight
    bare = BARE * (0.55 + 0.45 * np.clip(normal @ np.array([0.3, -0.3, 0.9]), 0, 1))[:, None]
    trust = np.minimum(weights / 0.02, 1.0)[:, None]
    picture[shown] = trust * total / np.maximum(weights, 1e-9)[:, None] + (1 - trust) * bare


def _seen(image: Image, view: Camera, skin: Skin, surface: Array, normal: Array) -> tuple[Array, Array]:
    """Colours (N, 3) of surface points in one image, and how well it sees each (N,), 0 where not at all."""
    pixels, away = geometry.project(view, surface)
    first, inside = _sample(_depth(view, skin)[..., None], pixels, cv2.INTER_NEAREST)
    toward = view.world_T_cam[:3, 3] - surface
    facing = np.sum(toward * normal, axis=1) / np.linalg.norm(toward, axis=1)
    open_to = inside & (away > 0.2) & (away < first[:, 0] + HIDDEN_M)
    colour, _ = _sample(image, pixels)
    return colour, np.where(open_to, np.clip(facing, 0.0, 1.0) ** 4, 0.0)


def _depth(camera: Camera, skin: Skin) -> NDArray[np.float32]:
    """(H, W) along the optical axis, infinite where there is no body."""
    points, _, faces = skin
    pixels, depth = projected(points, camera)
    z_buffer = visibility.empty_z_buffer((0, 0, camera.width - 1, camera.height - 1), 1.0)
    visibility.rasterise(pixels, depth, faces, np.zeros(len(points), np.uint8), z_buffer)
    return z_buffer.depth


def _rays(camera: Camera) -> Array:
    """(H * W, 3) unit directions of all pixels."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    return geometry.rays(camera, np.column_stack([u.ravel(), v.ravel()]).astype(float))


def _sample(image: NDArray[np.generic], pixels: Array, how: int = cv2.INTER_LINEAR) -> tuple[Array, Mask]:
    """Values (N, channels) at pixels (N, 2), and which of them lie inside (N,)."""
    column, row = pixels.astype(np.float32).T
    rows = 4096  # cv2 takes no image taller than 32767
    pad = -len(column) % rows
    columns_, rows_ = (np.pad(axis, (0, pad)).reshape(-1, rows) for axis in (column, row))
    values = cv2.remap(np.ascontiguousarray(image), columns_, rows_, how, borderMode=cv2.BORDER_REPLICATE)
    inside = (column >= 0) & (row >= 0) & (column <= image.shape[1] - 1) & (row <= image.shape[0] - 1)
    channels = 1 if image.ndim == 2 else image.shape[2]
    return np.asarray(values, float).reshape(-1, channels)[: len(column)], inside
