"""Lateral colour of a lens, measured in pictures of the simulator's hall whose channels SciPy has stretched."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
import pytest
from scipy import ndimage

from pzcap.calibration.calibrate import Footage
from pzcap.calibration.lateral_colour import aligned, measure
from pzcap.calibration.tuning import LATERAL
from pzcap.imaging.colour import LUMA, colours_aligned, grey
from pzcap.types import Array, Image
from sim.hall.gym import GymConfig
from tests.scenes.hall import HEIGHT, WIDTH, Hall

CORNER_PX = np.hypot(WIDTH, HEIGHT) / 2
PANS = np.linspace(0.0, 2 * np.pi, 12, endpoint=False)


@pytest.fixture(scope="module")
def pictures() -> list[Image]:
    hall = Hall(GymConfig(), seed=3)
    try:
        taken = []
        for pan_rad in PANS.tolist():
            hall.look(0, pan_rad)
            taken.append(hall.image())
        return taken
    finally:
        hall.close()


def apart(corner_px: float) -> Array:
    """Stretches of blue, green and red by a lens that parts red from blue by twice so much in the corners."""
    red = corner_px / CORNER_PX
    return np.array([-red, 0.0, red]) - LUMA @ np.array([-red, 0.0, red])


def stretched(image: Image, stretches: Array) -> Image:
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    planes = [
        ndimage.map_coordinates(
            image[..., k].astype(float),
            [(v - (HEIGHT - 1) / 2) / (1 + s) + (HEIGHT - 1) / 2, (u - (WIDTH - 1) / 2) / (1 + s) + (WIDTH - 1) / 2],
            order=3, mode="nearest",
        )
        for k, s in enumerate(stretches)
    ]  # fmt: skip
    return np.clip(np.rint(np.dstack(planes)), 0, 255).astype(np.uint8)


def recorded(images: list[Image], rng: np.random.Generator) -> Iterator[tuple[int, Image]]:
    """As video has them, with noise and with chroma at half the resolution; between them frames nobody looks at."""
    for k, image in enumerate(images):
        noisy = np.clip(image + rng.normal(0.0, 2.0, image.shape), 0, 255).astype(np.uint8)
        video = cv2.cvtColor(cv2.cvtColor(noisy, cv2.COLOR_BGR2YUV_I420), cv2.COLOR_YUV2BGR_I420)
        yield k * LATERAL.every, np.asarray(video, np.uint8)
        yield k * LATERAL.every + 1, np.zeros_like(image)


@pytest.mark.parametrize("corner_px", [-1.5, -0.5, 0.5, 1.0])
def test_it_is_measured_in_a_sweep(pictures: list[Image], corner_px: float) -> None:
    """Chroma keeps otherwise much of a fringe in one hall than in another: to an eighth."""
    true = apart(corner_px)
    found = measure(recorded([stretched(each, true) for each in pictures], np.random.default_rng(0)))
    np.testing.assert_allclose(found[[0, 2]], true[[0, 2]], rtol=0.125, atol=0.03 / CORNER_PX)
    assert LUMA @ found == pytest.approx(0.0, abs=1e-12)


def test_a_lens_without_it_has_none(pictures: list[Image]) -> None:
    for seed in range(3):
        assert not measure(recorded(pictures, np.random.default_rng(seed))).any()


def test_pictures_without_colours_show_none(pictures: list[Image]) -> None:
    shown = [np.dstack([grey(each)] * 3) for each in pictures]
    assert not measure((k * LATERAL.every, each) for k, each in enumerate(shown)).any()


def test_too_few_frames_tell_nothing(pictures: list[Image]) -> None:
    few = [stretched(each, apart(1.0)) for each in pictures[: LATERAL.least_frames - 1]]
    assert not measure(recorded(few, np.random.default_rng(0))).any()


def test_pictures_without_edges_tell_nothing() -> None:
    blank = [np.full((HEIGHT, WIDTH, 3), (90, 120, 150), np.uint8)] * 12
    assert not measure((k * LATERAL.every, each) for k, each in enumerate(blank)).any()


def test_footage_is_aligned_as_a_whole(pictures: list[Image]) -> None:
    """Grey values come to where they would be without it: to a third of what it had moved them by."""
    true = apart(3.0)
    shown = [stretched(each, true) for each in pictures]
    numbered = list(enumerate(shown))
    for zoom in (numbered, None):
        footage = aligned(Footage(shown[0], None, numbered, zoom, True), true)
        assert (footage.zoom is None) == (zoom is None)
        parts = [footage.sweep, *([] if footage.zoom is None else [footage.zoom])]
        for part in [[(0, footage.reference_image)], *parts]:
            for number, image in part:
                np.testing.assert_array_equal(image, colours_aligned(shown[number], true))
    smooth = [cv2.GaussianBlur(each, (0, 0), 1.5) for each in pictures]
    left, moved = (
        np.mean([np.square(grey(f(stretched(each, true))).astype(float) - grey(each)).mean() for each in smooth])
        for f in (lambda image: colours_aligned(image, true), lambda image: image)
    )
    assert left < moved / 9


def test_without_it_an_image_is_itself(pictures: list[Image]) -> None:
    assert colours_aligned(pictures[0], np.zeros(3)) is pictures[0]
