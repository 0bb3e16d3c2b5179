"""Save and load a `Reconstruction`: one npz of numbers, one json of names, a PNG a panorama. docs/reconstruction.md
specifies the folder, so that it can be read with numpy alone.

The layout follows the types: the number at ``reconstruction.cameras[0].lens.k1`` stands in the npz under
``camera1.camera.lens.k1``. Written twice, the same reconstruction gives the same bytes.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final, TypeVar, cast, get_args, get_type_hints

import cv2
import numpy as np
from numpy.typing import NDArray

from pzcap.io import limits
from pzcap.io.arrays import read_arrays
from pzcap.io.files import checked, leads_out, write_bytes, write_json, written_whole
from pzcap.io.picture_header import is_whole, picture_size
from pzcap.io.record_checks import check_array, check_record
from pzcap.io.text import is_plain, one_line
from pzcap.io.timecode import rate_of
from pzcap.types import (
    ENDS,
    JOINTS,
    SEGMENTS,
    Camera,
    InverseDepthMap,
    Lens,
    Motion,
    Panorama,
    PanZoomCamera,
    PanZoomTrack,
    PzcapError,
    Reconstruction,
    ReferenceCamera,
)

FORMAT: Final = "pzcap-reconstruction"
VERSION: Final = 2
READABLE: Final = (1, 2)  # versions that are read. The first has no ``motion.body``.
MANIFEST: Final = "reconstruction.json"
ARRAYS: Final = "reconstruction.npz"

PER_CAMERA: Final[dict[str, tuple[str, type]]] = {
    "references": ("reference", ReferenceCamera),
    "cameras": ("camera", PanZoomCamera),
    "panoramas": ("panorama", Panorama),
    "tracks": ("track", PanZoomTrack),
    "refined": ("refined", PanZoomTrack),
}
"""Field of Reconstruction -> (name in the npz, type)."""

ABSENT_IF_ZERO: Final = ("k2", "p1", "p2", "lateral_colour", "lean")
"""Fields that are stored where they are not zero: coefficients of distortion, and the floor's lean."""

_LEAST_BYTES: Final = 2**28  # bytes of a reconstruction's arrays that are read, however small the file: 256 MiB
_PACKED: Final = 100
"""More than these times a file's size are not in it: zeros pack a thousandfold, what was measured does not."""

T = TypeVar("T")


def save(reconstruction: Reconstruction, folder: Path) -> None:
    """Write ``reconstruction`` into ``folder`` (made where it is missing, replaced where it holds an older one).

    Every file appears whole or not at all, and the manifest last: a folder without it was never finished.
    Raises OSError where the disk refuses.
    """
    folder.mkdir(parents=True, exist_ok=True)
    (folder / MANIFEST).unlink(missing_ok=True)
    for older in folder.glob("panorama*.png"):
        older.unlink()
    arrays: dict[str, NDArray[Any]] = {}
    pictures: list[str | None] = []
    for number in range(1, len(reconstruction.camera_names) + 1):
        for field, (name, _) in PER_CAMERA.items():
            part = getattr(reconstruction, field)[number - 1]
            if part is not None:
                arrays |= _flatten(part, f"camera{number}.{name}")
        panorama = reconstruction.panoramas[number - 1]
        pictures.append(None if panorama is None else f"panorama{number}.png")
        if panorama is not None:
            alpha = np.where(panorama.valid, np.uint8(255), np.uint8(0))  # where something was pasted
            png = cv2.imencode(".png", np.dstack([panorama.image, alpha]))[1]
            write_bytes(folder / f"panorama{number}.png", bytes(png))
    if reconstruction.motion is not None:
        arrays |= _flatten(reconstruction.motion, "motion")

    manifest = {
        "format": FORMAT,
        "version": VERSION,
        "capture": reconstruction.capture_name,
        "method": reconstruction.method,
        "frame_rate": str(reconstruction.frame_rate),
        "cameras": [
            {"name": name, "panorama": picture}
            for name, picture in zip(reconstruction.camera_names, pictures, strict=True)
        ],
        "joints": list(JOINTS),
        "segments": list(SEGMENTS),
        "ends": list(ENDS),
        "notes": list(reconstruction.notes),
        "timecodes": list(reconstruction.timecodes),
    }

    with written_whole(folder / ARRAYS) as partial, partial.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)
    write_json(folder / MANIFEST, manifest)


