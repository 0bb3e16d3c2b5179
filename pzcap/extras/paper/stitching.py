"""The paper's panorama (section 3.5): unfolded frames, chained by their displacements, each pasted where nothing is
yet."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from pzcap.calibration import features
from pzcap.calibration.sweep import Frames, SweepConfig
from pzcap.extras.paper.unfolding import to_cylinder
from pzcap.imaging.colour import grey
from pzcap.types import Panorama, PzcapError


def stitch(frames: Frames, focal_px: float, config: SweepConfig, report: Callable[[int], None]) -> Panorama:
    """The panorama of section 3.5, whose first frame has pan 0; it does not wrap.

    The displacement of each frame against the one before it is the median of the AKAZE matches' on the cylinder.
    Raises PzcapError where two successive frames show nothing in common.
    """
    places = [np.zeros(2)]
    inliers = []
    spread = []
    before: features.Features | None = None
    for number, (_, image) in enumerate(frames):
        unfolded, covered, origin = to_cylinder(image, focal_px)
        inside = np.asarray(cv2.erode(covered.astype(np.uint8), np.ones((9, 9), np.uint8)), np.uint8)
        found = features.detect(grey(unfolded), config.threshold, config.features, inside)
        if before is not None:
            pairs = features.match(before, found, config.ratio)
            moved = before.points_px[pairs[:, 0]] - found.points_px[pairs[:, 1]]
            agree = features.densest(moved[:, 0], 4.0) if len(moved) else np.zeros(0, bool)
            if agree.sum() < config.min_matches:
                raise PzcapError(
                    f"sweep: frames {number - 1} and {number} show nothing in common; pan more slowly, past texture"
                )
            step = np.median(moved[agree], axis=0)
            places.append(places[-1] + step)
            inliers.append(int(agree.sum()))
            spread.append(np.mean(np.sum((moved[agree] - step) ** 2, axis=1)))
        before = found
        report(number + 1)
    if before is None or len(places) < 3:
        raise PzcapError(f"sweep: {len(inliers) + 1} frames are too few; record the whole pan")

    corners = np.round(np.array(places)).astype(int)
    corners = corners - corners.min(axis=0)
    height, width = covered.shape
    image_out = np.zeros((corners[:, 1].max() + height, corners[:, 0].max() + width, 3), np.uint8)
    written = np.zeros(image_out.shape[:2], bool)
    for (x, y), (_, image) in zip(corners, frames, strict=True):
        unfolded, covered, _ = to_cylinder(image, focal_px)
        new = covered & ~written[y : y + height, x : x + width]
        image_out[y : y + height, x : x + width][new] = unfolded[new]
        written[y : y + height, x : x + width] |= new
    pan = -np.array(places)[:, 0] / focal_px
    return Panorama(
        image_out, written, focal_px, corners[0] + origin, False, pan,
        np.array([*inliers, inliers[-1]], np.int64), 0.0, float(np.sqrt(np.mean(spread))),
    )  # fmt: skip
