"""The parallax assistant: how to slide the camera on its slide head until it pans about its projection centre.

Section 3.3: when projection centre and pan axis align, what is near stays before the same background however the head
is turned. Here a short pan over something near and something far, both at distances that a tape gives, says how far
the two still are apart. Features are tracked over the pan; each has a direction (azimuth, slope) from the axis and an
inverse distance ``q``. Seen from the centre, ``offset`` (forward, left) beside the axis of a head panned by ``pan``,
it stands in the direction of

    (cos(a - pan) - q forward,  sin(a - pan) - q left,  h)

which to first order is `pzcap.camera.parallax`. Pans, focal length, tilt, roll, principal point and distortion are
estimated along with the offset, by robust least squares.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pzcap import camera as geometry
from pzcap import features
from pzcap.camera import View
from pzcap.features import Features
from pzcap.sweep import grey
from pzcap.types import Array, Image, Mask, PzcapError

MIN_TRACKS = 12  # of what is near, and of what is far
FIELD_WIDTHS = 1.2  # focal length, in image widths, where nobody knows it
LENS_SIGMAS = (0.2, 0.2, 0.01, 0.01, 0.1)  # tilt, roll, principal point (x, y; image widths), k1
OFFSET_SIGMA_M = 0.3  # a camera further off is not on the head
TOLD_APART = 3.0  # standard deviations within the near and the far features, between their means
START_SCALE_PX, LOOSE_PX, LEAST_SCALE_PX = 8.0, 4.0, 0.5  # of the robust weights: at first; for sorting; at last
ITERATIONS = 20
EDGE = 0.03  # image widths about the border of the crew's box, where nobody knows what is near
CLEARLY = 3.0  # sigmas by which a feature must contradict the crew
SHARED = 8  # log focal, tilt, roll, principal point, k1, offset


@dataclass(frozen=True, slots=True)
class SlideConfig:
    threshold: float = 2e-4  # of AKAZE's response
    features: int = 1500  # a frame, at most
    ratio: float = 0.8  # of Lowe's test
    frames: int = 12  # of the pan, at most
    distance_sigma: float = 0.03  # of the distances that the crew measured, relative
    depth: float = 0.05  # how deep the near object is; relative standard deviation
    far_depth: float = 0.4  # and what is behind it
    focal_sigma: float = 0.3  # of log focal


@dataclass(frozen=True, slots=True, eq=False)
class Tracks:
    """Features followed over a pan: N observations of T features in F frames."""

    track: NDArray[np.int64]  # (N,)
    frame: NDArray[np.int64]  # (N,)
    points_px: Array  # (N, 2)


@dataclass(frozen=True, slots=True, eq=False)
class Slide:
    """What to do with the slide head."""

    slide_m: Array  # (2,) how far to slide the camera forward and to the left; the parallax is then gone
    covariance_m2: Array  # (2, 2)
    pan_rad: Array  # (F,) of the frames used; the first is 0
    focal_px: float
    residual_px: float  # RMS of one coordinate of the inliers
    tracks: Tracks
    near: Mask  # (T,) on the near object
    far: Mask  # (T,) behind it; what is neither, nobody could tell
    parallax_px: Array  # (T, 2) what each feature moved by, first to last seen, against something far behind it

    @property
    def sigma_m(self) -> Array:
        """(2,) Standard deviations of ``slide_m``."""
        return np.sqrt(np.diag(self.covariance_m2))

    @property
    def aligned(self) -> bool:
        """Whether this pan cannot tell the camera's place from the right one."""
        return bool((np.abs(self.slide_m) < 2.0 * self.sigma_m).all())

    @property
    def sentence(self) -> str:
        """What to do, in words."""
        parts = [
            f"{1000 * abs(way):.1f} +- {1000 * sigma:.1f} mm {words[int(way < 0)]}"
            for way, sigma, words in zip(
                self.slide_m, self.sigma_m, (("forward", "back"), ("to the left", "to the right")), strict=True
            )
        ]
        advice = "slide the camera " + " and ".join(parts)
        return advice + (" (as far as this pan can tell, it is right already)" if self.aligned else "")


