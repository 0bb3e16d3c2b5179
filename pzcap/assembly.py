"""The result put together: what the loop over the frames has left, and notes on what in it contradicts the rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from functools import partial
from typing import NamedTuple

import numpy as np

from pzcap.body.skeleton import Body
from pzcap.calibration.calibrate import CalibratedCamera
from pzcap.calibration.settings import PanZoomConfig
from pzcap.camera_notes import ON_ITS_SIDE, camera_notes, stabilised, woven_motion
from pzcap.camera_set import panzoom_tracks, refined
from pzcap.events import BodyTracked, FrameLocalised, FrameSegmented, Progress
from pzcap.frame_slips import FrameOffsets, repeated_pictures, slip_notes
from pzcap.imaging.comb import comb_px
from pzcap.io.capture import FrameSets
from pzcap.localisation.duplicate_frames import confirmed
from pzcap.plausibility import (
    SeenKeyframe,
    SeenViews,
    athlete_of_another_size,
    company,
    is_touched,
    lost_body,
    object_of_another_size,
    seen_keyframe,
    share_on_athlete,
    unlocated,
    unseen_keyframes,
)
from pzcap.tracking.body_size import body_size
from pzcap.tracking.tracker import Tracked, Tracker
from pzcap.types import Array, Capture, Localisation, PanZoomCamera, PanZoomTrack, Reconstruction
from pzcap.views import Segment, ViewLocaliser


class Gathered:
    """Record of the events of the loop over the frames. ``segment``: stage 5; ``tracker``: where a body is tracked,
    the ``body`` that it began with."""

    def __init__(
        self, capture: Capture, sets: FrameSets, segment: Segment, tracker: Tracker | None, body: Body | None
    ) -> None:
        self._capture, self._sets, self._segment, self._tracker = capture, sets, segment, tracker
        self._body = body
        self.names = tuple(files.name for files in capture.cameras)
        self._located: list[tuple[Localisation | None, ...]] = []
        self._poses: list[Tracked] = []
        self._set_by_hand = {keyframe.frame: keyframe for keyframe in sets.keyframes}
        self._unbiased = SeenViews((), ())  # of the latest keyframe, without a word of where the body should be
        self._keyframes: list[SeenKeyframe] = []
        self._offsets = FrameOffsets(len(capture.cameras))
        self._combs_px: list[list[float]] = []  # of each frame and view
        self._touched: list[int] = []  # frames in which somebody else is at the athlete's side

    def take(self, event: FrameLocalised | FrameSegmented | BodyTracked | Progress) -> None:
        """Keep what the result is made of."""
        match event:
            case FrameLocalised(frames, localisations):
                self._located.append(localisations)
                self._combs_px.append([0.0 if image is None else comb_px(image) for image in frames.images])
                if self._tracker and frames.index in self._set_by_hand:
                    alone = self._segment(event, None)
                    self._unbiased = SeenViews(alone.cameras, alone.silhouettes)
            case FrameSegmented(frames, cameras, silhouettes) if self._tracker:
                self._offsets.see(frames.index, cameras, silhouettes)
                if is_touched(silhouettes):
                    self._touched.append(frames.index)
                key = self._set_by_hand.get(frames.index)
                if key is not None and self._body is not None:
                    views, margin = SeenViews(cameras, silhouettes), self._tracker.config.cut_out_margin
                    self._keyframes.append(seen_keyframe(key, self._body, views, self._unbiased, margin))
            case BodyTracked(tracked):
                self._poses += tracked
                self._offsets.track(tracked)

    def tracks(self, calibrated: Sequence[CalibratedCamera | None]) -> tuple[PanZoomTrack | None, ...]:
        """Pan and zoom of each camera over the frames."""
        return panzoom_tracks(calibrated, self._confirmed())

    def never_located(
        self, tracks: Sequence[PanZoomTrack | None], localise: ViewLocaliser,
        known: Sequence[CalibratedCamera | None],
    ) -> list[str]:  # fmt: skip
        """Notes on the cameras of which no frame was located. ``known``: those that were taken over, if any."""
        return [
            _never_located(index, self.names, localise, self._sets, bool(known and known[index]))
            for index, track in enumerate(tracks)
            if track is not None and self._capture.cameras[index].motion and not track.valid.any()
        ]

    def recorded(self, tracks: Sequence[PanZoomTrack | None]) -> list[str]:
        """Notes on the cameras that were held upright, whose frames are two instants each, or that show pictures
        twice."""
        sides = zip(self.names, self._sets.on_their_side, strict=True)
        combs_px = np.array(self._combs_px).T
        found = zip(self._capture.cameras, combs_px, tracks, strict=True) if self._combs_px else ()
        return [
            *(f"camera {name}: {ON_ITS_SIDE}" for name, on_its_side in sides if on_its_side),
            *filter(None, (woven_motion(files, own, track) for files, own, track in found)),
            *repeated_pictures(self._confirmed(), self.names, self._sets.timecodes),
        ]

    def _missed(self, camera: int) -> Array:
        """(F, 2) changes of pan and log focal that a camera's pictures have `missed`."""
        seen = confirmed([views[camera] for views in self._located])
        return np.array([np.zeros(2) if one is None else one.missed for one in seen])

    def _confirmed(self) -> list[tuple[Localisation | None, ...]]:
        """The views of each frame, as those after it bear them out."""
        return list(zip(*map(confirmed, zip(*self._located, strict=True)), strict=True))

    def contradictions(self, tracks: Sequence[PanZoomTrack | None]) -> list[str]:
        """Notes on what in the keyframes' views contradicts the crew's papers, and on frames that a camera lost."""
        known = None if self._tracker is None else self._tracker.clocks
        clocks = np.zeros(len(self.names)) if known is None else known.clock
        slips = partial(slip_notes, self._offsets, clocks, tracks, self.names, self._sets.timecodes)
        if self._body is None:
            return slips()
        found = papers_against_views(self._body, self._keyframes, self._sets.timecodes)
        # where the body is misplaced, no view shows the athlete where it is thought to be
        if found.misplaced:
            return found.notes
        lost = {pose.frame: pose.lost for pose in self._poses}
        timecodes = self._sets.timecodes
        return [*found.notes, *slips(), *lost_body(lost, timecodes), *company(self._touched, timecodes)]

    def reconstruction(
        self, calibrated: Sequence[CalibratedCamera | None], tracks: tuple[PanZoomTrack | None, ...],
        heads: tuple[PanZoomCamera | None, ...], config: PanZoomConfig, notes: Sequence[str],
    ) -> Reconstruction:  # fmt: skip
        """The result: the cameras as ``calibrated``, their ``heads`` as the frames have shown them, and the body."""
        heads = _with_clocks(heads, self._tracker, self._capture.frame_rate)
        found = list(notes)
        for name, track in zip(self.names, tracks, strict=True):
            found += unlocated(name, track.valid, self._sets.timecodes) if track is not None else []
        if not config.free_tilt:
            usual_clock_s = float(np.median([head.clock_s for head in heads if head is not None] or [0.0]))
            for name, head, track in zip(self.names, heads, tracks, strict=True):
                if head is not None and track is not None:
                    found += camera_notes(name, head, track, usual_clock_s, self._sets.timecodes)
            found += stabilised(self.names, tracks)
        return Reconstruction(
            capture_name=self._capture.name,
            method=config.method,
            frame_rate=self._capture.frame_rate,
            timecodes=self._sets.timecodes,
            camera_names=self.names,
            references=tuple(None if one is None else one.reference for one in calibrated),
            cameras=heads,
            panoramas=tuple(None if one is None else one.panorama for one in calibrated),
            tracks=tracks,
            refined=tuple(
                None if track is None or head is None or not self._poses
                else refined(track, head, number, self._poses, self._missed(number), config)
                for number, (track, head) in enumerate(zip(tracks, heads, strict=True))
            ),
            motion=self._tracker.motion(self._poses) if self._tracker else None,
            notes=tuple(found),
        )  # fmt: skip


class AgainstPapers(NamedTuple):
    """Contradictions of the keyframes' views to the crew's papers."""

    notes: list[str]
    misplaced: bool  # the keyframes, and with them the body, are not where the cameras see somebody


def papers_against_views(body: Body, keyframes: Sequence[SeenKeyframe], timecodes: Sequence[str]) -> AgainstPapers:
    """Contradictions of the views of the ``keyframes`` to the crew's papers, the likeliest cause alone."""
    if wrong_object := object_of_another_size(keyframes):
        return AgainstPapers([wrong_object], True)
    if blind := unseen_keyframes(keyframes, timecodes):
        return AgainstPapers(blind, True)
    size = body_size(body, [log for each in keyframes for log in each.sizes])
    return AgainstPapers(athlete_of_another_size(size, share_on_athlete(keyframes)), False)


def _never_located(index: int, names: Sequence[str], localise: ViewLocaliser, sets: FrameSets, taken_over: bool) -> str:
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
    return (
        f"{camera}: no frame of its motion fits its sweep; it was moved between the two, filmed another hall, or "
        "somebody covers most of its view all the while"
    )


def _with_clocks(
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
