"""Estimators of anyone's, scored like ours. docs/estimators.md says what one is given and what it may return.

An estimator is a function from a `Capture` to the pan and zoom of each camera, to the body's motion, or to a whole
reconstruction. It is named ``module:function``. It is given the capture's folder and never the truth.
"""

from __future__ import annotations

import importlib
import importlib.util
import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from experiments.config import nearest
from experiments.score import score
from experiments.totals import metrics
from pzcap.io.capture import frame_sets, read_capture
from pzcap.io.record_checks import SHAPES
from pzcap.scoring.metric import Metric
from pzcap.types import Capture, Motion, PanZoomTrack, PzcapError, Reconstruction
from sim.truth import Truth

Estimate = Sequence[PanZoomTrack | None] | Motion | Reconstruction
Estimator = Callable[[Capture], Estimate]
T = TypeVar("T", PanZoomTrack, Motion)

GUIDE: Final = "(docs/estimators.md)"
_KINDS: Final = {"valid": np.bool_, "inliers": np.int64}
"""Type of an array's numbers, where it is not float64."""


def find(name: str, settings: Mapping[str, Any] | None = None) -> Estimator:
    """The function that ``module:function`` names, with its keyword arguments set to ``settings``.

    PzcapError, in one line, where there is none, or none that takes them.
    """
    module_name, colon, function_name = name.partition(":")
    if not (module_name and colon and function_name):
        raise PzcapError(f"estimator={name}: give module:function, such as my_lab.trackers:follow {GUIDE}")
    try:
        module = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{module_name}.".startswith(f"{error.name}."):
            raise PzcapError(f"estimator={name}: {module_name} needs a module '{error.name}'; install it") from error
        raise PzcapError(
            f"estimator={name}: no module '{error.name}'; start from the folder that holds it, or set PYTHONPATH"
        ) from error
    found = getattr(module, function_name, None)
    if not callable(found):
        known = [key for key, value in vars(module).items() if callable(value) and not key.startswith("_")]
        hint = nearest(function_name, known) if known else "it holds no function"
        raise PzcapError(f"estimator={name}: no function '{function_name}' in {module_name}; {hint}")
    return partial(found, **_taken(name, found, settings)) if settings else found


def _taken(name: str, function: Callable[..., Any], settings: Mapping[str, Any]) -> Mapping[str, Any]:
    """``settings``, all of which the function takes. PzcapError where it does not."""
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):  # of a function in C nobody knows
        return settings
    kinds = [parameter.kind for parameter in signature.parameters.values()]
    known = [one.name for one in list(signature.parameters.values())[1:]]
    for key in settings:
        if key not in known and inspect.Parameter.VAR_KEYWORD not in kinds:
            hint = nearest(key, known) if known else "it takes the capture alone"
            raise PzcapError(f"estimator={name}: takes no setting '{key}'; {hint} {GUIDE}")
    return settings


def source(name: str) -> Path | None:
    """The file in which the estimator ``module:function`` stands, without running it; None where there is none."""
    try:
        spec = importlib.util.find_spec(name.partition(":")[0])
    except (ImportError, ValueError):
        return None
    return None if spec is None or spec.origin is None or not spec.has_location else Path(spec.origin)


def estimate(estimator: Estimator, capture: Capture, name: str) -> Reconstruction:
    """Result of ``estimator`` on ``capture``, as a reconstruction in which all that it does not estimate is missing.

    ``name`` is what the result and the messages call it. PzcapError, in one line, for what is not an estimate.
    """
    found, where = estimator(capture), f"estimator {name}"
    whole = found if isinstance(found, Reconstruction) else _nothing_but(found, capture, name, where)
    names, frames = tuple(camera.name for camera in capture.cameras), len(whole.timecodes)
    parts = {key: len(getattr(whole, key)) for key in ("references", "cameras", "panoramas", "tracks", "refined")}
    if whole.camera_names != names or any(count != len(names) for count in parts.values()):
        raise PzcapError(f"{where}: has cameras {whole.camera_names} and {parts}; the capture has {names} {GUIDE}")
    return replace(
        whole,
        tracks=tuple(
            None if track is None else _checked(track, frames, f"{where}: track of camera {camera}")
            for camera, track in zip(names, whole.tracks, strict=True)
        ),
        motion=None if whole.motion is None else _checked(whole.motion, frames, f"{where}: motion"),
    )


