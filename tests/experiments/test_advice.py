"""What a command says where a machine gives too little: the true cause, and what was made is there."""

from __future__ import annotations

import errno
import resource
import subprocess
import sys
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from unittest import mock

import av
import av.error
import cv2
import pytest

from experiments.errors import explain, guard
from experiments.terminal import terminal
from pzcap.io import files
from pzcap.io.video import VideoReader
from pzcap.types import PzcapError
from sim.capture_writer import write_video
from tests.scenes.recorders import pictures
from tests.scenes.sweeps import ENVIRONMENT, ROOT

PRINTS = """
import sys
from pathlib import Path
from experiments.errors import guard
from experiments.terminal import terminal
def made():
    Path(sys.argv[1]).write_text("made")
    {how}
sys.exit(guard(made))
"""


@pytest.mark.parametrize("how", ["print('a line')", "terminal().print('a line')", "print('a line' * 100_000)"])
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_a_full_output_is_not_taken_for_a_full_disk(how: str, tmp_path: Path) -> None:
    line = [sys.executable, "-c", PRINTS.format(how=how), str(tmp_path / "result")]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(line, stdout=full, stderr=subprocess.PIPE, text=True, cwd=ROOT, env=ENVIRONMENT)
    assert done.returncode == 1
    assert done.stderr.startswith("error: the output takes no more (No space left on device); what was to be printed")
    assert done.stderr.count("\n") == 1
    assert (tmp_path / "result").read_text() == "made"


def test_a_full_disk_is_not_taken_for_a_full_output(capfd: pytest.CaptureFixture[str]) -> None:
    def fails() -> None:
        raise OSError(errno.ENOSPC, "No space left on device", "numbers.npz")

    assert guard(fails) == 1
    assert capfd.readouterr().err == (
        "error: the disk is full while writing numbers.npz; free some space or choose another folder with "
        "hydra.run.dir=FOLDER\n"
    )


@pytest.mark.parametrize(
    "error",
    [MemoryError(), MemoryError("Unable to allocate 3 GiB"), OSError(errno.ENOMEM, "Cannot allocate memory"),
     RuntimeError("can't start new thread")],
)  # fmt: skip
def test_memory_that_ran_out_is_said(error: Exception) -> None:
    line = explain(error)
    assert line is not None
    assert line.startswith("memory ran out")
    assert "close other programs, or give fewer reconstruct.threads or a smaller picture" in line


def test_opencv_without_memory_is_said() -> None:
    error = cv2.error("Insufficient memory")
    error.code = cv2.Error.StsNoMem
    assert (explain(error) or "").startswith("memory ran out (Insufficient memory)")
    error.code = cv2.Error.StsBadArg
    assert explain(error) is None
    assert explain(RuntimeError("a bug")) is None


def test_too_little_address_space_is_said_before_anything_is_loaded() -> None:
    def limited() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (2**30, 2**30))

    line = [sys.executable, "-m", "experiments.run"]
    done = subprocess.run(
        line, capture_output=True, text=True, cwd=ROOT, env=ENVIRONMENT, preexec_fn=limited
    )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr == (
        "error: this process may take 1.0 GiB of address space, and needs 3; raise the limit, ulimit -v 3145728\n"
    )


@pytest.fixture
def motion(tmp_path: Path) -> Path:
    write_video(tmp_path / "motion.mp4", pictures(6), Fraction(30), crf=12, timecode="10:00:00:00")
    return tmp_path / "motion.mp4"


def failing(error: Exception) -> Callable[..., object]:
    def fail(*_: object, **__: object) -> object:
        raise error

    return fail


def test_a_motion_that_may_not_be_read_is_not_called_damaged(motion: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    error = av.error.PermissionError(errno.EACCES, "Permission denied", str(motion))
    monkeypatch.setattr(av, "open", failing(error))
    with pytest.raises(PzcapError, match=r"motion\.mp4: may not be read \(Permission denied\); change its permissions"):
        VideoReader(motion)


def test_a_motion_without_memory_is_not_called_damaged(motion: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Memory ran out only where something limits it; else the file asks for more than anybody has."""
    reader = VideoReader(motion)
    monkeypatch.setattr(av, "open", failing(av.error.MemoryError(errno.ENOMEM, "Cannot allocate memory", str(motion))))
    with pytest.raises(PzcapError, match="truncated or damaged"):
        next(iter(reader))
    monkeypatch.setattr(files.resource, "getrlimit", lambda _: (2**45, 2**45))
    with pytest.raises(MemoryError, match=r"motion\.mp4 cannot be decoded"):
        next(iter(reader))


def test_a_place_that_cannot_be_sought_is_damage(motion: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """FFmpeg says that it is not permitted where the tables of an MP4 lead nowhere."""
    reader = VideoReader(motion)
    lost = av.error.PermissionError(errno.EPERM, "Operation not permitted", str(motion))
    monkeypatch.setattr(
        VideoReader, "_open", lambda _: mock.MagicMock(**{"__enter__.return_value.seek": failing(lost)})
    )
    monkeypatch.setattr(VideoReader, "_stream", lambda *_: mock.MagicMock(time_base=Fraction(1, 15360)))
    with pytest.raises(PzcapError, match=r"motion\.mp4: the video is truncated or damaged at frame 3"):
        next(reader.read(3))


def test_a_limit_that_is_all_but_reached_counts_as_memory(motion: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """FFmpeg says that data are invalid where its threads cannot be started."""
    monkeypatch.setattr(av, "open", failing(av.error.InvalidDataError(errno.EINVAL, "Invalid data", str(motion))))
    with pytest.raises(PzcapError, match="truncated or damaged"):
        VideoReader(motion)
    taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    monkeypatch.setattr(files.resource, "getrlimit", lambda _: (taken + 2**27, taken + 2**27))
    with pytest.raises(MemoryError):
        VideoReader(motion)


def test_metadata_that_are_no_utf_8_are_no_damage(motion: Path) -> None:
    """Cameras write what they like: a title in Latin-1, a place in Shift JIS."""
    with av.open(str(motion)) as whole, av.open(str(motion.with_name("titled.mp4")), "w") as titled:
        stream = whole.streams.video[0]
        copy = titled.add_stream_from_template(stream)
        copy.metadata.update(stream.metadata)
        titled.metadata["title"] = "Turnhalle Buehl"
        for packet in whole.demux(stream):
            if packet.dts is not None:
                packet.stream = copy
                titled.mux(packet)
    path = motion.with_name("titled.mp4")
    data = path.read_bytes()
    assert b"Turnhalle Buehl" in data
    path.write_bytes(data.replace(b"Turnhalle Buehl", "Turnhalle Bühlx".encode("latin-1")))
    assert VideoReader(path).timecode == "10:00:00:00"
    assert len(list(VideoReader(path))) == 6


def test_a_console_that_takes_all_says_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    terminal().print("a line")
    assert capfd.readouterr() == ("a line\n", "")
