"""What the page is told: the drawn body, clicks and their errors, the state of the whole, as JSON."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from pzcap.body.kinematics import forward, place
from pzcap.body.skeleton import Body
from pzcap.editor.edits import ORIGINS
from pzcap.editor.footage import outlines
from pzcap.editor.inverse_kinematics import HANDLES, SEGMENT, Click, Problem, epipolar, handle_name
from pzcap.editor.tuning import SHOWING
from pzcap.editor.workspace import Dragged, Workspace
from pzcap.extras import keyframe_diagnostics
from pzcap.extras.keyframe_diagnostics import PARTS, Suggestion
from pzcap.geometry.pinhole import projected
from pzcap.tracking import keyframes, visibility
from pzcap.tracking.visibility import GROUP
from pzcap.types import JOINTS, PARENTS, Array, Camera, Keyframe, Motion, Pose, PzcapError

Json = dict[str, Any]


def about(space: Workspace) -> Json:
    """What does not change while the page is open."""
    found = space.footage.found
    return {
        "name": space.capture.name, "folder": str(space.capture.folder), "frames": len(space.sets),
        "timecodes": list(space.sets.timecodes), "cameras": list(found.camera_names),
        "sizes": [None if head is None else [head.lens.width, head.lens.height] for head in found.cameras],
        "handles": [handle_name(n) for n in range(len(HANDLES))], "joints": len(JOINTS),
        "parents": [*PARENTS, *SEGMENT[len(JOINTS) :].tolist()],  # that a line joins each handle to
    }  # fmt: skip


def frame(space: Workspace, number: int) -> Json:
    """All that is drawn of a frame."""
    with space.lock:
        version, edit, problem = space.version, space.edit(number), space.problem(number)
    out: Json = {
        "frame": number, "version": version,
        "origin": edit.origin, "told_origin": ORIGINS[edit.origin], "is_key": edit.is_key,
        "hidden": sorted(edit.hidden), "found": [camera is not None for camera in problem.cameras],
        "clicks": [], "notes": [], "sigma_mm": [], "before": None,
    }  # fmt: skip
    if edit.pose is None:
        empty = [None] * len(HANDLES)
        return out | {"handles": [empty for _ in problem.cameras], "outlines": [[] for _ in problem.cameras]}
    sigma = space.sigma_m(number, problem, edit)
    out |= _body(problem, edit.pose)
    out |= {
        "clicks": _clicks(problem, edit.pose, edit.clicks),
        "sigma_mm": np.rint(1000.0 * sigma).astype(int).tolist(),
        "notes": [text.partition(": ")[2] for text in keyframes.check([Keyframe(number, edit.pose)], space.body)],
    }  # fmt: skip
    change = space.difference
    if change is not None and number in change.frames and change.before.valid[number]:
        out["before"] = _body(problem, change.before.pose(number))["handles"]
    return out


def drag(space: Workspace, dragged: Dragged) -> Json:
    """The body while it is dragged, and where the dragged handle can be in the other views."""
    problem, own = space.problem(dragged.frame), dragged.click.camera
    camera, pixel = problem.cameras[own], np.array([dragged.click.x, dragged.click.y])
    lines: list[list[list[float]]] = [
        [] if camera is None or other is None or number == own else _rounded(epipolar(camera, pixel, other))
        for number, other in enumerate(problem.cameras)
    ]
    clicks = _clicks(problem, dragged.pose, dragged.clicks)
    return _body(problem, dragged.pose) | {"clicks": clicks, "lines": lines}


def warm_up(space: Workspace) -> None:
    """Look at a frame and drag a joint, for nothing: kernels are compiled, or loaded, when they are called first, and
    nothing else is done meanwhile."""
    with contextlib.suppress(PzcapError):  # footage that is damaged is told of where it is looked at
        silhouettes(space, 0)
    for number, camera in enumerate(space.footage.cameras(0)):
        if camera is not None and space.edit(0).pose is not None:
            click = Click(0, number, camera.width / 2, camera.height / 2, 1.0)
            drag(space, space.drag(0, click, None))
            return


def silhouettes(space: Workspace, number: int) -> list[list[list[list[float]]]]:
    """Outlines of the athlete in each view of a frame, as the footage tells them."""
    edit = space.edit(number)
    pose = None if edit.origin == "standing" and not edit.clicks else edit.pose
    views = space.footage.views(number, space.body, pose)
    return [
        [] if view is None else [_rounded(line) for line in outlines(view.silhouette.probability > 127)]
        for view in views
    ]


def overview(space: Workspace) -> Json:
    """The state of the whole, for the lists and the line of time."""
    with space.lock:
        keys, motion, change = space.keys(), space.motion, space.difference
        out: Json = {
            "version": space.version, "keys": keys, "touched": space.touched(),
            "can_undo": space.history.can_undo, "can_redo": space.history.can_redo,
            "by_keypoints": space.by_keypoints,
        }  # fmt: skip
    sigma = np.where(motion.valid, 1000.0 * motion.sigma_m.max(axis=1), -1.0)
    out |= {"sigma_mm": np.rint(sigma).astype(int).tolist(), "suggested": _suggested(motion, keys)}
    if change is not None:
        moved, frames = 1000.0 * change.moved_m, change.frames
        worst = int(moved.max(axis=1).argmax())
        out["difference"] = {
            "first": frames.start, "last": frames.stop - 1, "known_before": change.known_before,
            "moved_mm": np.rint(moved.max(axis=1)).astype(int).tolist(),
            "mean_mm": round(float(moved.mean()), 1), "worst_mm": round(float(moved.max()), 1),
            "worst": f"{handle_name(int(moved[worst].argmax()))} in frame {frames.start + worst}",
            "sigma_before_mm": _median_mm(change.before, frames), "sigma_after_mm": _median_mm(motion, frames),
            "tracked": int(motion.valid[frames].sum()),
        }  # fmt: skip
    return out


def _suggested(motion: Motion, keys: Sequence[int]) -> list[Json]:
    """Frames to pose next, the best first, and why."""
    posed = [key for key in keys if key not in motion.keyframes]
    best = keyframe_diagnostics.suggestions(motion, posed, SHOWING.suggested) or _least_certain(motion, keys)
    if best:
        return [{"frame": one.frame, "why": f"{one.part} least certain"} for one in best]
    found: list[Json] = []
    last, known = len(motion.valid) - 1, set(keys)
    while len(found) < SHOWING.suggested:
        ends = [end for end in (0, last) if end not in known]
        gaps = [(b - a, -a, b) for a, b in pairwise(sorted(known)) if b - a > 1]
        if ends:
            number, why = ends[0], "an end of the take"
        elif gaps:
            gap, a, _ = max(gaps)
            number, why = gap // 2 - a, "in the longest gap"
        else:
            break
        found.append({"frame": number, "why": why})
        known.add(number)
    return found


def _least_certain(motion: Motion, keys: Sequence[int]) -> list[Suggestion]:
    """The least certain frames of a motion that was tracked from no keyframe of a hand, each with its surroundings;
    none where nobody was tracked."""
    if not motion.valid.any():
        return []
    variance = np.where(motion.valid[:, None], motion.sigma_m**2, 1.0)  # (F, 16); a metre, where nobody was tracked
    around = np.ones(2 * SHOWING.helped + 1)
    sums = np.array([np.convolve(joint, around)[SHOWING.helped : len(joint) + SHOWING.helped] for joint in variance.T])
    frames, found, gains = np.arange(len(variance)), list[Suggestion](), sums.sum(axis=0)
    for key in keys:
        gains[np.abs(frames - key) <= SHOWING.helped] = 0.0
    while len(found) < SHOWING.suggested and gains.any():
        best = int(gains.argmax())
        part = max(PARTS, key=lambda name: float(sums[list(PARTS[name]), best].mean()))
        found.append(Suggestion(best, part))
        gains[np.abs(frames - best) <= 2 * SHOWING.helped] = 0.0
    return found


def _body(problem: Problem, pose: Pose) -> Json:
    """The handles, and the outlines of the body, in each view."""
    world, (skin, _) = problem.handles(pose), place(problem.body, forward(problem.body, pose))
    handles: list[list[list[float] | None]] = []
    for camera in problem.cameras:
        seen: list[list[float] | None] = [None] * len(HANDLES)
        if camera is not None:
            pixels, depth = projected(world, camera)
            places = zip(pixels.tolist(), depth.tolist(), strict=True)
            seen = [[round(x, 2), round(y, 2)] if ahead > 0 else None for (x, y), ahead in places]
        handles.append(seen)
    lines = [[] if camera is None else list(_outline(problem.body, skin, camera)) for camera in problem.cameras]
    return {"handles": handles, "outlines": lines}


def _outline(body: Body, skin: Array, camera: Camera) -> Iterator[list[list[float]]]:
    pixels, depth = projected(skin, camera)
    box = visibility.bounds(pixels, depth)
    if box is None:
        return
    size = np.array([camera.width, camera.height])
    low, high = (np.clip(corner, -size, 2 * size) for corner in box)
    scale = max(float(np.max(high - low)) / SHOWING.outline_px, 0.05)
    left, top = np.floor(low - 2.0 * scale).astype(int).tolist()
    width, height = np.ceil(high - [left, top] + 3.0 * scale).astype(int).tolist()
    buffer = visibility.empty_z_buffer((left, top, width, height), scale)
    visibility.rasterise(pixels, depth, body.surface.faces, GROUP[body.surface.segment], buffer)
    for line in outlines(np.isfinite(buffer.depth)):
        yield _rounded(np.array([left, top]) + scale * line)


def _clicks(problem: Problem, pose: Pose, clicks: Sequence[Click]) -> list[list[float]]:
    """Clicks as the page has them: handle, camera, x, y, sigma, and by how many pixels the pose misses them."""
    world, out = problem.handles(pose), []
    seen = [None if camera is None else projected(world, camera)[0] for camera in problem.cameras]
    for one in clicks:
        pixels = seen[one.camera]
        off = 0.0 if pixels is None else float(np.hypot(*(pixels[one.handle] - [one.x, one.y])))
        out.append([one.handle, one.camera, round(one.x, 2), round(one.y, 2), round(one.sigma_px, 2), round(off, 1)])
    return out


def _rounded(points: Array) -> list[list[float]]:
    rounded: list[list[float]] = np.round(points, 1).tolist()
    return rounded


def _median_mm(motion: Motion, frames: range) -> float | None:
    valid = motion.valid[frames]
    return round(1000.0 * float(np.median(motion.sigma_m[frames][valid])), 1) if valid.any() else None
