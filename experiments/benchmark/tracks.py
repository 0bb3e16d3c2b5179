"""The tracks: what a method is given, what it is to find, and the figures that its rows show."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

SELF_CALIBRATION_EVERY: Final = 7
"""Of the frames of the motion, those that a self-calibration has to link: each of them to all others."""
PEERS_EVERY: Final = 10
"""Of the frames of the motion, those that are to be found on a panorama that is given: some methods take seconds."""

CAMERAS: Final = (
    "panzoom.completeness", "panzoom.pan.median", "panzoom.pan.rms", "panzoom.focal.median", "panzoom.focal.rms",
    "panzoom.reprojection.rms", "panzoom.jac5", "panzoom.nees", "panzoom.bound_ratio.pan",
)  # fmt: skip
MOTION: Final = (
    "body.completeness", "body.mpjpe.mean", "body.mpjpe.p95", "body.mpjpe.inverted", "body.mpjpe.airborne",
    "body.mpjpe.similarity", "body.limb.rms", "body.covered", "body.lost",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Track:
    """One table of the board."""

    label: str
    given: str  # besides the rules
    columns: tuple[str, ...]  # metrics; the second is what rows are sorted by
    every: int = 1  # of cameras, only each so many-th frame counts


TRACKS: Final[dict[str, Track]] = {
    "everything": Track(
        "Everything", "the capture folder: footage, object, tape, keyframes, keypoints",
        ("body.completeness", "body.mpjpe.mean", *MOTION[2:6], "panzoom.completeness", "panzoom.pan.rms",
         "panzoom.focal.rms", "panzoom.reprojection.rms", "body.covered"),
    ),
    "cameras": Track("Cameras alone", "the capture folder", CAMERAS),
    "cameras_given_panorama": Track(
        "Cameras, the panorama given", "our calibrated cameras and panoramas, as well", CAMERAS, every=PEERS_EVERY
    ),
    "self_calibration": Track(
        "Self-calibration", "the motion's frames, or all footage, without the calibration object",
        ("panzoom.completeness", "panzoom.rotation.common.median", "panzoom.rotation.common.rms",
         "panzoom.focal.median", "panzoom.focal.rms"), every=SELF_CALIBRATION_EVERY,
    ),
    "body_given_cameras": Track("Body, true cameras given", "true cameras of all frames", MOTION),
    "body_given_cameras_masks": Track(
        "Body, true cameras and masks given", "true cameras and silhouettes of all frames", MOTION
    ),
    "one_camera": Track("One camera only", "the footage of one camera", ("body.completeness", "body.mpjpe.similarity",
                        "body.mpjpe.mean", "body.limb.rms", "panzoom.pan.rms", "panzoom.focal.rms")),
}  # fmt: skip
