"""What the pipeline tells while it works: each stage's results as they come, and how far it is."""

from __future__ import annotations

from dataclasses import dataclass

from pzcap.calibration.calibrate import Prepared
from pzcap.tracking.tracker import Tracked
from pzcap.types import Camera, FrameSet, Localisation, Reconstruction, Silhouette


@dataclass(frozen=True, slots=True, eq=False)
class Progress:
    stage: str
    done: int
    total: int  # 0 where it is not known


@dataclass(frozen=True, slots=True, eq=False)
class CameraPrepared:
    """Stages 2-3 are done for one camera; None where the material is missing."""

    index: int
    prepared: Prepared | None


@dataclass(frozen=True, slots=True, eq=False)
class FrameLocalised:
    """Stage 4 is done for one instant."""

    frames: FrameSet
    localisations: tuple[Localisation | None, ...]  # one a camera; None where there is no frame or no camera


@dataclass(frozen=True, slots=True, eq=False)
class FrameSeparated:
    """Stage 5 is done for one instant."""

    frames: FrameSet
    cameras: tuple[Camera | None, ...]  # one a camera; None where it is lost or the frame missing
    silhouettes: tuple[Silhouette | None, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Finished:
    reconstruction: Reconstruction
    seconds: dict[str, float]  # wall time: of the whole of "prepare", summed over the frame sets for the others


Event = Progress | CameraPrepared | FrameLocalised | FrameSeparated | Tracked | Finished
"""`Tracked`: stage 6 is done for one instant. Comes in order, up to two intervals between keyframes late."""
