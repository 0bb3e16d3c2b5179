"""Files that are damaged, by a byte or by a value: one line that names the file, and the other runs go on."""

from __future__ import annotations

import json
import os
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from experiments import recordings
from experiments.metrics import read_metrics
from experiments.report import bookmarks
from experiments.studies import page, study
from pzcap.types import PzcapError
from sim.truth import Truth, load, save
from tests.scenes import fabricated
from tests.scenes.fabricated_truth import truth_of
from tests.scenes.studies import NOISE, grid, record

TRIES = 60
VALUES: tuple[Any, ...] = (None, "", "x", -1, 0, 1e308, float("nan"), [], {}, [[]], {"value": {}}, True)


@pytest.fixture(scope="module")
def truth() -> Truth:
    return truth_of(fabricated.reconstruction())


def damaged(content: bytes, rng: random.Random) -> bytes:
    """Some bytes changed, cut off, doubled, or all gone."""
    kind = rng.randrange(4)
    at = rng.randrange(len(content))
    if kind == 0:
        return bytes(rng.randrange(256) if rng.random() < 0.02 else byte for byte in content)
    if kind == 1:
        return content[:at]
    if kind == 2:
        return content[:at] + content[rng.randrange(len(content)) :]
    return content[:at] + bytes([rng.randrange(256)]) + content[at + 1 :]


def mutated(tree: Any, rng: random.Random) -> Any:
    """One value of plain data changed for another kind of value, or gone."""
    copy = json.loads(json.dumps(tree))
    node, parent, key = copy, None, None
    while isinstance(node, dict | list) and node and (parent is None or rng.random() < 0.7):
        parent, key = node, rng.choice(list(node)) if isinstance(node, dict) else rng.randrange(len(node))
        node = parent[key]
    if isinstance(parent, dict) and rng.random() < 0.2:
        del parent[key]
    elif parent is not None:
        parent[key] = rng.choice(VALUES)
    return copy


def a_result_or_one_line(read: Callable[[], object], path: Path) -> None:
    said = f"{path}: nothing"
    try:
        read()
    except PzcapError as error:
        said = str(error)
    assert str(path) in said
    assert "\n" not in said


@pytest.mark.parametrize("name", ["truth.json", "truth.npz", "masks.npz"])
def test_a_truth_of_damaged_bytes(name: str, truth: Truth, tmp_path: Path) -> None:
    save(truth, tmp_path)
    content = (tmp_path / name).read_bytes()
    for seed in range(TRIES):
        (tmp_path / name).write_bytes(damaged(content, random.Random(seed)))
        a_result_or_one_line(lambda: load(tmp_path), tmp_path)


def test_a_truth_of_damaged_values(truth: Truth, tmp_path: Path) -> None:
    save(truth, tmp_path)
    plain = json.loads((tmp_path / "truth.json").read_text())
    for seed in range(TRIES):
        (tmp_path / "truth.json").write_text(json.dumps(mutated(plain, random.Random(seed))))
        a_result_or_one_line(lambda: load(tmp_path), tmp_path)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda arrays: arrays.update(focal_px=arrays["focal_px"][:, :-1]), r"focal_px has the shape \(\d, \d+\), not"),
        (lambda arrays: arrays.update(pan_rad=arrays["pan_rad"] * np.nan), "pan_rad holds what is no number"),
        (lambda arrays: arrays.update(k1=arrays["k1"].astype(str)), "k1 holds what is no number"),
        (
            lambda arrays: arrays.update(joints_m=arrays["joints_m"].ravel()),
            r"joints_m has the shape \(576,\), not F x 16 x 3",
        ),
        (lambda arrays: arrays.pop("roll_rad"), "not a truth of this version .*roll_rad"),
        (lambda arrays: arrays.update(more=np.zeros(3)), "not a truth of this version .*more"),
    ],
)
def test_arrays_that_do_not_fit(
    change: Callable[[dict[str, Any]], object], expected: str, truth: Truth, tmp_path: Path
) -> None:
    save(truth, tmp_path)
    with np.load(tmp_path / "truth.npz") as found:
        arrays = dict(found)
    change(arrays)
    np.savez(tmp_path / "truth.npz", **arrays)
    with pytest.raises(PzcapError, match=expected):
        load(tmp_path)


def test_metrics_of_damaged_bytes_and_values(tmp_path: Path) -> None:
    (place, *_) = grid(tmp_path, {NOISE: (0, 1)})
    path = place / "metrics.json"
    content = path.read_bytes()
    for seed in range(TRIES):
        rng = random.Random(seed)
        path.write_bytes(damaged(content, rng))
        a_result_or_one_line(lambda: read_metrics(path), path)
        path.write_text(json.dumps(mutated(json.loads(content), rng)))
        a_result_or_one_line(lambda: read_metrics(path), path)


@pytest.mark.parametrize("name", ["metrics.json", "job.json", "failed.txt"])
def test_one_bad_file_costs_a_study_one_run(name: str, tmp_path: Path) -> None:
    places = grid(tmp_path, {NOISE: (0, 1, 2), "seed": (0, 1)})
    good = (places[2] / name).read_bytes() if name != "failed.txt" else b"out of memory\n"
    for seed in range(12):
        rng = random.Random(seed)
        (places[2] / name).write_bytes(damaged(good, rng) if seed % 3 else b"\xff\xfe{")
        found = study.collect(tmp_path, places)
        assert found is not None
        assert found.count >= 5
        assert set(found.failed) <= {places[2].name}
        if seed < 4:  # pages and tables are drawn of what was collected
            assert page.write_study(tmp_path, places)
            assert (tmp_path / "runs.parquet").is_dir()


def test_a_recording_of_damaged_bytes(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "run" / "recording.rrd"
    record(path, 1.0, 0)
    content = path.read_bytes()
    for seed in range(TRIES):
        path.write_bytes(damaged(content, random.Random(seed)))
        a_result_or_one_line(lambda: bookmarks.errors(path), path)
        a_result_or_one_line(lambda: recordings.recording_id(path), path)
    assert capfd.readouterr() == ("", "")


def test_one_bad_recording_costs_a_catalog_one_run_and_a_copy_none(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    paths = [tmp_path / f"{k}" / "recording.rrd" for k in range(4)]
    for k, path in enumerate(paths[:3]):
        record(path, 1.0, k)
    paths[1].write_bytes(paths[1].read_bytes()[:-5000])
    paths[3].parent.mkdir()
    paths[3].write_bytes(paths[0].read_bytes())
    assert recordings.readable(paths) == [paths[0], paths[2]]
    lines = capfd.readouterr().err.splitlines()
    assert len(lines) == 2
    assert lines[0].startswith(f"error: {paths[1]}: damaged, or never finished (")
    assert lines[1] == f"error: {paths[3]}: left out, since it is a copy of {paths[0]}; make the run again to have both"


def test_a_pipe_in_the_place_of_a_result_is_not_waited_for(tmp_path: Path) -> None:
    places = grid(tmp_path, {NOISE: (0, 1)})
    (places[0] / "metrics.json").unlink()
    os.mkfifo(places[0] / "metrics.json")
    found = study.collect(tmp_path, places)
    assert found is not None
    assert [row["path"] for row in found.rows(["path"])] == [places[1].name]
    assert "is a pipe" in found.failed[places[0].name]
