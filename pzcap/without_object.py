"""Cameras placed without a calibration object: by the athlete, whose stature or another length is known.

Each camera has been calibrated in a world of its own, in which its head is level. All frames are localised; the rays to
the athlete's keypoints tell how the cameras stand to each other (`pzcap.initialisation.camera_poses`), to centimetres;
the feet where the floor is; and the lengths of the limbs, of which the stature tells something, how long a metre is.
Then the floor, which all have swept, places them to millimetres (`pzcap.initialisation.floor_matching`). Lengths are
good to a percent or two. Where lengths in the hall were measured, these bring the cameras to metres; else the body is
tracked with its size open, and once its contours have told that size in the cameras' units, `in_metres` scales
everything to the stature that was measured.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from pzcap.body import skeleton
from pzcap.body.anthropometry import UNMEASURED, Measured
from pzcap.body.skeleton import Body, of
from pzcap.calibration.calibrate import CalibratedCamera
from pzcap.calibration.correspondences import height_of as camera_height
from pzcap.events import Progress
from pzcap.geometry import camera as geometry
from pzcap.initialisation.body_height import seen_height, standing_height
from pzcap.initialisation.camera_poses import HeadRays, Heads, adjust, floor_height, place_heads
from pzcap.initialisation.floor_matching import place_by_floor
from pzcap.initialisation.limb_lengths import scale_by_limbs
from pzcap.initialisation.people import Detections, Sighting, athlete, most_central
from pzcap.initialisation.tuning import HEADS, HEIGHT, LENGTHS, PEOPLE
from pzcap.io.capture import FrameSets
from pzcap.io.detections import KEYPOINTS, ROW
from pzcap.scale_by_lengths import scale_by_lengths
from pzcap.scaling import scaled, scaled_camera, scaled_pose
from pzcap.starting_poses import observer
from pzcap.tracking.settings import TrackingConfig
from pzcap.types import Array, Camera, Capture, Localisation, PanZoomCamera, PzcapError, Reconstruction
from pzcap.views import Segment, ViewLocaliser

Number = TypeVar("Number", bound=np.generic)


_FEET: Final = [ROW[f"{side}_{name}"] for side in ("left", "right") for name in ("heel", "big_toe", "small_toe")]


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """An instant that the cameras were placed by."""

    frame: int
    located: tuple[Localisation | None, ...]
    athlete: Sighting  # by the cameras where they were placed


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """Cameras placed by the athlete."""

    body: Body  # of the athlete, as measured
    cameras: tuple[CalibratedCamera | None, ...]
    instants: tuple[Seen, ...]
    sigma_m: Array  # (C,) of their places, in the cameras' own units of length
    scale_sigma: float  # relative, of these units
    by_floor: bool  # the floor has told more than keypoints do
    by_lengths: bool = False  # their units are metres, by lengths that were measured in the hall
    notes: tuple[str, ...] = ()  # on such lengths


def place_cameras(
    calibrated: Sequence[CalibratedCamera | None], capture: Capture, sets: FrameSets, localise: ViewLocaliser,
    segment_by: Callable[[Sequence[CalibratedCamera | None]], Segment], config: TrackingConfig,
) -> Generator[Progress, None, Placed]:  # fmt: skip
    """Place the ``calibrated`` cameras of a ``capture``, each level in a world of its own, in one world: z up from the
    floor, the middle of what the athlete does above the origin, x as the first of them looks at pan 0. ``segment_by``
    makes stage 5 of cameras.

    Raises PzcapError where the keypoints do not tell how they stand.
    """
    body = skeleton.build(capture.subject or UNMEASURED)
    placed = yield from _placed_by_body_and_floor(calibrated, sets, body, localise)
    if capture.lengths:
        floor_sigma_m = LENGTHS.floor_m if placed.by_floor else LENGTHS.floor_by_feet_m
        measured = scale_by_lengths(capture, placed.cameras, placed.sigma_m, floor_sigma_m, localise)
        placed = replace(placed, notes=measured.notes)
        if measured.scale is not None:
            return replace(_scaled(placed, measured.scale.factor, measured.scale.sigma), by_lengths=True)
    return _scaled_by_contours(placed, sets, localise, segment_by(placed.cameras), config)


def _scaled(placed: Placed, factor: float, sigma: float) -> Placed:
    """The cameras in another unit of length, ``factor`` of which make one of theirs, to a relative ``sigma``."""
    cameras = tuple(
        None if one is None else scaled_camera(one, factor, scaled_pose(one.camera.world_T_head, factor))
        for one in placed.cameras
    )
    return replace(placed, cameras=cameras, sigma_m=factor * placed.sigma_m, scale_sigma=sigma)


def _placed_by_body_and_floor(
    calibrated: Sequence[CalibratedCamera | None], sets: FrameSets, body: Body, localise: ViewLocaliser
) -> Generator[Progress, None, Placed]:
    """The cameras in one world, its lengths by the limbs."""
    instants: list[Detections] = []
    located: list[tuple[int, tuple[Localisation | None, ...]]] = []
    every = max(len(sets) // HEADS.most_frames, 1)
    for frames in sets:
        seen = localise(frames, None)
        if frames.index % every == 0:
            cameras, people = localise.cameras(seen.localisations), seen.frames.keypoints
            views = (None if one is None else (one, found) for one, found in zip(cameras, people, strict=True))
            instants.append(Detections(tuple(views)))
            located.append((frames.index, seen.localisations))
        yield Progress("place cameras", frames.index + 1, len(sets))
    heads = [None if one is None else one.camera for one in calibrated]
    try:
        found = place_heads(_rays(heads, [_central(instant) for instant in instants]))
        for _ in range(HEADS.rounds):  # who is who, and left and right, are told from here on
            scale, sigma = scale_by_limbs(_by_frame(found.points), _by_frame(found.seen), body)
            found = found.moved(np.eye(3), scale, np.zeros(3))
            sightings = athlete([_in_world(found, heads, instant) for instant in instants])
            own = [_as_calibrated(sighting, instant) for sighting, instant in zip(sightings, instants, strict=True)]
            found = adjust(_rays(heads, own), found.rotation, found.place, found.placed)
        scale, sigma = scale_by_limbs(_by_frame(found.points), _by_frame(found.seen), body)
    except (PzcapError, np.linalg.LinAlgError) as error:
        raise PzcapError(
            f"without a calibration object the cameras cannot be placed: {error}; film one, or let the athlete cross "
            "the field of all cameras, and run another detector"
        ) from error
    found = _in_own_world(found, scale)
    by_floor = place_by_floor([None if one is None else one.panorama for one in calibrated], found)
    if by_floor is not None:
        found = by_floor.moved(_heading(by_floor), 1.0, np.zeros(3))
    sightings = athlete([_in_world(found, heads, instant) for instant in instants])
    sigma_m = np.sqrt(np.array([np.trace(found.covariance[k + 3 : k + 6, k + 3 : k + 6]) for k in _blocks(found)]))
    return Placed(
        body,
        tuple(
            None if one is None or not found.placed[c] else _placed(one, found.rotation[c], found.place[c])
            for c, one in enumerate(calibrated)
        ),
        tuple(Seen(*where, sighting) for where, sighting in zip(located, sightings, strict=True)),
        sigma_m,
        sigma,
        by_floor is not None,
    )


def _blocks(heads: Heads) -> range:
    return range(0, 6 * len(heads.place), 6)


# --------------------------------------------------------------------------------------------------------------
# Rays


def _central(instant: Detections) -> Sighting:
    """The most central person of each view: cameras follow the athlete."""
    found: list[tuple[Camera, Array] | None] = []
    for view in instant.views:
        order = [] if view is None else most_central(*view)
        found.append((view[0], view[1][order[0]]) if view is not None and order else None)
    return tuple(found)


def _rays(heads: Sequence[PanZoomCamera | None], sightings: Sequence[Sighting]) -> HeadRays:
    """The rays of all keypoints of all instants, by cameras as they were calibrated."""
    count = len(KEYPOINTS)
    shape = (len(heads), len(sightings), count)
    origins, directions, confidence = np.zeros((*shape, 3)), np.zeros((*shape, 3)), np.zeros(shape)
    directions[..., 0] = 1.0
    for t, sighting in enumerate(sightings):
        for c, (head, view) in enumerate(zip(heads, sighting, strict=True)):
            if head is None or view is None:
                continue
            camera, person = view
            rotation, place_m = head.world_T_head[:3, :3], head.world_T_head[:3, 3]
            origins[c, t] = (camera.world_T_cam[:3, 3] - place_m) @ rotation
            directions[c, t] = geometry.rays(camera, person[:, :2]) @ rotation
            confidence[c, t] = np.where(person[:, 2] < PEOPLE.least_confidence, 0.0, person[:, 2])
    points = (len(heads), -1)
    return HeadRays(
        origins.reshape(*points, 3), directions.reshape(*points, 3), confidence.reshape(points)
    )  # fmt: skip


def _by_frame(values: NDArray[Number]) -> NDArray[Number]:
    """Values (N, ...) of points as (T, 26, ...)."""
    return values.reshape(-1, len(KEYPOINTS), *values.shape[1:])


def _in_world(found: Heads, heads: Sequence[PanZoomCamera | None], instant: Detections) -> Detections:
    """The detections of an instant by cameras where they were ``found`` to stand."""
    views: list[tuple[Camera, Array] | None] = []
    for c, (head, view) in enumerate(zip(heads, instant.views, strict=True)):
        if head is None or view is None or not found.placed[c]:
            views.append(None)
            continue
        there = _transform(found.rotation[c], found.place[c]) @ np.linalg.inv(head.world_T_head)
        views.append((replace(view[0], world_T_cam=there @ view[0].world_T_cam), view[1]))
    return Detections(tuple(views))


def _as_calibrated(sighting: Sighting, instant: Detections) -> Sighting:
    """The athlete's keypoints with the cameras as they were calibrated."""
    return tuple(
        None if view is None or own is None else (own[0], view[1])
        for view, own in zip(sighting, instant.views, strict=True)
    )


