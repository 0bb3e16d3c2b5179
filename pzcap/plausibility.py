"""Contradictions of the footage to the papers and the crew: notes, each with its likely cause."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import cv2
import numpy as np

from pzcap.body.anthropometry import contradictions
from pzcap.body.kinematics import joints
from pzcap.body.skeleton import Body
from pzcap.calibration.calibrate import CalibratedCamera
from pzcap.geometry.camera import project, wrapped
from pzcap.tracking.bidirectional_fusion import runs
from pzcap.tracking.body_size import BodySize, seen_sizes
from pzcap.tuning import PLAUSIBILITY
from pzcap.types import MEASUREMENTS, Camera, Keyframe, Mask, PzcapError, Silhouette, Subject

_OBJECT: Final = "object.json: "  # begins a note
_SCALES: Final = tuple(percent / 100 for percent in range(70, 141))
"""Sizes of the hall that are tried, as shares of what object.json makes it."""


def object_of_other_shape(name: str, calibrated: CalibratedCamera) -> str | None:
    """A note where camera ``name`` sees the corners of the calibration object elsewhere than object.json has them: its
    focal length and place are then wrong, too, and nothing of the motion need fit."""
    residuals_px = calibrated.reference.residuals_px
    off_px = float(np.median(np.hypot(*residuals_px.T))) if len(residuals_px) else 0.0
    if off_px < PLAUSIBILITY.corners_px:
        return None
    return (
        f"camera {name}: the calibration object's corners are {off_px:.1f} px from where object.json has them: it is "
        "of another object, or some lengths in it are wrong; measure it again"
    )


def open_circle(name: str, calibrated: CalibratedCamera) -> str | None:
    """A note where the sweep of camera ``name``, said to go all the way round, has a gap."""
    panorama = calibrated.panorama
    if panorama.full_turn:
        return None
    pan_rad = np.sort(wrapped(panorama.sweep_pan_rad))
    widths = np.diff(np.append(pan_rad, pan_rad[0] + 2.0 * np.pi))
    right = int(np.argmax(widths))
    ends_deg = np.rad2deg(wrapped(pan_rad[right] + np.array([0.0, widths[right]])))
    from_deg, to_deg = (f"{abs(end):.0f} {'left' if end > 0.0 else 'right'}" for end in ends_deg)
    return (
        f"camera {name}: from {from_deg} to {to_deg} (degrees from the reference image) its sweep shows nothing twice, "
        f"a bare wall or a blurred turn, and so does not close: focal lengths are known to "
        f"{calibrated.camera.focal_sigma:.2%}; hang something up there, or turn more slowly"
    )


def check_upright(cameras: Sequence[CalibratedCamera | None]) -> None:
    """Check that the z axis of the world that object.json sets points up. Raises PzcapError where most ``cameras`` lie
    on their side in it, or hang."""
    up = [-float(each.reference.camera.world_T_cam[2, 1]) for each in cameras if each is not None]
    if up and float(np.median(up)) < PLAUSIBILITY.upright:
        deg = np.rad2deg(np.arccos(np.clip(np.median(up), -1.0, 1.0)))
        raise PzcapError(
            f"object.json: the cameras stand turned by {deg:.0f} degrees in its world, whose z axis has to point up; "
            "correct its corners (docs/capture.md), or set the object, or the cameras, upright"
        )


def unlocated(name: str, valid: Mask, timecodes: Sequence[str]) -> list[str]:
    """A note where many frames of camera ``name`` are not ``valid`` (F,): the others alone carry the body there."""
    lost = np.flatnonzero(~valid)
    if len(lost) <= PLAUSIBILITY.unlocated * len(valid):
        return []
    first, last = (f"{frame} ({timecodes[frame]})" for frame in (lost[0], lost[-1]))
    return [
        f"camera {name}: not located in {len(lost)} of {len(valid)} frames from {first} to {last}: its pictures are "
        "missing there, or fit its panorama nowhere; pzcap check says which"
    ]


def lost_body(lost: Mapping[int, float], timecodes: Sequence[str]) -> list[str]:
    """A note on the stretches of frames in which the body is not where silhouettes show somebody; ``lost``: the
    probability of that, a frame."""
    where = _stretches([frame for frame, probability in lost.items() if probability > 0.5], timecodes)
    what = "the views show somebody where it is not: one who is not told from the athlete, or the athlete"
    return [f"the body may be lost in {where}; {what}; pose a keyframe there"] if where else []


def is_touched(silhouettes: Sequence[Silhouette | None]) -> bool:
    """True if somebody else touches the athlete's outline, or nearly so, in most views: one who stands before or behind
    the athlete does in some, one who is near does in all."""
    seen = [one for one in silhouettes if one is not None and one.valid]
    touching = sum(map(_touches, seen))
    return touching >= PLAUSIBILITY.touching_views and 2 * touching > len(seen)


def _touches(silhouette: Silhouette) -> bool:
    """True if a good part of the band about the athlete's outline shows somebody else."""
    if not silhouette.others.any():
        return False
    height, width = silhouette.others.shape
    athlete = (silhouette.probability[::2, ::2] > PLAUSIBILITY.even)[:height, :width]
    rows = np.flatnonzero(athlete.any(axis=1))
    if not len(rows):
        return False
    tall = int(rows[-1] - rows[0]) + 1
    reach = max(round(PLAUSIBILITY.touching_reach * tall), 1)
    disk = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    near = (cv2.dilate(athlete.astype(np.uint8), disk) > 0) & (silhouette.others > 0)
    return bool(near.sum() > PLAUSIBILITY.touching_share * tall * reach)


