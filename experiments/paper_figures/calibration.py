"""Figures 8 and 9: the calibration object after pan and zoom, and the matches that led to the camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.paper_figures.canvas import PANNED, REFERENCE, WIDTH, Drawn, beneath, cased, letter, lines, show
from experiments.paper_figures.material import Located, Run, shoot_config
from experiments.report.pictures import border_on_panorama, window
from experiments.report.style import literal
from pzcap.calibration.settings import PanZoomConfig
from pzcap.geometry import camera as geometry
from pzcap.localisation.localise import Localiser
from pzcap.types import Array, CalibrationObject, Camera, Image, Localisation, PzcapError
from pzcap.viewer.drawing import project_edges
from sim.restage import Hall

PAN_DEG: Final = -5.0  # to the right, as the paper has it
ZOOM: Final = 1.8
MATCHES: Final = 120  # drawn


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """An image after pan and zoom, located on its panorama."""

    one: Located
    image: Image
    found: Localisation
    camera: Camera  # as found
    true: Camera | None
    what: str  # is seen


def shoot_again(run: Run) -> Shot:
    """The object once more, panned and zoomed. It stands in no footage then: the simulator puts it back.

    Without a simulator a frame of the motion serves, in which the object's place is empty.
    """
    one = run.located()[0]
    if run.truth is not None:
        pan, focal = np.radians(PAN_DEG), ZOOM * float(run.truth.reference_focal_px[one.number])
        number = run.truth.camera_names.index(one.name)
        with Hall(shoot_config(run.truth)) as hall:
            image, true = hall.photograph_object(number, pan, focal), hall.camera(number, pan, focal)
        return _locate(run, one, image, true, "the object is back in its place")
    for frame in np.flatnonzero(one.track.valid):
        views = run.views(int(frame))
        image_or_none = views[one.number]
        if image_or_none is not None:
            return _locate(run, one, image_or_none, None, f"frame {frame}, where the object has stood")
    raise PzcapError(f"{run.reconstruction.capture_name}: camera {one.name} recorded nothing")


def _locate(run: Run, one: Located, image: Image, true: Camera | None, what: str) -> Shot:
    """Find ``image`` by its features, nothing being known of where it looks."""
    localiser = Localiser(one.panorama, one.camera, PanZoomConfig(method=run.reconstruction.method))
    found = localiser.localise(image, None)
    if not found.valid:
        raise PzcapError(f"{run.reconstruction.capture_name}: camera {one.name} was not found after pan and zoom")
    camera = geometry.of_frame(one.camera, found)
    return Shot(one, image, found, camera, true, what)


def wireframe(run: Run, shot: Shot) -> Drawn:
    """Figure 8."""
    one, target, still = shot.one, run.target, run.references[shot.one.number]
    reference = run.reconstruction.references[one.number]
    if target is None or still is None or reference is None:
        raise PzcapError(f"{run.reconstruction.capture_name}: no calibration object was filmed; Fig. 8 needs one")
    figure = Figure(figsize=(WIDTH, 3.95))
    left, right = figure.subplots(1, 2)
    _wired(left, still, reference.camera, run.true_camera(one.name, None), target)
    left.set_title(f"Camera {literal(one.name)} at its reference pose")
    letter(left, f"focal length {reference.camera.focal_px:.1f} px")
    _wired(right, shot.image, shot.camera, shot.true, target)
    right.set_title("After pan and zoom")
    zoom = shot.found.focal_px / one.camera.lens.reference_focal_px
    letter(right, f"pan {np.degrees(shot.found.pan_rad):+.3f}°, zoom {zoom:.3f}; {shot.what}")
    corners = target.wireframe_m.reshape(-1, 3)
    caption = (
        "Wireframe of the calibration object over the image: (left) with the camera calibrated at the reference pose "
        "from the object itself, (right) with the camera found from the background alone after panning and zooming."
    )
    off = [
        _off(a, b, corners) for a, b in ((reference.camera, run.true_camera(one.name, None)), (shot.camera, shot.true))
    ]
    if off[0] is not None and off[1] is not None:
        caption += f" Pale line beneath: with the true camera; corners are off by {off[0]:.3f} and {off[1]:.3f} px RMS."
    return Drawn(8, "wireframe", "Calibration at the reference pose, and after pan and zoom", caption, figure)


def _wired(plot: Axes, image: Image, camera: Camera, true: Camera | None, target: CalibrationObject) -> None:
    show(plot, image)
    if true is not None:
        beneath(plot, project_edges(true, target.wireframe_m), 4.4)
    cased(plot, project_edges(camera, target.wireframe_m), REFERENCE, 1.5)


def _off(camera: Camera, true: Camera | None, points_m: Array) -> float | None:
    """RMS distance of points between the two cameras, px."""
    if true is None:
        return None
    apart = geometry.project(camera, points_m)[0] - geometry.project(true, points_m)[0]
    return float(np.sqrt(np.mean(np.sum(apart**2, axis=1))))


def matches(shot: Shot) -> Drawn:
    """Figure 9."""
    one, panorama, found = shot.one, shot.one.panorama, shot.found
    pan = found.pan_rad
    border = border_on_panorama(panorama, one.camera, shot.camera, pan)
    height, width = shot.image.shape[:2]
    half = 1.9 * np.ptp(border[:, 0]) / panorama.px_per_rad
    crop, corner = window(panorama, pan - half, pan + half, (0, panorama.image.shape[0]))

    figure = Figure(figsize=(WIDTH, 2.75))
    plot = figure.subplots()
    # both pictures in the panorama's pixels, the frame as tall as the panorama
    scale, gap = crop.shape[0] / height, 0.03 * crop.shape[1]
    show(plot, crop)
    left = -gap - scale * width
    plot.imshow(shot.image[..., ::-1], extent=(left, -gap, crop.shape[0] - 0.5, -0.5), aspect="equal")
    plot.set(xlim=(left, crop.shape[1] - 0.5), ylim=(crop.shape[0] - 0.5, -0.5))
    some = np.unique(
        np.linspace(0, len(found.frame_points_px) - 1, min(MATCHES, len(found.frame_points_px))).astype(int)
    )
    here = (found.frame_points_px[some] + 0.5) * scale + np.array([left, -0.5])
    there = found.panorama_points_px[some] - corner
    if panorama.full_turn:  # bring columns next to the window
        turn = panorama.image.shape[1]
        there[:, 0] += turn * np.round((crop.shape[1] / 2 - there[:, 0]) / turn)
    if shot.true is not None:
        beneath(plot, [border_on_panorama(panorama, one.camera, shot.true, pan) - corner], 4.4)
    cased(plot, [border - corner], PANNED, 1.5)
    colours = [_shade(float(place)) for place in np.argsort(np.argsort(here[:, 1])) / max(len(some) - 1, 1)]
    lines(plot, list(np.stack([here, there], axis=1)), colours, 0.55, alpha=0.8)
    for points in (here, there):
        plot.scatter(points[:, 0], points[:, 1], s=9, facecolors="none", edgecolors=colours, linewidths=0.8)
    plot.set_title(f"Camera {literal(one.name)}: panned and zoomed frame (left), panorama (right)")
    caption = (
        f"AKAZE matches between the image after pan and zoom and the panorama of camera {one.name}: "
        f"{len(found.frame_points_px)} agree on one pan and zoom, {len(some)} of them are drawn, no start being given. "
        "Orange: where the frame lies on the panorama."
    )
    if shot.true is not None:
        error = np.degrees(found.pan_rad) - PAN_DEG
        zoom = 100 * (found.focal_px / shot.true.focal_px - 1)
        caption += f" Pale line beneath: by the truth. Pan is off by {error:+.4f}°, the focal length by {zoom:+.3f} %; "
        caption += "with the exact method, after the photometric alignment that follows the matches."
    return Drawn(9, "matches", "Matches between a frame and the panorama", caption, figure)


def _shade(place: float) -> tuple[float, float, float]:
    """From light blue (0) by white to orange (1): told apart on any picture, and by anybody."""
    stops = np.array([[0.34, 0.76, 1.0], [0.98, 0.98, 0.9], [1.0, 0.67, 0.1]])
    red, green, blue = (float(np.interp(2 * place, [0, 1, 2], stops[:, k])) for k in range(3))
    return red, green, blue
