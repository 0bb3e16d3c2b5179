"""Open a run, a study, or two runs side by side in the viewer, at the worst frame.

    python -m experiments.review outputs/demo                   # a run
    python -m experiments.review outputs/study/noise            # a study: its worst runs, the worst one before
    python -m experiments.review outputs/demo outputs/other     # two runs: where they differ most

The worst frames by each metric are listed beside the views; a click on one goes there. What is opened is a copy with
that list in it, RUN/review.rrd or RUN/comparison.rrd, which `rerun` opens anywhere.
"""

from __future__ import annotations

import itertools
import sys
import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import Chunk, LazyChunkStream

from experiments.errors import guard
from experiments.recordings import check, each, opened
from experiments.report import bookmarks
from experiments.report.bookmarks import Bookmark
from experiments.terminal import command_line
from pzcap.io import results
from pzcap.io.files import written_whole
from pzcap.types import PzcapError
from pzcap.viewer import layouts
from pzcap.viewer.columns import TIMELINE, plain
from pzcap.viewer.recording import APPLICATION
from pzcap.viewer.window import show

RECORDING: Final = "recording.rrd"
AT_ONCE: Final = 3  # runs of a study
LEFT_OUT: Final = ["/__properties/**", "/truth/**", "/phase/**"]
"""Of the second of two runs: what it shares with the first, or what stands in the first one's views by name."""


@dataclass(frozen=True, slots=True)
class Review:
    """A file for the viewer, and what to look at in it."""

    path: Path
    title: str
    marks: tuple[Bookmark, ...]  # the gravest first

    @property
    def place(self) -> tuple[Path, int | None]:
        """The file, and the frame to see first."""
        return self.path, self.marks[0].frame if self.marks else None


def runs_in(folder: Path) -> list[Path]:
    """The folders in ``folder``, or itself, that hold a recording. PzcapError if there is none."""
    if (folder / RECORDING).is_file():
        return [folder]
    paths = (path.relative_to(folder) for path in sorted(folder.rglob(RECORDING)))
    found = [folder / path.parent for path in paths if not any(part.startswith(".") for part in path.parts)]
    if not found:
        raise PzcapError(f"{folder}: no {RECORDING} in it; give the folder of a run, or of a study (output.recording)")
    return found


def review(run: Path) -> Review:
    """Write RUN/review.rrd: all of the recording, its worst frames, and a layout a purpose."""
    marks = bookmarks.worst(bookmarks.errors(run / RECORDING))
    whole = results.load(run / "reconstruction")
    purposes = layouts.overview(whole, scored=bool(marks)), layouts.calibration(whole), layouts.tracking(whole)
    first = {"calibration": 1, "tracking": 2}[marks[0].kind.purpose] if marks else 0
    blueprint = layouts.whole(_beside(rrb.Tabs(*purposes, active_tab=first)), whole)
    path = run / "review.rrd"
    page = _page(marks, "In brackets: how many times its target.")
    with opened(run / RECORDING) as reader:
        _write(path, reader.store().stream(), run.name, marks, page, blueprint)
    return Review(path, run.name, tuple(marks))


def compare(first: Path, second: Path) -> Review:
    """Write FIRST/comparison.rrd: both runs in one recording, and where they differ."""
    marks = bookmarks.differing(*(bookmarks.errors(run / RECORDING) for run in (first, second)))
    whole = results.load(first / "reconstruction")
    titles = told_apart(first.name, second.name)
    content = rrb.Tabs(layouts.comparison(whole, titles), layouts.overview(whole, scored=True), active_tab=0)
    path, title = first / "comparison.rrd", " and ".join(titles)
    page = _page(marks, f"By how much {titles[1]} is above {titles[0]}. In brackets: in times of the target.")
    check(second / RECORDING)
    with opened(first / RECORDING) as one, opened(second / RECORDING) as other:
        others = other.store().stream().drop(content=LEFT_OUT).map(_under_other)
        both = LazyChunkStream.merge(one.store().stream(), others)
        _write(path, both, title, marks, page, layouts.whole(_beside(content), whole))
    return Review(path, title, tuple(marks))


