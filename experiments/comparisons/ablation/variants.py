"""One change at a time: a list of named variants of the tracker and of what it is given."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import numpy as np

from pzcap.tracking.settings import TrackingConfig

Known = Literal["cameras", "masks", "body", "keyframes"]
Group = Literal["default", "evidence", "keyframes", "cameras", "truth"]
Change = Callable[[TrackingConfig], TrackingConfig]


SHAKEN_DEG: Final = 0.03  # half a pixel and more, forty times what the background leaves open


def _all(count: int) -> list[int]:
    return list(range(count))


def _half(count: int) -> list[int]:
    """Evenly spaced, with both ends."""
    return [int(i) for i in np.rint(np.linspace(0, count - 1, max((count + 1) // 2, min(count, 2))))]


@dataclass(frozen=True, slots=True, eq=False)
class Variant:
    key: str  # in metrics
    label: str
    group: Group
    change: Change = lambda config: config
    chosen: Callable[[int], list[int]] = _all  # which keyframes are used, of how many the capture has
    posed_per_s: float = 0.0  # keyframes that the experiment poses besides
    expected: bool = True  # whether the silhouettes are cut knowing where the tracker expects the body
    others: bool = True  # whether the silhouettes tell other people apart
    known: frozenset[Known] = frozenset()  # what the experiment puts in from the truth
    shaken_deg: float = 0.0  # standard deviation of what the experiment adds to each pan; the tracker is told
    corrected: bool = True  # whether the body may correct the cameras


def _terms(**values: Any) -> Change:
    def change(config: TrackingConfig) -> TrackingConfig:
        rounds = (replace(each, terms=replace(each.terms, **values)) for each in config.schedule)
        return replace(config, schedule=tuple(rounds))

    return change


def _config(**values: Any) -> Change:
    return lambda config: replace(config, **values)


VARIANTS: Final[tuple[Variant, ...]] = (
    Variant("default", "default", "default"),
    Variant("no_brightness", "no brightness", "evidence", _terms(brightness_weight=0.0)),
    Variant("no_shading", "no shading", "evidence", _terms(shading_sigma=1e-6)),
    Variant("no_contour", "no contour", "evidence", _terms(contour_weight=0.0)),
    Variant("no_expectation", "body not expected", "evidence", expected=False),
    Variant("no_others", "others not told apart", "evidence", others=False),
    Variant("no_limits", "no joint limits", "evidence", _config(limit_sigma_rad=np.inf)),
    Variant("no_spine", "spine free to bend", "evidence", _config(spine_sigma_rad=np.inf)),
    Variant("no_shape", "body as measured", "evidence", _config(shape_weight=0.0)),
    Variant("no_body_size", "size as measured", "evidence", _config(body_size=False)),
    Variant("no_drape", "loose clothes move with the body", "evidence", _config(drape=False)),
    Variant("no_second_fields", "fields by twos, as frames", "evidence", _config(second_fields=False)),
    Variant("no_reacquisition", "no reacquisition", "evidence", _config(reacquisition=False)),
    Variant("no_appearance", "appearance not scored", "evidence", _config(appearance_score=False)),
    Variant("no_self_collision", "no self-collision", "evidence", _config(self_collision=False)),
    Variant("no_contacts", "no contacts", "evidence", _config(contacts=False)),
    Variant("no_skin_colours", "no skin colours", "evidence", _config(skin_colours=False)),
    Variant("no_shape_refit", "early frames not refitted", "evidence", _config(shape_refit=False)),
    Variant("no_polishing", "no polishing", "evidence", _config(polishing_sweeps=0)),
    Variant("first", "first keyframe alone", "keyframes", chosen=lambda _: [0]),
    Variant("ends", "keyframes at the ends", "keyframes", chosen=lambda count: sorted({0, count - 1})),
    Variant("half", "half of the keyframes", "keyframes", chosen=_half),
    Variant("two_a_second", "two keyframes a second", "keyframes", posed_per_s=2.0),
    Variant("four_a_second", "four keyframes a second", "keyframes", posed_per_s=4.0),
    Variant("kept", "cameras not corrected", "cameras", corrected=False),
    Variant("shaken", "cameras shaken by 0.03°", "cameras", shaken_deg=SHAKEN_DEG),
    Variant("shaken_kept", "shaken, not corrected", "cameras", shaken_deg=SHAKEN_DEG, corrected=False),
    Variant("true_cameras", "true cameras", "truth", known=frozenset({"cameras"})),
    Variant("true_masks", "true masks", "truth", known=frozenset({"masks"})),
    Variant("true_body", "true body measures", "truth", known=frozenset({"body"})),
    Variant("true_keyframes", "true keyframes", "truth", known=frozenset({"keyframes"})),
    Variant("all_true", "all of these true", "truth", known=frozenset({"cameras", "masks", "body", "keyframes"})),
)
"""The default comes first: the others are compared with it."""
