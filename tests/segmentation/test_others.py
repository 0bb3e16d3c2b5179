"""Somebody else beside the athlete: told from a limb, and unknown to the tracker."""

from __future__ import annotations

import cv2
import numpy as np

from pzcap.segmentation.others import other_people
from pzcap.types import Float32, Mask

SHAPE = (120, 160)


def person(column: int, width: int = 16) -> Mask:
    """Somebody upright, 80 half pixels tall."""
    mask = np.zeros(SHAPE, np.uint8)
    cv2.ellipse(mask, (column, 62), (width // 2, 40), 0, 0, 360, 1, -1)
    return mask > 0


def log_odds(solid: Mask) -> Float32:
    return np.where(solid, np.float32(4.0), np.float32(-4.0))


def distance(expected: Mask) -> Float32:
    inside = expected.astype(np.uint8)
    apart = cv2.distanceTransform(inside, cv2.DIST_L2, 3) - cv2.distanceTransform(1 - inside, cv2.DIST_L2, 3)
    return np.asarray(2.0 * apart, np.float32)


def test_nobody_is_found_where_nobody_is() -> None:
    athlete = person(80)
    assert not other_people(log_odds(athlete), distance(athlete), 2.0).any()
    assert not other_people(log_odds(athlete), np.full(SHAPE, -10.0, np.float32), 2.0).any()  # nor is the athlete


def test_a_limb_that_was_not_expected_is_not_somebody() -> None:
    athlete = person(80)
    seen = athlete.copy()
    cv2.line(canvas := seen.astype(np.uint8), (84, 60), (116, 30), 1, 5)
    seen = canvas > 0
    assert not other_people(log_odds(seen), distance(athlete), 2.0).any()


def test_somebody_beside_the_athlete_is() -> None:
    athlete, coach = person(60), person(100)
    found = other_people(log_odds(athlete | coach), distance(athlete), 2.0) > 0
    assert found[coach].mean() > 0.95
    assert not found[athlete].any()


def test_reaching_arms_go_with_whom_they_belong_to() -> None:
    athlete, spotter = person(60), person(100)
    arm = np.zeros(SHAPE, np.uint8)
    cv2.line(arm, (100, 60), (66, 62), 1, 4)
    found = other_people(log_odds(athlete | spotter | (arm > 0)), distance(athlete), 2.0) > 0
    assert found[(arm > 0) & ~athlete].mean() > 0.8
    assert not found[athlete].any()


def test_somebody_who_is_half_out_of_view_is_somebody() -> None:
    athlete, passer = person(80), person(158, width=20)
    found = other_people(log_odds(athlete | passer), distance(athlete), 2.0) > 0
    assert found[passer].mean() > 0.9
