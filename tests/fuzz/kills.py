"""Kill a shoot, a run or a sweep at a random moment and do it again: nothing lost, nobody left, nothing stale.

    python -m tests.fuzz.kills 100            # a third of each; -9, TERM and INT in turn
    python -m tests.fuzz.kills 30 --only sweep --seed 7

After each kill all processes that the command started must be gone 5 s after it; a command that was asked to end may
take 10 s to clear away what is half done. The same command, started again, must end with the same results as one that
was never killed, and leave nothing temporary behind. Exit status 1 if not.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import uuid
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import psutil

from experiments.metrics import read_metrics
from tests.scenes.sweeps import ENVIRONMENT, ROOT, command

GONE_S = 5.0
TIDY_S = 10.0
"""In which a command that was asked to end clears away what is half done."""
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
MARK = "PZCAP_KILL"
TIMES = ("speed.", "memory.")
"""Beginnings of the names of metrics that differ from run to run."""
SHOOT = """
import signal, sys
signal.signal(signal.SIGINT, signal.SIG_DFL)  # as experiments/__init__.py has it of a command
from pathlib import Path
from experiments.errors import guard
from experiments.footage import shot
from tests.scenes.captures import TINY
sys.exit(guard(lambda: shot(TINY, Path(sys.argv[1]))))
"""


@dataclass(frozen=True)
class Work:
    """A command that works in a folder, and what it leaves there that must be the same each time."""

    line: Callable[[Path], list[str]]
    results: Callable[[Path], dict[str, str]]


def _hashes(folder: Path, pattern: str) -> dict[str, str]:
    files = (path for path in sorted(folder.rglob(pattern)) if path.is_file() and not path.is_symlink())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def _shot(folder: Path) -> dict[str, str]:
    return {name: value for name, value in _hashes(folder, "*").items() if "/capture/" in name or "/truth/" in name}


def _figures(folder: Path) -> dict[str, str]:
    found, _ = read_metrics(folder / "run" / "metrics.json")
    return {each.key: repr(each.value) for each in found if not each.key.startswith(TIMES)}


def _run(folder: Path) -> list[str]:
    capture = os.environ["PZCAP_CAPTURE"]
    return [sys.executable, "-m", "experiments.run", f"capture={capture}", f"hydra.run.dir={folder / 'run'}"]


WORK = {
    "shoot": Work(lambda folder: [sys.executable, "-c", SHOOT, str(folder)], _shot),
    "run": Work(_run, _figures),
    "sweep": Work(
        lambda folder: command(folder, "value=1,2,3,4", "pause_s=0.1", launcher="joblib"),
        lambda folder: _hashes(folder, "[abc].txt"),
    ),
    "ray": Work(
        lambda folder: command(folder, "value=1,2,3,4", "pause_s=0.1", launcher="ray"),
        lambda folder: _hashes(folder, "[abc].txt"),
    ),
}


def orphans(mark: str) -> list[psutil.Process]:
    """Processes that a command of this mark has started, and that live."""
    found = []
    for process in psutil.process_iter():
        try:
            if process.status() != psutil.STATUS_ZOMBIE and process.environ().get(MARK) == mark:
                found.append(process)
        except (psutil.NoSuchProcess, psutil.AccessDenied):
            pass
    return found


def start(line: list[str], mark: str) -> subprocess.Popen[bytes]:
    environment = ENVIRONMENT | {MARK: mark}
    return subprocess.Popen(
        line, cwd=ROOT, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )


def finished(work: Work, folder: Path) -> tuple[int, float]:
    """Run to the end: the exit status, and the seconds that it took."""
    begun = time.monotonic()
    process = start(work.line(folder), "finished")
    return process.wait(), time.monotonic() - begun


def stale(folder: Path) -> list[str]:
    """What is temporary and was left behind."""
    names = (str(path.relative_to(folder)) for path in folder.rglob("*"))
    return [name for name in names if name.endswith((".partial", ".lock")) or ".partial/" in name or "/." in f"/{name}"]


def trial(
    work: Work, folder: Path, sent: signal.Signals, after_s: float, wanted: dict[str, str], usual: set[str]
) -> list[str]:  # fmt: skip
    """Kill once and do it again: what went wrong. ``usual``: hidden files of one that was never killed."""
    mark = uuid.uuid4().hex
    process = start(work.line(folder), mark)
    try:
        process.wait(after_s)
    except subprocess.TimeoutExpired:
        process.send_signal(sent)
    begun = time.monotonic()
    process.wait()
    ended = time.monotonic()
    wrong = [f"it ended after {ended - begun:.1f} s"] if ended > begun + TIDY_S else []
    while orphans(mark) and time.monotonic() < ended + GONE_S:
        time.sleep(0.1)
    wrong += [f"process {one.pid} lives on: {' '.join(one.cmdline())[:80]}" for one in orphans(mark)]
    status, _ = finished(work, folder)
    if status:
        wrong.append(f"the next one ends with {status}")
    elif work.results(folder) != wanted:
        wrong.append("the results are others")
    hidden = [name for name in stale(folder) if name not in usual]
    if hidden:
        wrong.append(f"left behind: {', '.join(hidden[:3])}")
    return wrong


def main() -> int:
    parser = argparse.ArgumentParser(description="Kill shoots, runs and sweeps at random moments.")
    parser.add_argument("count", type=int, help="kills")
    parser.add_argument("--only", choices=sorted(WORK), help="one kind of work; by default all in turn")
    parser.add_argument("--seed", type=int, default=0)
    said = parser.parse_args()
    # what a shell starts in the background ignores SIGINT, and so would all that is started here
    signal.signal(signal.SIGINT, signal.default_int_handler)
    rng = random.Random(said.seed)
    kinds = [said.only] if said.only else list(WORK)
    failed = 0
    with tempfile.TemporaryDirectory() as place:
        wanted, lasts, usual = {}, {}, {}
        if "run" in kinds and "PZCAP_CAPTURE" not in os.environ:
            from tests.scenes.captures import SMALL, shot

            os.environ["PZCAP_CAPTURE"] = str(shot(SMALL) / "capture")
        for kind in kinds:
            folder = Path(place) / f"{kind}-whole"
            folder.mkdir()
            status, lasts[kind] = finished(WORK[kind], folder)
            assert status == 0, f"{kind} ends with {status}"
            wanted[kind], usual[kind] = WORK[kind].results(folder), set(stale(folder))
            assert wanted[kind]
            print(f"{kind}: {len(wanted[kind])} results in {lasts[kind]:.1f} s", flush=True)
        for number in range(said.count):
            kind, sent = kinds[number % len(kinds)], SIGNALS[number // len(kinds) % len(SIGNALS)]
            folder, after_s = Path(place) / f"{kind}-{number}", rng.uniform(0.0, lasts[kind])
            folder.mkdir()
            wrong = trial(WORK[kind], folder, sent, after_s, wanted[kind], usual[kind])
            failed += bool(wrong)
            print(f"{number + 1}: {kind}, {sent.name} after {after_s:.2f} s: {'; '.join(wrong) or 'right'}", flush=True)
            shutil.rmtree(folder, ignore_errors=True)
    print(f"{said.count - failed} of {said.count} kills right")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
