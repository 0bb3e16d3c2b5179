"""The athlete at the keyframes: as large as subject.json and object.json make them, and where the keyframes say?

The posed body is projected into the pictures of its instant, by cameras that are placed as roughly as a check does:
panned and zoomed as the picture stands on the sweep. What differs from the empty hall in the picture is covered by that
silhouette, larger or smaller, here or there: where all that differs lies in it, and nothing about it, it fits.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from pzcap.body import kinematics, skeleton
from pzcap.body.skeleton import Body
from pzcap.command.check.findings import Finding, Level
from pzcap.command.check.reference_check import Reference
from pzcap.command.check.sweep_check import Sweep
from pzcap.command.check.tuning import BODY
from pzcap.command.check.views import Relation, View, best, view
from pzcap.geometry.camera import project
from pzcap.io.capture import frame_sets
from pzcap.io.video import VideoReader
from pzcap.types import Array, Camera, Capture, Image, Indices, Mask, Pose, PzcapError

_RATIOS: Final = np.arange(0.70, 1.42, 0.02)


@dataclass(frozen=True, slots=True)
class Seen:
    """One picture: the athlete's size against the projected body's, and how far away, in its heights."""

    ratio: float
    away: float


def check_body(
    capture: Capture, references: Mapping[str, Reference], sweeps: Mapping[str, Sweep],
    reference_rad: Mapping[str, float],
) -> Iterator[Finding]:  # fmt: skip
    """The athlete's size and place as the keyframes have them."""
    if capture.subject is None:
        return
    try:
        sets = frame_sets(capture)
    except PzcapError:  # it has been said
        return
    if not sets.keyframes:
        return
    body = skeleton.build(capture.subject)
    faces = skeleton.moved(body).skin_faces
    some = np.unique(np.linspace(0, len(sets.keyframes) - 1, BODY.keyframes).round().astype(int)).tolist()
    seen: list[Seen] = []
    for number, files in enumerate(capture.cameras):
        reference, sweep = references.get(files.name), sweeps.get(files.name)
        if files.motion is None or reference is None or reference.camera is None or sweep is None:
            continue
        reader, pictures = VideoReader(files.motion), sets.pictures(number)
        for key in (sets.keyframes[k] for k in some):
            index = pictures[key.frame]
            if index is None:
                continue
            image = next(reader.read(index, index + 1))[1]
            found = _seen(image, skin(body, key.pose), faces, reference.camera.camera, sweep, reference_rad[files.name])
            if found is not None:
                seen.append(found)
    yield from judged(seen)


def judged(seen: Sequence[Seen]) -> Iterator[Finding]:
    """Findings about the athlete as seen in some pictures."""
    if len(seen) < BODY.fewest:
        return
    ratio, away = (float(np.median([getattr(each, name) for each in seen])) for name in ("ratio", "away"))
    if away > BODY.away:
        text = (
            f"the athlete stands {away:.1f} body heights from where the keyframes put them; is object.json of another "
            "size, or keyframes.json of another take?"
        )
        yield Finding(Level.FAIL, "", "keyframes", text)
    elif abs(ratio - 1.0) > BODY.off:
        text = (
            f"the athlete looks {ratio:.2f} times as large as subject.json makes them; is it of another person, or "
            "object.json of an object of another size?"
        )
        yield Finding(Level.WARN, "", "subject", text)
    else:
        yield Finding(Level.OK, "", "subject", f"the athlete looks {ratio:.2f} times as large as subject.json says")


def skin(body: Body, pose: Pose) -> Array:
    """(V, 3) the skin of a body in a pose."""
    moved = skeleton.moved(body)
    return kinematics.world_points(kinematics.forward(body, pose), moved.skin_segment, moved.skin_m)


def _seen(
    image: Image, skin_m: Array, faces: Indices, reference: Camera, sweep: Sweep, reference_rad: float
) -> Seen | None:
    """The athlete in a picture against a posed body; None where they cannot be told from the hall."""
    here = view(image)
    index, relation = best(here, sweep.keys)
    if not relation.found:
        return None
    turned = float(sweep.key_angles_rad[index] - np.arctan(relation.across / sweep.focal)) - reference_rad
    focal_px = sweep.focal * reference.width / relation.scale
    camera = _aimed(reference, turned, focal_px)
    pixels = project(camera, skin_m)[0] * (here.picture.shape[1] / camera.width)
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    height, width = here.picture.shape
    tall = float(high[1] - low[1])
    if tall < BODY.smallest_px or (low < 0).any() or high[0] > width or high[1] > height:
        return None
    return _covered(_changed(here, sweep.keys[index], relation), pixels, faces, tall)


