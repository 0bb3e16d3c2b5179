"""Keypoints in the motion videos as a 2D detector finds them: true ones with the errors of a detector.

A detector looks at a picture of one size, however large the athlete is in the video, so its errors are a share of the
body. A keypoint has a systematic offset on the body. Errors last for some frames; they grow where the body is small,
blurred, upside down or hides a joint. Left and right are swapped at times; a few keypoints are elsewhere on the body,
or are not found. The confidence says how hard a joint was to see, not how wrong it is.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

import mujoco
import numpy as np

from pzcap.types import PARENTS, SEGMENTS, Array, Mask, Pose
from sim.cameras.operator import Trajectory
from sim.cameras.optics import Rig
from sim.cameras.sensor import SensorConfig, by_rows
from sim.people.athlete import GEOM_GROUP, set_pose
from sim.ranges import Pixels, Range, Share

BODY_25: Final = (
    "nose", "neck", "right_shoulder", "right_elbow", "right_wrist", "left_shoulder", "left_elbow", "left_wrist",
    "mid_hip", "right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle",
    "right_eye", "left_eye", "right_ear", "left_ear",
    "left_big_toe", "left_small_toe", "left_heel", "right_big_toe", "right_small_toe", "right_heel",
)  # fmt: skip
_ARMS: Final = ("shoulder", "elbow", "wrist")
_LEGS: Final = ("hip", "knee", "ankle", "big_toe", "small_toe", "heel")
_FACE: Final = ("eye", "ear")
_BOTH: Final = tuple(
    [BODY_25.index(f"{side}_{name}") for name in (*_ARMS, *_LEGS, *_FACE)] for side in ("left", "right")
)
_SWAPS: Final = tuple(
    tuple([BODY_25.index(f"{side}_{name}") for name in names] for side in ("left", "right")) for names in (_ARMS, _LEGS)
)


@dataclass(frozen=True, slots=True)
class DetectorConfig:
    """Errors of a keypoint detector, of the size of OpenPose's.

    Lengths are standard deviations along each axis, in shares of the athlete's stature: a detector looks at a picture
    of one size however large the athlete is in the video.
    """

    enabled: bool = False
    """Write keypoints beside the videos. Off: the method does without."""
    meaning: Share = 0.008
    """Offset of what it takes for a keypoint from the true place, constant on the body: 14 mm of 1.70 m."""
    noise: Share = 0.007
    """Error of a joint that it sees well: 12 mm of 1.70 m."""
    noise_px: Pixels = 0.7
    """Error due to the video's resolution, px, besides."""
    blur: Annotated[float, Range(0.0, 10.0)] = 0.5
    """Error due to motion blur, share of the blur's length, besides."""
    hidden: Annotated[float, Range(0.0, 100.0)] = 3.0
    """Factor of the error where the body hides the joint."""
    inverted: Annotated[float, Range(0.0, 100.0)] = 2.0
    """Factor of the error, and of how often sides are swapped, where the body is upside down: detectors are trained on
    upright people."""
    memory: Annotated[float, Range(0.0, 0.999)] = 0.7
    """Correlation of the error from one frame to the next: pictures that are alike mislead alike."""
    swapped: Share = 0.02
    """Share of the frames in which left and right arms, or legs, are taken for one another."""
    swap_frames: Annotated[float, Range(1.0, 10_000.0)] = 4.0
    """Mean duration of such a swap, frames."""
    astray: Share = 0.01
    """Share of the keypoints that are found anywhere on the body."""
    missed: Share = 0.01
    """Share of the keypoints that are not found; twice as many of those that the body hides."""
    exchanged: Share = 0.0
    """Share of the pictures in which the whole body, face and all, is seen from the wrong side: every left is a right.
    As often more as `inverted` says where the body is upside down; a sixth of a tumbler's with BlazePose."""
    lost: Share = 0.0
    """Share of the pictures of hard postures (upside down, or seen along the trunk) in which the whole body is lost:
    found turned over, or, half as often, not found. A third of them with BlazePose."""
    candid: bool = True
    """Say by the confidence how hard a joint was to see. Off: it is 0.99 right or wrong."""
    others: Annotated[int, Range(0, 10)] = 0
    """People besides who walk to and fro across the hall and are found, too, though they are not filmed."""


