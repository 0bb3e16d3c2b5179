"""Methods of other footage and other tools: answers have the joints that they give, and no cameras of their own."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from experiments.benchmark.make import CONFIG, BenchmarkConfig
from experiments.benchmark.methods import bodies
from experiments.benchmark.methods.given import Answered, Given
from experiments.comparisons.fixed_tools import LIMBS
from experiments.config import AppConfig, default_tree
from pzcap.scoring.score import score
from pzcap.scoring.totals import metrics
from pzcap.types import JOINTS, Array, PzcapError
from tests.scenes import plain

OWN = [JOINTS.index(name) for name in LIMBS]


@pytest.fixture
def given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Given:
    """A capture that our pipeline finds perfectly, with keypoints and two keyframes."""
    whole, truth = plain.perfect()
    sets = SimpleNamespace(timecodes=whole.timecodes, keyframes=[SimpleNamespace(frame=0), SimpleNamespace(frame=19)])
    cameras = tuple(SimpleNamespace(name=name, keypoints=tmp_path) for name in whole.camera_names)
    capture: Any = SimpleNamespace(cameras=cameras, subject="measured", name=whole.capture_name, keyframe_poses={})
    monkeypatch.setattr(bodies, "Take", lambda found, _: found)
    monkeypatch.setattr(bodies, "installed", lambda _: True)
    (tmp_path / CONFIG).write_text(json.dumps(default_tree(BenchmarkConfig)))
    made = Given(tmp_path, AppConfig(), lambda *_: None)
    vars(made).update(capture=capture, sets=sets, truth=truth, ours=(whole, 2.0, 100.0))
    return made


def values(answered: Answered) -> dict[str, float | None]:
    assert answered.results is not None
    return {metric.key: metric.value for metric in metrics(score(answered.results, plain.good()[1]))}


def some_joints(found: dict[str, Array], _: object) -> Array:
    """The limbs' joints as they are; those of the trunk nowhere."""
    joints = np.full((len(found["left_hip"]), len(JOINTS), 3), np.nan)
    for name, places in found.items():
        joints[:, JOINTS.index(name)] = places
    return joints


def test_a_tool_for_fixed_cameras_answers_with_the_joints_it_gives(
    given: Given, monkeypatch: pytest.MonkeyPatch
) -> None:
    def off(take: Any, _: Path) -> Array:
        places = take.motion.joints_m[:, OWN] + np.array([0.01, 0.0, 0.0])
        places[3] = np.nan  # a frame that it has no answer for
        return np.asarray(places)

    def fails(*_: object) -> Array:
        raise PzcapError("aniposelib: it does not work")

    monkeypatch.setattr(bodies, "TOOLS", {"aniposelib": fails, "pose2sim": off})
    monkeypatch.setattr(bodies, "all_joints", some_joints)
    answers = bodies.run_fixed_tools(given)
    assert answers["aniposelib"].missing == "aniposelib: it does not work"  # and the other goes on
    found = values(answers["pose2sim"])
    assert found["body.mpjpe.mean"] == pytest.approx(10.0)
    assert found["body.completeness"] == pytest.approx(100.0 * 17 * 12 / (18 * 16))  # two keyframes, one without
    assert found["panzoom.completeness"] == 100.0  # our cameras


def test_a_tool_without_environment_or_keypoints_says_so(given: Given, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bodies, "installed", lambda _: False)
    assert {a.missing for a in bodies.run_fixed_tools(given).values()} == {
        "needs its own environment: make test-clients"
    }
    given.capture.subject = None  # type: ignore[misc]
    assert {a.missing for a in bodies.run_fixed_tools(given).values()} == {"needs keypoints and measurements"}


def test_keypoints_have_a_body_by_true_cameras_where_ours_found_none(
    given: Given, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, truth = plain.perfect()

    def triangulated(_: object, cameras: Any) -> object:
        if all(camera is None for camera in cameras(0)):
            raise PzcapError("nowhere seen by two cameras")
        return whole.motion

    monkeypatch.setattr(bodies, "triangulated", triangulated)
    monkeypatch.setattr(bodies, "cameras_at", lambda *_: [None, None])
    vars(given)["truth"] = SimpleNamespace(
        camera_names=whole.camera_names, timecodes=whole.timecodes, camera=lambda *_: "true", width=truth.width,
        height=truth.height,
    )  # fmt: skip
    answers = bodies.run_triangulated(given)
    assert answers["triangulated"].missing == "nowhere seen by two cameras"
    assert values(answers["triangulated_true_cameras"])["body.mpjpe.mean"] == pytest.approx(0.0, abs=1e-9)


def test_locked_cameras_that_find_no_body_leave_the_keypoints_theirs(
    given: Given, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, truth = plain.perfect()
    monkeypatch.setattr(bodies.footage, "shot", lambda *_: given.job)
    monkeypatch.setattr(bodies.truth_files, "load", lambda _: truth)
    monkeypatch.setattr(bodies, "read_capture", lambda _: given.capture)
    monkeypatch.setattr(bodies, "replace", _replace)
    monkeypatch.setattr(bodies, "reconstructed", lambda *_: (replace(whole, motion=None), 3.0, 50.0))
    monkeypatch.setattr(bodies, "triangulate", lambda *_: whole.motion)
    answers = bodies.run_locked(given)
    assert answers["locked"].missing == "found no body"
    assert values(answers["locked_triangulated"])["body.mpjpe.mean"] == pytest.approx(0.0, abs=1e-9)


def test_locked_cameras_are_other_footage_of_the_same_motion(given: Given, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def shot(config: Any, *_: object) -> Path:
        asked.append(config.operator.moves)
        return given.job

    whole, truth = plain.perfect()
    assert whole.motion is not None
    moved = replace(whole, motion=replace(whole.motion, joints_m=whole.motion.joints_m + np.array([0.0, 0.02, 0.0])))
    monkeypatch.setattr(bodies.footage, "shot", shot)
    monkeypatch.setattr(bodies.truth_files, "load", lambda _: truth)
    monkeypatch.setattr(bodies, "read_capture", lambda _: given.capture)
    monkeypatch.setattr(bodies, "replace", _replace)
    monkeypatch.setattr(bodies, "reconstructed", lambda *_: (moved, 3.0, 50.0))
    monkeypatch.setattr(bodies, "triangulate", lambda *_: whole.motion)
    answers = bodies.run_locked(given)
    assert asked == ["none"]
    assert {key: values(one)["body.mpjpe.mean"] for key, one in answers.items()} == {
        "locked": pytest.approx(20.0), "locked_triangulated": pytest.approx(0.0, abs=1e-9)
    }  # fmt: skip
    assert values(answers["locked"])["panzoom.completeness"] == 0.0  # cameras of other footage are not answers
    monkeypatch.setattr(bodies.truth_files, "load", lambda _: replace(truth, joints_m=truth.joints_m + 1.0))
    with pytest.raises(PzcapError, match="another motion"):
        bodies.run_locked(given)


def _replace(each: Any, **changes: Any) -> Any:
    return each if isinstance(each, SimpleNamespace) else replace(each, **changes)
