"""Pictures on the walls: the right way round, in their proportions, and nothing else changes."""

from __future__ import annotations

from pathlib import Path

import cv2
import mujoco
import numpy as np
import pytest

from pzcap.types import Image, PzcapError
from sim.hall.gym import GymConfig, build_gym
from sim.hall.textures import Canvas
from sim.hall.wallpaper import cover, wall_pictures
from tests.scenes.hall import Hall

RED, GREEN, BLUE, YELLOW = (200, 30, 30), (30, 200, 30), (30, 30, 200), (200, 200, 30)


def quarters(width: int, height: int) -> Image:
    """Red and green above, blue and yellow below; red, green, blue."""
    image = np.empty((height, width, 3), np.uint8)
    image[: height // 2, : width // 2], image[: height // 2, width // 2 :] = RED, GREEN
    image[height // 2 :, : width // 2], image[height // 2 :, width // 2 :] = BLUE, YELLOW
    return image


def save(path: Path, image: Image) -> Path:
    path.parent.mkdir(exist_ok=True)
    cv2.imwrite(str(path), image[..., ::-1])
    return path


def covered(picture: Path, width_m: float = 30.0) -> tuple[Canvas, Canvas]:
    lower, upper = Canvas.blank(width_m, 2.75, 40, (0, 0, 0)), Canvas.blank(width_m, 5.25, 24, (0, 0, 0))
    cover(picture, lower, upper)
    return lower, upper


@pytest.mark.parametrize(("width", "height"), [(300, 80), (3000, 800), (300, 300), (900, 80)])
def test_it_covers_the_wall_whatever_its_size(width: int, height: int, tmp_path: Path) -> None:
    """Its middle lies in the middle of the wall: 4 m above the floor, in the upper part."""
    lower, upper = covered(save(tmp_path / "north.png", quarters(width, height)))
    assert upper.image[0, 0].tolist() == list(RED)
    assert upper.image[0, -1].tolist() == list(GREEN)
    assert upper.image[-1, 0].tolist() == lower.image[0, 0].tolist() == lower.image[-1, 0].tolist() == list(BLUE)
    assert lower.image[-1, -1].tolist() == list(YELLOW)
    left = np.abs(upper.image[:, 100].astype(int) - RED).max(axis=1) < 40
    assert np.flatnonzero(~left)[0] == pytest.approx(24 * 4.0, abs=2)
    above = np.abs(upper.image[10].astype(int) - RED).max(axis=1) < 40
    assert np.flatnonzero(~above)[0] == pytest.approx(24 * 15.0, abs=2)


def test_a_circle_stays_a_circle(tmp_path: Path) -> None:
    image = np.zeros((400, 400, 3), np.uint8)
    cv2.circle(image, (200, 200), 40, (255, 255, 255), cv2.FILLED)
    _, upper = covered(save(tmp_path / "north.png", image), 20.0)
    rows, columns = np.nonzero(upper.image[..., 0] > 127)
    assert np.ptp(columns) / 24 == pytest.approx(80 / 400 * 20, abs=0.15)
    assert (np.ptp(rows) + 1) / 24 == pytest.approx(80 / 400 * 20 / 2 + 1.25, abs=0.15), "the rest is below 2.75 m"


def test_it_is_seen_the_right_way_round_and_nothing_else_changes(tmp_path: Path) -> None:
    save(tmp_path / "walls" / "north.png", quarters(1500, 400))
    pictures = []
    for folder in ("", str(tmp_path / "walls")):
        hall = Hall(GymConfig(texture_px_per_m=50.0, wall_pictures=folder), seed=0)
        try:
            for target in ((0.0, 10.0, 4.0), (0.0, -10.0, 3.0)):
                hall.aim(np.array([0.0, 0.0, 4.0]), np.array(target))
                pictures.append(hall.image()[..., ::-1])
        finally:
            hall.close()
    plain_north, plain_south, north, south = pictures
    np.testing.assert_array_equal(south, plain_south)
    assert (north != plain_north).any()
    for u, v, colour in ((200, 100, RED), (440, 100, GREEN), (200, 300, BLUE), (440, 300, YELLOW)):
        patch = np.median(north[v - 20 : v + 20, u - 20 : u + 20].reshape(-1, 3), axis=0)
        assert (patch > 80).tolist() == [value > 100 for value in colour], (u, v, patch)


def test_bare_walls_are_plastered_and_nothing_else_changes() -> None:
    corners = {}
    for bare in (False, True):
        hall = Hall(GymConfig(texture_px_per_m=50.0, bare_walls=bare), seed=0)
        try:
            hall.aim(np.array([10.5, -8.0, 1.8]), np.array([15.0, -6.0, 1.8]))  # a wall, from near
            wall = hall.image()
            hall.aim(np.array([0.0, 0.0, 4.0]), np.array([1.0, 0.0, 0.0]))  # the floor
            corners[bare] = wall, hall.image()
        finally:
            hall.close()
    (painted, floor), (plastered, same) = corners[False], corners[True]
    np.testing.assert_array_equal(same, floor)
    flat = [np.mean(np.abs(cv2.Laplacian(image, cv2.CV_32F)) < 3.0) for image in (painted, plastered)]
    assert flat[1] > flat[0] + 0.1


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ((), "no picture of a wall is in it; name them south, east, north, west, as PNG or JPEG"),
        (("nort.png",), r"nort\.png: one picture a wall, named as it is: south, east"),
        (("north.jpg", "north.png"), r"north\.png: one picture a wall"),
    ],
)
def test_a_folder_that_is_unclear_is_refused(names: tuple[str, ...], message: str, tmp_path: Path) -> None:
    for name in names:
        (tmp_path / name).touch()
    (tmp_path / "notes.txt").touch()
    with pytest.raises(PzcapError, match=message):
        wall_pictures(str(tmp_path))


def test_what_is_no_picture_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PzcapError, match="cannot read the pictures of the walls: No such file"):
        wall_pictures(str(tmp_path / "none"))
    (tmp_path / "east.png").write_bytes(b"no picture")
    with pytest.raises(PzcapError, match=r"east\.png: the image cannot be decoded"):
        build_gym(
            mujoco.MjSpec(), GymConfig(texture_px_per_m=50.0, wall_pictures=str(tmp_path)), np.random.default_rng(0)
        )
