"""Views of an instant: a camera that is not found in the first frames by itself is, from a later one."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction
from typing import cast

import numpy as np
import pytest

from pzcap.calibration.settings import PanZoomConfig
from pzcap.camera_set import calibrated_of
from pzcap.io.capture import FrameSets
from pzcap.localisation.localise import lost
from pzcap.tuning import LOOK_AHEAD
from pzcap.types import FrameSet, Image, Localisation, Panorama, PanZoomCamera
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
        number, nothing = int(image[0, 0, 0]), np.empty((0, 2))
        near = prior is not None and abs(prior.pan_rad - number * TURN_RAD) < 2.5 * TURN_RAD
        if number < FOUND and not near:
            return lost(self.camera, prior)
        place = number * TURN_RAD, self.camera.tilt_rad, self.camera.lens.reference_focal_px
        return Localisation(*place, np.eye(2) * 1e-8, True, nothing, nothing)


@pytest.fixture
def localise() -> Iterator[ViewLocaliser]:
    with ThreadPoolExecutor(2) as pool:
        made = fabricated.reconstruction()
        yield ViewLocaliser(calibrated_of(made), PanZoomConfig(), pool, Fraction(30), Late)


def valid(localise: ViewLocaliser, footage: Footage) -> list[bool]:
    seen = [localise(frames, None).localisations for frames in footage.between(0, len(footage))]
    assert all(len({one is not None and one.valid for one in views}) == 1 for views in seen)
    return [bool(views[0] and views[0].valid) for views in seen]


def looked(localise: ViewLocaliser, footage: Footage) -> None:
    localise.look_ahead(cast(FrameSets, footage))


def test_without_looking_ahead_the_first_frames_are_lost(localise: ViewLocaliser) -> None:
    assert valid(localise, Footage(30)) == [False] * FOUND + [True] * (30 - FOUND)


def test_they_are_found_from_a_later_one_and_back(localise: ViewLocaliser) -> None:
    looked(localise, Footage(30))
    assert all(valid(localise, Footage(30)))
    localise.restart()
    assert all(valid(localise, Footage(30)))


def test_a_frame_that_a_camera_dropped_is_passed_over(localise: ViewLocaliser) -> None:
    looked(localise, Footage(30, dropped=5))
    assert valid(localise, Footage(30, dropped=5)) == [index != 5 for index in range(30)]


def test_nothing_is_looked_for_where_the_first_frame_is_found(
    localise: ViewLocaliser, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tests.test_views.FOUND", 0)
    footage = Footage(30)
    looked(localise, footage)
    assert set(footage.read) == {0}


@pytest.mark.parametrize("frames", [10, 2 * LOOK_AHEAD.frames])
def test_the_search_ends_with_the_take_or_before_it_takes_long(
    localise: ViewLocaliser, monkeypatch: pytest.MonkeyPatch, frames: int
) -> None:
    monkeypatch.setattr("tests.test_views.FOUND", 10_000)
    footage = Footage(frames)
    looked(localise, footage)
    assert max(footage.read) < min(frames, LOOK_AHEAD.frames)
    assert not any(valid(localise, Footage(10)))


def test_a_camera_that_is_not_calibrated_is_left_out() -> None:
    made = fabricated.without_a_camera(fabricated.reconstruction())
    with ThreadPoolExecutor(2) as pool:
        localise = ViewLocaliser(calibrated_of(made), PanZoomConfig(), pool, Fraction(30), Late)
        looked(localise, Footage(30))
        (frames,) = Footage(1).between(0, 1)
        found = localise(frames, None).localisations
    assert [one is not None and one.valid for one in found] == [one is not None for one in made.cameras]
