"""The crew's measurements and marks in the hall."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from experiments.footage import SMALL
from pzcap.initialisation.known_lengths import Sight, meet
from pzcap.types import Camera
from sim.hall.surfaces import CARPET_M
from sim.measuring import sides_of_carpet
from sim.people.crew import CrewConfig
from sim.session import Session, assemble

EXACT = replace(SMALL, sweep_deg=360.0, crew=replace(CrewConfig(), lengths="carpet", click_px=0.0, length_sigma_m=0.0))


def camera_of(session: Session, name: str, frame: int) -> Camera:
    rig, run = session.rigs[int(name) - 1], session.sweep(int(name) - 1)
    aim = run.at(float(run.times_s[frame]))
    return Camera(
        rig.width, rig.height, rig.world_T_cam(*aim), aim.focal_px, rig.principal_px, rig.k1(aim.focal_px)
    )  # fmt: skip


def test_marks_are_the_corners_of_the_carpet() -> None:
    session = assemble(EXACT)
    sides = sides_of_carpet(session)
    assert len(sides) >= 2
    for side in sides:
        ends = [
            meet([Sight(camera_of(session, m.camera, m.frame), m.px, 0.0) for m in end], 0.003).place_m
            for end in side.ends
        ]
        assert np.linalg.norm(ends[1] - ends[0]) == pytest.approx(CARPET_M, abs=0.01)
        assert side.length_m == CARPET_M
        for end in ends:
            np.testing.assert_allclose(np.abs(end), [CARPET_M / 2, CARPET_M / 2, 0.0], atol=0.01)


def test_readings_and_marks_err_as_the_settings_say() -> None:
    crew = replace(EXACT.crew, click_px=2.0, length_sigma_m=0.1)
    exact, found = (sides_of_carpet(assemble(config)) for config in (EXACT, replace(EXACT, crew=crew)))
    off = [
        mark.px - true.px
        for side, other in zip(found, exact, strict=True)
        for end, truth in zip(side.ends, other.ends, strict=True)
        for mark, true in zip(end, truth, strict=True)
    ]
    assert 0.5 < np.std(off) < 4.0
    assert all(side.sigma_m == 0.1 for side in found)
    assert 0.02 < np.std([side.length_m - CARPET_M for side in found]) < 0.3
