"""The zoom run: the head locked, the focal length going through its range.

Unlike a sweep it shows the principal point, towards which everything moves, and how the lens changes with the zoom. Its
frames are matched here with each other and with the sweep; `pzcap.calibration.bundle_adjustment` uses the matches.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pzcap.calibration.bundle_adjustment import Link
from pzcap.calibration.features import Features
from pzcap.calibration.settings import PanZoomConfig
from pzcap.calibration.sweep import link_views, place, spaced
from pzcap.calibration.tuning import ZOOM
from pzcap.geometry.camera import View, wrapped
from pzcap.types import Array, PzcapError


@dataclass(frozen=True, slots=True, eq=False)
class ZoomRun:
    """First values and matches of the zoom run's frames."""

    pan_rad: float
    log_focal: Array  # (K,)
    links: tuple[Link, ...]  # the zoom frames' indices follow those of the frames given


def link_zoom(
    found: Sequence[Features], sweep_pan_rad: Array, offset: int, view: View, width: int, config: PanZoomConfig
) -> ZoomRun:
    """Match the zoom frames ``found[offset:]`` with the sweep's frames ``found[:len(sweep_pan_rad)]``.

    ``view`` is that of the sweep at pan 0. Raises PzcapError if the zoom run shows nothing of the sweep.
    """
    zoomed = found[offset:]
    field = 2 * np.arctan(width / 2 / view.focal_px)
    low, high = config.zoom_range
    every = view.focal_px * np.exp(np.arange(np.log(low), np.log(high), 0.02))

    def at(focal_px: float) -> View:
        return replace(view, focal_px=focal_px)

    best, anchor, pan, focal = 0, 0, 0.0, view.focal_px
    nearby = spaced(sweep_pan_rad, 0.4 * field)
    for k in dict.fromkeys((len(zoomed) // 4, len(zoomed) // 2, 0, 3 * len(zoomed) // 4, len(zoomed) - 1)):
        if best >= ZOOM.sure_matches:
            break
        for index in nearby:
            taken = replace(view, pan_rad=float(sweep_pan_rad[index]))
            candidate = place(zoomed[k], found[index], taken, at, every, config.sweep.ratio)
            if candidate[2] > best:
                (pan, focal, best), anchor = candidate, k
    if best < 2 * config.sweep.min_matches:
        raise PzcapError(
            "zoom run: it shows nothing of what the sweep showed; record it with the head locked in between"
        )

    focals = np.zeros(len(zoomed))
    focals[anchor] = focal
    for direction, order in ((1, range(anchor + 1, len(zoomed))), (-1, range(anchor - 1, -1, -1))):
        for k in order:
            before = replace(at(focals[k - direction]), pan_rad=pan)
            near = before.focal_px * np.exp(np.arange(-0.4, 0.401, 0.01))
            _, focals[k], agreed = place(zoomed[k], zoomed[k - direction], before, at, near, config.sweep.ratio)
            if agreed < config.sweep.min_matches:
                raise PzcapError(
                    f"zoom run: it jumps near {k / len(zoomed):.0%} of its length; zoom slowly, head locked"
                )

    views = [replace(at(f), pan_rad=pan) for f in focals]
    links: list[Link | None] = []
    for k in range(len(zoomed)):
        links += [
            link_views(found, offset + k, offset + k + step, (views[k], views[k + step]), 12.0, config.sweep)
            for step in ZOOM.steps
            if k + step < len(zoomed)
        ]
        for share in ZOOM.spread:
            index = int(np.argmin(np.abs(wrapped(sweep_pan_rad - pan - share * field))))
            taken = replace(view, pan_rad=float(sweep_pan_rad[index]))
            links.append(link_views(found, index, offset + k, (taken, views[k]), 12.0, config.sweep))
    return ZoomRun(pan, np.log(focals), tuple(link for link in links if link is not None))
