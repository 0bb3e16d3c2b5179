"""Entries say what was reached and by which files; the board shows them, and every link and picture is there."""

from __future__ import annotations

import json
import shutil
import subprocess
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import cv2
import numpy as np
import pytest

from experiments.benchmark import board, worst
from experiments.benchmark.entries import Description, entry_of, read_description, read_entries, sha256_of, write_entry
from experiments.benchmark.tracks import TRACKS
from pzcap.scoring.score import score
from pzcap.scoring.totals import metrics
from pzcap.types import PzcapError
from tests.scenes import plain, splits

OURS = Description("ours", "pzcap", ("everything", "cameras"), "reproduced", "python -m x", "abc", seconds=12.3)
THEIRS = Description(
    "theirs", "A <b>lab</b>'s", ("cameras",), "claimed", url="https://lab.example/code", published="0.1 deg, own data"
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A split with two entries, pictures and a recording of one."""
    place = tmp_path_factory.mktemp("board") / "dev"
    content = splits.split(place)
    path = splits.entry(place, content, OURS, 1.0)
    splits.entry(place, content, THEIRS, 30.0, lacks=("jump_2",))
    entry = json.loads(path.read_text())
    results, truth = plain.good()
    for track, frames in entry["worst"].items():
        for number, one in enumerate(frames):
            body = track == "everything"
            grey = np.full((truth.image_size[1], truth.image_size[0], 3), 90, np.uint8)
            one["picture"] = f"ours/{track}-{number}.jpg"
            shown = worst.picture(grey, results, truth, one["camera"], one["frame"], body=body)
            assert np.any(shown != 90)
            worst.save_picture(place / "entries" / one["picture"], shown)
    entry["recording"] = "ours/recording.rrd"
    worst.record(place / "entries" / entry["recording"], results, truth, "pzcap", entry["means"]["cameras"])
    write_entry(path, entry)
    return place


@pytest.fixture(scope="module")
def page(folder: Path) -> Path:
    return board.write(folder, folder / "entries")


class Page(HTMLParser):
    """Links, pictures, anchors, tables and text of a page."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.images: list[str] = []
        self.ids: set[str] = set()
        self.tables: list[list[list[str]]] = []
        self.in_cell = False
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {name: value or "" for name, value in attrs}
        self.ids |= {values["id"]} if "id" in values else set()
        if tag == "a":
            self.links.append(values["href"])
        elif tag == "img":
            self.images.append(values["src"])
        elif tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag in ("td", "th"):
            self.in_cell = True
            self.tables[-1][-1].append("")

    def handle_endtag(self, tag: str) -> None:
        self.in_cell = self.in_cell and tag not in ("td", "th")

    def handle_data(self, data: str) -> None:
        if self.in_cell:
            self.tables[-1][-1][-1] += data


def test_an_entry_holds_what_the_files_score(folder: Path) -> None:
    entry = json.loads((folder / "entries" / "ours.json").read_text())
    assert set(entry["scores"]) == {"everything", "cameras"}
    assert list(entry["scores"]["cameras"]) == sorted(splits.CAPTURES)
    assert entry["predictions_sha256"] == sha256_of(folder / "results" / "ours")
    assert entry["suspicious"] == []
    by_size = {name: entry["scores"]["cameras"][name]["panzoom.pan.rms"] for name in splits.CAPTURES}
    assert list(by_size.values()) == sorted(by_size.values())  # as they were made
    mean = entry["means"]["cameras"]["panzoom.pan.rms"]
    assert mean == pytest.approx(np.mean(list(by_size.values())))


def test_the_hash_is_of_the_predictions_and_not_of_what_they_took(folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder / "results" / "ours", tmp_path / "same")
    path = tmp_path / "same" / "walk_1" / "results.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"about": {"seconds": 99.0}}))
    assert sha256_of(tmp_path / "same") == sha256_of(folder / "results" / "ours")
    cameras = tmp_path / "same" / "walk_1" / "cameras.csv"
    cameras.write_text(cameras.read_text().replace("1,0,", "1,0,0", 1))
    assert sha256_of(tmp_path / "same") != sha256_of(folder / "results" / "ours")


def test_a_capture_without_results_counts_as_not_answered(folder: Path) -> None:
    entry = json.loads((folder / "entries" / "theirs.json").read_text())
    assert entry["scores"]["cameras"]["jump_2"] == {}
    assert entry["means"]["cameras"]["panzoom.completeness"] == 75.0


def test_the_worst_frames_are_the_worst(folder: Path) -> None:
    entry = json.loads((folder / "entries" / "ours.json").read_text())
    worst_of_body = [one["error"] for one in entry["worst"]["everything"]]
    assert len(worst_of_body) == 3
    assert worst_of_body == sorted(worst_of_body, reverse=True)
    results, truth = plain.good()
    errors = score(results, truth)
    assert errors.body is not None
    most = 1000.0 * errors.body.joints_m.mean(axis=1)[errors.body.scored].max()
    assert worst_of_body[0] == pytest.approx(most)
    assert entry["worst"]["cameras"][0]["capture"] == "jump_2"  # whose errors are largest


def test_every_link_and_picture_of_the_board_is_there(page: Path) -> None:
    for path in (page, page.parent / board.BREAKS):
        found = Page(path)
        for link in (*found.links, *found.images):
            if link.startswith("https://lab.example"):
                continue
            target, _, anchor = unquote(link).partition("#")
            assert not target or (page.parent / target).is_file(), link
            assert not anchor or target or anchor in found.ids, link
    found = Page(page)
    assert len(found.images) == 3 + 3
    for image in found.images:
        assert cv2.imread(str(page.parent / image)) is not None
    assert any(link.endswith("recording.rrd") for link in found.links)
    assert {"ours.json", "theirs.json"} <= set(found.links)


def test_the_tables_show_the_entries_best_first(page: Path, folder: Path) -> None:
    tables = Page(page).tables
    assert len(tables) == 3  # everything, cameras, and the captures: nobody has entered the others
    cameras = tables[1]
    assert [row[0].split("\n")[0].strip() for row in cameras[1:]] == ["pzcap", "A <b>lab</b>'s"]
    assert len(cameras[0]) == 1 + len(TRACKS["cameras"].columns) + 3
    entry = json.loads((folder / "entries" / "ours.json").read_text())
    shown = dict(zip(TRACKS["cameras"].columns, cameras[1][1:], strict=False))
    assert float(shown["panzoom.pan.rms"]) == pytest.approx(entry["means"]["cameras"]["panzoom.pan.rms"], rel=0.01)
    assert "<b>lab</b>" not in page.read_text()  # what others say is text, not markup
    assert page.read_text().count("Nobody has entered yet.") == len(TRACKS) - 2


def test_who_answers_next_to_nothing_stands_behind_and_is_never_the_best(folder: Path, tmp_path: Path) -> None:
    """The joints of one frame, and right: an error of next to nothing."""
    place = tmp_path / "dev"
    shutil.copytree(folder, place)
    content = splits.split(place)
    results = splits.results(place, "few", 1.0)
    for name in splits.CAPTURES:
        shutil.copy(place / "truth" / name / "joints.csv", results / name / "joints.csv")
        plain.edited(results / name / "joints.csv", lambda rows: [row for row in rows if row["frame"] == "7"])
    few = Description("few", "Few frames", ("everything",))
    write_entry(place / "entries" / "few.json", entry_of(few, results, place / "truth", content))
    shown = Page(board.write(place, place / "entries"))
    labels = [row[0].split()[0] for row in shown.tables[0][1:]]
    assert labels == ["pzcap", "Few"]
    assert (
        'class="best"'
        not in (place / "board" / "index.html").read_text().split('id="everything-few"')[1].split("</tr>")[0]
    )


def test_what_breaks_which_method_has_an_axis_of_what_differs_alone(page: Path, folder: Path) -> None:
    content = json.loads((folder / "captures.json").read_text())
    axes = {axis.name: axis for axis in board.axes_of(content)}
    assert axes["noise"].values == ("2", "4", "8")
    assert axes["noise"].captures == ("walk_1", "walk_1_noise-4", "walk_1_noise-8")
    assert axes["motion"].values == ("walk", "jump")  # of other seeds, for want of the same
    text = (page.parent / board.BREAKS).read_text()
    assert text.count("<svg") == 2 * 2  # two axes, two tracks that anybody entered
    assert "nan" not in text.lower().replace("nance", "")


def test_what_a_method_fails_at_is_named(page: Path) -> None:
    (table,) = Page(page.parent / board.BREAKS).tables
    assert table[:3] == [["fails at", "noise", "motion"], ["Everything"], ["pzcap", "–", "–"]]
    # it has no results of that capture
    assert table[3:] == [["Cameras alone"], ["pzcap", "–", "–"], ["A <b>lab</b>'s", "–", "jump"]]


def test_values_of_an_axis_have_their_unit_where_the_release_says_it(folder: Path, tmp_path: Path) -> None:
    copied = tmp_path / "dev"
    shutil.copytree(folder, copied)
    content = json.loads((copied / "captures.json").read_text())
    (copied / "captures.json").write_text(json.dumps(content | {"units": {"noise": "grey levels"}}))
    shown = board.write(copied, copied / "entries").parent / board.BREAKS
    assert Page(shown).tables[0][0] == ["fails at", "noisegrey levels", "motion"]
    assert "noise [grey levels]: Everything" in shown.read_text(encoding="utf-8")


def test_one_file_added_is_one_row_more(folder: Path, tmp_path: Path) -> None:
    copied = tmp_path / "dev"
    shutil.copytree(folder, copied)
    before = Page(board.write(copied, copied / "entries")).tables[1]
    content = json.loads((copied / "captures.json").read_text())
    splits.entry(copied, content, Description("new", "new", ("cameras",)), 5.0)
    after = Page(board.write(copied, copied / "entries")).tables[1]
    assert [row[0].split()[0] for row in after[1:]] == ["pzcap", "new", "A"]
    assert len(after) == len(before) + 1


@pytest.mark.slow
def test_a_browser_shows_it(page: Path, tmp_path: Path) -> None:
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("needs chromium")
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", f"--user-data-dir={tmp_path}"]
    done = subprocess.run(
        [browser, *options, "--virtual-time-budget=4000", "--dump-dom", page.as_uri()], capture_output=True, text=True,
        timeout=240, check=False,
    )  # fmt: skip
    assert "Benchmark 9.9, dev" in done.stdout
    (tmp_path / "dom.html").write_text(done.stdout)
    drawn = Page(tmp_path / "dom.html")
    assert [len(table) for table in drawn.tables] == [len(table) for table in Page(page).tables]
    shot = tmp_path / "shot.png"
    size = "--window-size=1300,1200"
    subprocess.run([browser, *options, size, f"--screenshot={shot}", page.as_uri()], timeout=240, check=True,
                   capture_output=True)  # fmt: skip
    image = cv2.imread(str(shot))
    assert image is not None
    assert image.shape[:2] == (1200, 1300)
    assert 0.005 < np.mean(image < 128) < 0.5  # text and plots on white


def test_the_recording_holds_truth_found_and_errors(folder: Path) -> None:
    path = folder / "entries" / "ours" / "recording.rrd"
    import rerun as rr

    entities = {
        str(column).partition(":")[0]
        for column in rr.dataframe.load_recording(path).schema().component_columns()
    } if hasattr(rr, "dataframe") else None  # fmt: skip
    assert path.stat().st_size > 10_000
    assert entities is None or any("/error/pan/1" in entity for entity in entities)


def test_errors_of_cameras_are_drawn_where_they_are() -> None:
    results, truth = plain.good()
    grey = np.full((truth.image_size[1], truth.image_size[0], 3), 90, np.uint8)
    shown = worst.picture(grey, results, truth, "1", 3, body=False)
    orange = np.all(np.abs(shown.astype(int) - [40, 120, 255]) < 20, axis=2)
    assert 50 < orange.sum() < 20_000
    none = replace(results, cameras=(None, *results.cameras[1:]))
    assert np.array_equal(worst.picture(grey, none, truth, "1", 3, body=False), grey)


def description(**values: Any) -> str:
    return json.dumps({"key": "mine", "label": "mine", "tracks": ["cameras"]} | values)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (description(tracks=["camera"]), "no track 'camera'; did you mean cameras"),
        (description(tracks=[]), "enters no track"),
        (description(key="../x"), "key '../x'"),
        (description(claim="won"), "claim"),
        (description(colour="red"), "unknown key 'colour'"),
        ("[", "no readable description"),
    ],
)
def test_a_description_that_does_not_fit_is_refused(text: str, line: str, tmp_path: Path) -> None:
    (tmp_path / "d.json").write_text(text)
    with pytest.raises(PzcapError, match=line):
        read_description(tmp_path / "d.json")


