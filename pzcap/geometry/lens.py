"""The lens: distortion of normalised image coordinates. The only place where its formula, inverse and Jacobian stand.

A point at ``(x, y) = (X/Z, Y/Z)``, ``r^2 = x^2 + y^2``, is seen at ``principal_px + focal_px * (x_d, y_d)`` with

    x_d = (1 + k1 r^2 + k2 r^4) x + 2 p1 x y + p2 (r^2 + 2 x^2)
    y_d = (1 + k1 r^2 + k2 r^4) y + p1 (r^2 + 2 y^2) + 2 p2 x y

(Brown 1966, Conrady 1919; order and signs of OpenCV; from undistorted to distorted). Principal point and coefficients
are polynomials in ``log(focal_px / reference_focal_px)`` (`pzcap.types.Lens`). By default k1 alone is estimated, the
others are 0, and then cost nothing but a few additions.

The kernels come first, compiled for other kernels; then the same for arrays.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numba import njit

from pzcap.types import Array, Camera, Lens


class Distortion(NamedTuple):
    """The coefficients at one focal length."""

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0


NONE: Final = Distortion()
COEFFICIENTS: Final = Distortion._fields
_NEWTON_STEPS: Final = 8


# --------------------------------------------------------------------------------------------------------------
# For other kernels


@njit(cache=True, nogil=True, inline="always")
def distort_point(x: float, y: float, d: Distortion) -> tuple[float, float]:
    """A point as the lens bends it; without the limit of `distort` far outside the image."""
    squared = x * x + y * y
    factor = 1.0 + (d.k1 + d.k2 * squared) * squared
    return (
        factor * x + (2.0 * d.p1 * x * y + d.p2 * (squared + 2.0 * x * x)),
        factor * y + (d.p1 * (squared + 2.0 * y * y) + 2.0 * d.p2 * x * y),
    )


@njit(cache=True, nogil=True, inline="always")
def jacobian_at(x: float, y: float, d: Distortion) -> tuple[float, float, float]:
    """Derivatives of `distort_point`: of x_d by x, of x_d by y, which is that of y_d by x, and of y_d by y."""
    squared = x * x + y * y
    factor = 1.0 + (d.k1 + d.k2 * squared) * squared
    slope = 2.0 * (d.k1 + 2.0 * d.k2 * squared)
    return (
        factor + slope * x * x + (2.0 * d.p1 * y + 6.0 * d.p2 * x),
        slope * x * y + (2.0 * d.p1 * x + 2.0 * d.p2 * y),
        factor + slope * y * y + (6.0 * d.p1 * y + 2.0 * d.p2 * x),
    )


@njit(cache=True, nogil=True, inline="always")
def by_coefficients(x: float, y: float) -> tuple[float, float, float, float, float, float]:
    """Derivatives of `distort_point` by k1 (x_d, y_d), by k2 (the same times r^2), by p1 (x_d, y_d), and by p2 of x_d;
    that of y_d by p2 equals that of x_d by p1."""
    squared = x * x + y * y
    return squared * x, squared * y, squared, 2.0 * x * y, squared + 2.0 * y * y, squared + 2.0 * x * x


@njit(cache=True, nogil=True)
def undistort_point(x_d: float, y_d: float, d: Distortion, steps: int) -> tuple[float, float]:
    """The inverse of `distort_point` by so many steps of Newton's method, within the image: on the radius, which is all
    where the tangential coefficients are 0, then on the point."""
    bent = np.sqrt(x_d * x_d + y_d * y_d)
    radius = bent * (1.0 - d.k1 * bent * bent)  # so near that two steps are enough within an image
    for _ in range(steps):
        squared = radius * radius
        factor = 1.0 + (d.k1 + d.k2 * squared) * squared
        radius -= (radius * factor - bent) / (1.0 + (3.0 * d.k1 + 5.0 * d.k2 * squared) * squared)
    squared = radius * radius
    factor = 1.0 / (1.0 + (d.k1 + d.k2 * squared) * squared)
    x, y = x_d * factor, y_d * factor
    if d.p1 == 0.0 and d.p2 == 0.0:
        return x, y
    for _ in range(steps):
        found_x, found_y = distort_point(x, y, d)
        xx, xy, yy = jacobian_at(x, y, d)
        off_x, off_y, determinant = x_d - found_x, y_d - found_y, xx * yy - xy * xy
        x, y = x + (yy * off_x - xy * off_y) / determinant, y + (xx * off_y - xy * off_x) / determinant
    return x, y


# --------------------------------------------------------------------------------------------------------------
# For arrays


def of(camera: Camera) -> Distortion:
    """The distortion of a camera at one instant."""
    return Distortion(camera.k1, camera.k2, camera.p1, camera.p2)


def at(lens: Lens, focal_px: float) -> tuple[Array, Distortion]:
    """Principal point (2,) in pixels and distortion of ``lens`` zoomed to ``focal_px``."""
    x = np.log(focal_px / lens.reference_focal_px)
    coefficients = (getattr(lens, name) for name in COEFFICIENTS)
    return _powers(x, len(lens.principal_px)) @ lens.principal_px, Distortion(*(
        float(_powers(x, len(values)) @ values) for values in coefficients
    ))  # fmt: skip


def slope(lens: Lens, focal_px: float) -> tuple[Array, Distortion]:
    """Derivative of `at` with respect to log focal: (2,) pixels, and of each coefficient."""
    x = np.log(focal_px / lens.reference_focal_px)
    coefficients = (getattr(lens, name) for name in COEFFICIENTS)
    return _slopes(x, len(lens.principal_px)) @ lens.principal_px, Distortion(*(
        float(_slopes(x, len(values)) @ values) for values in coefficients
    ))  # fmt: skip


def _powers(x: float, order: int) -> Array:
    return np.asarray(x ** np.arange(order))


def _slopes(x: float, order: int) -> Array:
    return np.concatenate([[0.0], np.arange(1, order) * _powers(x, order - 1)])


def distort(xy: Array, d: Distortion) -> Array:
    """Normalised image coordinates (..., 2) as the lens bends them.

    Beyond the radius where that would fold back (barrel distortion, far outside any image) the factor stays what it is
    there, so that nothing out of view comes back into it.
    """
    squared = np.minimum(np.sum(xy * xy, axis=-1, keepdims=True), _fold(d))
    bent = (1.0 + (d.k1 + d.k2 * squared) * squared) * xy
    if d.p1 or d.p2:
        bent = bent + _tangential(xy, d)
    return bent


def undistort(xy: Array, d: Distortion) -> Array:
    """The inverse of `distort`; (..., 2) to (..., 2), by Newton's method on the radius and, where there are tangential
    coefficients, on the point."""
    distorted = np.sqrt(np.sum(xy * xy, axis=-1, keepdims=True))
    edge = _fold(d)
    if np.isfinite(edge):
        distorted = np.minimum(distorted, np.sqrt(edge) * (1.0 + (d.k1 + d.k2 * edge) * edge) * (1 - 1e-9))
    radius = distorted
    for _ in range(_NEWTON_STEPS):
        squared = radius * radius
        factor = 1.0 + (d.k1 + d.k2 * squared) * squared
        radius = radius - (radius * factor - distorted) / (1.0 + (3.0 * d.k1 + 5.0 * d.k2 * squared) * squared)
    squared = radius * radius
    found = xy / (1.0 + (d.k1 + d.k2 * squared) * squared)
    for _ in range(_NEWTON_STEPS if d.p1 or d.p2 else 0):
        found = found + np.linalg.solve(jacobian(found, d), (xy - distort(found, d))[..., None])[..., 0]
    return np.asarray(found)


def jacobian(xy: Array, d: Distortion) -> Array:
    """Derivatives (..., 2, 2) of distorted coordinates by undistorted ones, (..., 2)."""
    x, y = xy[..., 0], xy[..., 1]
    squared = x * x + y * y
    factor = 1.0 + (d.k1 + d.k2 * squared) * squared
    slope = 2.0 * (d.k1 + 2.0 * d.k2 * squared)
    result = np.empty((*x.shape, 2, 2))
    result[..., 0, 0] = factor + slope * x * x + (2.0 * d.p1 * y + 6.0 * d.p2 * x)
    result[..., 0, 1] = result[..., 1, 0] = slope * x * y + (2.0 * d.p1 * x + 2.0 * d.p2 * y)
    result[..., 1, 1] = factor + slope * y * y + (6.0 * d.p1 * y + 2.0 * d.p2 * x)
    return result


def jacobian_by_coefficients(xy: Array) -> Array:
    """Derivatives (..., 2, 4) of distorted coordinates by `COEFFICIENTS`, at undistorted ones (..., 2)."""
    x, y = xy[..., 0], xy[..., 1]
    squared = x * x + y * y
    result = np.empty((*x.shape, 2, 4))
    result[..., 0, 0], result[..., 1, 0] = squared * x, squared * y
    result[..., 0, 1], result[..., 1, 1] = squared * squared * x, squared * squared * y
    result[..., 0, 2] = result[..., 1, 3] = 2.0 * x * y
    result[..., 1, 2], result[..., 0, 3] = squared + 2.0 * y * y, squared + 2.0 * x * x
    return result


def _tangential(xy: Array, d: Distortion) -> Array:
    x, y = xy[..., 0], xy[..., 1]
    squared = x * x + y * y
    across = 2.0 * d.p1 * x * y + d.p2 * (squared + 2.0 * x * x)
    return np.stack([across, d.p1 * (squared + 2.0 * y * y) + 2.0 * d.p2 * x * y], axis=-1)


def _fold(d: Distortion) -> float:
    """The squared radius from which on a point that is further out is seen further in: the first zero of
    ``1 + 3 k1 r^2 + 5 k2 r^4``; infinite where there is none."""
    if d.k2 == 0.0:
        return -1.0 / (3.0 * d.k1) if d.k1 < 0.0 else np.inf
    discriminant = 9.0 * d.k1 * d.k1 - 20.0 * d.k2
    divisor = -3.0 * d.k1 + np.sqrt(max(discriminant, 0.0))
    return 2.0 / divisor if discriminant >= 0.0 and divisor > 1e-9 else np.inf
