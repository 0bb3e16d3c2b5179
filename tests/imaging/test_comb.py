"""The comb of two fields in one picture, and nothing of one."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pzcap.command.check.motion_check import check_shutter
from pzcap.imaging.comb import comb_of, comb_px
from pzcap.types import Array, Image
from tests.scenes.recorders import TURNS, encode, flag

WIDTH, HEIGHT = 320, 240


def hall(seed: int) -> Array:
    """A wall of slanting edges, wider than a picture."""
    noise = np.random.default_rng(seed).normal(size=(HEIGHT, 3 * WIDTH)).astype(np.float32)
    turned = cv2.warpAffine(cv2.GaussianBlur(noise, (0, 0), 2.0), np.array([[1, 0.5, 0], [0, 1, 0]], float), None)
    return np.asarray(120.0 + 35.0 * turned / turned.std(), float)


def seen(wall: Array, right_px: float, noise: float, rng: np.random.Generator) -> Image:
    """The wall in a picture, so far to the right."""
    move = np.array([[1.0, 0.0, right_px - WIDTH], [0.0, 1.0, 0.0]])
    picture = cv2.warpAffine(wall, move, (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC)
    return np.clip(picture + rng.normal(scale=noise, size=picture.shape), 0, 255).astype(np.uint8)


def panned(seed: int, count: int, step_px: float, first: int | None, noise: float = 2.0) -> list[Image]:
    """Pictures of a wall that moves by ``step_px`` from one to the next; ``first``: the rows, even (0) or odd (1), that
    are seen first, the others half a step later. None: all at once."""
    rng, wall, pictures = np.random.default_rng(seed), hall(seed), []
    for k in range(count):
        picture = seen(wall, k * step_px, noise, rng)
        if first is not None:
            picture[1 - first :: 2] = seen(wall, (k + 0.5) * step_px, noise, rng)[1 - first :: 2]
        pictures.append(picture)
    return pictures


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 50), st.floats(-7.0, 7.0))
def test_a_comb_is_as_wide_as_the_fields_are_apart_and_whole_pictures_have_none(seed: int, step_px: float) -> None:
    [woven], [whole] = (panned(seed, 1, step_px, first) for first in (0, None))
    assert comb_px(woven) == pytest.approx(0.5 * step_px, abs=0.15 + 0.06 * abs(step_px))
    assert abs(comb_px(whole)) < 0.1


def test_a_bare_picture_has_none() -> None:
    assert comb_px(np.full((HEIGHT, WIDTH, 3), 90, np.uint8)) == 0.0


@pytest.mark.parametrize(("first", "share"), [(0, 1.0), (1, -1.0), (None, 0.0)])
def test_which_field_is_first_is_told_by_the_way_of_the_pan(first: int | None, share: float) -> None:
    combs = np.array([comb_px(each) for each in panned(3, 12, 4.0, first)])
    comb = comb_of(combs, np.full(12, 4.0))
    assert comb is not None
    assert comb.share == pytest.approx(share, abs=0.1)
    assert comb.is_woven == (first is not None)


def test_a_camera_that_stands_still_tells_nothing() -> None:
    combs = np.array([comb_px(each) for each in panned(3, 12, 0.2, 0)])
    assert comb_of(combs, np.full(12, 0.2)) is None


@pytest.mark.parametrize("first", [0, 1])
def test_a_file_that_does_not_say_it_is_found_by_check_which_tells_how_to_say_it(first: int, tmp_path: Path) -> None:
    pictures = [np.repeat(each[..., None], 3, axis=2) for each in panned(5, 14, 3.0, first)]
    silent = encode(tmp_path / "motion.mp4", pictures, Fraction(25))
    shutter, findings = check_shutter("1", silent)
    assert shutter.interlaced
    assert not any("held upright" in each.text for each in findings)
    [finding] = [each for each in findings if "interlaced" in each.text]
    order = finding.text.partition("-x264-params ")[2].split()[0]
    assert order == ("tff=1", "bff=1")[first]
    told = encode(tmp_path / "told.mp4", pictures, Fraction(25), options={"x264-params": order})
    shutter, findings = check_shutter("1", told)
    assert shutter.interlaced
    assert not any("interlaced" in each.text for each in findings)


def test_a_phone_that_was_held_upright_is_found_by_check(tmp_path: Path) -> None:
    lying = [np.repeat(each[..., None], 3, axis=2) for each in panned(5, 14, 3.0, None)]
    stored = [np.ascontiguousarray(np.rot90(each)) for each in lying]
    path = flag(encode(tmp_path / "motion.mp4", stored, Fraction(25)), TURNS[90])
    [finding] = check_shutter("1", path)[1]
    assert "held upright" in finding.text
