"""Result types -> Rerun. The only room of the library that knows Rerun; docs/recording.md lists the entities.

`Recorder` takes the pipeline's events as they come: pictures are encoded and written by a thread of its own, so that
the reconstruction does not wait for them. Everything that is a number a frame is sent at the end, in columns.
"""

from __future__ import annotations

import queue
import threading
import time
import uuid
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Final

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from pzcap.events import CameraCalibrated, Event, FrameLocalised, FrameSegmented
from pzcap.io.capture import read_image
from pzcap.types import Array, Capture, Image, Localisation, Panorama, PzcapError, ReferenceCamera, Silhouette
from pzcap.viewer.columns import PIXEL_CENTRE, TIMELINE, path_part, plain, view_path
from pzcap.viewer.drawing import KEYPOINT_COLOUR, OUTLINE_COLOUR, centred, centred_shift, outlines, project_edges
from pzcap.viewer.utf8_name import with_utf8_name

APPLICATION: Final = "pzcap-v1"
"""The viewer binds its layout to this name: a new layout needs a new one."""

MAX_MATCHES: Final = 150
MAX_PENDING: Final = 8


class Recorder:
    """Writes one recording. Use it as a context manager: the file is whole once that is left without an exception.

    Until then it stands beside ``path`` as ``<name>.partial``. ``busy_s`` sums up the time that writing took.
    """

    def __init__(self, path: Path, capture: Capture, *, name: str, jpeg_quality: int = 75) -> None:
        self.path, self.capture, self.busy_s = path, capture, 0.0
        self._partial = path.with_name(path.name + ".partial")
        self._quality = jpeg_quality
        self._error: BaseException | None = None
        self._panoramas: dict[int, Panorama] = {}
        # Two recordings with one id are silently merged by the viewer: a new one for every file.
        self.rec = rr.RecordingStream(APPLICATION, recording_id=str(uuid.uuid4()))
        self.rec.set_log_time_enabled(False)
        self.rec.set_log_tick_enabled(False)
        try:
            with with_utf8_name(self._partial) as named:
                self.rec.save(named)
        except RuntimeError as error:  # all that Rerun says of a file that it cannot write
            raise PzcapError(f"{path}: cannot be written ({error}); choose another folder") from error
        self.rec.send_recording_name(plain(name))
        self._queue: queue.Queue[Callable[[], None] | None] = queue.Queue(MAX_PENDING)
        self._worker = threading.Thread(target=self._work, name="recorder", daemon=True)
        self._worker.start()
        log_hall(self.rec, capture)

    def event(self, event: Event) -> None:
        """Hand over what a stage of the pipeline yielded. Returns at once, unless the writer has fallen far behind."""
        if self._error is not None:
            raise self._error
        names = [camera.name for camera in self.capture.cameras]
        match event:
            case CameraCalibrated():
                self._queue.put(lambda: self._calibrated(event, names[event.index]))
            case FrameLocalised():
                self._queue.put(lambda: self._localised(event, names))
            case FrameSegmented():
                self._queue.put(lambda: self._separated(event, names))
            case _:
                pass

    @contextmanager
    def timed(self) -> Iterator[rr.RecordingStream]:
        """The stream, for logging from the caller's thread, which counts as time spent writing."""
        start = time.perf_counter()
        yield self.rec
        self.busy_s += time.perf_counter() - start

    def recorded(self, events: Iterable[Event]) -> Iterator[Event]:
        """The ``events``, each recorded as it goes by."""
        for event in events:
            self.event(event)
            yield event

    def drain(self) -> None:
        """Wait until everything that was handed over is written."""
        start = time.perf_counter()
        self._queue.join()
        if self._error is not None:
            raise self._error
        try:
            self.rec.flush()
        except RuntimeError as error:  # all that Rerun says of a file that it cannot write
            raise self._unwritable() from error
        self.busy_s += time.perf_counter() - start

    def __enter__(self) -> Recorder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._queue.put(None)
        self._worker.join()
        self.rec.disconnect()
        if kind is not None or self._error is not None:
            self._partial.unlink(missing_ok=True)
            if kind is None and self._error is not None:
                raise self._error
            return
        if not has_footer(self._partial):
            self._partial.unlink(missing_ok=True)
            raise self._unwritable()
        self._partial.replace(self.path)

    def _unwritable(self) -> PzcapError:
        return PzcapError(f"{self.path}: the recording cannot be written to its end; the disk is full, free some space")

    def _work(self) -> None:
        while (job := self._queue.get()) is not None:
            start = time.thread_time()
            try:
                if self._error is None:
                    job()
            except Exception as error:
                self._error = error
            finally:
                self.busy_s += time.thread_time() - start
                self._queue.task_done()
        self._queue.task_done()

    def _calibrated(self, event: CameraCalibrated, name: str) -> None:
        part, prepared = path_part(name), event.calibrated
        if prepared is not None:
            self._panoramas[event.index] = prepared.panorama
            log_panorama(self.rec, f"/panorama/{part}", prepared.panorama, self._quality)
        path = self.capture.cameras[event.index].reference
        if path is not None:
            reference = None if prepared is None else prepared.reference
            log_reference(self.rec, f"/reference/{part}", read_image(path), reference, self.capture, self._quality)

    def _localised(self, event: FrameLocalised, names: Sequence[str]) -> None:
        self.rec.set_time(TIMELINE, sequence=event.frames.index)
        for index, (name, image, found) in enumerate(zip(names, event.frames.images, event.localisations, strict=True)):
            view = f"{view_path('/world', name)}/image"
            self.rec.log(view, rr.Clear(recursive=False) if image is None else encoded(image, self._quality))
            log_matches(self.rec, name, found, self._panoramas.get(index))
        for name, people in zip(names, event.frames.keypoints, strict=False):  # there may be none at all
            log_keypoints(self.rec, name, people)

    def _separated(self, event: FrameSegmented, names: Sequence[str]) -> None:
        self.rec.set_time(TIMELINE, sequence=event.frames.index)
        for name, silhouette in zip(names, event.silhouettes, strict=True):
            log_silhouette(self.rec, name, silhouette, self._quality)


