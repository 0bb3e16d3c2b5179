"""Diagnostics of keyframes from the finished motion: which of them the images contradict, where the next would help
most.

The frames beside a keyframe say what the images have the body do in its own: there they have had their way, where in
the keyframe itself the hand has. A hand errs by so much at each joint (`HAND_SIGMA`); a pose that stands
further off than that was set wrongly, or to another instant.

Away from the keyframes the uncertainty of a joint grows, as the motion itself shows. A keyframe more starts it anew, on
both its sides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import chdtri

from pzcap.body.kinematics import difference, forward, joint_jacobians, joints, retract
from pzcap.body.skeleton import LIMBS, Body
from pzcap.tracking.tuning import HAND_SIGMA
from pzcap.types import SEGMENTS, Array, Keyframe, Motion, Pose

PARTS: Final[dict[str, tuple[int, ...]]] = {
    "trunk": (0, 1, 2, 3), "left arm": LIMBS[0], "right arm": LIMBS[1], "left leg": LIMBS[2], "right leg": LIMBS[3]
}  # fmt: skip
"""Joints of each part of the body."""
_BESIDE: Final = 2  # frames on either side that say what the images have a keyframe be
_ASTRAY: Final = 5  # frames that a timecode may be off by
_CHANCE: Final = 1e-3  # that a hand as good as stated sets a part of the body so far off
_UNKNOWN_M: Final = 1.0  # of a joint, in a frame in which nobody was tracked
_TRIED: Final = 256  # frames of a stretch that are tried, at least, where there are more
_OPEN_M: Final = 0.15  # sigma of a joint, from which on its limb may be anywhere
_OPEN_SHARE: Final = 0.25  # of the frames, from which on it is worth running a detector over all of them
_RISK_M2: Final = 3e-4  # a frame: that a limb is lost unnoticed, some 0.3 m off, in three of a thousand


@dataclass(frozen=True, slots=True)
class Contradiction:
    """A keyframe that stands further from what the images say than a hand errs."""

    frame: int
    parts: tuple[str, ...]  # of PARTS, the worst first
    off_m: float  # of the joint in them that is furthest off
    sigma_m: float  # what a hand errs by there
    like: int | None  # the frame near by that the pose does fit

    def told(self, timecodes: Sequence[str]) -> str:
        """In one line. ``timecodes`` (F,) are those of the frames."""
        where = f"keyframe {self.frame}: the images have its {_listed(self.parts)} {1000 * self.off_m:.0f} mm elsewhere"
        if self.like is not None:
            return f"{where}; it fits frame {self.like}: check its timecode, {timecodes[self.like]} would do"
        return f"{where}, where a hand errs by {1000 * self.sigma_m:.0f} mm; pose it again"


@dataclass(frozen=True, slots=True)
class Suggestion:
    """The frame where one more keyframe would help most."""

    frame: int
    part: str  # of PARTS: what is least certain there

    def told(self, timecodes: Sequence[str]) -> str:
        """In one line. ``timecodes`` (F,) are those of the frames."""
        where = f"frame {self.frame} ({timecodes[self.frame]})"
        return f"{_ADVICE} at {where}, where the {self.part} is least certain"


_ADVICE: Final = "the next keyframe would help most"
_DETECTOR: Final = "a detector's keypoints would help"


def is_advice(note: str) -> bool:
    """True of a note that says what would help, and of nothing that is wrong."""
    return note.startswith((_ADVICE, _DETECTOR))


def notes(
    motion: Motion, keyframes: Sequence[Keyframe], body: Body, timecodes: Sequence[str], detected: bool
) -> tuple[str, ...]:
    """All advice, a line each. ``detected``: the motion was tracked by a detector's keypoints, too."""
    found: list[Contradiction | Suggestion | None] = [*contradictions(motion, keyframes, body)]
    told = [each.told(timecodes) for each in [*found, suggestion(motion)] if each is not None]
    return tuple(told if detected else [*told, *_for_a_detector(motion)])


