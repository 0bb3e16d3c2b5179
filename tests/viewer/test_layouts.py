"""First look of the viewer."""

from __future__ import annotations

import numpy as np

from pzcap.viewer import layouts
from tests.scenes import fabricated


def test_the_eye_stands_before_all_cameras() -> None:
    """Within 40 degrees of where it looks, as far as a wide view shows."""
    found = fabricated.reconstruction()
    eye = layouts._eye(found)
    assert eye.position is not None
    assert eye.look_target is not None
    position, target = (np.array(each.as_arrow_array().to_pylist()[0]) for each in (eye.position, eye.look_target))
    ahead = (target - position)[:2]
    for camera in found.cameras:
        assert camera is not None
        to = camera.world_T_head[:2, 3] - position[:2]
        assert np.degrees(np.arccos(to @ ahead / np.linalg.norm(to) / np.linalg.norm(ahead))) < 40.0


def test_notes_stand_where_there_are_no_totals() -> None:
    for scored, first in ((True, 0), (False, 1)):
        row = list(layouts.overview(fabricated.reconstruction(), scored=scored).contents)[1]
        texts = list(row.contents)[2]  # type: ignore[union-attr]
        assert [view.name for view in texts.contents] == ["Summary", "Notes"]  # type: ignore[union-attr]
        assert texts.active_tab == first  # type: ignore[union-attr]
