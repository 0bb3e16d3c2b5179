"""A study is one table and one page: every run in it, with what it takes to get it again."""

from __future__ import annotations

import itertools
import re
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pyarrow.parquet as pq
import pytest

from experiments import run
from experiments.config import build
from experiments.studies import jobs, study
from experiments.studies import page as study_page
from tests.scenes.studies import NOISE, ZOOM, composed, grid, job_tree

STUDIES = sorted(path.stem for path in (run.CONF / "study").glob("[!_]*.yaml"))


def axes(name: str) -> dict[str, list[str]]:
    params = composed(f"study={name}", hydra=True).hydra.sweeper.params
    return {str(key): str(value).split(",") for key, value in params.items()}


def test_the_studies_of_the_issue_are_there() -> None:
    method = {"noise", "zoom_range", "noise_x_zoom", "keyframes", "parallax", "frame_size"}
    cameras = {
        "readout",
        "clocks",
        "mains",
        "settling",
        "springing",
        "lens",
        "lateral_colour",
        "exposure",
        "sweep_by_hand",
    }
    assert method | cameras | {"cloth", "nearness", "trials"} == set(STUDIES)


def test_every_trial_is_in_the_table_of_trials() -> None:
    """But for those of one comparison, and a perfect camera, which takes hours."""
    named = {path.stem for path in (run.CONF / "experiment").glob("*.yaml")}
    of_comparisons = {"ablation", "burden", "keypoints", "operators", "self_calibration", "clean"}
    developed_on = {"crouching_turn", "full_turn_jump"}
    assert set(axes("trials")["experiment"]) == named - of_comparisons - developed_on


@pytest.mark.parametrize("name", STUDIES)
def test_every_job_of_a_study_composes(name: str) -> None:
    for choice in itertools.product(*([f"{key}={value}" for value in values] for key, values in axes(name).items())):
        config = build(job_tree(f"study={name}", *choice))
        assert config.shoot.width * 3 == config.shoot.height * 4
        assert config.shoot.seed == config.seed


def test_a_study_is_kept_in_a_folder_of_its_own_and_its_jobs_are_named_by_what_differs() -> None:
    config = composed("study=noise", "seed=1", hydra=True)
    assert config.hydra.sweep.dir == "outputs/study/noise"  # without ${hydra:...}: launchers ask before there is one
    assert re.fullmatch(r"seed=1-[0-9a-f]{10}", jobs.name(config))


def test_the_table_holds_settings_metrics_and_versions(tmp_path: Path) -> None:
    places = grid(tmp_path, {NOISE: [0, 2.5], "seed": [0, 1]})
    assert study_page.write_study(tmp_path, places)
    table = pq.read_table(tmp_path / study.TABLE)
    assert table.num_rows == 4
    rows = table.to_pylist()
    assert [row[f"config.{NOISE}"] for row in rows] == [0, 0, 2.5, 2.5]
    assert [row["config.seed"] for row in rows] == [0, 1, 0, 1]
    assert rows[2]["metric.panzoom.pan.rms"] == pytest.approx(3.5 / 3 / 1000)
    assert table.schema.field("metric.panzoom.pan.rms").metadata == {b"unit": b"deg"}
    assert rows[0]["metric.body.mpjpe.mean"] is None
    assert rows[0]["version.numpy"] == np.__version__
    assert rows[0]["config.reconstruct.panzoom.zoom_range"].startswith("[")
    assert rows[1]["command"] == f"python -m experiments.run {NOISE}=0 seed=1"
    assert (tmp_path / rows[3]["path"]) == places[3]


def test_every_point_leads_to_its_run_and_to_the_command_that_made_it(tmp_path: Path) -> None:
    places = grid(tmp_path, {NOISE: [0, 4], "seed": [0, 1, 2]})
    study_page.write_study(tmp_path, places)
    page = (tmp_path / study_page.PAGE).read_text()
    for place in places:
        assert page.count(f'href="#{place.name}"') == 2  # a point in each of two panels
        assert f'<tr id="{place.name}">' in page
    for link in re.findall(r'href="([^#"]+)"', page):
        assert (tmp_path / unquote(link)).exists()
    assert page.count("<code>python -m experiments.run") == 6
    assert "Cramér-Rao bound" in page
    assert f"<code>{NOISE}</code>, standard deviation, grey levels." in page


def test_a_run_that_says_what_is_wrong_is_ringed_and_its_words_stand_in_its_row(tmp_path: Path) -> None:
    said = ("camera 2: its shutter rolls", "the body may be lost in 7 frames")
    [silent] = grid(tmp_path, {NOISE: [0], "seed": [0]}, notes=["the next keyframe would help most at frame 3 (01:00)"])
    [speaks] = grid(tmp_path, {NOISE: [4], "seed": [0]}, notes=said)
    plan = plan_of(tmp_path, [silent, speaks])
    assert {point.name: point.spoke for line in plan.lines for point in line.points} == {
        silent.name: False, speaks.name: True,
    }  # fmt: skip
    study_page.write_study(tmp_path, [silent, speaks])
    assert [row["notes"] for row in pq.read_table(tmp_path / study.TABLE).to_pylist()] == ["", "\n".join(said)]
    page = (tmp_path / study_page.PAGE).read_text()
    assert "the run says what is wrong" in page  # the legend
    _, row = page.split(f'<tr id="{speaks.name}">')
    assert all(f"<li>{note}</li>" in row for note in said)
    study_page.write_study(tmp_path, [silent])
    assert "the run says what is wrong" not in (tmp_path / study_page.PAGE).read_text()


