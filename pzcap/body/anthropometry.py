"""Measurements of a person from those that a tape has given: a regression on stature, mass and sex, with its scatter.

`measured` returns all of `pzcap.types.MEASUREMENTS` with one covariance: the population's, conditioned on what was
measured, each reading with its own sigma. With a tape's full set of readings the population hardly counts; what is
missing comes from it alone. A reading that no person of these other measurements has, such as one with two digits
exchanged, is believed to what it is off by (`contradictions`).

Model
    Of each sex, stature and mass are jointly normal; every length is a share of stature, every girth linear in stature
    and mass; what is left is normal, and correlated within arms, legs, trunk. Where no sex is given, both are tried and
    weighed by how well they explain the readings.

Sources
    G. Heinz, L. Peterson, R. Johnson, C. Kerk, *Exploring Relationships in Body Dimensions*, J. Statistics Education 11
    (2003): 507 physically active adults. Stature, mass, girths but for head, neck and elbow, their coefficients
    on stature and mass, and the correlations of what these leave (regressed anew from its data, the two sexes' mean).
    C. Gordon et al., *2012 Anthropometric Survey of U.S. Army Personnel* (ANSUR II), NATICK/TR-15/007 (2014): heights
    of cervicale, trochanter, knee, ankle and acromion, biacromial breadth, lengths of arm, hand and foot, girths of
    head and neck; the scatter and correlations of lengths at given stature follow its deviations and correlations,
    rounded: not to be told from a table to more than a fifth. **To be checked**: these figures were not read off the
    report again when they were entered.
    R. Drillis and R. Contini, *Body Segment Parameters* (1966), as in D. Winter, *Biomechanics and Motor Control of
    Human Movement*: links from joint to joint as shares of stature. P. de Leva, *Joint center longitudinal positions*,
    J. Biomechanics 29 (1996): how far below the acromion a shoulder joint lies.
    The sources do not agree where a joint is: a share is the mean of both, and half their difference is in the scatter.
    By hand, since no survey has it: the elbow's girth, and how far inside the breadths hips and shoulders lie.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from operator import itemgetter
from typing import Final, NamedTuple

import numpy as np

from pzcap.types import MEASUREMENTS, Array, Indices, Sex, Subject


class _Population(NamedTuple):
    """Stature (m) and mass (kg) of one sex: means, deviations, correlation."""

    stature_m: float
    stature_sigma_m: float
    mass_kg: float
    mass_sigma_kg: float
    correlation: float


class _Share(NamedTuple):
    """A length as a share of stature: of women, of men, and its scatter."""

    female: float
    male: float
    sigma: float


class _Girth(NamedTuple):
    """Of one sex: centimetres at the mean stature and mass, per centimetre of stature, per kilogram, scatter."""

    mean: float
    per_cm: float
    per_kg: float
    sigma: float


_POPULATIONS: Final[dict[Sex, _Population]] = {
    "female": _Population(1.649, 0.065, 60.6, 9.6, 0.43),
    "male": _Population(1.777, 0.072, 78.1, 10.5, 0.53),
}
# heights above the floor; the legs and the trunk are the differences
_HEIGHTS: Final[dict[str, _Share]] = {
    "neck": _Share(0.8635, 0.8650, 0.0065),
    "hip": _Share(0.5250, 0.5240, 0.0150),
    "knee": _Share(0.2820, 0.2830, 0.0085),
    "ankle": _Share(0.0400, 0.0405, 0.0033),
}
_LENGTHS: Final[dict[str, _Share]] = {
    "shoulder_drop": _Share(0.0530, 0.0535, 0.0105),
    "shoulder_width": _Share(0.2040, 0.2140, 0.0120),
    "hip_width": _Share(0.1030, 0.0970, 0.0080),
    "upper_arm": _Share(0.1760, 0.1770, 0.0110),
    "forearm": _Share(0.1475, 0.1495, 0.0060),
    "hand": _Share(0.1100, 0.1095, 0.0045),
    "foot": _Share(0.1515, 0.1530, 0.0050),
}
_GIRTHS: Final[dict[str, tuple[_Girth, _Girth]]] = {
    "girth_head": (_Girth(55.9, 0.07, 0.03, 1.5), _Girth(57.2, 0.06, 0.03, 1.4)),
    "girth_neck": (_Girth(32.0, -0.02, 0.13, 1.4), _Girth(38.8, -0.04, 0.14, 1.7)),
    "girth_chest": (_Girth(86.1, -0.19, 0.594, 3.2), _Girth(101.0, -0.25, 0.636, 4.1)),
    "girth_waist": (_Girth(69.8, -0.33, 0.774, 3.4), _Girth(84.5, -0.38, 0.813, 4.7)),
    "girth_hips": (_Girth(95.7, -0.12, 0.686, 2.9), _Girth(97.8, -0.15, 0.574, 2.9)),
    # that of the flexed arm less what flexing adds, 1.3 and 2.5 cm in ANSUR's earlier survey
    "girth_upper_arm": (_Girth(26.8, -0.12, 0.266, 1.5), _Girth(31.9, -0.10, 0.230, 2.2)),
    "girth_elbow": (_Girth(23.6, -0.05, 0.170, 1.3), _Girth(28.0, -0.05, 0.150, 1.6)),
    "girth_forearm": (_Girth(23.8, -0.04, 0.157, 0.9), _Girth(28.2, -0.04, 0.130, 1.3)),
    "girth_wrist": (_Girth(15.1, 0.01, 0.061, 0.6), _Girth(17.2, 0.01, 0.048, 0.7)),
    "girth_thigh": (_Girth(57.2, -0.12, 0.448, 2.3), _Girth(56.5, -0.15, 0.366, 2.6)),
    "girth_knee": (_Girth(35.3, 0.02, 0.219, 1.4), _Girth(37.2, 0.00, 0.159, 1.5)),
    "girth_calf": (_Girth(35.0, -0.01, 0.220, 1.6), _Girth(37.2, -0.07, 0.198, 1.9)),
    "girth_ankle": (_Girth(21.2, 0.01, 0.098, 1.1), _Girth(23.2, 0.01, 0.102, 1.3)),
}
"""Women, men."""
_CORRELATIONS: Final[tuple[tuple[str, str, float], ...]] = (
    ("hip", "knee", 0.6), ("hip", "ankle", 0.25), ("knee", "ankle", 0.4),
    ("upper_arm", "forearm", 0.2), ("forearm", "hand", 0.4), ("hand", "foot", 0.5), ("knee", "forearm", 0.4),
    ("knee", "foot", 0.2), ("hand", "knee", 0.2), ("forearm", "foot", 0.3),
    ("girth_chest", "girth_waist", 0.25), ("girth_chest", "girth_upper_arm", 0.35),
    ("girth_chest", "girth_forearm", 0.2), ("girth_chest", "girth_knee", -0.25), ("girth_chest", "girth_calf", -0.25),
    ("girth_chest", "girth_thigh", -0.2), ("girth_chest", "girth_hips", -0.15),
    ("girth_waist", "girth_hips", 0.15), ("girth_waist", "girth_thigh", -0.3), ("girth_waist", "girth_forearm", -0.3),
    ("girth_waist", "girth_calf", -0.3), ("girth_waist", "girth_wrist", -0.2), ("girth_waist", "girth_knee", -0.2),
    ("girth_hips", "girth_thigh", 0.4), ("girth_hips", "girth_forearm", -0.15),
    ("girth_thigh", "girth_knee", 0.2), ("girth_thigh", "girth_calf", 0.2),
    ("girth_upper_arm", "girth_elbow", 0.5), ("girth_upper_arm", "girth_forearm", 0.6),
    ("girth_upper_arm", "girth_wrist", 0.3), ("girth_elbow", "girth_forearm", 0.6), ("girth_elbow", "girth_wrist", 0.4),
    ("girth_forearm", "girth_wrist", 0.55), ("girth_wrist", "girth_ankle", 0.35), ("girth_forearm", "girth_ankle", 0.2),
    ("girth_knee", "girth_calf", 0.4), ("girth_knee", "girth_ankle", 0.4), ("girth_calf", "girth_ankle", 0.45),
    ("girth_knee", "girth_wrist", 0.2), ("girth_calf", "girth_wrist", 0.2), ("girth_calf", "girth_forearm", 0.15),
)  # fmt: skip
"""Of what stature and mass leave; pairs that are not listed are taken to be independent."""
_CURVED_M: Final = 0.005
"""By how much the links of legs, trunk and head miss the stature, which they add up to: a back is no straight line."""
_PARTS: Final = (*_HEIGHTS, *_LENGTHS, *_GIRTHS, "curved")
_MASS: Final = len(MEASUREMENTS)  # stands after the measurements
_LINKS: Final[dict[str, dict[str, float]]] = {
    "head": {"stature": 1.0, "neck": -1.0},
    "trunk": {"neck": 1.0, "hip": -1.0, "curved": 1.0},
    "thigh": {"hip": 1.0, "knee": -1.0},
    "shank": {"knee": 1.0, "ankle": -1.0},
    "ankle_height": {"ankle": 1.0},
}
"""Measurements that are differences of heights."""


UNMEASURED: Final = Subject({}, 0.005)
"""Somebody of whom nothing is known: the mean of the population, with its scatter."""


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """A person's measurements, in the order of MEASUREMENTS."""

    values_m: Array  # (26,)
    covariance_m2: Array  # (26, 26)

    def value(self, name: str) -> float:
        return float(self.values_m[MEASUREMENTS.index(name)])

    def sigma(self, name: str) -> float:
        k = MEASUREMENTS.index(name)
        return float(np.sqrt(self.covariance_m2[k, k]))

    def named(self) -> dict[str, float]:
        return dict(zip(MEASUREMENTS, self.values_m.tolist(), strict=True))


