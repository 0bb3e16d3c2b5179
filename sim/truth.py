"""The truth about a capture: its record, its files, and true cameras, lenses and poses from it.

Reading it needs numpy alone, no simulator. `sim.collect_truth` makes the record.
"""

from __future__ import annotations

import json
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass, fields
from fractions import Fraction
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pzcap.io import limits
from pzcap.io.arrays import announced, read_arrays
from pzcap.io.files import checked
from pzcap.io.timecode import rate_of
from pzcap.types import Array, Camera, Lens, Mask, Pose, PzcapError

ARRAYS: Final = ("truth.npz", "masks.npz")
_MASKS: Final = ("mask_bits", "shadow_bits")
_MOST: Final = 100_000
"""Frames of a sweep, points of a hall: what no other file says the number of."""
_REMEDY: Final = "remove the truth to go on without a score"
_SHAPES: Final = {
    "pan_rad": "C F", "tilt_rad": "C F", "roll_rad": "C F", "focal_px": "C F", "principal_px": "C F 2", "k1": "C F",
    "world_T_cam": "C F 4 4", "recorded": "C F", "reference_focal_px": "C", "reference_principal_px": "C 2",
    "reference_k1": "C", "reference_world_T_cam": "C 4 4", "sweep_pan_rad": "C M", "sweep_world_T_cam": "C M 4 4",
    "zoom_focal_px": "C Z", "zoom_pan_rad": "C", "scene_points_m": "C P 3", "root_position_m": "F 3",
    "rotations": "F 16 4", "joints_m": "F 16 3", "contact": "F 4", "airborne": "F", "mask_bits": "C F B",
    "shadow_frames": "S", "shadow_bits": "C S B", "sweep_focal_px": "C M", "clock_offset_s": "C", "clock_drift": "C",
    "readout_s": "C", "field_s": "C", "k2": "C", "p1": "C", "gain": "C F 3",
}  # fmt: skip
"""Shapes of the arrays: C cameras, F frames, B bytes of a mask; M, Z, P and S are as many as there are."""


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """F frames (the frame sets of the capture, in order), C cameras, at mid-exposure. Conventions: `pzcap.types`.

    A frame set has a common time, frame over frame rate, of which the athlete is. A camera exposes its middle row at
    its own time, which is the common one plus ``clock_offset_s + clock_drift * common time``, and of which all else is:
    where it points, and what it sees. Row v is exposed ``((v + 0.5) / height - 0.5) * readout_s`` after the middle row,
    and if v is odd ``field_s`` after that.
    """

    config: str  # JSON of the ShootConfig
    frame_rate: Fraction
    camera_names: tuple[str, ...]  # (C,)
    timecodes: tuple[str, ...]  # (F,)
    width: int
    height: int

    # cameras while the motion is recorded
    pan_rad: Array  # (C, F)
    tilt_rad: Array  # (C, F)
    roll_rad: Array  # (C, F)
    focal_px: Array  # (C, F)
    principal_px: Array  # (C, F, 2)
    k1: Array  # (C, F)
    k2: Array  # (C,) at all focal lengths
    p1: Array  # (C,) at all focal lengths
    world_T_cam: Array  # (C, F, 4, 4)
    recorded: Mask  # (C, F) False where the frame was dropped
    clock_offset_s: Array  # (C,)
    clock_drift: Array  # (C,) seconds a second
    readout_s: Array  # (C,) negative: from the bottom
    field_s: Array  # (C,) from the field of the even rows to that of the odd ones; 0: frames are whole
    gain: Array  # (C, F, 3) of the light in blue, green and red, the mean of all rows
    # at the reference pose
    reference_focal_px: Array  # (C,)
    reference_principal_px: Array  # (C, 2)
    reference_k1: Array  # (C,)
    reference_world_T_cam: Array  # (C, 4, 4)
    # during the sweep and the zoom run
    sweep_pan_rad: Array  # (C, M)
    sweep_focal_px: Array  # (C, M)
    sweep_world_T_cam: Array  # (C, M, 4, 4)
    zoom_focal_px: Array  # (C, Z)
    zoom_pan_rad: Array  # (C,)
    # the static scene: points of the hall that each camera sees as it turns
    scene_points_m: Array  # (C, P, 3)

    # the athlete
    measurements_m: dict[str, float]
    root_position_m: Array  # (F, 3)
    rotations: Array  # (F, 16, 4) as in pzcap.types.Pose
    joints_m: Array  # (F, 16, 3) pzcap.types.JOINTS
    contact: Mask  # (F, 4) left hand, right hand, left foot, right foot on the floor
    airborne: Mask  # (F,)

    # images of the athlete, a bit a pixel; see `mask` and `shadow`
    mask_bits: NDArray[np.uint8]  # (C, F, H * W / 8)
    shadow_frames: NDArray[np.int64]  # (S,) the frames whose shadows are known
    shadow_bits: NDArray[np.uint8]  # (C, S, H * W / 8)

    @property
    def inverted(self) -> Mask:
        """(F,) the head is below the pelvis."""
        return np.asarray(self.joints_m[:, 3, 2] < self.joints_m[:, 0, 2])

    def camera(self, camera: int, frame: int) -> Camera:
        """The camera at the mid-exposure of a frame's middle row."""
        at = camera, frame
        return self._camera(camera, self.world_T_cam[at], self.focal_px[at], self.principal_px[at], self.k1[at])

    def reference_camera(self, camera: int) -> Camera:
        """The camera as it took the image of the calibration object."""
        return self._camera(
            camera, self.reference_world_T_cam[camera], self.reference_focal_px[camera],
            self.reference_principal_px[camera], self.reference_k1[camera],
        )  # fmt: skip

    def lens(self, camera: int) -> Lens:
        """The camera's intrinsics as functions of the focal length.

        Principal point and k1 are straight lines in log focal, fitted by least squares to the reference image and all
        frames. The simulator's lens is such a line (`sim.cameras.optics`): the fit is exact.
        """
        reference = float(self.reference_focal_px[camera])
        focal = np.concatenate([[reference], self.focal_px[camera]])
        principal = np.vstack([self.reference_principal_px[camera], self.principal_px[camera]])
        k1 = np.concatenate([[self.reference_k1[camera]], self.k1[camera]])
        system = np.log(focal / reference)[:, None] ** np.arange(2)
        lines = np.linalg.lstsq(system, np.column_stack([principal, k1]), rcond=None)[0]
        others = self.k2[[camera]], self.p1[[camera]]
        return Lens(self.width, self.height, reference, lines[:, :2], lines[:, 2], *others)

    def pose(self, frame: int) -> Pose:
        """The athlete's pose at the common time of a frame set."""
        return Pose(self.root_position_m[frame], self.rotations[frame])

    def mask(self, camera: int, frame: int) -> Mask:
        """(H, W) the pixels that show the athlete."""
        return self._unpack(self.mask_bits[camera, frame])

    def shadow(self, camera: int, frame: int) -> Mask | None:
        """(H, W) the pixels darkened by the athlete's shadow, off the athlete; None where it is not known."""
        at = np.flatnonzero(self.shadow_frames == frame)
        return self._unpack(self.shadow_bits[camera, at[0]]) if len(at) else None

    def _camera(self, camera: int, world_T_cam: Array, focal_px: float, principal_px: Array, k1: float) -> Camera:
        return Camera(
            self.width, self.height, world_T_cam, float(focal_px), principal_px,
            float(k1), float(self.k2[camera]), float(self.p1[camera]),
        )  # fmt: skip

    def _unpack(self, bits: NDArray[np.uint8]) -> Mask:
        return np.unpackbits(bits, count=self.height * self.width).reshape(self.height, self.width).astype(bool)


