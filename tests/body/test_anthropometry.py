"""Measurements from a few: the regression against people drawn from other tables, and laws of a Gaussian."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pzcap.body import skeleton
from pzcap.body.anthropometry import _correlation, contradictions, measured
from pzcap.body.shape_basis import basis
from pzcap.types import MEASUREMENTS, Array, Subject
from sim.people.anthropometry import draw_measurements
from sim.people.crew import CrewConfig, measure

COLUMN = ("head", "trunk", "thigh", "shank", "ankle_height")


def test_correlations_are_those_of_something() -> None:
    assert np.linalg.eigvalsh(_correlation()).min() > 0.05


def _errors(config: CrewConfig, people: int = 60) -> tuple[Array, Array]:
    """Errors (N, 26) of the measurements of people measured so, and sigmas."""
    rng, errors, sigmas = np.random.default_rng(2), [], []
    for _ in range(people):
        true = draw_measurements(rng)
        found = measured(measure(true, config, rng, {}))
        errors.append(found.values_m - [true[name] for name in MEASUREMENTS])
        sigmas.append(np.sqrt(np.diag(found.covariance_m2)))
    return np.array(errors), np.array(sigmas)


@pytest.mark.parametrize(
    ("config", "most_m"),
    [
        (CrewConfig(), 0.0048),  # better than the tape's 5 mm: lengths add up
        (CrewConfig(tape_guess=0.04), 0.018),
        (CrewConfig(tape="stature"), 0.030),
        (CrewConfig(tape="none"), 0.035),
    ],
)
def test_sigma_says_how_well_a_person_is_known(config: CrewConfig, most_m: float) -> None:
    """The people come from other tables than the regression's, so that theirs are larger than a sample's own."""
    errors, sigmas = _errors(config)
    assert np.sqrt(np.mean(errors**2)) < most_m
    assert 0.4 < np.mean((errors / sigmas) ** 2) < 1.25
    assert np.mean(np.abs(errors) > 3 * sigmas) < 0.01


@pytest.mark.parametrize(
    ("slips", "kg"),
    [
        ({"forearm": 0.10}, None),
        ({"shank": -0.18, "girth_chest": -0.5}, None),
        ({"stature": 0.30}, None),
        ({"girth_waist": -0.6}, 20.0),
    ],
)
def test_a_slip_of_the_pen_is_named_and_does_little_harm(slips: dict[str, float], kg: float | None) -> None:
    rng = np.random.default_rng(0)
    true = draw_measurements(rng)
    right = measure(true, CrewConfig(), rng, {})
    wrong = replace(right, measurements_m={k: v + slips.get(k, 0.0) for k, v in right.measurements_m.items()})
    named = contradictions(replace(wrong, mass_kg=kg))
    assert {one.name for one in named} == {*slips} | ({"mass_kg"} if kg else set())
    found = measured(wrong)
    for name in slips:
        (one,) = (one for one in named if one.name == name)
        assert one.expected == pytest.approx(true[name], abs=3.0 * one.sigma)
        assert found.value(name) == pytest.approx(true[name], abs=3.0 * found.sigma(name))
        assert found.sigma(name) > 2.0 * right.sigma_m if name.startswith("girth") else found.sigma(name) > 0.006
    rest = [name for name in MEASUREMENTS if name not in slips]
    assert max(abs(found.value(name) - true[name]) for name in rest) < 0.02


@pytest.mark.parametrize("guess", [0.0, 0.04])
def test_who_is_measured_right_contradicts_nothing(guess: float) -> None:
    for seed in range(100):
        rng = np.random.default_rng(seed)
        assert contradictions(measure(draw_measurements(rng), CrewConfig(tape_guess=guess), rng, {})) == []
    for child in (
        Subject({"stature": 1.15}, 0.005, mass_kg=20.0),
        Subject({"stature": 2.1}, 0.005),
        Subject({}, 0.005),
    ):
        assert contradictions(child) == []


def test_what_was_measured_stays_and_helps_what_was_not() -> None:
    true = draw_measurements(np.random.default_rng(5))
    tall, short = (measured(Subject({"stature": s}, 0.005)) for s in (1.9, 1.6))
    assert all(tall.value(name) > short.value(name) for name in ("thigh", "foot", "girth_wrist"))
    stature = Subject({"stature": true["stature"]}, 0.005)
    legs = Subject({name: true[name] for name in ("stature", "thigh", "shank")}, 0.002)
    assert measured(legs).value("thigh") == pytest.approx(true["thigh"], abs=0.002)
    assert measured(legs).sigma("trunk") < 0.8 * measured(stature).sigma("trunk")
    assert sum(measured(stature).value(name) for name in COLUMN) == pytest.approx(true["stature"], abs=1e-3)


def test_mass_tells_of_girths_and_sex_of_hips() -> None:
    light, heavy = (measured(Subject({"stature": 1.7}, 0.005, mass_kg=kg)) for kg in (55.0, 85.0))
    assert heavy.value("girth_waist") > light.value("girth_waist") + 0.15
    assert heavy.sigma("girth_waist") < 0.7 * measured(Subject({"stature": 1.7}, 0.005)).sigma("girth_waist")
    woman, man = (measured(Subject({"stature": 1.7}, 0.005, mass_kg=65.0, sex=sex)) for sex in ("female", "male"))
    assert woman.value("girth_hips") > man.value("girth_hips") + 0.05
    assert woman.value("shoulder_width") < man.value("shoulder_width")


def test_a_measurement_that_is_wrong_for_itself_is_believed_as_little_as_it_says() -> None:
    true = draw_measurements(np.random.default_rng(6))
    wrong = true | {"thigh": true["thigh"] + 0.06}
    sure, unsure = (measured(Subject(wrong, 0.005, sigmas)) for sigmas in ({}, {"thigh": 0.05}))
    assert abs(unsure.value("thigh") - true["thigh"]) < 0.01 < abs(sure.value("thigh") - true["thigh"])


def test_corrections_are_as_free_as_the_measurements_are_open() -> None:
    true = draw_measurements(np.random.default_rng(7))
    bodies = [
        skeleton.build(Subject(true, 0.005, {name: share * value for name, value in true.items()}))
        for share in (0.001, 0.05)
    ]
    # skins that are as thick: how far they depart from ellipses is a share of that
    sure, guess = (basis(replace(body, surface=bodies[0].surface)) for body in bodies)
    assert np.all(guess.sigma_m >= 0.999 * sure.sigma_m)
    assert np.all(guess.sigma_m[:8] > 5 * sure.sigma_m[:8])
    # a taller head, a longer hand, a longer foot: the last three
    assert np.all(guess.sigma_m[-3:] > sure.sigma_m[-3:])
    # and the two thighs are thicker where the girths of thigh and knee are open
    correlation = guess.covariance_m2 / np.outer(guess.sigma_m, guess.sigma_m)
    assert np.abs(correlation - np.eye(len(correlation))).max() > 0.2


def test_a_thicker_girth_by_the_corrections_is_that_of_the_mesh() -> None:
    true = draw_measurements(np.random.default_rng(8))
    body, change = skeleton.build(Subject(true, 1e-5)), None
    change = basis(body)
    more = true | {"girth_calf": true["girth_calf"] + 0.02}
    thicker = skeleton.build(Subject(more, 1e-5))
    told = np.array([name == "girth_calf" for name in MEASUREMENTS]) * 0.02
    amounts = change.told @ told
    shank = body.surface.segment == 11
    found = change.displaced(11, body.surface.points_m[shank], amounts)
    own = thicker.surface.points_m[thicker.surface.segment == 11]
    widest = lambda points: np.ptp(points[np.abs(points[:, 2] + 0.32 * true["shank"]) < 0.03, 1])  # noqa: E731
    assert widest(found) - widest(body.surface.points_m[shank]) == pytest.approx(
        widest(own) - widest(body.surface.points_m[shank]), abs=0.002
    )
