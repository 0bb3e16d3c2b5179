"""The capture folder: what a crew brings home, read and checked. docs/capture.md specifies the format.

`read_capture` checks every file that the folder names, so that what is wrong is said before any work begins;
`frame_sets` brings the recordings of the motion together by their clocks (`pzcap.io.clocks`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np

from pzcap.io import limits
from pzcap.io.clocks import Timeline, check_clock, drop_frame, read_sync, timelines
from pzcap.io.detections import NOBODY, read_keypoints
from pzcap.io.files import checked
from pzcap.io.known_lengths import read_known_lengths
from pzcap.io.manifest import Json, load_json, read_keyframes, read_object, read_subject
from pzcap.io.picture_header import is_whole, picture_size
from pzcap.io.timecode import frames_per_day, frames_to_timecode, rate_of, timecode_to_frames
from pzcap.io.video import VideoReader
from pzcap.types import Array, CameraFiles, Capture, FrameSet, Image, Keyframe, Mark, PzcapError

FORMAT = "pzcap-capture"
VERSION = 1
MANIFEST = "capture.json"
PAPERS = ("object", "subject", "keyframes", "lengths", "sync")
_ENTRIES = ("format", "version", "name", "frame_rate", "full_turn", "cameras", *PAPERS)
FOOTAGE = ("reference", "sweep", "zoom", "motion")


def read_capture(folder: Path, *, without_clocks: bool = False) -> Capture:
    """Read a capture folder and check everything it names, but for the pixels and for what a detector found in them.

    ``without_clocks``: of cameras that have neither timecode nor sync.json yet. Raises PzcapError naming the file at
    fault and the remedy: a file that is missing or no JSON, a wrong version, a missing, misspelt or malformed entry, a
    video that cannot be opened, whose clock is not known, or that has another frame rate than the manifest or another
    size than the camera's other files.
    """
    manifest = load_json(folder / MANIFEST, "give the folder that holds it; pzcap new FOLDER writes one")
    if manifest["format"].text() != FORMAT or manifest["version"].value != VERSION:
        raise manifest.error(f'this is not format "{FORMAT}", version {VERSION}; convert it (docs/capture.md)')
    manifest.only(*_ENTRIES)
    rate = _frame_rate(manifest["frame_rate"])
    entries = manifest["cameras"].list()
    if len(entries) > limits.CAMERAS:
        raise manifest["cameras"].error(f"{len(entries)} cameras, where {limits.CAMERAS} are the most")
    cameras = tuple(_read_camera(entry, folder) for entry in entries)
    names = [camera.name for camera in cameras]
    if not cameras or len(set(names)) < len(names):
        raise manifest["cameras"].error("list at least one camera, each with a name of its own")
    _check_own(manifest, cameras)
    object_path, subject_path, keyframes_path, lengths_path, sync_path = (manifest.file(key, folder) for key in PAPERS)
    sync = None if sync_path is None or without_clocks else read_sync(sync_path)
    for camera in cameras:
        _check_videos(camera)
        if camera.motion is not None and not without_clocks:
            check_clock(camera.name, VideoReader(camera.motion), rate, sync)
    posed = read_keyframes(keyframes_path, rate) if keyframes_path else {}
    lengths = read_known_lengths(lengths_path) if lengths_path else ()
    for mark in (mark for one in lengths for end in one.ends for mark in end):
        check_mark(mark, cameras, f"{lengths_path}: ")
    return Capture(
        folder=folder, name=manifest["name"].name(), frame_rate=rate, cameras=cameras,
        calibration_object=read_object(object_path) if object_path else None,
        subject=read_subject(subject_path) if subject_path else None,
        keyframe_poses={timecode: pose for timecode, (pose, _) in posed.items()},
        keyframe_covariances={timecode: known for timecode, (_, known) in posed.items() if known is not None},
        full_turn=manifest["full_turn"].boolean(), sync=sync, lengths=lengths,
    )  # fmt: skip


def read_image(path: Path) -> Image:
    """Read a PNG or JPEG (H, W, 3), turned upright as its EXIF says.

    Raises PzcapError if it is missing, truncated, neither, or larger than `pzcap.io.limits`.
    """
    try:
        data = checked(path).read_bytes()
    except OSError as error:
        what = "no such image" if isinstance(error, FileNotFoundError) else "the image cannot be read"
        raise PzcapError(f"{path}: {what} ({error.strerror}); copy it again from the camera") from error
    size = picture_size(data)
    if size is not None and (problem := limits.picture_problem(*size)):
        raise PzcapError(f"{path}: {problem}")
    # OpenCV fills up what is cut off with grey and a line on stderr
    whole = size is not None and is_whole(data)
    image = _decoded(data) if whole else None
    if image is None and data and size is None:
        raise PzcapError(
            f"{path}: the image cannot be decoded, being neither PNG nor JPEG, whatever its name; save it as "
            "one of them, at its full size and not corrected for distortion"
        )
    if image is None:
        raise PzcapError(f"{path}: the image cannot be decoded; copy it again from the camera, as PNG or JPEG")
    return image


def _decoded(data: bytes) -> Image | None:
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    except cv2.error as error:  # a header that says one thing and another
        if error.code == cv2.Error.StsNoMem:
            raise MemoryError("a picture") from error
        return None
    return None if image is None else np.asarray(image, np.uint8)


def _frame_rate(entry: Json) -> Fraction:
    try:
        rate = rate_of(entry.text())
    except PzcapError as error:
        raise entry.error(str(error)) from error
    if rate is None:
        raise entry.error('must be a fraction in quotes, such as "30/1"')
    return rate


def _read_camera(entry: Json, folder: Path) -> CameraFiles:
    entry.only("name", *FOOTAGE, "keypoints", "keypoints_from")
    name = entry["name"].name()
    reference, sweep, zoom, motion = (entry.file(kind, folder) for kind in FOOTAGE)
    keypoints = entry.file("keypoints", folder, or_folder=True)
    first = entry["keypoints_from"] if entry.value.get("keypoints_from") is not None else None
    if first is not None and (type(first.value) is not int or first.value not in (0, 1)):
        raise first.error("must be 0 or 1: the number of the first picture")
    counted_from = None if first is None else int(first.value)
    return CameraFiles(name, reference, sweep, zoom, motion, keypoints, counted_from)


def _check_own(manifest: Json, cameras: Sequence[CameraFiles]) -> None:
    """Raise PzcapError where one file is named in two places: a line that was copied and not changed."""
    seen: dict[tuple[int, int], str] = {}
    for number, camera in enumerate(cameras):
        for kind in (*FOOTAGE, "keypoints"):
            path: Path | None = getattr(camera, kind)
            if path is None:
                continue
            known, here = path.stat(), f"cameras[{number}].{kind}"
            before = seen.setdefault((known.st_dev, known.st_ino), here)
            if before != here:
                raise manifest.error(f"{before} and {here} are one and the same; each camera has its own of each")


def _check_videos(camera: CameraFiles) -> None:
    """One size for all that a camera recorded."""
    sizes: dict[Path, tuple[int, int]] = {}
    if camera.reference is not None:
        height, width = read_image(camera.reference).shape[:2]
        sizes[camera.reference] = (width, height)
    for path in (camera.sweep, camera.zoom, camera.motion):
        if path is not None:
            reader = VideoReader(path)
            sizes[path] = (reader.width, reader.height)
    if problem := size_problem(sizes, camera.reference):
        raise PzcapError(f"{next(iter(sizes)).parent}: one size is needed for all files of a camera, not {problem}")


def size_problem(sizes: Mapping[Path, tuple[int, int]], still: Path | None) -> str | None:
    """The sizes of a camera's files where they are not one, with the cure; ``still``: its reference image."""
    if len(set(sizes.values())) < 2:
        return None
    listing = ", ".join(f"{path.name} {width}x{height}" for path, (width, height) in sizes.items())
    if len({frozenset(size) for size in sizes.values()}) == 1:
        cure = (
            "some stand upright and some lie: if the camera did not, take the turn out of those that say it wrongly "
            "(video: ffmpeg -display_rotation 0 -i IN -c copy OUT; photo: exiftool -Orientation= PHOTO)"
        )
    elif len({size for path, size in sizes.items() if path != still}) == 1:
        cure = (
            "a photo shows more or less of the scene than a video: film the object as the sweep, and take the still "
            "out of that (ffmpeg -i VIDEO -frames:v 1 reference.png)"
        )
    else:
        cure = "shoot what differs again, by the settings of the motion: other sizes show more or less of the scene"
    return f"{listing}; {cure}"