def plan_of(folder: Path, places: list[Path]) -> study_page.Plan:
    found = study.collect(folder, places)
    assert found is not None
    return study_page.Plan.of(found)


def test_seeds_give_the_error_bars_and_what_else_differs_another_line(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, grid(tmp_path, {NOISE: [0, 4], "method": ["exact", "paper"], "seed": [0, 1, 2]}))
    assert (plan.x, plan.others, plan.names) == (NOISE, ("method",), None)
    assert [line.label for line in plan.lines] == ["method exact", "method paper"]
    assert plan.panels[0].metric == "panzoom.pan.rms"
    mean, sigma = plan.lines[0].means()
    np.testing.assert_allclose(plan.lines[0].x, [0, 4])
    np.testing.assert_allclose(mean[:, 0], [1.1 / 3000, 5.1 / 3000])
    np.testing.assert_allclose(sigma[:, 0], 0.1 / 3000)
    np.testing.assert_allclose(mean[:, len(plan.panels)], mean[:, 0] / 3)  # the bound


def test_what_is_no_number_stands_side_by_side(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, grid(tmp_path, {"experiment": ["pedestrian", "clean"]}))
    assert (plan.x, plan.names) == ("experiment", ("pedestrian", "clean"))
    np.testing.assert_allclose(plan.lines[0].x, [0, 1])


def test_the_table_is_written_in_parts_that_have_the_same_columns(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    places = grid(tmp_path, {NOISE: [0, 2.5, 4], "seed": [0, 1]})
    whole = study.collect(tmp_path, places)
    expected = pq.read_table(tmp_path / study.TABLE)
    monkeypatch.setattr(study, "PART", 2)  # the first part has whole noises, the second others
    parted = study.collect(tmp_path, places)
    parts = sorted((tmp_path / study.TABLE).iterdir())
    assert [pq.read_metadata(part).num_rows for part in parts] == [2, 2, 2]
    assert {str(pq.read_schema(part)) for part in parts} == {str(expected.schema)}
    assert pq.read_table(tmp_path / study.TABLE).to_pylist() == expected.to_pylist()
    assert parted == whole
    assert not list(tmp_path.glob(".*"))


def test_a_setting_of_numbers_here_and_words_there_is_text_in_all_parts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(study, "PART", 1)
    study.collect(tmp_path, [*grid(tmp_path, {"capture": ["null", "3"]}), *grid(tmp_path, {"capture": ["here"]})])
    table = pq.read_table(tmp_path / study.TABLE)
    assert sorted(map(str, table["config.capture"].to_pylist())) == ["3", "None", "here"]


def test_the_page_names_the_first_runs_and_means_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study_page, "ROWS", 4)
    places = grid(tmp_path, {NOISE: [0, 4], "seed": [0, 1, 2]})
    study_page.write_study(tmp_path, places)
    page = (tmp_path / study_page.PAGE).read_text()
    assert page.count("<code>python -m experiments.run") == 4
    assert "the first 4 of 6 runs" in page
    plan = plan_of(tmp_path, places)
    np.testing.assert_allclose(plan.lines[0].means()[0][:, 0], [1.1 / 3000, 5.1 / 3000])


def test_two_axes_of_numbers_are_a_surface(tmp_path: Path) -> None:
    places = grid(tmp_path, {NOISE: [0, 4], ZOOM: [1.5, 3]})
    study_page.write_study(tmp_path, places)
    assert (tmp_path / study_page.PAGE).read_text().count("<svg") == 2
    study_page.write_study(tmp_path, places[:2])
    assert (tmp_path / study_page.PAGE).read_text().count("<svg") == 1


def test_without_a_bound_none_is_drawn_and_lost_frames_are_marked(tmp_path: Path) -> None:
    places = grid(tmp_path, {NOISE: [0, 4]}, bounded=False, lost=5.0)
    study_page.write_study(tmp_path, places)
    page = (tmp_path / study_page.PAGE).read_text()
    assert "Cramér-Rao" not in page
    assert "with frames lost" in page


def test_a_job_that_failed_is_named_with_its_reason(tmp_path: Path) -> None:
    places = grid(tmp_path, {NOISE: [0, 4]})
    broken = tmp_path / "broken"
    broken.mkdir()
    (broken / jobs.FAILED).write_text("camera 2: the sweep shows nothing\n")
    study_page.write_study(tmp_path, [*places, broken])
    page = (tmp_path / study_page.PAGE).read_text()
    assert "Without a result: 1" in page
    assert "camera 2: the sweep shows nothing" in page


def test_jobs_without_metrics_make_no_page(tmp_path: Path) -> None:
    assert not study_page.write_study(tmp_path, [tmp_path / "nothing"])
    assert not list(tmp_path.iterdir())
