"""A limb is supported by the silhouettes that show it."""

from __future__ import annotations

from pzcap.tracking.limbs import grounds, support
from tests.scenes.tracked import clip, true_body


def test_a_limb_seen_by_nobody_has_no_support() -> None:
    body, pose = true_body(), clip().poses[3]
    assert not support(body, pose, grounds([None] * 4, [None] * 4)).any()
