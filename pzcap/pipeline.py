"""Footage in, cameras and motion out: the paper's method section, a line a stage."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from pzcap.types import (
    Array,
    Camera,
    Capture,
    FrameSet,
    Localisation,
    Panorama,
    PanZoomCamera,
    Pose,
    Reconstruction,
    ReferenceCamera,
    Silhouette,
)


@dataclass(frozen=True, slots=True, eq=False)
class Config:
    method: str = "exact"  # or "paper", the baseline: no distortion, no tilt, stops at eq. 15


@dataclass(frozen=True, slots=True, eq=False)
class Progress:
    stage: str
    done: int
    total: int


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    reference: ReferenceCamera
    panorama: Panorama
    camera: PanZoomCamera


@dataclass(frozen=True, slots=True, eq=False)
class CameraPrepared:
    """Stages 2-3 are done for one camera; None where the material is missing."""

    index: int
    prepared: Prepared | None  # panzoom.Prepared: .reference, .panorama, .camera


@dataclass(frozen=True, slots=True, eq=False)
class FrameLocalised:
    """Stage 4 is done for one instant."""

    frames: FrameSet
    localisations: tuple[Localisation | None, ...]  # one a camera


@dataclass(frozen=True, slots=True, eq=False)
class FrameSeparated:
    """Stage 5 is done for one instant."""

    frames: FrameSet
    cameras: tuple[Camera | None, ...]  # one a camera; None where it is lost or the frame missing
    silhouettes: tuple[Silhouette | None, ...]


@dataclass(frozen=True, slots=True, eq=False)
class FrameTracked:
    """Stage 6 is done for one instant."""

    index: int
    pose: Pose
    joints_m: Array  # (16, 3)
    sigma_m: Array  # (16,)
    valid: bool


@dataclass(frozen=True, slots=True, eq=False)
class Finished:
    reconstruction: Reconstruction
    seconds: dict[str, float]  # wall time of each stage


Event = Progress | CameraPrepared | FrameLocalised | FrameSeparated | FrameTracked | Finished


def stages(capture: Capture, config: Config) -> Iterator[Event]:
    """Run every stage that ``capture`` has the material for, and yield each result as it comes.

    Memory does not grow with the length of the video, but for the result itself.
    """
    raise NotImplementedError


def reconstruct(capture: Capture, config: Config) -> Reconstruction:
    """Run every stage that ``capture`` has the material for. See ``stages`` for the results on the way."""
    for event in stages(capture, config):
        if isinstance(event, Finished):
            return event.reconstruction
    raise AssertionError("stages() ends with Finished")
