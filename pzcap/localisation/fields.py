"""Fields of interlaced video: where a camera was by both of a frame's fields.

The first field is of the frame's time, the second of half a frame period later. Codecs take the comb between them for
noise where they differ by a fraction of a pixel, and blend both: each then shows a place between the two. Their mean
stays what it was. The cubic p whose values at the fields of four frames have the same means,

    (p(j) + p(j + 1/2)) / 2 = m_j,        j = -2 ... 1,

has the place at the frame's own time, p(0). Where the lens zooms, the middle of a picture moves by such fractions and
its sides do not: the first field by itself shows the middle too late, and so too large. In a zoom run, whose times do
not matter, the mean of both fields takes the place of a frame.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from pzcap.geometry.camera import wrapped
from pzcap.io.video import VideoReader
from pzcap.localisation.readout import History, rate_between
from pzcap.types import Array, Image, Localisation


@dataclass(frozen=True, slots=True, eq=False)
class BothFields:
    """The frames of a ``video``, of interlaced ones the mean of both fields: what stands between them."""

    video: VideoReader

    def __iter__(self) -> Iterator[tuple[int, Image]]:
        for number, first, second in self.video.read_fields():
            yield number, first if second is None else np.asarray(cv2.addWeighted(first, 0.5, second, 0.5, 0.0))


def expected_second(history: History, found: Localisation) -> Localisation:
    """Place at which the second field of a frame ``found`` is expected, by how the camera turned to get there; of its
    sway is believed what was of the frame's."""
    rate = np.zeros(2) if history.last is None else rate_between(history.last, found)
    return replace(
        found, pan_rad=float(wrapped(found.pan_rad + 0.5 * rate[0])),
        focal_px=found.focal_px * float(np.exp(0.5 * rate[1])), sway_sigma=np.sqrt(history.sway.variance),
    )  # fmt: skip


def by_both_fields(found: Sequence[Localisation | None]) -> list[Localisation | None]:
    """Frames one after the other, pan and log focal of those with two fields by both. What the cubic adds to the
    parabola through three frames is added to the standard deviation."""
    out = list(found)
    for number, one in enumerate(found):
        if one is None or not _whole(one):
            continue
        near = [j for j in (-2, -1, 0, 1) if 0 <= number + j < len(found) and _whole(found[number + j])]
        if not {-1, 0} <= set(near):
            continue
        middle = np.array([_middle(found[number + j], one) for j in near])
        fewer = slice(1, None) if near[0] == -2 else slice(None, -1)
        step = _at_0(near) @ middle
        unsure = step - _at_0(near[fewer]) @ middle[fewer]
        out[number] = replace(
            one, pan_rad=float(wrapped(one.pan_rad + step[0])), focal_px=one.focal_px * float(np.exp(step[1])),
            covariance=one.covariance + np.outer(unsure, unsure),
        )  # fmt: skip
    return out


def _whole(one: Localisation | None) -> bool:
    return one is not None and one.valid and len(one.second_field) > 0


def _middle(one: Localisation | None, origin: Localisation) -> Array:
    """Mean of both fields (2,), pan and log focal, from the first field of ``origin``."""
    assert one is not None
    first = np.array([wrapped(one.pan_rad - origin.pan_rad), np.log(one.focal_px / origin.focal_px)])
    between = np.array([wrapped(one.second_field[0] - one.pan_rad), one.second_field[1] - np.log(one.focal_px)])
    return np.asarray(first + 0.5 * between, np.float64)


def _at_0(near: Sequence[int]) -> Array:
    """Weights (N,) of the means of the fields of frames ``near`` (N,) in a polynomial's value at 0."""
    first, power = np.array(near, np.float64)[:, None], np.arange(len(near))
    means = 0.5 * (first**power + (first + 0.5) ** power)
    return np.asarray(np.linalg.inv(means)[0])
