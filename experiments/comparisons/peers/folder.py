"""Frames made elsewhere: a folder of images, what is known of the camera, and perhaps the truth. docs/peers.md."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from experiments.comparisons.peers.material import SWEEP_STEP, Background, Estimate, Material, Shot, SweepView, spaced
from experiments.config import structured
from pzcap.calibration import stitching
from pzcap.calibration.bundle_adjustment import Link
from pzcap.calibration.settings import PanZoomConfig
from pzcap.calibration.sweep import chain, link_further
from pzcap.geometry import camera as geometry
from pzcap.geometry.camera import View, wrapped
from pzcap.io.capture import read_image
from pzcap.io.files import checked
from pzcap.progress import Report
from pzcap.types import FAR_AWAY, Array, Image, Lens, Mask, Panorama, PanZoomCamera, PzcapError

CAMERA: Final = "camera.json"
TRUTH: Final = "truth.csv"
COLUMNS: Final = ("frame", "pan_deg", "focal_px")
DOCS: Final = "docs/peers.md"
PAN_ITERATIONS: Final = 5

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class CameraFile:
    """camera.json."""

    focal_px: float  # of the sweep
    principal_px: tuple[tuple[float, ...], ...]  # coefficients of polynomials in log(focal / focal_px), constant first
    k1: tuple[float, ...]
    tilt_deg: float
    roll_deg: float
    full_turn: bool = False  # the sweep goes all the way round; a panorama says it itself

    def __post_init__(self) -> None:
        if self.focal_px <= 0:
            raise PzcapError(f"focal_px is {self.focal_px}; it must be above 0")
        if not self.principal_px or any(len(pair) != 2 for pair in self.principal_px) or not self.k1:
            raise PzcapError("principal_px is a list of [x, y], k1 a list of numbers; the constants come first")


@dataclass(frozen=True, slots=True)
class PanoramaFile:
    """panorama.json."""

    px_per_rad: float
    origin_px: tuple[float, float]
    full_turn: bool


def is_folder_of_frames(folder: Path) -> bool:
    """True if this is meant to be such a folder."""
    return (folder / CAMERA).exists() or (folder / "frames").is_dir()


def from_folder(folder: Path, config: PanZoomConfig, report: Report) -> Material:
    """The material of a folder of frames.

    Raises PzcapError that names what is missing or malformed, and what to do about it.
    """
    frames = _images(folder / "frames", "the frames to locate, as PNG")
    first = read_image(frames[0])
    known = _read(folder / CAMERA, CameraFile)
    lens = Lens(
        first.shape[1], first.shape[0], known.focal_px, np.array(known.principal_px), np.array(known.k1, np.float64)
    )
    camera = PanZoomCamera(lens, np.eye(4), np.deg2rad(known.tilt_deg), np.deg2rad(known.roll_deg))
    truth = _truth(folder / TRUTH, frames)
    sweep: tuple[SweepView, ...] = ()
    if (folder / "panorama.png").exists():
        panorama = _panorama(folder)
    elif (folder / "sweep").is_dir():
        images = [_sized(path, lens) for path in _images(folder / "sweep", "the frames of the sweep, as PNG")]
        panorama, kept = _stitched(images, camera, known.full_turn, config, report)
        views = [SweepView(images[k], float(pan)) for k, pan in zip(kept, panorama.sweep_pan_rad, strict=True)]
        sweep = spaced(views, SWEEP_STEP * 2 * np.arctan(lens.width / 2 / known.focal_px))
    else:
        raise PzcapError(f"{folder}: holds neither panorama.png nor the folder sweep; bring one of them ({DOCS})")

    def shots() -> Iterator[Shot]:
        for number, path in enumerate(frames):
            person = _mask(folder / "masks" / path.name, lens)
            yield Shot(0, number, _sized(path, lens), truth.get(path.stem), person)

    background = Background(camera, panorama, sweep, config, None)
    return Material(folder.name, ("1",), (background,), len(frames), shots)


def _images(folder: Path, what: str) -> list[Path]:
    found = sorted(folder.glob("*.png"))
    if not found:
        raise PzcapError(f"{folder}: holds no images; put {what} there ({DOCS})")
    return found


def _sized(path: Path, lens: Lens) -> Image:
    image = read_image(path)
    if image.shape[:2] != (lens.height, lens.width):
        raise PzcapError(
            f"{path}: is {image.shape[1]}x{image.shape[0]} where the first frame is {lens.width}x{lens.height}; "
            "bring all images in one size"
        )
    return image


def _mask(path: Path, lens: Lens) -> Mask | None:
    return np.asarray(_sized(path, lens).any(axis=2), np.bool_) if path.exists() else None


def _read(path: Path, kind: type[T]) -> T:
    try:
        tree: Any = json.loads(checked(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise PzcapError(f"{path}: cannot be read ({error.strerror}); write it ({DOCS})") from error
    except ValueError as error:
        raise PzcapError(f"{path}: is not valid JSON ({error}); correct it there") from error
    if not isinstance(tree, dict):
        raise PzcapError(f"{path}: must be a JSON object ({DOCS})")
    return structured(tree, kind, str(path))


def _panorama(folder: Path) -> Panorama:
    path = folder / "panorama.png"
    file = _read(folder / "panorama.json", PanoramaFile)
    try:  # by its bytes: OpenCV itself does not survive a name that is not UTF-8
        image = cv2.imdecode(np.fromfile(checked(path), np.uint8), cv2.IMREAD_UNCHANGED)
    except (OSError, cv2.error):
        image = None
    if image is None or image.dtype != np.uint8 or image.ndim != 3:
        raise PzcapError(f"{path}: is no PNG of 8 bits in colour; write it again ({DOCS})")
    valid = image[:, :, 3] > 0 if image.shape[2] == 4 else np.ones(image.shape[:2], bool)
    if file.full_turn and abs(image.shape[1] - 2 * np.pi * file.px_per_rad) > 0.5:
        raise PzcapError(
            f"{path}: is {image.shape[1]} wide; of a full turn it must be 2 pi px_per_rad = "
            f"{2 * np.pi * file.px_per_rad:.1f} ({DOCS})"
        )
    return Panorama(
        np.ascontiguousarray(image[:, :, :3]), valid, file.px_per_rad, np.array(file.origin_px), file.full_turn,
        np.zeros(0), np.zeros(0, np.int64), 0.0, 0.0,
    )  # fmt: skip


def _truth(path: Path, frames: Sequence[Path]) -> dict[str, Estimate]:
    """Frame's name without its ending -> truth; empty where there is none."""
    if not path.exists():
        return {}
    names = {frame.stem for frame in frames}
    truth = {}
    with checked(path).open(encoding="utf-8", newline="") as file:
        rows = csv.DictReader(file)
        if tuple(rows.fieldnames or ()) != COLUMNS:
            raise PzcapError(f"{path}: its first line must be {','.join(COLUMNS)} ({DOCS})")
        for row in rows:
            where = f"{path}, line {rows.line_num}"
            try:
                pan, focal = float(row["pan_deg"]), float(row["focal_px"])
            except (TypeError, ValueError) as error:
                raise PzcapError(f"{where}: pan_deg and focal_px must be numbers ({error})") from error
            if not np.isfinite(pan) or not 0 < focal < np.inf:
                raise PzcapError(f"{where}: pan_deg must be finite and focal_px above 0; correct it there")
            if row["frame"] not in names:
                raise PzcapError(f"{where}: there is no frames/{row['frame']}.png; bring it or remove the line")
            truth[row["frame"]] = Estimate(np.deg2rad(pan), focal)
    return truth


