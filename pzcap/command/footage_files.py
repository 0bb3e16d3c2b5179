"""A crew's own files: which camera they are of, what each is for, and what its container says of itself."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatch
from fractions import Fraction
from pathlib import Path
from typing import Final

import av
from av.error import FFmpegError

from pzcap.io import results
from pzcap.io.capture import FOOTAGE, read_image, size_problem
from pzcap.io.clocks import DRIFT, RATE_TOLERANCE
from pzcap.io.files import checked
from pzcap.io.frame_times import usual_rate
from pzcap.io.video import VideoReader
from pzcap.types import PzcapError

READ_STILLS: Final = {".png", ".jpg", ".jpeg"}
STILLS: Final = READ_STILLS | {
    ".tif", ".tiff", ".bmp", ".webp", ".heic", ".heif", ".hif", ".avif",
    ".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".rw2", ".orf",
}  # fmt: skip
"""Kinds of pictures, those too that are refused: one that is passed over in silence is missed, or missed by nobody."""
VIDEOS: Final = {
    ".mp4", ".mov", ".qt", ".m4v", ".3gp", ".3g2", ".mkv", ".webm", ".mxf", ".gxf", ".avi", ".dv", ".mts", ".m2ts",
    ".m2t", ".ts", ".tod", ".mpg", ".mpeg", ".mod", ".vob", ".wmv", ".asf", ".flv", ".ogv", ".nut", ".braw", ".r3d",
    ".crm",
}  # fmt: skip
"""Kinds of videos, those too that FFmpeg may not decode: else the next one would be taken for what they are."""
WORDS: Final[dict[str, frozenset[str]]] = {
    "reference": frozenset(
        {"ref", "reference", "object", "cube", "calib", "calibration", "marker", "markers", "still"}
    ),
    "sweep": frozenset({"sweep", "pan", "pano", "panorama", "turn", "swing"}),
    "zoom": frozenset({"zoom", "zooms", "zooming"}),
    "motion": frozenset({"motion", "take", "action", "move", "movement", "performance", "exercise", "run", "routine"}),
}
"""Words in the name of a file that say what it is for."""
ORDER: Final[dict[int, tuple[str, ...]]] = {1: ("motion",), 2: ("sweep", "motion"), 3: ("sweep", "zoom", "motion")}
"""Of so many videos without such words, in the order of their names: as they are shot."""
_PIECES: Final = "join pieces of one recording first (docs/capture.md)"


@dataclass(frozen=True, slots=True)
class File:
    """A file of a camera, what it is for, and what it says of itself. What cannot be read has a ``trouble`` alone."""

    path: Path
    role: str
    known_by: str
    width: int = 0
    height: int = 0
    rate: Fraction | None = None
    timecode: str | None = None
    frames: int = 1
    interlaced: bool = False
    rotation_deg: int = 0
    varies: bool = False  # its rate, which is then what the camera was set to
    trouble: str | None = None


def cameras_in(folder: Path, patterns: Mapping[str, str]) -> dict[str, list[File]]:
    """The files of each camera in ``folder``, by the camera's name: that of the folder they lie in, without the word
    "camera", or what is left of their own names without the word for what they are. ``patterns``: role to a pattern
    that names the file outright.

    Raises PzcapError where there is no footage, or where nothing tells what a file is for.
    """
    groups: dict[str, list[Path]] = {}
    for inner in sorted((path for path in folder.iterdir() if path.is_dir()), key=_natural):
        if any(inner.rglob(results.MANIFEST)):  # with pictures and stabilised video in it
            continue
        found = sorted((path for path in inner.rglob("*") if _is_footage(path)), key=_natural)
        if any(path.suffix.lower() in VIDEOS for path in found) and not inner.name.startswith("."):
            groups[inner.name] = found
    if not groups:
        for path in sorted((path for path in folder.iterdir() if _is_footage(path)), key=_natural):
            groups.setdefault(_without_role(path.stem), []).append(path)
    if not any(path.suffix.lower() in VIDEOS for paths in groups.values() for path in paths):
        raise PzcapError(f"{folder}: no videos in it; put those of each camera into a folder of the camera's name")
    return {
        name: [_described(*each) for each in _roles(name, paths, patterns).values()]
        for name, paths in zip(_names(list(groups)), groups.values(), strict=True)
    }


def _names(groups: Sequence[str]) -> Sequence[str]:
    """Names of cameras: of camera_1 and camera_2, 1 and 2, since messages say "camera" before a name."""
    short = [re.sub(r"(?i)^cam(era)?[ _.-]*", "", name) for name in groups]
    told = all(one and one != name for one, name in zip(short, groups, strict=True)) and len({*short}) == len(short)
    return short if told else groups


def _is_footage(path: Path) -> bool:
    return path.suffix.lower() in STILLS | VIDEOS and not path.name.startswith(".") and path.is_file()


def _words(stem: str) -> list[str]:
    """Words of a name: cam1_sweepA is cam, sweep, A."""
    return re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", stem)


def _role_of(stem: str) -> str | None:
    """Role of a file by its name."""
    words = {word.lower() for word in _words(stem)}
    roles = [role for role, known in WORDS.items() if words & known]
    return roles[0] if len(roles) == 1 else None


def _without_role(stem: str) -> str:
    known = frozenset().union(*WORDS.values())
    kept = [part for part in re.split(r"[ _.-]+", stem) if part.lower() not in known]
    return "_".join(kept) or "camera"


def _natural(path: Path) -> list[tuple[int, str]]:
    """Key that sorts GX2 before GX10."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", str(path).lower())]