def _transform(rotation: Array, place_m: Array) -> Array:
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = rotation, place_m
    return found


# --------------------------------------------------------------------------------------------------------------
# The world: how long a metre is, where the floor


def _in_own_world(found: Heads, scale: float) -> Heads:
    """The heads in metres, in the world that `place_cameras` says."""
    rotation = _heading(found)
    points, seen = found.points @ rotation.T * scale, found.seen
    by_frame, there = _by_frame(points), _by_frame(seen)
    feet = by_frame[:, _FEET, 2][there[:, _FEET]]
    middle = np.median(points[seen], axis=0)
    floor = floor_height(feet) if len(feet) else float(points[seen, 2].min())
    return found.moved(rotation, scale, -np.array([middle[0], middle[1], floor - HEADS.sole_m]))


def _heading(found: Heads) -> Array:
    """(3, 3) the turn about z after which the first camera looks along x at pan 0."""
    ahead = found.rotation[int(np.argmax(found.placed)), :, 0]
    yaw = -np.arctan2(ahead[1], ahead[0])
    return np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])


def _placed(one: CalibratedCamera, rotation: Array, place_m: Array) -> CalibratedCamera:
    """A camera on its head there, what it knows in camera heights brought to metres."""
    return scaled_camera(one, place_m[2] / camera_height(one.reference.camera), _transform(rotation, place_m))


