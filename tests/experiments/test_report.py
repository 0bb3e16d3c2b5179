"""What the page shows of the keyframes."""

from __future__ import annotations

import numpy as np

from experiments.report import plots
from pzcap.scoring.body_errors import BodyErrors


def errors(frames: int = 40) -> BodyErrors:
    keyframe = np.zeros(frames, bool)
    keyframe[[0, 20, 39]] = True
    nothing = np.zeros(frames, bool)
    return BodyErrors(
        np.full((frames, 16), 0.01), np.full((frames, 16), 0.01), np.zeros(15), ~nothing, keyframe, nothing, nothing
    )


def test_the_error_over_time_marks_what_is_said_of_the_keyframes() -> None:
    plain = plots.body_error(errors(), [], None)
    advised = plots.body_error(errors(), [20], 30)
    for label in ("contradicted", "next keyframe"):
        assert label not in plain
        assert label in advised
