"""USD: a stage with the skinned body (UsdSkel) and the cameras with their zoom; metres, z up, a time code a frame set.

Frames without a body or a camera have no sample: USD interpolates between those beside. Lengths of a lens are tenths of
a scene unit, and its window has no distortion: coefficients and sigmas go along as attributes ``pzcap:...``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from pzcap.export.axes import LOOKING_BACK
from pzcap.export.rest_pose import BONE_PARENTS, BONES, rest_pose
from pzcap.export.take import SENSOR_WIDTH_MM, LocatedCamera, Take, library, write_text
from pzcap.export.uncertainty import lens
from pzcap.types import JOINTS, Array, Camera

_APERTURE = SENSOR_WIDTH_MM / 100.0  # tenths of a metre


def write(take: Take, folder: Path) -> list[Path]:
    """Write what of body and cameras there is; the file."""
    library("pxr", "USD")
    from pxr import Usd, UsdGeom

    whole, stage = take.reconstruction, Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetTimeCodesPerSecond(take.rate)
    stage.SetFramesPerSecond(take.rate)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(len(whole.timecodes) - 1)
    root = UsdGeom.Xform.Define(stage, "/World")
    stage.SetDefaultPrim(root.GetPrim())
    root.GetPrim().SetCustomDataByKey("pzcap:timecode", whole.timecodes[0])
    root.GetPrim().SetCustomDataByKey("pzcap:frameRate", str(whole.frame_rate))
    if whole.motion is not None and whole.motion.body is not None:
        _body(stage, take)
    else:
        take.cameras()  # one of the two there must be
    if any(track is not None and track.valid.any() for track in whole.tracks):
        for located in take.cameras():
            _camera(stage, located)
    return [write_text(folder / f"{take.file}.usda", stage.ExportToString())]


def _camera(stage: Any, located: LocatedCamera) -> None:
    from pxr import Gf, Sdf, UsdGeom

    prim = UsdGeom.Camera.Define(stage, f"/World/camera_{located.file.replace('-', '_')}")
    place = prim.AddTransformOp()
    own = {
        name: prim.GetPrim().CreateAttribute(f"pzcap:{name}", Sdf.ValueTypeNames.Double)
        for name in ("panSigmaDegrees", "focalSigmaPixels", "k1", "k2", "p1", "p2")
    }
    width, height = located.head.lens.width, located.head.lens.height
    down = _APERTURE * height / width
    prim.CreateHorizontalApertureAttr(_APERTURE)
    prim.CreateVerticalApertureAttr(down)
    prim.CreateClippingRangeAttr(Gf.Vec2f(0.1, 1000.0))
    prim.GetPrim().CreateAttribute("pzcap:resolution", Sdf.ValueTypeNames.Int2).Set(Gf.Vec2i(width, height))
    prim.GetPrim().SetDisplayName(located.name)
    focal, across, upward = (
        prim.CreateFocalLengthAttr(), prim.CreateHorizontalApertureOffsetAttr(), prim.CreateVerticalApertureOffsetAttr()
    )  # fmt: skip
    for frame, camera in located.frames():
        x, y = camera.principal_px + 0.5 - (width / 2.0, height / 2.0)
        place.Set(Gf.Matrix4d(*_row_vectors(camera)), frame)
        focal.Set(camera.focal_px * _APERTURE / width, frame)
        across.Set(-float(x) * _APERTURE / width, frame)
        upward.Set(float(y) * down / height, frame)
        values = zip(own.values(), (*located.sigma(frame), *lens(camera)[2:]), strict=True)
        for attribute, value in values:
            attribute.Set(value, frame)


def _row_vectors(camera: Camera) -> list[float]:
    """The pose of a camera that looks along -z, for vectors that are rows."""
    pose = camera.world_T_cam.copy()
    pose[:3, :3] = pose[:3, :3] @ LOOKING_BACK
    return [float(value) for value in pose.T.ravel()]


def _body(stage: Any, take: Take) -> None:
    from pxr import Gf, Sdf, UsdGeom, UsdSkel, Vt

    motion, body = take.rig()
    rest = rest_pose(body)
    athlete = UsdSkel.Root.Define(stage, "/World/Athlete")
    skeleton = UsdSkel.Skeleton.Define(stage, "/World/Athlete/Skeleton")
    animation = UsdSkel.Animation.Define(stage, "/World/Athlete/Skeleton/Motion")
    joints = _paths()
    for schema in (skeleton, animation):
        schema.CreateJointsAttr(joints)
    skeleton.CreateBindTransformsAttr(Vt.Matrix4dArray([_translation(place) for place in rest.places_m]))
    skeleton.CreateRestTransformsAttr(Vt.Matrix4dArray([_translation(offset) for offset in rest.offsets_m]))
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets([animation.GetPath()])

    places, turns = animation.CreateTranslationsAttr(), animation.CreateRotationsAttr()
    animation.CreateScalesAttr(Vt.Vec3hArray([Gf.Vec3h(1, 1, 1)] * len(BONES)))
    sigma = animation.GetPrim().CreateAttribute("pzcap:sigma", Sdf.ValueTypeNames.FloatArray)
    animation.GetPrim().SetCustomDataByKey("pzcap:sigmaJoints", Vt.StringArray(list(JOINTS)))
    still = [[1.0, 0.0, 0.0, 0.0]] * (len(BONES) - motion.rotations.shape[1])
    for frame in np.flatnonzero(motion.valid).tolist():
        here = rest.offsets_m.copy()
        here[0] = motion.root_position_m[frame]
        places.Set(Vt.Vec3fArray.FromNumpy(here.astype(np.float32)), frame)
        turns.Set(Vt.QuatfArray([Gf.Quatf(*row) for row in (*motion.rotations[frame].tolist(), *still)]), frame)
        sigma.Set(Vt.FloatArray.FromNumpy(motion.sigma_m[frame].astype(np.float32)), frame)

    skin = UsdGeom.Mesh.Define(stage, "/World/Athlete/Skin")
    skin.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(rest.skin_m.astype(np.float32)))
    skin.CreateFaceVertexCountsAttr(Vt.IntArray([3] * len(rest.faces)))
    skin.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(rest.faces.ravel().astype(np.int32)))
    skin.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(rest.normals.astype(np.float32)))
    skin.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    skin.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    binding = UsdSkel.BindingAPI.Apply(skin.GetPrim())
    binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1.0))
    binding.CreateJointIndicesPrimvar(False, 1).Set(Vt.IntArray.FromNumpy(rest.carriers.astype(np.int32)))
    binding.CreateJointWeightsPrimvar(False, 1).Set(Vt.FloatArray([1.0] * len(rest.carriers)))
    reached = motion.joints_m[motion.valid]
    extent = np.vstack([reached.min(axis=(0, 1)) - 1.0, reached.max(axis=(0, 1)) + 1.0])
    athlete.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(extent.astype(np.float32)))


def _paths() -> list[str]:
    """Each bone's name after those of the bones that it hangs on."""
    paths: list[str] = []
    for name, parent in zip(BONES, BONE_PARENTS, strict=True):
        paths.append(name if parent < 0 else f"{paths[parent]}/{name}")
    return paths


def _translation(place: Array) -> Any:
    from pxr import Gf

    return Gf.Matrix4d(1.0).SetTranslate(Gf.Vec3d(*place.tolist()))