def advise(
    frames: Iterable[Image],
    near_m: float,
    far_m: float,
    *,
    near_box_px: tuple[float, float, float, float] | None = None,
    focal_px: float | None = None,
    config: SlideConfig | None = None,
) -> Slide:
    """How to slide the camera, from the frames (H, W[, 3]) of a short pan.

    ``near_m`` and ``far_m`` are horizontal distances from the head. ``near_box_px`` (left, top, right, bottom) is where
    the near object stands in the middle frame; without it the features are told apart by how they move, and those that
    take up less of the width are taken for the near ones. Some are then mistaken, which the sigmas do not know of: in
    one of thirty draws of a test the error was 3.4 sigmas, with a box never more than 3. Raises PzcapError where too
    little is seen of either, or they cannot be told apart.
    """
    config = config or SlideConfig()
    images = list(frames)
    if len(images) < 3:
        raise PzcapError(f"pan: {len(images)} frames are too few; pan over the near and the far object once")
    chosen = np.unique(np.round(np.linspace(0, len(images) - 1, config.frames)).astype(int))
    height, width = images[0].shape[:2]
    found = [features.detect(grey(images[i]), config.threshold, config.features) for i in chosen]
    focal = FIELD_WIDTHS * width if focal_px is None else focal_px
    view = View(0.0, 0.0, 0.0, focal, np.array([(width - 1) / 2, (height - 1) / 2]), 0.0)
    tracks, pan_rad = follow(found, view, config.ratio)
    return solve(tracks, pan_rad, view, width, near_m, far_m, near_box_px=near_box_px, config=config)


def follow(found: Sequence[Features], view: View, ratio: float) -> tuple[Tracks, Array]:
    """Features followed over the frames of a pan, and first values of the pans (F,). PzcapError if it has a gap."""
    counts = np.array([len(each) for each in found])
    first_of = np.concatenate([[0], np.cumsum(counts)])
    parent = np.arange(first_of[-1])

    def root(node: int) -> int:
        while parent[node] != node:
            parent[node] = parent[parent[node]]
            node = int(parent[node])
        return node

    def join(first: int, second: int, pairs: NDArray[np.int64]) -> None:
        for i, j in pairs:
            parent[root(int(first_of[first] + i))] = root(int(first_of[second] + j))

    pan = np.zeros(len(found))
    for second in range(1, len(found)):
        pairs, turn = _pairs(found[second - 1], found[second], view, ratio)
        if len(pairs) < MIN_TRACKS:
            raise PzcapError(
                f"pan: frames {second - 1} and {second} of the {len(found)} used show nothing in common; "
                "pan more slowly, or over less"
            )
        pan[second] = pan[second - 1] + turn
        join(second - 1, second, pairs)
    for first in range(len(found)):
        for second in range(first + 2, len(found)):
            pairs, turn = _pairs(found[first], found[second], view, ratio)
            chained = pan[second] - pan[first]
            if abs(turn - chained) < 0.02 + 0.1 * abs(chained):
                join(first, second, pairs)
    roots = np.array([root(node) for node in range(len(parent))])
    frame = np.repeat(np.arange(len(found)), counts)
    _, track, size = np.unique(roots, return_inverse=True, return_counts=True)
    # a track that holds two features of one frame is a muddle of several things
    twice = np.zeros(len(size), bool)
    _, where, times = np.unique(np.stack([track, frame]), axis=1, return_index=True, return_counts=True)
    twice[track[where[times > 1]]] = True
    kept = (size >= 3) & ~twice
    keep = kept[track]
    _, numbered = np.unique(track[keep], return_inverse=True)
    points = np.concatenate([each.points_px for each in found])
    return Tracks(numbered, frame[keep], points[keep]), pan


def _pairs(first: Features, second: Features, view: View, ratio: float) -> tuple[NDArray[np.int64], float]:
    """Pairs (N, 2) of features that agree roughly on one pan between the frames, and that pan."""
    pairs = features.match(first, second, ratio)
    if len(pairs) < MIN_TRACKS:
        return pairs[:0], 0.0
    azimuth_a, slope_a = geometry.look(view, first.points_px[pairs[:, 0]])
    azimuth_b, slope_b = geometry.look(view, second.points_px[pairs[:, 1]])
    turn = azimuth_a - azimuth_b
    middle = float(np.median(turn[features.densest(turn, 8.0 / view.focal_px)]))
    # what is near moves otherwise than what is far; focal length, tilt and distortion are not known yet
    agree = (np.abs(turn - middle) < 0.05 + 0.1 * abs(middle)) & (np.abs(slope_a - slope_b) < 0.04 + 0.1 * abs(middle))
    return pairs[agree], middle


