"""Arrays of an npz file: what its headers announce is known, and can be refused, before memory is taken for it."""

from __future__ import annotations

import math
import zipfile
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from pzcap.io import limits

_ENDING: Final = ".npy"
_HEADERS: Final = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}


class Announced(NamedTuple):
    """Shape and type of an array by its header."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]


def announced(path: Path) -> dict[str, Announced]:
    """Shape and type of each array in an npz file, by its name; nothing but headers is read.

    Raises ValueError where an array holds objects or does not fit its place in the file, and where all together are
    larger than `limits.ARRAYS_BYTES`; OSError and zipfile.BadZipFile where it is no such file.
    """
    found: dict[str, Announced] = {}
    total = 0
    with zipfile.ZipFile(path) as archive:
        for member in archive.infolist():
            if not member.filename.endswith(_ENDING):
                raise ValueError(f"{member.filename} is no array")
            with archive.open(member) as file:
                version = npy.read_magic(file)
                if version not in _HEADERS:
                    raise ValueError(f"{member.filename} is of a version not known here")
                shape, _, dtype = _HEADERS[version](file)
                size = math.prod(shape) * dtype.itemsize
                if dtype.hasobject or min(shape, default=0) < 0 or file.tell() + size != member.file_size:
                    raise ValueError(f"{member.filename} says {shape}, which is not what follows")
            total += size
            found[member.filename.removesuffix(_ENDING)] = Announced(shape, dtype)
    if total > limits.ARRAYS_BYTES:
        raise ValueError(f"it holds {total / 2**30:.0f} GiB, where {limits.ARRAYS_BYTES / 2**30:.0f} GiB are the most")
    return found


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """All arrays of an npz file, by name. Raises ValueError as `announced` does, and where the data are damaged."""
    with np.load(path, allow_pickle=False) as arrays:
        return {key: arrays[key] for key in arrays}
