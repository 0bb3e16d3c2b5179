"""The text files of a capture: the calibration object, the subject, the keyframes. docs/capture.md specifies them."""

from __future__ import annotations

import difflib
import itertools
import json
import unicodedata
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from pzcap.io import limits
from pzcap.io.files import checked, leads_out
from pzcap.io.text import is_plain
from pzcap.io.timecode import frames_to_timecode, timecode_to_frames
from pzcap.types import (
    DOF,
    GARMENTS,
    MEASUREMENTS,
    SEGMENTS,
    Array,
    CalibrationObject,
    Garment,
    Marker,
    Pose,
    PzcapError,
    Subject,
)

_SQUARE = 1.25  # longest side of a marker by its shortest: a diagonal taken for a side is 1.41
_STRAIGHT: Final = 0.8  # median w of the quaternions of all segments against their parents, at least, whatever the pose
_BENT: Final = 0.5
_MOST_LOOKED_AT: Final = 10_000  # files of a folder among which one that is missing is looked for
_UNIT_TOLERANCE = 1e-3  # quaternions are written with a few decimals; they are normalised after this check


@dataclass(frozen=True, slots=True)
class Json:
    """A JSON value that knows where it stands, so that a complaint can say it."""

    value: Any
    path: Path
    where: str = ""

    def error(self, problem: str) -> PzcapError:
        return PzcapError(f"{self.path}: {self.where + ': ' if self.where else ''}{problem}")

    def __getitem__(self, key: str) -> Json:
        if not isinstance(self.value, dict):
            raise self.error("must be a JSON object; see docs/capture.md")
        if key not in self.value:
            raise self.error(f'"{key}" is missing; add it (docs/capture.md)')
        return Json(self.value[key], self.path, f"{self.where}.{key}" if self.where else key)

    def only(self, *keys: str) -> None:
        """Complain about a key that is not one of these: a misspelt optional one would silently be missing."""
        for key in self.value if isinstance(self.value, dict) else ():
            if key not in keys:
                if key in MEASUREMENTS and "measurements_m" in keys:
                    raise self.error(f'"{key}" is a measurement: it belongs inside "measurements_m"')
                near = difflib.get_close_matches(key, keys, n=1, cutoff=0.4) or keys
                raise self.error(f'unknown entry "{key}"; the nearest are {", ".join(near)}')

    def not_misspelt(self, optional: str) -> None:
        """The same where other keys are allowed: about one that is all but this optional one."""
        for key in self.value if isinstance(self.value, dict) else ():
            if key != optional and difflib.get_close_matches(key.casefold(), [optional], cutoff=0.8):
                raise self.error(f'entry "{key}"; write it "{optional}"')

    def list(self) -> list[Json]:
        if not isinstance(self.value, list):
            raise self.error("must be a JSON list; see docs/capture.md")
        return [Json(value, self.path, f"{self.where}[{i}]") for i, value in enumerate(self.value)]

    def text(self) -> str:
        if not isinstance(self.value, str) or not self.value:
            raise self.error("must be text in quotes")
        return self.value

    def name(self) -> str:
        """Text that is shown to people, in terminals and on pages."""
        if not is_plain(self.text()):
            raise self.error("holds control characters, which a terminal would obey; write it without them")
        return self.text()

    def boolean(self) -> bool:
        if not isinstance(self.value, bool):
            raise self.error("must be true or false")
        return self.value

    def length(self) -> float:
        """A length of a body, in metres."""
        longest = limits.MEASUREMENT_M
        if isinstance(self.value, bool) or not isinstance(self.value, int | float) or not 0 < self.value <= longest:
            raise self.error(f"must be a length in metres, above 0 and at most {longest:g}")
        return float(self.value)

    def array(self, *shape: int) -> Array:
        """Finite numbers; a -1 in ``shape`` stands for any length."""
        try:
            array = np.array(self.value, np.float64)
        except (TypeError, ValueError, OverflowError):
            array = np.empty(0)
        fits = array.ndim == len(shape) and all(w in (-1, n) for w, n in zip(shape, array.shape, strict=True))
        if not fits or not np.isfinite(array).all():
            raise self.error(f"must be {' x '.join('n' if n < 0 else str(n) for n in shape)} finite numbers")
        return array

    def place(self, *shape: int) -> Array:
        """Places in the world, in metres: finite numbers, none of them beyond the hall."""
        places = self.array(*shape)
        if places.size and np.abs(places).max() > limits.HALL_M:
            raise self.error(f"{np.abs(places).max():g} m from the origin, where {limits.HALL_M:g} are the most")
        return places

    def file(self, key: str, folder: Path, or_folder: bool = False) -> Path | None:
        """An optional file in ``folder``, which must exist if named; with ``or_folder`` it may be a folder of them.

        Links are followed: whoever made one in the folder meant it. A name that leads out by itself is refused.
        """
        if not isinstance(self.value, dict) or self.value.get(key) is None:
            return None
        name = self[key].text()
        if leads_out(name):
            raise self[key].error(f"{name} leads out of the folder; put the file, or a link to it, inside")
        path = folder / name
        try:
            if or_folder and path.is_dir():
                return path
            if checked(path).is_file():
                return path
        except OSError as error:  # a name that is too long
            raise self[key].error(f"no such file can be ({error.strerror}); correct the name") from error
        if path.is_symlink():
            raise self[key].error(f"{path} is a link to {path.readlink()}, which is missing; bring the file itself")
        written = _written_otherwise(folder, name)
        if written is not None and _composed(written) == _composed(name):  # people see one and the same name
            return folder / written
        remedy = "bring it, or put null in its place" if written is None else f'its name is written "{written}"'
        raise self[key].error(f"the file {path} is missing; {remedy}")


