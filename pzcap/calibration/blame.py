"""Footage of another camera or of another focus: reference image, sweep and zoom run, compared in pairs; which of them
does not belong to the others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pzcap.calibration import reference_camera
from pzcap.calibration.calibrate import CalibratedCamera, Footage
from pzcap.calibration.features import Features
from pzcap.calibration.settings import PanZoomConfig
from pzcap.calibration.sweep import Frames, detect, place
from pzcap.calibration.tuning import BLAME
from pzcap.geometry.camera import View
from pzcap.geometry.lens import NONE
from pzcap.tuning import PLAUSIBILITY
from pzcap.types import Array


def sweep_is_foreign(footage: Footage, config: PanZoomConfig) -> bool:
    """True where reference image and zoom run show the same, and the sweep nothing of it: it is another camera's.

    Raises PzcapError where the reference image does not show the calibration object.
    """
    if footage.zoom is None or footage.calibration_object is None:
        return False
    camera = reference_camera.calibrate(footage.reference_image, footage.calibration_object, config.reference).camera
    view = View(0.0, 0.0, 0.0, camera.focal_px, camera.principal_px, NONE)
    reference = [detect(footage.reference_image, config.sweep)]
    low, high = np.log(config.zoom_range)
    zoomed = _some(footage.zoom, BLAME.zoom_frames, config)
    beside = _agreed(zoomed, reference, view, np.arange(low, high, 0.04), config)
    if beside < BLAME.many:
        return False
    swept = _some(footage.sweep, BLAME.sweep_frames, config)
    return _agreed(reference, swept, view, np.arange(-0.1, 0.101, 0.02), config) < min(BLAME.many, BLAME.fewer * beside)


def lens_moved(name: str, calibrated: CalibratedCamera) -> str | None:
    """A note where the sweep of camera ``name`` was taken through another lens than the reference image."""
    still_px, sweep_px = calibrated.reference.camera.focal_px, calibrated.camera.lens.reference_focal_px
    if abs(sweep_px / still_px - 1.0) < PLAUSIBILITY.focal:
        return None
    return (
        f"camera {name}: the focal length of its sweep, {sweep_px:.2f} px, is not that of its reference image, "
        f"{still_px:.2f} px: focus or zoom have moved; set both by hand and shoot the sweep again"
    )


def focal_in_doubt(name: str, calibrated: CalibratedCamera) -> str | None:
    """A note where the focal length of camera ``name`` is hardly known: object and sweep contradict each other."""
    camera = calibrated.camera
    if camera.focal_sigma < PLAUSIBILITY.focal_sigma:
        return None
    return (
        f"camera {name}: its focal length, {camera.lens.reference_focal_px:.0f} px by the sweep, is in doubt by "
        f"{camera.focal_sigma:.1%}: the calibration object shows another, or another fits the sweep as well; shoot the "
        "sweep again, slowly, all the way round, by lamps that do not flicker"
    )


def _agreed(
    some: Sequence[Features], others: Sequence[Features], view: View, log_zooms: Array, config: PanZoomConfig
) -> int:
    """Matches of the two frames that agree best."""
    focals = view.focal_px * np.exp(log_zooms)
    return max(place(one, other, view, view, focals, config.sweep.ratio)[2] for one in some for other in others)


def _some(frames: Frames, most: int, config: PanZoomConfig) -> list[Features]:
    """Features of some frames, evenly spaced."""
    count = sum(1 for _ in frames)
    chosen = set(np.round(np.linspace(0, count - 1, min(count, most))).astype(int).tolist())
    return [detect(image, config.sweep) for number, (_, image) in enumerate(frames) if number in chosen]