def save(truth: Truth, folder: Path) -> None:
    """Write ``truth.json`` (text and scalars), ``truth.npz`` (arrays) and ``masks.npz`` into ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    values = {field.name: getattr(truth, field.name) for field in fields(truth)}
    arrays = {name: value for name, value in values.items() if isinstance(value, np.ndarray)}
    plain = {name: value for name, value in values.items() if name not in arrays}
    plain["frame_rate"] = str(truth.frame_rate)
    (folder / "truth.json").write_text(json.dumps(plain, indent=1) + "\n", encoding="utf-8")
    masks: dict[str, Any] = {name: arrays.pop(name) for name in _MASKS}
    numbers: dict[str, Any] = arrays
    np.savez(folder / "truth.npz", **numbers)
    np.savez_compressed(folder / "masks.npz", **masks)


def load(folder: Path) -> Truth:
    """Read what `save` wrote. Raises PzcapError, with the file, if it is damaged or one part does not fit another."""
    values = _read(folder / "truth.json", _plain)
    _check_headers(values, folder)
    for name in ARRAYS:
        values |= _read(folder / name, read_arrays)
    try:
        truth = Truth(**values)
    except TypeError as error:
        raise PzcapError(f"{folder}: not a truth of this version ({error}); shoot the capture again") from error
    for name in _SHAPES:
        if not np.all(np.isfinite(getattr(truth, name))):
            raise PzcapError(f"{folder}: {name} holds what is no number; {_REMEDY}")
    return truth


def _read(path: Path, read: Callable[[Path], dict[str, Any]]) -> dict[str, Any]:
    try:
        return read(checked(path))
    except (OSError, ValueError, KeyError, TypeError, AttributeError, EOFError, RecursionError, OverflowError,
            ZeroDivisionError, zipfile.BadZipFile, zlib.error, NotImplementedError) as error:  # fmt: skip
        raise PzcapError(f"{path}: damaged ({error}); {_REMEDY}") from error


def _plain(path: Path) -> dict[str, Any]:
    if path.stat().st_size > limits.PAPER_BYTES:
        raise ValueError(f"{path.stat().st_size / 2**20:.0f} MiB")
    values: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    try:
        values["frame_rate"] = rate_of(str(values["frame_rate"]))
    except PzcapError as error:
        raise ValueError(f"its frame_rate {error}") from error
    if values["frame_rate"] is None:
        raise ValueError("its frame_rate is no fraction")
    values["camera_names"], values["timecodes"] = tuple(values["camera_names"]), tuple(values["timecodes"])
    values["width"], values["height"] = int(values["width"]), int(values["height"])
    if problem := limits.picture_problem(values["width"], values["height"]):
        raise ValueError(problem)
    json.loads(values["config"])
    return values


def _check_headers(plain: dict[str, Any], folder: Path) -> None:
    """Raise PzcapError unless the headers of all arrays fit the rest, and each other; no array is read for that."""
    found: dict[str, Any] = {}
    for name in ARRAYS:
        found |= _read(folder / name, announced)
    if missing := sorted(set(_SHAPES) - set(found)):
        raise PzcapError(f"{folder}: not a truth of this version ({missing[0]} is missing); shoot the capture again")
    sizes = {"C": len(plain["camera_names"]), "F": len(plain["timecodes"])}
    sizes["B"] = -(-plain["width"] * plain["height"] // 8)
    for name, letters in _SHAPES.items():
        shape, dtype = found[name]
        if len(shape) != len(letters.split()):
            raise PzcapError(f"{folder}: {name} has the shape {shape}, not {letters.replace(' ', ' x ')}; {_REMEDY}")
        wanted = tuple(
            int(letter) if letter.isdigit() else sizes.setdefault(letter, min(length, _MOST))
            for letter, length in zip(letters.split(), shape, strict=True)
        )
        if shape != wanted:
            raise PzcapError(f"{folder}: {name} has the shape {shape}, not {wanted}; {_REMEDY}")
        if dtype.kind not in "fiub":
            raise PzcapError(f"{folder}: {name} holds what is no number; {_REMEDY}")
