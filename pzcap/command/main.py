"""Entry of the command `pzcap`: what may be asked for, and errors as one line."""

from __future__ import annotations

import argparse
import errno
import os
import signal
import sys
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Final

from pzcap.command.printing import print_anything
from pzcap.io.text import one_line
from pzcap.types import PzcapError

FORMATS_HELP = "pzcap doctor lists them; several may be given, one after the other"


def parser() -> argparse.ArgumentParser:
    """The command line. What a part does is imported when it is asked for: a help text comes at once."""
    whole = argparse.ArgumentParser(
        prog="pzcap",
        description="Motion capture with cameras that stand still, pan and zoom: footage in, cameras and bodies out.",
        epilog="exit status: 0 all is well, 1 something is wrong and a line says what, 2 the line cannot be read",
    )
    whole.add_argument("--version", action="version", version=f"%(prog)s {metadata.version('pzcap')}")
    parts = whole.add_subparsers(dest="part", required=True, metavar="PART")

    def part(name: str, help: str) -> argparse.ArgumentParser:
        return parts.add_parser(name, help=help, description=f"{help[0].upper()}{help[1:]}.")

    one = part("new", help="write a capture.json that names a crew's own files where they lie")
    one.add_argument("folder", type=Path, metavar="FOLDER", help="holds a folder of files for each camera")
    one.add_argument("--name", help="of the take (that of the folder)")
    one.add_argument("--partial-sweep", action="store_true", help="the sweeps do not go all the way round")
    for role in ("reference", "sweep", "zoom", "motion"):
        one.add_argument(f"--{role}", metavar="NAME", help=f"name, or pattern, of each camera's {role}")
    one.add_argument("--replace", action="store_true", help="write capture.json anew where there is one")
    one.set_defaults(run=_new)

    one = part("sync", help="find how cameras without timecode lie to each other; write sync.json")
    one.add_argument("capture", type=Path, metavar="FOLDER", help="holds capture.json")
    one.add_argument("--by", choices=("sound", "flash", "motion"), help="this way alone (one after the other)")
    one.set_defaults(run=_sync)

    one = part("check", help="say what to shoot again while the hall is still rented")
    one.add_argument("capture", type=Path, metavar="FOLDER", help="holds capture.json")
    one.add_argument("--page", type=Path, metavar="FILE", help="page with pictures (FOLDER/check.html)")
    one.set_defaults(run=_check)

    one = part("marker-cube", help="write the calibration object: a PDF to print, and its object.json")
    one.add_argument("--out", type=Path, required=True, metavar="FOLDER", help="for both files")
    one.add_argument("--edge", type=float, default=2.0, metavar="METRES", help="edge of the cube (2)")
    one.add_argument("--replace", action="store_true", help="write object.json anew where there is one")
    one.set_defaults(run=_marker_cube)

    one = part("keypoints", help="run a detector over the motion, to do without keyframes")
    one.add_argument("capture", type=Path, metavar="FOLDER", help="holds capture.json, which is to name what is found")
    one.add_argument(
        "--by", required=True, metavar="DETECTOR", help="rtmlib (RTMPose), mediapipe (BlazePose), or MODULE:FUNCTION"
    )
    one.add_argument("--models", type=Path, nargs="+", default=[], metavar="FILE", help="its weights; none are fetched")
    one.add_argument("--replace", action="store_true", help="find keypoints anew where there are some")
    one.set_defaults(run=_keypoints)

    one = part("reconstruct", help="find cameras and body in a capture folder")
    one.add_argument("capture", type=Path, metavar="FOLDER", help="holds capture.json (pzcap new writes one)")
    one.add_argument("--out", type=Path, required=True, metavar="RESULTS", help="folder for what is found")
    one.add_argument(
        "--cameras", type=Path, metavar="RESULTS", help="of another take by the same cameras, not moved since"
    )
    one.add_argument("--free-tilt", action="store_true", help="the heads were tilted while the motion was filmed")
    one.add_argument("--threads", type=int, default=2, help="views that are worked on side by side (2)")
    one.set_defaults(run=_reconstruct)

    one = part("edit", help="pose and correct keyframes by dragging joints on a page in the browser")
    one.add_argument("place", type=Path, metavar="RESULTS|FOLDER", help="results, or a capture without any")
    one.add_argument("--capture", type=Path, metavar="FOLDER", help="of the results, where they do not tell it")
    one.add_argument("--port", type=int, default=0, help="at 127.0.0.1 (any that is free)")
    one.add_argument("--no-browser", action="store_true", help="print the address, and open no browser")
    one.set_defaults(run=_edit)

    one = part("lengths", help="mark known lengths of the hall, where there is no calibration object, in the browser")
    one.add_argument("capture", type=Path, metavar="FOLDER", help="holds capture.json")
    one.add_argument("--port", type=int, default=0, help="at 127.0.0.1 (any that is free)")
    one.add_argument("--no-browser", action="store_true", help="print the address, and open no browser")
    one.set_defaults(run=_lengths)

    one = part("export", help="write results in the formats of other tools")
    one.add_argument("results", type=Path, metavar="RESULTS", help="what pzcap reconstruct left")
    one.add_argument("--to", required=True, nargs="+", metavar="FORMAT", help=FORMATS_HELP)
    one.add_argument(
        "--out", type=Path, required=True, metavar="FOLDER",
        help="for the files; of several formats a folder each in it",
    )  # fmt: skip
    one.add_argument(
        "--capture",
        type=Path,
        metavar="FOLDER",
        help="of the results, for formats with its keypoints or video, where they do not tell it",
    )
    one.add_argument("--udp", metavar="HOST:PORT", help="freed: send the messages as well, at the rate of the take")
    one.set_defaults(run=_export)

    one = part("review", help="open the recording of results in the Rerun viewer")
    one.add_argument("results", type=Path, metavar="RESULTS", help="what pzcap reconstruct left")
    one.set_defaults(run=_review)

    one = part("doctor", help="say what is installed, what is missing, and the line to type")
    one.set_defaults(run=_doctor)
    return whole


