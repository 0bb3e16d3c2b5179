"""Methods of this tree are run once a capture, scored as anybody's files are, and entered."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from experiments.benchmark import __main__ as command
from experiments.benchmark import score, theirs, worst
from experiments.benchmark.methods.given import Answered, Given
from experiments.benchmark.methods.rows import METHODS, RUNS
from experiments.benchmark.tracks import TRACKS
from pzcap.scoring.files import read_results
from pzcap.types import JOINTS, Array, Image, PzcapError, Reconstruction
from tests.scenes import plain, splits

CAPTURES = list(splits.CAPTURES)


def grey(_capture: Path, _camera: str, _frame: int) -> Image:
    return np.full((260, 320, 3), 90, np.uint8)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A split, where a run gives made-up answers and writes into began.txt that it began."""
    place = tmp_path / "9.9" / "dev"
    splits.split(place)
    results, _ = plain.good()

    def run(given: Given) -> dict[str, Answered]:
        name = given.job.name
        with (place / "began.txt").open("a") as began:
            began.write(f"{name}\n")
        found = replace(results, capture=name)
        nobody = replace(found, cameras=(None,) * 4, body=None)
        return {
            "shum_szeliski": Answered(replace(found, own_world=True, body=None), 2.5, 100.0),
            "sinha_pollefeys": Answered(nobody, 0.5, None),
            "wu_radke": Answered(None, 0.0, None, "needs a zoom run"),
        }

    monkeypatch.setitem(RUNS, "self_calibration", run)  # type: ignore[misc]
    monkeypatch.setattr(worst, "frame_image", grey)
    return place


def test_a_run_answers_for_its_methods_once(folder: Path) -> None:
    made = score.score_methods(folder, ["shum_szeliski", "sinha_pollefeys", "wu_radke"], again=False)
    assert [path.stem for path in made] == ["shum_szeliski", "sinha_pollefeys"]  # the third could run nowhere
    assert (folder / "began.txt").read_text().split() == CAPTURES
    score.score_methods(folder, ["shum_szeliski"], again=False)
    assert (folder / "began.txt").read_text().split() == CAPTURES
    took = folder / "runs" / "shum_szeliski" / f"{CAPTURES[1]}.json"
    took.write_text(json.dumps(json.loads(took.read_text()) | {"code": "of yesterday"}))
    score.score_methods(folder, ["shum_szeliski"], again=False)
    assert (folder / "began.txt").read_text().split() == [*CAPTURES, CAPTURES[1]]
    score.score_methods(folder, ["shum_szeliski"], again=True)
    assert (folder / "began.txt").read_text().split() == [*CAPTURES, CAPTURES[1], *CAPTURES]


def test_the_entry_says_what_it_took_and_shows_its_worst(folder: Path) -> None:
    (path,) = score.score_methods(folder, ["shum_szeliski"], again=False)
    entry = json.loads(path.read_text())
    assert entry["claim"] == "reproduced"
    assert entry["seconds"] == 10.0
    assert entry["memory_mib"] == 100.0
    assert entry["command"] == "python -m experiments.benchmark score release=9.9 split=dev methods=[shum_szeliski]"
    assert entry["machine"]
    means = entry["means"]["self_calibration"]
    assert means["panzoom.completeness"] == 100.0
    assert means["panzoom.rotation.common.median"] < 0.1
    assert means["panzoom.pan.rms"] is None
    assert len(entry["worst"]["self_calibration"]) == 3
    for one in entry["worst"]["self_calibration"]:
        assert (path.parent / one["picture"]).is_file()
    assert (path.parent / entry["recording"]).stat().st_size > 10_000


def test_a_method_that_found_nothing_is_a_row_of_zeros(folder: Path) -> None:
    (path,) = score.score_methods(folder, ["sinha_pollefeys"], again=False)
    entry = json.loads(path.read_text())
    assert entry["means"]["self_calibration"]["panzoom.completeness"] == 0.0
    assert entry["worst"]["self_calibration"] == []
    assert read_results(folder / "results" / "sinha_pollefeys" / CAPTURES[0]).cameras[0] is not None


