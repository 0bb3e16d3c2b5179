"""Files score as the records in memory do, with numpy alone."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from experiments.plain_truth import true_capture, write
from experiments.score import score as score_in_memory
from experiments.totals import metrics as metrics_in_memory
from pzcap.export.tables import results_of
from pzcap.io.capture import read_capture
from pzcap.scoring import truth_files
from pzcap.scoring.command import main, over
from pzcap.scoring.files import read_results, write_results
from pzcap.scoring.metric import Metric
from pzcap.scoring.records import Results, thinned
from pzcap.scoring.score import score
from pzcap.scoring.suspicions import suspicions
from pzcap.scoring.totals import metrics
from pzcap.types import PzcapError
from tests.scenes import plain
from tests.scenes.fabricated import without_a_camera

ROOT = Path(__file__).parents[2]
HEAVY = ("scipy", "cv2", "av", "numba", "loky", "threadpoolctl", "mujoco", "OpenGL", "hydra", "rerun", "ezc3d")


def values(found: list[Metric]) -> dict[str, float | None]:
    return {metric.key: metric.value for metric in found}


def test_files_and_memory_agree_to_the_last_digit(tmp_path: Path) -> None:
    whole, truth = plain.perfect()
    whole = plain.noisy(whole)
    inverse = np.array([[2e-8, 3e-7], [3e-7 * (1 + 1e-9), 2e-5]])  # symmetric but for its last digits
    tracks = [
        None if t is None else replace(t, covariance=np.tile(inverse, (len(t.valid), 1, 1))) for t in whole.tracks
    ]
    whole = replace(whole, tracks=tuple(tracks))
    in_memory = score_in_memory(whole, truth, None)
    bounds = [
        None if e.pan_bound_rad is None or e.focal_bound is None else (e.pan_bound_rad, e.focal_bound)
        for e in in_memory.cameras
    ]
    write_results(results_of(whole), tmp_path / "results")
    truth_files.write_truth(true_capture(truth, bounds=bounds), tmp_path / "truth")
    found = values(metrics(score(read_results(tmp_path / "results"), truth_files.read_truth(tmp_path / "truth"))))
    wanted = values(metrics_in_memory(in_memory))
    assert found["panzoom.bound_ratio.pan"] is not None
    assert found == {key: wanted[key] for key in found}
    assert sum(value is not None for value in found.values()) > 25


def test_what_a_reconstruction_lacks_is_lacking_in_files_too(tmp_path: Path) -> None:
    whole, truth = plain.perfect()
    lacking = without_a_camera(whole)
    write_results(results_of(lacking), tmp_path)
    found = values(metrics(score(read_results(tmp_path), true_capture(truth))))
    wanted = values(metrics_in_memory(score_in_memory(lacking, truth, None)))
    bounded = {key for key in found if "bound" in key}  # the truth has none here
    assert {key: found[key] for key in found.keys() - bounded} == {key: wanted[key] for key in found.keys() - bounded}
    assert found["panzoom.completeness"] == 75.0
    assert found["body.mpjpe.mean"] is None
    assert found["body.completeness"] == 0.0


def test_a_truth_of_the_simulator_is_named_and_can_be_written_plain(tmp_path: Path, small_capture: Path) -> None:
    with pytest.raises(PzcapError, match="this is the simulator's own truth"):
        truth_files.read_truth(small_capture / "truth")
    write(small_capture / "capture", tmp_path)
    plainly = truth_files.read_truth(tmp_path)
    assert plainly.camera_names == ("1", "2", "3", "4")
    assert plainly.name == read_capture(small_capture / "capture").name, "as results of that capture name it"
    assert plainly.keyframe.any(), "poses that the capture gives are not scored"
    with pytest.raises(PzcapError, match="no truth beside it"):
        write(tmp_path, tmp_path / "out")


def test_part_of_a_result_is_scored_and_its_completeness_apart() -> None:
    results, truth = plain.good()
    half = np.arange(results.frames) % 2 == 0
    body = results.body
    assert body is not None
    some = replace(
        results,
        cameras=(*(None if t is None else replace(t, valid=t.valid & half) for t in results.cameras[:2]), None, None),
        body=replace(body, valid=body.valid & half[:, None] & (np.arange(16) < 8)),
    )
    found, whole = values(metrics(score(some, truth))), values(metrics(score(results, truth)))
    assert found["panzoom.completeness"] == 25.0
    assert whole["panzoom.completeness"] == whole["body.completeness"] == 100.0
    # of 20 frames the first and last are keyframes: nine of 18 are left, half the joints each
    assert found["body.completeness"] == pytest.approx(100.0 * 9 * 8 / (18 * 16))
    assert found["body.mpjpe.mean"] == pytest.approx(whole["body.mpjpe.mean"], rel=0.2)
    assert found["body.lost"] == results.frames  # no frame is whole


def test_the_pan_of_a_pose_is_the_pan_that_a_head_would_state() -> None:
    results, truth = plain.good()
    tracks = [t for t in results.cameras if t is not None]
    posed = replace(results, cameras=tuple(replace(t, pan_rad=None, covariance=None) for t in tracks))
    stated, found = values(metrics(score(results, truth))), values(metrics(score(posed, truth)))
    assert found["panzoom.pan.rms"] == pytest.approx(stated["panzoom.pan.rms"], rel=1e-6)
    assert found["panzoom.nees"] is None
    turned = tuple(
        replace(t, poses=replace(t.poses, rotation=rotation_z(np.deg2rad(2.0)) @ t.poses.rotation))
        for t in (t for t in posed.cameras if t is not None)
        if t.poses is not None
    )
    off = values(metrics(score(replace(posed, cameras=turned), truth)))
    assert off["panzoom.pan.median"] == pytest.approx(2.0, abs=0.02)
    assert off["panzoom.rotation.rms"] == pytest.approx(2.0, abs=0.02)


def rotation_z(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def test_jaccard_counts_points_that_either_camera_shows() -> None:
    results, truth = plain.good()
    assert values(metrics(score(results, truth)))["panzoom.jac5"] > 90.0  # type: ignore[operator]
    tracks = [t for t in results.cameras if t is not None]
    away = replace(results, cameras=tuple(
        replace(t, poses=replace(t.poses, principal_px=t.poses.principal_px + np.array([7.0, 0.0])))
        for t in tracks if t.poses is not None
    ))  # fmt: skip
    found = values(metrics(score(away, truth)))
    assert found["panzoom.jac5"] < 5.0  # type: ignore[operator]
    # all that both show is within 10 px; a strip of 7 of 320 columns is shown by one alone, on either side
    assert found["panzoom.jac10"] == pytest.approx(100.0 * (320 - 7) / (320 + 7), abs=4.0)


def test_the_similarity_takes_out_scale_turn_and_place() -> None:
    results, truth = plain.good()
    assert results.body is not None
    joints = 1.1 * truth.joints_m @ rotation_z(0.4).T + [1.0, 2.0, 0.5]
    found = values(metrics(score(replace(results, body=replace(results.body, joints_m=joints)), truth)))
    assert found["body.mpjpe.similarity"] == pytest.approx(0.0, abs=1e-6)
    assert found["body.mpjpe.mean"] > 500.0  # type: ignore[operator]


def test_frames_whose_pose_the_capture_gives_are_not_scored() -> None:
    results, truth = plain.good()
    assert results.body is not None
    joints = results.body.joints_m.copy()
    joints[0] += 9.0  # the truth says that frame 0 was given, and the method does not
    body = replace(results.body, joints_m=joints, keyframe=np.zeros(results.frames, bool))
    found = values(metrics(score(replace(results, body=body), truth)))
    assert found["body.mpjpe.max"] < 100.0  # type: ignore[operator]
    assert found["body.keyframes"] == 1.0


def test_the_truth_is_read_as_it_was_written(tmp_path: Path) -> None:
    results, truth = plain.good()
    truth_files.write_truth(truth, tmp_path)
    again = truth_files.read_truth(tmp_path)
    assert metrics(score(results, again)) == metrics(score(results, truth))
    assert (again.name, again.timecodes, again.frame_rate) == (truth.name, truth.timecodes, truth.frame_rate)
    assert np.array_equal(again.keyframe, truth.keyframe)


def test_a_good_method_is_suspected_of_nothing() -> None:
    results, truth = plain.good()
    assert suspicions(results, truth) == []
    assert suspicions(results, None) == []
    perfect, same = plain.perfect()
    assert suspicions(replace(results_of(perfect), image_size=None), true_capture(same)) == []


def test_a_poor_method_is_poor_and_not_suspected() -> None:
    """Errors of degrees and decimetres, which no mistake of the format explains, are errors."""
    results, truth = plain.good()
    rng = np.random.default_rng(0)
    tracks = []
    for track in results.cameras:
        assert track is not None
        assert track.poses is not None
        turns = np.array([rotation_z(angle) for angle in rng.normal(0.0, 0.05, results.frames)])
        poses = replace(track.poses, rotation=turns @ track.poses.rotation)
        pan = None if track.pan_rad is None else track.pan_rad + rng.normal(0.0, 0.05, results.frames)
        tracks.append(replace(track, poses=poses, pan_rad=pan, focal_px=track.focal_px * rng.uniform(0.8, 1.2, 20)))
    assert results.body is not None
    joints = results.body.joints_m + rng.normal(0.0, 0.2, results.body.joints_m.shape)
    poor = replace(results, cameras=tuple(tracks), body=replace(results.body, joints_m=joints))
    assert suspicions(poor, truth) == []


def test_the_command_scores_a_split_and_means_over_its_captures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    results, truth = plain.good()
    for name in ("a", "b"):
        truth_files.write_truth(replace(truth, name=name), tmp_path / "truth" / name)
    write_results(replace(results, capture="a"), tmp_path / "results" / "a")
    assert main([str(tmp_path / "results"), str(tmp_path / "truth"), "--json", str(tmp_path / "out.json")]) == 0
    said = capsys.readouterr()
    assert "b: no results" in said.err
    content = json.loads((tmp_path / "out.json").read_text())
    assert content["panzoom.completeness"]["value"] == 50.0  # half of the captures
    assert content["_captures"]["a"]["panzoom.completeness"]["value"] == 100.0
    assert content["panzoom.pan.rms"] == content["_captures"]["a"]["panzoom.pan.rms"]
    assert "panzoom.pan.rms" in said.out


def test_over_captures_what_none_has_stays_without_a_value() -> None:
    none, one = Metric("x", None, "mm"), Metric("x", 2.0, "mm")
    assert over({"a": [none], "b": [none]}) == [none]
    assert over({"a": [none], "b": [one], "c": [Metric("x", 4.0, "mm")]}) == [Metric("x", 3.0, "mm")]


def test_the_scorer_needs_numpy_alone(tmp_path: Path) -> None:
    """In a process where nothing heavy can be imported: check, score, and no module of the estimator is loaded."""
    results, truth = plain.written(tmp_path)
    code = f"""