def test_results_that_are_suspicious_say_so_on_the_board(folder: Path, tmp_path: Path) -> None:
    copied = tmp_path / "dev"
    shutil.copytree(folder, copied)
    content = json.loads((copied / "captures.json").read_text())
    results = splits.results(copied, "odd", 1.0)
    for path in results.glob("*/cameras.csv"):
        plain.edited(path, lambda rows: [row | {"pan_rad": str(-float(row["pan_rad"]))} for row in rows])
    made = entry_of(Description("odd", "odd", ("cameras",)), results, copied / "truth", content)
    assert any("positive to the right" in line for line in made["suspicious"])
    write_entry(copied / "entries" / "odd.json", made)
    assert "positive to the right" in board.write(copied, copied / "entries").read_text()


def test_what_is_no_entry_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PzcapError, match="holds no entry; score a method first"):
        read_entries(tmp_path)
    (tmp_path / "x.json").write_text('{"format": "pzcap-entry", "version": 1, "key": "x"}')
    with pytest.raises(PzcapError, match="no entry of the board"):
        read_entries(tmp_path)


def test_files_and_memory_agree_for_an_entry(folder: Path) -> None:
    """What the board says of a capture is what the records in memory score, to the last digit."""
    from pzcap.scoring.files import read_results
    from pzcap.scoring.truth_files import read_truth

    entry = json.loads((folder / "entries" / "ours.json").read_text())
    for name in splits.CAPTURES:
        again = score(read_results(folder / "results" / "ours" / name), read_truth(folder / "truth" / name))
        assert {m.key: m.value for m in metrics(again)} == entry["scores"]["cameras"][name]


def test_no_two_of_twenty_entries_look_the_same() -> None:
    looks = {(style["color"], style["marker"]) for style in map(board._style, range(20))}
    assert len(looks) == 20