def _roles(camera: str, paths: Sequence[Path], patterns: Mapping[str, str]) -> dict[str, tuple[Path, str, str]]:
    """Role -> (file, role, how it is known)."""
    found: dict[str, tuple[Path, str, str]] = {}
    if any(path.suffix.lower() in READ_STILLS for path in paths):  # beside raw pictures, as cameras write them
        paths = [path for path in paths if path.suffix.lower() in READ_STILLS | VIDEOS]
    left = list(paths)
    for role in FOOTAGE:
        named = [path for path in paths if role in patterns and fnmatch(path.name, patterns[role])]
        how = f"--{role} {patterns.get(role)}"
        if not named:
            named = [path for path in left if _role_of(path.stem) == role]
            how = "its name"
        if len(named) > 1:
            listed = ", ".join(path.name for path in named)
            pieces = "" if named[0].suffix.lower() in STILLS else f"; {_PIECES}"
            raise PzcapError(f"camera {camera}: {listed} could each be its {role}; say which by --{role} NAME{pieces}")
        if named:
            found[role] = (named[0], role, how)
            left = [path for path in left if path != named[0] and (role not in patterns or _role_of(path.stem) != role)]
    stills = [path for path in left if path.suffix.lower() in STILLS]
    videos = [path for path in left if path.suffix.lower() in VIDEOS]
    if {"sweep", "zoom", "motion"} <= set(patterns) & set(found):  # each by its name: others are of no use
        videos = []
    if stills and "reference" not in found:
        if len(stills) > 1:
            listed = ", ".join(path.name for path in stills)
            raise PzcapError(f"camera {camera}: {listed} could each be its reference; say which by --reference NAME")
        found["reference"] = (stills[0], "reference", "the only still")
    for path, role in zip(videos, _order(camera, videos, found), strict=True):
        found[role] = (path, role, "its place in the order")
    return {role: found[role] for role in FOOTAGE if role in found}