def has_footer(path: Path) -> bool:
    """True where the recording at ``path`` was closed properly: its footer is written last."""
    try:
        with warnings.catch_warnings(action="ignore"), with_utf8_name(path) as named:
            rr.chunk.RrdReader(named).store()
    except Exception:  # the reader's exceptions have no common type of their own
        return False
    return True


# --------------------------------------------------------------------------------------------------------------
# Once


def log_hall(rec: rr.RecordingStream, capture: Capture) -> None:
    """World axes, a floor of 2 m squares, and the calibration object."""
    for root in ("/world", "/truth"):
        rec.log(root, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    lines = [[(x, -10, 0), (x, 10, 0)] for x in range(-14, 15, 2)] + [
        [(-14, y, 0), (14, y, 0)] for y in range(-10, 11, 2)
    ]
    rec.log("/world/floor", rr.LineStrips3D(lines, colors=(74, 76, 84), radii=rr.Radius.ui_points(0.5)), static=True)
    if capture.calibration_object is not None:
        edges = rr.LineStrips3D(list(capture.calibration_object.wireframe_m), colors=(80, 120, 255), radii=0.012)
        rec.log("/world/object", edges, static=True)


def log_reference(
    rec: rr.RecordingStream,
    path: str,
    image: Image,
    reference: ReferenceCamera | None,
    capture: Capture,
    jpeg_quality: int,
) -> None:
    """The image of the calibration object, its corners as detected and as projected, its wireframe (Fig. 8)."""
    rec.log(f"{path}/image", encoded(image, jpeg_quality), static=True)
    if reference is None:
        return
    projected = reference.points_px - reference.residuals_px
    rec.log(
        f"{path}/detected",
        rr.Points2D(reference.points_px + PIXEL_CENTRE, colors=(255, 220, 60), radii=2.5),
        static=True,
    )
    rec.log(f"{path}/projected", rr.Points2D(projected + PIXEL_CENTRE, colors=(235, 64, 52), radii=1.2), static=True)
    if capture.calibration_object is not None:
        edges = project_edges(reference.camera, capture.calibration_object.wireframe_m)
        strips = [edge + PIXEL_CENTRE for edge in edges]
        rec.log(f"{path}/wireframe", rr.LineStrips2D(strips, colors=(80, 120, 255), radii=0.8), static=True)


def log_panorama(rec: rr.RecordingStream, path: str, panorama: Panorama, jpeg_quality: int) -> None:
    """The panorama, where each frame of the sweep looked, and where the reference pose looks."""
    shown = centred(panorama)
    image = np.where(shown.valid[..., None], shown.image, np.uint8(0))
    rec.log(f"{path}/image", encoded(image, jpeg_quality), static=True)
    column, _ = shown.origin_px + PIXEL_CENTRE
    columns = column - shown.sweep_pan_rad * shown.px_per_rad
    if shown.full_turn:
        columns = columns % image.shape[1]
    ticks = [[(x, -16), (x, -4)] for x in columns]
    rec.log(f"{path}/sweep", rr.LineStrips2D(ticks, colors=(200, 200, 200), radii=0.8), static=True)
    reference = [[(column, -24), (column, image.shape[0])]]
    rec.log(f"{path}/reference_pose", rr.LineStrips2D(reference, colors=(80, 120, 255), radii=1.0), static=True)


# --------------------------------------------------------------------------------------------------------------
# A frame (the caller has set the time)


def log_matches(rec: rr.RecordingStream, name: str, found: Localisation | None, panorama: Panorama | None) -> None:
    """Matches in the frame and in the panorama; both ends of one have one colour (Fig. 9)."""
    paths = f"{view_path('/world', name)}/matches", f"/panorama/{path_part(name)}/matches"
    if found is None or panorama is None or not len(found.frame_points_px):
        for path in paths:
            rec.log(path, rr.Clear(recursive=False))
        return
    some = np.linspace(0, len(found.frame_points_px) - 1, min(MAX_MATCHES, len(found.frame_points_px))).astype(int)
    there = found.panorama_points_px[some] + centred_shift(panorama)
    if panorama.full_turn:
        there[:, 0] %= panorama.image.shape[1]
    colours = _rainbow(found.frame_points_px[some, 0])
    for path, points in zip(paths, (found.frame_points_px[some], there), strict=True):
        rec.log(path, rr.Points2D(points + PIXEL_CENTRE, colors=colours, radii=rr.Radius.ui_points(2.0)))


def log_keypoints(rec: rr.RecordingStream, name: str, people: Array) -> None:
    """Log what a detector found in a view, (P, 26, 3); the surer, the brighter."""
    path, found = f"{view_path('/world', name)}/keypoints", people[people[..., 2] > 0.0]
    colours = np.outer(0.3 + 0.7 * found[:, 2], KEYPOINT_COLOUR).astype(np.uint8)
    points = rr.Points2D(found[:, :2] + PIXEL_CENTRE, colors=colours, radii=rr.Radius.ui_points(3.0))
    rec.log(path, points if len(found) else rr.Clear(recursive=False))


def log_silhouette(rec: rr.RecordingStream, name: str, silhouette: Silhouette | None, jpeg_quality: int) -> None:
    """The outline over the view; the warped panorama and the probability as pictures of half the size."""
    part = path_part(name)
    path, pictures = f"{view_path('/world', name)}/outline", f"/foreground/{part}"
    if silhouette is None or not silhouette.valid:
        rec.log(path, rr.Clear(recursive=False))
        rec.log(pictures, rr.Clear(recursive=True))
        return
    strips = [outline + PIXEL_CENTRE for outline in outlines(silhouette.probability)]
    rec.log(path, rr.LineStrips2D(strips, colors=OUTLINE_COLOUR, radii=0.7) if strips else rr.Clear(recursive=False))
    for kind, image in (("background", silhouette.background), ("probability", silhouette.probability)):
        small = cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        rec.log(f"{pictures}/{kind}", encoded(np.asarray(small, np.uint8), jpeg_quality))


def encoded(image: Image, jpeg_quality: int) -> rr.EncodedImage:
    """JPEG: every viewer shows it without a codec, and a recording of raw images would be twenty times the size."""
    data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality])[1]
    return rr.EncodedImage(contents=data.tobytes(), media_type="image/jpeg")


def _rainbow(values: Array) -> NDArray[np.uint8]:
    """A colour (N, 3) for each value: hue from the least to the greatest."""
    span = max(float(np.ptp(values)), 1e-9)
    hue = ((values - values.min()) / span * 150).astype(np.uint8)
    hsv = np.dstack([hue, np.full_like(hue, 200), np.full_like(hue, 255)])
    return np.asarray(cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB)[0], np.uint8)
