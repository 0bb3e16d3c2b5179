"""The parallax assistant: right to its sigma on points of known truth, and on a rendered pan past a post."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import cv2
import mujoco
import numpy as np
import pytest
from rich.console import Console

from experiments import slide as command
from experiments.slide import assist
from pzcap.extras import slide
from pzcap.extras.slide import Slide, Tracks
from pzcap.extras.slide.adjustment import from_centre
from pzcap.geometry import camera as geometry
from pzcap.geometry.camera import View
from pzcap.geometry.lens import NONE, Distortion
from pzcap.geometry.parallax import parallax
from pzcap.types import Array, Camera, Image, PzcapError
from sim.cameras.optics import OpticsConfig, build_rig
from sim.cameras.plate import lens_maps, plate_for, through_lens
from sim.cameras.render import Stage
from tests.scenes import synthetic

WIDTH, HEIGHT = 640, 480
TRUE_VIEW = View(0.0, np.deg2rad(-4.0), np.deg2rad(0.5), 880.0, np.array([322.0, 237.0]), Distortion(-0.05))
ROUGH_VIEW = View(0.0, 0.0, 0.0, 768.0, np.array([319.5, 239.5]), NONE)
PANS = np.deg2rad(np.linspace(-14.0, 14.0, 12))


def pan_past(offset_m: Array, seed: int, noise: float = 0.3, near_m: float = 1.5) -> Tracks:
    """What is seen of a post 1.5 m away and of walls 7 to 20 m away, from a centre beside the axis."""
    rng = np.random.default_rng(seed)
    near = np.column_stack([rng.uniform(near_m, 1.03 * near_m, 90), rng.uniform(-0.25, 0.25, 90),
                            rng.uniform(-0.5, 0.4, 90)])  # fmt: skip
    azimuth, distance = rng.uniform(-0.6, 0.6, 260), rng.uniform(7, 20, 260)
    far = np.column_stack([distance * np.cos(azimuth), distance * np.sin(azimuth),
                           distance * rng.uniform(-0.35, 0.25, 260)])  # fmt: skip
    world = np.concatenate([near, far])
    track, frame, points = [], [], []
    for k, pan in enumerate(PANS):
        head_T_cam = geometry.head_T_cam(pan, TRUE_VIEW.tilt_rad, TRUE_VIEW.roll_rad, np.append(offset_m, 0.0))
        at = Camera(WIDTH, HEIGHT, head_T_cam, 880.0, TRUE_VIEW.principal_px, TRUE_VIEW.distortion.k1)
        seen, depth = geometry.project(at, world)
        inside = (depth > 0) & (seen >= 0).all(axis=1) & (seen <= (WIDTH - 1, HEIGHT - 1)).all(axis=1)
        inside &= rng.random(len(world)) < 0.7
        inside[90:] &= np.abs(np.arctan2(far[:, 1], far[:, 0])) > 0.18  # the post hides what is behind it
        track.append(np.flatnonzero(inside))
        frame.append(np.full(inside.sum(), k))
        points.append(seen[inside])
    tracks, frames, pixels = np.concatenate(track), np.concatenate(frame), np.concatenate(points)
    often = np.bincount(tracks, minlength=len(world)) >= 3
    keep = often[tracks]
    beside = rng.normal(0, noise / 2, (len(world), 2))  # a feature is found beside where it is, in all frames alike
    pixels = pixels + beside[tracks] + rng.normal(0, noise, pixels.shape)
    return Tracks(np.unique(tracks[keep], return_inverse=True)[1], frames[keep], pixels[keep])


def advice(tracks: Tracks, box: tuple[float, float, float, float] | None = None) -> Slide:
    return slide.solve(tracks, PANS - PANS[0], ROUGH_VIEW, WIDTH, 1.522, 12.0, near_box_px=box)


BOX = (165.0, 0.0, 475.0, 480.0)


@pytest.mark.parametrize("offset_m", [(0.005, -0.003), (-0.02, 0.008), (0.03, 0.0)])
def test_perfect_tracks_give_the_truth_but_for_the_depth_of_the_post(offset_m: tuple[float, float]) -> None:
    found = advice(pan_past(np.array(offset_m), 1, noise=1e-3))
    np.testing.assert_allclose(found.slide_m, -np.array(offset_m), atol=0.03 * np.hypot(*offset_m) + 1e-4)
    assert not found.aligned


@pytest.mark.parametrize("box", [None, BOX])
def test_sigmas_are_right(box: tuple[float, float, float, float] | None) -> None:
    """Over 30 draws of offset, points, noise and tape: within three sigmas (with a box), which are right.

    Without a box, offsets too small for the groups to be told apart are refused, and not counted.
    """
    squares, worst = [], 0.0
    rng = np.random.default_rng(0)
    for draw in range(30):
        offset = rng.normal(0, 0.008, 2)
        offset[0] += np.sign(offset[0]) * 0.003
        near_m = 1.522 * (1 + 0.03 * rng.normal())
        tracks = pan_past(offset, draw)
        try:
            found = slide.solve(tracks, PANS - PANS[0], ROUGH_VIEW, WIDTH, near_m, 12.0, near_box_px=box)
        except PzcapError:
            assert box is None
            continue
        error = found.slide_m + offset
        squares.append(error @ np.linalg.solve(found.covariance_m2, error) / 2)
        worst = max(worst, float((np.abs(error) / found.sigma_m).max()))
    assert len(squares) >= 20
    assert 0.6 < np.mean(squares) < 1.6
    assert worst < (4.0 if box is None else 3.0)  # without a box, some features are taken for what they are not


def test_after_sliding_the_parallax_is_gone() -> None:
    """Twice what one pan advises: the second finds nothing left to do."""
    offset = np.array([0.012, -0.006])
    first = advice(pan_past(offset, 3), BOX)
    second = advice(pan_past(offset + first.slide_m, 4), BOX)
    assert np.abs(second.slide_m).max() < 0.0035
    assert np.abs(second.parallax_px[second.near]).mean() < 0.3 * np.abs(first.parallax_px[first.near]).mean()
    assert not first.aligned
    assert second.aligned


def test_where_nothing_moves_against_anything_it_says_so() -> None:
    tracks = pan_past(np.zeros(2), 5)
    with pytest.raises(PzcapError, match="cannot be told apart"):
        advice(tracks)
    assert advice(tracks, BOX).aligned


def test_the_direction_from_beside_the_axis_is_the_parallax_of_the_camera_model() -> None:
    azimuth, slope, nearness = np.array([0.3, -0.2]), np.array([0.1, -0.2]), np.array([0.1, 0.7])
    offset, pan = np.array([0.004, -0.003]), np.array([0.1, 0.1])
    seen, _, _ = from_centre(azimuth, slope, nearness, pan, offset)
    turned = replace(TRUE_VIEW, pan_rad=pan, centre_m=np.append(offset, 0.0))
    moved = parallax(turned, azimuth, slope, nearness)
    np.testing.assert_allclose(seen, np.column_stack([azimuth + moved[0], slope + moved[1]]), atol=1e-5)


def test_derivatives_match_finite_differences() -> None:
    start = np.array([0.3, 0.1, 0.6, 0.1, 0.02, -0.01])  # azimuth, slope, nearness, pan, forward, left

    def at(x: Array) -> Array:
        return from_centre(x[:1], x[1:2], x[2:3], x[3:4], x[4:])[0][0]

    _, by_point, by_motion = from_centre(start[:1], start[1:2], start[2:3], start[3:4], start[4:])
    numeric = np.column_stack([(at(start + step) - at(start - step)) / 2e-6 for step in 1e-6 * np.eye(6)])
    np.testing.assert_allclose(np.hstack([by_point[0], by_motion[0]]), numeric, atol=1e-8)


def test_the_sentence_says_which_way() -> None:
    found = advice(pan_past(np.array([0.012, 0.009]), 6))
    assert re.fullmatch(
        r"slide the camera 1\d\.\d \+- 0\.\d mm back and \d+\.\d \+- \d\.\d mm to the right", found.sentence
    )


# --------------------------------------------------------------------------------------------------------------
# Rendered


def room() -> Stage:
    """A wall 10 m away, and a poster on a stand 1.5 m away."""
    spec = mujoco.MjSpec()
    spec.visual.headlight.ambient = [0.9, 0.9, 0.9]
    spec.visual.headlight.diffuse = [0.0, 0.0, 0.0]
    texture = synthetic.hall(3)
    for name, x, size, part in (
        ("wall", 10.0, (8.0, 4.0), texture[:1500, :3000]),
        ("poster", 1.5, (0.2, 0.7), texture[:1400, 4000:4400]),
    ):
        pixels = np.ascontiguousarray(part.transpose(1, 0, 2)[:, :, ::-1])
        made = spec.add_texture(
            name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, width=part.shape[0], height=part.shape[1], nchannel=3
        )
        made.data = pixels.tobytes()
        material = spec.add_material(name=name)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_PLANE, size=[size[1], size[0], 1.0], pos=[x, 0.0, 1.6], material=name,
            quat=[np.sqrt(0.5), 0.0, -np.sqrt(0.5), 0.0],
        )  # fmt: skip
    return Stage(spec, 1400, 1100, athlete_group=3, object_group=4)


def film(stage: Stage, slid_m: Array, beside_m: float, behind_m: float) -> list[Image]:
    """A pan of 24 degrees; the camera has been slid forward and to the left from where the slide head left it."""
    optics = OpticsConfig(
        axis_beside_m=abs(beside_m + slid_m[1]), axis_behind_m=behind_m + slid_m[0], principal_offset=0.003,
        axis_lean_deg=0.0, tilt_deg=-3.0,
    )  # fmt: skip
    rig = build_rig(0, WIDTH, HEIGHT, optics, np.random.default_rng(5))
    world_T_head = np.eye(4)
    world_T_head[2, 3] = 1.6
    rig = replace(rig, beside_m=-(beside_m + slid_m[1]), world_T_head=world_T_head)
    focal = rig.reference_focal_px
    plate = plate_for(rig, focal)
    maps = [lens_maps(rig, plate, focal, 1.0)]
    rng = np.random.default_rng(1)
    images = []
    for pan in np.deg2rad(np.linspace(-12.0, 12.0, 7)):
        stage.aim(rig.world_T_cam(pan, focal), plate.vertical_view_deg(focal))
        fine = stage.picture(plate.size(2.0), athlete=False)
        seen = cv2.resize(fine, plate.size(1.0), interpolation=cv2.INTER_AREA)
        noisy = through_lens(np.asarray(seen, np.uint8), maps, rig)[:, :, ::-1] + rng.normal(0, 2, (HEIGHT, WIDTH, 3))
        images.append(np.clip(noisy, 0, 255).astype(np.uint8))
    return images


def test_a_rendered_pan_past_a_poster(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Offset found to 3 sigma; slid by the advice, the next pan finds no parallax worth a sentence. By the command."""
    stage = room()
    offset = np.array([0.011, 0.006])  # the centre is before the axis, and to its left
    images = film(stage, np.zeros(2), offset[1], offset[0])
    for number, image in enumerate(images):
        cv2.imwrite(str(tmp_path / f"{number:02d}.png"), image)
    found, picture = assist(tmp_path, 1.5, 10.5, None, None, Console(stderr=True))
    assert picture.exists()
    error = found.slide_m + offset
    print(found.sentence, found.near.sum(), found.far.sum(), found.focal_px, found.residual_px)
    assert (np.abs(error) < 3.0 * found.sigma_m).all()
    assert (found.sigma_m < (0.001, 0.003)).all()
    again = slide.advise(film(stage, found.slide_m, offset[1], offset[0]), 1.5, 10.5, near_box_px=(240, 0, 400, 480))
    print(again.sentence)
    assert (np.abs(again.slide_m) < np.maximum(3.0 * again.sigma_m, 0.0015)).all()
    stage.close()

    monkeypatch.setattr("sys.argv", ["slide", str(tmp_path / "none"), "--near", "1.5", "--far", "10"])
    assert command.main() == 1
    assert capsys.readouterr().err.splitlines()[-1].startswith("error: ")