def _order(camera: str, videos: Sequence[Path], found: Mapping[str, object]) -> Sequence[str]:
    """Roles of videos whose names say nothing."""
    if not videos:
        return ()
    wanted = [role for role in ("sweep", "zoom", "motion") if role not in found]
    if len(videos) == len(wanted):
        return wanted
    if not set(found) - {"reference"} and len(videos) in ORDER:
        return ORDER[len(videos)]
    listed = ", ".join(path.name for path in videos)
    are = "is" if len(videos) == 1 else "are"
    raise PzcapError(
        f"camera {camera}: nothing tells what {listed} {are} for; say so by --sweep, --zoom, --motion NAME, or put "
        f"aside what is for nothing; {_PIECES}"
    )


def _described(path: Path, role: str, known_by: str) -> File:
    """Properties of a file by its own header."""
    try:
        if path.suffix.lower() in STILLS:
            height, width = read_image(path).shape[:2]
            return File(path, role, known_by, width, height)
        reader = VideoReader(path)
        interlaced, rotation = _first_frame(path)
    except PzcapError as error:
        return File(path, role, known_by, trouble=str(error))
    size, varies = (reader.width, reader.height), not reader.constant_rate
    rate = usual_rate(reader.times_s) if varies else reader.frame_rate
    return File(path, role, known_by, *size, rate, reader.timecode, reader.frame_count, interlaced, rotation, varies)


def _first_frame(path: Path) -> tuple[bool, int]:
    """Scan type of a video, True if interlaced, and the degrees by which its container turns it."""
    try:
        with av.open(str(checked(path)), metadata_errors="replace") as container:
            frame = next(container.decode(container.streams.video[0]))
            return bool(frame.interlaced_frame), int(frame.rotation)
    except (FFmpegError, StopIteration) as error:
        raise PzcapError(f"{path}: its first frame cannot be decoded; copy it again from the camera") from error


def keypoints_beside(motion: Path) -> Path:
    """File of the keypoints of a video, beside it."""
    return motion.with_name(f"{motion.stem}_keypoints.json")


def troubles(cameras: Mapping[str, Sequence[File]], synchronised: bool) -> Iterator[str]:
    """Faults of the files that stand against a reconstruction, each with its cure. ``synchronised``: by sync.json,
    which knows by how much a clock drifts."""
    for name, files in cameras.items():
        roles = {file.role: file for file in files}
        for file in files:
            if file.trouble:
                yield file.trouble
        sizes = {file.path: (file.width, file.height) for file in files if not file.trouble}
        still = roles["reference"].path if "reference" in roles else None
        if problem := size_problem(sizes, still):
            yield f"camera {name}: one size is needed for all its files, not {problem}"
        if "reference" not in roles:
            yield (
                f"camera {name}: no still of the calibration object; take one out of a video "
                "(ffmpeg -i VIDEO -frames:v 1 reference.png)"
            )
        if "sweep" not in roles:
            yield f"camera {name}: no sweep; its frames cannot be located"
        if "motion" not in roles:
            yield f"camera {name}: no motion; the body is tracked in the other views"
    rates = sorted({*motion_rates(cameras)})
    if not multiples(rates, DRIFT if synchronised else RATE_TOLERANCE):
        yield (
            f"the motion videos have {', '.join(map(str, rates))} frames/s; one rate is needed, or multiples of one: "
            "film again at one, or leave the motion of a camera out of capture.json; what differs by 2 % at most, "
            "pzcap sync FOLDER brings together"
        )


def motion_rates(cameras: Mapping[str, Sequence[File]]) -> list[Fraction]:
    """The rates of the motion videos that can be read; those that vary count where there are no others."""
    motions = [file for files in cameras.values() for file in files if file.role == "motion"]
    constant = [file.rate for file in motions if file.rate and not file.varies]
    return constant or [file.rate for file in motions if file.rate]


def multiples(rates: Sequence[Fraction], tolerance: float = RATE_TOLERANCE) -> bool:
    """True where all rates are whole multiples of the least, but for a ``tolerance``."""
    return all(abs(float(rate / min(rates)) / round(rate / min(rates)) - 1.0) < tolerance for rate in rates)
