"""The shader draws what MuJoCo's two passes draw, shadows included, and draws the shadow map anew where one moved."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np
import pytest

from pzcap.types import Image
from sim.cameras.render import Stage
from sim.cameras.shading import casts_one_shadow
from tests.scenes.captures import facing

SIZE = (400, 300)


def scene(**light: object) -> mujoco.MjSpec:
    """A checkered floor, a striped box, a plain ball that can move, and the light of a hall."""
    spec = mujoco.MjSpec()
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.5] * 3, [0, 0, 0]
    spec.visual.headlight.specular = [0, 0, 0]
    spec.stat.extent, spec.stat.center = 4.0, [0, 0, 0.5]
    rng = np.random.default_rng(0)
    for name in ("floor", "box"):
        texture = spec.add_texture(name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, width=16, height=16, nchannel=3)
        texture.data = rng.integers(80, 200, (16, 16, 3), np.uint8).tobytes()
        material = spec.add_material(name=name, specular=0, emission=0.1 if name == "box" else 0.0)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
    spec.add_material(name="plain", specular=0, rgba=[0.8, 0.3, 0.2, 1])
    world = spec.worldbody
    world.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[3, 3, 1], material="floor")
    world.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.3, 0.3, 0.4], pos=[0.8, 0, 0.4], material="box")
    ball = world.add_body(name="ball", pos=[-0.6, 0, 1.0])
    ball.add_freejoint()
    ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.3, 0, 0], material="plain", group=1)
    directional = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    main = {"castshadow": True, "diffuse": [0.4] * 3, "specular": [0, 0, 0], "type": directional, **light}
    world.add_light(name="main", dir=[0.3, 0.2, -1], pos=[0, 0, 4], **main)
    world.add_light(
        name="fill", dir=[0.8, 0.6, 0.0], diffuse=[0.2] * 3, specular=[0, 0, 0], castshadow=False, type=directional
    )
    return spec


@pytest.fixture
def stage() -> Iterator[Stage]:
    stage = Stage(scene(), *SIZE, athlete_group=1, object_group=3)
    look(stage, -3.0)
    yield stage
    stage.close()


def look(stage: Stage, x: float) -> None:
    """Look at the scene from the south."""
    stage.aim(facing(np.array([0.3 * x, -4.0, 2.2]), np.array([0.0, 0.0, 0.6])), 45.0)


def picture(stage: Stage) -> Image:
    return stage.picture(SIZE, athlete=True)


def by_mujoco(stage: Stage) -> Image:
    """The same picture in MuJoCo's own passes."""
    stage.picture(SIZE, athlete=True)
    mujoco.mjr_render(mujoco.MjrRect(0, 0, *SIZE), stage._scene, stage._gpu)
    pixels = np.empty((SIZE[1], SIZE[0], 3), np.uint8)
    mujoco.mjr_readPixels(pixels, None, mujoco.MjrRect(0, 0, *SIZE), stage._gpu)
    return pixels


def test_one_pass_draws_what_mujoco_draws_in_two(stage: Stage) -> None:
    for x in (-3.0, 2.0):
        look(stage, x)
        difference = np.abs(picture(stage).astype(int) - by_mujoco(stage))
        assert difference.mean() < 0.5  # MuJoCo rounds twice
        assert np.mean(difference > 2) < 0.01  # edges of shadows, by a rounding of the light's distance


def test_a_shadow_goes_with_what_casts_it(stage: Stage) -> None:
    before = picture(stage)
    stage.data.qpos[0] += 0.5
    look(stage, -3.0)
    after = picture(stage)
    assert np.mean(np.abs(after.astype(int) - by_mujoco(stage)) > 2) < 0.01
    assert np.mean(np.abs(after.astype(int) - before) > 20) > 0.02


def test_the_shadow_map_is_kept_while_only_the_camera_moves(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = []
    draw = mujoco.mjr_render
    monkeypatch.setattr(mujoco, "mjr_render", lambda *arguments: (drawn.append(1), draw(*arguments)))
    for x in (-3.0, 0.0, 3.0):
        look(stage, x)
        picture(stage)
    assert len(drawn) == 4  # three pictures, one map
    stage.data.qpos[0] += 0.1
    look(stage, 3.0)
    picture(stage)
    assert len(drawn) == 6


@pytest.mark.parametrize(
    "light",
    [{"castshadow": False}, {"specular": [0.3] * 3}, {"type": mujoco.mjtLightType.mjLIGHT_SPOT}],
    ids=["none casts", "one shines", "a spot"],
)
def test_other_lights_are_left_to_mujoco(light: dict[str, object]) -> None:
    assert casts_one_shadow(scene().compile())
    assert not casts_one_shadow(scene(**light).compile())