def company(touched: Sequence[int], timecodes: Sequence[str]) -> list[str]:
    """A note on the stretches of frames in which somebody else is at the athlete's side, the frames ``touched``."""
    where = _stretches(touched, timecodes)
    what = "a hand or a foot may be taken for the other's; look at these frames, and pose a keyframe where it was"
    return [f"somebody else touches the athlete, or nearly so, in {where}: {what}"] if where else []


def _stretches(frames: Sequence[int], timecodes: Sequence[str]) -> str:
    """Text of the number of ``frames`` in stretches that are worth a word, and of the longest; "" if there are none."""
    marked = np.zeros(len(timecodes), bool)
    marked[list(frames)] = True
    stretches = [each for each in runs(marked) if len(each) >= PLAUSIBILITY.lost_frames]
    if not stretches:
        return ""
    longest, count = max(stretches, key=len), sum(map(len, stretches))
    more = f" and {len(stretches) - 1} more stretch{'es' * (len(stretches) > 2)}" if len(stretches) > 1 else ""
    return f"{count} frames: {longest[0]} to {longest[-1]} ({timecodes[longest[0]]} to {timecodes[longest[-1]]}){more}"


class SeenViews(NamedTuple):
    """The cameras of an instant, and the athlete's outline in each."""

    cameras: Sequence[Camera | None]
    silhouettes: Sequence[Silhouette | None]


class SeenKeyframe(NamedTuple):
    """Judgement of a keyframe by the views of its instant. The pictures themselves are let go."""

    key: Keyframe
    blind: bool  # no camera has anybody there
    on_athlete: Mask  # (N,) joints, view by view, that lie on the athlete by the colours
    by_scale: Mask  # (len(_SCALES), N) the same in halls of other sizes, by views that were not told where to look
    sizes: list[float]  # of the athlete over the body's, as `seen_sizes` has them


def seen_keyframe(key: Keyframe, body: Body, views: SeenViews, unbiased: SeenViews, margin: float) -> SeenKeyframe:
    """Judge a keyframe by its ``views``. Those that are ``unbiased`` were cut out by the colours alone, where a body
    that is expected elsewhere leaves no trace."""
    return SeenKeyframe(
        key, not _is_seen(key, body, views), _on_athlete(key, body, views, (1.0,))[0],
        _on_athlete(key, body, unbiased, _SCALES), seen_sizes(body, key.pose, *views, margin),
    )  # fmt: skip


def unseen_keyframes(keyframes: Sequence[SeenKeyframe], timecodes: Sequence[str]) -> list[str]:
    """Notes on the keyframes that no camera has anybody at."""
    blind = [each.key for each in keyframes if each.blind]
    if len(blind) == len(keyframes) > 1:
        return [
            "no view shows anybody where any of the keyframes stands: their root_position_m are not metres in the "
            "world frame that object.json sets, or object.json is wrong"
        ]
    notes = []
    for key in blind:
        place = ", ".join(f"{x:.2f}" for x in key.pose.root_position_m)
        notes.append(
            f"keyframe {key.frame} ({timecodes[key.frame]}): no view shows anybody where it stands, ({place}) m; "
            "correct its root_position_m or its timecode"
        )
    return notes


def object_of_another_size(keyframes: Sequence[SeenKeyframe]) -> str | None:
    """A note where the keyframes fit the pictures of a hall of another size, and not of this one.

    All tripods stand at distances that object.json is the yardstick of, while a keyframe's place and the body's lengths
    are metres of another tape. With the tripods moved along their lines to the world's origin by the right factor, the
    joints lie on the athlete again; of a factor that is off by 0.05 half of them do not.
    """
    if len(keyframes) < 2:  # one may be wrong itself
        return None
    on_athlete = np.hstack([each.by_scale for each in keyframes])
    if not on_athlete.size:
        return None
    shares = dict(zip(_SCALES, on_athlete.mean(axis=1).tolist(), strict=True))
    highest = max(shares.values())
    best = round(float(np.mean([scale for scale, share in shares.items() if share > highest - PLAUSIBILITY.alike])), 2)
    if (
        abs(best - 1.0) < PLAUSIBILITY.same_size
        or highest < PLAUSIBILITY.fits
        or highest - shares[1.0] < PLAUSIBILITY.better
    ):
        return None
    # tripods too far by so much: what is written is too large
    kind = "smaller" if best < 1.0 else "larger"
    return (
        f"{_OBJECT}the calibration object is about {abs(best - 1.0):.0%} {kind} than it says: with every length in it "
        f"times {best:.2f}, {highest:.0%} of the keyframes' joints lie on the athlete, and now {shares[1.0]:.0%}; "
        "measure it again"
    )


