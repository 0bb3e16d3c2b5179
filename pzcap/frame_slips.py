"""Cameras whose pictures are whole frames early or late: a start timecode that is wrong, or a frame that was lost in
the middle and the recording closed up, so that no stamp shows it.

The body is found from all cameras together. In each view it is laid to the colours of the athlete not only as it was
at that instant, but also as it was up to some frames before and after: the camera shows the instant that fits best.
Along a take that offset stays the same; where it changes by whole frames, and stays changed, frames were lost or
doubled. Clocks that are off by less than a frame are the tracker's (`pzcap.tracking.pixel_time`), which sees nothing of
larger offsets: such views contradict the others by more than it takes for an error of the images, and are passed over.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from pzcap.geometry.camera import project
from pzcap.segmentation.others import BEFORE
from pzcap.solver.viterbi import best_path
from pzcap.tracking.tracker import Tracked
from pzcap.tuning import SLIPS
from pzcap.types import PARENTS, Array, Camera, Localisation, Mask, PanZoomTrack, Silhouette

_OFFSETS: Final = np.arange(-SLIPS.reach * SLIPS.parts, SLIPS.reach * SLIPS.parts + 1) / SLIPS.parts
_ALONG: Final = np.linspace(0.0, 1.0, 6)
"""Shares of the way from a joint to the one before it, at which points are laid to the athlete."""


class Slip(NamedTuple):
    """Frames that a camera has lost, or doubled."""

    camera: int
    frame: int  # the first one that shows another instant
    lost: int  # frames; negative: so many too many


class _Kept(NamedTuple):
    camera: Camera  # scaled to the picture
    log_odds: NDArray[np.int8]  # (h, w) of the athlete, in 127ths of `SLIPS.most_log_odds`
    hidden: Mask  # (h, w) by somebody who stands before the athlete


class FrameOffsets:
    """Gathers the views as they come, and the body once it is known: pictures wait no longer than the tracker does."""

    def __init__(self, cameras: int) -> None:
        self._cameras = cameras
        self._views: dict[int, list[_Kept | None]] = {}
        self._points: dict[int, Array] = {}
        self._latest = -1
        self.scores: dict[int, Array] = {}  # frame -> (C, O) log-odds a point, of each of _OFFSETS; NaN: not told

    def see(self, frame: int, cameras: Sequence[Camera | None], silhouettes: Sequence[Silhouette | None]) -> None:
        """Keep what the views of a frame show of the athlete."""
        self._views[frame] = [
            None if camera is None or silhouette is None or not silhouette.valid else _kept(camera, silhouette)
            for camera, silhouette in zip(cameras, silhouettes, strict=True)
        ]

    def track(self, found: Sequence[Tracked]) -> None:
        """Take in the body of some frames, in order; score those that are between known ones by now."""
        for each in found:
            if each.valid and each.lost < SLIPS.most_lost:
                self._points[each.frame] = along_limbs(each.joints_m)
            self._latest = max(self._latest, each.frame)
        for frame in [each for each in self._views if each <= self._latest - SLIPS.reach]:
            self.scores[frame] = self._scored(frame, self._views.pop(frame))
        for frame in [each for each in self._points if each < self._latest - 2 * SLIPS.reach]:
            del self._points[frame]

    def _scored(self, frame: int, views: Sequence[_Kept | None]) -> Array:
        scores = np.full((self._cameras, len(_OFFSETS)), np.nan)
        bodies = [self._points.get(frame + offset) for offset in range(-SLIPS.reach, SLIPS.reach + 1)]
        if any(body is None for body in bodies):
            return scores
        points = _between_frames(np.array(bodies)).reshape(-1, 3)
        for number, view in enumerate(views):
            if view is not None:
                pixels, depth = project(view.camera, points)
                columns, rows = np.round(pixels).astype(int).T
                height, width = view.log_odds.shape
                inside = (depth > 0.0) & (columns >= 0) & (rows >= 0) & (columns < width) & (rows < height)
                seen = np.full(len(points), -127.0)
                seen[inside] = view.log_odds[rows[inside], columns[inside]]
                hidden = view.hidden[rows[inside], columns[inside]].sum() > SLIPS.most_hidden * len(points)
                if inside.mean() > 0.5 and not hidden:  # else the athlete walks out of the picture, or out of sight
                    scores[number] = seen.reshape(len(_OFFSETS), -1).mean(axis=1) * SLIPS.most_log_odds / 127.0
        return scores

    def offsets(self) -> tuple[list[int], Array]:
        """The frames (N,) that were told, and each camera's offset there, (N, C): how many frames late its pictures
        are, in parts of a frame that stay the same; NaN of one that tells nothing."""
        frames = self._told()
        scores = np.array([self.scores[frame] for frame in frames]).reshape(-1, self._cameras, len(_OFFSETS))
        found = np.full((len(frames), self._cameras), np.nan)
        for camera in range(self._cameras):
            told = np.isfinite(scores[:, camera]).all(axis=1)
            if told.any():
                path = _path(scores[told, camera])
                part = path[0] % 1.0
                between = np.interp(np.arange(len(frames)), np.flatnonzero(told), path)
                found[:, camera] = (between - part).round() + part
        return frames, found

    def _told(self) -> list[int]:
        """Frames in which any camera tells an offset."""
        return sorted(frame for frame, scores in self.scores.items() if np.isfinite(scores).any())

    def worth(self, camera: int, found: Array, instead: float) -> float:
        """Log-odds, a point, summed over the frames, by which a camera's offsets as ``found`` (N,), those of `offsets`,
        explain its pictures better than one offset ``instead`` of them does."""
        scores = [self.scores[frame][camera] for frame in self._told()]
        pairs = [(each, offset) for each, offset in zip(scores, found, strict=True) if np.isfinite(each).all()]
        return sum(
            float(np.interp(offset, _OFFSETS, each) - np.interp(instead, _OFFSETS, each)) for each, offset in pairs
        )


def along_limbs(joints_m: Array) -> Array:
    """(N, 3) Points between the joints (16, 3) and those before them."""
    parents = np.array(PARENTS[1:])
    way = joints_m[parents] - joints_m[1:]
    return np.asarray((joints_m[1:, None] + _ALONG[:, None] * way[:, None]).reshape(-1, 3))


def _between_frames(bodies: Array) -> Array:
    """Points (O, N, 3) of a body at each of _OFFSETS, from its points (2 REACH + 1, N, 3) in the frames."""
    before = np.minimum((_OFFSETS + SLIPS.reach).astype(int), 2 * SLIPS.reach - 1)
    share = (_OFFSETS + SLIPS.reach - before)[:, None, None]
    return np.asarray((1.0 - share) * bodies[before] + share * bodies[before + 1])


def _kept(camera: Camera, silhouette: Silhouette) -> _Kept:
    """Athlete's colours in a view, small."""
    height, width = silhouette.evidence.shape
    share = min(1.0, SLIPS.width / width)
    size = max(1, round(share * width)), max(1, round(share * height))
    hidden = cv2.resize((silhouette.others == BEFORE).astype(np.uint8), size) if silhouette.others.size else None
    odds = np.clip(silhouette.evidence, -SLIPS.most_log_odds, SLIPS.most_log_odds) * (127.0 / SLIPS.most_log_odds)
    small = cv2.resize(odds, size, interpolation=cv2.INTER_AREA)
    scale = np.array([size[0] / camera.width, size[1] / camera.height])
    principal = scale * (camera.principal_px + 0.5) - 0.5
    shrunk = replace(
        camera, width=size[0], height=size[1], focal_px=float(scale[0]) * camera.focal_px, principal_px=principal
    )
    nothing = np.zeros(size[::-1], np.uint8)
    return _Kept(shrunk, np.asarray(np.round(small), np.int8), (nothing if hidden is None else hidden) > 0)


