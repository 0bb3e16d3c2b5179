"""Views of an instant: a camera that is not found in the first frames by itself is, from a later one."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from fractions import Fraction
from typing import cast

import numpy as np
import pytest

from pzcap.calibration.settings import PanZoomConfig
from pzcap.camera_set import calibrated_of
from pzcap.io.capture import FrameSets
from pzcap.localisation.localise import lost
from pzcap.localisation.tuning import READOUT, REPETITION
from pzcap.tuning import LOOK_AHEAD
from pzcap.types import FrameSet, Image, Localisation, Panorama, PanZoomCamera, Reconstruction
from pzcap.views import ViewLocaliser
from tests.scenes import fabricated

FOUND = 14  # the first frame that is found without another
TURN_RAD = 1e-3  # a frame


class Footage:
    """Frame sets of as many views as the fabricated cameras; a picture's brightness is the number of its frame."""

    def __init__(self, frames: int, dropped: int | None = None) -> None:
        self.frames, self.dropped = frames, dropped
        self.read: list[int] = []

    def __len__(self) -> int:
        return self.frames

    def between(self, start: int, stop: int) -> Iterator[FrameSet]:
        for index in range(start, stop):
            self.read.append(index)
            image = None if index == self.dropped else np.full((8, 8, 3), index, np.uint8)
            yield FrameSet(index, "", (image,) * 4, (), (), ())


class Late:
    """Finds a frame from ``FOUND`` on, and one before that near where it is expected."""

    def __init__(self, _: Panorama, camera: PanZoomCamera, __: PanZoomConfig) -> None:
        self.camera = camera

    def localise(self, image: Image, prior: Localisation | None, _: object = None) -> Localisation:
        number, nothing = int(image[0, 0]), np.empty((0, 2))
        near = prior is not None and abs(prior.pan_rad - number * TURN_RAD) < 2.5 * TURN_RAD
        if number < FOUND and not near:
            return lost(self.camera, prior)
        place = number * TURN_RAD, self.camera.tilt_rad, self.camera.lens.reference_focal_px
        return Localisation(*place, np.eye(2) * 1e-8, True, nothing, nothing)


class Rolling(Late):
    """Finds every frame, of a camera that is panned to and fro and reads a frame out in half of its period."""

    def localise(self, image: Image, _: Localisation | None, __: object = None) -> Localisation:
        number, nothing = int(image[0, 0]), np.empty((0, 2))
        place = 0.2 * np.sin(0.1 * number), self.camera.tilt_rad, self.camera.lens.reference_focal_px
        shear = np.array([0.5 * 0.02 * np.cos(0.1 * number), 0.0])
        return Localisation(*place, np.eye(2) * 1e-8, True, nothing, nothing, shear=shear, shear_sigma=np.full(2, 5e-5))


def localising(
    ahead: Footage | None, made: Reconstruction | None = None, by: type[Late] = Late
) -> ViewLocaliser:  # fmt: skip
    cameras = calibrated_of(made or fabricated.reconstruction())
    take = cast(FrameSets | None, ahead)
    return ViewLocaliser(cameras, PanZoomConfig(), ThreadPoolExecutor(2), Fraction(30), by, take)


def valid(localise: ViewLocaliser, footage: Footage) -> list[bool]:
    seen = [localise(frames, None).localisations for frames in footage.between(0, len(footage))]
    assert all(len({one is not None and one.valid for one in views}) == 1 for views in seen)
    return [bool(views[0] and views[0].valid) for views in seen]


def test_without_looking_ahead_the_first_frames_are_lost() -> None:
    assert valid(localising(None), Footage(30)) == [False] * FOUND + [True] * (30 - FOUND)


def test_they_are_found_from_a_later_one_and_back() -> None:
    localise = localising(Footage(30))
    assert all(valid(localise, Footage(30)))
    localise.restart()
    assert all(valid(localise, Footage(30)))


@pytest.mark.parametrize("dropped", [0, 5, 6])
def test_a_frame_that_a_camera_dropped_is_passed_over(dropped: int) -> None:
    found = valid(localising(Footage(30, dropped)), Footage(30, dropped))
    assert found == [index != dropped for index in range(30)]


