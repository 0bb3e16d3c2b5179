"""Scale of a world that nobody has measured: by the lengths of the athlete's limbs, of which the stature tells some."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np

from pzcap.body.landmarks import SIGMA_M
from pzcap.body.skeleton import Body
from pzcap.initialisation.tuning import HEADS
from pzcap.io.detections import KEYPOINTS, ROW
from pzcap.solver.robust import normal_sigma
from pzcap.types import MEASUREMENTS, Array, Mask, PzcapError


class _Link(NamedTuple):
    """A distance between keypoints, or between the middles of two, that measurements tell."""

    ends: tuple[tuple[str, ...], tuple[str, ...]]
    told: Mapping[str, float]  # by measurement
    quantile: float = 0.5  # of its length over the frames: a back is straight in some only
    sigma_m: float = 0.0  # beside what measurements and detector leave open


def _pair(name: str) -> tuple[str, str]:
    return f"left_{name}", f"right_{name}"


_LINKS: Final = (
    *(
        _Link(((f"{side}_{a}",), (f"{side}_{b}",)), {measurement: 1.0})
        for side in ("left", "right")
        for a, b, measurement in (
            ("shoulder", "elbow", "upper_arm"), ("elbow", "wrist", "forearm"), ("hip", "knee", "thigh"),
            ("knee", "ankle", "shank"),
        )
    ),
    _Link((_pair("hip"), _pair("shoulder")), {"trunk": 1.0, "shoulder_drop": -1.0}, 0.8, 0.015),
    _Link((_pair("shoulder"), _pair("ear")), {"shoulder_drop": 1.0, "head": 0.48}, 0.8, 0.015),
)  # fmt: skip
"""From ankle to ear without a gap: what a detector means by a hip makes a thigh longer and the trunk shorter."""


def scale_by_limbs(points: Array, seen: Mask, body: Body) -> tuple[float, float]:
    """Metres for each unit of the ``points`` (T, 26, 3), of those ``seen`` (T, 26), and its relative standard
    deviation: limbs are as long as the ``body``'s measurements have them, with all that is not known of these and of
    what the detector means (generalised least squares on their logarithms). Raises PzcapError where none is seen."""
    rows: list[_Link] = []
    observed, noise = [], []
    for link in _LINKS:
        ends = [[ROW[name] for name in names] for names in link.ends]
        both = seen[:, ends[0] + ends[1]].all(axis=1)
        lengths = np.linalg.norm(points[both][:, ends[0]].mean(axis=1) - points[both][:, ends[1]].mean(axis=1), axis=1)
        if len(lengths) < HEADS.fewest_lengths:
            continue
        middle = float(np.median(lengths))
        spread = normal_sigma(lengths - middle)
        rows.append(link)
        observed.append(float(np.quantile(lengths, link.quantile)))
        noise.append(spread / middle * np.sqrt(HEADS.doubt / len(lengths)))
    if not rows:
        raise PzcapError("no limb of the athlete is seen by two cameras often enough")
    by_measurement = np.array([[link.told.get(name, 0.0) for name in MEASUREMENTS] for link in rows])
    by_landmark = np.zeros((len(rows), len(KEYPOINTS)))
    for k, link in enumerate(rows):
        for sign, names in zip((-1.0, 1.0), link.ends, strict=True):
            by_landmark[k, [ROW[name] for name in names]] = sign / len(names)
    lengths_m = by_measurement @ body.measured.values_m
    covariance = by_measurement @ body.measured.covariance_m2 @ by_measurement.T
    covariance += (by_landmark * SIGMA_M**2) @ by_landmark.T + np.diag([link.sigma_m**2 for link in rows])
    covariance = covariance / np.outer(lengths_m, lengths_m) + np.diag(np.square(noise))
    weight = np.linalg.solve(covariance, np.ones(len(rows)))
    variance = 1.0 / float(weight.sum())
    return float(np.exp(variance * weight @ np.log(lengths_m / np.array(observed)))), float(np.sqrt(variance))
