"""COLMAP text: cameras.txt, images.txt and points3D.txt, metres; a camera of its own for every picture, since it zooms.

The pixel (0, 0) of COLMAP is the corner of the picture, half a pixel up and left of ours.
"""

from __future__ import annotations

from pathlib import Path

from scipy.spatial.transform import Rotation

from pzcap.export.take import Take, write_text
from pzcap.types import Camera


def write(take: Take, folder: Path) -> list[Path]:
    """Write all cameras in all frames as one model; the files."""
    cameras, images = ["# CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]"], ["# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME"]
    for located in take.cameras():
        for frame, camera in located.frames():
            number = len(cameras)
            cameras.append(f"{number} {_model(camera)}")
            rotation = camera.world_T_cam[:3, :3].T
            quaternion = Rotation.from_matrix(rotation).as_quat(scalar_first=True)
            numbers = " ".join(f"{value:.12g}" for value in (*quaternion, *(-rotation @ camera.world_T_cam[:3, 3])))
            images += [f"{number} {numbers} {number} {located.file}/{frame:06d}.png", ""]
    texts = {
        "cameras.txt": "\n".join(cameras) + "\n",
        "images.txt": "\n".join(images) + "\n",
        "points3D.txt": "# POINT3D_ID X Y Z R G B ERROR TRACK[]\n",
    }
    return [write_text(folder / name, text) for name, text in texts.items()]


def _model(camera: Camera) -> str:
    focal, (x, y) = camera.focal_px, (camera.principal_px + 0.5).tolist()
    name, numbers = "SIMPLE_RADIAL", [focal, x, y, camera.k1]
    if camera.k2 or camera.p1 or camera.p2:
        name, numbers = "OPENCV", [focal, focal, x, y, camera.k1, camera.k2, camera.p1, camera.p2]
    return " ".join([name, str(camera.width), str(camera.height), *(f"{number:.12g}" for number in numbers)])
