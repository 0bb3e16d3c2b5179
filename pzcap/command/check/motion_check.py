"""Motion: whether its pictures fit the camera's own sweep, or another camera's, or a mirror; range of pan and zoom."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from pzcap.camera_notes import ON_ITS_SIDE
from pzcap.command.check.findings import Finding, Level
from pzcap.command.check.forecast import Shutter
from pzcap.command.check.sweep_check import MAINS, Sweep
from pzcap.command.check.tuning import MOTION, VIEWS
from pzcap.command.check.views import ENOUGH, NOTHING, Relation, best, mirrored, overlap, small, step, view
from pzcap.command.check.zoom_check import ZoomRun
from pzcap.imaging.comb import comb_of, comb_px
from pzcap.io.video import VideoReader
from pzcap.solver.robust import normal_sigma
from pzcap.types import Array, Image, Mask


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """Places of some pictures on a sweep."""

    images: tuple[Image, ...]
    relations: tuple[Relation, ...]
    angles_rad: Array  # (N,) on the sweep, to the left

    @property
    def found(self) -> Mask:
        """(N,) that could be placed."""
        return np.array([relation.found for relation in self.relations], bool)

    @property
    def strength(self) -> float:
        """Features that agree, a picture; those of pictures that could not be placed do not count."""
        return float(np.mean([relation.inliers if relation.found else 0 for relation in self.relations]))

    @property
    def level_strength(self) -> float:
        """The same of the pictures that lie on the sweep as those of its own camera do, at its tilt: a sign on a wall,
        seen from elsewhere, fits by itself, above or below."""
        level = [abs(each.down) < MOTION.level * max(each.scale, 1.0) for each in self.relations]
        return replace(
            self, relations=tuple(each if fits else NOTHING for each, fits in zip(self.relations, level, strict=True))
        ).strength


def place(images: Sequence[Image], sweep: Sweep) -> Places:
    """Place pictures on a sweep."""
    found = [best(view(image), sweep.keys) for image in images]
    angles = [sweep.key_angles_rad[index] - np.arctan(relation.across / sweep.focal) for index, relation in found]
    return Places(tuple(images), tuple(relation for _, relation in found), np.array(angles))


def samples(path: Path, count: int = MOTION.samples) -> list[Image]:
    """Some pictures of a video, evenly over its length."""
    reader = VideoReader(path)
    wanted = reader.indices[
        np.linspace(0, len(reader.indices) - 1, min(count, len(reader.indices))).round().astype(int)
    ]
    return [image for index in wanted.tolist() for _, image in reader.read(index, index + 1)]


def check_belonging(
    camera: str, subject: str, images: Sequence[Image], sweeps: Mapping[str, Sweep]
) -> tuple[Places, list[Finding]]:
    """Pictures of a camera on its own sweep; where they hardly fit, on those of others and in a mirror. Cameras in one
    hall share walls, so that another's pictures may fit a little: they are of the camera that they fit best."""
    own = place(images, sweeps[camera])
    if own.strength < MOTION.sure:
        others = {name: place(images, sweep).level_strength for name, sweep in sweeps.items() if name != camera}
        best_other = max(others, key=lambda name: others[name], default=camera)
        if others and others[best_other] > max(ENOUGH, MOTION.better * own.strength):
            text = f"fits the sweep of camera {best_other}, not its own; were two cameras' files swapped?"
            return own, [Finding(Level.FAIL, camera, subject, text)]
    share = float(np.mean(own.found))
    if share < MOTION.fewest:
        text = "its pictures do not fit the sweep; was the tripod moved, or is it of another camera or hall?"
        if place([mirrored(image) for image in images], sweeps[camera]).strength > ENOUGH:
            text = "is mirrored against the sweep: it fits in a mirror; record it straight"
        return own, [Finding(Level.FAIL, camera, subject, text)]
    turned = float(np.median([abs(r.turn_deg) for r in own.relations if r.found]))
    if turned > MOTION.turned_deg:
        text = f"stands turned by {turned:.0f} degrees against the sweep; record both the same way up"
        return own, [Finding(Level.FAIL, camera, subject, text)]
    level = Level.OK if share >= MOTION.usual else Level.WARN
    return own, [Finding(level, camera, subject, f"{own.found.sum()} of {len(images)} pictures fit the sweep")]