import sys
class Block:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {HEAVY!r}:
            raise ImportError(name + " is blocked")
sys.meta_path.insert(0, Block())
from pzcap.scoring.command import main
assert main([{str(results)!r}, {str(truth)!r}, "--json", {str(tmp_path / "m.json")!r}]) == 0
ours = sorted(name for name in sys.modules if name.startswith(("pzcap", "sim", "experiments")))
light = ("pzcap", "pzcap.types", "pzcap.anatomy", "pzcap.marks", "pzcap.io", "pzcap.io.files")
assert all(name in light or name.startswith("pzcap.scoring") for name in ours), ours
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, timeout=120, check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert json.loads((tmp_path / "m.json").read_text())["panzoom.pan.rms"]["value"] > 0.0


def test_results_of_another_capture_are_refused_or_suspected() -> None:
    results, truth = plain.good()
    with pytest.raises(PzcapError, match="another capture"):
        score(replace(results, timecodes=tuple(f"9{code[1:]}" for code in truth.timecodes)), truth)
    found = suspicions(replace(results, capture="pedestrian"), truth)
    assert found == ["results of the capture 'pedestrian' are scored as 'fabricated'"]


TEN_LINES = """
import csv, json
from pathlib import Path
out, truth = Path("mine"), Path("truth")
out.mkdir()
head = json.loads((truth / "truth.json").read_text())
json.dump({"format": "pzcap-results", "version": 1, "method": "ten lines", "frames": len(head["timecodes"]),
           "cameras": head["cameras"]}, (out / "results.json").open("w"))
rows = [(r["camera"], r["frame"], float(r["pan_rad"]) + 0.001, r["focal_px"])
        for r in csv.DictReader((truth / "cameras.csv").open())]
csv.writer((out / "cameras.csv").open("w")).writerows([("camera", "frame", "pan_rad", "focal_px"), *rows])
"""


