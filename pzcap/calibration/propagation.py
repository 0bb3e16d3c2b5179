"""Covariance that the calibration's own errors give every frame of the motion.

A frame that is aligned with the panorama is one more frame of the bundle adjustment: what its pixels show, frames of
the sweep show as well. With pan and log focal m of the frame, the parameters c of the calibration and their covariance
C (`photometric_bundle_adjustment`), the residuals of those pixels J_m dm + J_c dc are least for

    dm = -(J_m^T J_m)^-1 J_m^T J_c dc = S dc,        covariance S C S^T.

It holds what is wrong with the sweep's pans there, against that of the reference image, with the scale of the sweep,
and with the lens at that zoom.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pzcap.calibration.bundle_adjustment import Link, matches_of, normal_equations
from pzcap.calibration.parameters import CalibrationParameters
from pzcap.calibration.photometric_bundle_adjustment import Fitted
from pzcap.calibration.tuning import PROPAGATION
from pzcap.geometry import camera as geometry
from pzcap.geometry import cylinder
from pzcap.geometry.camera import View
from pzcap.geometry.parallax import parallax
from pzcap.types import Array


def propagated(fitted: Fitted, count: int, size: tuple[int, int], scale_sigma: float = 0.0) -> Array:
    """Covariances (P, Z, 2, 2) of pan, against that of the reference image, and log focal of frames at P pans that are
    equally spaced round the turn from the reference image's to the left, and at the Z zooms of `PROPAGATION`.

    The first ``count`` frames of what is ``fitted`` are the sweep's, the next is the reference image; ``size`` is the
    frames' width and height. ``scale_sigma`` is what the sweep's scale is off by beside that, where no circle closes.
    """
    model, covariance = fitted.parameters, fitted.covariance
    from_reference = np.arange(PROPAGATION.pans) * 2 * np.pi / PROPAGATION.pans
    sweep_pan = model.pan_rad[model.pan_of[:count]]
    off = geometry.wrapped(sweep_pan - (model.view(count).pan_rad + from_reference)[:, None])
    shown = sweep_pan[np.abs(off).argmin(axis=1)]  # a sweep that is no full turn has not been everywhere
    pan, zoom = (one.ravel() for one in np.meshgrid(shown, np.log(PROPAGATION.zooms), indexing="ij"))
    frames, pans, focals = len(model.pan_of), len(model.pan_rad), len(model.log_focal)
    more = np.arange(len(pan))
    wider = replace(
        model, pan_rad=np.append(model.pan_rad, pan), log_focal=np.append(model.log_focal, model.log_focal[0] + zoom),
        pan_of=np.append(model.pan_of, pans + more), focal_of=np.append(model.focal_of, focals + more),
    )  # fmt: skip
    links = [link for number in more for link in _links(wider, frames + int(number), count, size)]
    matches = matches_of(links)
    normal = normal_equations(wider, matches, 1e6, np.empty(len(matches.pixels))).normal
    own = np.stack([pans + more, pans + len(more) + focals + more], axis=1)  # (N, 2) places in the wider vector
    old = np.delete(np.arange(len(normal)), own.ravel())
    out = np.empty((len(more), 2, 2))
    for number, place in enumerate(own):
        by_calibration = -np.linalg.solve(normal[np.ix_(place, place)], normal[np.ix_(place, old)])
        by_calibration[0, model.pan_of[count]] -= 1.0
        stretch = np.array([-geometry.wrapped(pan[number] - model.view(count).pan_rad), 1.0]) * scale_sigma
        out[number] = by_calibration @ covariance @ by_calibration.T + np.outer(stretch, stretch)
    return out.reshape(PROPAGATION.pans, len(PROPAGATION.zooms), 2, 2)


def _links(model: CalibrationParameters, frame: int, count: int, size: tuple[int, int]) -> list[Link]:
    """Points of a ``frame`` in the frames of the sweep, spread over its field of view, that show them."""
    view, (width, height) = model.view(frame), size
    across, down = (np.linspace(0.0, side - 1.0, nodes) for side, nodes in zip(size, PROPAGATION.grid, strict=True))
    pixels = np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)
    field = 2.0 * np.arctan(0.5 * width / view.focal_px)
    sweep_pan = model.pan_rad[model.pan_of[:count]]
    beside = view.pan_rad + field * np.array(PROPAGATION.beside)
    nearest = np.abs(geometry.wrapped(sweep_pan - beside[:, None])).argmin(axis=1)
    links = []
    for number in np.unique(nearest).tolist():
        seen = _transferred(model, view, model.view(number), pixels)
        inside = np.all((seen >= 0.0) & (seen <= np.array([width - 1.0, height - 1.0])), axis=1)
        if inside.any():
            links.append(Link(frame, number, pixels[inside], seen[inside], np.zeros(int(inside.sum()))))
    return links


def _transferred(model: CalibrationParameters, first: View, second: View, pixels: Array) -> Array:
    """Pixels (N, 2) of the ``second`` view that show what ``pixels`` (N, 2) of the ``first`` do."""
    azimuth, slope = geometry.pixel_to_direction(first, pixels)
    near = cylinder.inverse_distance(model.surroundings, azimuth, slope)
    back, on = (parallax(view, azimuth, slope, near) for view in (first, second))
    seen, front = geometry.direction_to_pixel(second, azimuth - back[0] + on[0], slope - back[1] + on[1])
    return np.asarray(np.where(front[:, None], seen, -1.0))
