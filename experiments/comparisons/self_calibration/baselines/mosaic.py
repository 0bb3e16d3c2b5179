"""Shum and Szeliski (2000)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from experiments.comparisons.self_calibration.baselines.adjustment import LensModel, adjust
from experiments.comparisons.self_calibration.baselines.rotations import Frames, Pair
from experiments.comparisons.self_calibration.baselines.shots import Shots, first_values


def shum_szeliski(shots: Shots, pairs: Sequence[Pair]) -> Frames:
    """A mosaic: focal lengths and rotations of all frames, no distortion, principal point in the middle.

    Focal lengths in closed form from the homographies; rotations chained; in a full turn the gap at the end gives the
    focal length and is spread over the turn; then all frames are aligned globally over all overlapping
    pairs, each with a rotation and a focal length. Simplified: homographies from features instead of
    registered patches, and residuals in pixels instead of between rays; no deghosting, which moves pixels, not cameras.
    """
    start = first_values(shots, pairs)
    count = len(shots.found)
    design = np.zeros((count, 4, count))
    design[np.arange(count), 0, np.arange(count)] = 1.0
    constant = np.array([0.0, *shots.centre_px, 0.0])
    # nothing is believed of the focal lengths, but that of a frame without matches must not be anything at all
    model = LensModel(design, np.eye(count), start.lens[:, 0].copy(), np.full(count, 2.0), constant)
    frames, _, _ = adjust(start, start.lens[:, 0].copy(), model, pairs)
    return frames
