"""Files that others made, and locks."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from experiments import footage
from pzcap.io import results
from pzcap.io.capture import read_image
from pzcap.io.files import checked, written_whole
from pzcap.io.video import VideoReader
from pzcap.types import PzcapError
from sim.lock import locked
from sim.motion._bvh import read_bvh
from tests.scenes import fabricated, specials

KINDS = ("a pipe", "a folder", "a socket", "a device")


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_no_file_is_refused_by_every_reader(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "footage"
    specials.make(path, kind)
    for read in (checked, read_image, VideoReader, read_bvh):
        with pytest.raises(PzcapError, match=f"footage: is {kind}, not a file; put the file itself in its place"):
            read(path)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", [results.MANIFEST, results.ARRAYS, "panorama1.png"])
def test_what_is_no_file_is_refused_in_a_reconstruction(kind: str, name: str, tmp_path: Path) -> None:
    results.save(fabricated.reconstruction(), tmp_path)
    (tmp_path / name).unlink()
    specials.make(tmp_path / name, kind)
    with pytest.raises(PzcapError, match=f"{name}: is {kind}"):
        results.load(tmp_path)


@pytest.mark.parametrize("name", ["truth.json", "truth.npz", "masks.npz"])
def test_what_is_no_file_is_refused_in_a_truth(name: str, small_capture: Path, tmp_path: Path) -> None:
    (tmp_path / "truth").mkdir()
    for file in (small_capture / "truth").iterdir():
        (tmp_path / "truth" / file.name).symlink_to(file)
    assert footage.truth_beside(tmp_path / "capture") is not None
    (tmp_path / "truth" / name).unlink()
    specials.make(tmp_path / "truth" / name, "a pipe")
    with pytest.raises(PzcapError, match=f"{name}: is a pipe"):
        footage.truth_beside(tmp_path / "capture")


@pytest.mark.parametrize("name", ["../panorama1.png", "/dev/zero"])
def test_a_reconstruction_opens_nothing_outside_itself(name: str, tmp_path: Path) -> None:
    folder = tmp_path / "reconstruction"
    results.save(fabricated.reconstruction(), folder)
    (folder / "panorama1.png").rename(tmp_path / "panorama1.png")
    manifest = json.loads((folder / results.MANIFEST).read_text())
    manifest["cameras"][0]["panorama"] = name
    (folder / results.MANIFEST).write_text(json.dumps(manifest))
    with pytest.raises(PzcapError, match=f"{name} leads out of the folder"):
        results.load(folder)


HOLDING = """
import sys, time
from pathlib import Path
from sim.lock import locked
with locked(Path(sys.argv[1]), "busy"):
    print("held", flush=True)
    time.sleep(60)
"""


def test_a_lock_says_who_holds_it_and_falls_with_him(tmp_path: Path) -> None:
    lock = tmp_path / "lock"
    with subprocess.Popen([sys.executable, "-c", HOLDING, str(lock)], stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(PzcapError, match=rf"busy \(it is process {holder.pid} on "), locked(lock, "busy"):
            pass
        holder.kill()
        holder.wait()
        assert lock.exists()
        with locked(lock, "busy"):
            assert str(os.getpid()) in lock.read_text()
    assert not lock.exists()


def test_a_lock_is_waited_for(tmp_path: Path) -> None:
    lock = tmp_path / "lock"
    with subprocess.Popen([sys.executable, "-c", HOLDING, str(lock)], stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None
        holder.stdout.readline()
        killer = subprocess.Popen(["sh", "-c", f"sleep 0.5; kill -9 {holder.pid}"])
        start = time.monotonic()
        with locked(lock, "busy", patience_s=20.0):
            assert 0.3 < time.monotonic() - start < 10.0
        killer.wait()


def test_nobody_waits_for_himself(tmp_path: Path) -> None:
    start = time.monotonic()
    with locked(tmp_path / "lock", "busy"), pytest.raises(PzcapError), locked(tmp_path / "lock", "busy", 60.0):
        pass
    assert time.monotonic() - start < 5.0


def test_a_file_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "file.txt"
    with written_whole(path) as partial:
        partial.write_text("old", encoding="utf-8")
        assert not path.exists()
    with suppress(ZeroDivisionError), written_whole(path) as partial:
        partial.write_text("ne", encoding="utf-8")
        raise ZeroDivisionError
    assert path.read_text(encoding="utf-8") == "old"
    assert [one.name for one in tmp_path.iterdir()] == ["file.txt"]


def test_a_file_that_cannot_be_written_is_named_as_it_is_known(tmp_path: Path) -> None:
    path = tmp_path / "nowhere" / "page.html"
    with pytest.raises(OSError, match="No such file") as caught, written_whole(path) as partial:
        partial.write_text("")
    assert caught.value.filename == str(path)