def load(folder: Path) -> Reconstruction:
    """Read what `save` wrote. PzcapError, naming file and array, where the folder is not a whole reconstruction of a
    version known here, or is damaged."""
    manifest = _read_manifest(folder)
    arrays = _Arrays(folder / ARRAYS, len(manifest["timecodes"]))
    per_camera: dict[str, tuple[Any, ...]] = {}
    for field, (name, kind) in PER_CAMERA.items():
        parts: list[Any] = []
        for number, camera in enumerate(manifest["cameras"], start=1):
            images = {}
            if kind is Panorama and camera["panorama"] is not None:
                images = _decode_panorama(folder, camera["panorama"])
            parts.append(arrays.record(kind, f"camera{number}.{name}", images))
        per_camera[field] = tuple(parts)
    return Reconstruction(
        capture_name=manifest["capture"], method=manifest["method"], frame_rate=manifest["frame_rate"],
        timecodes=tuple(manifest["timecodes"]), camera_names=tuple(camera["name"] for camera in manifest["cameras"]),
        motion=arrays.record(Motion, "motion", {}), notes=tuple(manifest["notes"]), **per_camera,
    )  # fmt: skip


# --------------------------------------------------------------------------------------------------------------
# Dataclasses of numbers <-> named arrays


def _flatten(part: Any, prefix: str) -> dict[str, NDArray[Any]]:
    arrays: dict[str, NDArray[Any]] = {}
    for field in dataclasses.fields(part):
        value, key = getattr(part, field.name), f"{prefix}.{field.name}"
        if value is None:
            continue
        if isinstance(part, Camera | Lens | InverseDepthMap) and field.name in ABSENT_IF_ZERO and not np.any(value):
            continue
        if dataclasses.is_dataclass(value):
            arrays |= _flatten(value, key)
        elif not (isinstance(part, Panorama) and field.name in ("image", "valid")):  # these two stand in the PNG
            arrays[key] = np.asarray(value)
    return arrays


class _Arrays:
    """The numbers of a reconstruction, read and checked record by record: the inverse of `_flatten`."""

    def __init__(self, path: Path, frames: int) -> None:
        self._path, self._frames = path, frames
        self._arrays = _read_arrays(path)

    def record(self, kind: type[T], prefix: str, images: Mapping[str, NDArray[Any]]) -> T | None:
        """The ``kind`` that stands under ``prefix``, with its ``images``; None where nothing does."""
        if not any(key.startswith(prefix + ".") for key in self._arrays):
            return None
        values: dict[str, Any] = dict(images)
        own: dict[str, NDArray[Any]] = {}
        hints = get_type_hints(kind)
        for field in dataclasses.fields(cast(Any, kind)):  # not all that is annotated is a field
            name = field.name
            key, hint = f"{prefix}.{name}", hints[name]
            has_default = not (field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING)
            if name in images:
                continue
            inner = _record_type(hint)
            if inner is not None:
                values[name] = self.record(inner, key, {})
            elif key in self._arrays:
                own[name] = self._arrays[key]
                check_array(kind, name, own[name], f"{self._path}: {key}")
                values[name] = hint(own[name]) if hint in (int, float, bool) else own[name]
            if values.get(name) is None:
                values.pop(name, None)
                if not has_default:
                    raise PzcapError(f"{self._path}: {key} is missing; save the reconstruction again")
        record = kind(**values)
        check_record(record, own, f"{self._path}: {prefix}", self._frames)
        return record


def _record_type(hint: Any) -> type[Any] | None:
    """The dataclass that a field holds, be it optional; None where it holds none."""
    kinds = (hint, *get_args(hint))
    return next((kind for kind in kinds if isinstance(kind, type) and dataclasses.is_dataclass(kind)), None)


# --------------------------------------------------------------------------------------------------------------
# Files