def _for_a_detector(motion: Motion) -> list[str]:
    """A line where limbs are often in doubt: few keyframes help all of these frames, a detector looks at each."""
    in_doubt = int((motion.valid & (motion.sigma_m > _OPEN_M).any(axis=1)).sum())
    if in_doubt < _OPEN_SHARE * len(motion.valid):
        return []
    return [
        f"{_DETECTOR} (pzcap keypoints FOLDER): in {in_doubt} of {len(motion.valid)} frames a limb is known to no "
        f"better than {1000 * _OPEN_M:.0f} mm"
    ]


# --------------------------------------------------------------------------------------------------------------
# Keyframes that cannot be


def contradictions(motion: Motion, keyframes: Sequence[Keyframe], body: Body) -> tuple[Contradiction, ...]:
    """The keyframes that the motion found from them contradicts."""
    found = (_contradiction(motion, key, body) for key in keyframes if 0 <= key.frame < len(motion.valid))
    return tuple(each for each in found if each is not None)


def _contradiction(motion: Motion, key: Keyframe, body: Body) -> Contradiction | None:
    near = _near(motion, key.frame, _BESIDE)
    if len(near) < 2:
        return None
    said, spread = _in_line(motion, near, key.frame)
    hand = _Hand.of(body, key.pose)
    sigma_m = np.hypot(spread * motion.sigma_m[[key.frame, *near]].max(axis=0), _speeding_m(motion, near, key.frame))
    seen_m = joints(body, said)
    excess = hand.excess(seen_m, sigma_m)
    parts = tuple(part for part in sorted(PARTS, key=excess.__getitem__, reverse=True) if excess[part] > 1.0)
    if not parts:
        return None
    off_m = np.linalg.norm(seen_m - hand.joints_m, axis=1)
    worst = max((joint for part in parts for joint in PARTS[part]), key=off_m.__getitem__)
    fits = {
        frame: max(hand.excess(joints(body, _pose(motion, frame)), sigma_m).values())
        for frame in _near(motion, key.frame, _ASTRAY)
    }
    like = min(fits, key=fits.__getitem__)
    return Contradiction(
        key.frame, parts, float(off_m[worst]), hand.sigma_m(worst), like if fits[like] <= 1.0 else None
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Hand:
    """Joints as a hand has set them, with covariance."""

    joints_m: Array  # (16, 3)
    covariance: Array  # (16, 3, 16, 3)

    @classmethod
    def of(cls, body: Body, pose: Pose) -> _Hand:
        frames = forward(body, pose)
        jacobians = joint_jacobians(frames)
        return cls(frames[:, :3, 3], np.einsum("iad,d,jbd->iajb", jacobians, HAND_SIGMA**2, jacobians))

    def sigma_m(self, joint: int) -> float:
        """Of a joint's distance from where it is."""
        return float(np.sqrt(np.trace(self.covariance[joint, :, joint])))

    def excess(self, seen_m: Array, sigma_m: Array) -> dict[str, float]:
        """Of each part, the squared Mahalanobis distance between the hand and what is seen (joints (16, 3) with the
        standard deviation (16,) of their distance), as a share of the largest that chance allows."""
        found = {}
        for part, members in PARTS.items():
            rows = list(members)
            off, count = (seen_m - self.joints_m)[rows].ravel(), 3 * len(rows)
            hand = self.covariance[rows][:, :, rows].reshape(count, count)
            covariance = hand + np.diag(np.repeat(sigma_m[rows] ** 2 / 3.0, 3))
            found[part] = float(off @ np.linalg.solve(covariance, off) / chdtri(count, _CHANCE))
        return found


def _in_line(motion: Motion, near: Sequence[int], frame: int) -> tuple[Pose, float]:
    """The pose of a frame as those ``near`` it have it: on a parabola through them, on a line where they are on one
    side only. Also, by what factor that is less certain than one of them."""
    degree = 2 if len(near) > 2 and near[0] < frame < near[-1] else 1
    shares = np.linalg.pinv(np.vander(np.array(near) - frame, degree + 1))[-1]
    base = _pose(motion, near[len(near) // 2])
    moved = sum(share * difference(_pose(motion, t), base) for share, t in zip(shares, near, strict=True))
    return retract(base, moved), float(np.linalg.norm(shares))


def _speeding_m(motion: Motion, near: Sequence[int], frame: int) -> Array:
    """Error (16,) of the joints, metres, on a line through the frames ``near``: where these are on one side of a
    ``frame`` only, as much as each has last moved, since a limb that is thrown moves twice as fast a frame later."""
    if near[0] < frame < near[-1]:
        return np.zeros(len(SEGMENTS))
    one, other = motion.joints_m[list(near[:2] if frame < near[0] else near[-2:])]
    return np.asarray(np.linalg.norm(other - one, axis=1))


def _near(motion: Motion, frame: int, reach: int) -> list[int]:
    """The frames within ``reach`` of a frame in which the body was tracked and no hand has set it."""
    around = range(max(frame - reach, 0), min(frame + reach + 1, len(motion.valid)))
    return [t for t in around if t != frame and motion.valid[t] and t not in motion.keyframes]


def _pose(motion: Motion, frame: int) -> Pose:
    return Pose(motion.root_position_m[frame], motion.rotations[frame])


# --------------------------------------------------------------------------------------------------------------
# The next one


def suggestion(motion: Motion) -> Suggestion | None:
    """The frame where one more keyframe takes most variance away. None if there is no keyframe to learn that from, or
    no frame without one."""
    return next(iter(suggestions(motion, (), 1)), None)


def suggestions(motion: Motion, posed: Sequence[int], count: int) -> tuple[Suggestion, ...]:
    """So many frames, at most, where a keyframe would help most, the best first; each takes those before it for set,
    and so are the frames ``posed`` since the motion was tracked.

    Between two keyframes (or before the first, or after the last) the variance of a joint is taken to grow by ``slope``
    with every frame from the nearest one, so that its sum is right. Where in between it is large tells little: two
    passes that have lost a limb alike agree, and differ only where one of them has it still. That they may have is in
    the slope, too.
    """
    frames = np.arange(len(motion.valid))
    keys = np.flatnonzero(np.isin(frames, motion.keyframes) & motion.valid)
    if not 0 < len(keys) < len(frames):
        return ()
    variance = np.where(motion.valid[:, None], motion.sigma_m**2, _UNKNOWN_M**2)  # (F, 16)
    excess = variance - variance[keys].mean(axis=0)
    distance = np.abs(frames[:, None] - keys).min(axis=1)
    spans = [span for span in np.split(frames, np.unique([keys, keys + 1])) if len(span) and span[0] not in keys]
    slopes = [np.maximum(excess[span].sum(axis=0), 0.0) / distance[span].sum() for span in spans]
    found: list[Suggestion] = []
    for frame in posed:
        distance = np.minimum(distance, np.abs(frames - frame))
    while len(found) < count:
        gains = np.zeros(excess.shape)  # of a keyframe in each frame
        for span, slope in zip(spans, slopes, strict=True):
            tried = span[:: max(len(span) // _TRIED, 1)]
            left = np.minimum(distance[span], np.abs(span - tried[:, None]))  # (T, S) by a keyframe in each of them
            gains[tried] = (slope + _RISK_M2) * (distance[span] - left).sum(axis=1)[:, None]
        best = int(np.argmax(gains.sum(axis=1)))
        if gains[best].sum() <= 0.0:
            break
        found.append(Suggestion(best, max(PARTS, key=lambda part: float(gains[best, list(PARTS[part])].mean()))))
        distance = np.minimum(distance, np.abs(frames - best))
    return tuple(found)


def _listed(parts: Sequence[str]) -> str:
    if len(parts) == len(PARTS):
        return "whole body"
    return " and ".join(filter(None, (", ".join(parts[:-1]), parts[-1])))
