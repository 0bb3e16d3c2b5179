"""The zero pose as a rig: joints and ends as one list, and the skin about them. What USD and glTF are written from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from pzcap.body.mesh import vertex_normals
from pzcap.types import ENDS, PARENTS, SEGMENTS, Array, Indices, MovedBody

BONES: Final[tuple[str, ...]] = (*SEGMENTS, *ENDS)  # segments, then ends as leaves that never turn
BONE_PARENTS: Final[tuple[int, ...]] = (*PARENTS, *(SEGMENTS.index(segment) for segment in ENDS.values()))


@dataclass(frozen=True, slots=True, eq=False)
class RestPose:
    """The zero pose, the pelvis joint in the origin."""

    offsets_m: Array  # (23, 3) of each bone in its parent's frame
    places_m: Array  # (23, 3) of each bone
    skin_m: Array  # (V, 3)
    normals: Array  # (V, 3) unit, outward
    carriers: Indices  # (V,) the bone that carries a vertex
    faces: Indices  # (T, 3) counter-clockwise seen from outside


def rest_pose(body: MovedBody) -> RestPose:
    """The zero pose of a body."""
    offsets = np.vstack([body.offsets_m, body.ends_m])
    places = np.zeros_like(offsets)
    for bone, parent in enumerate(BONE_PARENTS):
        places[bone] = offsets[bone] + (places[parent] if parent >= 0 else 0.0)
    skin = body.skin_m + places[body.skin_segment]
    return RestPose(offsets, places, skin, vertex_normals(skin, body.skin_faces)[0], body.skin_segment, body.skin_faces)
