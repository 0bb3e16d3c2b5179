"""The athlete among the people that a detector found in several views, and which side of the body is which.

A detector looks at one picture at a time: it finds whoever is there, and takes a left arm for a right one where a body
turns its back or stands on its hands. Views that show one instant cannot all be wrong alike. Of the people that are
seen in several views, the athlete is the one whom the cameras follow; of the ways to exchange left and right in some of
the views, that one is right whose rays meet, as few views exchanged as possible and each for some frames, and nobody
changes sides from frame to frame (both by dynamic programming over the frames, `pzcap.solver.viterbi`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise, product
from typing import Final, NamedTuple

import numpy as np

from pzcap.initialisation.triangulation import Rays, Triangulated, rays_of, triangulate
from pzcap.initialisation.tuning import PEOPLE
from pzcap.io.detections import ROW
from pzcap.solver.viterbi import best_path
from pzcap.tracking.keypoint_residuals import with_error
from pzcap.types import Array, Camera, Indices

_GROUPS: Final = (
    ("shoulder", "elbow", "wrist"), ("hip", "knee", "ankle", "big_toe", "small_toe", "heel"), ("eye", "ear"),
)  # fmt: skip
"""Keypoints whose sides a detector exchanges together."""
_SIDES: Final[tuple[Indices, ...]] = tuple(
    np.array([[ROW[f"{side}_{name}"] for name in names] for side in ("left", "right")]) for names in _GROUPS
)
_MIDDLES: Final[Indices] = np.array(
    [[ROW[f"left_{name}"], ROW[f"right_{name}"]] for group in _GROUPS for name in group]
    + [[ROW[name]] * 2 for name in ("nose", "neck", "mid_hip", "head_top")]
)
"""Pairs of keypoints whose middle is the same whatever side is which."""


@dataclass(frozen=True, slots=True, eq=False)
class Detections:
    """Detections of one instant. A view whose camera is not known is None."""

    views: tuple[tuple[Camera, Array] | None, ...]  # one a camera: people (P, 26, 3) as in `pzcap.io.detections`
    sigma_rad: tuple[float, ...] = ()  # one a camera, of where it looks; none: nothing is known against it


Sighting = tuple[tuple[Camera, Array] | None, ...]
"""The athlete at one instant: keypoints (26, 3) a view; None where the athlete is not found."""


def athlete(instants: Sequence[Detections]) -> list[Sighting]:
    """The athlete's keypoints in each view of successive ``instants``, left and right put right. Their confidence is
    what the error of the camera leaves of it."""
    return [_doubted(*pair) for pair in zip(_sides_put_right(_followed(instants)), instants, strict=True)]


def _doubted(sighting: Sighting, instant: Detections) -> Sighting:
    """The sighting with confidences that answer for the cameras' errors, too, where the rays of a view meet others."""
    views = [view for view in sighting if view is not None]
    if not instant.sigma_rad or len(views) < 2:
        return sighting
    met = triangulate(rays_of(views, PEOPLE.least_confidence), PEOPLE.agree_m)
    middle = np.median(met.points_m[met.found], axis=0) if met.found.any() else None
    found: list[tuple[Camera, Array] | None] = []
    for view, sigma_rad in zip(sighting, instant.sigma_rad, strict=True):
        if view is None or middle is None:
            found.append(view)
            continue
        camera, person = view
        off_m = sigma_rad * float(np.linalg.norm(middle - camera.world_T_cam[:3, 3]))
        found.append((camera, np.column_stack([person[:, :2], with_error(person[:, 2], off_m)])))
    return tuple(found)


# --------------------------------------------------------------------------------------------------------------
# Who


class _Person(NamedTuple):
    """Somebody, as several views have them."""

    chosen: tuple[int | None, ...]  # a view each: which of its people
    score: float
    centre_m: Array | None  # (3,) None: no two views agree


_NOBODY: Final[float] = -1e3


def _followed(instants: Sequence[Detections]) -> list[Sighting]:
    """The person whom the cameras follow, in each view of each instant."""
    found = [_people(instant) for instant in instants]
    scores = [np.array([person.score for person in people]) for people in found]
    transitions = [_jumps(people, following) for people, following in pairwise(found)]
    path = best_path(scores, transitions)
    return [
        tuple(
            None if view is None or one is None else (view[0], view[1][one])
            for view, one in zip(instant.views, people[k].chosen, strict=True)
        )
        for instant, people, k in zip(instants, found, path, strict=True)
    ]