def _path(scores: Array) -> Array:
    """(N,) the offsets, whole frames apart, that gather most of the ``scores`` (N, O)."""
    paths = [_path_of(scores[:, part :: SLIPS.parts], _OFFSETS[part :: SLIPS.parts]) for part in range(SLIPS.parts)]
    return max(paths, key=lambda path: path[0])[1]


def _path_of(scores: Array, offsets: Array) -> tuple[float, Array]:
    """The most that the ``scores`` (N, K) of some ``offsets`` (K,) add up to, each change costing ``SLIPS.change``, and
    the offsets (N,) that do. Of one that is a frame or more from the start, half of that is taken off: a timecode is
    wrong more often than that a frame is lost so soon (Viterbi)."""
    begin = -0.5 * SLIPS.change * (np.abs(offsets) >= 1.0)
    stay = SLIPS.change * (np.eye(len(offsets)) - 1.0)
    states = np.array(best_path([scores[0] + begin, *scores[1:]], [stay] * (len(scores) - 1)))
    changes = np.count_nonzero(np.diff(states))
    worth = begin[states[0]] + scores[np.arange(len(scores)), states].sum() - SLIPS.change * changes
    return float(worth), offsets[states]


def slips(frames: Sequence[int], offsets: Array, tracks: Sequence[PanZoomTrack | None]) -> list[Slip]:
    """Changes of the ``offsets`` (N, C) of a camera; the frame is that at which pan and zoom leap, where they do. A
    change that they contradict is none: loose clothes and lost limbs move the body, not the camera."""
    found = []
    for camera in range(offsets.shape[1]):
        for k in (np.flatnonzero(np.abs(np.diff(offsets[:, camera])) > 0.5) + 1).tolist():
            lost = round(offsets[k, camera] - offsets[k - 1, camera])
            track = tracks[camera]
            leap = None if track is None else leap_near(track, frames[k], lost)
            if leap is not None or track is None or not _contradicted(track, frames[k], lost):
                found.append(Slip(camera, frames[k] if leap is None else leap, lost))
    return found


