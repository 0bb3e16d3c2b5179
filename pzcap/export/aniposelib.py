"""aniposelib: calibration.toml of the virtual fixed cameras and, of a take with keypoints, keypoints.npz for them.

Metres; world to camera; pixel (0, 0) the centre of the top-left pixel, as ours. The keypoints are arrays as
aniposelib's `CameraGroup.triangulate` takes them: ``points`` (C, F, 26, 2), NaN where nothing was found, and
``scores`` (C, F, 26).
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from pzcap.export.take import Take, held, write_text
from pzcap.export.toml import toml
from pzcap.export.virtual_cameras import VirtualCamera, athlete, carried_keypoints, virtual_cameras
from pzcap.geometry.camera import project
from pzcap.io.detections import KEYPOINTS
from pzcap.io.files import written_whole
from pzcap.types import JOINTS, Array

_SHARED: Final = tuple(name for name in KEYPOINTS if name in JOINTS)


def write(take: Take, folder: Path) -> list[Path]:
    """Write the calibration, and keypoints where there are any; the files."""
    virtual = virtual_cameras(take)
    # keys are sorted as text by its reader
    tables = {f"cam_{k:03d}": each.opencv(each.located.name) for k, each in enumerate(virtual)}
    files = [write_text(folder / "calibration.toml", toml({**tables, "metadata": {"adjusted": False, "error": 0.0}}))]
    people = carried_keypoints(take, virtual)
    if people:
        bodies = _expected(take)
        chosen = np.array([
            [_nearest(each, *pair) for pair in zip(rows, bodies, strict=True)]
            for each, rows in zip(virtual, people, strict=True)
        ])  # fmt: skip
        missing = chosen[..., 2:] <= 0.0
        path = folder / "keypoints.npz"
        with written_whole(path) as partial, partial.open("wb") as file:
            names = np.array([each.located.name for each in virtual])
            points = np.where(missing, np.nan, chosen[..., :2])
            np.savez_compressed(
                file, points=points, scores=chosen[..., 2], cameras=names, keypoints=np.array(KEYPOINTS)
            )
        files.append(path)
    return files


def _expected(take: Take) -> Array:
    """(F, N, 3) places of the joints that are keypoints, too; those of the athlete where no body was tracked."""
    motion = take.reconstruction.motion
    if motion is None or not motion.valid.any():
        return np.repeat(athlete(take)[:, None], len(_SHARED), axis=1)
    joints = [JOINTS.index(name) for name in _SHARED]
    return np.asarray(motion.joints_m[held(motion.valid)][:, joints])


def _nearest(each: VirtualCamera, people: Array, joints_m: Array) -> Array:
    """(26, 3) of the person whose keypoints lie nearest to the joints (N, 3) of `_expected`; of nobody zeros."""
    if not len(people):
        return np.zeros((len(KEYPOINTS), 3))
    shared = people[:, [KEYPOINTS.index(name) for name in _SHARED]]
    off = np.linalg.norm(shared[..., :2] - project(each.camera, joints_m)[0], axis=-1)
    weight = shared[..., 2] + 1e-9
    return np.asarray(people[np.argmin((weight * off).sum(axis=1) / weight.sum(axis=1))])