def _people(instant: Detections) -> list[_Person]:
    """The people of an instant, each with the detections that agree best; nobody, where nobody is found."""
    left = [[] if view is None else most_central(view[0], view[1])[: PEOPLE.most_people] for view in instant.views]
    people: list[_Person] = []
    while any(left):
        best = max((_judged(instant, chosen) for chosen in _choices(left)), key=lambda person: person.score)
        people.append(best)
        if best.centre_m is None:
            break
        left = [[one for one in own if one != taken] for own, taken in zip(left, best.chosen, strict=True)]
    return people or [_Person((None,) * len(instant.views), _NOBODY, None)]


def _choices(left: Sequence[Sequence[int]]) -> list[tuple[int | None, ...]]:
    """All ways to take one of the people ``left`` in each view, or nobody where there are several in any."""
    if max(map(len, left)) < 2:
        return [tuple(own[0] if own else None for own in left)]
    if len(left) > PEOPLE.most_views:  # too many ways: everybody's most central
        return [tuple(own[0] if own else None for own in left)]
    ways = product(*([*own, None] for own in left))
    return [way for way in ways if any(one is not None for one in way)]


def most_central(camera: Camera, people: Array) -> list[int]:
    """The people (P, 26, 3) of a view, those nearest to the picture's middle first."""
    return sorted(range(len(people)), key=lambda one: _off_centre(camera, people[one]))


def _off_centre(camera: Camera, person: Array) -> float:
    """Distance of a person from the middle of the picture, in its widths."""
    seen = person[person[:, 2] > 0.0, :2]
    if not len(seen):
        return 1.0
    return float(np.linalg.norm(np.median(seen, axis=0) - [camera.width / 2, camera.height / 2])) / camera.width


def _judged(instant: Detections, chosen: tuple[int | None, ...]) -> _Person:
    """The person that these detections are of, and how well they agree about it."""
    views = [
        (view[0], view[1][one]) for view, one in zip(instant.views, chosen, strict=True) if view and one is not None
    ]
    off = float(np.mean([_off_centre(camera, person) for camera, person in views]))
    if len(views) < 2:
        return _Person(chosen, _NOBODY / 2 - off, None)
    middles = [(camera, _middles(person)) for camera, person in views]
    met = triangulate(rays_of(middles, PEOPLE.least_confidence), PEOPLE.agree_m)
    if not met.found.any():
        return _Person(chosen, _NOBODY / 2 - off, None)
    disagreeing = sum(int(np.sum(person[:, 2] > 0.0)) for _, person in middles) - int(met.agreeing.sum())
    score = (met.agreeing[:, met.found].sum() - disagreeing) / len(_MIDDLES) - PEOPLE.central * off * len(views)
    return _Person(chosen, float(score), np.median(met.points_m[met.found], axis=0))


def _middles(person: Array) -> Array:
    """Middles (M, 3) of pairs of keypoints, with the lesser confidence of the two."""
    pairs = person[_MIDDLES]  # (M, 2, 3)
    return np.column_stack([pairs[..., :2].mean(axis=1), pairs[..., 2].min(axis=1)])


def _jumps(people: Sequence[_Person], following: Sequence[_Person]) -> Array:
    """(N', N) score of following one person from an instant to the next."""
    found = np.zeros((len(following), len(people)))
    for row, there in enumerate(following):
        for column, here in enumerate(people):
            if here.centre_m is not None and there.centre_m is not None:
                moved_m = float(np.linalg.norm(there.centre_m - here.centre_m))
                found[row, column] = -PEOPLE.jump * min(moved_m / PEOPLE.jump_m, 1.0) ** 2
    return found


# --------------------------------------------------------------------------------------------------------------
# Left and right


def _sides_put_right(sightings: Sequence[Sighting]) -> list[Sighting]:
    """The athlete, left and right exchanged where a detector took them for one another."""
    people = [[None if view is None else view[1].copy() for view in sighting] for sighting in sightings]
    wrong: list[set[int]] = [set() for _ in sightings]  # views in which all sides before were exchanged
    for number, (sides, agree_m) in enumerate(zip(_SIDES, PEOPLE.sides_agree_m, strict=True)):
        exchanged = _exchanged(sightings, sides, agree_m, wrong if number == len(_SIDES) - 1 else None)
        wrong = [set(one) & before if number else set(one) for one, before in zip(exchanged, wrong, strict=True)]
        for persons, flipped in zip(people, exchanged, strict=True):
            for view in flipped:
                person = persons[view]
                if person is not None:
                    person[sides.ravel()] = person[sides[::-1].ravel()]
    return [
        tuple(
            None if view is None or person is None else (view[0], person)
            for view, person in zip(sighting, persons, strict=True)
        )
        for sighting, persons in zip(sightings, people, strict=True)
    ]