def test_nothing_is_looked_for_where_the_first_frame_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.test_views.FOUND", 0)
    ahead = Footage(30)
    assert all(valid(localising(ahead), Footage(30)))
    assert not ahead.read


@pytest.mark.parametrize("frames", [10, 2 * LOOK_AHEAD.frames])
def test_the_search_ends_with_the_take_or_before_it_takes_long(monkeypatch: pytest.MonkeyPatch, frames: int) -> None:
    monkeypatch.setattr("tests.test_views.FOUND", 10_000)
    ahead = Footage(frames)
    assert not any(valid(localising(ahead), Footage(10)))
    assert 0 < max(ahead.read) < min(frames, LOOK_AHEAD.frames)
    assert len(ahead.read) <= 4 * LOOK_AHEAD.frames / LOOK_AHEAD.stride  # once for each of four cameras


@pytest.mark.parametrize(
    ("share", "sigma", "open_"),
    [(0.4, 0.1, True), (0.0, 0.2, True), (0.5, 0.01, False), (0.0, 0.014, False)],
    ids=["rolls", "nothing is known", "is known", "is global"],
)
def test_read_outs_that_are_not_known_are_learned_beforehand(share: float, sigma: float, open_: bool) -> None:
    made, take = fabricated.reconstruction(), Footage(2 * LOOK_AHEAD.frames)
    heads = [
        None if head is None else replace(head, readout_s=share / 30, readout_sigma_s=sigma / 30)
        for head in made.cameras
    ]  # fmt: skip
    localise = localising(None, replace(made, cameras=tuple(heads)), Rolling)
    told = list(localise.learn_readouts(cast(FrameSets, take)))
    assert [(each.done, each.total) for each in told] == [(n + 1, LOOK_AHEAD.frames) for n in take.read]
    assert take.read == (list(range(LOOK_AHEAD.frames)) if open_ else [])
    for history in localise.histories:
        assert history is not None
        assert not history.seen
        assert history.readout.share == pytest.approx(0.5 if open_ else share, abs=0.01)
        assert history.readout.sigma == history.readout.believed == READOUT.from_sweep


def test_a_camera_that_is_not_calibrated_is_left_out() -> None:
    made = fabricated.without_a_camera(fabricated.reconstruction())
    (frames,) = Footage(1).between(0, 1)
    found = localising(Footage(30), made)(frames, None).localisations
    assert [one is not None and one.valid for one in found] == [one is not None for one in made.cameras]


def test_a_picture_that_repeats_the_one_before_is_less_sure(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.test_views.FOUND", 0)
    localise, (first,) = localising(None), Footage(1).between(0, 1)
    edges = np.tile(np.arange(8, dtype=np.uint8) % 2 * 100, (8, 1))[..., None].repeat(3, axis=2)
    repeated, new = (replace(first, index=1, images=(edges + lighter,) * 4) for lighter in (np.uint8(0), np.uint8(9)))
    sigmas = []
    for frames in (repeated, new):
        localise.restart()
        localise(replace(first, images=(edges,) * 4), None)
        found = localise(frames, None).localisations[0]
        assert found is not None
        sigmas.append(np.sqrt(found.covariance[0, 0]) * found.focal_px)
    assert sigmas[0] > 0.9 * REPETITION.sigma_px > sigmas[1]


def test_a_camera_that_stops_is_said_to_have_missed_a_change_for_one_frame_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("tests.test_views.FOUND", 0)
    localise, (frames,) = localising(None), Footage(1).between(0, 1)
    edges = np.tile(np.arange(8, dtype=np.uint8) % 2 * 100, (8, 1))[..., None].repeat(3, axis=2)
    missed, pans = [], []
    for index, number in enumerate([0, 10, 20, 30, 40, 50, 50, 50, 50, 50]):  # 6 pixels a frame, then none
        picture = edges.copy()
        picture[0, 0] = number
        found = localise(replace(frames, index=index, images=(picture,) * 4), None).localisations[0]
        assert found is not None
        missed.append(bool(found.missed.any()))
        expected = localise.histories[0].predicted() if localise.histories[0] else None
        pans.append(0.0 if expected is None else expected.pan_rad / TURN_RAD)
    assert missed == [False] * 6 + [True] + [False] * 3
    np.testing.assert_allclose(pans[-3:], 50.0, atol=1e-6)
