"""Footage in, cameras and motion out: the paper's method section, a line a stage.

`stages` runs the whole; `reconstruct` runs it for whoever wants the result alone. The stages are functions, for whoever
replaces one to compare it: `calibrate_cameras`, `ViewLocaliser`, `segment_views`, `body_tracker` of
`pzcap.starting_poses`, and `follow`, the one loop over the frames.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import partial
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np

from pzcap import runtime
from pzcap.body import skeleton
from pzcap.calibration.calibrate import CalibratedCamera, no_report
from pzcap.calibration.settings import PanZoomConfig
from pzcap.camera_set import calibrate_camera, calibrate_cameras, panzoom_tracks, refined, taken_over
from pzcap.events import (
    BodyTracked,
    CameraCalibrated,
    CamerasReady,
    Event,
    Finished,
    FrameLocalised,
    FrameSegmented,
    Progress,
)
from pzcap.frame_slips import FrameOffsets, slip_notes
from pzcap.geometry.camera import at
from pzcap.io.capture import FrameSets, frame_sets
from pzcap.localisation.fields import expected_second
from pzcap.localisation.localise import Localiser, predicted
from pzcap.localisation.panorama_sampler import place_of
from pzcap.localisation.readout import History, Readout, Sway
from pzcap.localisation.rectification import upright_views
from pzcap.plausibility import (
    SeenViews,
    athlete_of_another_size,
    camera_notes,
    lens_moved,
    object_of_another_size,
    share_on_athlete,
    unseen_keyframes,
)
from pzcap.runtime import give_back, one_thread_each, set_large_apart
from pzcap.segmentation import foreground
from pzcap.starting_poses import Expecting, body_to_track, body_tracker, track_input
from pzcap.tracking.body_size import body_size
from pzcap.tracking.camera_refinement import CameraPrior, camera_prior
from pzcap.tracking.interval_solver import warm_up
from pzcap.tracking.settings import TrackingConfig
from pzcap.tracking.tracker import Tracked, Tracker
from pzcap.types import (
    Camera,
    Capture,
    FrameSet,
    Image,
    Localisation,
    Mask,
    PanZoomCamera,
    PzcapError,
    Reconstruction,
    Silhouette,
)
from pzcap.without_object import in_metres, of_open_size, place_cameras, scaled_by_contours

TIDY_EVERY: Final = 8
"""Frame sets after which free memory is given back to the system."""


@dataclass(frozen=True, slots=True)
class Config:
    """Settings of the reconstruction."""

    panzoom: PanZoomConfig = field(default_factory=PanZoomConfig)
    """Calibration, and pan and zoom of each frame."""
    foreground: foreground.ForegroundConfig = field(default_factory=foreground.ForegroundConfig)
    """Silhouettes."""
    tracking: TrackingConfig = field(default_factory=TrackingConfig)
    """The body."""
    threads: int = 2
    """Views that are worked on side by side; BLAS and OpenCV have one thread each."""

    def __post_init__(self) -> None:
        if self.threads < 1:
            raise PzcapError(f"threads is {self.threads}; give 1 or more")


@dataclass(frozen=True, slots=True)
class Method:
    """The functions that find a camera and its frames. `pzcap.extras` has others than `EXACT`."""

    name: str
    calibrate: Callable[..., CalibratedCamera]  # of a Footage, a PanZoomConfig and a Report
    localiser: Callable[..., Any]  # of a panorama, a PanZoomCamera and a PanZoomConfig; it has `localise`


EXACT: Final = Method("exact", calibrate_camera, Localiser)


def reconstruct(
    capture: Capture, config: Config, report: Callable[[str, int, int], None] = no_report,
    cameras: Reconstruction | None = None,
) -> Reconstruction:  # fmt: skip
    """Run every stage that ``capture`` has the material for. See `stages` for ``cameras``.

    ``report(stage, done, total)`` hears of the progress; a total of 0 is not known yet.
    """
    return finished(stages(capture, config, cameras), report)


def finished(events: Iterator[Event], report: Callable[[str, int, int], None]) -> Reconstruction:
    """The reconstruction that ``events`` end with."""
    for event in events:
        match event:
            case Progress(stage, done, total):
                report(stage, done, total)
            case Finished(reconstruction):
                return reconstruction
    raise AssertionError("stages end with Finished")


def stages(
    capture: Capture, config: Config, cameras: Reconstruction | None = None, method: Method = EXACT
) -> Iterator[Event]:
    """Run every stage that ``capture`` has the material for, and yield each result as it comes.

    ``cameras`` is of another take by the same cameras: those that it knows are not calibrated again.

    What is missing (a camera's sweep, the subject, the keyframes) costs the stages that need it and nothing else;
    the reconstruction's ``notes`` say what and why. Memory does not grow with the length of the video, but for the
    result itself. Raises PzcapError where a file is there and is not what it should be.
    """
    if config.panzoom.method != method.name:
        raise PzcapError(f"method '{config.panzoom.method}' is not the core's; call pzcap.extras.reconstruct for it")
    notes: list[str] = []
    set_large_apart()
    with one_thread_each(), ThreadPoolExecutor(config.threads) as pool:
        sets = frame_sets(capture)
        body = body_to_track(capture, sets, config.tracking, notes)
        known = taken_over(capture, cameras, method.name, notes) if cameras else ()

        started = time.perf_counter()
        calibrated: list[CalibratedCamera | None] = [None] * len(capture.cameras)
        one = partial(method.calibrate, config=config.panzoom)
        for calibration in calibrate_cameras(capture, one, pool, notes, known):
            if isinstance(calibration, CameraCalibrated):
                calibrated[calibration.index] = calibration.calibrated
                if calibration.calibrated and method is EXACT:
                    name = capture.cameras[calibration.index].name
                    notes += filter(None, [lens_moved(name, calibration.calibrated)])
            yield calibration
        if body:
            runtime.submit(warm_up)  # not before: cameras being calibrated take most of the memory that there is
        localise = ViewLocaliser(calibrated, config.panzoom, pool, capture.frame_rate, method)
        segment = partial(segment_views, calibrated, config, pool)
        by_athlete = capture.calibration_object is None and not any(known) and any(calibrated)
        if by_athlete:
            assert capture.subject is not None, "no camera is calibrated then"
            measured = skeleton.build(capture.subject)
            placed = yield from place_cameras(calibrated, sets, measured, localise)
            calibrated[:] = placed.cameras  # as ``segment`` knows them from now on
            placed = scaled_by_contours(placed, sets, measured, localise, segment, config.tracking)
            calibrated[:] = placed.cameras
            body = None if body is None else of_open_size(measured, placed.scale_sigma)
            if sets.keyframes:
                sets.keyframes = ()
                notes.append("keyframes.json is not used: without a calibration object nobody knows its world")
            localise = ViewLocaliser(calibrated, config.panzoom, pool, capture.frame_rate, method)
        yield CamerasReady(time.perf_counter() - started)

        tracker = None
        if body is not None:
            tracking = _with_clock_sigma(config.tracking, capture)
            tracker = yield from body_tracker(body, sets, capture.frame_rate, localise, segment, tracking, notes)
        located: list[tuple[Localisation | None, ...]] = []
        poses: list[Tracked] = []
        set_by_hand = {keyframe.frame for keyframe in sets.keyframes} if tracker else set()
        views: dict[int, SeenViews] = {}  # of the keyframes
        unbiased: dict[int, SeenViews] = {}  # cut out without a word of where the body should be
        offsets = FrameOffsets(len(capture.cameras))
        for event in follow(sets, localise, segment, tracker):
            match event:
                case FrameLocalised(frames, localisations):
                    located.append(localisations)
                    if frames.index in set_by_hand:
                        alone = segment(event, None)
                        unbiased[frames.index] = SeenViews(alone.cameras, alone.silhouettes)
                case FrameSegmented(frames, cameras_then, silhouettes) if tracker:
                    offsets.see(frames.index, cameras_then, silhouettes)
                    if frames.index in set_by_hand:
                        views[frames.index] = SeenViews(cameras_then, silhouettes)
                case BodyTracked(tracked):
                    poses += tracked
                    offsets.track(tracked)
            yield event
        tracks = panzoom_tracks(calibrated, located)
        names = tuple(files.name for files in capture.cameras)
        for index, track in enumerate(tracks):
            if track is not None and capture.cameras[index].motion and not track.valid.any():
                notes.append(never_located(index, names, localise, sets, bool(known and known[index])))
    if body is not None:
        against_papers = papers_against_views(body, sets, views, unbiased, config.tracking)
        notes += against_papers.notes
        if not against_papers.misplaced:  # else no view shows the athlete where the body is thought to be
            notes += slip_notes(offsets, tracks, names, sets.timecodes)
    heads = with_clocks(localise.heads(capture.frame_rate), tracker, capture.frame_rate)
    if not config.panzoom.free_tilt:
        usual_clock_s = float(np.median([head.clock_s for head in heads if head is not None] or [0.0]))
        for name, head, track in zip(names, heads, tracks, strict=True):
            if head is not None and track is not None:
                notes += camera_notes(name, head, track, usual_clock_s)
    found = Reconstruction(
        capture_name=capture.name,
        method=config.panzoom.method,
        frame_rate=capture.frame_rate,
        timecodes=sets.timecodes,
        camera_names=names,
        references=tuple(None if one is None else one.reference for one in calibrated),
        cameras=heads,
        panoramas=tuple(None if one is None else one.panorama for one in calibrated),
        tracks=tracks,
        refined=tuple(
            None if track is None or head is None or not poses else refined(track, head, number, poses, config.panzoom)
            for number, (track, head) in enumerate(zip(tracks, heads, strict=True))
        ),
        motion=tracker.motion(poses) if tracker else None,
        notes=tuple(notes),
    )  # fmt: skip
    if by_athlete:
        found = in_metres(found, measured, placed)
    yield Finished(found)


class AgainstPapers(NamedTuple):
    """What the views of the keyframes say against the crew's papers."""

    notes: list[str]
    misplaced: bool  # the keyframes, and with them the body, are not where the cameras see somebody


def papers_against_views(
    body: skeleton.Body, sets: FrameSets, views: dict[int, SeenViews], unbiased: dict[int, SeenViews],
    config: TrackingConfig,
) -> AgainstPapers:  # fmt: skip
    """Contradictions of the keyframes' ``views`` to the crew's papers, the likeliest cause alone. Those that are
    ``unbiased`` were cut out by the colours alone, where a body that is expected elsewhere leaves no trace."""
    if wrong_object := object_of_another_size(sets.keyframes, body, unbiased):
        return AgainstPapers([wrong_object], True)
    if blind := unseen_keyframes(sets.keyframes, body, views, sets.timecodes):
        return AgainstPapers(blind, True)
    seen = [(key.pose, *views[key.frame]) for key in sets.keyframes if key.frame in views]
    size = body_size(body, seen, config.cut_out_margin)
    return AgainstPapers(athlete_of_another_size(size, share_on_athlete(sets.keyframes, body, views)), False)


# --------------------------------------------------------------------------------------------------------------
# The loop over the frames


Localise: TypeAlias = Callable[[FrameSet, Tracker | None], FrameLocalised]
"""Stage 4: the views of an instant found on their panoramas; the tracker says where it expects the body."""
Segment: TypeAlias = Callable[[FrameLocalised, Expecting | None], FrameSegmented]
"""Stage 5: the athlete cut out of the views of an instant."""


def follow(
    sets: FrameSets, localise: Localise, segment: Segment, tracker: Tracker | None
) -> Iterator[FrameLocalised | FrameSegmented | BodyTracked | Progress]:
    """Stages 4 to 6, frame set by frame set. ``tracker``, where there is one, also says where it expects the body."""
    for frames in sets:
        seen = localise(frames, tracker)
        yield seen
        segmented = segment(seen, tracker)
        yield segmented
        if tracker:
            yield _timed(partial(tracker.push, track_input(segmented)))
        if frames.index % TIDY_EVERY == 0:
            give_back()
        yield Progress("motion", frames.index + 1, len(sets))
    if tracker:
        yield _timed(tracker.finish)


def _timed(track: Callable[[], list[Tracked]]) -> BodyTracked:
    started = time.perf_counter()
    poses = tuple(track())
    return BodyTracked(poses, time.perf_counter() - started)


class ViewLocaliser:
    """Stage 4: localises the views of an instant side by side, each from where its camera was seen last."""

    def __init__(
        self, cameras: Sequence[CalibratedCamera | None], config: PanZoomConfig, pool: ThreadPoolExecutor,
        frame_rate: Fraction, method: Method = EXACT,
    ) -> None:  # fmt: skip
        self._heads = [None if one is None else one.camera for one in cameras]
        # one after the other: the features of a panorama take 250 MiB for the half second in which they are found
        self.localisers = [
            None if one is None else method.localiser(one.panorama, one.camera, config) for one in cameras
        ]
        give_back()
        self._pool, self._config, self._frame_rate = pool, config, float(frame_rate)
        self.restart()

    def restart(self) -> None:
        """Forget the frames so far: the next one is the first."""
        beliefs = self._config.beliefs
        sway = np.full(2, np.deg2rad(beliefs.sway_deg) ** 2)
        self.histories = [
            None if head is None
            else History(Readout.of(head, self._frame_rate, beliefs.readout), Sway(head.tilt_rad, sway))
            for head in self._heads
        ]  # fmt: skip

    def __call__(self, frames: FrameSet, tracker: Tracker | None) -> FrameLocalised:
        """Localise ``frames``, and put their rows right; ``tracker``, where there is one, says where it expects the
        body."""
        started = time.perf_counter()
        one = partial(self._one, frames.index, tracker)
        second = frames.second_fields or (None,) * len(frames.images)
        found = tuple(self._pool.map(one, range(len(frames.images)), frames.images, second))
        return replace(self.as_found(replace(frames, second_fields=()), found), seconds=time.perf_counter() - started)

    def as_found(self, frames: FrameSet, found: tuple[Localisation | None, ...]) -> FrameLocalised:
        """``frames`` that were ``found`` before, their rows put right."""
        return FrameLocalised(upright_views(frames, self._heads, found), found)

    def cameras(self, found: Sequence[Localisation | None]) -> tuple[Camera | None, ...]:
        """The cameras of an instant that was ``found``; None where one is lost."""
        return tuple(
            None if head is None or one is None or not one.valid else at(head, *place_of(one)[:4])
            for head, one in zip(self._heads, found, strict=True)
        )

    def heads(self, frame_rate: Fraction) -> tuple[PanZoomCamera | None, ...]:
        """The cameras, with the read-out time that their frames have shown by now."""
        period_s = float(1 / frame_rate)
        return tuple(
            None if head is None or each is None
            else replace(head, readout_s=each.readout.share * period_s, readout_sigma_s=each.readout.sigma * period_s)
            for head, each in zip(self._heads, self.histories, strict=True)
        )  # fmt: skip

    def _one(
        self, frame: int, tracker: Tracker | None, index: int, image: Image | None, second: Image | None
    ) -> Localisation | None:
        localiser, head, history = self.localisers[index], self._heads[index], self.histories[index]
        if localiser is None or head is None or history is None or image is None:
            return None

        def hidden(prior: Localisation) -> Mask | None:
            camera = at(head, *place_of(prior)[:4])
            expected = None if tracker is None else tracker.expect(frame, camera)
            return None if expected is None else expected.covered(camera.height, camera.width)

        prior = predicted(history)
        localisation: Localisation = localiser.localise(image, prior, hidden)
        if second is not None and localisation.valid:
            later = localiser.localise(second, expected_second(history, localisation), hidden)
            if later.valid:
                there = np.array([later.pan_rad, np.log(later.focal_px)])
                localisation = replace(localisation, second_field=there)
        self.histories[index] = history.followed_by(localisation, prior)
        return replace(localisation, readout=history.readout.share)


def never_located(index: int, names: Sequence[str], localise: ViewLocaliser, sets: FrameSets, taken_over: bool) -> str:
    """A note on a camera of whose motion no frame was located: of which camera it is, if of any."""
    camera = f"camera {names[index]}"
    for frame in sorted({0, len(sets) // 2}):
        [frames] = sets.between(frame, frame + 1)
        image = frames.images[index]
        if image is None:
            continue
        for other, localiser in enumerate(localise.localisers):
            if other != index and localiser is not None and localiser.localise(image, None).valid:
                return (
                    f"{camera}: its motion fits the sweep of camera {names[other]}, and not its own: the files of two "
                    "cameras were exchanged"
                )
        own = localise.localisers[index]
        if own is not None and own.localise(np.ascontiguousarray(image[:, ::-1]), None).valid:
            return f"{camera}: its motion is mirrored against its sweep"
    if taken_over:
        return f"{camera}: no frame agrees with the take before; it was moved since then, calibrate it anew"
    return f"{camera}: no frame of its motion fits its sweep; it was moved between the two, or filmed another hall"


def segment_views(
    cameras: Sequence[CalibratedCamera | None], config: Config, pool: ThreadPoolExecutor, seen: FrameLocalised,
    tracker: Expecting | None,
) -> FrameSegmented:  # fmt: skip
    """Stage 5: the athlete cut out of the views of an instant, side by side; ``tracker`` says where it expects the
    body."""
    started = time.perf_counter()

    def one(index: int) -> tuple[Camera | None, Silhouette | None, CameraPrior | None]:
        image, found, known = seen.frames.images[index], seen.localisations[index], cameras[index]
        if known is None or image is None or found is None or not found.valid:
            return None, None, None
        camera = at(known.camera, *place_of(found)[:4])
        expected = None if tracker is None else tracker.expect(seen.frames.index, camera)
        silhouette = foreground.separate(image, known.panorama, known.camera, found, config.foreground, expected)
        return camera, silhouette, camera_prior(config.panzoom, known.camera, found)

    found, silhouettes, priors = zip(*pool.map(one, range(len(seen.frames.images))), strict=True)
    return FrameSegmented(seen.frames, found, silhouettes, priors, time.perf_counter() - started)


_WORST_CLOCK: Final = 1.5  # frames: more, and the motion of a frame is no longer a straight line


def _with_clock_sigma(config: TrackingConfig, capture: Capture) -> TrackingConfig:
    """The settings, with clocks as uncertain as sync.json says where there is one."""
    if capture.sync is None or not config.clock_sigma:
        return config
    worst = max(clock.sigma_s for clock in capture.sync.values()) * float(capture.frame_rate)
    return replace(config, clock_sigma=max(config.clock_sigma, min(worst, _WORST_CLOCK)))


def with_clocks(
    heads: tuple[PanZoomCamera | None, ...], tracker: Tracker | None, frame_rate: Fraction
) -> tuple[PanZoomCamera | None, ...]:
    """The cameras with their clocks, as the body has shown them by now."""
    if tracker is None or tracker.clocks is None:
        return heads
    period_s, clocks = float(1 / frame_rate), tracker.clocks
    return tuple(
        None if head is None else replace(head, clock_s=float(clock) * period_s, clock_sigma_s=float(sigma) * period_s)
        for head, clock, sigma in zip(heads, clocks.clock, clocks.sigma, strict=True)
    )
