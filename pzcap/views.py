"""Stages 4 and 5: the views of an instant found on their panoramas, and the athlete cut out of them, side by side."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from fractions import Fraction
from functools import partial
from typing import Any, Protocol, TypeAlias

import numpy as np

from pzcap.calibration.calibrate import CalibratedCamera
from pzcap.calibration.settings import PanZoomConfig
from pzcap.events import FrameLocalised, FrameSegmented, Progress
from pzcap.geometry.camera import of_frame
from pzcap.imaging.colour import colours_aligned, grey
from pzcap.io.capture import FrameSets
from pzcap.localisation.duplicate_frames import (
    Pictures,
    extrapolated,
    known_less_surely,
    moved_px,
    stood_still,
    without_extrapolation,
)
from pzcap.localisation.fields import expected_second
from pzcap.localisation.localise import Localiser
from pzcap.localisation.readout import History, Readout, Sway, rate_between
from pzcap.localisation.rectification import upright_views
from pzcap.look_ahead import LookAhead
from pzcap.runtime import give_back
from pzcap.segmentation.company import WholeView, others_on_floor, whole_view, with_others
from pzcap.segmentation.expected import Expected
from pzcap.segmentation.foreground import ForegroundConfig, separate
from pzcap.tracking.camera_refinement import CameraPrior, camera_prior
from pzcap.tuning import LOOK_AHEAD
from pzcap.types import Camera, FrameSet, Image, Localisation, Mask, PanZoomCamera, Silhouette


class Expecting(Protocol):
    """Something that expects the body somewhere."""

    def expect(self, frame: int, camera: Camera) -> Expected | None:
        """Prior of the silhouette in a view of a ``frame``; None where nothing is expected."""


Localise: TypeAlias = Callable[[FrameSet, Expecting | None], FrameLocalised]
"""Stage 4, as `ViewLocaliser` is one; what expects the body says where it hides the hall."""
Segment: TypeAlias = Callable[[FrameLocalised, Expecting | None], FrameSegmented]  # stage 5, as `segment_views` is one


def as_found(
    heads: Sequence[PanZoomCamera | None], frames: FrameSet, found: tuple[Localisation | None, ...],
    later: tuple[Localisation | None, ...] | None = None,
) -> FrameLocalised:  # fmt: skip
    """``frames`` that were ``found``, and where they are told ``later`` their second fields, their rows put right."""
    seen = FrameLocalised(upright_views(replace(frames, second_fields=()), heads, found), found)
    if later is None:
        return seen
    fields = replace(frames, images=frames.second_fields, second_fields=(), keypoints=())
    return replace(seen, second_fields=as_found(heads, fields, later))


class ViewLocaliser:
    """Stage 4: localises the views of an instant side by side, each from where its camera was seen last."""

    def __init__(
        self, cameras: Sequence[CalibratedCamera | None], config: PanZoomConfig, pool: ThreadPoolExecutor,
        frame_rate: Fraction, localiser: Callable[..., Any] = Localiser, ahead: FrameSets | None = None,
    ) -> None:  # fmt: skip
        """``localiser`` makes of a panorama, a PanZoomCamera and a PanZoomConfig what has `Localiser.localise`.

        ``ahead``: the take, in which a camera that is not found in its first frame by itself, as one with a body before
        it at a long zoom, is looked for further on, and from there followed back.
        """
        self._heads = [None if one is None else one.camera for one in cameras]
        # one after the other: the features of a panorama take 250 MiB for the half second in which they are found
        self.localisers = [None if one is None else localiser(one.panorama, one.camera, config) for one in cameras]
        give_back()
        self._pool, self._config, self._frame_rate = pool, config, frame_rate
        self._ahead = [LookAhead(ahead, partial(self._beside, index)) for index in range(len(cameras))]
        self._readouts = [
            None if head is None else Readout.of(head, float(frame_rate), config.beliefs.readout)
            for head in self._heads
        ]  # fmt: skip
        self.restart()

    def _beside(self, index: int, frames: FrameSet, beside: Localisation | None) -> Localisation | None:
        """A view of ``frames``, near one that was found ``beside`` it; None where the camera has none, or is not
        known."""
        localiser, head, image = self.localisers[index], self._heads[index], frames.images[index]
        if localiser is None or head is None or image is None:
            return None
        prior = None if beside is None else self._near(beside, index)
        found: Localisation = localiser.localise(_grey(head, image), prior)
        return found

    def _as_new_as(self, found: Localisation, history: History, index: int, picture: Image) -> Localisation:
        """A frame that was ``found`` after the ``history``, less sure the more its ``picture`` is the one before."""
        last, expected, width = history.last, history.predicted(), picture.shape[1]
        change = np.zeros(2) if last is None or expected is None else rate_between(last, expected)
        share = self._pictures[index].repeated_share(picture, moved_px(change, found.focal_px, width))
        if last is not None and last.missed.any():  # that was shown twice, or the camera has stopped
            change = np.zeros(2)
        return known_less_surely(found, change, share, width) if found.valid else found

    def _start(self, frame: int, index: int) -> Localisation | None:
        """The prior of a frame of a camera that was found looking ahead."""
        place = self._ahead[index].places.get(frame)
        return None if place is None else self._near(place, index)

    def _near(self, found: Localisation, index: int) -> Localisation | None:
        """The prior of a frame beside one that was ``found``, whichever of the two comes first."""
        history = self.histories[index]
        return None if history is None else history._replace(seen=(found,)).predicted()

    def restart(self) -> None:
        """Forget the frames so far: the next one is the first."""
        sway = np.full(2, np.deg2rad(self._config.beliefs.sway_deg) ** 2)
        self._pictures = [Pictures() for _ in self._heads]
        self.histories = [
            None if head is None or readout is None else History(readout, Sway(head.tilt_rad, sway))
            for head, readout in zip(self._heads, self._readouts, strict=True)
        ]

    def learn_readouts(self, take: FrameSets) -> Iterator[Progress]:
        """Localise the first frames of the ``take`` for the read-outs that they show, where a shutter rolls, or may,
        and its read-out is not known well; and restart with these.

        The body moves while a frame is read, and nobody tracks it well by read-outs that are learned on the way.
        """
        if not any(each is not None and each.is_open for each in self._readouts):
            return
        count = min(LOOK_AHEAD.frames, len(take))
        for frames in take.between(0, count):
            self(frames, None)
            yield Progress("learn read-outs", frames.index + 1, count)
        self._readouts = [None if each is None else each.readout.as_before() for each in self.histories]
        self.restart()

    def __call__(self, frames: FrameSet, tracker: Expecting | None) -> FrameLocalised:
        """Localise ``frames``, and put their rows right, those of the second fields by themselves; ``tracker``, where
        there is one, says where it expects the body."""
        started = time.perf_counter()
        one = partial(self._one, frames.index, tracker)
        second = frames.second_fields or (None,) * len(frames.images)
        found = self._pool.map(one, range(len(frames.images)), frames.images, second)
        first, later = zip(*found, strict=True)
        seen = as_found(self._heads, frames, first, later if frames.second_fields else None)
        return replace(seen, seconds=time.perf_counter() - started)

    def as_found(self, frames: FrameSet, found: tuple[Localisation | None, ...]) -> FrameLocalised:
        """``frames`` that were ``found`` before, their rows put right."""
        return as_found(self._heads, frames, found)

    def cameras(self, found: Sequence[Localisation | None]) -> tuple[Camera | None, ...]:
        """The cameras of an instant that was ``found``; None where one is lost."""
        return tuple(
            None if head is None or one is None or not one.valid else of_frame(head, one)
            for head, one in zip(self._heads, found, strict=True)
        )

    def with_readout(self) -> tuple[PanZoomCamera | None, ...]:
        """The cameras, with the read-out time that their frames have shown by now."""
        period_s = float(1 / self._frame_rate)
        return tuple(
            None if head is None or each is None
            else replace(
                head, readout_s=each.readout.share * period_s, readout_sigma_s=each.readout.deviation * period_s
            )
            for head, each in zip(self._heads, self.histories, strict=True)
        )  # fmt: skip

    def _one(
        self, frame: int, tracker: Expecting | None, index: int, image: Image | None, second: Image | None
    ) -> tuple[Localisation | None, Localisation | None]:
        """A view of a frame, and its second field where it has one."""
        localiser, head, history = self.localisers[index], self._heads[index], self.histories[index]
        if localiser is None or head is None or history is None or image is None:
            return None, None

        def hidden(prior: Localisation) -> Mask | None:
            camera = of_frame(head, prior)
            expected = None if tracker is None else tracker.expect(frame, camera)
            return None if expected is None else expected.covered(camera.height, camera.width)

        image, second = _grey(head, image), second if second is None else _grey(head, second)
        prior = history.predicted() or self._start(frame, index)
        localisation: Localisation = localiser.localise(image, prior, hidden)
        if self._ahead[index].first(frame, localisation):
            prior = prior or self._start(frame, index)
            if not localisation.valid and prior is not None:
                localisation = localiser.localise(image, prior, hidden)
        localisation = self._as_new_as(localisation, history, index, image)
        later: Localisation | None = None
        if second is not None and localisation.valid:
            later = localiser.localise(second, expected_second(history, localisation), hidden)
            if later.valid:
                there = np.array([later.pan_rad, np.log(later.focal_px)])
                localisation = replace(localisation, second_field=there)
        self.histories[index] = _corrected(history, localisation).followed_by(extrapolated(localisation), prior)
        share = history.readout.share
        return replace(localisation, readout=share), None if later is None else replace(later, readout=share)


def _grey(head: PanZoomCamera, image: Image) -> Image:
    """A frame's grey values, its colours brought to where they are seen without lateral colour."""
    return grey(colours_aligned(image, head.lens.lateral_colour))


