"""The lens: distortion of normalised image coordinates. The only place where its formula, inverse and Jacobian stand.

A point at ``(x, y) = (X/Z, Y/Z)``, ``r^2 = x^2 + y^2``, is seen at ``principal_px + focal_px * (x_d, y_d)`` with

    x_d = (1 + k1 r^2 + k2 r^4) x + 2 p1 x y + p2 (r^2 + 2 x^2)
    y_d = (1 + k1 r^2 + k2 r^4) y + p1 (r^2 + 2 y^2) + 2 p2 x y

(Brown 1966, Conrady 1919; order and signs of OpenCV; from undistorted to distorted). Principal point and coefficients
are polynomials in ``log(focal_px / reference_focal_px)`` (`pzcap.types.Lens`).

`@register_jitable` makes a formula serve both: numbers in compiled kernels, and arrays outside.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from operator import mul
from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit
from numba.extending import register_jitable

from pzcap.types import Array, Camera, Lens


class Distortion(NamedTuple):
    """The coefficients at one focal length."""

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0


NONE: Final = Distortion()
_NEWTON_STEPS: Final = 8  # of the radius, at most
_SETTLED: Final = 1e-9  # change of the radius, whose square the next one would be
_POINT_STEPS: Final = 4  # of the point after it: from what tangential distortion leaves, to a millionth of a pixel


# --------------------------------------------------------------------------------------------------------------
# Formulas, of numbers in kernels and of arrays


@register_jitable
def _radial(squared: Any, d: Distortion) -> Any:
    """Factor at a squared radius."""
    return 1.0 + (d.k1 + d.k2 * squared) * squared


@register_jitable
def _tangential(x: Any, y: Any, d: Distortion) -> tuple[Any, Any]:
    squared = x * x + y * y
    return (2.0 * d.p1 * x * y + d.p2 * (squared + 2.0 * x * x), d.p1 * (squared + 2.0 * y * y) + 2.0 * d.p2 * x * y)


@register_jitable
def distort_point(x: Any, y: Any, d: Distortion) -> tuple[Any, Any]:
    """A point as the lens bends it; without the limit of `distort` far outside the image."""
    factor, (across, down) = _radial(x * x + y * y, d), _tangential(x, y, d)
    return factor * x + across, factor * y + down


@register_jitable
def jacobian_at(x: Any, y: Any, d: Distortion) -> tuple[Any, Any, Any]:
    """Derivatives of `distort_point`: of x_d by x, of x_d by y, which is that of y_d by x, and of y_d by y."""
    squared = x * x + y * y
    factor, slope = _radial(squared, d), 2.0 * (d.k1 + 2.0 * d.k2 * squared)
    return (
        factor + slope * x * x + (2.0 * d.p1 * y + 6.0 * d.p2 * x),
        slope * x * y + (2.0 * d.p1 * x + 2.0 * d.p2 * y),
        factor + slope * y * y + (6.0 * d.p1 * y + 2.0 * d.p2 * x),
    )


@register_jitable
def by_coefficients(x: Any, y: Any) -> tuple[Any, Any, Any, Any, Any, Any]:
    """Derivatives of `distort_point` by k1 (x_d, y_d), by k2 (the same times r^2), by p1 (x_d, y_d), and by p2 of x_d;
    that of y_d by p2 equals that of x_d by p1."""
    squared = x * x + y * y
    return squared * x, squared * y, squared, 2.0 * x * y, squared + 2.0 * y * y, squared + 2.0 * x * x


@register_jitable
def _radius_step(radius: Any, bent: Any, d: Distortion) -> Any:
    """Newton step of the radius that is seen at radius ``bent``, without tangential distortion."""
    squared = radius * radius
    rise = 1.0 + (3.0 * d.k1 + 5.0 * d.k2 * squared) * squared
    return radius - (radius * _radial(squared, d) - bent) / rise


@register_jitable
def _point_step(x: Any, y: Any, x_d: Any, y_d: Any, d: Distortion) -> tuple[Any, Any]:
    """Newton step of the point that is seen at (``x_d``, ``y_d``)."""
    (found_x, found_y), (xx, xy, yy) = distort_point(x, y, d), jacobian_at(x, y, d)
    off_x, off_y, determinant = x_d - found_x, y_d - found_y, xx * yy - xy * xy
    return x + (yy * off_x - xy * off_y) / determinant, y + (xx * off_y - xy * off_x) / determinant


@njit(cache=True, nogil=True)
def undistort_point(x_d: float, y_d: float, d: Distortion, steps: int) -> tuple[float, float]:
    """The inverse of `distort_point` by so many steps of Newton's method, within the image: on the radius, which is all
    where the tangential coefficients are 0, then on the point."""
    bent = np.sqrt(x_d * x_d + y_d * y_d)
    radius = bent * (1.0 - d.k1 * bent * bent)  # so near that two steps are enough within an image
    for _ in range(steps):
        radius = _radius_step(radius, bent, d)
    factor = 1.0 / _radial(radius * radius, d)
    x, y = x_d * factor, y_d * factor
    for _ in range(0 if d.p1 == 0.0 and d.p2 == 0.0 else steps):
        x, y = _point_step(x, y, x_d, y_d, d)
    return x, y


# --------------------------------------------------------------------------------------------------------------
# For arrays


def of(camera: Camera) -> Distortion:
    """The distortion of a camera at one instant."""
    return Distortion(camera.k1, camera.k2, camera.p1, camera.p2)


def at(lens: Lens, focal_px: float) -> tuple[Array, Distortion]:
    """Principal point (2,) in pixels and distortion of ``lens`` zoomed to ``focal_px``."""
    x = math.log(focal_px / lens.reference_focal_px)
    return _at(lens, lambda power: x**power)


def slope(lens: Lens, focal_px: float) -> tuple[Array, Distortion]:
    """Derivative of `at` with respect to log focal: (2,) pixels, and of each coefficient."""
    x = math.log(focal_px / lens.reference_focal_px)
    return _at(lens, lambda power: power * x ** max(power - 1, 0))


def _at(lens: Lens, basis: Callable[[int], float]) -> tuple[Array, Distortion]:
    """Principal point and distortion by the polynomials' terms, of which ``basis`` gives each power's. Several times a
    step of every frame, which numpy's polynomials take a seventh of."""
    polynomials = (lens.k1, lens.k2, lens.p1, lens.p2)
    terms = [basis(power) for power in range(max(map(len, (lens.principal_px, *polynomials))))]
    principal = np.array(terms[: len(lens.principal_px)]) @ lens.principal_px
    return principal, Distortion(*(sum(map(mul, terms, each.tolist())) for each in polynomials))