def evaluate(estimator: Estimator, capture: Path, truth: Truth, name: str) -> tuple[Reconstruction, list[Metric]]:
    """``estimator`` on the capture folder ``capture``, and every metric that ``truth`` allows."""
    reconstruction = estimate(estimator, read_capture(capture), name)
    return reconstruction, metrics(score(reconstruction, truth, None))


def _nothing_but(found: Any, capture: Capture, name: str, where: str) -> Reconstruction:
    """A reconstruction of ``capture`` that holds the tracks or the motion in ``found``, and nothing else."""
    nothing = replace(unfound(capture, name), notes=(f"estimated by {name}",))
    if isinstance(found, Motion):
        return replace(nothing, motion=found)
    strange, count = _not_a_track(found), len(capture.cameras)
    if strange is not None:
        raise PzcapError(
            f"{where} returned a {strange}; return a PanZoomTrack a camera, a Motion, or a Reconstruction {GUIDE}"
        )
    if len(found) != count:
        raise PzcapError(f"{where}: {len(found)} tracks for {count} cameras; give None for one not found {GUIDE}")
    return replace(nothing, tracks=tuple(found))


def unfound(capture: Capture, method: str) -> Reconstruction:
    """A reconstruction of ``capture`` in which nothing has been found."""
    none: tuple[None, ...] = (None,) * len(capture.cameras)
    return Reconstruction(
        capture_name=capture.name,
        method=method,
        frame_rate=capture.frame_rate,
        timecodes=frame_sets(capture).timecodes,
        camera_names=tuple(camera.name for camera in capture.cameras),
        references=none,
        cameras=none,
        panoramas=none,
        tracks=none,
        refined=none,
        motion=None,
        notes=(),
    )


def _not_a_track(found: Any) -> str | None:
    """Description of ``found``, where it is no sequence of tracks."""
    kind = type(found).__name__
    if not isinstance(found, Sequence) or isinstance(found, str):
        return kind
    strange = [type(item).__name__ for item in found if not isinstance(item, PanZoomTrack | None)]
    return f"{kind} with a {strange[0]} in it" if strange else None


def _checked(part: T, frames: int, where: str) -> T:
    """``part`` with arrays of the right type. PzcapError where a shape is wrong or a valid number not finite."""
    arrays: dict[str, Any] = {}
    for name, (first, *inner) in SHAPES[Motion if isinstance(part, Motion) else PanZoomTrack].items():
        if first != "F":  # not a value a frame set
            continue
        try:
            array: NDArray[Any] = np.array(getattr(part, name), _KINDS.get(name, np.float64))
        except (TypeError, ValueError) as error:
            raise PzcapError(f"{where}: {name} is no array of numbers {GUIDE}") from error
        if array.shape != (shape := (frames, *inner)):
            raise PzcapError(f"{where}: {name} has shape {array.shape}, not {shape}: {frames} frame sets {GUIDE}")
        arrays[name] = array
    for name, array in arrays.items():
        if not np.isfinite(array[arrays["valid"]]).all():
            raise PzcapError(f"{where}: {name} is not finite where valid; set valid to False there {GUIDE}")
        array[~arrays["valid"]] = np.nan_to_num(array[~arrays["valid"]])
    if isinstance(part, Motion):
        arrays["keyframes"] = _keyframes(part.keyframes, frames, where)
    return replace(part, **arrays)


def _keyframes(found: Any, frames: int, where: str) -> NDArray[np.int64]:
    keyframes = np.asarray(found, np.int64)
    if keyframes.ndim != 1 or np.any((keyframes < 0) | (keyframes >= frames)):
        raise PzcapError(f"{where}: keyframes are not indices of its {frames} frame sets {GUIDE}")
    return keyframes
