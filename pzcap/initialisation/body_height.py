"""Height of the athlete in the cameras' units of length, and the cameras' places once more, from the contours of some
frames.

The body is fitted to the silhouettes of frames from all over the take, its pose in each, its shape (lengths, size and
skin, `pzcap.body.shape_estimation`) common to all, in turns until both stay. Of a body whose size is open the contours
tell it to half a percent: soles and vertex are seen, whatever a detector means by a hip.

Contours are finer than keypoints, so that they also move the cameras, each by a twist ``e`` about the world's origin
that all its frames share. A view shows all segments moved by it: from their normal equations ``H_s, g_s`` follow

    E = sum_t sum_s A_t' H_s A_t      C_t = sum_s T_s' H_s A_t
    (E - sum_t C_t' H_t^-1 C_t) e = g - sum_t C_t' H_t^-1 g_t

with ``A_t`` from the origin to the body, ``T_s`` from a pose's step to a segment's twist, and the poses eliminated.
Keypoints are a prior (`camera_poses`); what is common to all cameras stays.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from pzcap.body.kinematics import difference, screws
from pzcap.body.segment_equations import lift
from pzcap.body.shape_estimation import Shape, ShapeEstimate
from pzcap.body.skeleton import MOVES, Body
from pzcap.initialisation import pose_fit
from pzcap.initialisation.camera_poses import Heads
from pzcap.initialisation.limb_poses import pose_of_points
from pzcap.initialisation.people import Sighting
from pzcap.initialisation.triangulation import rays_of, triangulate
from pzcap.initialisation.tuning import HEIGHT, JUDGEMENT, PEOPLE
from pzcap.tracking.body_estimate import BodyEstimate
from pzcap.tracking.interval_solver import fit_keyframe, misplaced
from pzcap.tracking.keyframes import information
from pzcap.tracking.keypoint_residuals import LandmarkEstimate
from pzcap.tracking.observation import ViewInput, Views, crop_view
from pzcap.tracking.pose_objective import PoseObjective, sum_of
from pzcap.tracking.settings import TrackingConfig
from pzcap.tracking.skin_colour_model import SkinColourModel
from pzcap.types import PARENTS, SEGMENTS, Array, Indices, Keyframe, MovedBody, Pose

Observe = Callable[[Keyframe], Sequence[ViewInput | None]]
"""The views of a keyframe's instant, the athlete cut out where the keyframe has the body."""


@dataclass(frozen=True, slots=True, eq=False)
class SeenHeight:
    """Height of the athlete over that of a body."""

    ratio: float
    sigma: float
    frames: tuple[int, ...]  # that it was seen in
    moves: Array  # (C, 4, 4) of the cameras, in the world that they were in


def standing_height(offsets_m: Array, skin_m: Array, skin_segment: Indices) -> float:
    """From the soles to the top of the head of a body that stands upright, its joints (16, 3) in their parents' frames
    and its skin (V, 3) in those of its segments."""
    height_m = np.zeros(len(SEGMENTS))
    for s, parent in enumerate(PARENTS):
        if parent >= 0:
            height_m[s] = height_m[parent] + offsets_m[s, 2]
    return float(np.ptp(height_m[skin_segment] + skin_m[:, 2]))


def height_of(body: Body) -> float:
    """Standing height of a body, metres."""
    return standing_height(body.offsets_m, body.surface.points_m, body.surface.segment)


def height_of_moved(body: MovedBody) -> float:
    """Standing height of the body of a motion, metres."""
    return standing_height(body.offsets_m, body.skin_m, body.skin_segment)


def seen_height(
    body: Body, sightings: Sequence[tuple[int, Sighting]], observe: Observe, heads: Heads, config: TrackingConfig
) -> SeenHeight | None:
    """Height by the contours of the best frames among the ``sightings``, each with its number, of a ``body`` whose size
    is open, and how the cameras on ``heads`` have to be moved; None where too few bear the keypoints out."""
    keys = _keys(body, sightings, config)
    seen = [(key, observe(key)) for key in keys]
    base = ShapeEstimate.of(body)
    amounts = base.amounts_m
    still = np.zeros((len(SEGMENTS), 6))
    used: list[int] = []
    moves = np.tile(np.eye(4), (len(heads.place), 1, 1))
    for number in range(HEIGHT.rounds):
        shape = replace(base, amounts_m=amounts)
        now = replace(shape.body(amounts), landmarks=body.landmarks)
        known = Shape(amounts, np.zeros(len(SEGMENTS)))
        estimate = BodyEstimate(now, shape, known, LandmarkEstimate.of(body.landmarks))
        used, following = [], []
        equations_of_cameras = CameraEquations(len(moves))
        for key, inputs in seen:
            crops = [
                None if view is None else crop_view(now, view, key.pose, config.cut_out_margin, SkinColourModel())
                for view in inputs
            ]
            if sum(crop is not None for crop in crops) < JUDGEMENT.least_views:
                continue
            fit, _ = fit_keyframe(now, key, crops, still, config)
            following.append((replace(key, pose=fit.pose), inputs))
            equations_of_cameras.accumulate(now, key, fit.pose, crops, config)
            if number < HEIGHT.rounds - 1 or float(misplaced(fit.contour).max()) < JUDGEMENT.misplaced:
                estimate = estimate.with_keyframe(key, fit.pose, crops, still, config)
                used.append(key.frame)
        steps = equations_of_cameras.solve(heads, moves)
        moves = steps @ moves
        seen = [(key, tuple(map(_moved, inputs, steps))) for key, inputs in following]
        if len(used) < HEIGHT.fewest:
            return None
        equations = estimate.shape.equations
        amounts = np.asarray(np.linalg.solve(equations.information, equations.vector))
    usual = height_of(body)
    changes = np.eye(len(amounts)) * HEIGHT.step_m
    slope = np.array([height_of(base.body(amounts + change)) for change in changes]) - height_of(base.body(amounts))
    slope /= HEIGHT.step_m
    variance = float(slope @ np.linalg.solve(equations.information, slope))
    sigma = float(np.hypot(np.sqrt(variance) / usual, HEIGHT.sigma))
    return SeenHeight(height_of(base.body(amounts)) / usual, sigma, tuple(used), moves)


