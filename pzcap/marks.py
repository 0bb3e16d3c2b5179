"""Places that somebody has pointed out in pictures, and lengths between them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class Mark:
    """A place in the hall that somebody has pointed out in a picture."""

    camera: str
    video: Literal["sweep", "zoom", "motion"]
    frame: int  # of that camera's own video, counted from 0
    px: NDArray[np.float64]  # (2,)


@dataclass(frozen=True, slots=True, eq=False)
class KnownLength:
    """A distance in the hall that was measured: a side of the carpet, a stick held up. An end that one picture alone
    shows lies on the floor."""

    name: str
    length_m: float
    sigma_m: float
    ends: tuple[tuple[Mark, ...], tuple[Mark, ...]]