class Contradiction(NamedTuple):
    """A reading that no person of the other measurements has."""

    name: str  # of MEASUREMENTS, or "mass_kg"
    reading: float  # metres, or kilograms
    expected: float  # from all others
    sigma: float  # of that, and of the reading


def measured(subject: Subject) -> Measured:
    """All measurements of the ``subject`` with their covariance, from those that there are."""
    readings, off = _weighed(subject)
    rows, told, sigma = readings.rows, readings.values, np.hypot(readings.sigma, off)
    found = [_conditioned(*_population(sex), rows, told, sigma) for sex in _sexes(subject)]
    weights = np.exp(np.array([one[2] for one in found]) - max(one[2] for one in found))
    weights /= weights.sum()
    mean = np.array(sum(w * one[0] for w, one in zip(weights, found, strict=True)))
    spread = [one[1] + np.outer(one[0] - mean, one[0] - mean) for one in found]
    covariance = np.array(sum(w * one for w, one in zip(weights, spread, strict=True)))
    return Measured(mean[:_MASS], covariance[:_MASS, :_MASS])


_SCALE_KG: Final = 1.0  # sigma of a person's mass: scales, a meal, the clothes
_CONTRADICTS_SIGMAS: Final = 6.0
"""Of a reading against all others: the largest of 300 people, drawn from other tables than these, is 4.8."""
_BUILD_SPREAD: Final = 5.0  # factor of the spread of stature and mass: children contradict no reading by being small