# --------------------------------------------------------------------------------------------------------------
# The body's size


def _scaled_by_contours(
    placed: Placed, sets: FrameSets, localise: ViewLocaliser, segment: Segment, config: TrackingConfig
) -> Placed:
    """The cameras with their scale by the athlete's height as contours show it, where these do; ``segment`` knows the
    cameras as they are ``placed``, and ``localise`` how their rows are exposed."""
    open_body = of_open_size(placed.body, HEIGHT.open * placed.scale_sigma)
    located = {seen.frame: seen.located for seen in placed.instants}
    observe = observer(open_body, sets, located, localise, segment, config)
    found = seen_height(open_body, [(seen.frame, seen.athlete) for seen in placed.instants], observe, config)
    return placed if found is None else _scaled(placed, 1.0 / found.ratio, found.sigma)


def of_open_size(body: Body, sigma: float) -> Body:
    """The body in units of length that are uncertain by a relative ``sigma``."""
    values, covariance = body.measured.values_m, body.measured.covariance_m2
    return of(Measured(values, covariance + sigma**2 * np.outer(values, values)), body.worn)


def in_metres(found: Reconstruction, placed: Placed) -> Reconstruction:
    """``found`` scaled so that the athlete is as tall as was measured, unless its lengths are metres already, with a
    note on how well all is known."""
    if placed.by_lengths:
        return replace(found, notes=(*found.notes, _note(found, placed, 1.0, placed.scale_sigma)))
    stature_m = placed.body.measured.value("stature")
    sigma = float(np.hypot(placed.body.measured.sigma("stature") / stature_m, HEIGHT.sigma))
    if found.motion is None or found.motion.body is None:
        return replace(found, notes=(*found.notes, _note(found, placed, 1.0, placed.scale_sigma)))
    factor = standing_height(skeleton.moved(placed.body)) / standing_height(found.motion.body)
    return replace(scaled(found, factor), notes=(*found.notes, _note(found, placed, factor, sigma)))


def _note(found: Reconstruction, placed: Placed, factor: float, sigma: float) -> str:
    lost = [
        name
        for name, before, one in zip(found.camera_names, found.panoramas, placed.cameras, strict=True)
        if before is not None and one is None
    ]
    means = "and by the floor that they have in common" if placed.by_floor else "alone, the floor not telling"
    yardstick = "lengths.json" if placed.by_lengths else "the stature"
    text = (
        f"no calibration object: the cameras were placed by the athlete's keypoints {means}, to "
        f"{100 * factor * float(placed.sigma_m[placed.sigma_m > 0.0].mean()):.1f} cm; {yardstick} tells how long a "
        f"metre is, to {100 * sigma:.1f} %; the world is its own, z up from the floor, x as the first camera looks at "
        "pan 0"
    )
    return text + (f"; not placed, since too little is seen from there: camera {', '.join(lost)}" if lost else "")