def check_tilt(camera: str, subject: str, places: Places, sweep: Sweep) -> Iterator[Finding]:
    """Check that the tilt is that of the sweep. Zoom moves the middle of the picture a little: only much is told."""
    down = np.array([r.down / max(r.scale, 1.0) for r in places.relations if r.found])
    tilts = np.rad2deg(down / sweep.focal)
    if not len(tilts):
        return
    tilt, (low, high) = float(np.median(tilts)), np.percentile(tilts, MOTION.tilts)
    if high - low > MOTION.tilted_deg:
        text = (
            f"its head was tilted while it filmed, over {high - low:.1f} degrees: reconstruct with --free-tilt, or "
            "lock the tilt and film again"
        )
        yield Finding(Level.WARN, camera, subject, text)
    elif abs(tilt) > MOTION.tilt_deg:
        way = "lower" if tilt > 0 else "higher"
        text = f"looks {abs(tilt):.2f} degrees {way} than the sweep; the tripod was moved, or settled"
        yield Finding(Level.FAIL if abs(tilt) > 1.0 else Level.WARN, camera, subject, text)


def check_ranges(camera: str, places: Places, sweep: Sweep, run: ZoomRun, full_turn: bool) -> Iterator[Finding]:
    """Check that pan and zoom of the motion stay inside those of sweep and zoom run."""
    found = places.found
    if not found.any():
        return
    scales = 1.0 / np.array([r.scale for r in places.relations])[found]
    angles = places.angles_rad[found]
    half = np.arctan(0.5 / (sweep.focal * scales))
    text = (
        f"pans over {np.rad2deg(np.ptp(angles)):.1f} degrees at {scales.min():.2f} to {scales.max():.2f} times the"
        " focal length of the sweep"
    )
    yield Finding(Level.OK, camera, "motion", text)
    if not full_turn:
        low, high = sweep.angles_rad.min(), sweep.angles_rad.max()
        edge = np.arctan(0.5 / sweep.focal)
        beyond = np.rad2deg(
            max(0.0, float((low - edge - angles + half).max()), float((angles + half - high - edge).max()))
        )
        if beyond > 0.5:
            text = f"shows {beyond:.0f} degrees that the sweep does not; sweep further on that side"
            yield Finding(Level.WARN, camera, "motion", text)
    if run.widest is None or run.longest is None:
        return
    if scales.max() > 1.08 * run.longest or scales.min() < run.widest / 1.08:
        text = "zooms beyond the zoom run; distortion is not known there: zoom over the whole range"
        yield Finding(Level.WARN, camera, "motion", text)


def check_shutter(camera: str, path: Path) -> tuple[Shutter, list[Finding]]:
    """Shutter of a camera, and findings where bands of light lie over its rows, where these are of two instants though
    the file does not say so, or are shown as columns."""
    reader = VideoReader(path)
    start = int(reader.indices[len(reader.indices) // 2])
    pictures, combs_px = [], []  # small: forty of 4K are a gigabyte
    for _, image in reader.read(start, start + MOTION.row_pictures):
        pictures.append(small(image, VIEWS.step_width))
        combs_px.append(comb_px(image))
    flicker = row_flicker(pictures[: MOTION.band_pictures])
    turned_px = reader.width * np.array([step(one, other)[0] for one, other in pairwise(pictures)])
    comb = comb_of(np.array(combs_px[:-1]), turned_px)
    woven = comb is not None and comb.is_woven
    shutter, texts = Shutter(reader.interlaced or woven, flicker > MOTION.bands), []
    if shutter.banded:
        change = f"{100 * flicker:.0f} %"
        texts.append(f"light lies over it in bands, which change by {change} from picture to picture; {MAINS}")
    if reader.on_its_side:
        texts.append(ON_ITS_SIDE)
    if comb is not None and woven:
        texts.append(
            "odd and even rows are of two instants: it is interlaced video, and the file does not say so; copy the "
            f"original again, or say it: {comb.cure(path.name)}"
        )
    return shutter, [Finding(Level.WARN, camera, "motion", text) for text in texts]


def row_flicker(images: Sequence[Image]) -> float:
    """Scatter of the brightness of rows from one picture to the next, relative: lamps that flicker while the shutter
    rolls lay bands over them, elsewhere in each."""
    pictures, changes = [small(image, VIEWS.step_width) for image in images], []
    for one, other in pairwise(pictures):
        before, after = (_rows(part) for part in overlap(one, other, step(one, other)[0]))
        changes.append(np.log(after / before))
    if not changes:
        return 0.0
    return normal_sigma(changes - np.mean(changes, axis=1, keepdims=True))


def _rows(picture: Array) -> Array:
    """(12,) brightness of the rows, those of a twelfth of the picture together."""
    return np.array([max(float(part.mean()), 1.0) for part in np.array_split(picture, 12) if part.size])


def check_light(camera: str, places: Places, sweep: Sweep) -> Iterator[Finding]:
    """Check that the motion is as bright as the sweep was."""
    bright = float(np.mean([np.mean(image) for image in places.images]))
    ratio = bright / max(sweep.brightness, 1.0)
    if not 0.6 < ratio < 1.7:
        text = f"is {ratio:.1f} times as bright as the sweep; keep exposure and gain, or light the hall as it was"
        yield Finding(Level.WARN, camera, "motion", text)
