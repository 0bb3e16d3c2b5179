"""Readings of coordinates and rotations that would explain a result: other axes, another unit, another world, another
order of a quaternion."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import permutations, product
from typing import Final

import numpy as np

from pzcap.scoring.body_errors import Similarity, similarity_of
from pzcap.types import Array

FAR_BETTER: Final = 0.2  # a mistake is named where undoing it leaves this share of the error, or less
UNITS: Final[Mapping[float, str]] = {
    1000.0: "1000 times too far from the origin: millimetres",
    100.0: "100 times too far from the origin: centimetres",
    10.0: "10 times too far from the origin: millimetres taken for centimetres",
    0.1: "10 times too near the origin: centimetres taken for millimetres",
    0.01: "100 times too near the origin: metres taken for centimetres",
    0.001: "1000 times too near the origin: metres taken for millimetres",
}
"""Factor by which coordinates are too large, and what that looks like."""
_NAMED: Final = {
    "y is up, z to the viewer": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "y is up, z forward": np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
    "z is down": np.diag([1.0, -1.0, -1.0]),
    "turned by 90 degrees about z": np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    "turned by -90 degrees about z": np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    "turned by 180 degrees about z": np.diag([-1.0, -1.0, 1.0]),
}
_ORDERS: Final = ((1, 2, 3, 0), (3, 0, 1, 2))


def better(undone: float, as_written: float) -> bool:
    """True where a mistake, undone, explains nearly all of the error."""
    return undone < FAR_BETTER * as_written


def scaled(ratio: float, factor: float, undone: float, as_written: float) -> bool:
    """True where coordinates, ``ratio`` times as far from the origin as the true ones, are too large by ``factor``."""
    return abs(ratio / factor - 1.0) < 0.1 or (0.5 < ratio / factor < 2.0 and better(undone, as_written))


def _other_axes() -> dict[str, Array]:
    found = dict(_NAMED)
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        axes = np.eye(3)[list(order)] * np.array(signs)[:, None]
        if any(np.array_equal(axes, known) for known in (np.eye(3), *found.values())):
            continue
        ours = ", ".join(f"{'-' if sign < 0.0 else ''}{'xyz'[at]}" for at, sign in zip(order, signs, strict=True))
        mirrored = "mirrored: " if np.linalg.det(axes) < 0.0 else ""
        found[f"{mirrored}x, y, z of the world are {ours} there"] = axes
    return found


AXES: Final[Mapping[str, Array]] = _other_axes()
"""Coordinates of other conventions to those of the world, z up: all turns by right angles, mirrored ones too."""


def axes(text: str) -> Array:
    """(3, 3) coordinates of a file to ours, by our axis along each of its, such as "y,z,x" or "x,z,-y"."""
    turn = np.zeros((3, 3))
    for column, part in enumerate(part.strip() for part in text.split(",")):
        turn["xyz".index(part.lstrip("+-")), column] = -1.0 if part.startswith("-") else 1.0
    return turn


def in_words(turn: Array) -> str:
    """The text that `axes` makes ``turn`` of."""
    rows = np.argmax(np.abs(turn), axis=0)
    return ",".join(f"{'-' if turn[row, at] < 0.0 else ''}{'xyz'[row]}" for at, row in enumerate(rows))


def another_world(found: Array, true: Array) -> tuple[Similarity, str] | None:
    """The similarity that brings points (N, 3) as ``found`` to the ``true`` ones, and in words what it undoes."""
    similarity = similarity_of(found, true)
    if similarity is None:
        return None
    angle = np.degrees(np.arccos(np.clip((np.trace(similarity.rotation) - 1.0) / 2.0, -1.0, 1.0)))
    away = float(np.linalg.norm(found.mean(axis=0) - true.mean(axis=0)))
    size = 1.0 / similarity.scale if similarity.scale > 0.0 else np.inf
    return similarity, f"turned by {angle:.1f} degrees, {size:.3g} times as large, its middle {away:.2f} m away"


def reordered(rotation: Array) -> Iterator[Array]:
    """Rotations (F, 3, 3) that these would be, had their quaternion, or that of the inverse, been read with w at the
    other end."""
    for inverse in (False, True):
        quaternion = _quaternion(rotation.transpose(0, 2, 1) if inverse else rotation)
        for order in _ORDERS:
            turned = _matrix(quaternion[:, order])
            yield turned.transpose(0, 2, 1) if inverse else turned


def _quaternion(rotation: Array) -> Array:
    """(F, 4) w, x, y, z of rotations (F, 3, 3)."""
    r = rotation
    symmetric = np.zeros((len(r), 4, 4))
    symmetric[:, 0, 0] = np.trace(r, axis1=1, axis2=2)
    symmetric[:, 1:, 1:] = r + r.transpose(0, 2, 1) - symmetric[:, 0, 0, None, None] * np.eye(3)
    symmetric[:, 0, 1:] = np.stack([r[:, 2, 1] - r[:, 1, 2], r[:, 0, 2] - r[:, 2, 0], r[:, 1, 0] - r[:, 0, 1]], axis=1)
    symmetric[:, 1:, 0] = symmetric[:, 0, 1:]
    return np.asarray(np.linalg.eigh(symmetric)[1][:, :, -1])


def _matrix(wxyz: Array) -> Array:
    """(F, 3, 3) of unit quaternions (F, 4)."""
    w, x, y, z = wxyz.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.asarray(np.moveaxis(np.array(rows), 2, 0))