def _moved(view: ViewInput | None, step: Array) -> ViewInput | None:
    if view is None:
        return None
    return replace(view, camera=replace(view.camera, world_T_cam=step @ view.camera.world_T_cam))


class CameraEquations:
    """Normal equations of the cameras' twists, the poses eliminated."""

    def __init__(self, cameras: int) -> None:
        self._information, self._vector = np.zeros((6 * cameras, 6 * cameras)), np.zeros(6 * cameras)

    def accumulate(self, body: Body, key: Keyframe, pose: Pose, views: Views, config: TrackingConfig) -> None:
        """Add the contours of a keyframe whose pose was fitted to the views."""
        objective = PoseObjective(body, views, np.zeros((len(SEGMENTS), 6)))
        posed, placed = objective.place(pose)
        last = config.schedule[-1].terms
        terms = replace(last, contour_weight=config.shape_weight * last.contour_weight, keypoint_weight=0.0)
        every = objective.by_view(posed, placed, terms)
        prior = config.shape_weight * information(key, config)
        twists = screws(posed.frames, posed.centre)  # (43, 6)
        hessian, gradient = lift(sum_of(every), twists)
        hessian, gradient = hessian + prior, gradient + prior @ difference(key.pose, pose)
        about = np.eye(6)
        x, y, z = posed.centre
        about[:3, 3:] = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])  # w x c
        cross = np.zeros((len(gradient), len(self._vector)))
        for c, (view, sums) in enumerate(zip(views, every, strict=True)):
            if view is None:
                continue
            part = slice(6 * c, 6 * c + 6)
            self._information[part, part] += about.T @ sums.hessians.sum(axis=0) @ about
            self._vector[part] += about.T @ sums.gradients.sum(axis=0)
            for d in range(len(gradient)):
                cross[d, part] = twists[d] @ sums.hessians[MOVES[d]].sum(axis=0) @ about
        eliminated = np.linalg.solve(hessian, np.column_stack([cross, gradient]))
        self._information -= cross.T @ eliminated[:, :-1]
        self._vector -= cross.T @ eliminated[:, -1]

    def solve(self, heads: Heads, moves: Array) -> Array:
        """Moves (C, 4, 4) of the cameras beyond the ``moves`` so far; of heads that were not placed, none."""
        free = np.repeat(heads.placed, 6)
        jacobian = np.zeros((len(free), len(free)))  # of turn in the head and place, by the twist
        so_far = np.zeros(len(free))
        common = np.zeros((len(free), 7))
        for c, (rotation, place) in enumerate(zip(heads.rotation, heads.place, strict=True)):
            part = slice(6 * c, 6 * c + 6)
            x, y, z = place
            own = np.zeros((6, 6))
            own[:3, 3:], own[3:, :3] = -rotation.T, -np.eye(3)
            own[3:, 3:] = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])  # t x w
            jacobian[part, part] = own
            turned = Rotation.from_matrix(moves[c, :3, :3]).as_rotvec()
            so_far[part] = [*rotation.T @ turned, *(moves[c, :3, :3] @ place + moves[c, :3, 3] - place)]
            common[part, :6], common[part.start : part.start + 3, 6] = np.eye(6), place
        known = np.linalg.pinv(heads.covariance, rcond=HEIGHT.rank, hermitian=True)
        normal = (self._information + jacobian.T @ known @ jacobian)[np.ix_(free, free)]
        right = (self._vector - jacobian.T @ known @ so_far)[free]
        basis, _ = np.linalg.qr(common[free])
        rest = np.eye(len(basis)) - basis @ basis.T
        held = rest @ normal @ rest + np.trace(normal) * basis @ basis.T
        twist = np.zeros(len(free))
        twist[free] = rest @ np.linalg.solve(held, rest @ right)
        found = np.tile(np.eye(4), (len(moves), 1, 1))
        for c, (shift, turn) in enumerate(twist.reshape(-1, 2, 3)):
            found[c, :3, :3] = Rotation.from_rotvec(-turn).as_matrix()
            found[c, :3, 3] = -shift
        return found


def _keys(body: Body, sightings: Sequence[tuple[int, Sighting]], config: TrackingConfig) -> list[Keyframe]:
    """The best-fitting frame of each of some equal parts of the take."""
    best: dict[int, tuple[float, Keyframe]] = {}
    for number in np.unique(np.linspace(0, len(sightings) - 1, HEIGHT.tried).round().astype(int)).tolist():
        frame, seen = sightings[number]
        views = [view for view in seen if view is not None]
        if len(views) < JUDGEMENT.least_views:
            continue
        met = triangulate(rays_of(views, PEOPLE.least_confidence), PEOPLE.agree_m)
        start = pose_of_points(met.points_m, met.found)
        if start is None:
            continue
        [pose] = pose_fit.fit(body, [seen], [start], config)
        known = pose_fit.known(body, pose, seen, config)
        part = number * HEIGHT.frames // len(sightings)
        if known.misfit < JUDGEMENT.largest_misfit and known.misfit < best.get(part, (np.inf, None))[0]:
            best[part] = known.misfit, Keyframe(frame, pose, known.covariance, found=True)
    return [key for _, key in best.values()]
