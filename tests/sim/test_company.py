"""Other people in the hall and loose clothes: where they are, without a picture."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from pzcap.types import SEGMENTS, Array
from sim import motion
from sim.people import athlete, company
from sim.people.anthropometry import draw_measurements
from sim.people.athlete import CLOTH, AthleteConfig, set_pose
from sim.people.crew import CrewConfig
from sim.people.loose_clothing import Clothes
from sim.scene import describe_scene
from sim.session import ShootConfig, assemble
from tests.scenes.bodies import subject

SHOOT = ShootConfig(motion="pedestrian", motion_frames=60)
END_S = 59 / 30


def places(model: mujoco.MjModel, prefix: str = "") -> tuple[mujoco.MjData, list[int]]:
    return mujoco.MjData(model), [model.body(prefix + name).id for name in SEGMENTS]


@pytest.fixture(scope="module")
def people() -> tuple[dict[str, float], motion.MotionClip]:
    measurements = draw_measurements(np.random.default_rng(11))
    return measurements, motion.make("pedestrian", measurements, np.random.default_rng(12))


def test_a_coach_keeps_beside_the_athlete(people: tuple[dict[str, float], motion.MotionClip]) -> None:
    session = assemble(SHOOT)
    beside = company.coach(session.clip, *people, END_S, 1.2, touches=False)
    for t in np.linspace(0.0, END_S, 12):
        apart = beside.at(t).root_position_m[:2] - session.clip.at(t).root_position_m[:2]
        assert 0.9 < np.linalg.norm(apart) < 1.6


def test_a_spotter_has_both_hands_on_the_athlete_for_a_second(
    people: tuple[dict[str, float], motion.MotionClip],
) -> None:
    session = assemble(SHOOT)
    spotter = company.coach(session.clip, *people, END_S, 1.2, touches=True)
    spec = mujoco.MjSpec()
    athlete.add_athlete(spec, people[0], AthleteConfig(), np.random.default_rng(0))
    model = spec.compile()
    data, bodies = places(model)

    def hands(t: float) -> Array:
        """(2,) how far the palms are from the athlete's hips."""
        set_pose(model, data, spotter.at(t))
        mujoco.mj_kinematics(model, data)
        hands = [bodies[SEGMENTS.index(f"{side}_hand")] for side in ("left", "right")]
        palms = data.xpos[hands] - 0.5 * people[0]["hand"] * data.xmat[hands].reshape(2, 3, 3)[:, :, 2]
        return np.linalg.norm(palms - session.clip.at(t).root_position_m, axis=1)

    for t in np.linspace(0.55, 1.4, 6):
        assert hands(float(t)).max() < 0.30
    assert hands(0.0).min() > 0.6


def test_walkers_pass_before_and_behind_and_are_dressed_alike() -> None:
    shoot = ShootConfig(motion="pedestrian", motion_frames=60, crew=CrewConfig(company="bystanders"))
    session = assemble(shoot)
    first, second = session.company()
    athlete_m = session.clip.at(END_S / 2).root_position_m[:2]
    for k, (walker, before) in enumerate(((first, True), (second, False))):
        towards = session.rigs[k].world_T_head[:2, 3] - athlete_m
        apart = walker.at(END_S / 2).root_position_m[:2] - athlete_m
        assert (apart @ towards > 0) == before
        assert 2.0 < np.linalg.norm(apart) < 6.0
        assert np.linalg.norm(walker.at(0.0).root_position_m - walker.at(END_S).root_position_m) > 1.0
    model = describe_scene(0, shoot.gym, shoot.athlete, session.measurements, [first, second]).compile()
    colours = [
        model.tex_data[model.tex_adr[model.texture(name).id] :][:300]
        for name in ("athlete_thorax_chest", "walker0_athlete_thorax_chest")
    ]
    np.testing.assert_allclose(np.median(colours[0]), np.median(colours[1]), atol=8)


@pytest.mark.parametrize("loose_m", [0.03, 0.05])
def test_cloth_hangs_behind_the_motion_and_no_further_than_it_can(loose_m: float) -> None:
    clip, person = assemble(SHOOT).clip, subject(0)
    spec = mujoco.MjSpec()
    config = AthleteConfig(loose_m=loose_m, skirt=True, ponytail=True)
    athlete.add_athlete(spec, person.measurements_m, config, np.random.default_rng(1))
    model = spec.compile()
    data, bodies = places(model)
    clothes = Clothes(model, clip, loose_m, np.random.default_rng(2))
    again = Clothes(model, clip, loose_m, np.random.default_rng(2))
    shirt = model.body(CLOTH + "thorax").id
    for t in (1.2, 0.7, 1.9):
        set_pose(model, data, clip.at(t))
        clothes.hang(data, t)
        mujoco.mj_kinematics(model, data)
        apart = data.xpos[shirt] - data.xpos[bodies[SEGMENTS.index("thorax")]]
        before, after = (clip.at(t + dt).root_position_m for dt in (-0.1, 0.1))
        assert apart @ (after - before) < 0.0
        assert np.linalg.norm(apart) < 1.4 * loose_m
        hung = data.mocap_pos.copy()
        again.hang(data, t)
        np.testing.assert_array_equal(data.mocap_pos, hung)
    # a garment is as wide as the skin below it and the room for cloth
    chests = [geom for geom in range(model.ngeom) if "thorax_chest" in model.mat(int(model.geom_matid[geom])).name]
    below, over = sorted(model.geom_size[geom][0] for geom in chests)
    assert over - below == pytest.approx(loose_m)


def test_tight_clothes_have_no_piece_and_need_no_word() -> None:
    assert AthleteConfig().garments() == {}
    assert AthleteConfig(loose_m=0.03, skirt=True).garments() == pytest.approx(
        {"shirt": 0.03, "trousers": 0.03, "skirt": 0.05}
    )
    spec = mujoco.MjSpec()
    athlete.add_athlete(spec, subject(0).measurements_m, AthleteConfig(), np.random.default_rng(1))
    model = spec.compile()
    assert model.nmocap == 0
    clothes, data = Clothes(model, assemble(SHOOT).clip, 0.0, np.random.default_rng(2)), mujoco.MjData(model)
    clothes.hang(data, 0.5)
