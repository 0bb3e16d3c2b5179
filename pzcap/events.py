"""Events of the pipeline: each stage's results as they come, the time they took, and how far the work is."""

from __future__ import annotations

from dataclasses import dataclass

from pzcap.calibration.calibrate import CalibratedCamera
from pzcap.tracking.camera_refinement import CameraPrior
from pzcap.tracking.tracker import Tracked
from pzcap.types import Camera, FrameSet, Localisation, Reconstruction, Silhouette


@dataclass(frozen=True, slots=True, eq=False)
class Progress:
    """Progress of a stage."""

    stage: str
    done: int
    total: int  # 0 where it is not known


@dataclass(frozen=True, slots=True, eq=False)
class CameraCalibrated:
    """Stages 2-3 are done for one camera; None where the material is missing."""

    index: int
    calibrated: CalibratedCamera | None
    seconds: float  # wall time, beside the other cameras


@dataclass(frozen=True, slots=True, eq=False)
class CamerasReady:
    """Stages 2-3 are done for all cameras, and frames can be localised."""

    seconds: float  # wall time


@dataclass(frozen=True, slots=True, eq=False)
class FrameLocalised:
    """Stage 4 is done for one instant."""

    frames: FrameSet
    localisations: tuple[Localisation | None, ...]  # one a camera; None where there is no frame or no camera
    second_fields: FrameLocalised | None = None  # half a frame period later; None where all views are whole frames
    seconds: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class FrameSegmented:
    """Stage 5 is done for one instant."""

    frames: FrameSet
    cameras: tuple[Camera | None, ...]  # one a camera; None where it is lost or the frame missing
    silhouettes: tuple[Silhouette | None, ...]
    priors: tuple[CameraPrior | None, ...]  # how well each camera is known; None: taken as it is
    seconds: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class BodyTracked:
    """Stage 6 has taken in one instant, or the end. Poses come in order, up to two intervals between keyframes late."""

    poses: tuple[Tracked, ...]
    seconds: float


@dataclass(frozen=True, slots=True, eq=False)
class Finished:
    """All is done."""

    reconstruction: Reconstruction


Event = Progress | CameraCalibrated | CamerasReady | FrameLocalised | FrameSegmented | BodyTracked | Finished