class Detector:
    """A detector, whose keypoints have the same systematic offsets in every video."""

    def __init__(
        self, model: mujoco.MjModel, measurements: dict[str, float], config: DetectorConfig, rng: np.random.Generator
    ) -> None:
        self._model, self._data = model, mujoco.MjData(model)
        self._config, self._stature_m = config, measurements["stature"]
        places = _places(measurements)
        self._segment = np.array([SEGMENTS.index(places[name][0]) for name in BODY_25])
        points = np.array([places[name][1] for name in BODY_25])
        self._points_m = points + rng.normal(0.0, config.meaning * self._stature_m, points.shape)
        bodies = [model.body(name).id for name in SEGMENTS]
        self._bodies = np.array(bodies)
        self._segment_of = {body: s for s, body in enumerate(bodies)}

    def watch(
        self, rig: Rig, trajectory: Trajectory, person: Callable[[float], Pose], times_s: Array, sensor: SensorConfig,
        rng: np.random.Generator,
    ) -> Array:  # fmt: skip
        """Keypoints (T, 25, 3) of pictures exposed at ``times_s`` (T,): x, y, confidence; 0 where not found."""
        config, pictures = self._config, len(times_s)
        seen = np.array([self._look(rig, trajectory, person, t, sensor) for t in times_s.tolist()])
        pixels, size_px, blur_px, hidden, upside = (
            seen[..., :2], seen[..., 2], seen[..., 3], seen[..., 4] > 0, seen[..., 5] > 0
        )  # fmt: skip
        ideal = np.hypot(config.noise * size_px, config.noise_px)
        hard = np.where(hidden, config.hidden, 1.0) * np.where(upside, config.inverted, 1.0)
        sigma = hard * np.hypot(ideal, config.blur * blur_px)
        error = np.empty(pixels.shape)
        error[0] = rng.normal(size=pixels.shape[1:])
        fresh = np.sqrt(1.0 - config.memory**2)
        for t in range(1, pictures):
            error[t] = config.memory * error[t - 1] + fresh * rng.normal(size=pixels.shape[1:])
        found = pixels + sigma[..., None] * error
        often = np.where(upside[:, 0], config.inverted, 1.0)
        for group in _SWAPS:
            rows = np.flatnonzero(_stretches(config.swapped * often, config.swap_frames, rng))[:, None]
            left, right = group
            found[rows, left], found[rows, right] = found[rows, right], found[rows, left]
        whole = rng.spawn(1)[0]  # faults that are off by default leave the draws of the others as they were
        backward = np.flatnonzero(_stretches(config.exchanged * often, config.swap_frames, whole))[:, None]
        found[backward, np.concatenate(_BOTH)] = found[backward, np.concatenate(_BOTH[::-1])]
        hard_posture = upside[:, 0] | _end_on(pixels, size_px)
        lost = _stretches(np.where(hard_posture, config.lost, 0.0), config.swap_frames, whole)
        middle = np.median(found, axis=1, keepdims=True)
        found = np.where(lost[:, None, None], 2.0 * middle - found, found)
        unfound = lost & (_lasting(lost, whole) < 1.0 / 3.0)
        astray = rng.uniform(size=sigma.shape) < config.astray
        anywhere = rng.integers(len(BODY_25), size=sigma.shape)
        found = np.where(astray[..., None], np.take_along_axis(found, anywhere[..., None], axis=1), found)
        effort = np.maximum(sigma / np.maximum(ideal, 1e-9), 1.0)
        confidence = 0.9 / np.sqrt(effort) + 0.08 * rng.normal(size=sigma.shape)
        confidence = np.where(astray, 0.5 * confidence, confidence)
        confidence = confidence if config.candid else np.full(sigma.shape, 0.99)
        missed = rng.uniform(size=sigma.shape) < config.missed * np.where(hidden, 2.0, 1.0)
        inside = np.all((found >= -0.5) & (found < [rig.width - 0.5, rig.height - 0.5]), axis=2)
        there = inside & ~missed & (size_px > 0) & ~unfound[:, None]
        return np.where(there[..., None], np.dstack([found, np.clip(confidence, 0.05, 1.0)]), 0.0)

    def _look(
        self, rig: Rig, trajectory: Trajectory, person: Callable[[float], Pose], time_s: float, sensor: SensorConfig
    ) -> Array:  # fmt: skip
        """True keypoints (25, 6): pixel, the body's height and the blur's length (px), hidden, upside down."""

        def seen(at_s: float) -> tuple[Array, Array]:
            aim = trajectory.at(at_s)
            return rig.project(rig.world_T_cam(*aim), aim.focal_px, self._place(person(at_s)))

        half_s = sensor.shutter_s / 2
        start, end, pixels = (
            by_rows(lambda t: seen(t)[0], at_s, rig.height, sensor.readout_s)
            for at_s in (time_s - half_s, time_s + half_s, time_s)
        )
        aim = trajectory.at(time_s)
        pose, points = rig.world_T_cam(*aim), self._place(person(time_s))
        _, depth = rig.project(pose, aim.focal_px, points)
        size = np.where(depth > 0.1, self._stature_m * aim.focal_px / np.maximum(depth, 0.1), 0.0)
        hidden = [self._hidden(pose[:3, 3], k, point) for k, point in enumerate(points)]
        data, head = self._data, self._bodies[SEGMENTS.index("head")]
        upside = np.full(len(points), data.xpos[head, 2] < data.xpos[self._bodies[0], 2])
        return np.column_stack([pixels, size, np.linalg.norm(end - start, axis=1), hidden, upside])

    def _place(self, pose: Pose) -> Array:
        """The keypoints (25, 3) in the world, of an athlete who stands as ``pose`` has it."""
        set_pose(self._model, self._data, pose)
        mujoco.mj_kinematics(self._model, self._data)
        bodies = self._bodies[self._segment]
        turns = self._data.xmat[bodies].reshape(-1, 3, 3)
        return np.asarray(self._data.xpos[bodies] + np.einsum("kij,kj->ki", turns, self._points_m))

    def _hidden(self, eye_m: Array, keypoint: int, point_m: Array) -> bool:
        """True if a part of the body that is no neighbour of the keypoint's own stands in front of it."""
        groups = np.array([group == GEOM_GROUP for group in range(6)], np.uint8)
        geom = np.zeros(1, np.int32)
        way = point_m - eye_m
        distance = mujoco.mj_ray(self._model, self._data, eye_m, way, groups, 1, -1, geom, None)
        if not 0.0 <= distance < 1.0:
            return False
        other, own = self._segment_of[int(self._model.geom_bodyid[geom[0]])], int(self._segment[keypoint])
        return other != own and PARENTS[own] != other and PARENTS[other] != own


