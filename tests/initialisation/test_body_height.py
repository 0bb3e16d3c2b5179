"""Height of the athlete by contours, in units of a body whose size is open."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from pzcap.body import skeleton
from pzcap.body.skeleton import Body
from pzcap.initialisation.body_height import seen_height
from pzcap.initialisation.people import athlete
from pzcap.tracking.observation import ViewInput
from pzcap.tracking.pixel_time import Exposure
from pzcap.types import Keyframe, Subject
from pzcap.without_object import of_open_size
from sim.people.anthropometry import draw_measurements
from tests.initialisation.test_keyframes import FRAMES, observe
from tests.scenes.detected import Faults, detections
from tests.scenes.tracked import CONFIG


def of_size(factor: float) -> Body:
    """The athlete's body, so many times as large, to four per cent."""
    true = draw_measurements(np.random.default_rng(3))
    return of_open_size(skeleton.build(Subject({name: factor * length for name, length in true.items()}, 0.004)), 0.04)


def test_contours_tell_the_size_of_a_body_that_is_seen_row_by_row() -> None:
    found_people = detections(FRAMES, Faults())

    def seen(key: Keyframe) -> Sequence[ViewInput | None]:
        views = zip(observe(key), found_people[key.frame].views, strict=True)
        return [
            None
            if view is None or found is None
            else replace(view, people=found[1], exposure=Exposure(clock=0.01, readout=0.05))
            for view, found in views
        ]

    sightings = list(enumerate(athlete(found_people)))
    found = seen_height(of_size(0.96), sightings, seen, CONFIG)
    assert found is not None
    assert found.ratio == pytest.approx(1.0 / 0.96, abs=0.012)
    assert found.sigma < 0.012