# --------------------------------------------------------------------------------------------------------------
# The adjustment


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    pan_rad: Array  # (F,)
    view: View  # at pan 0
    offset_m: Array  # (2,)
    points: Array  # (T, 3) azimuth, slope, inverse distance

    def shared(self) -> Array:
        """(8,) log focal, tilt, roll, principal point, k1, offset."""
        view = self.view
        return np.array([
            np.log(view.focal_px), view.tilt_rad, view.roll_rad, *view.principal_px, view.k1, *self.offset_m
        ])  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class _Priors:
    shared: Array  # (8,)
    sigmas: Array  # (8,)
    nearness: Array  # (T,) inverse distance of each feature
    nearness_sigma: Array  # (T,)
    known: Mask  # (T,) near or far; what may be either would fit noise the better the larger the offset


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    state: _State
    spread_px: float  # of one coordinate
    covariance: Array  # (2, 2) of the offset


def solve(
    tracks: Tracks,
    pan_rad: Array,
    view: View,
    width: int,
    near_m: float,
    far_m: float,
    *,
    near_box_px: tuple[float, float, float, float] | None = None,
    config: SlideConfig | None = None,
) -> Slide:
    """The offset from tracked features, with first values ``pan_rad`` (F,) and ``view``. See `advise`."""
    config = config or SlideConfig()
    if not 0 < near_m <= 0.8 * far_m:
        raise PzcapError(f"near {near_m} m, far {far_m} m: the near object must be much nearer, best less than half")
    count = int(tracks.track.max(initial=-1)) + 1
    if count < 2 * MIN_TRACKS:
        raise PzcapError(f"pan: only {count} features could be followed; pan slowly over things with texture")
    state = _start(tracks, pan_rad, view, np.full(count, 1.0 / far_m))
    lens = np.array(LENS_SIGMAS) * np.array([1.0, 1.0, width, width, 1.0])
    sigmas = np.concatenate([[config.focal_sigma], lens, np.full(2, OFFSET_SIGMA_M)])
    believed = state.shared()

    def priors(near: Mask, far: Mask) -> _Priors:
        nearness = np.where(near, 1.0 / near_m, 1.0 / far_m)
        deep = nearness * np.where(near, config.depth, config.far_depth)
        return _Priors(believed, sigmas, nearness, deep, near | far)

    # first as if there were no parallax; what then moves against the rest is near
    everything, between = np.ones(count, bool), 0.5 / near_m + 0.5 / far_m
    still = replace(priors(~everything, everything), sigmas=np.concatenate([sigmas[:-2], np.full(2, 1e-9)]))
    fit = _adjust(tracks, state, still, LEAST_SCALE_PX)
    if near_box_px is None:
        # where about half of the features are near, loose weights tell them apart; where few are, tight ones
        fits = [fit, _adjust(tracks, state, still, LOOSE_PX)]
        starts = [(each, *groups) for each in fits if (groups := _moving(each, tracks)) is not None]
        if not starts:
            raise PzcapError(
                "pan: nothing moves clearly against the rest, so near and far cannot be told apart; either the camera "
                "sits right already, or say where the near object stands"
            )
        said = None
    else:
        said = _boxed(fit.state, len(pan_rad) // 2, near_box_px, EDGE * width)
        starts = [(fit, *said)]
    found: list[tuple[_Fit, Mask, Mask]] = []
    for fit, near, far in starts:
        for _ in range(6):
            _check(near, far)
            fit = _adjust(tracks, _placed(fit.state, priors(near, far)), priors(near, far), LOOSE_PX)
            again = _nearer(tracks, fit, between, said)
            if (again[0] == near).all() and (again[1] == far).all():
                break
            near, far = again
        _check(near, far)
        fit = _adjust(tracks, _placed(fit.state, priors(near, far)), priors(near, far), LEAST_SCALE_PX)
        found.append((fit, near, far))
    fit, near, far = min(found, key=lambda each: each[0].spread_px)
    # an error of the crew's tape is common to all
    q = np.array([1.0 / near_m, 1.0 / far_m])
    scale = config.distance_sigma * np.hypot(*q) / (q[0] - q[1])
    offset = fit.state.offset_m
    return Slide(
        -offset, fit.covariance + scale**2 * np.outer(offset, offset), fit.state.pan_rad, fit.state.view.focal_px,
        fit.spread_px, tracks, near, far, _parallax(tracks, fit.state, far_m),
    )  # fmt: skip


def _check(near: Mask, far: Mask) -> None:
    """Raise PzcapError unless enough features of either kind were followed."""
    for count, what in ((int(near.sum()), "near object"), (int(far.sum()), "background")):
        if count < MIN_TRACKS:
            raise PzcapError(
                f"pan: {count} features were followed on the {what}, {MIN_TRACKS} are needed; choose one with more "
                "texture, which passes from one side of the picture to the other, or say where the near object stands"
            )


def _start(tracks: Tracks, pan_rad: Array, view: View, nearness: Array) -> _State:
    """Each feature where its observations, on average, see it."""
    azimuth, slope = geometry.look(view, tracks.points_px)
    seen = np.bincount(tracks.track, minlength=len(nearness))
    azimuth = np.bincount(tracks.track, azimuth + pan_rad[tracks.frame]) / seen
    return _State(pan_rad, view, np.zeros(2), np.column_stack([
        azimuth, np.bincount(tracks.track, slope) / seen, nearness
    ]))  # fmt: skip


def _placed(state: _State, priors: _Priors) -> _State:
    """The state with every feature as far away as its kind is."""
    return replace(state, points=np.column_stack([state.points[:, :2], priors.nearness]))


def from_centre(
    azimuth_rad: Array, slope: Array, nearness: Array, pan_rad: Array, offset_m: Array
) -> tuple[Array, Array, Array]:
    """Directions (N,) from the pan axis, and inverse distances, as seen from the projection centre.

    Returns azimuth and slope (N, 2), their derivatives with respect to (azimuth, slope, inverse distance) (N, 2, 3)
    and to (pan, forward, left) (N, 2, 3).
    """
    alpha = azimuth_rad - pan_rad
    x, y = np.cos(alpha) - nearness * offset_m[0], np.sin(alpha) - nearness * offset_m[1]
    squared = x * x + y * y
    distance = np.sqrt(squared)
    seen = np.column_stack([pan_rad + np.arctan2(y, x), slope / distance])
    zero = np.zeros_like(alpha)
    # columns: azimuth, slope, inverse distance, forward, left
    d_x = np.column_stack([-np.sin(alpha), zero, np.full_like(alpha, -offset_m[0]), -nearness, zero])
    d_y = np.column_stack([np.cos(alpha), zero, np.full_like(alpha, -offset_m[1]), zero, -nearness])
    by = np.empty((len(alpha), 2, 5))
    by[:, 0] = (x[:, None] * d_y - y[:, None] * d_x) / squared[:, None]
    by[:, 1] = -(slope / distance**3)[:, None] * (x[:, None] * d_x + y[:, None] * d_y)
    by[:, 1, 1] += 1.0 / distance
    by_pan = -by[:, :, :1] + np.array([[1.0], [0.0]])
    return seen, by[:, :, :3], np.concatenate([by_pan, by[:, :, 3:]], axis=2)


def _linearised(tracks: Tracks, state: _State) -> tuple[Array, Array, Array, Array]:
    """Residuals (N, 2), and derivatives with respect to the pan (N, 2), to what is shared (N, 2, 8), to the point."""
    points, pan = state.points[tracks.track], state.pan_rad[tracks.frame]
    seen, by_point, by_motion = from_centre(points[:, 0], points[:, 1], points[:, 2], pan, state.offset_m)
    relative = seen[:, 0] - pan
    pixels, _ = geometry.see(state.view, relative, seen[:, 1])
    by_view, by_direction = geometry.derivatives(state.view, relative, seen[:, 1])
    to_pan = by_direction @ by_motion[:, :, :1]
    shared = np.concatenate([by_view[:, :, [2, 1, 3, 4, 5, 6]], by_direction @ by_motion[:, :, 1:]], axis=2)
    return pixels - tracks.points_px, by_view[:, :, 0] + to_pan[:, :, 0], shared, by_direction @ by_point


def _adjust(tracks: Tracks, state: _State, priors: _Priors, least_scale_px: float) -> _Fit:
    """Gauss-Newton with the features eliminated; weights of Geman and McClure (1987) as in `pzcap.bundle`.

    The covariance takes the errors of one feature for dependent on each other (a feature is found a little beside
    where it is in all frames alike): scores are summed a feature (Liang and Zeger, 1986), as they would be if it had
    not been fitted itself (Bell and McCaffrey, 2002).
    """
    frames, count = len(state.pan_rad), len(state.points)
    free = np.arange(1, frames + SHARED)  # the first frame's pan is 0
    information = np.concatenate([np.zeros(frames), priors.sigmas**-2.0])
    scale, spread, used = START_SCALE_PX, START_SCALE_PX, priors.known[tracks.track]
    for _ in range(ITERATIONS):
        residual, by_pan, by_shared, by_point = _linearised(tracks, state)
        length = np.hypot(*residual.T)
        weight = (scale**2 / (scale**2 + length**2)) ** 2 * used
        spread = max(float(np.median(length[used])) / 1.1774, 0.01)
        by_frame = np.zeros((len(residual), 2, frames + SHARED))
        by_frame[np.arange(len(residual)), :, tracks.frame] = by_pan
        by_frame[:, :, frames:] = by_shared
        weighted = by_frame * weight[:, None, None]
        normal = np.einsum("nij,nik->jk", weighted, by_frame) + np.diag(information) * spread**2
        gradient = np.einsum("nij,ni->j", weighted, residual)
        gradient[frames:] += spread**2 * (state.shared() - priors.shared) / priors.sigmas**2
        blocks, cross, slopes = np.zeros((count, 3, 3)), np.zeros((count, 3, frames + SHARED)), np.zeros((count, 3))
        turned = (by_point * weight[:, None, None]).transpose(0, 2, 1)
        np.add.at(blocks, tracks.track, turned @ by_point)
        np.add.at(cross, tracks.track, turned @ by_frame)
        np.add.at(slopes, tracks.track, (turned @ residual[:, :, None])[:, :, 0])
        loose = np.array([1e-6, 1e-6, 0.0])  # a feature without weight must not be singular
        blocks += np.eye(3) * loose
        blocks[:, 2, 2] += spread**2 / priors.nearness_sigma**2
        slopes[:, 2] += spread**2 * (state.points[:, 2] - priors.nearness) / priors.nearness_sigma**2
        inverse = np.linalg.inv(blocks)
        eliminated = cross.transpose(0, 2, 1) @ inverse  # (T, F + 8, 3)
        reduced = (normal - np.einsum("tij,tjk->ik", eliminated, cross))[np.ix_(free, free)]
        step = np.zeros(frames + SHARED)
        step[free] = -np.linalg.solve(reduced, (gradient - np.einsum("tij,tj->i", eliminated, slopes))[free])
        moved = -(inverse @ (slopes + cross @ step)[:, :, None])[:, :, 0]
        state = _stepped(state, step, moved)
        if np.abs(step[:frames]).max() < 1e-7 and np.abs(step[-2:]).max() < 1e-6:
            break
        scale = max(3.0 * spread, scale / 3.0, least_scale_px)
    scores = np.zeros((count, frames + SHARED))
    np.add.at(scores, tracks.track, np.einsum("nij,ni->nj", weighted, residual))
    scores -= (eliminated @ slopes[:, :, None])[:, :, 0]
    own = np.zeros((count, frames + SHARED, frames + SHARED))  # each feature's part of the reduced normal matrix
    np.add.at(own, tracks.track, weighted.transpose(0, 2, 1) @ by_frame)
    own = (own - eliminated @ cross)[:, free[:, None], free]
    bread = np.linalg.inv(reduced)
    # the weights fall with the residual, so that the cost curves less than they say (Huber, 1981)
    curving = np.sum(weight * (1.0 - 2.0 * length**2 / (scale**2 + length**2))) / np.sum(weight)
    left_out = np.linalg.solve(np.eye(len(free)) - own @ bread, scores[:, free, None])[:, :, 0]
    meat = left_out.T @ left_out + np.diag(information[free]) * spread**4
    covariance = bread @ meat @ bread / curving**2
    return _Fit(state, spread, np.asarray(covariance[-2:, -2:], np.float64))


def _stepped(state: _State, step: Array, moved: Array) -> _State:
    frames = len(state.pan_rad)
    log_focal, tilt, roll, x, y, k1 = step[frames : frames + 6]
    view = geometry.moved(state.view, np.array([0.0, tilt, np.clip(log_focal, -0.3, 0.3), roll, x, y, k1]))
    return _State(state.pan_rad + step[:frames], view, state.offset_m + step[-2:], state.points + moved)


# --------------------------------------------------------------------------------------------------------------
# What is near


def _along(tracks: Tracks, fit: _Fit, direction: Array) -> tuple[Array, Array]:
    """How far (T,) each feature's observations want to go along ``direction`` (N, 2), its azimuth and slope being
    free, and the standard deviations."""
    residual, _, _, by_point = _linearised(tracks, fit.state)
    basis = np.concatenate([by_point[:, :, :2], direction[:, :, None]], axis=2)
    blocks, slopes = np.zeros((len(fit.state.points), 3, 3)), np.zeros((len(fit.state.points), 3))
    np.add.at(blocks, tracks.track, basis.transpose(0, 2, 1) @ basis)
    np.add.at(slopes, tracks.track, (basis.transpose(0, 2, 1) @ residual[:, :, None])[:, :, 0])
    inverse = np.linalg.inv(blocks + np.eye(3) * 1e-9)
    return -(inverse @ slopes[:, :, None])[:, 2, 0], fit.spread_px * np.sqrt(inverse[:, 2, 2])


def _moving(fit: _Fit, tracks: Tracks) -> tuple[Mask, Mask] | None:
    """(T,) The features that move against the others as what is in front would, and the others; None if none do.

    Which of two groups moves against which nobody can tell: it is the one that takes up less of the width.
    """
    _, _, by_shared, _ = _linearised(tracks, fit.state)
    nearness = fit.state.points[tracks.track, 2]
    way, sigma = _along(tracks, fit, by_shared[:, :, 6] / nearness[:, None])
    # the split of the ways into two groups that leaves the least variance within them (Otsu, 1979)
    order = np.argsort(way)
    weight = 1.0 / (sigma[order] ** 2 + np.median(sigma) ** 2)
    total, first, second = (np.cumsum(weight * way[order] ** power) for power in range(3))
    below, above = total[:-1], total[-1] - total[:-1]
    within = second[-1] - first[:-1] ** 2 / below - (first[-1] - first[:-1]) ** 2 / above
    at = int(np.argmin(within))
    apart = (first[-1] - first[at]) / above[at] - first[at] / below[at]
    if apart < TOLD_APART * np.sqrt(within[at] / total[-1]):
        return None
    upper = np.asarray(way > way[order[at]], np.bool_)
    lower, azimuth = np.logical_not(upper), fit.state.points[:, 0]
    return (upper, lower) if np.std(azimuth[upper]) < np.std(azimuth[lower]) else (lower, upper)


def _nearer(tracks: Tracks, fit: _Fit, between: float, said: tuple[Mask, Mask] | None) -> tuple[Mask, Mask]:
    """(T,) The features whose own inverse distance, as they show it, exceeds ``between``, and those below it.

    What the crew ``said`` holds until a feature clearly shows the contrary; then it counts as neither.
    """
    _, _, _, by_point = _linearised(tracks, fit.state)
    change, sigma = _along(tracks, fit, by_point[:, :, 2])
    shown = fit.state.points[:, 2] + change - between
    if said is None:
        return (shown > 0) & (sigma < between), (shown <= 0) & (sigma < between)
    return said[0] & (shown > -CLEARLY * sigma), said[1] & (shown < CLEARLY * sigma)


def _boxed(state: _State, frame: int, box_px: tuple[float, float, float, float], edge_px: float) -> tuple[Mask, Mask]:
    """(T,) The features that ``frame`` sees, or would see, within the box, and those outside, but for its border."""
    seen, front = geometry.see(state.view, state.points[:, 0] - state.pan_rad[frame], state.points[:, 1])
    left, top, right, bottom = box_px
    within = np.min(np.column_stack([seen - (left, top), (right, bottom) - seen]), axis=1)
    return front & (within > edge_px), np.logical_not(front) | (within < -edge_px)


def _parallax(tracks: Tracks, state: _State, far_m: float) -> Array:
    """(T, 2) Where each feature was last seen, minus where it were if it had stood far away when first seen."""
    count = len(state.points)
    order = np.lexsort((tracks.frame, tracks.track))
    first = order[np.searchsorted(tracks.track[order], np.arange(count))]
    last = order[np.searchsorted(tracks.track[order], np.arange(count), side="right") - 1]
    azimuth, slope = geometry.look(state.view, tracks.points_px[first])
    x, y = np.cos(azimuth) * far_m + state.offset_m[0], np.sin(azimuth) * far_m + state.offset_m[1]
    distance = np.hypot(x, y)
    axis = np.arctan2(y, x) + state.pan_rad[tracks.frame[first]]
    pan = state.pan_rad[tracks.frame[last]]
    seen, _, _ = from_centre(axis, slope * far_m / distance, 1.0 / distance, pan, state.offset_m)
    return tracks.points_px[last] - geometry.see(state.view, seen[:, 0] - pan, seen[:, 1])[0]
