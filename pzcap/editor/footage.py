"""Frames of the motion for the page: decoded on demand, rows put right."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np

from pzcap.body.skeleton import Body
from pzcap.editor.on_demand import OnDemand
from pzcap.editor.tuning import FOOTAGE
from pzcap.events import FrameLocalised
from pzcap.geometry.camera import of_track, wrapped
from pzcap.io.capture import FrameSets
from pzcap.localisation.rectification import upright_views
from pzcap.segmentation.foreground import ForegroundConfig, separate
from pzcap.tracking.observation import ViewInput, expect
from pzcap.types import Array, Camera, FrameSet, Image, Localisation, PanZoomTrack, Pose, Reconstruction
from pzcap.views import as_found

Views = tuple[bytes | None, ...]  # the pictures of a frame as JPEG; None where a camera recorded none


class Footage:
    """The views of a capture's frames, and the cameras that a reconstruction found for them."""

    def __init__(self, sets: FrameSets, found: Reconstruction) -> None:
        self.sets, self.found = sets, found
        self._cameras: dict[int, tuple[Camera | None, ...]] = {}
        self._lock = threading.Lock()
        self._kept = OnDemand[Views](self._decode, lambda views: sum(len(jpeg or b"") for jpeg in views))
        self._latest: FrameSet | None = None

    def cameras(self, frame: int) -> tuple[Camera | None, ...]:
        """The camera of each view of a frame; None where it was not found."""
        if frame in self._cameras:
            return self._cameras[frame]
        pairs = zip(self.found.cameras, self.found.tracks, strict=True)
        cameras = tuple(
            None if head is None or track is None or not track.valid[frame] else of_track(head, track, frame)
            for head, track in pairs
        )
        return self._cameras.setdefault(frame, cameras)

    def localisations(self, frame: int) -> tuple[Localisation | None, ...]:
        """Where each view of a frame was found."""
        return tuple(None if track is None else _localisation(track, frame) for track in self.found.tracks)

    def upright(self, frames: FrameSet) -> FrameSet:
        """The views of a frame with their rows put right, as the cameras have them."""
        return upright_views(frames, self.found.cameras, self.localisations(frames.index))

    def located(self, frames: FrameSet) -> FrameLocalised:
        """The views of a frame, rows put right, and where each was found; of interlaced ones the second fields as well,
        each where the camera is halfway to the next frame."""
        later = None
        if frames.second_fields and frames.index + 1 < len(self.sets):
            later = tuple(
                None if image is None or track is None else _halfway(track, frames.index)
                for image, track in zip(frames.second_fields, self.found.tracks, strict=True)
            )
        return as_found(self.found.cameras, frames, self.localisations(frames.index), later)

    def jpeg(self, frame: int, camera: int) -> bytes | None:
        """A view of a frame as JPEG; None where it was not recorded."""
        with self._lock:
            return self._kept[frame][camera]

    def images(self, frame: int) -> tuple[Image | None, ...]:
        """The views of a frame, rows put right; of one that was decoded a while ago, as its JPEG has them."""
        with self._lock:
            views = self._kept[frame]
            if self._latest is not None and self._latest.index == frame:
                return self._latest.images
            return tuple(None if jpeg is None else _decompressed(jpeg) for jpeg in views)

    def _decode(self, start: int) -> Iterator[Views]:
        for frames in self.sets.between(start, len(self.sets)):
            self._latest = self.upright(frames)
            yield tuple(None if image is None else compressed(image) for image in self._latest.images)

    def views(self, frame: int, body: Body, pose: Pose | None) -> list[ViewInput | None]:
        """The views of a frame, the athlete cut out of them as the hall behind tells it. With a ``pose`` only its
        surroundings are searched."""
        images, places = self.images(frame), self.localisations(frame)
        config = ForegroundConfig()
        found: list[ViewInput | None] = []
        for number, camera in enumerate(self.cameras(frame)):
            image, panorama = images[number], self.found.panoramas[number]
            head, place = self.found.cameras[number], places[number]
            if camera is None or image is None or panorama is None or head is None or place is None:
                found.append(None)
                continue
            expected = None if pose is None else expect(body, pose, FOOTAGE.expected_sigma_m, camera, FOOTAGE.margin)
            if expected is not None:  # its surroundings alone: the outline shall tell whether the body fits it
                odds = config.prior_log_odds / 2.0 * np.hypot(config.prediction_sigma_px, expected.sigma_px)
                expected = replace(expected, distance_px=np.full_like(expected.distance_px, odds))
            found.append(ViewInput(image, camera, separate(image, panorama, head, place, config, expected)))
        return found


def outlines(mask: Array | np.ndarray) -> list[Array]:
    """The outlines (N, 2) of a mask (H, W), pixels."""
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    simple = (cv2.approxPolyDP(contour, FOOTAGE.edge_px, True)[:, 0].astype(np.float64) for contour in contours)
    return [line for line in simple if len(line) > 2]


def compressed(image: Image) -> bytes:
    """An image as JPEG."""
    return bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, FOOTAGE.quality])[1])


def _decompressed(jpeg: bytes) -> Image:
    return np.asarray(cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR), np.uint8)


def _halfway(track: PanZoomTrack, frame: int) -> Localisation:
    """Half a frame period after a frame; it was found if that frame and the next were."""
    here, there = _localisation(track, frame), _localisation(track, frame + 1)
    turned_rad = float(wrapped(there.pan_rad - here.pan_rad))
    return replace(
        here, pan_rad=here.pan_rad + 0.5 * turned_rad, tilt_rad=(here.tilt_rad + there.tilt_rad) / 2,
        roll_rad=(here.roll_rad + there.roll_rad) / 2, focal_px=float(np.sqrt(here.focal_px * there.focal_px)),
        covariance=(here.covariance + there.covariance) / 2, shear=(here.shear + there.shear) / 2,
        valid=here.valid and there.valid,
    )  # fmt: skip


def _localisation(track: PanZoomTrack, frame: int) -> Localisation:
    nowhere = np.zeros((0, 2))
    return Localisation(
        float(track.pan_rad[frame]), float(track.tilt_rad[frame]), float(track.focal_px[frame]),
        track.covariance[frame], bool(track.valid[frame]), nowhere, nowhere, float(track.roll_rad[frame]),
        shear=track.shear[frame] if len(track.shear) else np.zeros(2),
        readout=float(track.readout[frame]) if len(track.readout) else 0.0,
    )  # fmt: skip
