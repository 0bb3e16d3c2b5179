"""The formats that results are written in."""

from __future__ import annotations

import difflib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from pzcap.export import (
    aniposelib,
    bvh,
    c3d,
    chan,
    colmap,
    fbx,
    freed,
    gltf,
    mot,
    opentrackio,
    pose2sim,
    soccernet,
    stabilised,
    tables,
    trc,
    uncertainty,
    usd,
)
from pzcap.export.take import Take
from pzcap.types import PzcapError


@dataclass(frozen=True, slots=True)
class Format:
    """A format: how it is written, and what of a take it holds."""

    title: str
    units: str  # and axes
    write: Callable[[Take, Path], list[Path]]
    body: bool
    cameras: bool
    library: str | None = None  # the package that it is written by, where that is none that pzcap needs
    keypoints: bool = False  # of the capture, if it has any
    video: bool = False  # of the capture, which has to be at hand


FORMATS: Final[dict[str, Format]] = {
    "trc": Format("TRC, joints as markers: OpenSim, Pose2Sim", "metres, y up", trc.write, True, False),
    "c3d": Format(
        "C3D, joints as markers: Mokka, Visual3D, Vicon", "millimetres, z up", c3d.write, True, False, "ezc3d"
    ),
    "bvh": Format(
        "BVH, skeleton: Blender, MotionBuilder, Unity", "centimetres, y up; Blender: Scale 0.01", bvh.write, True, False
    ),
    "mot": Format(
        "OpenSim model of the subject (.osim) and its motion (.mot)", "metres and degrees, y up", mot.write, True, False
    ),
    "usd": Format(
        "USD, skinned body and cameras: Houdini, Maya, Omniverse", "metres, z up", usd.write, True, True, "usd-core"
    ),
    "gltf": Format(
        "glTF, skinned body and cameras: Blender, three.js", "metres, y up", gltf.write, True, True, "pygltflib"
    ),
    "fbx": Format(
        "FBX, skinned body and cameras: Unreal, Unity, MotionBuilder", "centimetres, y up", fbx.write, True, True,
        "usd-core",
    ),
    "csv": Format(
        "Tables of cameras and joints: pzcap-score, spreadsheets", "metres, radians and pixels, z up", tables.write,
        True, True,
    ),
    "opentrackio": Format(
        "OpenTrackIO 1.0.1, cameras: Unreal, Aximmetry", "metres and degrees, z up", opentrackio.write, False, True
    ),
    "freed": Format("FreeD D1, cameras: virtual studios", "z up", freed.write, False, True),
    "colmap": Format(
        "COLMAP text, cameras: COLMAP, NeRF and splatting tools", "metres, z up", colmap.write, False, True
    ),
    "soccernet": Format("SoccerNet camera JSON", "metres, z points down", soccernet.write, False, True),
    "chan": Format("Nuke .chan, cameras: Nuke, Blender, Houdini", "metres, y up", chan.write, False, True),
    "aniposelib": Format(
        "aniposelib calibration of virtual fixed cameras, keypoints", "metres, z up", aniposelib.write, False, True,
        keypoints=True,
    ),
    "pose2sim": Format(
        "Pose2Sim project of virtual fixed cameras, keypoints", "metres, z up", pose2sim.write, False, True,
        keypoints=True,
    ),
    "stabilised": Format(
        "Stabilised video of virtual fixed cameras: detectors", "metres", stabilised.write, False, True,
        video=True,
    ),
}  # fmt: skip


def known(name: str) -> str:
    """The format as `FORMATS` calls it, however the ``name`` is spelt. Raises PzcapError where there is none."""
    if name.lower() in FORMATS:
        return name.lower()
    close = difflib.get_close_matches(name.lower(), FORMATS, n=1, cutoff=0.5)
    guess = f"did you mean '{close[0]}'? There are" if close else "there are"
    raise PzcapError(f"no format '{name}'; {guess} {', '.join(FORMATS)}")


def write(take: Take, name: str, folder: Path) -> list[Path]:
    """Write ``take`` in the format ``name`` into ``folder``, and beside it how certain its numbers are; the files.

    Raises PzcapError where the format is not known, the take holds nothing for it, or its library is not installed.
    """
    form = FORMATS[known(name)]
    folder.mkdir(parents=True, exist_ok=True)
    files = form.write(take, folder)
    if form.body and take.reconstruction.motion is not None:
        files.append(uncertainty.write_joints(take, folder))
    if form.cameras:
        files += uncertainty.write_cameras(take, folder)
    return files
