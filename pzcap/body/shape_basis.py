"""Basis of what a body may differ by from its measurements: segment lengths, and the skin's shape at stations along
each segment.

Each correction is a number of metres. A length moves joints and stretches the skin between them. The skin's own
corrections are affine in a segment's frame (deeper, wider, further ahead, ...), for the whole segment or tapering off
linearly about one of its stations. Left and right are taken to be alike.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pzcap.body.mesh import girths_along
from pzcap.body.skeleton import Body
from pzcap.body.tuning import SHAPE
from pzcap.types import LUMBAR_FRACTION, MEASUREMENTS, PARENTS, SEGMENTS, THORAX_FRACTION, Array, Indices, without_side

LENGTHS: Final = 8  # corrections that move joints: the first ones

_NEAR, _FAR = SHAPE.stations - 1, 0
_MIDDLES: Final = {
    "upper_arm": (_FAR,), "forearm": (_NEAR, _FAR), "hand": (_NEAR,), "thigh": (_FAR,), "shank": (_NEAR,),
}  # fmt: skip
"""Stations of a limb that a hinge lies at."""


@dataclass(frozen=True, slots=True, eq=False)
class Basis:
    """Change of a body by each of P corrections, each in metres."""

    joints: Array  # (P, 16, 3) of a segment's joint in its parent's frame
    skin: Array  # (P, 16, 3, 4) of a point (x, y, z, 1) in its segment's frame, at the station
    station: Indices  # (P,) along the segment; SHAPE.stations: the whole of it
    covariance_m2: Array  # (P, P) prior
    doubt: Array  # (P,) factor of the deviation that is left of the prior's, as it turns out to be
    told: Array  # (P, 26) metres of a correction for each metre that a measurement is off by
    span: Array  # (16, 4) takes a point (x, y, z, 1) of a segment to 0 at one end of it, 1 at the other

    @property
    def sigma_m(self) -> Array:
        """(P,) of the prior."""
        return np.asarray(np.sqrt(np.diag(self.covariance_m2)))

    def skin_change(self, segment: int, local: Array, along: Array) -> Array:
        """Derivatives (N, P) of ``along . point`` for skin points (N, 3) of a segment and directions (N, 3), both in
        its frame."""
        change = np.zeros((len(local), len(self.station)))
        mine = np.flatnonzero(self.skin[:, segment].any(axis=(1, 2)))
        points = _homogeneous(local)
        moments = (along[:, :, None] * points[:, None]).reshape(-1, 12)
        share = self._shares(segment, points)[:, self.station[mine]]
        change[:, mine] = share * (moments @ self.skin[mine, segment].reshape(-1, 12).T)
        return change

    def carried(self, world_T_segment: Array) -> Array:
        """(P, 16, 3) what a correction moves each joint by, in the world, the pose's numbers kept."""
        moved = np.zeros_like(self.joints)
        for s, parent in enumerate(PARENTS):
            if parent >= 0:
                moved[:, s] = moved[:, parent] + self.joints[:, s] @ world_T_segment[parent, :3, :3].T
        return moved

    def displaced(self, segment: int, local: Array, amounts_m: Array) -> Array:
        """Skin points (N, 3) of a segment, in its frame, after corrections (P,)."""
        points = _homogeneous(local)
        share = self._shares(segment, points)[:, self.station]
        affine = ((share * amounts_m) @ self.skin[:, segment].reshape(-1, 12)).reshape(-1, 3, 4)
        return local + np.einsum("nij,nj->ni", affine, points)

    def _shares(self, segment: int, points: Array) -> Array:
        """(N, SHAPE.stations + 1) how much of each station's corrections a point takes on, and all of the whole's."""
        at = (SHAPE.stations - 1) * np.clip(points @ self.span[segment], 0.0, 1.0)
        hats = np.maximum(1.0 - np.abs(at[:, None] - np.arange(SHAPE.stations)), 0.0)
        return np.column_stack([hats, np.ones(len(hats))])


