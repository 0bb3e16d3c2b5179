"""Pictures of the shooting guide (docs/shooting.md), from a capture that the simulator shot.

    python -m experiments.guide_pictures CAPTURE docs/images

CAPTURE has truth/ beside it, whence the plan of the hall is drawn; 640 x 480 is enough.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import cv2
import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from experiments.errors import guard
from experiments.footage import capture_in, truth_beside
from experiments.report.style import STYLE
from experiments.terminal import command_line
from pzcap.command.check.reference_check import check_reference
from pzcap.io.capture import frame_sets, read_capture, read_image
from pzcap.io.video import VideoReader
from pzcap.types import Capture, Image, PzcapError
from sim.truth import Truth

_QUALITY: Final = 80
_NARROW: Final = 320


def draw(capture: Capture, truth: Truth, folder: Path) -> list[Path]:
    """Write the pictures; the files."""
    folder.mkdir(parents=True, exist_ok=True)
    first = capture.cameras[0]
    if first.reference is None or first.sweep is None or first.zoom is None:
        raise PzcapError(f"{capture.folder}: camera {first.name} lacks a file; give a capture with all of them")
    pictures = {
        "guide_reference": _reference(capture, first.reference),
        "guide_sweep": _tiled(_evenly(first.sweep, 10), 5),
        "guide_zoom": _tiled(_evenly(first.zoom, 4), 4),
        "guide_motion": _tiled(_motion(capture), 4),
    }
    paths = []
    for name, image in pictures.items():
        path = folder / f"{name}.jpg"
        cv2.imwrite(str(path), image, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
        paths.append(path)
    return [*paths, _plan(capture, truth, folder / "guide_plan.svg")]


def _reference(capture: Capture, path: Path) -> Image:
    """The reference image, the corners that were found marked."""
    image = read_image(path)
    found, _ = check_reference("1", image, capture.calibration_object)
    if found.camera is not None:
        for quad in found.camera.points_px.reshape(-1, 4, 2):
            cv2.polylines(image, [np.round(quad).astype(np.int32)], True, (60, 220, 255), 1, cv2.LINE_AA)
    return image


def _evenly(path: Path, count: int) -> list[Image]:
    reader = VideoReader(path)
    some = reader.indices[np.linspace(0, len(reader.indices) - 1, count).round().astype(int)].tolist()
    return [image for _, image in reader.read(0, None, frozenset(some))]


def _motion(capture: Capture) -> list[Image]:
    """Views of all cameras, early and late."""
    sets = frame_sets(capture)
    found = []
    for at in (len(sets) // 4, 3 * len(sets) // 4):
        [frames] = sets.between(at, at + 1)
        found += [image for image in frames.images if image is not None]
    return found


def _tiled(images: Sequence[Image], columns: int) -> Image:
    size = (_NARROW, round(_NARROW * images[0].shape[0] / images[0].shape[1]))
    small = [np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8) for image in images]
    small += [np.zeros_like(small[0])] * (-len(small) % columns)
    return np.vstack([np.hstack(small[k : k + columns]) for k in range(0, len(small), columns)])


def _plan(capture: Capture, truth: Truth, path: Path) -> Path:
    """The hall from above: cameras with what they see at the reference pose, the object, the athlete's way."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.4, 4.6))
        axes = figure.add_subplot()
        for c, name in enumerate(truth.camera_names):
            pose, focal = truth.reference_world_T_cam[c], truth.reference_focal_px[c]
            place, forward = pose[:2, 3], pose[:2, 2] / np.linalg.norm(pose[:2, 2])
            half = np.arctan(truth.width / 2 / focal)
            for side in (-half, half):
                turn = np.array([[np.cos(side), -np.sin(side)], [np.sin(side), np.cos(side)]])
                axes.plot(*np.array([place, place + 9.0 * turn @ forward]).T, color="0.7", linewidth=0.8)
            axes.plot(*place, "o", color="C0", markersize=7)
            axes.annotate(f"camera {name}", place, (0, 9), textcoords="offset points", ha="center")
        axes.plot(*truth.joints_m[:, 0, :2].T, color="C1", linewidth=2.0, label="the athlete's way")
        if capture.calibration_object is not None:
            corners = np.concatenate([marker.corners_m for marker in capture.calibration_object.markers])
            low, high = corners[:, :2].min(axis=0), corners[:, :2].max(axis=0)
            box = np.array([low, [high[0], low[1]], high, [low[0], high[1]], low])
            axes.plot(*box.T, color="C3", label="calibration object, which is taken away")
        axes.set_aspect("equal")
        axes.set_xlabel("m")
        axes.set_ylabel("m")
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False)
        figure.savefig(path, metadata={"Date": None}, bbox_inches="tight")
    return path


def main(arguments: Sequence[str] | None = None) -> int:
    """The command. Exit status 0, or 1 with a line on stderr."""
    parser = command_line("guide_pictures", __doc__)
    parser.add_argument("capture", type=Path)
    parser.add_argument("folder", type=Path)
    given = parser.parse_args(arguments)

    def work() -> None:
        place = capture_in(given.capture)
        truth = truth_beside(place)
        if truth is None:
            raise PzcapError(f"{place}: the plan is drawn from the truth; give a capture with truth/ beside it")
        print("\n".join(map(str, draw(read_capture(place), truth, given.folder))))

    return guard(work)


if __name__ == "__main__":
    sys.exit(main())
