"""Arrays of an npz file: what its headers announce is known, and can be refused, before memory is taken for it."""

from __future__ import annotations

import math
import tokenize
import zipfile
import zlib
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


def announced(path: Path, most_bytes: int = limits.ARRAYS_BYTES) -> dict[str, Announced]:
    """Shape and type of each array in an npz file, by its name; nothing but headers is read.

    Raises ValueError where an array holds objects or does not fit its place in the file, and where all together are
    larger than ``most_bytes``; OSError and zipfile.BadZipFile where it is no such file.
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
                try:
                    shape, _, dtype = _HEADERS[version](file)
                except (
                    tokenize.TokenError,
                    SyntaxError,
                    TypeError,
                    RecursionError,
                ) as error:  # NumPy raises those, too
                    raise ValueError(f"{member.filename} has a header that is none") from error
                size = math.prod(shape) * dtype.itemsize
                if dtype.hasobject or min(shape, default=0) < 0 or file.tell() + size != member.file_size:
                    raise ValueError(f"{member.filename} says {shape}, which is not what follows")
            total += size
            found[member.filename.removesuffix(_ENDING)] = Announced(shape, dtype)
    if total > most_bytes:
        raise ValueError(f"it holds {total / 2**30:.2g} GiB, where {most_bytes / 2**30:.2g} GiB are the most")
    return found


def read_arrays(path: Path, most_bytes: int = limits.ARRAYS_BYTES) -> dict[str, NDArray[Any]]:
    """All arrays of an npz file, by name. Raises ValueError as `announced` does, and where the data are damaged;
    OSError where the file cannot be read."""
    try:
        announced(path, most_bytes)
        with np.load(path, allow_pickle=False) as arrays:
            return {key: arrays[key] for key in arrays}
    except (EOFError, KeyError, TypeError, OverflowError, RuntimeError, zipfile.BadZipFile, zlib.error) as error:
        raise ValueError(str(error)) from error
