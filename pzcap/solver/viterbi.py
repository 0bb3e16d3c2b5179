"""Dynamic programming over a chain: the best sequence of states (Viterbi, 1967; Bellman, 1957)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from pzcap.types import Array


def best_path(scores: Sequence[Array], transitions: Iterable[Array]) -> list[int]:
    """The states (T,) with the greatest ``sum_t scores[t][k_t] + sum_t transitions[t][k_(t+1), k_t]``.

    Each of the T instants has states of its own, ``scores[t]`` (K_t,); a transition (K_(t+1), K_t) of minus infinity is
    forbidden. Of equally good paths the one of the lowest states wins.
    """
    total, origins = scores[0], []
    for score, transition in zip(scores[1:], transitions, strict=True):
        reached = total + transition
        origins.append(np.argmax(reached, axis=1))
        total = reached.max(axis=1) + score
    path = [int(np.argmax(total))]
    for origin in reversed(origins):
        path.append(int(origin[path[-1]]))
    return path[::-1]
