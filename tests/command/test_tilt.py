"""A head that was tilted while it filmed, told from a tripod that was moved before."""

from __future__ import annotations

import numpy as np
import pytest

from pzcap.command.check.findings import Level
from pzcap.command.check.motion_check import Places, check_tilt
from pzcap.command.check.sweep_check import Sweep
from pzcap.command.check.views import NOTHING, Relation

SWEEP = Sweep(1.4, np.zeros(1), (), np.empty(0), (), 100.0)


@pytest.mark.parametrize(
    ("tilts_deg", "level", "says"),
    [
        ([0.1, 0.0, -0.1, 0.15, 0.0], None, ""),
        ([0.1, 0.0, 5.0, 0.15, 0.0, 0.1, -0.1, 0.0], None, ""),  # one picture is placed wrongly
        ([0.7, 0.6, 0.65, 0.75, 0.6], Level.WARN, "looks 0.65 degrees lower than the sweep; the tripod was moved"),
        ([-1.7, -1.7, -1.6, -1.8, -1.7], Level.FAIL, "looks 1.70 degrees higher than the sweep"),
        ([-1.7, -1.2, -0.4, 0.3, 1.1], Level.WARN, "its head was tilted while it filmed, over 2.0 degrees"),
        ([], None, ""),
    ],
)
def test_what_is_said_of_the_tilt(tilts_deg: list[float], level: Level | None, says: str) -> None:
    seen = [Relation(100, down=SWEEP.focal * np.deg2rad(tilt)) for tilt in tilts_deg]
    found = list(check_tilt("1", "motion", Places((), (*seen, NOTHING), np.zeros(len(seen) + 1)), SWEEP))
    assert [each.level for each in found] == ([] if level is None else [level])
    assert all(says in each.text for each in found)
