"""The methods of the bench, and what they reach: every one on the same frames, against the same background."""

from __future__ import annotations

import resource
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final, Protocol

import cv2
import numpy as np

from experiments.comparisons.peers import hugin
from experiments.comparisons.peers.adjustment import RayAdjustment
from experiments.comparisons.peers.alignment import Ecc
from experiments.comparisons.peers.matching import Features
from experiments.comparisons.peers.material import Background, Estimate, Material, Shot
from pzcap.extras.paper.method import PaperLocaliser
from pzcap.geometry.camera import wrapped
from pzcap.localisation.localise import Localiser
from pzcap.progress import Report
from pzcap.types import Array, Localisation, PzcapError

LOST_RAD: Final = np.deg2rad(1.0)
LOST_FOCAL: Final = 0.05
"""An answer further off than either is none."""


class Peer(Protocol):
    """One method, ready for the frames of one camera."""

    def locate(self, shot: Shot, start: Estimate | None) -> Estimate | None:
        """Pan and focal length of a view, None where the method has no answer. ``start`` is a good one, where known."""
        ...


class Ours:
    """`pzcap.localisation.localise`, from nothing or from the frame before."""

    def __init__(self, background: Background, *, method: str, tracking: bool) -> None:
        config = replace(background.config, method=method)
        if method == "paper":
            assert background.paper is not None
            self._localiser: Localiser | PaperLocaliser = PaperLocaliser(*background.paper, config)
        else:
            self._localiser = Localiser(background.panorama, background.camera, config)
        self._tracking = tracking
        self._before: Localisation | None = None

    def locate(self, shot: Shot, start: Estimate | None) -> Estimate | None:
        del start
        found = self._localiser.localise(shot.image, self._before)
        if self._tracking:
            self._before = found if found.valid else None
        return Estimate(found.pan_rad, found.focal_px) if found.valid else None


def _lacks_paper(material: Material) -> str | None:
    return None if all(b.paper is not None for b in material.backgrounds) else "needs a capture"


def _lacks_masks(material: Material) -> str | None:
    first = next(material.shots(), None)
    return None if first is not None and first.person is not None else "needs masks"


def _lacks_sweep(material: Material) -> str | None:
    return None if all(len(b.sweep) > 1 for b in material.backgrounds) else "needs a sweep"


@dataclass(frozen=True, slots=True)
class Method:
    label: str
    make: Callable[[Background], Peer]
    lacks: Callable[[Material], str | None] = lambda _: None  # why it cannot run
    starts: bool = False  # it needs a good start
    tracks: bool = False  # it must see every frame, the scored and the others


METHODS: Final[dict[str, Method]] = {
    "ours": Method("ours, cold start", lambda b: Ours(b, method="exact", tracking=False)),
    "ours_tracking": Method("ours, tracking", lambda b: Ours(b, method="exact", tracking=True), tracks=True),
    "paper": Method("the paper's (eq. 15)", lambda b: Ours(b, method="paper", tracking=False), _lacks_paper),
    "sift": Method("SIFT + MAGSAC, fit of pan and focal", lambda b: Features(b, "sift", "fit")),
    "akaze": Method("AKAZE + MAGSAC, fit of pan and focal", lambda b: Features(b, "akaze", "fit")),
    "homography": Method("AKAZE + MAGSAC, homography decomposed", lambda b: Features(b, "akaze", "homography")),
    "ecc": Method("findTransformECC, no mask", lambda b: Ecc(b, "none"), starts=True),
    "ecc_difference": Method("findTransformECC, own mask", lambda b: Ecc(b, "difference"), starts=True),
    "ecc_known": Method("findTransformECC, true mask", lambda b: Ecc(b, "known"), _lacks_masks, starts=True),
    "rays": Method("cv2.detail ray bundle adjustment", RayAdjustment, _lacks_sweep, starts=True),
    "hugin": Method("Hugin", hugin.Hugin, lambda m: hugin.missing() or _lacks_sweep(m), starts=True),
}


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """Answer of one method to one view."""

    camera: int
    frame: int
    estimate: Estimate | None
    truth: Estimate | None
    seconds: float  # CPU time, on one thread

    @property
    def errors(self) -> tuple[float, float] | None:
        """Pan in radians and focal length relative to the truth; None without an answer or without a truth."""
        return None if self.truth is None else difference(self.estimate, self.truth)


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """Answers of one method to all views."""

    name: str
    answers: tuple[Answer, ...]
    missing: str | None  # why it did not run


@dataclass(frozen=True, slots=True, eq=False)
class Summary:
    """Errors against the truth, or, where there is none, against the median of all methods' answers."""

    pan_rad: Array  # (N,) of the answers that did not fail
    focal: Array  # (N,) relative
    failures: int | None  # no answer, or one that is far off; without a truth no answer
    ms: float  # median a view
    views: int  # that were judged


def difference(estimate: Estimate | None, other: Estimate) -> tuple[float, float] | None:
    """Pan in radians and focal length, relative, of one estimate against another."""
    if estimate is None:
        return None
    return float(wrapped(estimate.pan_rad - other.pan_rad)), estimate.focal_px / other.focal_px - 1.0


def choose(names: Sequence[str]) -> tuple[str, ...]:
    """The methods named, in the bench's order; all where none is. PzcapError for a name that is not known."""
    for name in names:
        if name not in METHODS:
            raise PzcapError(f"no method '{name}'; choose from {', '.join(METHODS)}")
    return tuple(name for name in METHODS if not names or name in names)


