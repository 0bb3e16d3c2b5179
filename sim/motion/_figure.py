"""Joints of a BVH file matched to the skeleton's, and the file's figure in the skeleton's axes."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from pzcap.types import SEGMENTS, Array, PzcapError
from sim.motion._bvh import Bvh

_SYNONYMS: Final[dict[str, tuple[str, ...]]] = {
    "pelvis": ("hips", "pelvis", "hip"),
    "head": ("head", "neck"),
    # "shoulder" is the collar bone in most files, and the arm in those that know a collar beside it
    "upper_arm": ("arm", "upperarm", "uparm", "shldr", "shoulder"),
    "forearm": ("forearm", "lowerarm", "lowarm", "elbow"),
    # where there are both, "hand" is the palm and "foot" the ball of the foot, as in SMPL
    "hand": ("wrist", "hand"),
    "thigh": ("upleg", "upperleg", "thigh", "hip"),
    "shank": ("leg", "lowerleg", "lowleg", "shin", "shank", "calf", "knee"),
    "foot": ("ankle", "foot"),
}
"""Names by CMU, Mixamo, Xsens, Rokoko, Poser, Blender, Unreal and SMPL of the joint at a segment's near end,
less "left" and "right". The first that is there is taken. The spine is found by what hangs from it."""
_NAMESPACE: Final = re.compile(r"^(.*:|mixamorig\d*|bip\d+)")
_AFFIXES: Final = (re.compile(r"^[^_.\- ]*[_.\- ]"), re.compile(r"[_.\- ][^_.\- ]*$"))
_NUMBER: Final = re.compile(r"\d+$")
_COMMON: Final = 0.6  # share of the joints that have an affix that says nothing; "left" stands in less than half
_UPRIGHT: Final = np.cos(np.pi / 4)
_SHORTEST: Final = 1e-3  # limb, of the figure's size


@dataclass(frozen=True, slots=True, eq=False)
class Figure:
    """The figure of a BVH file, x forward, y left, z up as it stands at rest; lengths still in the file's unit."""

    joint: dict[str, int]  # segment -> column of what follows; "lumbar" only if the file has a joint for it
    rest: Array  # (J, 3)
    ends: dict[int, Array]  # joint -> (3,) where what hangs from it points to, at rest
    places: Array  # (T, J, 3)
    turns: Array  # (T, J, 3, 3)


def match_joints(bvh: Bvh) -> Figure:
    """Match the joints. Raises PzcapError if one is missing or the figure does not stand while at rest."""
    joint = _named(bvh)
    joint |= _spine(bvh, joint)
    axes = _axes(bvh, joint)
    _check_limbs(bvh, joint)
    ends = dict(bvh.tips)
    for j in set(bvh.parents) - {-1}:
        ends[j] = bvh.rest[[child for child, parent in enumerate(bvh.parents) if parent == j]].mean(axis=0)
    return Figure(
        joint=joint,
        rest=bvh.rest @ axes.T,
        ends={j: axes @ end for j, end in ends.items()},
        places=bvh.places @ axes.T,
        turns=axes @ bvh.turns @ axes.T,
    )


def _named(bvh: Bvh) -> dict[str, int]:
    """The joints that go by a name: all but lumbar and thorax."""
    keys = [re.sub(r"[^a-z0-9]", "", name) for name in _without_affixes(bvh.names)]
    found, missing = {}, []
    for segment in SEGMENTS:
        if segment in ("lumbar", "thorax"):
            continue
        spelling = next((word for word in _spellings(segment) if word in keys), None)
        if spelling is None:
            missing.append(f"{segment} ({', '.join(_spellings(segment)[:2])}, ...)")
        else:
            found[segment] = keys.index(spelling)
    if missing:
        raise PzcapError(
            f"{bvh.path}: there is no joint for {', '.join(missing)}; rename the joints that stand for them"
        )
    return found


