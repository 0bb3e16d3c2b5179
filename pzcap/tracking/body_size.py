"""Size of the athlete as the silhouettes of the keyframes show it, against that of the tape.

The images know sizes in metres of the calibration object. A keyframe's pose, its root kept, is put on with the whole
body made larger or smaller, and in each view that size is taken which gathers the most evidence of the athlete within
the body's outline (the sum of the log-odds by the colours). Views err apart, by limbs that a hand turned wrong: the
median is the size. It is one more measurement where the tape's sigmas leave room for it. Where they do not, the tape is
another person's, and only the proportions are taken from it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pzcap.body import skeleton
from pzcap.body.anthropometry import Measured
from pzcap.body.skeleton import Body
from pzcap.solver.robust import normal_sigma
from pzcap.tracking.observation import expect
from pzcap.tracking.tuning import BODY_SIZE
from pzcap.types import SEGMENTS, Camera, Float32, Pose, Silhouette


@dataclass(frozen=True, slots=True)
class BodySize:
    """Size of the athlete by the images over that of a body."""

    ratio: float
    sigma: float
    allowed: float  # standard deviation of the ratio by what is known of the body, and by ``sigma``

    @property
    def contradicts(self) -> bool:
        """True where the body is of another person's size."""
        return abs(np.log(self.ratio)) > BODY_SIZE.contradicts_sigmas * self.allowed


def seen_sizes(
    body: Body, pose: Pose, cameras: Sequence[Camera | None], silhouettes: Sequence[Silhouette | None], margin: float
) -> list[float]:
    """Logarithms of the athlete's size over the body's by the views of a keyframe, whose ``pose`` has a hand's error;
    of those alone that tell it."""
    logs = np.arange(-BODY_SIZE.steps, BODY_SIZE.steps + 1) * BODY_SIZE.step
    bodies = [scaled(body, float(ratio)) for ratio in np.exp(logs)]
    found = []
    for camera, silhouette in zip(cameras, silhouettes, strict=True):
        if camera is None or silhouette is None or not silhouette.valid:
            continue
        scores = np.array([_score(each, pose, camera, silhouette, margin) for each in bodies])
        best = int(np.argmax(scores))
        if np.isfinite(scores).all() and 0 < best < len(logs) - 1:  # else it is not the athlete that is seen
            before, at, after = scores[best - 1 : best + 2]
            step = 0.5 * BODY_SIZE.step * (before - after) / (before - 2.0 * at + after)
            found.append(float(logs[best] + step))
    return found


def body_size(body: Body, logs: Sequence[float]) -> BodySize | None:
    """Size by the `seen_sizes` of keyframes; None where too few views tell."""
    if len(logs) < BODY_SIZE.fewest_views:
        return None
    median = float(np.median(logs))
    scatter = normal_sigma(np.array(logs) - median)
    sigma = float(np.linalg.norm([1.25 * scatter / np.sqrt(len(logs)), BODY_SIZE.sigma, _sigma_of_clothes(body)]))
    return BodySize(float(np.exp(median)), sigma, float(np.hypot(sigma, np.sqrt(_size_variance(body.measured)))))


def resized(body: Body, size: BodySize) -> Body:
    """The body by its measurements and its ``size`` in the images: a measurement of all lengths in common. Where it
    contradicts them, they tell proportions alone."""
    values, covariance = body.measured.values_m, body.measured.covariance_m2
    along = np.outer(values, values)
    if size.contradicts:
        covariance = covariance + BODY_SIZE.open**2 * along
    variance = _size_variance(Measured(values, covariance))
    gain = variance / (variance + size.sigma**2)
    values = values * np.exp(gain * np.log(size.ratio))
    return skeleton.of(Measured(values, covariance - gain * variance * along), body.worn)


def scaled(body: Body, ratio: float) -> Body:
    """The body so many times as large."""
    return replace(body, offsets_m=ratio * body.offsets_m, surface=body.surface.scaled(ratio))


def _sigma_of_clothes(body: Body) -> float:
    """Standard deviation of the logarithm of the size for clothes, which stand off by nobody knows how much."""
    if not body.loose_m.any():
        return 0.0
    points, segment = body.surface.points_m, body.surface.segment
    extents = np.array([np.sort(np.ptp(points[segment == s], axis=0)) for s in range(len(SEGMENTS))])
    across, along = extents[:, :2].mean(axis=1), extents[:, 2]
    return float(BODY_SIZE.loose * (2.0 * body.loose_m @ along) / (across @ along))


def _size_variance(measured: Measured) -> float:
    """Variance of the logarithm of the size that all measurements have in common."""
    return float(1.0 / (measured.values_m @ np.linalg.solve(measured.covariance_m2, measured.values_m)))


def _score(body: Body, pose: Pose, camera: Camera, silhouette: Silhouette, margin: float) -> float:
    """Sum of the evidence within the body's outline; infinitely bad where the body is out of view."""
    expected = expect(body, pose, 0.0, camera, margin)
    if expected is None:
        return -np.inf
    height, width = expected.distance_px.shape
    top, left = expected.top // 2, expected.left // 2
    evidence: Float32 = silhouette.evidence[top : top + height, left : left + width]
    inside = evidence[expected.distance_px > 0.0]
    return float(np.clip(inside, -BODY_SIZE.most_log_odds, BODY_SIZE.most_log_odds).sum())