def guessed_measurements(subject: Subject, body: Body) -> list[str]:
    """A note where measurements are missing."""
    missing = [name for name in MEASUREMENTS if name not in subject.measurements_m]
    if not missing:
        return []
    worst = max(missing, key=body.measured.sigma)
    worst_mm = 1e3 * body.measured.sigma(worst)
    return [
        f"subject.json: {len(missing)} of {len(MEASUREMENTS)} measurements are missing and were guessed from the rest "
        f"by the statistics of a population; the least certain of them is {worst}, to {worst_mm:.0f} mm"
    ]


def contradictory_readings(subject: Subject) -> list[str]:
    """A note for each reading that contradicts the others: two digits exchanged, another unit, another person's."""
    return [
        f"subject.json: {one.name} is {one.reading:.4g}, where people with all its other measurements have "
        f"{one.expected:.3g}, give or take {one.sigma:.2g}: likeliest a slip of the pen, and hardly believed; "
        "measure it again"
        for one in contradictions(subject)
    ]


def athlete_of_another_size(size: BodySize | None, on_athlete: float) -> list[str]:
    """A note where subject.json contradicts the pictures. ``on_athlete``: the share of the keyframes' joints that lie
    on the athlete. The keyframes stand where the cameras see the athlete, in metres of the calibration object, so that
    these two bear each other out."""
    if size is None or not size.contradicts:
        return []
    kind = "larger" if size.ratio > 1.0 else "smaller"
    return [
        f"subject.json: in the pictures the athlete is {abs(size.ratio - 1.0):.1%} {kind} than it says (standard "
        f"deviation {size.sigma:.1%}), in all lengths and girths together; object and keyframes bear each other out "
        f"({on_athlete:.0%} of the keyframes' joints lie on the athlete), so that the measurements are likeliest "
        f"wrong, somebody else's or of another unit. They were taken times {size.ratio:.3f}; measure again"
    ]


def share_on_athlete(keyframes: Sequence[SeenKeyframe]) -> float:
    """Share of the keyframes' joints that lie on the athlete by the colours."""
    hits = [hit for each in keyframes for hit in each.on_athlete.tolist()]
    return float(np.mean(hits)) if hits else 0.0


def blames_object(notes: Sequence[str]) -> bool:
    """True where the notes say that object.json is wrong, so that no keyframe need be."""
    return any(note.startswith(_OBJECT) for note in notes)


def _on_athlete(key: Keyframe, body: Body, seen: SeenViews, scales: Sequence[float]) -> Mask:
    """(S, N) The keyframe's joints, view by view, that lie on the athlete by the colours, in halls so many times as
    large."""
    times, points = np.array(scales)[:, None, None], joints(body, key.pose)
    hits = [np.zeros((len(scales), 0), bool)]
    for camera, silhouette in zip(*seen, strict=True):
        if camera is None or silhouette is None or not silhouette.valid:
            continue
        # a tripod so much further off sees what its own place would see nearer by as much
        apart = points - (times - 1.0) * camera.world_T_cam[:3, 3]
        pixels, depth = project(camera, apart.reshape(-1, 3))
        inside = (depth > 0.0) & np.all((pixels >= 0.0) & (pixels < (camera.width - 1, camera.height - 1)), axis=1)
        halved = np.minimum((pixels[inside] / 2).astype(int), np.array(silhouette.evidence.shape)[::-1] - 1)
        on = np.zeros(len(inside), bool)
        on[inside] = silhouette.evidence[halved[:, 1], halved[:, 0]] > 0.0
        hits.append(on.reshape(len(scales), -1))
    return np.hstack(hits)


def _is_seen(key: Keyframe, body: Body, seen: SeenViews) -> bool:
    """True where a joint lies on the athlete in a view, or no view tells where the athlete is."""
    told = False
    for camera, silhouette in zip(seen.cameras, seen.silhouettes, strict=True):
        if camera is None or silhouette is None or not silhouette.valid:
            continue
        told = True
        pixels, depth = project(camera, joints(body, key.pose))
        inside = (depth > 0.0) & np.all((pixels >= 0.0) & (pixels < (camera.width - 1, camera.height - 1)), axis=1)
        column, row = np.round(pixels[inside]).astype(int).T
        if np.any(silhouette.probability[row, column] > PLAUSIBILITY.even):
            return True
    return not told
