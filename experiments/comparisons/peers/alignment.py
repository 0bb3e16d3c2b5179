"""`cv2.findTransformECC` (Evangelidis and Psarakis, 2008): the whole image, from a good start."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from experiments.comparisons.peers import matching
from experiments.comparisons.peers.material import Background, Estimate, Shot
from pzcap.geometry import camera as geometry
from pzcap.imaging.colour import grey
from pzcap.localisation.panorama_sampler import ViewPlace, warp_background
from pzcap.types import Image, Mask

STOP: Final = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 60, 1e-7)
BLUR_PX: Final = 5  # OpenCV's own default
GRID_PX: Final = 20  # between the points at which pan and focal length are fitted to the homography
DIFFERENT: Final = 25.0  # grey levels: a person in front of the background
GROWN_PX: Final = 15  # the mask is made larger by this


class Ecc:
    """Aligns the frame with the panorama, rendered as our calibrated camera would see it at the start.

    What is left between the two is a homography near the identity; pan and focal length are fitted to it. ``mask`` says
    how the athlete is kept out: "none"; "difference", where frame and rendered background differ; "known", the mask
    that came with the frame.
    """

    def __init__(self, background: Background, mask: str) -> None:
        self._background = background
        self._mask = mask

    def locate(self, shot: Shot, start: Estimate | None) -> Estimate | None:
        if start is None:
            return None
        camera = self._background.camera
        place = ViewPlace(start.pan_rad, camera.tilt_rad, start.focal_px)
        rendered, known = warp_background(self._background.panorama, camera, place)
        frame, template = grey(shot.image), grey(rendered)
        inside = np.asarray(cv2.erode(known.astype(np.uint8), np.ones((5, 5), np.uint8)), np.uint8)
        away = np.asarray(~self._person(shot, frame, template, known), np.uint8)
        try:
            _, warp = cv2.findTransformECCWithMask(
                template, frame, inside, away, np.eye(3, dtype=np.float32), cv2.MOTION_HOMOGRAPHY, STOP, BLUR_PX
            )
        except cv2.error:  # did not converge
            return None
        u, v = np.meshgrid(np.arange(0, camera.lens.width, GRID_PX), np.arange(0, camera.lens.height, GRID_PX))
        shown = known[v, u]
        if shown.sum() < matching.LEAST:
            return None
        places = np.column_stack([u[shown], v[shown]]).astype(np.float64)
        moved = np.asarray(cv2.perspectiveTransform(places[:, None], np.asarray(warp, np.float64))[:, 0], np.float64)
        view = geometry.view_at(camera, start.pan_rad, camera.tilt_rad, start.focal_px)
        azimuth, slope = geometry.pixel_to_direction(view, places)
        return matching.fit_directions(self._background, moved, azimuth, slope, start)

    def _person(self, shot: Shot, frame: Image, template: Image, known: Mask) -> Mask:
        """(H, W) what is not background."""
        if self._mask == "none":
            return np.zeros(frame.shape, bool)
        if self._mask == "known":
            person = np.zeros(frame.shape, bool) if shot.person is None else shot.person
        else:
            gain = float(np.median(frame[known])) / max(float(np.median(template[known])), 1.0)
            soft = cv2.GaussianBlur(frame.astype(np.float32) - gain * template.astype(np.float32), (0, 0), 2.0)
            person = np.asarray(known & (np.abs(soft) > DIFFERENT), np.bool_)
        grown = cv2.dilate(person.astype(np.uint8), np.ones((GROWN_PX, GROWN_PX), np.uint8))
        return np.asarray(grown > 0, np.bool_)
