"""Each effect of the named trials does what it says, in pixels and in the truth, and leaves all else as it was."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from experiments.footage import SMALL, shot
from pzcap.io.capture import frame_sets, read_capture
from pzcap.io.video import VideoReader
from pzcap.types import Image, Mask, PzcapError
from sim import capture_cache
from sim.cameras.operator import OperatorConfig, follow, swinging, through, zooming
from sim.cameras.optics import OpticsConfig, build_rig
from sim.cameras.sensor import SensorConfig
from sim.capture_cache import shoot_cached
from sim.hall.furniture import REARRANGED
from sim.hall.scenery import WALLS
from sim.people.crew import CrewConfig
from sim.session import ShootConfig
from sim.team import Progress
from sim.truth import Truth, load
from tests.scenes.captures import project

PLAIN = replace(
    SMALL, motion="floor_exercise", motion_frames=3, sweep_deg=10.0, zoom_frames=2,
    gym=replace(SMALL.gym, texture_px_per_m=50.0),
    sensor=SensorConfig(sub_exposures=1, crf_motion=0, crf_still=0, largest_roll=0),
)  # fmt: skip
"""Three frames of four cameras. Without losses of compression, so that what differs between two shoots is what was
there to be seen."""


Shots = Callable[[ShootConfig], Path]


@pytest.fixture(scope="module")
def shots(tmp_path_factory: pytest.TempPathFactory) -> Shots:
    """The folder of a shoot: filmed when it is first asked for, or developed from light that is there."""
    root = tmp_path_factory.mktemp("trials")
    return lambda config: shot(config, root)


@pytest.fixture(scope="module")
def plain(shots: Shots) -> Path:
    return shots(PLAIN)


def footage(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted((folder / "capture").rglob("*.*"))}


def changed(one: Path, other: Path) -> set[str]:
    """Names of the files, without the cameras' folders, that are not the same in two captures."""
    first, second = footage(one), footage(other)
    assert first.keys() == second.keys()
    return {Path(name).name for name in first if first[name] != second[name]}


def frames(folder: Path) -> list[list[Image]]:
    """[camera][frame] of the motion."""
    sets = [frame.images for frame in frame_sets(read_capture(folder / "capture"))]
    return [[image for image in camera if image is not None] for camera in zip(*sets, strict=True)]


# ------------------------------------------------------------------------------------------ off by default


def test_the_names_of_default_captures_have_not_changed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def pretend(_: ShootConfig, __: Path, folder: Path) -> Iterator[Progress]:
        (folder / "capture").mkdir()
        yield Progress("sweep", 1, 1)

    monkeypatch.setattr(capture_cache, "film", lambda *_: iter(()))
    monkeypatch.setattr(capture_cache, "develop", pretend)
    list(shoot_cached(ShootConfig(), tmp_path))
    name = "floor_exercise-0-aade01ba6104"
    assert {path.name for path in tmp_path.iterdir()} == {name, f"light-{name}"}


# ------------------------------------------------------------------------------------------ the hall


def test_lights_on_brightens_what_is_recorded_after_the_sweep(shots: Shots, plain: Path) -> None:
    bright = shots(replace(PLAIN, gym=replace(PLAIN.gym, lights_on=1.3)))
    assert changed(plain, bright) == {"motion.mp4"}
    for before, after in zip(frames(plain), frames(bright), strict=True):
        for dark, light in zip(before, after, strict=True):
            clear = (dark > 30) & (dark < 170)  # neither lost in the noise nor burnt out at 1.3
            assert light[clear].mean() / dark[clear].mean() == pytest.approx(1.3, abs=0.01)
            assert (light[dark > 210] > 245).mean() > 0.9


PIECES = {  # where the middle of each piece stood, and its half sides along x, y, z
    "vault_south": (WALLS["south"].at(14.3, 1.0, 0.61), (0.75, 0.4, 0.61)),
    "vault_north": (WALLS["north"].at(24.6, 0.9, 0.61), (0.75, 0.4, 0.61)),
    "mats_west": (WALLS["west"].at(8.4, 1.1, 0.53), (0.48, 1.0, 0.53)),
}


def outlines(truth: Truth, camera: int, frame: int) -> Mask:
    """(H, W) where the pieces that move stood and stand, with their shadows beside them and some pixels to spare."""
    found = np.zeros((truth.height, truth.width), np.uint8)
    signs = np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T
    for name, (centre, half) in PIECES.items():
        for place in (centre, centre + np.array(REARRANGED[name])):
            corners = place + signs * (
                np.array(half) + np.array([0.4, 0.3, 0.0])
            )  # light comes from above, at 16 degrees
            pixels = project(truth.camera(camera, frame), corners)
            if np.isfinite(pixels).all():
                cv2.fillConvexPoly(found, cv2.convexHull(np.rint(pixels).astype(np.int32)), 1)
    return np.asarray(cv2.dilate(found, np.ones((9, 9), np.uint8)) > 0)


