"""Shoots of a user's own: motion from a BVH file, hands from a table, pictures on the walls."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from experiments.config import CONVERTER, default_tree
from experiments.studies import jobs
from pzcap.types import PzcapError
from sim import capture_cache, motion
from sim.cameras.operator import OperatorConfig
from sim.capture_cache import VERSION, shoot_cached
from sim.people.anthropometry import draw_measurements
from sim.session import ShootConfig
from sim.shoot import shoot
from sim.team import Progress
from sim.truth import Truth, load
from tests.scenes.bvh_files import Style, t_pose, write_bvh
from tests.scenes.captures import TINY

PlaceOf = Callable[[ShootConfig], str]


@pytest.fixture
def bvh(tmp_path: Path) -> Path:
    """The pedestrian, in somebody else's hands."""
    rng = np.random.default_rng(3)
    measurements = draw_measurements(rng)
    clip = motion.make("pedestrian", measurements, rng)
    return write_bvh(tmp_path / "a walk.bvh", clip, measurements, Style(rest=t_pose(), unit=100.0))


def filmed(config: ShootConfig, folder: Path) -> Truth:
    list(shoot(config, folder))
    return load(folder / "truth")


@pytest.fixture
def table(tmp_path: Path) -> Path:
    """What four cameras do in three frames."""
    path = tmp_path / "hands.csv"
    rows = [f"{c},{f},{c + f / 4},{120 + 40 * c + 7 * f},{f / 8 - c / 4}" for c in (1, 2, 3, 4) for f in (0, 1, 2)]
    path.write_text("\n".join(["camera,frame,pan_deg,focal_px,tilt_deg", *rows]))
    return path


@pytest.fixture
def place_of(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> PlaceOf:
    """The folder in which a config's capture is kept; nothing is filmed."""

    def pretend(_: ShootConfig, __: Path, folder: Path) -> Iterator[Progress]:
        (folder / "capture").mkdir()
        yield Progress("sweep", 1, 1)

    def find(config: ShootConfig) -> str:
        run = shoot_cached(config, tmp_path / "captures")
        while True:
            try:
                next(run)
            except StopIteration as end:
                return Path(end.value).name

    monkeypatch.setattr(capture_cache, "film", lambda *_: iter(()))
    monkeypatch.setattr(capture_cache, "develop", pretend)
    return find


def test_captures_with_no_file_are_kept_where_they_were(place_of: PlaceOf) -> None:
    """What was shot before there were such files is not shot again."""
    for config, departures in (
        (ShootConfig(), {}),
        (replace(ShootConfig(), motion="pedestrian", seed=2), {"motion": "pedestrian", "seed": 2}),
    ):
        key = hashlib.sha256(json.dumps([VERSION, departures], sort_keys=True).encode()).hexdigest()[:12]
        assert place_of(config) == f"{config.motion}-{config.seed}-{key}"


def test_a_motion_from_a_file_is_filmed(bvh: Path, tmp_path: Path) -> None:
    truth = filmed(replace(TINY, motion=str(bvh)), tmp_path / "shoot")
    assert json.loads((tmp_path / "shoot" / "capture" / "capture.json").read_text())["name"] == "a walk, seed 0"
    clip = motion.make(str(bvh), truth.measurements_m, np.random.default_rng(0))
    np.testing.assert_allclose(truth.root_position_m[1], clip.at(1 / 30).root_position_m, atol=1e-12)
    assert truth.mask_bits.any(axis=2).all(), "the athlete is in every picture"


def test_another_content_is_another_capture(bvh: Path, place_of: PlaceOf) -> None:
    config = replace(TINY, motion=str(bvh))
    first = place_of(config)
    assert first.startswith("a walk-0-")
    assert place_of(config) == first
    bvh.write_text(bvh.read_text() + "\n")
    assert place_of(config) != first
    bvh.unlink()
    with pytest.raises(PzcapError, match=r"a walk\.bvh: cannot be read: No such file"):
        place_of(config)


def test_cameras_do_what_the_table_says(table: Path, tmp_path: Path) -> None:
    operator = OperatorConfig(trajectories=str(table))
    truth = filmed(replace(TINY, motion_frames=3, operator=operator), tmp_path / "shoot")
    cameras, frames = np.mgrid[1:5, 0:3]
    np.testing.assert_allclose(np.rad2deg(truth.pan_rad), cameras + frames / 4, atol=1e-9)
    np.testing.assert_allclose(truth.focal_px, 120 + 40 * cameras + 7 * frames, rtol=1e-9)
    reference = truth.reference_world_T_cam[:, None, :3, 2]  # where the locked camera looks
    locked_deg = np.rad2deg(truth.tilt_rad) - (frames / 8 - cameras / 4)
    np.testing.assert_allclose(locked_deg, np.repeat(locked_deg[:, :1], 3, axis=1), atol=1e-9)
    risen_deg = np.rad2deg(np.arcsin(truth.world_T_cam[..., :3, 2][..., 2]) - np.arcsin(reference[..., 2]))
    np.testing.assert_allclose(risen_deg, frames / 8 - cameras / 4, atol=0.05)  # the axis leans a little


def test_another_table_is_another_capture(table: Path, place_of: PlaceOf) -> None:
    config = replace(TINY, operator=OperatorConfig(trajectories=str(table)))
    tree = default_tree() | {"shoot": CONVERTER.unstructure(config)}
    first, job = place_of(config), jobs.key(tree)
    assert jobs.key(tree) == job
    table.write_text(table.read_text().replace("1,0,1.0", "1,0,1.1"))
    assert place_of(config) != first
    assert jobs.key(tree) != job, "a finished job of a sweep is not that of another table"


def test_a_table_that_ends_too_early_is_refused_before_anything_is_filmed(table: Path, tmp_path: Path) -> None:
    steps = shoot(replace(TINY, motion_frames=5, operator=OperatorConfig(trajectories=str(table))), tmp_path / "shoot")
    assert next(steps).stage == "build"
    with pytest.raises(PzcapError, match=r"camera 1 has 0\.000 to 0\.067 s; it films"):
        next(steps)


def test_another_picture_or_the_same_on_another_wall_is_another_capture(place_of: PlaceOf, tmp_path: Path) -> None:
    walls = tmp_path / "walls"
    walls.mkdir()
    (walls / "north.png").write_bytes(b"a picture")
    config = replace(TINY, gym=replace(TINY.gym, wall_pictures=str(walls)))
    first = place_of(config)
    (walls / "north.png").rename(walls / "south.png")
    second = place_of(config)
    (walls / "south.png").write_bytes(b"another picture")
    assert len({first, second, place_of(config)}) == 3
