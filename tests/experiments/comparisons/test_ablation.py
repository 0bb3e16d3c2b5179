"""The error budget on a small capture: every variant is tracked, and the default is what a run would find."""

from __future__ import annotations

import csv
import shutil
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hydra.core.global_hydra import GlobalHydra

from experiments import compare, footage
from experiments.comparisons.ablation import COMPARISON, trial
from experiments.comparisons.ablation.trial import Material
from experiments.comparisons.ablation.variants import VARIANTS
from experiments.metrics import read_metrics
from experiments.score import frames_of
from pzcap import pipeline
from pzcap.events import FrameLocalised
from pzcap.io.capture import frame_sets, read_capture
from pzcap.types import PzcapError, Reconstruction

pytestmark = pytest.mark.xdist_group("pipeline")
BY_KEY = {variant.key: variant for variant in VARIANTS}


def silent(*_: object) -> None:
    """Hear no progress."""


@pytest.fixture(scope="module")
def material(small_capture: Path, small_run: Reconstruction) -> Material:
    """As `trial.prepare` makes it, from what the run has prepared already."""
    capture, truth = read_capture(small_capture / "capture"), footage.truth_beside(small_capture / "capture")
    assert truth is not None
    assert capture.subject is not None
    found = replace(small_run, motion=None)
    return Material(capture, capture.subject, frame_sets(capture), found, {}, truth, frames_of(truth, found)[0])


def test_the_default_is_what_a_run_finds(material: Material, small_run: Reconstruction) -> None:
    assert small_run.motion is not None
    motion, _ = trial.follow(material, BY_KEY["default"], pipeline.Config(), silent)
    np.testing.assert_array_equal(motion.joints_m, small_run.motion.joints_m)


@pytest.mark.heavy
def test_the_command_leaves_a_table_metrics_and_plots(
    small_capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    GlobalHydra.instance().clear()
    arguments = ["compare", "ablation", f"capture={small_capture / 'capture'}", f"hydra.run.dir={tmp_path}"]
    monkeypatch.setattr("sys.argv", arguments)
    assert compare.main() == 0
    assert all((tmp_path / name).stat().st_size > 500 for name in COMPARISON.results)
    out = capsys.readouterr().out
    assert all(variant.label in out for variant in VARIANTS)
    found = {metric.key: metric.value for metric in read_metrics(tmp_path / "metrics.json")[0]}
    assert all(found[f"ablation.{key}.mpjpe.mean"] is not None for key in BY_KEY)
    assert found["body.mpjpe.true_cameras"] == found["ablation.true_cameras.mpjpe.mean"]
    known, usual = found["ablation.all_true.mpjpe.mean"], found["ablation.default.mpjpe.mean"]
    assert known is not None
    assert usual is not None
    assert known < usual
    same = {key for key in BY_KEY if found[f"ablation.{key}.mpjpe.mean"] == usual}
    # eight frames of a walker, a keyframe at either end: no limb is lost, no keyframe is between
    more = {"ends", "half", "two_a_second", "four_a_second"}
    unused = {"no_limits", "no_reacquisition", "no_appearance", "no_self_collision", "no_others", "no_drape"}
    unused.add("no_shape_refit")  # of one interval the body is known in the end as it was
    assert same <= {"default"} | unused | more
    with (tmp_path / "ablation.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["label"] for row in rows] == [variant.label for variant in VARIANTS]


def test_keyframes_are_left_out_and_posed_besides(material: Material) -> None:
    def frames(key: str) -> list[int]:
        return [keyframe.frame for keyframe in trial.keyframes(material, BY_KEY[key])]

    given = [keyframe.frame for keyframe in material.sets.keyframes]
    assert frames("default") == given
    assert frames("first") == given[:1]
    assert frames("ends") == [given[0], given[-1]]
    assert set(given) <= set(frames("four_a_second"))


def test_second_fields_are_shaken_as_their_frames_are(material: Material) -> None:
    """Of views that a capture has whole: each is its own second field."""
    frames = next(iter(material.sets))
    doubled = replace(frames, second_fields=frames.images)
    with ThreadPoolExecutor(1) as pool:

        def seen(fields: dict[int, trial.Located], key: str) -> FrameLocalised:
            known = replace(material, second_fields=fields)
            return trial._Stages(known, BY_KEY[key], pipeline.Config(), pool).localise(doubled, None)

        whole = seen({}, "default")
        assert whole.second_fields is None
        both = seen({0: whole.localisations}, "shaken")
    assert both.second_fields is not None
    for one, other, where in zip(
        both.localisations, both.second_fields.localisations, whole.localisations, strict=True
    ):
        assert one is not None
        assert other is not None
        assert where is not None
        assert one.pan_rad == other.pan_rad != where.pan_rad
        assert np.all(np.diag(one.covariance) >= np.diag(where.covariance))


def test_a_keyframe_that_is_posed_besides_has_the_error_of_a_hand(material: Material) -> None:
    often = BY_KEY["four_a_second"]
    by_hand, true = (
        trial.keyframes(material, each) for each in (often, replace(often, known=frozenset({"keyframes"})))
    )
    for one, other in zip(by_hand, true, strict=True):
        assert one.frame == other.frame
        assert 0.0 < np.linalg.norm(one.pose.root_position_m - other.pose.root_position_m) < 0.04


def test_a_true_silhouette_is_sure_of_the_mask() -> None:
    mask = np.zeros((41, 50), bool)
    mask[10:30, 20:40] = True
    silhouette = trial.true_silhouette(mask)
    assert np.array_equal(silhouette.probability > 127, mask)
    assert np.array_equal(silhouette.evidence > 0, mask[:40:2, ::2])


def test_footage_without_a_truth_gets_one_line(
    small_capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    GlobalHydra.instance().clear()
    shutil.copytree(small_capture / "capture", tmp_path / "footage")
    monkeypatch.setattr(
        "sys.argv", ["compare", "ablation", f"capture={tmp_path / 'footage'}", f"hydra.run.dir={tmp_path}"]
    )
    assert compare.main() == 1
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "needs the truth" in err


def test_a_capture_without_keyframes_is_refused(material: Material) -> None:
    capture = replace(material.capture, keyframe_poses={})
    with pytest.raises(PzcapError, match=r"keyframes\.json"):
        trial.prepare(capture, material.truth, pipeline.Config(), silent)
