"""Tools that know fixed cameras alone: what they write is read as they mean it, and without them a line says so. That
they run, and what they find, is in tests/clients."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from experiments.comparisons import fixed_tools, harness, operators
from experiments.comparisons.fixed_tools import LIMBS, clients, read_pose2sim
from experiments.config import AppConfig
from pzcap.types import JOINTS, PzcapError
from tests.scenes import exported


def test_pose2sim_turns_the_world_upright(tmp_path: Path) -> None:
    """Its X is our y, its Y our z, its Z our x; a row that it could not fill is blank."""
    names = ["Hip", *(f"{limb[0].upper()}{limb.split('_')[1].capitalize()}" for limb in LIMBS)]
    rows = []
    for frame in range(3):
        places = [[100 * k + frame, 0.5, -k] for k in range(len(names))]
        cells = ["" if frame == 1 else str(value) for place in places for value in place]
        rows.append("\t".join([str(frame + 1), f"{frame / 30:.5f}", *cells]))
    head = ["PathFileType", "DataRate", "30", "Frame#\tTime\t" + "\t\t\t".join(names) + "\t\t", "\t\tX1\tY1\tZ1"]
    (tmp_path / "a.trc").write_text("\n".join([*head, *rows]) + "\n")
    found = read_pose2sim(tmp_path / "a.trc", 4, 30.0)
    for k in range(len(LIMBS)):
        np.testing.assert_allclose(found[2, k], [-(k + 1), 100 * (k + 1) + 2, 0.5])
    assert np.isnan(found[1]).all()
    assert np.isnan(found[3]).all()


def test_a_tool_that_fails_is_told_by_its_last_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PZCAP_CLIENTS", str(tmp_path))
    assert not clients.installed("pose2sim")
    python = tmp_path / "pose2sim" / "bin" / "python"
    python.parent.mkdir(parents=True)
    python.write_text("#!/bin/sh\necho first >&2\necho it does not work >&2\nexit 3\n")
    python.chmod(0o755)
    assert clients.installed("pose2sim")
    with pytest.raises(PzcapError, match="pose2sim: it does not work"):
        clients.run("pose2sim", tmp_path / "script.py", folder=tmp_path)


@pytest.fixture
def material(monkeypatch: pytest.MonkeyPatch) -> Any:
    """A take whose joints are the truth, and a capture with keypoints."""
    whole = exported.reconstruction()
    assert whole.motion is not None
    truth = SimpleNamespace(joints_m=whole.motion.joints_m, timecodes=whole.timecodes)
    capture = SimpleNamespace(cameras=(SimpleNamespace(keypoints=Path("k")),), folder=Path("capture"))
    monkeypatch.setattr(fixed_tools, "on_keypoints", lambda *_: (capture, truth, whole, whole))
    monkeypatch.setattr(fixed_tools, "triangulate", lambda *_: whole.motion)
    monkeypatch.setattr(fixed_tools, "Bars", lambda _: nullcontext(SimpleNamespace(update=lambda *_: None)))
    return whole


def test_what_is_not_installed_has_a_line(material: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    del material
    monkeypatch.setenv("PZCAP_CLIENTS", str(tmp_path))
    rows = {row.key: row for row in fixed_tools.compare(AppConfig(), tmp_path, Console())}
    assert rows["pose2sim"].missing == rows["aniposelib"].missing == "not installed: make test-clients"
    assert rows["joined"].figures["mean"] == pytest.approx(0.0)


def test_errors_are_of_the_joints_that_all_have(material: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own = [JOINTS.index(limb) for limb in LIMBS]
    off = material.motion.joints_m[:, own] + [0.03, 0.0, 0.04]
    holes = off.copy()
    holes[5, 2] = np.nan
    monkeypatch.setattr(fixed_tools, "installed", lambda _: True)
    monkeypatch.setattr(fixed_tools, "TOOLS", {"pose2sim": lambda *_: off, "aniposelib": lambda *_: holes})
    rows = {row.key: row for row in fixed_tools.compare(AppConfig(), tmp_path, Console())}
    assert rows["pose2sim"].figures["mean"] == pytest.approx(50.0)
    assert rows["pose2sim"].figures["missing"] == 0.0
    frames = len(off) - 1  # the keyframe does not count
    assert rows["aniposelib"].figures["missing"] == pytest.approx(100.0 / (frames * len(LIMBS)))


def test_cameras_of_earlier_results_are_taken_or_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Never passed over: by one that does not take them, they are refused; by one that does, they are read."""
    given = AppConfig(cameras=str(tmp_path / "nowhere"))
    with pytest.raises(PzcapError, match=r"comparison operators calibrates by itself; leave cameras=\.\.\. out"):
        harness.execute(operators.COMPARISON, given, {}, tmp_path, Console())
    monkeypatch.setattr(harness, "scored_capture", None)
    with pytest.raises(PzcapError, match="nowhere"):
        harness.execute(fixed_tools.COMPARISON, given, {}, tmp_path / "f", Console())
