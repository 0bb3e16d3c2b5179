"""`pzcap review`: the recording of results in a window of the Rerun viewer."""

from __future__ import annotations

import importlib.util
from pathlib import Path

from pzcap.command.places import NO_RERUN, recording_in
from pzcap.types import PzcapError


def review_results(results: Path) -> int:
    """Open the recording in ``results``; the exit status. PzcapError where there is none, or no viewer."""
    if importlib.util.find_spec("rerun") is None:
        raise PzcapError(NO_RERUN)
    path = recording_in(results)
    from pzcap.viewer.window import show

    show([(path, None)])
    print(path)
    return 0