def distort(xy: Array, d: Distortion) -> Array:
    """Normalised image coordinates (..., 2) as the lens bends them.

    Beyond the radius where that would fold back (barrel distortion, far outside any image) the factor stays what it is
    there, so that nothing out of view comes back into it.
    """
    x, y = xy[..., 0], xy[..., 1]
    factor, (across, down) = _radial(np.minimum(x * x + y * y, _fold(d)), d), _tangential(x, y, d)
    return np.stack([factor * x + across, factor * y + down], axis=-1)


def undistort(xy: Array, d: Distortion) -> Array:
    """The inverse of `distort`; (..., 2) to (..., 2), by Newton's method on the radius and, where there are tangential
    coefficients, on the point."""
    if d == NONE:
        return xy
    edge = _fold(d)
    furthest = np.sqrt(edge) * _radial(edge, d) * (1 - 1e-9) if np.isfinite(edge) else np.inf
    straight = np.empty(xy.shape)
    _undistort_all(np.ascontiguousarray(xy, np.float64).reshape(-1, 2), d, furthest, straight.reshape(-1, 2))
    return straight


@njit(cache=True, nogil=True)
def _undistort_all(xy: Array, d: Distortion, furthest: float, straight: Array) -> None:
    """`undistort` of points (N, 2) into ``straight`` (N, 2); beyond the radius ``furthest`` by the factor there."""
    for n in range(len(xy)):
        x_d, y_d = xy[n, 0], xy[n, 1]
        bent = min(np.sqrt(x_d * x_d + y_d * y_d), furthest)
        radius, before = bent, -1.0
        for _ in range(_NEWTON_STEPS):
            if abs(radius - before) < _SETTLED:
                break
            radius, before = _radius_step(radius, bent, d), radius
        factor = _radial(radius * radius, d)
        x, y = x_d / factor, y_d / factor
        for _ in range(0 if d.p1 == 0.0 and d.p2 == 0.0 else _POINT_STEPS):
            x, y = _point_step(x, y, x_d, y_d, d)
        straight[n, 0], straight[n, 1] = x, y


def jacobian(xy: Array, d: Distortion) -> Array:
    """Derivatives (..., 2, 2) of distorted coordinates by undistorted ones, (..., 2)."""
    xx, across, yy = jacobian_at(xy[..., 0], xy[..., 1], d)
    return np.stack([xx, across, across, yy], axis=-1).reshape(*xy.shape, 2)


def jacobian_by_coefficients(xy: Array) -> Array:
    """Derivatives (..., 2, 4) of distorted coordinates by the coefficients, at undistorted ones (..., 2)."""
    k1_x, k1_y, squared, p1_x, p1_y, p2_x = by_coefficients(xy[..., 0], xy[..., 1])
    rows = [k1_x, squared * k1_x, p1_x, p2_x, k1_y, squared * k1_y, p1_y, p1_x]
    return np.stack(rows, axis=-1).reshape(*xy.shape, 4)


def _fold(d: Distortion) -> float:
    """The squared radius from which on a point that is further out is seen further in: the first zero of
    ``1 + 3 k1 r^2 + 5 k2 r^4``; infinite where there is none."""
    if d.k2 == 0.0:
        return -1.0 / (3.0 * d.k1) if d.k1 < 0.0 else np.inf
    discriminant = 9.0 * d.k1 * d.k1 - 20.0 * d.k2
    divisor = -3.0 * d.k1 + np.sqrt(max(discriminant, 0.0))
    return 2.0 / divisor if discriminant >= 0.0 and divisor > 1e-9 else np.inf
