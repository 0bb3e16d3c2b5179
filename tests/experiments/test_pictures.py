"""Pictures of the report."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from experiments.report.pictures import EMPTY, panorama_picture, window
from pzcap.types import Camera, Panorama, PanZoomCamera, PanZoomTrack
from pzcap.viewer.drawing import footprint, instants
from tests.scenes import fabricated


def first_view() -> tuple[PanZoomCamera, Panorama, PanZoomTrack, Camera]:
    """A camera, its panorama, its track, and where it is in the first frame."""
    whole = fabricated.reconstruction()
    camera, panorama, track = whole.cameras[0], whole.panoramas[0], whole.tracks[0]
    assert camera is not None
    assert panorama is not None
    assert track is not None
    at = instants(camera, track)[0]
    assert at is not None
    return camera, panorama, track, at


def test_a_border_is_drawn_where_it_lies_on_a_panorama_without_a_full_turn() -> None:
    """The strip would reach beyond both edges of the panorama, and is cut there."""
    camera, panorama, track, at = first_view()
    image = np.zeros((180, 420, 3), np.uint8)
    origin = np.array([210.0 + track.pan_rad[0] * panorama.px_per_rad, 90.0])
    part = replace(panorama, image=image, valid=np.ones((180, 420), bool), origin_px=origin, full_turn=False)
    picture = panorama_picture(part, camera, [at], [(255, 0, 0)], [])
    drawn = np.flatnonzero(picture[..., 2].max(axis=0) > 127)
    (border,) = footprint(part, camera, at)
    np.testing.assert_allclose([drawn[0], drawn[-1]], [border[:, 0].min(), border[:, 0].max()], atol=2.0)


def test_a_sweep_that_passes_behind_the_camera_is_shown_there() -> None:
    """A partial panorama may count its azimuths on beyond half a turn, where frames count from the other side."""
    _, panorama, _, _ = first_view()
    around = round(2 * np.pi * panorama.px_per_rad)
    swept = round(0.9 * around)
    shades = np.broadcast_to(np.linspace(80, 250, swept)[None, :, None], (40, swept, 3)).astype(np.uint8)
    part = replace(
        panorama, image=shades, valid=np.ones((40, swept), bool), full_turn=False,
        origin_px=np.array([0.5 * swept, 20.0]) + np.array([0.3 * around, 0.0]),
    )  # fmt: skip
    behind = -0.75 * np.pi  # column 0.375 of a turn right of the origin, beyond the right edge; a turn less is within
    image, corner = window(part, behind - 0.1, behind + 0.1, (0, 40))
    first = round(part.origin_px[0] - (behind + 0.1) * part.px_per_rad)
    assert corner[0] == first
    np.testing.assert_array_equal(image[0, :, 0], shades[0, first - around : first - around + image.shape[1], 0])
    assert image.shape[1] == round(0.2 * part.px_per_rad) + 1


def test_a_footprint_behind_the_camera_lies_on_the_sweep() -> None:
    camera, panorama, track, at = first_view()
    pan_rad = float(track.pan_rad[0]) + 2 * np.pi  # as a sweep counts that went once round before it came there
    origin = np.array([210.0 + pan_rad * panorama.px_per_rad, 90.0])
    part = replace(
        panorama, image=np.zeros((180, 420, 3), np.uint8), valid=np.ones((180, 420), bool), origin_px=origin,
        full_turn=False,
    )  # fmt: skip
    (border,) = footprint(part, camera, at)
    assert abs(border[:, 0].mean() - 210.0) < 40.0


def test_across_the_gap_of_a_sweep_the_picture_is_grey() -> None:
    _, panorama, _, _ = first_view()
    around = round(2 * np.pi * panorama.px_per_rad)
    gap = round(0.05 * around)
    swept = around - gap
    part = replace(
        panorama, image=np.full((40, swept, 3), 200, np.uint8), valid=np.ones((40, swept), bool), full_turn=False,
        origin_px=np.array([0.5 * swept, 20.0]),
    )  # fmt: skip
    image, _ = window(part, np.pi - 0.5, np.pi + 0.5, (0, 40))
    assert np.sum(np.all(image[0] == EMPTY, axis=1)) == gap
    assert np.all(image[0, [0, -1]] == 200)