# --------------------------------------------------------------------------------------------------------------
# A sweep by a camera that is known


def _stitched(
    images: list[Image], camera: PanZoomCamera, full_turn: bool, config: PanZoomConfig, report: Report
) -> tuple[Panorama, NDArray[np.int64]]:
    """The panorama of a sweep whose lens, tilt and roll are known, its first frame at pan 0; and its frames."""
    count = len(images)
    view = geometry.view_at(camera, 0.0, camera.tilt_rad, camera.lens.reference_focal_px)
    numbered = list(enumerate(images))
    chained = chain(numbered, view, full_turn, config.sweep, lambda done: report("match sweep", done, count))
    turned = [geometry.view_at(camera, float(pan), camera.tilt_rad, view.focal_px) for pan in chained.pan_rad]
    links = [*chained.links, *link_further(chained.features, turned, camera.lens.width, config.sweep)]
    pan_rad = _adjusted(chained.pan_rad, links, view)
    brightness = stitching.fit_brightness(links, len(pan_rad), view, camera.lens.width, camera.lens.height)
    panorama = stitching.stitch(
        numbered, stitching.SweptFrames(chained.images, chained.kept, brightness, view), pan_rad, full_turn, FAR_AWAY,
        lambda done: report("paste sweep", done, 2 * len(pan_rad)),
    )  # fmt: skip
    return panorama, chained.kept


def _adjusted(pan_rad: Array, links: Sequence[Link], view: View) -> Array:
    """Pans (M,) that fit the turns between all linked frames best; the first is 0.

    Of a link's matches the median counts, with the weight of how many there are; turns that fit badly lose theirs.
    """
    first, second = np.array([link.first for link in links]), np.array([link.second for link in links])
    turn = np.array([
        np.median(
            geometry.pixel_to_direction(view, link.first_px)[0] - geometry.pixel_to_direction(view, link.second_px)[0]
        )
        for link in links
    ])  # fmt: skip
    matches = np.array([float(len(link.first_px)) for link in links])
    rows = np.arange(len(links))
    system = np.zeros((len(links), len(pan_rad)))
    system[rows, second] += 1.0
    system[rows, first] -= 1.0
    chained = pan_rad[second] - pan_rad[first]
    turn = chained + wrapped(turn - chained)  # a link may lie across the seam
    weight = np.sqrt(matches)
    pans = pan_rad
    for _ in range(PAN_ITERATIONS):
        pans = np.concatenate([[0.0], np.linalg.lstsq(system[:, 1:] * weight[:, None], turn * weight, rcond=None)[0]])
        residual = np.abs(system @ pans - turn)
        scale = max(3.0 * float(np.median(residual)), 1e-6)
        weight = np.sqrt(matches) * scale**2 / (scale**2 + residual**2)
    return pans
