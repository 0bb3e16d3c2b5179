"""Save and load a `Reconstruction`: one npz of numbers, one json of names, a PNG a panorama. docs/reconstruction.md
specifies the folder, so that it can be read with numpy alone.

The layout follows the types: the number at ``reconstruction.cameras[0].lens.k1`` stands in the npz under
``camera1.camera.lens.k1``. Written twice, the same reconstruction gives the same bytes.
"""

from __future__ import annotations

import dataclasses
import json
import zipfile
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any, Final, TypeVar, cast, get_type_hints

import cv2
import numpy as np
from numpy.typing import NDArray

from pzcap.io.files import checked, leads_out, written_whole
from pzcap.types import (
    JOINTS,
    SEGMENTS,
    Camera,
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
VERSION: Final = 1
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

HIGHER: Final = ("k2", "p1", "p2")
"""Coefficients of distortion that are stored where they are not zero."""

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
            with written_whole(folder / f"panorama{number}.png") as partial:
                alpha = np.where(panorama.valid, np.uint8(255), np.uint8(0))  # where something was pasted
                partial.write_bytes(bytes(cv2.imencode(".png", np.dstack([panorama.image, alpha]))[1]))
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
        "notes": list(reconstruction.notes),
        "timecodes": list(reconstruction.timecodes),
    }

    with written_whole(folder / ARRAYS) as partial, partial.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)
    with written_whole(folder / MANIFEST) as partial:
        partial.write_bytes((json.dumps(manifest, indent=1, ensure_ascii=False) + "\n").encode())


def load(folder: Path) -> Reconstruction:
    """Read what `save` wrote. PzcapError where the folder is not a whole reconstruction of a version known here."""
    manifest = _read_manifest(folder)
    arrays = _read_arrays(folder / ARRAYS)
    try:
        cameras = manifest["cameras"]
        timecodes = tuple(manifest["timecodes"])
        per_camera: dict[str, tuple[Any, ...]] = {}
        for field, (name, kind) in PER_CAMERA.items():
            parts: list[Any] = []
            for number, camera in enumerate(cameras, start=1):
                images = {}
                if kind is Panorama and camera["panorama"] is not None:
                    images = _decode_panorama(folder, camera["panorama"])
                parts.append(_unflatten(kind, f"camera{number}.{name}", arrays, images))
            per_camera[field] = tuple(parts)
        motion = _unflatten(Motion, "motion", arrays, {})
        frames = {len(track.valid) for track in per_camera["tracks"] if track is not None}
        frames |= set() if motion is None else {len(motion.valid)}
        if frames - {len(timecodes)}:
            raise PzcapError(
                f"{folder}: tracks of {sorted(frames)} frames beside {len(timecodes)} timecodes; "
                "the files are of different reconstructions, save it again"
            )
        return Reconstruction(
            capture_name=manifest["capture"],
            method=manifest["method"],
            frame_rate=Fraction(manifest["frame_rate"]),
            timecodes=timecodes,
            camera_names=tuple(camera["name"] for camera in cameras),
            motion=motion,
            notes=tuple(manifest["notes"]),
            **per_camera,
        )
    except (KeyError, TypeError, ValueError) as error:
        raise PzcapError(f"{folder}: {error} is missing or malformed; see docs/reconstruction.md") from error


# --------------------------------------------------------------------------------------------------------------
# Dataclasses of numbers <-> named arrays


def _flatten(part: Any, prefix: str) -> dict[str, NDArray[Any]]:
    arrays: dict[str, NDArray[Any]] = {}
    for field in dataclasses.fields(part):
        value, key = getattr(part, field.name), f"{prefix}.{field.name}"
        if isinstance(part, Camera | Lens) and field.name in HIGHER and not np.any(value):
            continue
        if dataclasses.is_dataclass(value):
            arrays |= _flatten(value, key)
        elif not (isinstance(part, Panorama) and field.name in ("image", "valid")):  # these two stand in the PNG
            arrays[key] = np.asarray(value)
    return arrays


def _unflatten(
    kind: type[T], prefix: str, arrays: Mapping[str, NDArray[Any]], images: Mapping[str, NDArray[Any]]
) -> T | None:
    """The inverse of `_flatten`; None where nothing stands under ``prefix``."""
    if not any(key.startswith(prefix + ".") for key in arrays):
        return None
    values: dict[str, Any] = dict(images)
    hints = get_type_hints(kind)
    for field in dataclasses.fields(cast(Any, kind)):  # not all that is annotated is a field
        name = field.name
        key, hint = f"{prefix}.{name}", hints[name]
        missing = key not in arrays and not dataclasses.is_dataclass(hint)
        has_default = not (field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING)
        if name in images or (missing and has_default):
            continue  # not known when this was saved, or zero
        if dataclasses.is_dataclass(hint):
            values[name] = _unflatten(cast(type[Any], hint), key, arrays, {})
        elif hint in (int, float, bool):
            values[name] = hint(arrays[key])
        else:
            values[name] = arrays[key]
    return kind(**values)


# --------------------------------------------------------------------------------------------------------------
# Files


def _decode_panorama(folder: Path, name: str) -> dict[str, NDArray[Any]]:
    if leads_out(name):
        raise PzcapError(f"{folder / MANIFEST}: {name} leads out of the folder; save the reconstruction again")
    path = folder / name
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED) if checked(path).is_file() else None
    if image is None or image.ndim != 3 or image.shape[2] != 4:
        raise PzcapError(f"{path}: no readable PNG with an alpha channel; save the reconstruction again")
    return {"image": np.ascontiguousarray(image[:, :, :3]), "valid": image[:, :, 3] > 0}


def _read_manifest(folder: Path) -> dict[str, Any]:
    path = folder / MANIFEST
    if not checked(path).is_file():
        raise PzcapError(f"{folder}: no {MANIFEST}; not a reconstruction, or one that was never finished")
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise PzcapError(f"{path}: not valid JSON ({error}); save the reconstruction again") from error
    if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
        raise PzcapError(f'{path}: its "format" is not "{FORMAT}"')
    if manifest.get("version") != VERSION:
        raise PzcapError(f"{path}: version {manifest.get('version')}; this pzcap reads version {VERSION}")
    return manifest


def _read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    try:
        with np.load(checked(path), allow_pickle=False) as file:
            return {key: file[key] for key in file.files}
    except FileNotFoundError as error:
        raise PzcapError(f"{path} is missing; save the reconstruction again") from error
    except (ValueError, EOFError, zipfile.BadZipFile) as error:
        raise PzcapError(f"{path}: truncated or no npz ({error}); save the reconstruction again") from error
