"""Shapes and values of a saved reconstruction's arrays, as docs/reconstruction.md has them: what does not fit is told
in one line that names the file and the array."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pzcap.types import (
    ENDS,
    PARENTS,
    Array,
    Camera,
    InverseDepthMap,
    Lens,
    Motion,
    MovedBody,
    Panorama,
    PanZoomCamera,
    PanZoomTrack,
    PzcapError,
    ReferenceCamera,
)

_S: Final = len(PARENTS)

SHAPES: Final[dict[type, dict[str, tuple[int | str, ...]]]] = {
    Camera: {"world_T_cam": (4, 4), "principal_px": (2,)},
    Lens: {
        "principal_px": ("P", 2), "k1": ("Q",), "k2": ("Q2",), "p1": ("Q3",), "p2": ("Q4",), "lateral_colour": (3,),
    },
    PanZoomCamera: {
        "world_T_head": (4, 4), "offset_m": (2,), "shared_covariance": ("P", "Z", 2, 2), "shared_zooms": ("Z",),
    },
    ReferenceCamera: {"points_m": ("N", 3), "points_px": ("N", 2), "residuals_px": ("N", 2)},
    InverseDepthMap: {"walls": ("A",), "departures": ("R", "A"), "slopes": (2,), "lean": (2,)},
    Panorama: {"origin_px": (2,), "sweep_pan_rad": ("M",), "sweep_inliers": ("M",), "fine": ("H", "W")},
    PanZoomTrack: {
        "pan_rad": ("F",), "tilt_rad": ("F",), "roll_rad": ("F",), "focal_px": ("F",), "covariance": ("F", 2, 2),
        "inliers": ("F",), "valid": ("F",), "shear": ("S", 2), "readout": ("S",),
    },
    Motion: {
        "root_position_m": ("F", 3), "rotations": ("F", _S, 4), "joints_m": ("F", _S, 3), "sigma_m": ("F", _S),
        "keyframes": ("K",), "valid": ("F",),
    },
    MovedBody: {
        "offsets_m": (_S, 3), "ends_m": (len(ENDS), 3), "skin_m": ("V", 3), "skin_segment": ("V",),
        "skin_faces": ("T", 3),
    },
}  # fmt: skip
"""Of every array of a record; a letter stands for any length, the same wherever it occurs in the record. Fields that
are not here are single numbers, records, or stand in a PNG."""

_WHOLE: Final = {"inliers", "sweep_inliers", "keyframes", "skin_segment", "skin_faces", "fine", "width", "height"}
_FLAGS: Final = {"valid", "full_turn"}
_POSITIVE: Final = {"width", "height", "focal_px", "reference_focal_px", "px_per_rad"}
_UNIT_TOLERANCE: Final = 1e-6


def check_array(kind: type, name: str, value: NDArray[Any], where: str) -> None:
    """Raise PzcapError, beginning with ``where``, unless ``value`` is what field ``name`` of a ``kind`` may be."""
    shape = SHAPES.get(kind, {}).get(name, ())
    fits = value.ndim == len(shape) and all(
        isinstance(wanted, str) or wanted == found for wanted, found in zip(shape, value.shape, strict=True)
    )
    if not fits:
        raise PzcapError(f"{where} has the shape {value.shape}, not {_written(shape)}; save the reconstruction again")
    expected = "b" if name in _FLAGS else "iu" if name in _WHOLE else "iuf"
    if value.dtype.kind not in expected:
        raise PzcapError(f"{where} holds {value.dtype}, which it cannot; save the reconstruction again")
    if value.dtype.kind == "f" and not np.isfinite(value).all():
        raise PzcapError(f"{where} holds what is no number; save the reconstruction again")


def check_record(record: Any, arrays: dict[str, NDArray[Any]], where: str, frames: int) -> None:
    """Raise PzcapError unless the ``arrays`` of a ``record``, each of which is right by itself, are so together."""
    lengths: dict[str, tuple[int, str]] = {"F": (frames, "the timecodes")}
    for name, shape in SHAPES.get(type(record), {}).items():
        for wanted, found in zip(shape, arrays[name].shape if name in arrays else (), strict=False):
            if isinstance(wanted, str):
                known, whose = lengths.setdefault(wanted, (found, name))
                if known != found:
                    raise PzcapError(
                        f"{where}.{name} has {found} rows beside {known} of {whose}; save the reconstruction again"
                    )
    for fault in _faults(record):
        raise PzcapError(f"{where}.{fault}; save the reconstruction again")


def _faults(record: Any) -> Iterator[str]:
    """Values of a record that cannot be, each as a fault."""
    for name in _POSITIVE.intersection(getattr(type(record), "__slots__", ())):
        value = np.asarray(getattr(record, name))
        if isinstance(record, PanZoomTrack):
            value = value[record.valid]
        if (value <= 0).any():
            yield f"{name} is {value.min()}; it must be above 0"
    match record:
        case Camera():
            yield from _transform_faults("world_T_cam", record.world_T_cam)
        case PanZoomCamera():
            yield from _transform_faults("world_T_head", record.world_T_head)
        case Lens() if not (len(record.principal_px) and len(record.k1)):
            yield "principal_px or k1 holds no coefficient"
        case Motion():
            lengths = np.linalg.norm(record.rotations[record.valid], axis=-1)
            if (np.abs(lengths - 1.0) > _UNIT_TOLERANCE).any():
                yield "rotations holds a quaternion whose length is not 1"
            if (record.sigma_m < 0).any():
                yield "sigma_m holds what is below 0"
            if ((record.keyframes < 0) | (record.keyframes >= len(record.valid))).any():
                yield "keyframes names a frame that is not there"
        case MovedBody():
            if ((record.skin_segment < 0) | (record.skin_segment >= _S)).any():
                yield f"skin_segment names a segment that is not there; there are {_S}"
            if ((record.skin_faces < 0) | (record.skin_faces >= len(record.skin_m))).any():
                yield "skin_faces names a vertex that is not there"


def _transform_faults(name: str, transform: Array) -> Iterator[str]:
    rotation = transform[:3, :3]
    rigid = np.allclose(rotation @ rotation.T, np.eye(3), atol=_UNIT_TOLERANCE) and np.linalg.det(rotation) > 0
    if not rigid or not np.allclose(transform[3], (0.0, 0.0, 0.0, 1.0), atol=1e-12):
        yield f"{name} is no rotation and translation"


def _written(shape: tuple[int | str, ...]) -> str:
    return f"({', '.join(map(str, shape))}{',' if len(shape) == 1 else ''})"