def _without_affixes(names: Sequence[str]) -> list[str]:
    """Names in lower case without what most of them share before or behind: Character1_Hips, Hips_rig, Hips_07."""
    bare = [_NAMESPACE.sub("", name.lower()) for name in names]
    for affix in _AFFIXES:
        while True:
            kinds = [_NUMBER.sub("#", match.group()) if (match := affix.search(name)) else "" for name in bare]
            most, count = Counter(kinds).most_common(1)[0]
            if not most or count < _COMMON * len(bare):
                break
            bare = [affix.sub("", name) if kind == most else name for name, kind in zip(bare, kinds, strict=True)]
    return bare


def _spellings(segment: str) -> list[str]:
    side, _, kind = segment.partition("_")
    if not kind:
        return list(_SYNONYMS[segment])
    return [
        spelling
        for word in _SYNONYMS[kind]
        for spelling in (f"{side}{word}", f"{side[0]}{word}", f"{word}{side}", f"{word}{side[0]}")
    ]


def _spine(bvh: Bvh, joint: dict[str, int]) -> dict[str, int]:
    """Thorax: what both arms hang from. Lumbar: the middle one of those between it and the pelvis, if there are any."""
    left = _chain(bvh, joint["left_upper_arm"])
    thorax = next((j for j in _chain(bvh, joint["right_upper_arm"]) if j in left), -1)
    chain = _chain(bvh, thorax) if thorax >= 0 else []
    if joint["pelvis"] not in chain[1:]:
        hips = bvh.names[joint["pelvis"]]
        raise PzcapError(f"{bvh.path}: there is no spine: both arms must hang from a joint that hangs from '{hips}'")
    between = chain[1 : chain.index(joint["pelvis"])]
    return {"thorax": thorax} | ({"lumbar": between[len(between) // 2]} if between else {})


def _chain(bvh: Bvh, joint: int) -> list[int]:
    """A joint and all that it hangs from."""
    chain = [joint]
    while bvh.parents[chain[-1]] >= 0:
        chain.append(bvh.parents[chain[-1]])
    return chain


def _check_limbs(bvh: Bvh, joint: dict[str, int]) -> None:
    """Position channels may move joints against their parents, and so onto them."""
    for side in ("left", "right"):
        for near, far in (("upper_arm", "forearm"), ("forearm", "hand"), ("thigh", "shank"), ("shank", "foot")):
            a, b = joint[f"{side}_{near}"], joint[f"{side}_{far}"]
            ways = np.concatenate([bvh.rest[None, b] - bvh.rest[None, a], bvh.places[:, b] - bvh.places[:, a]])
            shortest = float(np.linalg.norm(ways, axis=1).min())
            if shortest <= _SHORTEST * float(np.linalg.norm(bvh.rest, axis=1).max()):
                raise PzcapError(f"{bvh.path}: '{bvh.names[a]}' and '{bvh.names[b]}' coincide, at rest or in a frame")


def _axes(bvh: Bvh, joint: dict[str, int]) -> Array:
    """(3, 3) The directions forward, left and up of the figure at rest, a row each, in the file's axes."""
    rest = {segment: bvh.rest[j] for segment, j in joint.items()}
    across = rest["left_thigh"] - rest["right_thigh"]
    rise = rest["head"] - (rest["left_foot"] + rest["right_foot"]) / 2
    up = np.zeros(3)
    highest = int(np.argmax(np.abs(rise)))
    up[highest] = np.sign(rise[highest])
    left = across - (across @ up) * up
    upwards = [
        rest[upper] - rest[lower]
        for side in ("left", "right")
        for upper, lower in ((f"{side}_thigh", f"{side}_shank"), (f"{side}_shank", f"{side}_foot"), ("head", "pelvis"))
    ]
    if not left.any() or any(way @ up <= _UPRIGHT * np.linalg.norm(way) for way in upwards):
        raise PzcapError(
            f"{bvh.path}: with all rotations at 0 the figure does not stand upright; export it with a T-pose at rest"
        )
    left /= np.linalg.norm(left)
    return np.stack([np.cross(left, up), left, up])