def check_mark(mark: Mark, cameras: Sequence[CameraFiles], where: str = "") -> None:
    """Raise PzcapError, beginning with ``where``, if a mark is in no picture of the capture."""
    files = next((camera for camera in cameras if camera.name == mark.camera), None)
    if files is None:
        known = ", ".join(camera.name for camera in cameras)
        raise PzcapError(f'{where}there is no camera "{mark.camera}"; the cameras are {known}')
    path: Path | None = getattr(files, mark.video)
    if path is None:  # it was not brought, and the mark is of no use
        return
    reader = VideoReader(path)
    if not mark.frame < reader.frame_count:
        raise PzcapError(f"{where}{path} has no picture {mark.frame}: it holds {reader.frame_count}, counted from 0")
    if not (-0.5 <= mark.px[0] < reader.width - 0.5 and -0.5 <= mark.px[1] < reader.height - 0.5):
        raise PzcapError(
            f"{where}({mark.px[0]:g}, {mark.px[1]:g}) lies outside the pictures of {path}, "
            f"{reader.width} x {reader.height}"
        )


# --------------------------------------------------------------------------------------------------------------
# Frame sets


class FrameSets:
    """The recordings of the motion, brought together by their clocks. See `frame_sets`.

    ``len()`` is the number of frame sets, ``timecodes`` names each, ``keyframes`` holds the poses set by hand;
    ``interlaced``: so is a recording; ``on_their_side``: which cameras' rows are shown as columns.
    """

    def __init__(
        self, readers: Sequence[VideoReader | None], keypoints: Sequence[dict[int, Array]], clocks: Sequence[Timeline],
        first: int, timecodes: tuple[str, ...],
    ) -> None:  # fmt: skip
        self._readers = readers
        self._keypoints = keypoints  # of each camera, by its own index
        self._pictures = [dict(zip(each.clock.tolist(), each.picture.tolist(), strict=True)) for each in clocks]
        late = [dict(zip(each.clock.tolist(), each.late.tolist(), strict=True)) for each in clocks]
        self._late = late if any(each.late.any() for each in clocks) else []
        self.on_their_side = [reader is not None and reader.on_its_side for reader in readers]
        self.interlaced = any(reader is not None and reader.interlaced for reader in readers)
        self._first = first  # of the first frame set, on the common clock
        self.timecodes = timecodes
        self.keyframes: tuple[Keyframe, ...] = ()

    def __len__(self) -> int:
        return len(self.timecodes)

    def __iter__(self) -> Iterator[FrameSet]:
        return self.between(0, len(self))

    def between(self, start: int, stop: int) -> Iterator[FrameSet]:
        """Frame sets ``start`` to ``stop`` - 1, in order.

        The cameras are decoded side by side, one frame set ahead of the caller; memory does not grow with the length.
        """
        views = [self._view(camera, start, stop) for camera in range(len(self._readers))]
        with ThreadPoolExecutor(max_workers=len(views)) as pool:
            ahead = [pool.submit(next, view) for view in views] if start < stop else []
            for index in range(start, stop):
                images, second = zip(*(future.result() for future in ahead), strict=True)
                if index + 1 < stop:
                    ahead = [pool.submit(next, view) for view in views]
                late = tuple(each.get(self._first + index, 0.0) for each in self._late)
                fields = second if self.interlaced else ()
                yield FrameSet(index, self.timecodes[index], images, self.people(index), late, fields)

    def people(self, index: int) -> tuple[Array, ...]:
        """Detections in each camera's picture of a frame set."""
        if not any(self._keypoints):
            return ()
        clock = self._first + index
        pairs = zip(self._keypoints, self._pictures, strict=True)
        return tuple(found.get(pictures.get(clock, -1), NOBODY) for found, pictures in pairs)

    def pictures(self, camera: int) -> list[int | None]:
        """Index of a camera's picture in each frame set, as `VideoReader.read` counts; None where it has none."""
        return [self._pictures[camera].get(self._first + index) for index in range(len(self))]

    def _view(self, camera: int, start: int, stop: int) -> Iterator[tuple[Image | None, Image | None]]:
        """One camera's image, and second field, for each of the frame sets, None where it has none."""
        reader = self._readers[camera]
        wanted = self.pictures(camera)[start:stop]
        there = [picture for picture in wanted if picture is not None]
        if reader is None or not there:
            yield from ((None, None) for _ in wanted)
            return
        frames = reader.read_fields(there[0], there[-1] + 1, frozenset(there))
        for picture in wanted:
            yield (None, None) if picture is None else next(frames)[1:]