def _corrected(history: History, found: Localisation) -> History:
    """A ``history``, its last frame where its picture shows it if the camera had stopped there, as the next frame that
    was ``found`` tells."""
    last = history.last
    if (
        last is None
        or not last.missed.any()
        or not found.valid
        or not stood_still(without_extrapolation(last), last.missed, found)
    ):
        return history
    return history._replace(seen=(*history.seen[:-1], without_extrapolation(last)))


def segment_views(
    cameras: Sequence[CalibratedCamera | None], silhouettes: ForegroundConfig, panzoom: PanZoomConfig,
    pool: ThreadPoolExecutor, seen: FrameLocalised, tracker: Expecting | None,
) -> FrameSegmented:  # fmt: skip
    """Stage 5: the athlete cut out of the views of an instant, side by side; ``tracker`` says where it expects the
    body."""
    started = time.perf_counter()

    def one(index: int) -> tuple[Camera | None, Silhouette | None, CameraPrior | None, WholeView | None]:
        image, found, known = seen.frames.images[index], seen.localisations[index], cameras[index]
        if known is None or image is None or found is None or not found.valid:
            return None, None, None, None
        camera = of_frame(known.camera, found)
        expected = None if tracker is None else tracker.expect(seen.frames.index, camera)
        cut_out = separate(image, known.panorama, known.camera, found, silhouettes, expected)
        whole = None
        if expected is not None and silhouettes.others:
            whole = whole_view(image, known.panorama, known.camera, found, silhouettes, expected)
        return camera, cut_out, camera_prior(panzoom, known.camera, found), whole

    found, cut_outs, priors, wholes = zip(*pool.map(one, range(len(seen.frames.images))), strict=True)
    cut_outs = _apart(cut_outs, wholes)
    return FrameSegmented(seen.frames, found, cut_outs, priors, time.perf_counter() - started)


def _apart(
    silhouettes: tuple[Silhouette | None, ...], wholes: Sequence[WholeView | None]
) -> tuple[Silhouette | None, ...]:
    """The ``silhouettes`` of an instant, with others whom the ``wholes`` show on the floor."""
    places = others_on_floor([whole for whole in wholes if whole is not None])
    if not len(places):
        return silhouettes
    return tuple(
        silhouette if silhouette is None or whole is None else with_others(silhouette, whole, places)
        for silhouette, whole in zip(silhouettes, wholes, strict=True)
    )
