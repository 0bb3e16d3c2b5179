"""A camera's track made smooth: what the frames before and after say about each frame, weighed by the covariances.

Pan and log focal each follow a motion whose acceleration drifts by white jerk, constant over a frame; their state is
value, rate and acceleration. A Kalman filter runs forward and a Rauch-Tung-Striebel smoother back over it, in the form
of Bryson and Frazier (1963), which inverts nothing but the covariance of a measurement and so stands exact ones, too.
How strong the jerk is comes from the track itself, by maximum likelihood, unless it is given.

What neighbouring frames are wrong by together does not average out. That part of the covariance is set aside before,
and put back after.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Final

import numpy as np

from pzcap.geometry.camera import wrapped
from pzcap.types import Array, Mask, PanZoomTrack, PzcapError

ORDER: Final = 3
"""States of each of the two: value, rate, acceleration."""
FEWEST: Final = 8
"""A track of fewer frames is left as it is."""
START: Final = np.array([5.0, 50.0]) ** 2
"""Variance of rate and acceleration before the first frame, in rad (or log focal) and seconds: anything goes."""
STRENGTHS: Final = 2.0 ** np.arange(-12, 18)
"""Jerks that are tried, rad/s^3 or 1/s^3; between them the likelihood is interpolated."""


@dataclass(frozen=True, slots=True)
class SmoothConfig:
    """Smoothing of the finished tracks. Off by default: a frame's camera is then what this frame alone says."""

    enabled: bool = False
    """Smooth the tracks at all."""
    pan_deg_s3: float = 0.0
    """Standard deviation of the jerk of pan; 0: found from the track."""
    zoom_s3: float = 0.0
    """And that of log focal, 1/s^3."""
    max_gap_s: float = 0.2
    """Frames that were not found are filled in where they are no longer in a row."""

    def __post_init__(self) -> None:
        if min(self.pan_deg_s3, self.zoom_s3, self.max_gap_s) < 0:
            raise PzcapError("pan_deg_s3, zoom_s3 and max_gap_s of the smoother cannot be negative")


def smooth(track: PanZoomTrack, frame_rate: Fraction, config: SmoothConfig, common: Array) -> PanZoomTrack:
    """``track`` smoothed, and its short gaps filled.

    ``common`` (2, 2) or (F, 2, 2), of (pan, log focal), is the part of each frame's covariance that neighbouring frames
    share: zeros where their errors are independent. In a gap the covariance grows with the time to the next frame that
    was found. A gap longer than ``config.max_gap_s`` stays not valid, and so does what is missing at either end; tilt
    and inliers of frames that were found stay as they are.
    """
    found = np.flatnonzero(track.valid)
    if len(found) < FEWEST:
        return track
    span = slice(found[0], found[-1] + 1)
    seen = track.valid[span]
    measured = np.zeros((len(seen), 2))
    measured[seen] = np.column_stack([np.unwrap(track.pan_rad[found]), np.log(track.focal_px[found])])
    common = np.broadcast_to(common, track.covariance.shape)[span]
    noise = _apart(track.covariance[span], common)

    step_s = float(1 / frame_rate)
    given = np.deg2rad(config.pan_deg_s3), config.zoom_s3
    jerks = [given[k] or jerk(measured[:, k], noise[:, k, k], seen, step_s) for k in range(2)]
    values, covariance = _run(measured, noise, seen, step_s, np.array(jerks))

    kept = seen | _short(~seen, config.max_gap_s / step_s)
    filled = np.flatnonzero(kept & ~seen) + found[0]
    valid = track.valid.copy()
    valid[filled] = True

    def bridged(values: Array) -> Array:
        result = values.copy()
        result[filled] = np.interp(filled, found, values[found])
        return result

    def merged(old: Array, new: Array) -> Array:
        result = old.copy()
        result[span][kept] = new[kept]
        return result

    return replace(
        track, pan_rad=merged(track.pan_rad, wrapped(values[:, 0])), tilt_rad=bridged(track.tilt_rad),
        roll_rad=bridged(track.roll_rad), focal_px=merged(track.focal_px, np.exp(values[:, 1])),
        covariance=merged(track.covariance, covariance + common), valid=valid,
    )  # fmt: skip


