"""The scale of the world, by distances in the hall that somebody has measured and pointed out in pictures.

An end of a length lies where its lines of sight pass each other; an end that one picture alone shows lies on the floor,
whose height the cameras know. What a click is off by, and the cameras' places, make the uncertainty of a point; of a
length only what lies along it counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pzcap.geometry import camera as geometry
from pzcap.initialisation.tuning import LENGTHS
from pzcap.types import Array, Camera, PzcapError

_UP = np.array([0.0, 0.0, 1.0])


class Sight(NamedTuple):
    """A point as a camera sees it."""

    camera: Camera
    px: Array  # (2,) as if all rows had been exposed at once
    place_sigma_m: float  # of the camera


class Point(NamedTuple):
    """A point where lines of sight meet."""

    place_m: Array  # (3,)
    covariance_m2: Array  # (3, 3)
    misfit: float  # of the lines: root mean square distance in standard deviations; 0 for a single one
    missed_m: float  # by the line that passes furthest off


class Ratio(NamedTuple):
    """A length that was measured, over what the cameras make of it."""

    name: str
    log: float
    sigma: float  # of the logarithm


class Scale(NamedTuple):
    """Length of the cameras' unit, by all lengths."""

    factor: float  # metres
    sigma: float  # relative
    apart: tuple[str, ...]  # names of lengths that contradict the others, and do not count
    torn: tuple[str, ...] = ()  # names of all, where as many say one thing as another: the mean counts


def meet(sights: Sequence[Sight], floor_sigma_m: float) -> Point:
    """The point that all ``sights`` show; of a single one, where it meets the floor, z = 0 to ``floor_sigma_m``.

    Raises PzcapError where lines of sight are parallel to each other, or to the floor, or meet behind a camera.
    """
    origins = np.array([sight.camera.world_T_cam[:3, 3] for sight in sights])
    rays = np.concatenate([geometry.rays(sight.camera, sight.px[None]) for sight in sights])
    beside = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    floor = np.outer(_UP, _UP) if len(sights) == 1 else np.zeros((3, 3))
    sigma_m = np.full(len(sights), 1.0)
    for _ in range(2):  # how far a line may be off follows from how far away the point is
        information = np.einsum("n,nij->ij", sigma_m**-2.0, beside) + floor / floor_sigma_m**2
        if np.linalg.cond(information) > LENGTHS.most_condition:
            raise PzcapError("their lines of sight do not meet")
        place = np.linalg.solve(information, np.einsum("n,nij,nj->i", sigma_m**-2.0, beside, origins))
        away = np.einsum("ni,ni->n", rays, place - origins)
        if np.any(away <= 0.0):
            raise PzcapError("their lines of sight meet behind a camera")
        pixel_rad = LENGTHS.click_px / np.array([sight.camera.focal_px for sight in sights])
        sigma_m = np.hypot(away * pixel_rad, [sight.place_sigma_m for sight in sights])
    missed_m = np.linalg.norm(np.einsum("nij,nj->ni", beside, place - origins), axis=1)
    freedom = 2 * len(sights) - 3
    misfit = float(np.sqrt(np.sum((missed_m / sigma_m) ** 2) / freedom)) if freedom > 0 else 0.0
    return Point(place, np.asarray(np.linalg.inv(information)), misfit, float(missed_m.max()))


def ratio_of(name: str, length_m: float, sigma_m: float, ends: tuple[Point, Point]) -> Ratio:
    """A length between two points. Raises PzcapError where these are one and the same."""
    between = ends[1].place_m - ends[0].place_m
    seen = float(np.linalg.norm(between))
    if seen < LENGTHS.least_m:
        raise PzcapError("its ends are one and the same point")
    along = between / seen
    seen_sigma = float(np.sqrt(along @ (ends[0].covariance_m2 + ends[1].covariance_m2) @ along))
    return Ratio(name, float(np.log(length_m / seen)), float(np.hypot(seen_sigma / seen, sigma_m / length_m)))


def scale_of(ratios: Sequence[Ratio], shared: float) -> Scale:
    """The scale by those ``ratios`` that most others agree with. Each has one vote, since a length that was written
    down too long looks the surest of all. ``shared``: lengths that a mark is an end of, in the mean."""
    logs, sigmas = (np.array(column) for column in zip(*((one.log, one.sigma) for one in ratios), strict=True))
    agree = np.abs(logs[:, None] - logs) <= LENGTHS.most_sigmas * np.hypot(sigmas[:, None], sigmas)
    votes, weights = agree.sum(axis=1), sigmas**-2.0
    most = votes == votes.max()
    lead = int(np.argmax(np.where(most, agree @ weights, 0.0)))
    torn = bool(np.any(most & ~agree[lead]))  # as many others contradict these
    kept = np.ones(len(ratios), bool) if torn else agree[lead]
    mean = float(np.average(logs[kept], weights=weights[kept]))
    variance = shared / weights[kept].sum()
    if kept.sum() > 1:  # what contradicts itself is known less well
        variance *= max(1.0, float(weights[kept] @ (logs[kept] - mean) ** 2 / (kept.sum() - 1)))
    names = np.array([one.name for one in ratios])
    apart, contradictory = names[~kept].tolist(), names.tolist() if torn else []
    return Scale(float(np.exp(mean)), float(np.sqrt(variance)), tuple(apart), tuple(contradictory))