def test_ten_lines_without_our_library_write_results(tmp_path: Path) -> None:
    plain.written(tmp_path)
    subprocess.run([sys.executable, "-c", TEN_LINES], cwd=tmp_path, check=True, timeout=60)
    found = values(metrics(score(read_results(tmp_path / "mine"), truth_files.read_truth(tmp_path / "truth"))))
    assert found["panzoom.pan.max"] == pytest.approx(np.degrees(0.001))
    assert found["panzoom.focal.max"] == pytest.approx(0.0, abs=1e-9)
    assert found["panzoom.completeness"] == 100.0


def test_an_empty_table_is_a_method_that_found_nothing(tmp_path: Path) -> None:
    results, truth = plain.written(tmp_path)
    (results / "cameras.csv").write_text("camera,frame,focal_px,pan_rad\n")
    read: Results = read_results(results)
    found = values(metrics(score(read, truth_files.read_truth(truth))))
    assert found["panzoom.completeness"] == 0.0
    assert found["panzoom.lost"] == 80.0
    assert "nothing is scored" in suspicions(read, None)[0]


def test_in_a_world_of_its_own_a_method_is_scored_after_one_rotation(tmp_path: Path) -> None:
    results, truth = plain.good()
    tracks = [t for t in results.cameras if t is not None]
    turn = rotation_z(1.0) @ np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    turned = tuple(
        replace(t, pan_rad=None, covariance=None, poses=replace(t.poses, rotation=turn @ t.poses.rotation))
        for t in tracks if t.poses is not None
    )  # fmt: skip
    own = replace(results, cameras=turned, own_world=True, body=None)
    write_results(own, tmp_path)
    again = read_results(tmp_path)
    assert again.own_world
    assert suspicions(again, truth) == []
    found = values(metrics(score(again, truth)))
    assert 0.0 < found["panzoom.rotation.common.rms"] < 0.02  # type: ignore[operator]
    assert found["panzoom.pan.rms"] is found["panzoom.position.rms"] is found["panzoom.reprojection.rms"] is None
    assert found["panzoom.focal.rms"] == values(metrics(score(results, truth)))["panzoom.focal.rms"]
    assert found["panzoom.completeness"] == 100.0


