"""Truth and errors as they are shown of a reconstruction without a calibration object.

Nobody knows where its world begins, which way it lies and, to a percent, how large it is. Compared as they stand,
joints are metres off and pans half a turn, and a truth drawn beside them stands in another place. So the truth is
brought into the estimate's world: by the similarity of the motion, and each camera's pan by one offset of its own.
Metrics are never taken from here.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from experiments.score import CameraErrors, Score
from pzcap.geometry.camera import wrapped
from pzcap.scoring.body_errors import Similarity
from pzcap.scoring.records import Series
from pzcap.types import Array
from sim.truth import Truth


def brought_in(truth: Truth | None, result: Score | None, names: tuple[str, ...]) -> tuple[Truth | None, Score | None]:
    """The truth and the errors to show, for cameras ``names`` (C,).

    Unchanged where an object tells where the world begins. The truth is None where no motion tells how the two worlds
    lie to each other.
    """
    if truth is None or result is None or not result.own_world:
        return truth, result
    offsets = [_offset(errors.pan_rad) for errors in result.cameras]
    cameras = tuple(_compared(errors, offset) for errors, offset in zip(result.cameras, offsets, strict=True))
    body = result.body
    if body is None or body.similarity is None or body.aligned_m is None:
        return None, replace(result, cameras=cameras, body=None)
    pan = truth.pan_rad.copy()
    for name, offset in zip(names, offsets, strict=True):
        pan[truth.camera_names.index(name)] += offset
    shown = replace(result, cameras=cameras, body=replace(body, joints_m=body.aligned_m))
    return replace(_moved(truth, body.similarity), pan_rad=wrapped(pan)), shown


def _offset(errors: Series | None) -> float:
    """The mean direction of errors of pan."""
    if errors is None or not errors.valid.any():
        return 0.0
    return float(np.angle(np.mean(np.exp(1j * errors.values[errors.valid]))))


def _compared(errors: CameraErrors, offset: float) -> CameraErrors:
    """Errors of which the pan's are without their ``offset``, and nothing is left that depends on the world."""

    def less(series: Series | None) -> Series | None:
        return None if series is None else Series(wrapped(series.values - offset), series.valid)

    return replace(
        errors, pan_rad=less(errors.pan_rad), refined_pan_rad=less(errors.refined_pan_rad), normalised=None, nees=None,
        reprojection_px=None, reprojection_points_px=None, jaccard=None, rotation_rad=None, centre_m=None,
    )  # fmt: skip


def _moved(truth: Truth, similarity: Similarity) -> Truth:
    """The truth in the world from which the ``similarity`` leads to its own."""
    turn = Rotation.from_matrix(similarity.rotation.T)

    def points(there_m: Array) -> Array:
        return np.asarray((there_m - similarity.shift) @ similarity.rotation / similarity.scale)

    def places(world_T: Array) -> Array:
        moved = world_T.copy()
        moved[..., :3, :3] = similarity.rotation.T @ world_T[..., :3, :3]
        moved[..., :3, 3] = points(world_T[..., :3, 3])
        return moved

    rotations = truth.rotations.copy()
    rotations[:, 0] = (turn * Rotation.from_quat(rotations[:, 0], scalar_first=True)).as_quat(scalar_first=True)
    return replace(
        truth, joints_m=points(truth.joints_m), root_position_m=points(truth.root_position_m), rotations=rotations,
        world_T_cam=places(truth.world_T_cam), reference_world_T_cam=places(truth.reference_world_T_cam),
        sweep_world_T_cam=places(truth.sweep_world_T_cam), scene_points_m=points(truth.scene_points_m),
    )  # fmt: skip
