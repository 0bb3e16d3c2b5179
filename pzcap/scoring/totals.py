"""Metrics of a method on a capture, summed up from its errors. Each stands here once, whoever asks for it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from pzcap.scoring.body_errors import BodyErrors
from pzcap.scoring.camera_errors import JACCARD_PX, CameraErrors
from pzcap.scoring.metric import Metric, mean, percentile, rms, spread
from pzcap.scoring.records import Series
from pzcap.scoring.score import Errors
from pzcap.types import Array

LOST_M: Final = 0.1  # error of a joint from which on a frame counts as lost, m


def metrics(errors: Errors) -> list[Metric]:
    """Every metric that needs the truth alone; its value is None where the results had not the material."""
    return [
        *angle_metrics(errors.cameras),
        *scene_metrics(errors.cameras, errors.lost),
        *completeness(errors),
        *body_metrics(errors.body),
    ]


def angle_metrics(cameras: Sequence[CameraErrors]) -> list[Metric]:
    """Pan and focal length over all cameras and frames, no offset removed."""
    return [
        *spread("panzoom.pan", np.degrees(joined([c.pan_rad for c in cameras])), "deg"),
        *spread("panzoom.focal", 100.0 * joined([c.focal for c in cameras]), "%"),
    ]


def scene_metrics(cameras: Sequence[CameraErrors], lost: int | None) -> list[Metric]:
    """The whole camera: where it shows the static scene, where it stands, and what it claims."""
    parts = [c.reprojection_points_px for c in cameras if c.reprojection_points_px is not None]
    points = np.concatenate(parts) if parts else np.zeros(0)
    common = np.degrees(joined([c.common_rad for c in cameras]))
    aligned = [1000.0 * joined([c.aligned_centre_m]) for c in cameras]
    jaccard = [
        100.0 * joined([None if c.jaccard is None else c.jaccard[row] for c in cameras])
        for row in range(len(JACCARD_PX))
    ]
    return [
        Metric("panzoom.reprojection.rms", rms(points), "px"),
        Metric("panzoom.reprojection.mean", mean(points), "px"),
        Metric("panzoom.reprojection.p95", percentile(points, 95), "px"),
        *(
            Metric(f"panzoom.jac{within}", mean(values), "%", "higher")
            for within, values in zip(JACCARD_PX, jaccard, strict=True)
        ),
        Metric("panzoom.rotation.rms", rms(np.degrees(joined([c.rotation_rad for c in cameras]))), "deg"),
        Metric("panzoom.rotation.common.median", percentile(common, 50), "deg"),
        Metric("panzoom.rotation.common.rms", rms(common), "deg"),
        Metric("panzoom.position.rms", rms(1000.0 * joined([c.centre_m for c in cameras])), "mm"),
        Metric(
            "panzoom.position.similarity", max((float(one.mean()) for one in aligned if len(one)), default=None), "mm"
        ),
        Metric("panzoom.lost", None if lost is None else float(lost), "frames"),
        Metric("panzoom.bound_ratio.pan", _over([(c.pan_rad, c.pan_bound_rad) for c in cameras]), "1"),
        Metric("panzoom.bound_ratio.focal", _over([(c.focal, c.focal_bound) for c in cameras]), "1"),
        Metric("panzoom.nees", mean(joined([c.nees for c in cameras])), "1"),
    ]


def completeness(errors: Errors) -> list[Metric]:
    """Share of what could have been said that was said, apart from how exact it is."""
    return [
        Metric("panzoom.completeness", _share(errors.answered, errors.views), "%", "higher"),
        Metric("body.completeness", _share(errors.answered_joints, errors.joints), "%", "higher"),
    ]


def body_metrics(body: BodyErrors | None) -> list[Metric]:
    """The metrics of the body; all values are None if no motion was tracked."""
    if body is None:
        none = np.zeros(0)
        scored = inverted = airborne = covered = beyond = limbs = aligned = none
        keyframes = lost = size = None
    else:
        counted = body.scored_joints
        millimetres = 1000.0 * body.joints_m
        scored = millimetres[counted]
        inverted = millimetres[counted & body.inverted[:, None]]
        airborne = millimetres[counted & body.airborne[:, None]]
        covered = beyond = np.zeros(0)
        if body.sigma_m is not None:
            covered = 100.0 * (body.joints_m <= body.sigma_m)[counted].astype(np.float64)
            beyond = 100.0 * (body.joints_m > 3.0 * body.sigma_m)[counted].astype(np.float64)
        limbs = 100.0 * body.limbs
        aligned = np.zeros(0) if body.aligned_m is None else 1000.0 * body.aligned_m[counted]
        size = None if body.similarity is None else 100.0 * (1.0 / body.similarity.scale - 1.0)
        keyframes = float(np.sum(body.keyframe))
        whole = body.valid if body.given is None else body.given.all(axis=1)
        lost = float(np.sum(~whole | np.any(body.joints_m > LOST_M, axis=1)))
    return [
        Metric("body.mpjpe.mean", mean(scored), "mm"),
        Metric("body.mpjpe.p95", percentile(scored, 95), "mm"),
        Metric("body.mpjpe.max", float(scored.max()) if scored.size else None, "mm"),
        Metric("body.mpjpe.inverted", mean(inverted), "mm"),
        Metric("body.mpjpe.airborne", mean(airborne), "mm"),
        Metric("body.mpjpe.similarity", mean(aligned), "mm"),
        Metric("body.size.similarity", None if size is None else abs(size), "%"),  # over the true one's, less 1
        Metric("body.mpjpe.true_cameras", None, "mm"),
        Metric("body.covered", mean(covered), "%", "higher"),  # by one sigma: 68 of an honest one
        Metric("body.beyond3", mean(beyond), "%"),  # three sigma
        Metric("body.limb.rms", rms(limbs), "%"),
        Metric("body.limb.max", float(np.abs(limbs).max()) if limbs.size else None, "%"),
        Metric("body.keyframes", keyframes, "frames"),
        Metric("body.lost", lost, "frames"),
    ]


def joined(series: Sequence[Series | None]) -> Array:
    """The valid values of all ``series``, (N,)."""
    parts = [one.values[one.valid] for one in series if one is not None]
    return np.concatenate(parts) if parts else np.zeros(0)


def _over(pairs: list[tuple[Series | None, Series | None]]) -> float | None:
    """RMS error over the RMS of its bound, in the frames that have both."""
    both = [(e, b, e.valid & b.valid) for e, b in pairs if e is not None and b is not None]
    error = rms(np.concatenate([e.values[at] for e, _, at in both])) if both else None
    least = rms(np.concatenate([b.values[at] for _, b, at in both])) if both else None
    return None if error is None or not least else error / least


def _share(part: int, whole: int) -> float | None:
    return 100.0 * part / whole if whole else None