def _stretches(often: Array, frames: float, rng: np.random.Generator) -> Mask:
    """(T,) frames in which something goes wrong: a Markov chain of two states, wrong in a share ``often`` (T,) of the
    frames if that is small, for so many ``frames`` on the whole."""
    draws, wrong, now = rng.uniform(size=len(often)), np.zeros(len(often), bool), False
    for t, draw in enumerate(draws.tolist()):
        now = draw > 1.0 / frames if now else draw < often[t] / frames
        wrong[t] = now
    return wrong


def _lasting(wrong: Mask, rng: np.random.Generator) -> Array:
    """(T,) uniform draws, one for each stretch of frames that are ``wrong`` (T,)."""
    draws = rng.uniform(size=len(wrong))
    for t in range(1, len(wrong)):
        if wrong[t] and wrong[t - 1]:
            draws[t] = draws[t - 1]
    return np.asarray(draws)


def _end_on(pixels: Array, size_px: Array) -> Mask:
    """(T,) pictures that look along the trunk: it is less than half as long there as it could be."""
    neck, hips = BODY_25.index("neck"), BODY_25.index("mid_hip")
    return np.asarray(np.linalg.norm(pixels[:, neck] - pixels[:, hips], axis=1) < 0.14 * size_px[:, hips])


def write_openpose(folder: Path, name: str, people: Sequence[Array]) -> None:
    """One JSON file a picture, as OpenPose has them: keypoints (T, 25, 3) of each of the ``people``, who stand in the
    files in turn; none where nothing is seen."""
    folder.mkdir()
    for number in range(len(people[0])):
        first = number % len(people)
        seen = [one[number] for one in (*people[first:], *people[:first]) if one[number].any()]
        found = [{"person_id": [-1], "pose_keypoints_2d": np.round(one, 3).ravel().tolist()} for one in seen]
        value = json.dumps({"version": 1.3, "people": found}, separators=(",", ":"))
        (folder / f"{name}_{number:012d}_keypoints.json").write_text(value + "\n", encoding="utf-8")


def _places(m: dict[str, float]) -> dict[str, tuple[str, tuple[float, float, float]]]:
    """Segment of each keypoint, and its place in the segment's frame, m: what annotators click on."""
    depth, breadth = 0.175 * m["girth_head"], 0.14 * m["girth_head"]  # half axes of a head
    drop = m["trunk"] * 0.45 - m["shoulder_drop"]
    table = {
        "nose": ("head", (depth + 0.03, 0.0, 0.43 * m["head"])),
        "neck": ("thorax", (0.01, 0.0, drop + 0.01)),
        "mid_hip": ("pelvis", (0.0, 0.0, 0.02)),
    }
    for side, left in (("left_", 1.0), ("right_", -1.0)):
        sole = 0.02 - m["ankle_height"]
        table |= {
            side + "eye": ("head", (depth, left * 0.032, 0.54 * m["head"])),
            side + "ear": ("head", (0.005, left * breadth, 0.48 * m["head"])),
            side + "shoulder": (side + "upper_arm", (0.0, 0.0, 0.015)),
            side + "elbow": (side + "forearm", (-0.005, 0.0, 0.0)),
            side + "wrist": (side + "hand", (0.0, 0.0, 0.0)),
            side + "hip": (side + "thigh", (0.0, left * 0.015, 0.02)),
            side + "knee": (side + "shank", (0.015, 0.0, 0.0)),
            side + "ankle": (side + "foot", (0.0, 0.0, 0.0)),
            side + "big_toe": (side + "foot", (0.72 * m["foot"], -left * 0.02, sole)),
            side + "small_toe": (side + "foot", (0.60 * m["foot"], left * 0.04, sole)),
            side + "heel": (side + "foot", (-0.24 * m["foot"], 0.0, sole)),
        }
    return table
