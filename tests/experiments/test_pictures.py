"""Pictures of the report."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from experiments.report.pictures import panorama_picture
from pzcap.viewer.drawing import footprint, instants
from tests.scenes import fabricated


def test_a_border_is_drawn_where_it_lies_on_a_panorama_without_a_full_turn() -> None:
    """The strip would reach beyond both edges of the panorama, and is cut there."""
    whole = fabricated.reconstruction()
    camera, panorama, track = whole.cameras[0], whole.panoramas[0], whole.tracks[0]
    assert camera is not None
    assert panorama is not None
    assert track is not None
    at = instants(camera, track)[0]
    assert at is not None
    image = np.zeros((180, 420, 3), np.uint8)
    origin = np.array([210.0 + track.pan_rad[0] * panorama.px_per_rad, 90.0])
    part = replace(panorama, image=image, valid=np.ones((180, 420), bool), origin_px=origin, full_turn=False)
    picture = panorama_picture(part, camera, [at], [(255, 0, 0)], [])
    drawn = np.flatnonzero(picture[..., 2].max(axis=0) > 127)
    (border,) = footprint(part, camera, at)
    np.testing.assert_allclose([drawn[0], drawn[-1]], [border[:, 0].min(), border[:, 0].max()], atol=2.0)