def frame_sets(capture: Capture) -> FrameSets:
    """Align the cameras' recordings of the motion by timecode, or as sync.json says.

    The range is what all cameras with a recording have in common. Within it a frame that a camera dropped is None, and
    so is every view of a camera that recorded no motion. Raises PzcapError if no camera recorded the motion, the
    recordings do not overlap, a keyframe lies outside them, or keypoints cannot be read.
    """
    readers = [None if camera.motion is None else VideoReader(camera.motion) for camera in capture.cameras]
    recorded = [reader for reader in readers if reader is not None]
    if not recorded:
        raise PzcapError(f'{capture.folder / MANIFEST}: no camera has a "motion" video; name at least one')
    drop = capture.sync is None and drop_frame(capture.folder, recorded)
    day = frames_per_day(capture.frame_rate, drop)
    clocks = timelines(capture, readers)
    used = [each.clock for each, reader in zip(clocks, readers, strict=True) if reader is not None]
    first = max(int(each[0]) if len(each) else 1 for each in used)
    stop = min(int(each[-1]) + 1 if len(each) else 0 for each in used)
    if first >= stop:
        how = "timecode" if capture.sync is None else "time by sync.json"
        cure = "or let pzcap sync FOLDER find how they lie to each other" if capture.sync is None else "in sync.json"
        raise PzcapError(
            f"{capture.folder}: the motion videos have no {how} in common; check that they are of one take, and that "
            f"the clocks were synchronised, {cure}"
        )
    keypoints = [
        {}
        if reader is None or camera.keypoints is None
        else _keypoints(camera.keypoints, camera.keypoints_from, reader)
        for camera, reader in zip(capture.cameras, readers, strict=True)
    ]
    timecodes = tuple(frames_to_timecode(clock, capture.frame_rate, drop) for clock in range(first, stop))
    sets = FrameSets(readers, keypoints, clocks, first, timecodes)
    keyframes = []
    for timecode, pose in capture.keyframe_poses.items():
        index = (_clock_of(capture, timecode, drop) - first) % day
        if index >= len(sets):
            counted = "" if capture.sync is None else " (sync.json counts from 00:00:00:00 on)"
            raise PzcapError(
                f"{capture.folder}: the keyframe at {timecode} lies outside the recordings' common range"
                f" {sets.timecodes[0]} to {sets.timecodes[-1]}{counted}; correct its timecode or remove it"
            )
        keyframes.append(Keyframe(frame=index, pose=pose, covariance=capture.keyframe_covariances.get(timecode)))
    sets.keyframes = tuple(sorted(keyframes, key=lambda keyframe: keyframe.frame))
    return sets


def _keypoints(path: Path, first: int | None, reader: VideoReader) -> dict[int, Array]:
    return read_keypoints(path, reader.indices, (reader.width, reader.height), first)


def _clock_of(capture: Capture, timecode: str, drop: bool) -> int:
    """Frames since midnight of a keyframe's timecode, which is read as the recordings count."""
    try:
        return timecode_to_frames(f"{timecode[:8]}{';' if drop else ':'}{timecode[9:]}", capture.frame_rate)
    except PzcapError as error:
        raise PzcapError(f"{capture.folder}: keyframe: {error}") from error
