"""Methods of anyone's on a split: results that are handed in, or an estimator that is run here (docs/estimators.md).

    python -m experiments.benchmark score split=mini results=FOLDER entry=mine.json
    python -m experiments.benchmark score split=mini estimator=my_lab.trackers:follow entry=mine.json

An estimator is run on ``footage/NAME`` and leaves files of results in ``results/KEY/NAME``, as this tree's methods do.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final

from experiments import estimators
from experiments.benchmark.entries import Description, read_description
from experiments.benchmark.make import described
from experiments.benchmark.methods.rows import METHODS
from experiments.benchmark.write import this_machine, write
from experiments.terminal import terminal
from pzcap.export.tables import results_of
from pzcap.io.capture import read_capture
from pzcap.scoring.files import write_results
from pzcap.scoring.readers.conventions import METRES, Conventions, joint_names
from pzcap.types import PzcapError

CONVENTIONS: Final = ("joints", "axes", "unit", "first_frame", "rate")
"""Keys by which is said what TRC, C3D and BVH leave open: `pzcap-score` has them as options."""


def conventions(values: Mapping[str, str]) -> Conventions:
    """What is said of other programs' files; an empty text says nothing. Raises PzcapError for what cannot be."""
    if values["unit"] and values["unit"] not in METRES:
        raise PzcapError(f"unit={values['unit']}; give m, cm or mm")
    try:
        first = int(values["first_frame"]) if values["first_frame"] else None
        rate = float(values["rate"]) if values["rate"] else None
    except ValueError as error:
        raise PzcapError(f"first_frame={values['first_frame']} rate={values['rate']}; give numbers") from error
    if rate is not None and not 0.0 < rate < float("inf"):
        raise PzcapError(f"rate={values['rate']}; give frames a second, above 0")
    names = joint_names(Path(values["joints"])) if values["joints"] else {}
    return Conventions(values["axes"] or None, values["unit"] or None, first, names, rate)


def score_results(folder: Path, results: Path, description: Path, said: Conventions) -> Path:
    """Make an entry of anybody's ``results`` of the split in ``folder``."""
    return write(folder, described(folder), _foreign(description), results, said)


def score_estimator(folder: Path, name: str, description: Path) -> Path:
    """Run the estimator ``module:function`` on all captures of the split in ``folder``, and make an entry of it."""
    split, entered, estimator = described(folder), _foreign(description), estimators.find(name)
    place, took = folder / "results" / entered.key, 0.0
    shutil.rmtree(place, ignore_errors=True)
    for capture in split["captures"]:
        start = time.perf_counter()
        try:
            found = estimators.estimate(estimator, read_capture(folder / "footage" / capture), name)
        except PzcapError as error:  # on this footage: it is a capture without an answer
            terminal(stderr=True).print(f"{capture}: {error}", highlight=False, markup=False)
            continue
        finally:
            took += time.perf_counter() - start
        write_results(replace(results_of(found), method=entered.label, capture=capture), place / capture)
    if not place.is_dir():
        raise PzcapError(f"estimator={name}: has no answer on any capture of {folder}; no entry is made")
    measured = replace(
        entered,
        seconds=round(took, 1) if entered.seconds is None else entered.seconds,
        machine=entered.machine or this_machine(),
    )
    return write(folder, split, measured, place)


def _foreign(path: Path) -> Description:
    """The description at ``path``, which takes no key of this tree's methods."""
    description = read_description(path)
    if any(method.key == description.key for method in METHODS):
        raise PzcapError(f"{path}: key '{description.key}' is that of a method of this tree; give another")
    return description
