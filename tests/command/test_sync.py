"""`pzcap sync` and `pzcap new` on cameras without timecode: sync.json, or a clear word that it is not known."""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from pzcap.command.main import main
from pzcap.io.capture import frame_sets, read_capture
from sim.capture_writer import write_video
from sim.hall import sound
from tests.scenes.recorders import number, pictures

RATE, FRAMES = Fraction(30), 60
EARLY = {"a": 0, "b": 7, "c": -12}
"""Frames by which each camera was started before the first."""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Three cameras, started one after the other, whose crew claps; the picture tells the time."""
    rng = np.random.default_rng(0)
    claps = [(at, np.zeros(3), sound.clap(rng)) for at in (0.6, 0.91, 1.34)]
    fan = rng.normal(size=14 * sound.SAMPLES_PER_S)
    for k, (name, early) in enumerate(EARLY.items()):
        (tmp_path / name).mkdir()
        place = 12.0 * np.array([np.cos(2.0 * k), np.sin(2.0 * k), 0.0])
        heard = sound.recorded(
            claps, np.array([9.0, -6.0, 4.0]), fan, place, -early / 30, 1.0, FRAMES / 30, np.random.default_rng(k)
        )
        shown = pictures(FRAMES + 20)[12 - early : 12 - early + FRAMES] if early <= 12 else []
        write_video(tmp_path / name / "motion.mp4", shown, RATE, crf=6, sound=heard)
    return tmp_path


def test_a_crew_that_claps_needs_no_timecode(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["new", str(folder)]) == 1  # there is no still, and no sweep
    said = capsys.readouterr().out
    assert "sync by sound: known" in said
    assert "NOT KNOWN" not in said
    capture = read_capture(folder)
    assert capture.sync is not None
    for name, early in EARLY.items():
        assert capture.sync[name].offset_s == pytest.approx(-early / 30, abs=0.012)
        assert capture.sync[name].by == "sound"
    sets = frame_sets(capture)
    for each in sets:
        assert len({number(image) for image in each.images if image is not None}) == 1
    assert sets.timecodes[0] == "00:00:00:12"  # the first camera's first picture is 00:00:00:00


def test_what_is_not_known_is_said_and_nothing_is_written(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["new", str(folder)])
    (folder / "sync.json").unlink()
    manifest = json.loads((folder / "capture.json").read_text())
    (folder / "capture.json").write_text(json.dumps({**manifest, "sync": None}))
    capsys.readouterr()
    assert main(["sync", str(folder), "--by", "motion"]) == 1
    said = capsys.readouterr().out
    assert "sync by motion: no two cameras can be brought together" in said
    assert "sync: NOT KNOWN how the cameras lie to each other; clap" in said
    assert not (folder / "sync.json").exists()
    assert main(["check", str(folder)]) == 1
    assert "pzcap sync FOLDER find how the cameras lie" in capsys.readouterr().err


def test_a_sync_json_of_before_is_kept(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["new", str(folder)])
    by_hand = (folder / "sync.json").read_text().replace('"sigma_s"', ' "sigma_s"')
    (folder / "sync.json").write_text(by_hand)
    assert main(["sync", str(folder)]) == 0
    assert (folder / "sync.json.before").read_text() == by_hand
    capsys.readouterr()
    assert main(["sync", str(folder), "--by", "motion"]) == 1
    assert "of before, stays in force" in capsys.readouterr().out