def told_apart(first: str, second: str) -> tuple[str, str]:
    """The names of two jobs without what they share, which can be long (`experiments.studies.jobs.name`)."""
    one, other = first.split(","), second.split(",")
    return (
        ",".join(part for part in one if part not in other) or first,
        ",".join(part for part in other if part not in one) or second,
    )


def _under_other(chunk: Chunk) -> Chunk:
    return chunk.with_entity_path(layouts.OTHER + chunk.entity_path)


def _beside(content: rrb.Container) -> rrb.Container:
    """``content``, and the bookmarks to its right."""
    bare = rrb.archetypes.TextLogColumns(text_log_columns=[rrb.encodings.TextLogColumn("Body")])
    listed = rrb.TextLogView(name="Worst frames", origin="/review/worst", columns=bare)
    page = rrb.TextDocumentView(name="By gravity", origin="/review/page")
    return rrb.Horizontal(content, rrb.Vertical(listed, page), column_shares=[5.0, 1.0])


def _write(
    path: Path, chunks: LazyChunkStream, title: str, marks: Sequence[Bookmark], page: str, blueprint: rrb.Blueprint
) -> None:
    with written_whole(path) as partial:
        # a new id: under one id the viewer would take it for a part of the recording that it was made of
        rec = rr.RecordingStream(APPLICATION, recording_id=str(uuid.uuid4()))
        rec.set_log_time_enabled(False)
        rec.set_log_tick_enabled(False)
        rec.save(partial, default_blueprint=blueprint)
        rec.send_chunks(chunks)
        rec.send_recording_name(plain(f"Review of {title}"))
        for mark in sorted(marks, key=lambda mark: mark.frame):
            rec.set_time(TIMELINE, sequence=mark.frame)
            level = rr.TextLogLevel.WARN if mark.severity > 1.0 else rr.TextLogLevel.INFO
            rec.log("/review/worst", rr.TextLog(plain(mark.text), level=level))
        rec.log("/review/page", rr.TextDocument(plain(page), media_type="text/markdown"), static=True)
        rec.disconnect()


def _page(marks: Sequence[Bookmark], note: str) -> str:
    if not marks:
        return "The recording holds no errors: there was no truth to score against."
    rows = [f"| {mark.frame} | {mark.text} |" for mark in marks]
    return "\n".join([note, "", "| frame | what |", "|---:|---|", *rows])


def reviews(folders: Sequence[Path]) -> list[Review]:
    """Recordings to open for one folder, of a run or a study, or for two runs; the worst first."""
    if len(folders) == 2:
        first, second = (runs_in(folder) for folder in folders)
        if len(first) > 1 or len(second) > 1:
            raise PzcapError("two runs can be compared, not studies; give the folder of one job of each")
        return [compare(first[0], second[0])]
    found = runs_in(folders[0])
    if len(found) == 1:
        return [review(found[0])]
    ranked = sorted(each(_graded, found), key=lambda graded: -graded[0])
    made = list(itertools.islice(each(review, (run for _, run in ranked)), AT_ONCE))
    if not made:
        raise PzcapError(f"{folders[0]}: none of its {len(found)} runs can be shown; make them again")
    return made


def _graded(run: Path) -> tuple[float, Path]:
    """A run, and how grave its worst frame is."""
    marks = bookmarks.worst(bookmarks.errors(run / RECORDING))
    return max((mark.severity for mark in marks), default=0.0), run


def _open(folders: Sequence[Path]) -> None:
    found = reviews(folders)
    for one in found:
        print(one.path)
        for mark in one.marks:
            print(f"  frame {mark.frame}: {mark.text}")
    sys.stdout.flush()
    show([one.place for one in found])


def main() -> int:
    """The command. Exit status 0, or 1 with a line on stderr."""
    parser = command_line("review", __doc__)
    parser.add_argument("folder", type=Path, help="of a run or a study")
    parser.add_argument("other", type=Path, nargs="?", help="of a run to compare it with")
    given = parser.parse_args()
    folders = [given.folder] if given.other is None else [given.folder, given.other]
    return guard(lambda: _open(folders))


if __name__ == "__main__":
    sys.exit(main())