def contradictions(subject: Subject) -> list[Contradiction]:
    """The readings that contradict all others by more than people differ, the clearest first: slips of the pen."""
    readings, off = _weighed(subject)
    found = []
    for place in np.flatnonzero(off).tolist():
        others = np.hypot(readings.sigma, np.where(np.arange(len(off)) == place, 0.0, off))
        away, sigma = _leave_one_out(readings, others, _sexes(subject))
        name = (*MEASUREMENTS, "mass_kg")[readings.rows[place]]
        value = float(readings.values[place])
        found.append(Contradiction(name, value, value - float(away[place]), float(sigma[place])))
    return sorted(found, key=lambda one: -abs(one.reading - one.expected) / one.sigma)


class _Readings(NamedTuple):
    """Numbers of a person that were measured."""

    rows: Indices  # (N,) which of MEASUREMENTS, or _MASS
    values: Array  # (N,) metres, or kilograms
    sigma: Array  # (N,)


def _weighed(subject: Subject) -> tuple[_Readings, Array]:
    """The readings of a ``subject``, and by how much each contradicts all others, 0 where they agree. One that
    contradicts is believed no more when the next is looked for."""
    rows = [MEASUREMENTS.index(name) for name in subject.measurements_m]
    values = list(subject.measurements_m.values())
    sigma = [subject.sigma_of(name) for name in subject.measurements_m]
    if subject.mass_kg is not None:
        rows, values, sigma = [*rows, _MASS], [*values, subject.mass_kg], [*sigma, _SCALE_KG]
    readings = _Readings(np.array(rows, np.int64), np.array(values), np.array(sigma))
    off = np.zeros(len(rows))
    for _ in rows:
        away, spread = _leave_one_out(readings, np.hypot(readings.sigma, off), _sexes(subject))
        apart = np.abs(away) / spread
        worst = int(np.argmax(apart))
        if apart[worst] < _CONTRADICTS_SIGMAS:
            break
        off[worst] = away[worst]
    return readings, off