def _homogeneous(points: Array) -> Array:
    return np.column_stack([points, np.ones(len(points))])


def _segments(name: str) -> list[int]:
    return [i for i, segment in enumerate(SEGMENTS) if without_side(segment) == name]


def _stretch(axis: int, per_m: float, about_m: float = 0.0) -> Array:
    affine = np.zeros((3, 4))
    affine[axis, axis], affine[axis, 3] = per_m, -per_m * about_m
    return affine


def _shift(axis: int, by: float = 1.0) -> Array:
    affine = np.zeros((3, 4))
    affine[axis, 3] = by
    return affine


class _Row(NamedTuple):
    """One correction. ``told`` (26,): its metres for each metre that a measurement is off by."""

    joints: Array  # (16, 3)
    skin: Array  # (16, 3, 4)
    station: int
    sigma_m: float  # beside what the measurements leave open
    told: Array


class _Rows:
    """Corrections as they are listed."""

    def __init__(self, radii_m: Array) -> None:
        self.rows: list[_Row] = []
        self.centred: list[tuple[int, int]] = []  # rows whose sum moves a limb off the hinge at a station
        self._radii_m = radii_m  # (16,)

    def length(self, name: str, joints: Mapping[int, Sequence[float]], skin: Mapping[int, Array]) -> None:
        """Correction of a length that was measured."""
        told = _told({name: 1.0})
        self.rows.append(_Row(_rows(joints, (3,)), _rows(skin, (3, 4)), SHAPE.stations, 0.0, told))

    def whole(self, skin: Mapping[int, Array], told: Array | None = None) -> None:
        self._skin(skin, SHAPE.stations, SHAPE.skin_sigma, _told({}) if told is None else told)

    def stations(self, skin: Mapping[int, Array], told: Array | None = None, hinges: Sequence[int] = ()) -> None:
        """The whole segment, and each station by itself; ``told`` (SHAPE.stations, 26) of these. ``hinges`` are the
        stations at which a hinge lies, off whose middle these corrections move the skin."""
        self.whole(skin)
        whole = len(self.rows) - 1
        for station in range(SHAPE.stations):
            self._skin(skin, station, SHAPE.station_sigma, _told({}) if told is None else told[station])
        self.centred += [(whole, whole + 1 + station) for station in hinges]

    def _skin(self, skin: Mapping[int, Array], station: int, sigma: float, told: Array) -> None:
        sigma_m = sigma * float(self._radii_m[list(skin)].mean())
        self.rows.append(_Row(_rows({}, (3,)), _rows(skin, (3, 4)), station, sigma_m, told))


def _told(table: Mapping[str, float]) -> Array:
    """(26,) of all measurements, 0 of those that are not in the ``table``."""
    return np.array([table.get(name, 0.0) for name in MEASUREMENTS])


def _rows(table: Mapping[int, ArrayLike], shape: tuple[int, ...]) -> Array:
    """(16, *shape) of all segments, 0 of those that are not in the ``table``."""
    rows = np.zeros((len(SEGMENTS), *shape))
    for segment, values in table.items():
        rows[segment] = values
    return rows


def basis(body: Body) -> Basis:
    """The corrections of ``body``: first the eight lengths, then its skin's.

    A priori they vary as the measurements do that they follow from (``told``), and the skin as much again as a person
    departs from ellipses of the right girths, which is a share of the segment's radius. Hinges lie in the middle of
    their limbs: elbow and knee of both, the wrist of forearm and hand.
    """
    rows = _Rows(_radii_m(body))
    _lengths(body, rows)
    _skin(body, rows)
    joints, skin, station, sigma, told = (np.array(column) for column in zip(*rows.rows, strict=True))
    # nobody knows how far cloth stands off
    clothed = skin.any(axis=(2, 3))  # (P, 16)
    room = clothed @ body.loose_m / np.maximum(clothed.sum(axis=1), 1)
    cloth = np.where(sigma > 0.0, SHAPE.loose * room, 0.0)
    measured = told @ body.measured.covariance_m2 @ told.T
    covariance = measured + np.diag(sigma**2 + cloth**2)
    own = np.sqrt(np.diag(measured) + sigma**2)
    doubt = np.hypot(SHAPE.doubt_of_skin * own, cloth) / np.hypot(own, cloth)
    doubt[:LENGTHS] = SHAPE.doubt_of_lengths
    return Basis(joints, skin, station, _centred(covariance, rows.centred), doubt, told, _spans(body))


