"""An estimator of anyone's is scored as ours is, and one that does not fit is refused in one line."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hydra.core.global_hydra import GlobalHydra

from experiments import estimators, run
from experiments.metrics import read_metrics
from pzcap.io import results
from pzcap.io.capture import read_capture
from pzcap.types import Capture, PanZoomTrack, PzcapError
from tests.scenes import biased

if TYPE_CHECKING:
    from experiments.testing import ScoreEstimator

pytest_plugins = ["experiments.testing"]
pytestmark = pytest.mark.xdist_group("experiments")

GUIDE = Path(__file__).parents[2] / "docs" / "estimators.md"


@pytest.fixture(scope="session")
def pzcap_capture(small_capture: Path) -> Path:
    return small_capture / "capture"


@pytest.fixture
def capture(pzcap_capture: Path) -> Capture:
    return read_capture(pzcap_capture)


def biased_tracks(degrees: float) -> Callable[[Capture], list[PanZoomTrack | None]]:
    def estimator(capture: Capture) -> list[PanZoomTrack | None]:
        return [
            None if track is None else dataclasses.replace(track, pan_rad=track.pan_rad + np.deg2rad(degrees))
            for track in biased.perfect_tracks(capture)
        ]

    return estimator


def test_tracks_are_scored_and_nothing_else_is(score_estimator: ScoreEstimator) -> None:
    found = score_estimator(biased_tracks(0.01))
    assert found["panzoom.pan.rms"].value == pytest.approx(0.01, rel=1e-6)
    assert found["panzoom.focal.rms"].value == pytest.approx(0.0, abs=1e-9)
    assert found["panzoom.lost"].value == 0.0
    assert found["body.mpjpe.mean"].value is None


def test_a_motion_is_scored_and_no_camera_is_called_lost(score_estimator: ScoreEstimator) -> None:
    found = score_estimator(biased.perfect_motion)
    assert found["body.mpjpe.mean"].value == pytest.approx(0.0, abs=1e-9)
    assert found["panzoom.lost"].value is None


def test_the_example_of_the_guide_runs(score_estimator: ScoreEstimator) -> None:
    example, test = re.findall(r"```python\n(.*?)```", GUIDE.read_text(encoding="utf-8"), flags=re.DOTALL)
    assert len(example.strip().splitlines()) <= 12
    names: dict[str, Any] = {}
    exec(example + test, names)
    names["test_pan_is_near"](score_estimator)


@pytest.mark.parametrize("estimator", ["perfect_tracks", "perfect_motion"])
def test_a_run_with_it_leaves_what_a_run_leaves(
    estimator: str, pzcap_capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = f"tests.scenes.biased:{estimator}"
    arguments = [f"estimator={name}", f"capture={pzcap_capture}", f"hydra.run.dir={tmp_path}"]
    monkeypatch.setattr("sys.argv", ["run", *arguments])
    GlobalHydra.instance().clear()
    assert run.main() == 0
    found, info = read_metrics(tmp_path / "metrics.json")
    values = {metric.key: metric.value for metric in found}
    assert values["body.mpjpe.mean" if estimator == "perfect_motion" else "panzoom.pan.rms"] == pytest.approx(0.0)
    assert values["speed.fps"] > 0.0
    assert info["config"]["estimator"] == name
    assert results.load(tmp_path / "reconstruction").method == name
    assert {"report.html", "recording.rrd"} <= {path.name for path in tmp_path.iterdir()}


def test_a_sweep_over_estimators_goes_on_where_it_was(
    pzcap_capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    both = "estimator=tests.scenes.biased:perfect_tracks,tests.scenes.biased:perfect_motion"
    quick = ["output.recording=false", f"capture={pzcap_capture}", f"hydra.sweep.dir={tmp_path}"]
    monkeypatch.setattr("sys.argv", ["run", "-m", both, *quick])
    for before in (0, 2):
        GlobalHydra.instance().clear()
        assert run.main() == 0
        assert f"2 jobs: {before} done before" in capsys.readouterr().err
    folders = sorted((tmp_path / "floor_exercise").iterdir())
    assert [{path.name for path in folder.iterdir()} for folder in folders] == [
        {".hydra", "job.json", "metrics.json", "report.html", "reconstruction", "capture"}
    ] * 2
    assert "perfect_motion" in folders[0].name
    page = (folders[0] / "report.html").read_text(encoding="utf-8")
    assert re.search(r"python -m experiments\.run \S*estimator=tests\.scenes\.biased\S*perfect_motion\S* ", page)


def test_its_settings_are_swept(
    pzcap_capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    quick = ["output.recording=false", "output.report=false", f"capture={pzcap_capture}", f"hydra.sweep.dir={tmp_path}"]
    off = ["estimator=tests.scenes.biased:tracks_off", "+settings.by_deg=0.0,0.5"]
    monkeypatch.setattr("sys.argv", ["run", "-m", *off, *quick])
    GlobalHydra.instance().clear()
    assert run.main() == 0
    found = [read_metrics(path)[0] for path in sorted((tmp_path / "floor_exercise").glob("*/metrics.json"))]
    pans = [next(metric.value for metric in some if metric.key == "panzoom.pan.rms") for some in found]
    assert pans == [pytest.approx(0.0), pytest.approx(0.5)]
    assert "settings.by_deg" in (tmp_path / "index.html").read_text(encoding="utf-8")
    capsys.readouterr()
    for wrong, says in (
        ([off[0], "+settings.by_dg=1"], "takes no setting 'by_dg'; did you mean by_deg?"),
        ([off[0], "settings.by_deg=1"], "are added: +settings.by_deg=VALUE"),
        (["estimator=tests.scenes.biased:perfect_tracks", "+settings.x=1"], "it takes the capture alone"),
        (["+settings.x=1"], "settings are those of an estimator of one's own"),
    ):
        monkeypatch.setattr("sys.argv", ["run", *wrong, *quick[:3], f"hydra.run.dir={tmp_path / 'wrong'}"])
        GlobalHydra.instance().clear()
        assert run.main() == 1
        assert says in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("tests.scenes.biased", "give module:function"),
        ("tests.scenes.biased:", "give module:function"),
        ("no_such_lab.trackers:follow", "no module 'no_such_lab'"),
        ("tests.no_such:follow", "no module 'tests.no_such'"),
        ("tests.scenes.biased:perfect_track", "did you mean perfect_tracks"),
        ("tests.scenes.biased:__doc__", "no function '__doc__'"),
    ],
)
def test_a_wrong_name_gets_one_line(name: str, says: str) -> None:
    with pytest.raises(PzcapError) as error:
        estimators.find(name)
    assert says in str(error.value)
    assert "\n" not in str(error.value)


def test_a_module_that_lacks_another_says_which(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "my_lab_tracker.py").write_text("import no_such_package\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(PzcapError, match="my_lab_tracker needs a module 'no_such_package'"):
        estimators.find("my_lab_tracker:follow")


def test_what_it_finds_it_gives_back() -> None:
    assert estimators.find("tests.scenes.biased:perfect_tracks") is biased.perfect_tracks
    assert estimators.source("tests.scenes.biased:perfect_tracks") == Path(biased.__file__)
    assert estimators.source("no_such_lab.trackers:follow") is None


def changed(**arrays: Any) -> Callable[[Capture], Any]:
    def estimator(capture: Capture) -> Any:
        tracks = biased.perfect_tracks(capture)
        assert tracks[1] is not None
        return [tracks[0], dataclasses.replace(tracks[1], **arrays), *tracks[2:]]

    return estimator


@pytest.mark.parametrize(
    ("estimator", "says"),
    [
        (biased.a_dict, "returned a dict; return a PanZoomTrack a camera"),
        (lambda _: [1.0, 2.0, 3.0, 4.0], "returned a list with a float in it"),
        (lambda _: None, "returned a NoneType"),
        (lambda capture: biased.perfect_tracks(capture)[:3], "3 tracks for 4 cameras"),
        (changed(pan_rad=np.zeros(3)), "track of camera 2: pan_rad has shape (3,), not (8,)"),
        (changed(pan_rad=np.full(8, np.nan)), "track of camera 2: pan_rad is not finite where valid"),
        (changed(focal_px="long"), "track of camera 2: focal_px is no array of numbers"),
        (
            lambda capture: dataclasses.replace(biased.perfect_motion(capture), keyframes=np.array([8])),
            "motion: keyframes are not indices of its 8 frame sets",
        ),
        (
            lambda capture: dataclasses.replace(biased.perfect_motion(capture), joints_m=np.zeros((8, 17, 3))),
            "motion: joints_m has shape (8, 17, 3), not (8, 16, 3)",
        ),
    ],
)
def test_what_is_no_estimate_gets_one_line(estimator: Any, says: str, capture: Capture) -> None:
    with pytest.raises(PzcapError) as error:
        estimators.estimate(estimator, capture, "lab:it")
    assert str(error.value).startswith("estimator lab:it")
    assert says in str(error.value)
    assert "\n" not in str(error.value)


def test_lists_pass_for_arrays_and_a_lost_frame_may_hold_anything(capture: Capture) -> None:
    valid = [True] * 7 + [False]
    found = estimators.estimate(changed(pan_rad=[0.1] * 7 + [np.nan], valid=valid), capture, "lab:it").tracks[1]
    assert found is not None
    assert found.valid.tolist() == valid
    assert found.pan_rad[7] == 0.0


def test_a_bug_in_it_keeps_its_traceback(capture: Capture) -> None:
    def bug(_: Capture) -> Any:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        estimators.estimate(bug, capture, "lab:it")