def _leave_one_out(readings: _Readings, sigma: Array, sexes: Sequence[Sex]) -> tuple[Array, Array]:
    """Leave-one-out residuals (N,): by how much each reading, known to ``sigma`` (N,), is off from what all others say
    of it; and their standard deviations (N,), for the likeliest of the ``sexes``."""
    found = []
    for sex in sexes:
        mean, covariance = _population(sex, _BUILD_SPREAD)
        expected = covariance[np.ix_(readings.rows, readings.rows)] + np.diag(sigma**2)
        precision, off = np.linalg.inv(expected), readings.values - mean[readings.rows]
        likelihood = -0.5 * (off @ precision @ off + np.linalg.slogdet(expected)[1])
        found.append((float(likelihood), precision @ off / np.diag(precision), np.diag(precision) ** -0.5))
    _, away, spread = max(found, key=itemgetter(0))
    return away, spread


def _sexes(subject: Subject) -> tuple[Sex, ...]:
    return ("female", "male") if subject.sex is None else (subject.sex,)


def _population(sex: Sex, wider: float = 1.0) -> tuple[Array, Array]:
    """Mean (27,) and covariance (27, 27) of the measurements (metres) and the mass (kg) of one sex, stature and mass
    spread so many times ``wider``."""
    people, which = _POPULATIONS[sex], ("female", "male").index(sex)
    both = wider * np.array([people.stature_sigma_m, people.mass_sigma_kg])
    build = np.outer(both, both) * np.array([[1.0, people.correlation], [people.correlation, 1.0]])
    # parts as mean, change with stature (m) and with mass (kg), scatter (m)
    rows = np.zeros((len(_PARTS), 4))
    for k, name in enumerate(_PARTS):
        if name in _GIRTHS:
            girth = _GIRTHS[name][which]
            rows[k] = 0.01 * girth.mean, girth.per_cm, 0.01 * girth.per_kg, 0.01 * girth.sigma
        elif name == "curved":
            rows[k, 3] = _CURVED_M
        else:
            share = (_HEIGHTS | _LENGTHS)[name]
            rows[k] = people.stature_m * np.array([share[which], 0.0, 0.0, share.sigma])
            rows[k, 1] = share[which]
    mix = np.zeros((_MASS + 1, len(_PARTS)))  # of the parts to the measurements
    direct = np.zeros((_MASS + 1, 2))  # of stature and mass themselves
    direct[MEASUREMENTS.index("stature"), 0] = direct[_MASS, 1] = 1.0
    for k, name in enumerate(MEASUREMENTS):
        for part, factor in _LINKS.get(name, {} if name == "stature" else {name: 1.0}).items():
            if part == "stature":
                direct[k, 0] = factor
            else:
                mix[k, _PARTS.index(part)] = factor
    scatter = np.outer(rows[:, 3], rows[:, 3]) * _correlation()
    turn = direct + mix @ rows[:, 1:3]
    mean = mix @ rows[:, 0] + direct @ np.array([people.stature_m, people.mass_kg])
    return mean, turn @ build @ turn.T + mix @ scatter @ mix.T


def _correlation() -> Array:
    """(N, N) of the parts."""
    correlation = np.eye(len(_PARTS))
    for one, other, value in _CORRELATIONS:
        a, b = _PARTS.index(one), _PARTS.index(other)
        correlation[a, b] = correlation[b, a] = value
    return correlation


def _conditioned(
    mean: Array, covariance: Array, rows: Indices, told: Array, sigma: Array
) -> tuple[Array, Array, float]:
    """Mean and covariance given readings ``told`` (N,) of some ``rows``, and the log likelihood of these."""
    expected = covariance[np.ix_(rows, rows)] + np.diag(sigma**2)
    off = told - mean[rows]
    gain = np.linalg.solve(expected, covariance[rows]).T
    left = covariance - gain @ covariance[rows]
    likelihood = -0.5 * (off @ np.linalg.solve(expected, off) + np.linalg.slogdet(expected)[1])
    return mean + gain @ off, 0.5 * (left + left.T), float(likelihood)
