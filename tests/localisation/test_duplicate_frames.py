"""Pictures that a codec repeats: they are told from new ones, and known to be less sure of where the camera is."""

from __future__ import annotations

import io
from dataclasses import replace

import av
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pzcap.localisation import duplicate_frames
from pzcap.localisation.tuning import REPETITION
from pzcap.types import Array, Image, Localisation

WIDTH, HEIGHT = 320, 240
FOCAL_PX = 900.0


def hall(shift_px: float, noise: np.random.Generator) -> Image:
    """A picture of blurred edges, shifted to the right, with a sensor's noise of two grey levels."""
    rng, x = np.random.default_rng(5), np.arange(WIDTH) - shift_px
    rows = np.zeros((HEIGHT, WIDTH))
    for row in range(0, HEIGHT, 24):
        for edge in rng.uniform(0, WIDTH, 12):
            rows[row : row + 24] += rng.uniform(-25, 25) * np.tanh((x - edge) / 1.5)
    return np.clip(rows + 128 + noise.normal(0, 2, rows.shape), 0, 255).astype(np.uint8)


def decoded(pictures: list[Image], crf: int) -> list[Image]:
    """The ``pictures`` as H.264 leaves them."""
    file = io.BytesIO()
    with av.open(file, "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=30, options={"crf": str(crf)})
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        for picture in pictures:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, "gray").reformat(format="yuv420p")))
        container.mux(stream.encode(None))
    file.seek(0)
    with av.open(file) as container:
        return [frame.to_ndarray(format="gray") for frame in container.decode(video=0)]


def shares(pictures: list[Image]) -> Array:
    seen = duplicate_frames.Pictures()
    return np.array([seen.repeated_share(picture, 0.0) for picture in pictures])[1:]


def taken(shift_px: Array) -> list[Image]:
    noise = np.random.default_rng(1)
    return [hall(shift, noise) for shift in shift_px]


@pytest.mark.parametrize("step_px", [0.0, 0.1, 3.0])
def test_no_block_of_two_exposures_is_the_same(step_px: float) -> None:
    assert shares(taken(step_px * np.arange(4.0))).max() == 0.0


@given(st.integers(0, 2**31))
@settings(deadline=None)  # the first one compiles
def test_blocks_are_compared_as_whole_arrays_are(seed: int) -> None:
    """Brighter or darker: a block is the same where no pixel of it has changed by more than `levels`."""
    rng, size = np.random.default_rng(seed), REPETITION.block_px
    before = rng.integers(0, 256, (5 * size + 3, 4 * size + 1), np.uint8)
    change = rng.integers(-1, 2, before.shape) * rng.integers(0, 4, before.shape) * (rng.random(before.shape) < 0.01)
    grey = np.clip(before + change, 0, 255).astype(np.uint8)
    same, _ = duplicate_frames._blocks(grey, before)
    apart = np.abs(grey.astype(int) - before)[: 5 * size, : 4 * size].reshape(5, size, 4, size)
    np.testing.assert_array_equal(same, apart.max(axis=(1, 3)) <= REPETITION.levels)


def test_a_codec_repeats_what_hardly_moves_and_not_what_does() -> None:
    slow, fast = (shares(decoded(taken(step_px * np.arange(12.0)), 30)) for step_px in (0.05, 3.0))
    assert slow.mean() > 0.3
    assert fast.mean() < 0.1


def test_the_more_is_lost_the_more_is_repeated() -> None:
    moving = taken(0.2 * np.sin(np.arange(12.0)))
    fine, coarse = (shares(decoded(moving, crf)).mean() for crf in (10, 34))
    assert fine < 0.05 < coarse