def _radii_m(body: Body) -> Array:
    """(16,) half the mean thickness of each segment across it."""
    radii = np.zeros(len(SEGMENTS))
    for segment, name in enumerate(SEGMENTS):
        across = [1, 2] if name.endswith("foot") else [0, 1]
        radii[segment] = 0.5 * np.ptp(body.surface.points_m[body.surface.segment == segment][:, across], axis=0).mean()
    return radii


def _centred(covariance_m2: Array, pairs: Sequence[tuple[int, int]]) -> Array:
    """The covariance (P, P) of corrections after the sum of each pair was seen to be 0, to `SHAPE.centred_sigma_m`."""
    seen = np.zeros((len(pairs), len(covariance_m2)))
    for row, pair in zip(seen, pairs, strict=True):
        row[list(pair)] = 1.0
    shared = covariance_m2 @ seen.T
    innovation = seen @ shared + SHAPE.centred_sigma_m**2 * np.eye(len(pairs))
    return np.asarray(covariance_m2 - shared @ np.linalg.solve(innovation, shared.T))


def _lengths(body: Body, rows: _Rows) -> None:
    trunk = float(body.offsets_m[[1, 2, 3], 2].sum())
    shoulders, hips = _segments("upper_arm"), _segments("thigh")
    rows.length(
        "trunk",
        {1: (0, 0, LUMBAR_FRACTION), 2: (0, 0, THORAX_FRACTION - LUMBAR_FRACTION)}
        | dict.fromkeys((3, *shoulders), (0, 0, 1 - THORAX_FRACTION)),
        {i: _stretch(2, 1 / trunk) for i in (0, 1, 2)},
    )
    rows.length("shoulder_drop", dict.fromkeys(shoulders, (0, 0, -1.0)), {})
    for name, pair in (("shoulder_width", shoulders), ("hip_width", hips)):
        rows.length(name, dict(zip(pair, ((0, 0.5, 0), (0, -0.5, 0)), strict=True)), {})
    for near, far in (("upper_arm", "forearm"), ("forearm", "hand"), ("thigh", "shank"), ("shank", "foot")):
        length = float(-body.offsets_m[_segments(far)[0], 2])
        stretched = {i: _stretch(2, 1 / length) for i in _segments(near)}
        rows.length(near, dict.fromkeys(_segments(far), (0, 0, -1.0)), stretched)


