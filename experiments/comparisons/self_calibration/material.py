"""The frames that all methods are given, and how they were truly taken."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from experiments.comparisons.self_calibration.baselines import Frames, Shots
from pzcap.calibration import features
from pzcap.imaging.colour import grey
from pzcap.io.capture import frame_sets
from pzcap.io.video import VideoReader
from pzcap.types import Array, CameraFiles, Capture, Image, Mask
from sim.truth import Truth

SWEEP_EVERY, ZOOM_EVERY, MOTION_EVERY = 6, 2, 7
FEATURES, THRESHOLD = 800, 2e-4
MASK_MARGIN_PX = 6


@dataclass(frozen=True, slots=True, eq=False)
class Footage:
    """Frames of one camera, and how they were truly taken."""

    images: tuple[Image, ...]
    masks: tuple[Mask | None, ...]  # what is to be left out
    true: Frames
    numbers: tuple[int, ...] = ()  # of the motion's frames in the truth


def hall_footage(files: CameraFiles, truth: Truth, camera: int) -> tuple[Footage, int]:
    """Frames of the sweep, then of the zoom run; and how many are of the sweep."""
    assert files.sweep is not None
    assert files.zoom is not None
    images, rotations, focals = [], [], []
    reference = truth.reference_world_T_cam[camera, :3, :3]
    middle = int(np.argmax(np.abs(truth.sweep_pan_rad[camera]) % np.pi > 1.0))
    turned = Rotation.from_matrix(truth.sweep_world_T_cam[camera, middle, :3, :3] @ reference.T).as_rotvec()
    axis = turned / np.linalg.norm(turned) * np.sign(np.sin(truth.sweep_pan_rad[camera, middle]))
    for number, (_, image) in enumerate(VideoReader(files.sweep)):
        if number % SWEEP_EVERY == 0:
            images.append(image)
            rotations.append(truth.sweep_world_T_cam[camera, number, :3, :3])
            focals.append(truth.reference_focal_px[camera])
    count = len(images)
    zoomed = Rotation.from_rotvec(axis * truth.zoom_pan_rad[camera]).as_matrix() @ reference
    for number, (_, image) in enumerate(VideoReader(files.zoom)):
        if number % ZOOM_EVERY == 0:
            images.append(image)
            rotations.append(zoomed)
            focals.append(truth.zoom_focal_px[camera, number])
    return Footage(tuple(images), (None,) * len(images), _true(truth, camera, rotations, focals)), count


def motion_footage(capture: Capture, truth: Truth, every: int = 0) -> list[Footage]:
    """Each ``every``-th frame of the motion of each camera, and the true masks; 0: as many as make eight or more."""
    sets = frame_sets(capture)
    every = every or max(1, min(MOTION_EVERY, len(truth.timecodes) // 8))
    taken: list[list[tuple[Image, int]]] = [[] for _ in capture.cameras]
    for frames in sets:
        if frames.index % every == 0 and frames.timecode in truth.timecodes:
            at_frame = truth.timecodes.index(frames.timecode)
            for row, image in zip(taken, frames.images, strict=True):
                if image is not None:
                    row.append((image, at_frame))
    result = []
    kernel = np.ones((2 * MASK_MARGIN_PX + 1,) * 2, np.uint8)
    for files, row in zip(capture.cameras, taken, strict=True):
        camera = truth.camera_names.index(files.name)
        indices = [frame for _, frame in row]
        masks = [cv2.dilate(truth.mask(camera, frame).astype(np.uint8), kernel) > 0 for frame in indices]
        true = _true(
            truth, camera, list(truth.world_T_cam[camera, indices, :3, :3]), list(truth.focal_px[camera, indices])
        )
        result.append(Footage(tuple(image for image, _ in row), tuple(masks), true, tuple(indices)))
    return result


def _true(truth: Truth, camera: int, rotations: Sequence[Array], focals: Sequence[float]) -> Frames:
    """k1 is linear in log focal; its line is drawn through the motion's frames and the reference."""
    logs = np.append(np.log(truth.focal_px[camera]), np.log(truth.reference_focal_px[camera]))
    line = np.polyfit(logs, np.append(truth.k1[camera], truth.reference_k1[camera]), 1)
    log_focal = np.log(np.array(focals))
    principal = np.tile(truth.reference_principal_px[camera], (len(log_focal), 1))
    lens = np.column_stack([log_focal, principal, np.polyval(line, log_focal)])
    return Frames(np.array(rotations), lens, np.ones(len(lens), bool))


def shots_of(footage: Footage, masked: bool, sweep: int = 0, full_turn: bool = False) -> Shots:
    """The features of the frames, of which the first ``sweep`` pan in order and the others, if any pan, zoom."""
    found = []
    for image, mask in zip(footage.images, footage.masks, strict=True):
        allowed = None if mask is None or not masked else np.where(mask, 0, 255).astype(np.uint8)
        found.append(features.detect(grey(image), THRESHOLD, FEATURES, allowed))
    height, width = footage.images[0].shape[:2]
    zoom = tuple(range(sweep, len(found))) if sweep else ()
    return Shots(tuple(found), width, height, tuple(range(sweep)), full_turn and sweep > 0, zoom)