def jerk(measured: Array, variance: Array, seen: Mask, step_s: float) -> float:
    """The standard deviation of the jerk under which the measurements (F,) of one quantity are the most likely.

    ``variance`` (F,) is theirs; those not ``seen`` (F,) do not count. All candidates run through one filter at a time.
    """
    transition, push = _motion(step_s)
    drive = STRENGTHS[:, None, None] ** 2 * np.outer(push, push)
    first = int(np.argmax(seen))
    state = np.zeros((len(STRENGTHS), ORDER))
    state[:, 0] = measured[first]
    spread = np.tile(np.diag([variance[first], *START]), (len(STRENGTHS), 1, 1))
    likelihood, count = np.zeros(len(STRENGTHS)), 1
    for frame in range(first + 1, len(measured)):
        state = state @ transition.T
        spread = transition @ spread @ transition.T + drive
        if not seen[frame]:
            continue
        expected = spread[:, 0, 0] + variance[frame]
        surprise = measured[frame] - state[:, 0]
        gain = spread[:, :, 0] / expected[:, None]
        count += 1
        if count > ORDER:  # before, it is the start that is tested
            likelihood -= 0.5 * (np.log(expected) + surprise**2 / expected)
        state = state + gain * surprise[:, None]
        spread = spread - gain[:, :, None] * spread[:, None, 0]
    best = int(np.clip(np.argmax(likelihood), 1, len(STRENGTHS) - 2))
    below, here, above = likelihood[best - 1 : best + 2]
    curvature = below - 2.0 * here + above
    shift = 0.0 if curvature >= 0.0 else float(np.clip(0.5 * (below - above) / curvature, -1.0, 1.0))
    return float(STRENGTHS[best] * 2.0**shift)


# --------------------------------------------------------------------------------------------------------------


def _motion(step_s: float) -> tuple[Array, Array]:
    """Transition (3, 3) of (value, rate, acceleration) by one frame, and what a jerk of 1 adds (3,)."""
    transition = np.array([[1.0, step_s, step_s**2 / 2], [0.0, 1.0, step_s], [0.0, 0.0, 1.0]])
    return transition, np.array([step_s**3 / 6, step_s**2 / 2, step_s])


def _run(measured: Array, noise: Array, seen: Mask, step_s: float, jerks: Array) -> tuple[Array, Array]:
    """Values (F, 2) and covariances (F, 2, 2) of pan and log focal given all measurements (F, 2)."""
    single, push = _motion(step_s)
    transition = np.kron(np.eye(2), single)
    drive = np.kron(np.diag(jerks**2), np.outer(push, push))
    places = np.array([0, ORDER])
    frames, size = len(measured), 2 * ORDER
    states, spreads = np.empty((frames, size)), np.empty((frames, size, size))
    gains, weights, surprises = np.zeros((frames, size, 2)), np.zeros((frames, 2, 2)), np.zeros((frames, 2))

    state = np.zeros(size)
    state[places] = measured[0]
    spread = np.diag([0.0, *START] * 2)
    spread[np.ix_(places, places)] = noise[0]
    for frame in range(frames):
        if frame:
            state = transition @ state
            spread = transition @ spread @ transition.T + drive
            if seen[frame]:
                weights[frame] = np.linalg.inv(spread[np.ix_(places, places)] + noise[frame])
                gains[frame] = spread[:, places] @ weights[frame]
                surprises[frame] = measured[frame] - state[places]
                keep = np.eye(size)
                keep[:, places] -= gains[frame]
                state = state + gains[frame] @ surprises[frame]
                spread = keep @ spread @ keep.T + gains[frame] @ noise[frame] @ gains[frame].T
        states[frame], spreads[frame] = state, spread

    values, covariance = np.empty((frames, 2)), np.empty((frames, 2, 2))
    ahead, certainty = np.zeros(size), np.zeros((size, size))  # what the frames after say, and how surely
    for frame in range(frames - 1, -1, -1):
        rows = spreads[frame][places]
        values[frame] = states[frame][places] - rows @ ahead
        covariance[frame] = spreads[frame][np.ix_(places, places)] - rows @ certainty @ rows.T
        keep = np.eye(size)
        keep[:, places] -= gains[frame]
        ahead, certainty = keep.T @ ahead, keep.T @ certainty @ keep
        ahead[places] -= weights[frame] @ surprises[frame]
        certainty[np.ix_(places, places)] += weights[frame]
        ahead, certainty = transition.T @ ahead, transition.T @ certainty @ transition
    return values, covariance


def _apart(covariance: Array, common: Array) -> Array:
    """``covariance`` (F, 2, 2) less ``common`` (F, 2, 2); what is left of it stays positive."""
    scale = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 1e-30))
    outer = scale[:, :, None] * scale[:, None, :]
    values, vectors = np.linalg.eigh((covariance - common) / outer)
    return np.asarray((vectors * np.maximum(values, 1e-6)[:, None, :]) @ vectors.transpose(0, 2, 1) * outer)


def _short(missing: Mask, longest: float) -> Mask:
    """Mask (F,) of missing frames, no more than ``longest`` in a row."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], missing, [False]]).astype(np.int8)))
    result = np.zeros(len(missing), bool)
    for start, stop in edges.reshape(-1, 2):
        result[start:stop] = stop - start <= longest + 1e-9
    return result
