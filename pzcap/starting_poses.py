"""Poses that the body's tracking starts from: those set by hand, and others found in a detector's keypoints."""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from pzcap.body import skeleton
from pzcap.body.anthropometry import UNMEASURED
from pzcap.body.skeleton import Body
from pzcap.events import FrameSegmented, Progress
from pzcap.initialisation.keyframes import Observe, find_keyframes
from pzcap.initialisation.people import Detections
from pzcap.initialisation.selection import worthwhile
from pzcap.io.capture import FrameSets
from pzcap.io.detections import NOBODY
from pzcap.plausibility import contradictory_readings, guessed_measurements
from pzcap.tracking import keyframes
from pzcap.tracking.pixel_time import Exposure
from pzcap.tracking.settings import TrackingConfig
from pzcap.tracking.tracker import Tracker, TrackInput, ViewInput
from pzcap.types import Capture, Keyframe, Localisation
from pzcap.views import Segment, ViewLocaliser

_WORST_CLOCK: Final = 1.5  # frames: more, and the motion of a frame is no longer a straight line


def with_clock_sigma(config: TrackingConfig, capture: Capture) -> TrackingConfig:
    """The settings, with clocks as uncertain as sync.json says where there is one."""
    if capture.sync is None or not config.clock_sigma:
        return config
    worst = max(clock.sigma_s for clock in capture.sync.values()) * float(capture.frame_rate)
    return replace(config, clock_sigma=max(config.clock_sigma, min(worst, _WORST_CLOCK)))


def body_to_track(capture: Capture, sets: FrameSets, config: TrackingConfig, notes: list[str]) -> Body | None:
    """The body of stage 6; None, and a reason added to ``notes``, where the capture holds nothing to track by."""
    detected = any(camera.keypoints for camera in capture.cameras) and config.keypoint_keyframes
    if not sets.keyframes and not detected:
        notes.append(
            "the body is not tracked: the capture holds neither keyframes (keyframes.json) nor a detector's keypoints; "
            "run a detector (pzcap keypoints FOLDER --by mediapipe), or pose one frame by hand (pzcap edit FOLDER)"
        )
        return None
    subject = capture.subject or UNMEASURED
    body = skeleton.build(subject)
    notes += [*contradictory_readings(subject), *guessed_measurements(subject, body)]
    if sets.keyframes:
        notes += keyframes.check(sets.keyframes, body, len(sets), float(capture.frame_rate))
    return body


def body_tracker(
    body: Body, capture: Capture, sets: FrameSets, localise: ViewLocaliser, segment: Segment, config: TrackingConfig,
    notes: list[str],
) -> Generator[Progress, None, Tracker | None]:  # fmt: skip
    """The tracker of stage 6, which starts from the keyframes of ``sets`` and, where these leave gaps, from others that
    are found in a detector's keypoints; None, and a reason added to ``notes``, where there are neither."""
    config, found = with_clock_sigma(config, capture), list[Keyframe]()
    rate, given = float(capture.frame_rate), [key.frame for key in sets.keyframes]
    if config.keypoint_keyframes and sets.people(0) and worthwhile(given, len(sets), rate):
        found = yield from keyframes_from_keypoints(body, sets, rate, localise, segment, config)
        names = ", ".join(f"{key.frame} ({sets.timecodes[key.frame]})" for key in found)
        if found:
            notes.append(f"keyframes found in the keypoints: {names}")
        elif not sets.keyframes:
            calibrated = sum(each is not None for each in localise.localisers)
            notes.append(
                f"the body is not tracked: keypoints take two calibrated cameras, and there is {calibrated or 'none'}"
                if calibrated < 2 else
                "the body is not tracked: in no frame do the keypoints of two views or more agree with each other and "
                "with the silhouettes; pose one frame by hand (pzcap edit FOLDER), or run another detector"
            )  # fmt: skip
            return None
    keys = sorted([*sets.keyframes, *found], key=lambda key: key.frame)
    return Tracker(body, keys, config, sets.interlaced and config.second_fields)


def keyframes_from_keypoints(
    body: Body, sets: FrameSets, rate: float, localise: ViewLocaliser, segment: Segment, config: TrackingConfig
) -> Generator[Progress, None, list[Keyframe]]:
    """Keyframes beside those of ``sets`` (`pzcap.initialisation`). All frames are localised for it, and then again in
    their turn, when the tracker says where the body is."""
    located: list[tuple[Localisation | None, ...]] = []
    detections: list[Detections] = []
    for frames in sets:
        seen = localise(frames, None)
        cameras, people = localise.cameras(seen.localisations), seen.frames.keypoints
        views = (None if one is None else (one, found) for one, found in zip(cameras, people, strict=True))
        detections.append(Detections(tuple(views), tuple(map(_sigma_rad, seen.localisations))))
        located.append(seen.localisations)
        yield Progress("keypoints", frames.index + 1, len(sets))
    localise.restart()

    observe = observer(body, sets, dict(enumerate(located)), localise, segment, config)
    return find_keyframes(detections, body, sets.keyframes, rate, observe, config)


def observer(
    body: Body, sets: FrameSets, located: Mapping[int, tuple[Localisation | None, ...]], localise: ViewLocaliser,
    segment: Segment, config: TrackingConfig,
) -> Observe:  # fmt: skip
    """The views of a keyframe's instant, which was ``located``, the athlete cut out where the keyframe has the body."""

    def observe(key: Keyframe) -> Sequence[ViewInput | None]:
        [frames] = sets.between(key.frame, key.frame + 1)
        expected = Tracker(body, [key], config)
        return track_input(segment(localise.as_found(frames, located[key.frame]), expected)).views

    return observe


def _sigma_rad(found: Localisation | None) -> float:
    """Standard deviation of where a camera looks, of pan alone: the athlete is near the middle of the picture."""
    return 0.0 if found is None or not found.valid else float(np.sqrt(found.covariance[0, 0]))


def track_input(segmented: FrameSegmented) -> TrackInput:
    """An instant as the tracker takes it."""
    frames = segmented.frames
    people = frames.keypoints or (NOBODY,) * len(frames.images)

    def view(index: int) -> ViewInput | None:
        image, camera, silhouette = frames.images[index], segmented.cameras[index], segmented.silhouettes[index]
        if image is None or camera is None or silhouette is None or not silhouette.valid:
            return None
        prior = segmented.priors[index]
        late = frames.late[index] if frames.late else 0.0
        exposure = Exposure(readout=0.0 if prior is None else prior.readout, late=late)
        return ViewInput(image, camera, silhouette, people[index], prior, exposure)

    return TrackInput(frames.index, tuple(view(index) for index in range(len(frames.images))))