@settings(deadline=None)
@given(st.integers(0, HEIGHT // 8 - 1), st.integers(0, WIDTH // 8 - 1))
def test_a_block_counts_by_how_steep_it_is(row: int, column: int) -> None:
    before = hall(0.0, np.random.default_rng(2)).clip(2, 253)
    picture = before + np.uint8(1)  # a grey level is what a filter between blocks may change
    assert shares([before, picture]) == pytest.approx(1.0)
    picture[8 * row + 3, 8 * column + 3] ^= 8
    steep = np.square(np.diff(picture.astype(float), axis=1, append=picture[:, -1:]))
    steep = steep.reshape(HEIGHT // 8, 8, WIDTH // 8, 8).mean(axis=(1, 3))
    weight = steep / (steep + REPETITION.steep**2)
    assert shares([before, picture]) == pytest.approx(1.0 - weight[row, column] / weight.sum(), abs=1e-5)


def test_what_a_camera_writes_over_its_pictures_is_no_repetition() -> None:
    pictures, seen = taken(4.0 * np.arange(8.0)), duplicate_frames.Pictures()
    date = np.where(np.random.default_rng(7).random((24, 160)) < 0.5, 0, 255)
    for picture in pictures:
        picture[8:32, 80:240] = date
    assert shares(pictures).min() > 0.2  # a twentieth of the picture, and the steepest of it
    assert max(seen.repeated_share(picture, 4.0) for picture in pictures) == 0.0
    assert seen.repeated_share(pictures[-1], 4.0) > 0.99


def test_a_lamp_that_outshines_all_is_not_taken_for_repeated() -> None:
    first, second = taken(np.array([0.0, 3.0]))
    first[40:200, 100:260] = second[40:200, 100:260] = 255
    assert shares([first, second]) == 0.0


def known(share: float, change: Array) -> Localisation:
    exact = Localisation(0.1, 0.0, FOCAL_PX, np.zeros((2, 2)), True, np.empty((0, 2)), np.empty((0, 2)))
    return duplicate_frames.known_less_surely(exact, change, share, WIDTH)


def test_a_new_picture_is_as_sure_as_it_was() -> None:
    found = known(0.0, np.array([0.01, 0.01]))
    assert not found.covariance.any()
    assert not found.missed.any()


def test_one_that_a_codec_repeats_is_off_by_a_part_of_a_pixel() -> None:
    found = known(1.0, np.zeros(2))
    pan, focal = np.sqrt(np.diag(found.covariance))
    assert pan * FOCAL_PX == pytest.approx(REPETITION.sigma_px)
    assert focal * WIDTH / 2 == pytest.approx(REPETITION.sigma_px)
    assert not found.missed.any()


@pytest.mark.parametrize("change", [(5.0 / FOCAL_PX, 0.0), (0.0, -5.0 / (WIDTH / 2))])
def test_one_that_shows_the_frame_before_has_missed_what_was_to_change(change: tuple[float, float]) -> None:
    move = np.array(change)
    np.testing.assert_array_equal(known(0.9, move).missed, move)
    np.testing.assert_array_equal(known(0.9, move).covariance, known(0.9, np.zeros(2)).covariance)
    assert not known(0.1, move).missed.any()  # flat parts of a hall
    assert not known(0.9, 0.2 * move).missed.any()  # a codec may have done that


@pytest.mark.parametrize(("after", "stopped"), [(0.0, True), (0.2, True), (2.0, False), (1.7, False)])
def test_the_next_frame_tells_a_camera_that_stopped_from_a_picture_shown_twice(after: float, stopped: bool) -> None:
    change = np.array([5.0 / FOCAL_PX, 0.002])
    shown, move = known(0.9, change), after * change
    later = replace(known(0.0, change), pan_rad=shown.pan_rad + move[0], focal_px=FOCAL_PX * float(np.exp(move[1])))
    (one, _) = duplicate_frames.confirmed([shown, later])
    assert one is not None
    assert one.missed.any() != stopped
    assert duplicate_frames.confirmed([shown, None])[0] is shown


def test_a_frame_that_was_carried_on_can_be_brought_back() -> None:
    shown = known(0.9, np.array([5.0 / FOCAL_PX, -0.002]))
    carried = duplicate_frames.extrapolated(shown)
    back = duplicate_frames.without_extrapolation(carried)
    assert carried.pan_rad == pytest.approx(shown.pan_rad + 5.0 / FOCAL_PX)
    assert (back.pan_rad, back.focal_px) == pytest.approx((shown.pan_rad, shown.focal_px))
    np.testing.assert_allclose(back.covariance, shown.covariance, atol=1e-15)
