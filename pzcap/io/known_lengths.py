"""lengths.json: distances that were measured in the hall, and marks of their ends. docs/capture.md specifies it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pzcap.io import limits
from pzcap.io.manifest import Json, load_json
from pzcap.types import KnownLength, Mark


def read_known_lengths(path: Path) -> tuple[KnownLength, ...]:
    """Read and check lengths.json."""
    return tuple(read_known_length(entry) for entry in load_json(path).list())


def read_known_length(entry: Json) -> KnownLength:
    """One of them. Raises PzcapError saying what is wrong with it."""
    entry.only("name", "length_m", "sigma_m", "from", "to")
    length_m, sigma_m = metres(entry["length_m"]), metres(entry["sigma_m"])
    if not sigma_m <= 0.1 * length_m:
        raise entry["sigma_m"].error("must be above 0 and at most a tenth of the length, in metres")
    one, other = (tuple(read_mark(mark) for mark in entry[key].list()) for key in ("from", "to"))
    if not one or not other:
        raise entry.error("each end needs a mark: one on the floor, or two in the pictures of two cameras")
    return KnownLength(entry["name"].name(), length_m, sigma_m, (one, other))


def metres(entry: Json) -> float:
    """A length of the hall, or of what stands in it. Raises PzcapError where it is none."""
    length_m = float(entry.array())
    if not 0.0 < length_m <= limits.HALL_M:
        raise entry.error(f"must be a length in metres, above 0 and at most {limits.HALL_M:g}")
    return length_m


def read_mark(entry: Json) -> Mark:
    """A mark of an end. Raises PzcapError saying what is wrong with it."""
    entry.only("camera", "video", "frame", "px")
    video, frame = entry["video"].value, entry["frame"].value
    if not (video == "sweep" or video == "zoom" or video == "motion"):
        raise entry["video"].error('must be "sweep", "zoom" or "motion"')
    if isinstance(frame, bool) or not isinstance(frame, int) or not 0 <= frame < limits.FRAMES:
        raise entry["frame"].error("must be the number of a picture of the video, counted from 0")
    return Mark(entry["camera"].name(), video, frame, entry["px"].array(2))


def mark_entry(mark: Mark) -> dict[str, Any]:
    """A mark as `read_mark` reads it."""
    return {"camera": mark.camera, "video": mark.video, "frame": mark.frame, "px": mark.px.tolist()}