def _aimed(reference: Camera, turned_rad: float, focal_px: float) -> Camera:
    """The reference camera, turned to the left about the vertical and zoomed."""
    pose = reference.world_T_cam.copy()
    pose[:3, :3] = Rotation.from_rotvec([0.0, 0.0, turned_rad]).as_matrix() @ pose[:3, :3]
    return replace(reference, world_T_cam=pose, focal_px=focal_px)


def _changed(here: View, key: View, relation: Relation) -> Image:
    """(h, w) 255 where a picture differs from the empty hall, 0 elsewhere."""
    height, width = here.picture.shape
    middle, turn = np.array([(width - 1) / 2, (height - 1) / 2]), np.deg2rad(relation.turn_deg)
    similar = relation.scale * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    shift = middle + width * np.array([relation.across, relation.down]) - similar @ middle
    way = np.column_stack([similar, shift])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    empty = np.asarray(cv2.warpAffine(key.picture, way, (width, height), flags=flags, borderValue=0), np.uint8)
    known = cv2.warpAffine(np.full_like(key.picture, 255), way, (width, height), flags=flags, borderValue=0) > 254
    if not known.any():
        return np.zeros((height, width), np.uint8)
    gain = _lighting(here.picture, empty, known)
    # edges of the hall are displaced a little by the perspective: what differs has to from all that is near it
    apart = here.picture.astype(np.float32)
    near = gain * empty.astype(np.float32)
    low, high = cv2.erode(near, np.ones((3, 3), np.uint8)), cv2.dilate(near, np.ones((3, 3), np.uint8))
    changed = known & ((apart < low - BODY.changed) | (apart > high + BODY.changed))
    return np.asarray(255 * changed, np.uint8)


def _lighting(here: Image, empty: Image, known: Mask) -> Array:
    """(h, 1) brightness of the rows of a picture over that of the empty hall, which bands of light vary: medians of all
    that is ``known`` of some rows together, or of the whole picture where that is little."""
    ratios = np.where(known, here / np.maximum(empty, 1.0), np.nan)
    whole, half = float(np.nanmedian(ratios)), BODY.rows // 2
    gains = np.full((len(here), 1), whole)
    for row in np.flatnonzero(known.mean(axis=1) > 0.5).tolist():
        gains[row] = np.nanmedian(ratios[max(row - half, 0) : row + half + 1])
    return gains


def _covered(changed: Image, pixels: Array, faces: Indices, tall: float) -> Seen | None:
    """Size and place at which the silhouette of skin at ``pixels`` (V, 2) covers what has ``changed`` best, by the
    coefficient of Dice: twice what both have over what each has."""
    middle = (pixels.min(axis=0) + pixels.max(axis=0)) / 2
    half = np.ceil(np.abs(pixels - middle).max(axis=0) * _RATIOS[-1]).astype(int) + 1
    border = int(round(tall) + half.max())
    edges = (border, border, border, border)
    around = np.asarray(cv2.copyMakeBorder(changed, *edges, cv2.BORDER_CONSTANT, value=[0.0]), np.float32) / 255.0
    there = cv2.matchTemplate(around, np.ones((2 * half[1] + 1, 2 * half[0] + 1), np.float32), cv2.TM_CCORR)
    rows, columns = np.mgrid[: there.shape[0], : there.shape[1]]
    away = np.hypot(columns + half[0] - border - middle[0], rows + half[1] - border - middle[1]) / tall
    best_score, found = BODY.least_score, None
    for ratio in _RATIOS.tolist():
        inside = np.zeros((2 * half[1] + 1, 2 * half[0] + 1), np.uint8)
        for corners in np.round((pixels - middle)[faces] * ratio + half).astype(np.int32):
            cv2.fillConvexPoly(inside, corners, 1)
        both = cv2.matchTemplate(around, inside.astype(np.float32), cv2.TM_CCORR)
        scores = np.where(away < BODY.furthest, 2.0 * both / (float(inside.sum()) + there), 0.0)
        at = np.unravel_index(int(np.argmax(scores)), scores.shape)
        if scores[at] > best_score:
            best_score, found = float(scores[at]), Seen(ratio, float(away[at]))
    return found