def leap_near(track: PanZoomTrack, frame: int, lost: int, within: int = SLIPS.near) -> int | None:
    """The frame ``within`` so many of ``frame`` before which pan and zoom go ``1 + lost`` times as far as a frame
    before and after; None where the camera hardly moved, or moved otherwise."""
    steps, sigmas = _steps_beyond(track)
    strength = steps * sigmas * np.sign(lost)
    leaps = (strength > SLIPS.leap_sigmas) & (np.abs(np.abs(steps / lost) - 1.0) < 0.5)
    near = [k for k in range(max(2, frame - 1 - within), min(len(steps) - 2, frame + within)) if leaps[k]]
    return 1 + max(near, key=lambda k: float(strength[k])) if near else None


def _contradicted(track: PanZoomTrack, frame: int, lost: int) -> bool:
    """True if pan and zoom contradict that frames were ``lost`` about ``frame``: they would clearly leap, and leap
    nowhere there."""
    _, sigmas = _steps_beyond(track)
    around = sigmas[max(2, frame - 1 - SLIPS.near) : frame + SLIPS.near]
    clear = bool(around.size) and bool(np.all(abs(lost) * around > 2.0 * SLIPS.leap_sigmas))
    return clear and leap_near(track, frame, lost, SLIPS.far) is None


def _steps_beyond(track: PanZoomTrack) -> tuple[Array, Array]:
    """From each frame to the next, (F - 1,): how many steps further pan and zoom go than frames before and after let
    one expect, and how many standard deviations one step is; NaN where that is not known."""
    series = [track.pan_rad, np.log(track.focal_px)]
    steps = [np.diff(np.where(track.valid, each, np.nan)) for each in series]
    around = [_between(each) for each in steps]
    usual = [1.4826 * np.nanmedian(np.abs(a - b)) + 1e-7 for a, b in zip(steps, around, strict=True)]
    normal = np.sum([(b / s) ** 2 for b, s in zip(around, usual, strict=True)], axis=0) + 1e-12
    excess = np.sum([b * (a - b) / s**2 for a, b, s in zip(steps, around, usual, strict=True)], axis=0)
    return excess / normal, np.sqrt(normal)


def _between(steps: Array) -> Array:
    """(N,) each of some steps by those before and after it, a cubic; NaN where there are none."""
    found = np.full(len(steps), np.nan)
    if len(steps) >= 5:
        found[2:-2] = (-steps[:-4] + 4.0 * steps[1:-3] + 4.0 * steps[3:-1] - steps[4:]) / 6.0
    return found


def slip_notes(
    offsets: FrameOffsets, clocks: Array, tracks: Sequence[PanZoomTrack | None], names: Sequence[str],
    timecodes: Sequence[str],
) -> list[str]:  # fmt: skip
    """Notes on cameras that show other instants than the others do, and than their ``clocks`` (C,), frame periods,
    explain."""
    frames, found = offsets.offsets()
    if len(frames) < 2:
        return []
    notes = []
    told = np.flatnonzero(np.isfinite(found[0])).tolist()
    own = np.zeros(len(clocks))  # against the others'
    for camera in told if len(told) > 1 else ():
        own[camera] = clocks[camera] - np.median(clocks[[each for each in told if each != camera]])
    for camera, frame, lost in slips(frames, found, tracks):
        many = f"{abs(lost)} frame" + "s" * (abs(lost) > 1)
        what = f"{many} lost there, and the recording closed up" if lost > 0 else f"{many} too many there, doubled"
        notes.append(
            f"camera {names[camera]}: from frame {frame} ({timecodes[frame]}) on its pictures show the athlete "
            f"{many} {'later' if lost > 0 else 'earlier'} than before, against the other cameras: {what}; give the "
            "frames after it their true time stamps, or cut the take there"
        )
    for camera in told if len(told) > 2 else ():  # of two, each is as far from the other
        others = [other for other in told if other != camera]
        off = found[0, camera] - np.median(found[0, others])
        beyond, off = abs(off - own[camera]), round(off)
        right = float(clocks[camera] + np.median(found[0, others] - clocks[others]))  # if its timecode is
        if off and beyond > SLIPS.beyond_clock and offsets.worth(camera, found[:, camera], right) > SLIPS.change:
            many = f"{abs(off)} frame" + "s" * (abs(off) > 1)
            later, low = ("later", "low") if off > 0 else ("earlier", "high")
            notes.append(
                f"camera {names[camera]}: its pictures show the athlete {many} {later} than those of the other cameras "
                f"at the same time: its timecode is {many} too {low}, or what sync.json has in its place; correct it, "
                "or find it anew (pzcap sync FOLDER)"
            )
    return notes


def repeated_pictures(
    located: Sequence[Sequence[Localisation | None]], names: Sequence[str], timecodes: Sequence[str]
) -> list[str]:
    """Notes on cameras some of whose pictures are the one before once more; ``located``: the views of each frame."""
    notes = []
    for name, views in zip(names, zip(*located, strict=True), strict=False):
        frames = [frame for frame, one in enumerate(views) if one is not None and one.missed.any()]
        if len(frames) >= SLIPS.repeated:
            notes.append(
                f"camera {name}: in {len(frames)} frames, the first of them {frames[0]} ({timecodes[frames[0]]}), its "
                "picture is the one before once more, though it turns or zooms: pan and zoom are guessed there from "
                "those before; give the camera's own file, which nobody has converted or cut"
            )
    return notes
