"""Suspicions about results: files that read well, and do not mean what the format says. One line each.

Numbers in another unit or order are still numbers. What gives them away is that the truth fits far better once the
mistake is undone: each test here undoes one, and speaks only where the error falls to a fifth.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from pzcap.scoring.records import CameraTrack, Results, TrueCapture, matched
from pzcap.scoring.suspicions_of_body import suspicious_body
from pzcap.scoring.suspicions_of_cameras import Seen, suspicious_cameras
from pzcap.types import PzcapError

FARTHEST_M: Final = 100.0  # nothing that these captures show is further from the object than this


def suspicions(results: Results, truth: TrueCapture | None) -> list[str]:
    """Suspicions: what is probably not meant as it is written.

    Raises PzcapError for what cannot be scored against ``truth``.
    """
    found = [*_by_themselves(results)]
    if truth is None:
        return found
    if results.image_size is not None and results.image_size != truth.image_size:
        raise PzcapError(
            f"image_size is {list(results.image_size)} where the images are {list(truth.image_size)}; give pixels of "
            "the images as they were handed out"
        )
    if results.capture and truth.name and results.capture != truth.name:
        found.append(f"results of the capture '{results.capture}' are scored as '{truth.name}'")
    frames, known = matched(results, truth)
    seen = []
    for name, track in zip(results.camera_names, results.cameras, strict=True):
        if track is not None and np.any(track.valid & known):
            at = np.flatnonzero(track.valid & known)
            seen.append(Seen(name, track, truth.camera_names.index(name), at, frames[at]))
    found += suspicious_cameras(seen, truth, results.own_world)
    if results.body is not None:
        found += suspicious_body(results.body, truth, frames, known)
    return list(dict.fromkeys(found))


def _by_themselves(results: Results) -> Iterator[str]:
    """Suspicions that need no truth."""
    tracks = [(n, t) for n, t in zip(results.camera_names, results.cameras, strict=True) if t is not None]
    if tracks and not any(track.valid.any() for _, track in tracks):
        yield "no camera has a valid frame: nothing is scored"
    for name, track in tracks:
        yield from _strange_track(name, track)
    body = results.body
    if body is None:
        return
    joints = body.joints_m[body.valid]
    if not len(joints):
        yield "no joint is valid: nothing is scored"
        return
    if not body.valid[~body.keyframe].any():
        yield "keyframes are all the frames that have joints, and are not scored: list those set by hand"
    if np.median(np.linalg.norm(joints, axis=1)) > FARTHEST_M:
        yield "joints lie hundreds of metres away: millimetres? write metres"
    pelvis = body.joints_m[body.valid[:, 0], 0]
    nowhere = body.valid & np.all(body.joints_m == 0.0, axis=2)
    if len(pelvis) and np.abs(pelvis).max() < 1e-6 and not nowhere[:, 1:].any():
        yield "the pelvis is at the origin in every frame: joints relative to it? write world coordinates"
    elif nowhere.any():
        yield (
            f"{nowhere.sum()} joints are exactly at 0, 0, 0, the first in frame {np.argmax(nowhere.any(axis=1))}: not "
            "found? they are scored as they stand; leave their rows out, or their cells blank"
        )
    if body.sigma_m is not None and np.median(body.sigma_m[body.valid]) > 1.0:
        yield "sigma_m is above a metre: millimetres? write metres"


def _strange_track(name: str, track: CameraTrack) -> Iterator[str]:
    valid = track.valid
    if not valid.any():
        return
    if track.pan_rad is not None and np.abs(track.pan_rad[valid]).max() > 2.5 * np.pi:
        yield f"camera {name}: pan_rad is beyond a full turn: degrees? write radians"
    if track.covariance is not None and np.median(track.covariance[valid, 1, 1]) > 1.0:
        yield f"camera {name}: var_logf is above 1: of the focal length in pixels? write that of its logarithm"
    if track.poses is None:
        return
    if np.median(np.linalg.norm(track.poses.position_m[valid], axis=1)) > FARTHEST_M:
        yield f"camera {name}: stands hundreds of metres away: millimetres? write metres"
    width = 2.0 * np.median(track.poses.principal_px[valid, 0])
    if width > 0.0 and np.median(track.focal_px[valid]) < 0.15 * width:
        yield f"camera {name}: focal_px is far below the image's width: millimetres? write pixels"
