"""Errors of silhouettes against the true masks, scored as they come.

Silhouettes are of views in which the rows of a rolling shutter have been put right
(`pzcap.localisation.rectification`): so are the true masks, by the true turning of the camera.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from pzcap.scoring.records import Series
from pzcap.types import Image, Mask
from sim.truth import Truth

MIN_BODY_PX: Final = 200
"""Silhouettes are scored in views where the body is at least this tall."""
EVEN: Final = 128
"""A pixel counts as body if its probability (of 255) is more than this; at one half nothing is known."""


@dataclass(frozen=True, slots=True, eq=False)
class ForegroundErrors:
    """Errors of one camera's silhouettes. Valid where the body is tall enough to be scored."""

    iou: Series  # intersection over union
    outline_px: Series  # mean distance between the two outlines
    shadow: Series  # area of the cast shadow that is taken for body, over the body's area


class ForegroundScorer:
    """Scores silhouettes one by one, so that none has to be kept."""

    def __init__(self, truth: Truth, camera_names: tuple[str, ...]) -> None:
        self._truth = truth
        self._cameras = [
            truth.camera_names.index(name) if name in truth.camera_names else None for name in camera_names
        ]
        self._frame_of = {timecode: index for index, timecode in enumerate(truth.timecodes)}
        self._rows: dict[tuple[int, int], tuple[float, float, float | None]] = {}

    def add(self, index: int, timecode: str, camera: int, probability: Image) -> None:
        """Score the silhouette (H, W) of one view of the frame set ``index``."""
        frame, true_camera = self._frame_of.get(timecode), self._cameras[camera]
        if frame is None or true_camera is None:
            return
        true = self._truth.mask(true_camera, frame)
        rows = np.flatnonzero(true.any(axis=1))
        if not len(rows) or rows[-1] - rows[0] + 1 < MIN_BODY_PX:
            return
        estimate = probability > EVEN
        shadow = self._truth.shadow(true_camera, frame)
        if self._truth.readout_s[true_camera]:
            true = self._upright(true, true_camera, frame)
            shadow = None if shadow is None else self._upright(shadow, true_camera, frame)
        wrong = None if shadow is None else float(np.sum(estimate & shadow & ~true) / np.sum(true))
        self._rows[index, camera] = (iou(estimate, true), outline_distance(estimate, true), wrong)

    def _upright(self, mask: Mask, camera: int, frame: int) -> Mask:
        """A true ``mask`` (H, W) as if all rows had been exposed at once: what a row that was exposed later has turned
        and zoomed by since is taken back."""
        truth, (height, width) = self._truth, mask.shape
        near = slice(max(frame - 2, 0), frame + 3)
        at, times_s = frame - near.start, np.arange(len(truth.pan_rad[camera, near])) / float(truth.frame_rate)
        focal_px, (across, down) = truth.focal_px[camera, frame], truth.principal_px[camera, frame]
        pan, zoom = (
            np.gradient(each, times_s)[at] if len(times_s) > 1 else 0.0
            for each in (truth.pan_rad[camera, near], np.log(truth.focal_px[camera, near]))
        )
        row, column = np.mgrid[0:height, 0:width].astype(np.float64)
        delay_s = ((row + 0.5) / height - 0.5) * truth.readout_s[camera]
        x, y = column - across, row - down
        # the scene moves to the right as the camera turns to the left
        column += (focal_px + x * x / focal_px) * pan * delay_s + x * zoom * delay_s
        row += x * y / focal_px * pan * delay_s + y * zoom * delay_s
        places = column.astype(np.float32), row.astype(np.float32)
        seen = cv2.remap(mask.astype(np.uint8), *places, interpolation=cv2.INTER_NEAREST)
        return np.asarray(seen > 0)

    def errors(self, frames: int) -> tuple[ForegroundErrors, ...] | None:
        """Errors of each camera over so many ``frames``; None if no silhouette could be scored."""
        if not self._rows:
            return None
        table = np.zeros((len(self._cameras), 3, frames))
        valid = np.zeros((len(self._cameras), 3, frames), bool)
        for (index, camera), row in self._rows.items():
            for column, value in enumerate(row):
                if value is not None:
                    table[camera, column, index], valid[camera, column, index] = value, True
        return tuple(
            ForegroundErrors(*(Series(table[camera, column], valid[camera, column]) for column in range(3)))
            for camera in range(len(self._cameras))
        )


def iou(one: Mask, two: Mask) -> float:
    """Intersection over union of two masks (H, W)."""
    union = np.sum(one | two)
    return float(np.sum(one & two) / union) if union else 1.0


def outline_distance(estimate: Mask, true: Mask) -> float:
    """Mean distance in pixels from the pixels of each outline to the other; the body's height if nothing is found."""
    rows = np.flatnonzero(true.any(axis=1))
    if not estimate.any():
        return float(rows[-1] - rows[0] + 1)
    columns = np.flatnonzero((estimate | true).any(axis=0))
    rows = np.flatnonzero((estimate | true).any(axis=1))
    window = np.s_[max(rows[0] - 1, 0) : rows[-1] + 2, max(columns[0] - 1, 0) : columns[-1] + 2]
    one, two = _outline(estimate[window]), _outline(true[window])
    forth = cv2.distanceTransform((~two).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[one]
    back = cv2.distanceTransform((~one).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[two]
    return float((forth.sum() + back.sum()) / (len(forth) + len(back)))


def _outline(mask: Mask) -> Mask:
    """The pixels of ``mask`` (H, W) that touch others; the image's border is no outline."""
    solid = mask.astype(np.uint8)
    inside = cv2.erode(solid, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=1)
    return (solid > 0) & (inside == 0)