def test_what_was_moved_is_all_that_differs(shots: Shots, plain: Path) -> None:
    moved = shots(replace(PLAIN, gym=replace(PLAIN.gym, rearranged=True)))
    assert PIECES.keys() == REARRANGED.keys()
    assert changed(plain, moved) == {"motion.mp4"}
    truth, shares = load(moved / "truth"), []
    for c, (before, after) in enumerate(zip(frames(plain), frames(moved), strict=True)):
        for f, (old, new) in enumerate(zip(before, after, strict=True)):
            differs = np.abs(old.astype(int) - new).max(axis=2) > 25
            allowed = outlines(truth, c, f)
            assert (differs & ~allowed).mean() < 1e-4
            shares.append((c, differs.mean()))
    seen = {c for c, share in shares if share > 0.01}
    assert len(seen) >= 2


def test_the_crew_walks_through_the_sweep_alone(shots: Shots, plain: Path) -> None:
    walked = shots(replace(PLAIN, crew=CrewConfig(walks_in_sweep=True)))
    assert changed(plain, walked) == {"sweep.mp4"}
    cameras, middles = 0, []
    for c in "1234":
        videos = [VideoReader(folder / f"capture/camera{c}/sweep.mp4").read() for folder in (plain, walked)]
        tall = []
        for (_, empty), (_, crossed) in zip(*videos, strict=True):
            differs = (np.abs(empty.astype(int) - crossed).max(axis=2) > 30).astype(np.uint8)
            _, _, stats, centroids = cv2.connectedComponentsWithStats(cv2.dilate(differs, np.ones((3, 3), np.uint8)))
            body = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA])) if len(stats) > 1 else 0
            if body and stats[body, cv2.CC_STAT_HEIGHT] > 1.2 * stats[body, cv2.CC_STAT_WIDTH]:
                tall.append(stats[body, cv2.CC_STAT_HEIGHT])
                middles.append((c, centroids[body]))
        cameras += len(tall) >= 3
        assert all(25 < height < 120 for height in tall)  # 1.7 m at 5 to 20 m
    assert cameras >= 2
    for c in {name for name, _ in middles}:
        track = np.array([at for name, at in middles if name == c])
        assert len(track) < 3 or np.ptp(track[:, 0]) > 3  # and does not stand still


# ------------------------------------------------------------------------------------------ the operators


def test_a_fast_pan_reaches_its_speed_and_smears_the_picture(shots: Shots, plain: Path) -> None:
    swing = OperatorConfig(swing_deg_s=60.0, swing_hz=2.0)
    still = through(np.linspace(0, 4, 961), np.zeros(961), np.full(961, 880.0))
    trajectory = swinging(still, swing, np.random.default_rng(0))
    fine = np.array([trajectory.at(t).pan_rad for t in np.arange(0, 4, 0.001)])
    assert np.rad2deg(np.abs(np.diff(fine)).max() / 0.001) == pytest.approx(60.0, rel=0.01)
    assert np.rad2deg(np.abs(fine).max()) == pytest.approx(60 / (2 * np.pi * 2), rel=0.01)
    open_shutter = replace(PLAIN, operator=swing, sensor=replace(PLAIN.sensor, sub_exposures=6), motion_frames=6)
    blurred = shots(open_shutter)
    truth = load(blurred / "truth")
    speed = np.rad2deg(np.abs(np.diff(truth.pan_rad, axis=1))) * PLAIN.frame_rate
    assert (speed.max(axis=1) > 40).all()  # a third of a period, and the athlete's own speed on top
    assert speed.max() < 90
    assert np.mean([[truth.mask(c, f).any() for f in range(6)] for c in range(4)]) == 1.0
    # Along the pan the picture loses its edges, across it it keeps them; more so, the faster.
    lost, fast = [], []
    for c, images in enumerate(frames(blurred)):
        for f, image in enumerate(images[1:-1], 1):
            smooth = cv2.GaussianBlur(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(np.float32), (0, 0), 0.8)
            along, across = (np.mean(np.square(cv2.Sobel(smooth, cv2.CV_32F, *d))) for d in ((1, 0), (0, 1)))
            lost.append(along / across)
            fast.append(abs(truth.pan_rad[c, f + 1] - truth.pan_rad[c, f - 1]))
    order = np.argsort(fast)
    third = len(order) // 3
    assert np.mean(np.array(lost)[order[-third:]]) < 0.9 * np.mean(np.array(lost)[order[:third]])
    assert not changed(plain, blurred) & {"reference.png", "sweep.mp4", "zoom.mp4"}


