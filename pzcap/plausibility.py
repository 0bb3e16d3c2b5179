"""What the footage itself says against the papers and the crew: notes, each with its likely cause."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np

from pzcap.body.kinematics import joints
from pzcap.body.skeleton import Body
from pzcap.calibration.calibrate import CalibratedCamera
from pzcap.geometry.camera import project
from pzcap.types import Camera, Keyframe, Silhouette

_FOCAL: Final = 2e-4
"""Difference of the focal lengths of reference image and sweep, which a locked lens keeps to 2e-5; a lens that focused
anew in the middle of a sweep leaves 1e-3."""

_EVEN: Final = 127
"""Of a silhouette, from which on a pixel shows the athlete rather than not."""


def lens_moved(name: str, calibrated: CalibratedCamera) -> str | None:
    """A note where the sweep of camera ``name`` was taken through another lens than the reference image."""
    still_px, sweep_px = calibrated.reference.camera.focal_px, calibrated.camera.lens.reference_focal_px
    if abs(sweep_px / still_px - 1.0) < _FOCAL:
        return None
    return (
        f"camera {name}: the focal length of its sweep, {sweep_px:.2f} px, is not that of its reference image, "
        f"{still_px:.2f} px: focus or zoom have moved; set both by hand and shoot the sweep again"
    )


class SeenViews(NamedTuple):
    """The cameras of an instant, and the athlete's outline in each."""

    cameras: Sequence[Camera | None]
    silhouettes: Sequence[Silhouette | None]


def unseen_keyframes(
    keyframes: Sequence[Keyframe], body: Body, views: Mapping[int, SeenViews], timecodes: Sequence[str]
) -> list[str]:
    """Notes on the keyframes that no camera has anybody at. ``views``: those of each keyframe's frame."""
    blind = [key for key in keyframes if key.frame in views and not _is_seen(key, body, views[key.frame])]
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
        if np.any(silhouette.probability[row, column] > _EVEN):
            return True
    return not told