_CURES: Final = {
    errno.ENOSPC: "; free some space",
    errno.EFBIG: "; raise the limit of file sizes (ulimit -f)",
    errno.EMFILE: "; raise the limit of open files (ulimit -n)",
    errno.EACCES: "; choose a place that you may read and write",
    errno.EPERM: "; choose a place that you may read and write",
    errno.EROFS: "; choose a place that can be written",
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; the exit status."""
    print_anything()
    given = parser().parse_args(arguments)
    asked = [signal.SIGTERM]
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        asked.append(signal.SIGINT)
    before = {each: signal.signal(each, _end) for each in asked}
    try:
        status: int = given.run(given)
        sys.stdout.flush()
    except PzcapError as error:
        return _said(str(error))
    except KeyboardInterrupt:
        _said("interrupted")
        return 130
    except BrokenPipeError:  # whoever read has had enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        return _said(f"{where}{error.strerror or error}{_CURES.get(error.errno or 0, '')}")
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)
    return status


def _end(*_: object) -> None:
    """Answer a signal: clearing away takes a while, so it is said at once, by a call that may interrupt any other."""
    os.write(2, b"\npzcap: asked to end\n")
    raise KeyboardInterrupt


def _said(problem: str) -> int:
    print(f"pzcap: {one_line(problem)}", file=sys.stderr, flush=True)
    return 1


def _new(given: argparse.Namespace) -> int:
    from pzcap.command.new_capture import write_capture

    roles = {role: getattr(given, role) for role in ("reference", "sweep", "zoom", "motion")}
    patterns = {role: name for role, name in roles.items() if name is not None}
    full_turn = not given.partial_sweep
    return write_capture(given.folder, name=given.name, full_turn=full_turn, patterns=patterns, replace=given.replace)


def _sync(given: argparse.Namespace) -> int:
    from pzcap.command.syncing import sync_folder

    return sync_folder(given.capture, given.by)


def _check(given: argparse.Namespace) -> int:
    from pzcap.command.check.run import check_folder

    return check_folder(given.capture, given.page or given.capture / "check.html")


def _marker_cube(given: argparse.Namespace) -> int:
    from pzcap.command.marker_cube import Cube, write_cube

    return write_cube(Cube(given.edge), given.out, replace=given.replace)


def _keypoints(given: argparse.Namespace) -> int:
    from pzcap.command.detecting import detect_keypoints

    return detect_keypoints(given.capture, given.by, given.models, replace=given.replace)


def _reconstruct(given: argparse.Namespace) -> int:
    from pzcap.command.reconstructing import reconstruct_folder

    return reconstruct_folder(given.capture, given.out, given.cameras, given.threads, given.free_tilt)


def _edit(given: argparse.Namespace) -> int:
    from pzcap.command.editing import edit

    return edit(given.place, given.capture, given.port, not given.no_browser)


def _lengths(given: argparse.Namespace) -> int:
    from pzcap.command.editing import mark_lengths

    return mark_lengths(given.capture, given.port, not given.no_browser)


def _export(given: argparse.Namespace) -> int:
    from pzcap.command.exporting import export_results

    return export_results(given.results, given.to, given.out, given.capture, given.udp)


def _review(given: argparse.Namespace) -> int:
    from pzcap.command.reviewing import review_results

    return review_results(given.results)


def _doctor(_: argparse.Namespace) -> int:
    from pzcap.command.doctor import report

    return report()