def test_a_few_frames_that_are_far_off_do_not_tell_the_common_rotation() -> None:
    results, truth = plain.good()
    track = results.cameras[0]
    assert track is not None
    assert track.poses is not None
    rotation = track.poses.rotation.copy()
    rotation[:3] = rotation_z(0.5) @ rotation[:3]
    alone = replace(results, camera_names=("1",), own_world=True, body=None, cameras=(
        replace(track, pan_rad=None, poses=replace(track.poses, rotation=rotation)),
    ))  # fmt: skip
    assert values(metrics(score(alone, truth)))["panzoom.rotation.common.median"] < 0.05  # type: ignore[operator]


def test_a_track_may_ask_for_some_frames_only() -> None:
    results, truth = plain.good()
    some = np.arange(results.frames) % 5 == 0
    tracks = tuple(None if t is None else replace(t, valid=t.valid & some) for t in results.cameras)
    few, all_frames = replace(results, cameras=tracks), results
    found, whole = (values(metrics(score(one, thinned(truth, 5)))) for one in (few, all_frames))
    assert found["panzoom.completeness"] == 100.0
    assert {k: v for k, v in found.items() if "panzoom" in k} == {k: v for k, v in whole.items() if "panzoom" in k}
    with pytest.raises(PzcapError, match="every is 0"):
        thinned(truth, 0)


def test_a_reader_that_has_read_enough_is_no_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    results, truth = plain.written(tmp_path)
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "w") as closed:
        monkeypatch.setattr(sys, "stdout", closed)
        assert main([str(results), str(truth), "--json", str(tmp_path / "x.json")]) == 0
        monkeypatch.undo()
    assert capsys.readouterr().err == ""
    assert (tmp_path / "x.json").is_file()