def test_close_up_covers_more_than_half_the_view(shots: Shots) -> None:
    """The experiment's own optics and operator, two frames a second."""
    config = replace(
        PLAIN, motion="approach", motion_frames=0, frame_rate=2, sweep_deg=4.0, zoom_frames=0,
        optics=OpticsConfig(zoom_max=3.6, tilt_deg=-9.0), operator=OperatorConfig(body_height=3.6, whole_body=False),
    )  # fmt: skip
    truth = load(shots(config) / "truth")
    share = np.array([[truth.mask(c, f).mean() for f in range(len(truth.timecodes))] for c in range(4)])
    assert (share[2] > 0.5).sum() >= 4  # of eleven
    assert share[2].max() > 0.6
    assert (share > 0.003).all()  # and nobody has lost sight of the athlete


def test_operators_tilt_after_the_body(shots: Shots, plain: Path) -> None:
    tilted = shots(replace(PLAIN, operator=OperatorConfig(tilts=True)))
    assert changed(plain, tilted) == {"motion.mp4"}
    truth, locked = load(tilted / "truth"), load(plain / "truth")
    assert np.ptp(locked.tilt_rad, axis=1).max() == 0.0
    assert np.ptp(truth.tilt_rad, axis=1).min() > 1e-5
    np.testing.assert_array_equal(truth.pan_rad, locked.pan_rad)
    off = []
    for known in (truth, locked):
        rows = [[np.flatnonzero(known.mask(c, f).any(axis=1)) for f in range(3)] for c in range(4)]
        off.append(np.mean([[abs((r[0] + r[-1]) / 2 - 119.5) for r in row] for row in rows]))
    assert off[0] < 0.6 * off[1]
    for c in range(4):  # the truth's tilt is what the pixels show
        on = [truth.mask(c, 1)[v, u] for u, v in np.rint(project(truth.camera(c, 1), truth.joints_m[1])).astype(int)]
        assert np.mean(on) > 0.9


def test_the_zoom_swings_through_its_range_and_nothing_else_does() -> None:
    config = OperatorConfig(zoom_swing_s=2.0)
    rig = build_rig(0, 320, 240, OpticsConfig(zoom_max=4.0), np.random.default_rng(0))
    times_s = np.arange(60) / 30
    body_m = np.tile([[0.0, 0.0, 0.0], [0.0, 0.0, 1.7]], (60, 1, 1))
    plain = follow(rig, times_s, body_m, config, np.random.default_rng(1))
    swung = zooming(plain, rig, config, np.random.default_rng(2))
    zoom = np.array([swung.at(t).focal_px for t in times_s]) / rig.reference_focal_px
    assert zoom.min() == pytest.approx(0.7, rel=0.01)
    assert zoom.max() == pytest.approx(4.0, rel=0.01)
    assert np.abs(np.diff(np.log(zoom))).max() < 0.12  # a frame
    assert [swung.at(t).pan_rad for t in times_s] == [plain.at(t).pan_rad for t in times_s]


# ------------------------------------------------------------------------------------------ what is not brought


def test_a_capture_without_a_zoom_run(shots: Shots, plain: Path) -> None:
    """And what an effect is like does not matter while it is off."""
    off = OperatorConfig(swing_deg_s=0.0, swing_hz=5.0, zoom_swing_s=0.0, tilts=False)
    hurried = shots(replace(PLAIN, zoom_frames=0, operator=off))
    capture = read_capture(hurried / "capture")
    assert all(camera.zoom is None for camera in capture.cameras)
    assert not list(hurried.rglob("zoom.mp4"))
    before, after = footage(plain), footage(hurried)
    same = {name for name in before if name.endswith((".mp4", ".png")) and "zoom" not in name}
    assert all(after[name] == before[name] for name in same)
    truth = load(hurried / "truth")
    assert truth.zoom_focal_px.shape == (4, 0)
    assert truth.zoom_pan_rad.shape == (4,)


@pytest.mark.parametrize("count", [-1, 1])
def test_a_zoom_run_of_one_frame_is_refused(count: int) -> None:
    with pytest.raises(PzcapError, match="zoom_frames"):
        ShootConfig(zoom_frames=count)