def _written_otherwise(folder: Path, name: str) -> str | None:
    """The file of ``folder`` that ``name`` means in another spelling: other case, backslashes, spaces around it, or
    accents that are characters of their own, as Macs write them."""
    wanted = _alike(name)
    for parts in itertools.islice(folder.rglob("*"), _MOST_LOOKED_AT):
        found = parts.relative_to(folder).as_posix()
        if _alike(found) == wanted and parts.is_file():
            return found
    return None


def _alike(name: str) -> str:
    return _composed(name).casefold().replace("\\", "/").strip()


def _composed(name: str) -> str:
    """``name`` with each accent and its letter as one character."""
    return unicodedata.normalize("NFC", name)


def _each_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object of JSON whose keys are all different: of two values of one key the first would silently be lost."""
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f'"{next(name for name in names if names.count(name) > 1)}" stands there twice')
    return found


def load_json(path: Path, remedy: str = "write it (docs/capture.md)", most_bytes: int = limits.PAPER_BYTES) -> Json:
    """Raises PzcapError, with the remedy, if the file cannot be read, is longer than ``most_bytes``, or is no JSON."""
    try:
        size = checked(path).stat().st_size
        if size > most_bytes:
            raise PzcapError(f"{path}: {size / 2**20:.0f} MiB, where {most_bytes / 2**20:.0f} MiB are the most")
        return Json(json.loads(path.read_text(encoding="utf-8-sig"), object_pairs_hook=_each_once), path)
    except OSError as error:
        raise PzcapError(f"{path}: cannot be read ({error.strerror}); {remedy}") from error
    except (ValueError, RecursionError) as error:
        raise PzcapError(f"{path}: is not valid JSON ({error}); correct it there") from error


def read_object(path: Path) -> CalibrationObject:
    """Read and check object.json."""
    root = load_json(path)
    root.only("dictionary", "markers", "wireframe_m")
    dictionary = root["dictionary"].text()
    if not dictionary.startswith("DICT_") or not hasattr(cv2.aruco, dictionary):
        raise root["dictionary"].error(f'OpenCV knows no ArUco dictionary "{dictionary}"; such as "DICT_4X4_50"')
    count = len(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary)).bytesList)
    entries = root["markers"].list()
    if len(entries) > count:
        raise root["markers"].error(f"{len(entries)} markers, where {dictionary} has {count}")
    markers = [_read_marker(entry, dictionary, count) for entry in entries]
    if not markers or len({marker.id for marker in markers}) < len(markers):
        raise root["markers"].error("list at least one marker, each with an id of its own")
    for one, other in itertools.combinations(markers, 2):
        apart = float(np.linalg.norm(one.corners_m.mean(axis=0) - other.corners_m.mean(axis=0)))
        if apart < 0.1 * float(np.linalg.norm(one.corners_m[0] - one.corners_m[1])):
            raise root["markers"].error(
                f"markers {one.id} and {other.id} are {1000 * apart:.0f} mm apart; correct the corners of one of them"
            )
    wireframe = root["wireframe_m"].place(-1, 2, 3) if root.value.get("wireframe_m") else np.zeros((0, 2, 3))
    return CalibrationObject(dictionary, tuple(markers), wireframe)


def _read_marker(entry: Json, dictionary: str, count: int) -> Marker:
    entry.only("id", "corners_m")
    number = entry["id"].value
    if isinstance(number, bool) or not isinstance(number, int) or not 0 <= number < count:
        raise entry["id"].error(f"must be a whole number from 0 to {count - 1}: {dictionary} has no others")
    corners = entry["corners_m"].place(4, 3)
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)
    smallest, largest = limits.MARKER_M
    if sides.max() > largest or sides.min() < smallest:
        wrong = sides.max() if sides.max() > largest else sides.min()
        raise entry["corners_m"].error(
            f"marker {number} has a side of {wrong:g} m; {smallest:g} to {largest:g} are plausible: give metres"
        )
    if sides.max() > _SQUARE * sides.min():
        raise entry["corners_m"].error(
            f"marker {number} has sides of {sides.min():.3f} to {sides.max():.3f} m, and is square; give its "
            "corners in turn, in metres"
        )
    return Marker(number, corners)


def read_subject(path: Path) -> Subject:
    """Read and check subject.json."""
    root = load_json(path)
    root.only("measurements_m", "sigma_m", "sigmas_m", "mass_kg", "sex", "loose_m")
    measurements = _read_lengths(root["measurements_m"])
    sigmas = _read_lengths(root["sigmas_m"]) if root.value.get("sigmas_m") is not None else {}
    for name in sigmas:
        if name not in measurements:
            raise root["sigmas_m"].error(f'"{name}" is not measured; remove it here, or add it to measurements_m')
    mass = None
    if root.value.get("mass_kg") is not None:
        mass, (lightest, heaviest) = float(root["mass_kg"].array()), limits.MASS_KG
        if not lightest <= mass <= heaviest:
            raise root["mass_kg"].error(f"{mass:g} kg, where {lightest:g} to {heaviest:g} are plausible")
    sex = root.value.get("sex")
    if not (sex is None or sex == "female" or sex == "male"):
        raise root["sex"].error('must be "female", "male" or null')
    for entry in (root["sigma_m"], *(root["sigmas_m"][name] for name in sigmas)):
        if entry.length() > limits.READING_M:
            raise entry.error(f"no tape errs by {entry.value:g} m; give metres, at most {limits.READING_M:g}")
    return Subject(measurements, root["sigma_m"].length(), sigmas, mass, sex, _read_garments(root))


def _read_garments(root: Json) -> dict[Garment, float]:
    if root.value.get("loose_m") is None:
        return {}
    entry = root["loose_m"]
    entry.only(*GARMENTS)
    return {name: entry[name].length() for name in GARMENTS if name in entry.value}


def _read_lengths(entry: Json) -> dict[str, float]:
    if not isinstance(entry.value, dict):
        raise entry.error("must be a JSON object of lengths in metres")
    for name in entry.value:
        if name not in MEASUREMENTS:
            near = difflib.get_close_matches(name, MEASUREMENTS, n=3, cutoff=0.4) or MEASUREMENTS
            raise entry.error(f'unknown measurement "{name}"; the nearest are {", ".join(near)}')
    return {name: entry[name].length() for name in MEASUREMENTS if name in entry.value}


def read_keyframes(path: Path, rate: Fraction) -> dict[str, tuple[Pose, Array | None]]:
    """Read and check keyframes.json: the poses by timecode "hh:mm:ss:ff", quaternions normalised, and the covariance
    (43, 43) of those that have one; of none, some or all frames.

    Drop-frame timecode is written with a colon or a semicolon: the recordings say how to count.
    """
    root = load_json(path)
    poses: dict[str, tuple[Pose, Array | None]] = {}
    for entry in root.list():
        entry.not_misspelt("covariance")  # other entries are the user's own, and kept
        try:
            colons = entry["timecode"].text().replace(";", ":")
            timecode = frames_to_timecode(timecode_to_frames(colons, rate), rate)
        except PzcapError as error:
            raise entry.error(str(error)) from error
        if timecode in poses:
            raise entry.error(f"a second keyframe at {timecode}; remove one")
        table = entry["rotations_wxyz"]
        for name in table.value if isinstance(table.value, dict) else ():
            if name not in SEGMENTS:
                raise table.error(f'unknown segment "{name}"; the segments are {", ".join(SEGMENTS)}')
        rotations = np.stack([table[segment].array(4) for segment in SEGMENTS])
        norms = np.linalg.norm(rotations, axis=1, keepdims=True)
        if abs(norms[worst := int(np.argmax(np.abs(norms - 1))), 0] - 1) > _UNIT_TOLERANCE:
            raise table[SEGMENTS[worst]].error(f"the quaternion's length is {norms[worst, 0]:.4g}; it must be 1")
        usual = np.median(np.abs(rotations[1:]), axis=0)
        if usual[0] < _BENT and usual[3] > _STRAIGHT:
            raise table.error("its quaternions are [x, y, z, w], it seems; write [w, x, y, z]")
        poses[timecode] = Pose(entry["root_position_m"].place(3), rotations / norms), _read_covariance(entry)
    return poses


def covariance_entry(covariance: Array) -> list[float]:
    """A covariance (43, 43) as keyframes.json has it: the lower triangle, row by row, to six digits."""
    return [float(f"{value:.6g}") for value in covariance[np.tril_indices(len(covariance))]]


def _read_covariance(entry: Json) -> Array | None:
    if entry.value.get("covariance") is None:
        return None
    rows, columns = np.tril_indices(DOF)
    covariance = np.zeros((DOF, DOF))
    covariance[rows, columns] = covariance[columns, rows] = entry["covariance"].array(len(rows))
    if np.linalg.eigvalsh(covariance)[0] <= 0.0:
        raise entry["covariance"].error("is not positive definite; leave it out, and the pose counts as a hand's")
    return covariance