def _skin(body: Body, rows: _Rows) -> None:
    def extent(segment: int) -> tuple[Array, Array]:
        points = body.surface.points_m[body.surface.segment == segment]
        return points.min(axis=0), points.max(axis=0)

    outwards = {i: -1.0 if name.startswith("right_") else 1.0 for i, name in enumerate(SEGMENTS)}
    swells = _swelling(body)
    for segment in range(4):  # the trunk and the head: deeper, wider, further ahead, further up
        depth, width, _ = 0.5 * np.subtract(*extent(segment)[::-1])
        swell = swells[SEGMENTS[segment]]
        rows.stations({segment: _stretch(0, 1 / depth)}, depth * swell)
        rows.stations({segment: _stretch(1, 1 / width)}, width * swell)
        rows.stations({segment: _shift(0)})
        rows.whole({segment: _shift(2)})
    for name in ("upper_arm", "forearm", "hand", "thigh", "shank"):  # thicker, further ahead, further outwards
        pair = _segments(name)
        depth, width, _ = 0.5 * np.subtract(*extent(pair[0])[::-1])
        swell = swells[SEGMENTS[pair[0]]]
        if name == "hand":
            rows.stations({i: _stretch(0, 1 / depth) for i in pair}, depth * swell)
            rows.stations({i: _stretch(1, 1 / width) for i in pair}, width * swell)
        else:
            both = {i: _stretch(0, 2 / (depth + width)) + _stretch(1, 2 / (depth + width)) for i in pair}
            rows.stations(both, 0.5 * (depth + width) * swell)
        rows.stations({i: _shift(0) for i in pair}, hinges=_MIDDLES[name])
        rows.stations({i: _shift(1, outwards[i]) for i in pair}, hinges=_MIDDLES[name])
    # further up: of all near ends the shoulder's alone is seen, and its joint would make up for what the skin is off by
    rows.stations({i: _shift(2) for i in _segments("upper_arm")})
    feet = _segments("foot")  # higher, further up, wider, further outwards, further ahead
    low, high = extent(feet[0])
    # a higher ankle has the sole further down and the instep where it was
    higher = np.tile(_told({"ankle_height": 0.5}), (SHAPE.stations, 1))
    rows.stations({i: _stretch(2, 2 / (high[2] - low[2]), (low[2] + high[2]) / 2) for i in feet}, higher)
    rows.stations({i: _shift(2) for i in feet}, -higher)
    rows.stations({i: _stretch(1, 2 / (high[1] - low[1])) for i in feet})
    rows.whole({i: _shift(1, outwards[i]) for i in feet})
    rows.whole({i: _shift(0) for i in feet})
    for name, axis in (("head", 2), ("hand", 2), ("foot", 0)):  # what ends a limb
        low, high = extent(_segments(name)[0])
        longer = {i: _stretch(axis, 1 / (high[axis] - low[axis])) for i in _segments(name)}
        rows.whole(longer, _told({name: 1.0}))


_SMALL_M: Final = 1e-4


def _swelling(body: Body) -> dict[str, Array]:
    """Of each segment by name: share (SHAPE.stations, 26) that it is thicker by at its stations, for each metre that a
    girth is off by."""
    measured, skirt_m = body.measured, body.worn.get("skirt", 0.0)
    before = girths_along(measured.named(), SHAPE.stations, skirt_m)
    shares = {name: np.zeros((SHAPE.stations, len(MEASUREMENTS))) for name in before}
    for k, measurement in enumerate(MEASUREMENTS):
        if not measurement.startswith("girth_"):
            continue
        wider = measured.named() | {measurement: float(measured.values_m[k]) + _SMALL_M}
        after = girths_along(wider, SHAPE.stations, skirt_m)
        for name, girths in before.items():
            shares[name][:, k] = (after[name] / girths - 1.0) / _SMALL_M
    return shares


def _spans(body: Body) -> Array:
    spans = np.zeros((len(SEGMENTS), 4))
    for segment, name in enumerate(SEGMENTS):
        axis = 0 if name.endswith("foot") else 2
        along = body.surface.points_m[body.surface.segment == segment, axis]
        spans[segment, axis], spans[segment, 3] = 1 / np.ptp(along), -along.min() / np.ptp(along)
    return spans


def corrected(body: Body, change: Basis, amounts_m: Array) -> Body:
    """``body`` after corrections (P,)."""
    surface = body.surface
    points = surface.points_m.copy()
    for segment in range(len(SEGMENTS)):
        mine = surface.segment == segment
        points[mine] = change.displaced(segment, points[mine], amounts_m)
    offsets = body.offsets_m + np.einsum("p,psi->si", amounts_m, change.joints)
    return replace(body, offsets_m=offsets, surface=surface.moved(points))
