"""The calibration of one camera: reference image, sweep and zoom run in, panorama and pan-zoom camera out.

The matches of all three go into one bundle adjustment (`pzcap.calibration.bundle_adjustment`), which is then refined on
grey values (`pzcap.calibration.photometric_bundle_adjustment`): the sweep's closed circle fixes the focal length, the
zoom run the principal point and how distortion changes with the zoom, the reference image pan 0.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from pzcap.calibration import reference_camera, stitching
from pzcap.calibration.agreement import require_whole, sweep_inliers
from pzcap.calibration.correspondences import Matched, height_of, match
from pzcap.calibration.fitting import fit_camera, with_lean
from pzcap.calibration.focal_from_sweep import camera_of_sweep, levelled
from pzcap.calibration.in_metres import in_metres
from pzcap.calibration.minima import likeliest, starts
from pzcap.calibration.parameters import place_of_travel
from pzcap.calibration.propagation import propagated
from pzcap.calibration.settings import PanZoomConfig
from pzcap.calibration.sweep import Frames
from pzcap.calibration.tuning import BELIEF, PROPAGATION
from pzcap.geometry import camera as geometry
from pzcap.geometry.camera import View
from pzcap.progress import Report, no_report
from pzcap.types import Array, CalibrationObject, Camera, Image, Panorama, PanZoomCamera, PzcapError, ReferenceCamera


class Footage(NamedTuple):
    """Footage of one camera in the empty hall."""

    reference_image: Image  # (H, W, 3) of the calibration object, at the reference pose; without one, any of the sweep
    calibration_object: CalibrationObject | None
    sweep: Frames  # iterated more than once, as the zoom run is
    zoom: Frames | None
    full_turn: bool  # the sweep's circle closes
    sweep_period_s: float = 0.0  # from one frame of the sweep to the next; 0: not known
    by_fields: bool = False  # every other row of a picture is made of those beside it


@dataclass(frozen=True, slots=True, eq=False)
class CalibratedCamera:
    """Result of the calibration of one camera, before the motion."""

    reference: ReferenceCamera
    panorama: Panorama
    camera: PanZoomCamera


def calibrate(
    footage: Footage, config: PanZoomConfig, report: Report = no_report
) -> tuple[CalibratedCamera, stitching.SweptFrames, stitching.ZoomedFrames, Array]:
    """Calibrate one camera at its reference pose, and stitch its panorama; the frames that it is made of, and the bands
    of mains light (F, K) in those of the sweep, the reference image and those of the zoom run.

    Without a calibration object it stands levelled in a world of its own (`focal_from_sweep`), to be placed later.
    Raises PzcapError when the calibration object is not found or the sweep does not hold together.
    """
    first, matched = _matched(footage, config, report)
    chained, count = matched.chained, len(matched.chained.pan_rad)
    fits = [fit_camera(matched, start, config, report) for start in starts(matched, config)]
    (adjusted, brightness, fitted), undecided = likeliest(fits, matched)
    model = fitted.parameters
    require_whole(adjusted, matched.sweep_links, chained.kept)

    taken = model.view(count)
    refined = _with_lens_of(taken, first, footage, config)
    size = refined.camera.width, refined.camera.height
    scale = len(model.pan_rad)  # index of the sweep's focal length among the parameters
    camera, surroundings = in_metres(model, taken.pan_rad, refined.camera)
    fitted = fitted.less_sure(scale, BELIEF.parallax_scale_sigma_m * float(np.linalg.norm(camera.offset_m)))
    if footage.by_fields:
        fitted = fitted.less_sure(place_of_travel(model), BELIEF.travel_by_fields_m / height_of(refined.camera))
    stretch = BELIEF.partial_scale_by_fields if footage.by_fields else BELIEF.partial_scale_sigma
    doubt = np.hypot(0.0 if chained.full_turn else stretch, undecided)
    if footage.calibration_object is not None:
        doubt = np.hypot(doubt, contradiction(first.camera.focal_px, taken.focal_px, size[0]))
    sweep_pan_rad = model.pan_rad[:count] - taken.pan_rad  # the reference image's pan is 0
    camera = replace(
        camera, focal_sigma=float(np.sqrt(fitted.covariance[scale, scale] + doubt**2)),
        shared_zooms=np.array(PROPAGATION.zooms), shared_covariance=propagated(fitted, count, size, doubt),
    )  # fmt: skip
    view = geometry.view_at(camera, 0.0, camera.tilt_rad, camera.lens.reference_focal_px)
    swept = stitching.SweptFrames(chained.images, chained.kept, brightness, view)
    pasted = stitching.stitch(
        footage.sweep, swept, sweep_pan_rad, chained.full_turn, surroundings,
        lambda done: report("paste sweep", done, 2 * count),
    )  # fmt: skip
    inliers = sweep_inliers(adjusted, matched.links, count)
    panorama = replace(pasted, sweep_inliers=inliers, closure_rad=chained.closure_rad, residual_px=adjusted.residual_px)
    zoom_pan_rad = float(model.pan_rad[-1] - taken.pan_rad)
    zoomed = stitching.ZoomedFrames(np.array(matched.zoom_numbers, np.int64), model.log_focal[2:], zoom_pan_rad)
    return CalibratedCamera(refined, panorama, camera), swept, zoomed, fitted.bands


def _matched(footage: Footage, config: PanZoomConfig, report: Report) -> tuple[ReferenceCamera, Matched]:
    """The camera of the reference image by itself, and all frames matched. Raises PzcapError as `calibrate` does."""
    image, calibration_object, sweep, zoom, full_turn = footage[:5]
    if calibration_object is None:
        first = _unplaced(camera_of_sweep(sweep, config))
    else:
        first = reference_camera.calibrate(image, calibration_object, config.reference)
    matched = match(first.camera, image, sweep, zoom, full_turn, config, report)
    if calibration_object is None:
        if not matched.chained.full_turn:
            raise PzcapError(
                "sweep: it has a gap where nothing is seen twice, and without a calibration object nothing but a "
                "closed circle tells the focal length; film a calibration object"
            )
        return first, matched

    def up(view: View) -> Array:
        return np.asarray(_with_lens_of(view, first, footage, config).camera.world_T_cam[2, :3])

    matched = replace(matched, object_px=first.camera.focal_px, up=up)
    return first, replace(matched, start=with_lean(matched.start, matched))


def _with_lens_of(view: View, first: ReferenceCamera, footage: Footage, config: PanZoomConfig) -> ReferenceCamera:
    """The camera of the reference image with the lens of a ``view``; without a calibration object it stands levelled in
    a world of its own."""
    lens = {"focal_px": view.focal_px, "principal_px": view.principal_px, **view.distortion._asdict()}
    known = replace(first.camera, **lens)
    if footage.calibration_object is None:
        return replace(first, camera=replace(known, world_T_cam=levelled(view.tilt_rad, view.roll_rad)))
    return reference_camera.resolve(first, known, footage.reference_image, footage.calibration_object, config.reference)


def contradiction(object_px: float, sweep_px: float, width: int) -> float:
    """By how much the focal length of the reference image, of so many columns, that a sweep has led to contradicts the
    one that the calibration object shows by itself, relative; 0 where it does not: a minimum that is not the right
    one."""
    departure = abs(float(np.log(sweep_px / object_px)))
    return departure if departure * width > BELIEF.implausible_px else 0.0


def _unplaced(camera: Camera) -> ReferenceCamera:
    """A reference camera that no calibration object has been seen by."""
    return ReferenceCamera(camera, np.zeros((0, 3)), np.zeros((0, 2)), np.zeros((0, 2)))
