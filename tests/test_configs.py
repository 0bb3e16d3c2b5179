"""Every named experiment composes, and what does not fit is said in one line before any work begins."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hydra.core.global_hydra import GlobalHydra

from experiments import run
from experiments.config import CONVERTER, AppConfig, build, default_tree, keys, nearest
from experiments.errors import explain, guard
from pzcap.types import PzcapError
from tests.scenes.configs import composed

EXPERIMENTS = sorted(path.stem for path in (run.CONF / "experiment").glob("*.yaml"))


TRIALS = {
    "zoom_4x": {"optics.zoom_max", "operator.zoom_swing_s"},
    "fast_pan": {"operator.swing_deg_s", "operator.swing_hz", "sensor.sub_exposures"},
    "close_up": {"motion", "optics.zoom_max", "optics.tilt_deg", "operator.body_height", "operator.whole_body"},
    "lights_on": {"gym.lights_on"},
    "moved_object": {"gym.rearranged"},
    "bare_walls": {"gym.bare_walls"},
    "plain_head": {"optics.axis_behind_m", "optics.axis_beside_m"},
    "crew_in_sweep": {"crew.walks_in_sweep"},
    "tilting": {"operator.tilts"},
    "partial_sweep": {"sweep_deg", "zoom_frames"},
    "rolling_shutter": {"sensor.readout_s"},
    "own_clocks": {"sensor.clock_offset", "sensor.clock_drift_ppm"},
    "no_timecode": {"crew.sync", "sensor.largest_roll", "sensor.clock_offset", "sensor.clock_drift_ppm"},
    "mains_light": {"gym.mains_share"},
    "sprung_floor": {"optics.settled_deg", "optics.sprung_deg", "optics.bump_deg"},
    "hand_sweep": {
        "operator.sweep_uneven",
        "operator.sweep_stop_frames",
        "operator.sweep_back_frames",
        "operator.sweep_zoom",
        "sensor.hall_shutter_s",
    },
    "lens_beyond": {"optics.k2", "optics.p1", "optics.lateral_colour_px"},
    "auto_exposure": {"sensor.auto_exposure", "sensor.white_drift"},
    "interlaced": {"sensor.field_s"},
}
"""What each departs in from the default shoot."""
TRIALS["rolling_clocks_mains"] = set().union(
    *(TRIALS[name] for name in ("rolling_shutter", "own_clocks", "mains_light"))
)
TRIALS["all_cameras"] = TRIALS["rolling_clocks_mains"].union(
    *(TRIALS[name] for name in ("sprung_floor", "hand_sweep", "lens_beyond", "auto_exposure", "interlaced"))
)


def leaf(tree: dict[str, Any], key: str) -> Any:
    value: Any = tree
    for part in key.split("."):
        value = value[part]
    return value


def test_the_experiments_of_the_readme_are_there() -> None:
    readme = (run.CONF.parent / "README.md").read_text(encoding="utf-8")
    assert {"floor_exercise", "pedestrian", "clean", *TRIALS} <= set(EXPERIMENTS)
    assert all(name in readme for name in EXPERIMENTS)


@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_every_experiment_composes(experiment: str) -> None:
    config = build(composed(f"experiment={experiment}", "seed=7"))
    assert config.seed == config.shoot.seed == 7
    assert config.capture is None


def test_the_base_is_the_defaults_of_the_dataclasses() -> None:
    assert CONVERTER.unstructure(build(default_tree())) == default_tree()
    assert build(composed("experiment=floor_exercise")).shoot == AppConfig().shoot


@pytest.mark.parametrize("trial", TRIALS)
def test_a_trial_changes_what_it_is_about_and_leaves_the_other_troubles_on(trial: str) -> None:
    shoot = composed(f"experiment={trial}")["shoot"]
    plain = CONVERTER.unstructure(AppConfig().shoot)
    leaves = [key for key in keys(plain) if not isinstance(leaf(plain, key), dict)]
    assert {key for key in leaves if leaf(shoot, key) != leaf(plain, key)} == TRIALS[trial]


@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_an_experiment_says_what_it_is_in_a_few_lines(experiment: str) -> None:
    lines = (run.CONF / "experiment" / f"{experiment}.yaml").read_text(encoding="utf-8").splitlines()
    assert len(lines) <= 25
    assert sum(line.startswith("# ") for line in lines) >= 3


def test_the_method_reaches_the_reconstruction() -> None:
    assert build(composed("method=paper")).reconstruct.panzoom.method == "paper"


def test_clean_leaves_the_read_noise_alone_and_switches_the_rest_off() -> None:
    clean, real = build(composed("experiment=clean")).shoot, AppConfig().shoot
    assert clean.sensor.read_noise == real.sensor.read_noise > 0
    optics, sensor = clean.optics, clean.sensor
    assert optics.vignetting == 1.0
    for value in (optics.k1_wide, optics.k1_long, optics.principal_offset, optics.axis_beside_m, optics.axis_behind_m,
                  optics.centre_travel_m, optics.tilt_deg, optics.tilt_sigma_deg, optics.roll_deg, sensor.shot_noise,
                  sensor.exposure_drift, sensor.shutter_s, sensor.crf_motion, sensor.crf_still):  # fmt: skip
        assert value == 0


def changed(path: str, value: Any) -> dict[str, Any]:
    tree = default_tree()
    *groups, leaf = path.split(".")
    branch = tree
    for group in groups:
        branch = branch[group]
    branch[leaf] = value
    return tree


@pytest.mark.parametrize(
    ("path", "value", "says"),
    [
        ("shoot.sensor.read_noise", "loud", "shoot.sensor.read_noise: 'loud' is not a number"),
        ("seed", 1.5, "seed: 1.5 is not a whole number"),
        ("seed", True, "seed: True is not a whole number"),
        ("output.report", 1, "output.report: 1 is not true or false"),
        ("shoot.sensor.read_nois", 1.0, "unknown key 'shoot.sensor.read_nois'; did you mean shoot.sensor.read_noise"),
        ("recontruct", {}, "unknown key 'recontruct'; did you mean reconstruct"),
        ("xyz", 1, "the keys are cameras, capture, estimator, method, output, reconstruct, seed, settings, shoot"),
        ("reconstruct.panzoom.method", "guess", "'guess'"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(path: str, value: Any, says: str) -> None:
    with pytest.raises(PzcapError) as error:
        build(changed(path, value))
    assert says in str(error.value)
    assert "\n" not in str(error.value)


def test_whole_numbers_pass_for_numbers() -> None:
    assert build(changed("shoot.sensor.read_noise", 4)).shoot.sensor.read_noise == 4.0


def test_nearest_finds_a_leaf_that_was_put_at_the_wrong_place() -> None:
    assert "shoot.sensor.read_noise" in nearest("read_noise", keys(default_tree()))


COMMANDS = {
    "shoot.sensr.read_noise=3": "unknown key 'shoot.sensr.read_noise'; did you mean shoot.sensor.read_noise",
    "+nothing=3": "unknown key 'nothing'",
    "experiment=pedestrain": "no 'pedestrain' in conf/experiment; did you mean pedestrian",
    "seed=[1": "error: ",
    "seed=many": "seed: 'many' is not a whole number",
    "capture=/no/such/folder": "/no/such/folder",
}


@pytest.mark.parametrize("sweep", [False, True])
@pytest.mark.parametrize("override", COMMANDS)
def test_a_wrong_command_gets_one_line(
    override: str, sweep: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    folder = f"hydra.sweep.dir={tmp_path}" if sweep else f"hydra.run.dir={tmp_path}"
    monkeypatch.setattr("sys.argv", ["run", *(["-m"] if sweep else []), folder, override])
    GlobalHydra.instance().clear()
    assert run.main() == 1
    out, err = capfd.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert err.startswith("error: ")
    assert COMMANDS[override] in err


def test_a_full_disk_gets_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    def full() -> None:
        raise OSError(28, "No space left on device", "outputs/x/metrics.json")

    assert guard(full) == 1
    assert capsys.readouterr().err == (
        "error: the disk is full while writing outputs/x/metrics.json; "
        "free some space or choose another folder with hydra.run.dir=FOLDER\n"
    )


def test_a_bug_keeps_its_traceback() -> None:
    def bug() -> None:
        raise ZeroDivisionError

    assert explain(ZeroDivisionError()) is None
    with pytest.raises(ZeroDivisionError):
        guard(bug)
