"""An arm before the trunk: told from it by its colours, and drawn to the edge of those."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pzcap.body import kinematics
from pzcap.body import skeleton as bodies
from pzcap.body.kinematics import forward, place
from pzcap.body.skeleton import Body
from pzcap.tracking import visibility
from pzcap.tracking.limbs import support
from pzcap.tracking.observation import ViewCrop, place_view, prepare, project
from pzcap.tracking.pose_objective import PoseObjective
from pzcap.tracking.settings import Terms
from pzcap.tracking.skin_colour_model import UNKNOWN, SkinColourModel
from pzcap.types import DOF, SEGMENTS, Camera, Image, Mask, Pose, Subject
from tests.scenes import tracked
from tests.scenes.body_scene import HEIGHT, WIDTH, Clip

pytestmark = pytest.mark.xdist_group("tracked")  # the clip is rendered once
LOWER_ARMS = np.isin(SEGMENTS, ["left_forearm", "right_forearm", "left_hand", "right_hand"])
ELBOW = np.flatnonzero(SEGMENTS.index("left_forearm") == bodies.DOF_SEGMENT)[0]
CONTOUR = Terms(0, 10.0, 3.0, 12.0, 1.0, 0.0, 0.15)


@cache
def clip() -> Clip:
    """The first six frames."""
    whole = tracked.clip()
    return replace(whole, shots=whole.shots[:6], poses=whole.poses[:6], joints_m=whole.joints_m[:6])


@cache
def body() -> Body:
    return bodies.build(Subject(clip().measurements_m, 0.001))


def seen(pose: Pose, camera: Camera) -> tuple[Mask, Mask]:
    """Where the body is seen, and where its lower arms are: (HEIGHT, WIDTH) each."""
    surface = body().surface
    points, normals = place(body(), forward(body(), pose))
    skin = project(points, normals, camera)
    depths = []
    for part in (np.ones(len(SEGMENTS), bool), LOWER_ARMS):
        z_buffer = visibility.empty_z_buffer((0, 0, WIDTH - 1, HEIGHT - 1), 1.0)
        faces = surface.faces[part[surface.segment[surface.faces[:, 0]]]]
        visibility.rasterise(skin.pixels, skin.depth, faces, visibility.GROUP[surface.segment], z_buffer)
        depths.append(z_buffer.depth)
    return np.isfinite(depths[0]), np.isfinite(depths[1]) & (depths[1] <= depths[0] + 1e-4)


def learned(frame: int) -> SkinColourModel:
    complexion = SkinColourModel()
    pose = clip().poses[frame]
    points, normals = place(body(), forward(body(), pose))
    for shot in clip().shots[frame]:
        placed = place_view(body(), points, project(points, normals, shot.camera), shot.camera)
        complexion.learn(shot.image, body().surface.segment, placed.skin.pixels, placed.facing)
    return complexion


def test_nothing_is_said_of_colours_before_any_were_seen() -> None:
    shot = clip().shots[0][0]
    even = SkinColourModel().arms(shot.image, np.full((HEIGHT, WIDTH), 255, np.uint8))
    assert (even == UNKNOWN).all()


def test_lower_arms_are_known_by_their_colours_in_later_frames() -> None:
    complexion, last = learned(0), len(clip().poses) - 1
    inside, beside = [], []
    for shot in clip().shots[last]:
        whole, arms = seen(clip().poses[last], shot.camera)
        likely = complexion.arms(shot.image, (255 * whole).astype(np.uint8))
        inside.append(likely[arms & shot.mask])
        beside.append(likely[whole & ~arms & shot.mask])
        assert likely[~whole].mean() < 1.0
    assert np.median(np.concatenate(inside)) > 150
    assert np.median(np.concatenate(beside)) < 60


def test_clothes_of_the_arms_colour_leave_all_undecided() -> None:
    complexion = SkinColourModel()
    cloth = np.full((40, 40, 3), (90, 120, 160), np.uint8)
    segment = np.repeat(np.arange(len(SEGMENTS)), 20)
    pixels = np.random.default_rng(0).uniform(1.0, 38.0, (len(segment), 2))
    complexion.learn(cloth, segment, pixels, np.ones(len(segment), np.float32))
    assert np.abs(complexion.arms(cloth, np.full((40, 40), 255, np.uint8)).astype(int) - UNKNOWN).max() <= 1


def before_the_trunk() -> Pose:
    """Upright, the left forearm held across the belly, a hand's breadth before it."""
    pose = clip().poses[0]
    rotations = np.tile([1.0, 0.0, 0.0, 0.0], (len(SEGMENTS), 1))
    rotations[0] = pose.rotations[0]
    rotations[SEGMENTS.index("left_upper_arm")] = Rotation.from_rotvec([0.0, -0.5, -1.2]).as_quat(scalar_first=True)
    rotations[SEGMENTS.index("left_forearm")] = Rotation.from_rotvec([0.0, -1.3, 0.0]).as_quat(scalar_first=True)
    return Pose(pose.root_position_m, rotations)


