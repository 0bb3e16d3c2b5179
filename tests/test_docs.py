"""The pages lead nowhere that is not there, and what they show runs."""

from __future__ import annotations

import importlib.util
import pkgutil
import re
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

import pzcap
from experiments import settings_reference
from experiments.config import AppConfig, default_tree, keys, leaves
from sim.motion import MotionClip
from sim.people.anthropometry import draw_measurements

ROOT = Path(__file__).parents[1]
PAGES = sorted([ROOT / "README.md", *(page for page in (ROOT / "docs").rglob("*.md") if page.stem != "configuration")])
EXAMPLES = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")


def anchors(page: Path) -> set[str]:
    """Of its headings, as GitHub makes them."""
    titles = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.M)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def spine() -> list[str]:
    """Modules that the library lists as such."""
    assert pzcap.__doc__ is not None
    listed = pzcap.__doc__.split("skip:\n", 1)[1].split("Beside", 1)[0]
    names: list[str] = []
    for line in re.findall(r"^    (\S.*?)(?:  .*)?$", listed, re.M):
        for name in re.split(r", *", line):
            names.append(names[-1].rpartition(".")[0] + name if name.startswith(".") else name)
    return names


def test_the_spine_is_as_long_as_it_says() -> None:
    modules = [ROOT / "pzcap" / f"{name.replace('.', '/')}.py" for name in spine()]
    lines = sum(len(module.read_text(encoding="utf-8").splitlines()) for module in modules)
    assert 3800 < lines <= 3900
    assert f"{len(modules)} modules of 3,900" in (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: f"{page.parent.name}/{page.name}")
def test_no_link_is_dead(page: Path) -> None:
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.S)
    for link in re.findall(r"\]\(([^)]+)\)", text):
        place, _, anchor = link.partition("#")
        if "://" in place or place == "configuration.md":  # which `make docs` writes
            continue
        target = (page.parent / place) if place else page
        assert target.exists(), f"{page.name}: {link}"
        assert not anchor or anchor in anchors(target), f"{page.name}: {link}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: f"{page.parent.name}/{page.name}")
def test_every_command_is_there(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    targets = re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M)
    for module in set(re.findall(r"python -m ([\w.]+)", text)) - {"venv", "pip"}:
        assert importlib.util.find_spec(module) is not None, f"{page.name}: python -m {module}"
    assert set(re.findall(r"^make (\w+)", text, re.M)) <= set(targets)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: f"{page.parent.name}/{page.name}")
def test_every_setting_experiment_study_and_name_is_there(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert set(re.findall(r"(?<![\w./])((?:shoot|reconstruct|output)(?:\.\w+)+)", text)) <= set(keys(default_tree()))
    for group, names in re.findall(r"\b(experiment|study)=([\w|,]+)", text):
        for name in set(re.split(r"[|,]", names)) - {"NAME", "dusk", "shutter"}:  # the last two are shown as examples
            assert (ROOT / "conf" / group / f"{name}.yaml").exists(), f"{page.name}: {group}={name}"
    for name in set(re.findall(r"`((?:pzcap|sim|experiments)(?:\.\w+)+)[`(]", text)):
        pkgutil.resolve_name(name)  # or ImportError, AttributeError


def test_every_setting_is_in_the_reference_and_told_from_the_source() -> None:
    page, texts = settings_reference.markdown(), settings_reference.descriptions()
    for key in leaves(default_tree()):
        assert f"| `{key}` |" in page
        assert texts.get(key), key
    told = "Standard deviation, grey levels. It does not depend on the light; 2 of 255 is what a lit hall leaves."
    assert f"| `shoot.sensor.read_noise` | `2.0` | from 0 to 128 | {told} |" in page
    assert (AppConfig.__doc__ or "") in page


def test_the_motion_that_is_shown_can_be_filmed() -> None:
    (source,) = re.findall(r"```python\n(.*?)```", EXAMPLES, re.S)
    names: dict[str, object] = {}
    exec(compile(source, "extending.md", "exec"), names)
    rng = np.random.default_rng(0)
    clip = names["make"](draw_measurements(rng), rng)  # type: ignore[operator]
    assert isinstance(clip, MotionClip)
    times = np.linspace(0.0, clip.duration_s, 40)
    assert not any(clip.airborne(time) for time in times)
    heights = [clip.at(time).root_position_m[2] for time in times]
    assert 0.15 < max(heights) - min(heights) < 0.4


@pytest.mark.parametrize("group", ["experiment", "study"])
def test_the_yaml_that_is_shown_composes(group: str, tmp_path: Path) -> None:
    blocks = re.findall(r"```yaml\n(.*?)```", EXAMPLES, re.S)
    block = next(block for block in blocks if ("sweeper" in block) == (group == "study"))
    here = tmp_path / group
    here.mkdir()
    for shared in (ROOT / "conf" / group).glob("_*.yaml"):
        (here / shared.name).write_text(shared.read_text())
    (here / "shown.yaml").write_text(textwrap.dedent(block))
    line = [
        sys.executable,
        "-m",
        "experiments.run",
        f"hydra.searchpath=[file://{tmp_path}]",
        f"{group}=shown",
        "--cfg=job",
    ]
    done = subprocess.run(line, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "shutter_s" in done.stdout


@pytest.mark.slow
def test_the_site_is_built_without_a_warning(tmp_path: Path) -> None:
    if importlib.util.find_spec("myst_parser") is None:
        pytest.skip("needs Sphinx: pip install pzcap[docs]")
    line = [sys.executable, "-m", "sphinx", "-q", "-n", "-W", "-b", "html", "docs", str(tmp_path / "site")]
    done = subprocess.run(line, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    told = settings_reference.descriptions()["shoot.sensor.read_noise"].split(";")[0].split(".")[0]
    assert told
    assert told in (tmp_path / "site" / "configuration.html").read_text(encoding="utf-8")