def _decode_panorama(folder: Path, name: str) -> dict[str, NDArray[Any]]:
    if leads_out(name):
        raise PzcapError(f"{folder / MANIFEST}: {name} leads out of the folder; save the reconstruction again")
    path = folder / name
    try:
        data = checked(path).read_bytes()  # OpenCV itself does not survive a name that is not UTF-8
        size = picture_size(data)
        if size is not None and size[0] * size[1] > limits.PANORAMA_PX:
            most = f"{limits.PANORAMA_PX / 1e6:.0f} million"
            raise PzcapError(f"{path}: {size[0]} x {size[1]} pixels, where {most} are the most")
        whole = size is not None and is_whole(data)
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if whole else None
    except (OSError, cv2.error):  # not there, or of a size that cannot be
        image = None
    if image is None or image.ndim != 3 or image.shape[2] != 4 or image.dtype != np.uint8:
        raise PzcapError(f"{path}: no readable PNG with an alpha channel; save the reconstruction again")
    return {"image": np.ascontiguousarray(image[:, :, :3]), "valid": image[:, :, 3] > 0}


def _read_manifest(folder: Path) -> dict[str, Any]:
    path = folder / MANIFEST
    if not checked(path).is_file():
        raise PzcapError(f"{folder}: no {MANIFEST}; not a reconstruction, or one that was never finished")
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise PzcapError(f"{path}: not valid JSON ({one_line(str(error))}); save the reconstruction again") from error
    if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
        raise PzcapError(f'{path}: its "format" is not "{FORMAT}"')
    version = manifest.get("version")
    if version not in READABLE:
        cure = "install a newer pzcap" if isinstance(version, int) and version > VERSION else "reconstruct it again"
        raise PzcapError(f"{path}: version {version}; this pzcap reads versions 1 and {VERSION}; {cure}")
    for fault in _manifest_faults(manifest):
        raise PzcapError(f"{path}: {fault}; see docs/reconstruction.md")
    return {**manifest, "frame_rate": rate_of(manifest["frame_rate"])}


def _manifest_faults(manifest: dict[str, Any]) -> Iterator[str]:
    """Entries of a manifest that are missing or malformed."""
    for key in ("capture", "method", "frame_rate"):
        if not isinstance(manifest.get(key), str):
            yield f'"{key}" is missing or no text'
        elif not is_plain(manifest[key]):
            yield f'"{key}" holds control characters'
    try:
        if rate_of(manifest["frame_rate"]) is None:
            yield '"frame_rate" is no fraction such as "30/1"'
    except PzcapError as error:
        yield f'"frame_rate" {error}'
    for key in ("timecodes", "notes"):
        texts = manifest.get(key)
        if not isinstance(texts, list) or not all(isinstance(text, str) for text in texts):
            yield f'"{key}" is missing or no list of texts'
        elif not all(map(is_plain, texts)):
            yield f'"{key}" holds control characters'
    for key, names in (("joints", JOINTS), ("segments", SEGMENTS), ("ends", ENDS)):
        if key in manifest and manifest[key] != list(names):
            yield f'"{key}" is not the list that this pzcap knows'
    cameras = manifest.get("cameras")
    if not isinstance(cameras, list) or not cameras:
        yield '"cameras" is missing or no list of cameras'
        return
    for number, camera in enumerate(cameras, start=1):
        picture = camera.get("panorama", 0) if isinstance(camera, dict) else 0
        if not isinstance(picture, str | None) or not isinstance(camera.get("name"), str):
            yield f'"cameras": entry {number} is no "name" and "panorama"'
        elif not is_plain(camera["name"]):
            yield f'"cameras": the name of entry {number} holds control characters'


def _read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    try:
        return read_arrays(path, _LEAST_BYTES + _PACKED * checked(path).stat().st_size)
    except FileNotFoundError as error:
        raise PzcapError(f"{path} is missing; save the reconstruction again") from error
    except (OSError, ValueError) as error:
        raise PzcapError(
            f"{path}: truncated or no npz ({one_line(str(error))}); save the reconstruction again"
        ) from error