def near(camera: Camera, pose: Pose) -> Camera:
    """A longer lens, the body in its middle."""
    seen = camera.world_T_cam[:3, :3].T @ (pose.root_position_m - camera.world_T_cam[:3, 3])
    focal_px = 2.2 * camera.focal_px
    principal_px = np.array([WIDTH, HEIGHT]) / 2 - focal_px * seen[:2] / seen[2]
    return replace(camera, focal_px=focal_px, principal_px=principal_px, k1=0.0)


def views(pose: Pose, *, told: bool) -> list[ViewCrop | None]:
    """Silhouettes of the whole body and, if they are ``told``, of its lower arms; nothing else is to be seen."""
    found: list[ViewCrop | None] = []
    grey, size = np.full((HEIGHT, WIDTH, 3), 128, np.uint8), (WIDTH // 4, HEIGHT // 4)
    for shot in clip().shots[0]:
        camera = near(shot.camera, pose)
        whole, arms = (255 * mask.astype(np.uint8) for mask in seen(pose, camera))
        known: Image = arms if told else np.full(whole.shape, UNKNOWN)
        belief = cv2.resize(whole / np.float32(127.5) - np.float32(1.0), size, interpolation=cv2.INTER_AREA)
        found.append(prepare(grey, whole, known, np.asarray(belief, np.float32), camera, (0, 0)))
    return found


@pytest.mark.parametrize("off_rad", [-0.06, 0.06])
def test_an_arm_before_the_trunk_is_drawn_to_the_edge_of_its_colours(off_rad: float) -> None:
    pose, turned = before_the_trunk(), np.zeros(DOF)
    turned[ELBOW] = off_rad
    moved = kinematics.retract(pose, turned)
    slopes, information = [], []
    for told in (True, False):
        evidence = PoseObjective(body(), views(pose, told=told))
        normal = evidence.normal(*evidence.place(moved), [None] * 4, CONTOUR)
        slopes.append(normal.gradient[ELBOW])
        information.append(normal.hessian[ELBOW, ELBOW])
    step = slopes[0] / information[0]
    assert step == pytest.approx(-off_rad, rel=0.4)
    assert information[0] > 1.25 * information[1]


@pytest.mark.parametrize("off_rad", [-0.9, 0.9])
def test_an_arm_that_was_lost_before_the_trunk_is_worth_more_where_it_is(off_rad: float) -> None:
    pose, turned = before_the_trunk(), np.zeros(DOF)
    turned[ELBOW] = off_rad
    wrong = kinematics.retract(pose, turned)
    gain_m2 = []
    for told in (True, False):
        evidence = PoseObjective(body(), views(pose, told=told))
        placed = evidence.visibility(evidence.posed(wrong))
        here, there = (support(evidence, each, placed)[0] for each in (pose, wrong))
        gain_m2.append((here - there) @ [1.0, -1.0])
    assert gain_m2[0] > gain_m2[1] + 0.004