def test_the_command_takes_anybodys_results_and_makes_the_board(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    results = splits.results(folder, "lab", 2.0)
    about = folder / "lab.json"
    about.write_text(json.dumps({"key": "lab", "label": "A lab's", "tracks": ["cameras"]}))
    where = ["release=9.9", "split=dev", f"out={folder.parents[1]}"]

    def said(*arguments: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["benchmark", *arguments])
        status = command.main()
        out = capsys.readouterr()
        return status, out.out, out.err

    assert said("score", *where, f"results={results}", f"entry={about}")[0] == 0
    status, out, _ = said("board", *where)
    assert status == 0
    page = Path(out.strip())
    assert "A lab&#39;s" in page.read_text()
    assert said("score", *where, f"results={results}")[2].startswith("error: results=FOLDER and entry=")
    assert "no method 'our'; did you mean ours" in said("score", *where, "methods=[our]")[2]
    assert "unknown argument 'colour=red'" in said("board", *where, "colour=red")[2]
    assert "no command 'bord'; did you mean board" in said("bord")[2]
    assert "make it first" in said("board", "release=9.9", "split=none", f"out={folder.parents[1]}")[2]


def write_trc(path: Path, joints_m: Array) -> None:
    """Joints under names in capitals, in the axes of Pose2Sim."""
    head = ["PathFileType\t4\t(X/Y/Z)\tx.trc", "DataRate\tUnits", "30\tmm",
            "Frame#\tTime\t" + "\t\t\t".join(name.upper() for name in JOINTS), "\t\tX1"]  # fmt: skip
    places = 1000.0 * joints_m[:, :, [1, 2, 0]]
    path.write_text("\n".join([*head, *("\t".join(map(str, (n + 1, 0, *p.ravel()))) for n, p in enumerate(places))]))


def test_files_of_other_programs_are_entered_as_they_are(folder: Path, tmp_path: Path) -> None:
    for name in CAPTURES:
        write_trc(tmp_path / f"{name}.trc", plain.good()[1].joints_m + 0.02)
    (tmp_path / "names.csv").write_text("theirs,joint\n" + "".join(f"{name.upper()},{name}\n" for name in JOINTS))
    about = tmp_path / "p2s.json"
    about.write_text(json.dumps({"key": "p2s", "label": "Pose2Sim", "tracks": ["everything"]}))
    said = dict.fromkeys(theirs.CONVENTIONS, "")
    with pytest.raises(PzcapError, match="none of its joints"):
        theirs.score_results(folder, tmp_path, about, theirs.conventions(said))
    said = theirs.conventions(said | {"joints": str(tmp_path / "names.csv"), "rate": "30", "first_frame": "0"})
    path = theirs.score_results(folder, tmp_path, about, said)
    entry = json.loads(path.read_text())
    assert entry["means"]["everything"]["body.mpjpe.mean"] == pytest.approx(20.0 * np.sqrt(3.0), rel=1e-3)
    assert all((path.parent / one["picture"]).is_file() for one in entry["worst"]["everything"])
    assert (path.parent / entry["recording"]).is_file()
    assert entry["predictions_sha256"]


@pytest.mark.parametrize(
    ("values", "line"),
    [({"unit": "inch"}, "give m, cm or mm"), ({"rate": "fast"}, "give numbers"), ({"rate": "-1"}, "above 0")],
)
def test_conventions_that_cannot_be_are_refused(values: dict[str, str], line: str) -> None:
    with pytest.raises(PzcapError, match=line):
        theirs.conventions(dict.fromkeys(theirs.CONVENTIONS, "") | values)


def test_an_estimator_of_anyones_is_run_on_the_footage(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = plain.perfect()[0]

    def estimated(_estimator: object, capture: str, name: str) -> Reconstruction:
        if capture == CAPTURES[1]:
            raise PzcapError(f"estimator {name}: has seen nothing")
        return replace(plain.noisy(whole), cameras=(None,) * 4)

    monkeypatch.setattr(theirs.estimators, "estimate", estimated)
    monkeypatch.setattr(theirs, "read_capture", lambda path: path.name)
    about = tmp_path / "lab.json"
    about.write_text(json.dumps({"key": "lab", "label": "A lab's", "tracks": ["cameras"]}))
    path = theirs.score_estimator(folder, "tests.scenes.biased:perfect_tracks", about)
    entry = json.loads(path.read_text())
    assert f"{CAPTURES[1]}: estimator tests.scenes.biased:perfect_tracks: has seen nothing" in capsys.readouterr().err
    assert entry["means"]["cameras"]["panzoom.completeness"] == 75.0
    assert entry["machine"]
    assert entry["seconds"] >= 0.0
    assert read_results(folder / "results" / "lab" / CAPTURES[0]).method == "A lab's"
    about.write_text(about.read_text().replace('"lab"', '"ours"'))
    with pytest.raises(PzcapError, match="key 'ours' is that of a method of this tree"):
        theirs.score_estimator(folder, "tests.scenes.biased:perfect_tracks", about)


def test_every_method_has_a_run_and_tracks() -> None:
    keys = [method.key for method in METHODS]
    assert len(set(keys)) == len(keys)
    for method in METHODS:
        assert method.run in RUNS
        assert set(method.tracks) <= set(TRACKS)
    for track in TRACKS.values():
        assert len(track.columns) > 4


def test_a_split_that_was_not_made_is_said(tmp_path: Path) -> None:
    with pytest.raises(PzcapError, match="make it first"):
        score.score_methods(tmp_path / "dev", [], again=False)