def _exchanged(
    sightings: Sequence[Sighting], sides: Indices, agree_m: float, expected: Sequence[set[int]] | None
) -> list[tuple[int, ...]]:
    """The views of each instant in which the two ``sides`` (2, N) of the body are to be exchanged, as few as the rays
    allow besides those that are ``expected``. Rays that pass by each other further off than ``agree_m`` are of
    different keypoints."""
    states = [_patterns([v for v, view in enumerate(sighting) if view is not None]) for sighting in sightings]
    met = [_met(sighting, patterns, sides, agree_m) for sighting, patterns in zip(sightings, states, strict=True)]
    usual = [set[int]()] * len(states) if expected is None else expected
    unusual = [
        [one.symmetric_difference(pattern) for pattern in patterns] for one, patterns in zip(usual, states, strict=True)
    ]
    scores = [
        _agreement(each, len(sets), agree_m) - PEOPLE.exchange * sides.size * np.array([len(one) for one in sets])
        for each, sets in zip(met, unusual, strict=True)
    ]
    ways = [_points(each, len(sets)) for each, sets in zip(met, unusual, strict=True)]
    transitions = [
        _steps(*points) - PEOPLE.change * sides.size * _changes(*sets)
        for points, sets in zip(pairwise(ways), pairwise(unusual), strict=True)
    ]
    return [patterns[k] for patterns, k in zip(states, best_path(scores, transitions), strict=True)]


def _patterns(views: Sequence[int]) -> list[tuple[int, ...]]:
    """Sets of views that may be exchanged: all, or of many views those of as few as there is time for."""
    found: list[tuple[int, ...]] = []
    for size in range(len(views) + 1):
        if size > 1 and len(found) > PEOPLE.most_patterns:
            break
        found += combinations(views, size)
    return found


def _met(
    sighting: Sighting, patterns: Sequence[tuple[int, ...]], sides: Indices, agree_m: float
) -> Triangulated | None:
    """The keypoints of both ``sides`` (2, N) under each pattern, one pattern after the other; None of less than two
    views."""
    views = [view for view in sighting if view is not None]
    if len(views) < 2:
        return None
    rays = rays_of([(camera, person[sides.ravel()]) for camera, person in views], PEOPLE.least_confidence)
    number = {v: n for n, v in enumerate(v for v, view in enumerate(sighting) if view is not None)}
    count = sides.size
    straight, crossed = np.arange(count), np.arange(count).reshape(2, -1)[::-1].ravel()
    order = np.tile(straight, (len(views), len(patterns), 1))
    for row, flipped in enumerate(patterns):
        order[[number[v] for v in flipped], row] = crossed
    order = order.reshape(len(views), -1)
    directions = np.take_along_axis(rays.directions, order[..., None], axis=1)
    return triangulate(Rays(rays.origins, directions, np.take_along_axis(rays.confidence, order, axis=1)), agree_m)


def _agreement(met: Triangulated | None, patterns: int, agree_m: float) -> Array:
    """(P,) how well the rays of each pattern meet: of each agreeing ray 1 where it meets, 0 where it just agrees."""
    if met is None:
        return np.zeros(patterns)
    worth = np.where(met.agreeing, 1.0 - (met.misses_m / agree_m) ** 2, 0.0)
    return np.asarray(worth.sum(axis=0).reshape(patterns, -1).sum(axis=1))


def _points(met: Triangulated | None, patterns: int) -> Array:
    """(P, N, 4) points of each pattern, and 1 where it is found."""
    if met is None:
        return np.zeros((patterns, 1, 4))
    return np.column_stack([met.points_m, met.found]).reshape(patterns, -1, 4)


def _changes(before: Sequence[set[int]], after: Sequence[set[int]]) -> Array:
    """(P', P) number of views that are in one of two sets alone, from an instant's to the next one's."""
    return np.array([[len(old ^ new) for old in before] for new in after], np.float64)


def _steps(here: Array, there: Array) -> Array:
    """(P', P) score of the way from one instant's patterns (P, N, 4) to the next one's."""
    if here.shape[1] != there.shape[1]:
        return np.zeros((len(there), len(here)))
    apart = np.linalg.norm(there[:, None, :, :3] - here[None, :, :, :3], axis=-1)
    both = there[:, None, :, 3] * here[None, :, :, 3]
    return np.asarray(-PEOPLE.step * np.sum(both * np.minimum(apart / PEOPLE.step_m, 1.0), axis=-1))
