"""Whatever a capture, a camera, a note or a folder is called, pages and the terminal show it letter by letter."""

from __future__ import annotations

import dataclasses
import io
import json
import re
import shutil
from fractions import Fraction
from html.parser import HTMLParser
from pathlib import Path

import pytest
from matplotlib.figure import Figure
from rich.table import Table

from experiments import terminal
from experiments.comparisons.harness import Row, print_rows
from experiments.comparisons.peers import COMPARISON
from experiments.config import default_tree
from experiments.metrics import run_info
from experiments.paper_figures import page
from experiments.paper_figures.canvas import Drawn
from experiments.paper_figures.material import Run
from experiments.progress import Bars
from experiments.report import page as report
from experiments.report import plots
from experiments.run import main, print_table
from experiments.studies import jobs
from experiments.studies import page as study_page
from pzcap.io import results
from pzcap.scoring.metric import Metric
from pzcap.types import CameraFiles, Capture
from tests.scenes import fabricated
from tests.scenes.studies import NOISE, grid

ROOT = Path(__file__).parents[2]
NAMES = (
    "<script>alert(1)</script>",
    '"><img src=x onerror=alert(1)>',
    "'><svg/onload=alert(1)>",
    "[/b] [bold]x[/] [link=x] :smile: {0} $\\frac$ %s",
)


class Elements(HTMLParser):
    """All that a page consists of, as a browser reads it."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.handlers: list[str] = []
        self.text = ""
        self.feed(str(text))  # of Markup, escape() would not be that of a str
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.handlers += [name for name, _ in attrs if name.startswith("on")]
        self.text += " ".join(value or "" for _, value in attrs)

    def handle_data(self, data: str) -> None:
        self.text += data


def harmless(path: Path, *shown: str) -> None:
    """Asserts that a page runs nothing and shows these texts."""
    text = path.read_text(encoding="utf-8")
    found = Elements(text)
    assert "script" not in found.tags
    assert not found.handlers
    for name in shown:
        assert name in found.text


def test_the_report(tmp_path: Path) -> None:
    whole = fabricated.reconstruction()
    whole = dataclasses.replace(
        whole, capture_name=NAMES[0], method=NAMES[1], camera_names=NAMES, notes=NAMES, tracks=(None,) * 4, motion=None
    )
    cameras = tuple(CameraFiles(name, None, None, None, None) for name in NAMES)
    capture = Capture(tmp_path, NAMES[0], Fraction(30), cameras, None, None, {}, full_turn=True)
    tree = default_tree() | {"capture": NAMES[0], "estimator": NAMES[1]}
    material = report.Material(
        capture, whole, None, None, [Metric("speed.fps", 1.0, NAMES[1])], run_info(tree, 0), {}, {"prepare": 1.0}
    )  # fmt: skip
    report.write_report(tmp_path / "report.html", material, NAMES[0])
    harmless(tmp_path / "report.html", *NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_the_page_of_a_study(name: str, tmp_path: Path) -> None:
    folder = tmp_path / name.replace("/", "∕")
    places = grid(folder, {NOISE: [0, 4], "estimator": ["one", "two"]})
    for place in places:
        metrics = json.loads((place / "metrics.json").read_text())
        metrics["_run"]["config"]["estimator"] += name
        (place / "metrics.json").write_text(json.dumps(metrics))
        mark = json.loads((place / jobs.MARK).read_text())
        mark["overrides"] = [one + name if one.startswith("estimator") else one for one in mark["overrides"]]
        (place / jobs.MARK).write_text(json.dumps(mark))
    places[0] = places[0].rename(folder / name.replace("/", "∕"))
    broken = folder / "broken"
    broken.mkdir()
    (broken / jobs.FAILED).write_text(name + "\n")
    assert study_page.write_study(folder, [*places, broken])
    harmless(folder / study_page.PAGE, name, places[0].name)


def test_the_page_of_the_figures(tmp_path: Path) -> None:
    whole = dataclasses.replace(fabricated.reconstruction(), capture_name=NAMES[0])
    run = Run(whole, None, None, (), lambda _: ())
    drawn = Drawn(11, "stem", NAMES[1], NAMES[2], Figure())
    page.write_page(tmp_path, [drawn], [run], NAMES[3])
    harmless(tmp_path / page.PAGE, *NAMES)


def test_no_template_lets_text_through() -> None:
    for path in (ROOT / "experiments" / "templates").iterdir():
        text = path.read_text(encoding="utf-8")
        assert not re.search(r"\|\s*safe\b|autoescape|<script", text), path
    loading = [path.name for path in (ROOT / "experiments").rglob("*.py") if "jinja2" in path.read_text()]
    assert loading == ["pages.py"]


def test_names_are_drawn_letter_by_letter() -> None:
    drawn = plots.pan_zoom(dataclasses.replace(fabricated.reconstruction(), camera_names=NAMES), None, None)
    found = Elements(drawn)
    assert "script" not in found.tags
    for name in NAMES:
        assert f"Camera {name}" in found.text


# --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_the_terminal(name: str) -> None:
    out = terminal.terminal(file=io.StringIO(), width=300, record=True)
    table = Table(name, title=name)
    table.add_row(name)
    out.print(table)
    out.print(name)
    with Bars(out) as bars:
        bars.update(f"camera {name}: sweep", 1, 2)
    assert out.export_text().count(name) >= 5


@pytest.mark.parametrize("name", NAMES)
def test_the_tables(name: str) -> None:
    out = terminal.terminal(file=io.StringIO(), width=300, record=True)
    print_table(out, name, [Metric("body.mpjpe.mean", 1.0, "mm")])
    print_rows(out, COMPARISON, name, [Row("hugin", "Hugin", {}, missing=name)])
    text = out.export_text()
    assert " ".join(text.split()).count(name) == 3
    assert "reached" in text


def test_all_commands_print_to_that_terminal() -> None:
    for path in (ROOT / "experiments").rglob("*.py"):
        made = re.search(r"(?<![\w.])Console\(", path.read_text(encoding="utf-8"))
        assert (made is not None) == (path.name == "terminal.py"), path


@pytest.mark.slow
@pytest.mark.xdist_group("experiments")
def test_a_run_to_its_end(
    small_capture: Path, finished: tuple[Path, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    """The last camera is calibrated, the others are known."""
    footage = tmp_path / "take [/b] :smile:"
    shutil.copytree(small_capture / "capture", footage)
    manifest = json.loads((footage / "capture.json").read_text())
    manifest["name"] = NAMES[0]
    for camera, name in zip(manifest["cameras"], NAMES, strict=True):
        camera["name"] = name
    (footage / "capture.json").write_text(json.dumps(manifest))
    known = dataclasses.replace(results.load(finished[0] / "reconstruction"), camera_names=(*NAMES[:3], "another"))
    results.save(known, tmp_path / "take before")
    folder = tmp_path / "run [bold]"
    given = f"capture='{footage}'", f"cameras='{tmp_path / 'take before'}'", f"hydra.run.dir='{folder}'"
    monkeypatch.setattr("sys.argv", ["experiments.run", *given])
    assert main() == 0
    out, err = capfd.readouterr()
    assert str(footage) in out.replace("\n", "")
    assert f"{folder}/report.html" in out
    assert "[/b] [bold]x[/]" in err
    harmless(folder / "report.html", *NAMES)