def run(material: Material, names: Sequence[str], every: int, report: Report) -> tuple[Result, ...]:
    """Let each of the methods locate every ``every``-th frame of each camera, on one thread.

    Raises PzcapError if ``every`` is not above 0 or no frame is left.
    """
    if every < 1:
        raise PzcapError(f"every is {every}; give 1 or more")
    missing = {name: METHODS[name].lacks(material) for name in names}
    able = [name for name in names if missing[name] is None]
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        peers: list[dict[str, Peer]] = []
        for number, background in enumerate(material.backgrounds):
            report("make methods ready", number, len(material.backgrounds))
            peers.append({name: METHODS[name].make(background) for name in able})
        report("make methods ready", len(peers), len(peers))
        starters = [
            _Starter(b, ready, needed=any(METHODS[name].starts for name in able))
            for b, ready in zip(material.backgrounds, peers, strict=True)
        ]
        answers: dict[str, list[Answer]] = {name: [] for name in able}
        for done, shot in enumerate(material.shots()):
            for name, answer in _locate(shot, peers[shot.camera], starters[shot.camera], shot.frame % every == 0):
                answers[name].append(answer)
            report("locate views", done + 1, material.count)
    finally:
        cv2.setNumThreads(threads)
    if able and not answers[able[0]]:
        raise PzcapError(f"{material.name}: no frame to locate; bring some, or give a smaller every")
    return tuple(Result(name, tuple(answers.get(name, ())), missing[name]) for name in names)


def _locate(shot: Shot, peers: dict[str, Peer], starter: _Starter, scored: bool) -> Iterator[tuple[str, Answer]]:
    located: dict[str, Estimate | None] = {}
    for name in sorted(peers, key=lambda name: METHODS[name].starts):  # those that give a start come first
        method = METHODS[name]
        if not scored and not method.tracks:
            continue
        start = starter.start(shot, located) if method.starts else None
        before = _cpu_seconds()
        located[name] = peers[name].locate(shot, start)
        if scored:
            yield name, Answer(shot.camera, shot.frame, located[name], shot.truth, _cpu_seconds() - before)


class _Starter:
    """Gives the good start that some need: what SIFT found, or else AKAZE. Nobody's time counts it."""

    def __init__(self, background: Background, peers: dict[str, Peer], *, needed: bool) -> None:
        self._peers: dict[str, Peer] = {}
        for name in ("sift", "akaze") if needed else ():
            self._peers[name] = peers.get(name) or METHODS[name].make(background)

    def start(self, shot: Shot, located: dict[str, Estimate | None]) -> Estimate | None:
        for name, peer in self._peers.items():
            if name not in located:
                located[name] = peer.locate(shot, None)
            if located[name] is not None:
                return located[name]
        return None


def _cpu_seconds() -> float:
    """CPU time of this process and of those it waited for: what the clock would show if nobody else were at work."""
    return sum(
        usage.ru_utime + usage.ru_stime
        for usage in map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    )


# --------------------------------------------------------------------------------------------------------------
# What comes of it


def scored(results: Sequence[Result]) -> bool:
    """True if there is a truth to measure against."""
    return any(answer.truth is not None for result in results for answer in result.answers)


def summarise(results: Sequence[Result]) -> dict[str, Summary | None]:
    """Method -> what it reached; None for one that did not run."""
    consensus = None if scored(results) else _consensus(results)
    return {result.name: _summary(result, consensus) for result in results}


def _summary(result: Result, consensus: dict[tuple[int, int], Estimate] | None) -> Summary | None:
    if not result.answers:
        return None
    if consensus is None:
        judged = [answer.errors for answer in result.answers if answer.truth is not None]
        good = [e for e in judged if e is not None and abs(e[0]) <= LOST_RAD and abs(e[1]) <= LOST_FOCAL]
    else:
        judged = [
            None if a.estimate is None else difference(a.estimate, consensus[a.camera, a.frame]) for a in result.answers
        ]
        good = [apart for apart in judged if apart is not None]
    pan, focal = np.array(good, np.float64).reshape(-1, 2).T
    ms = 1000.0 * float(np.median([answer.seconds for answer in result.answers]))
    return Summary(pan, focal, len(judged) - len(good), ms, len(judged))


def _consensus(results: Sequence[Result]) -> dict[tuple[int, int], Estimate]:
    """(camera, frame) -> the median of all answers."""
    answers: dict[tuple[int, int], list[Estimate]] = {}
    for result in results:
        for answer in result.answers:
            if answer.estimate is not None:
                answers.setdefault((answer.camera, answer.frame), []).append(answer.estimate)
    medians = {}
    for view, found in answers.items():
        about = found[0].pan_rad  # angles about one of them have no seam
        pan = about + float(np.median([wrapped(estimate.pan_rad - about) for estimate in found]))
        medians[view] = Estimate(pan, float(np.median([estimate.focal_px for estimate in found])))
    return medians


def figures(summary: Summary | None, what: str) -> dict[str, float | None]:
    """The figures of one method. Without a truth ``what`` is "agreement.", which stands in the place of errors."""
    found: dict[str, float | None] = {}
    for quantity, factor in (("pan", 180.0 / np.pi), ("focal", 100.0)):
        values = np.empty(0) if summary is None else factor * np.abs(getattr(summary, _FIELD[quantity]))
        for statistic, of in STATISTICS.items():
            found[f"{what}{quantity}.{statistic}"] = of(values) if len(values) else None
    found["failures"] = None if summary is None else summary.failures
    found["views"] = None if summary is None else summary.views
    return found | {"time": None if summary is None else summary.ms}


_FIELD: Final = {"pan": "pan_rad", "focal": "focal"}
STATISTICS: Final[dict[str, Callable[[Array], float]]] = {
    "median": lambda values: float(np.median(values)),
    "p95": lambda values: float(np.percentile(values, 95)),
    "rms": lambda values: float(np.sqrt(np.mean(values**2))),
}
