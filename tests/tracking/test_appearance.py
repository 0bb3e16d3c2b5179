"""A limb that silhouettes cannot tell from the trunk is told by what it looks like, and found by that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise, product

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pzcap.body import kinematics
from pzcap.body.skeleton import LIMBS, Body
from pzcap.geometry.pinhole import projected
from pzcap.tracking import keypoint_residuals
from pzcap.tracking.appearance import LimbAppearance, Postures
from pzcap.tracking.batch_refinement import refine_batch
from pzcap.tracking.bidirectional_fusion import runs
from pzcap.tracking.limbs import POSTURES, LimbMotion, bounded, support, turn_to, turned
from pzcap.tracking.observation import PYRAMID_LEVELS, ViewCrop, Views
from pzcap.tracking.pixel_time import AT_REST, ClockEstimate, Exposure, rates_between
from pzcap.tracking.pose_objective import PoseObjective
from pzcap.tracking.reacquisition import PassResults, Reacquired, accepted, posterior_spread, reacquire, smoothest
from pzcap.tracking.settings import TrackingConfig
from pzcap.tracking.skin_appearance import Appearance, shared
from pzcap.tracking.tuning import KEYPOINT, REACQUISITION
from pzcap.tracking.view_sequence import ViewSequence
from pzcap.types import Array, Keyframe, Mask, Pose
from tests.scenes.tracked import clip, crops, known, observed, swung, true_body

pytestmark = pytest.mark.xdist_group("tracked")  # the clip is rendered once
FRAMES = range(2, 9)
SURE = np.zeros((len(FRAMES), 16), bool)


def alike(pose: Pose, objective: PoseObjective, looks: list[Appearance]) -> Array:
    return LimbAppearance(objective.body).similarity(pose, objective, objective.place(pose)[1], looks)


def without_silhouettes(frame: int, body: Body) -> PoseObjective:
    """Nothing but grey values: every belief is even, as if hall and body had the same colours."""
    return PoseObjective(
        body, [None if view is None else replace(view, belief=np.zeros_like(view.belief)) for view in crops(frame)]
    )


@pytest.mark.parametrize("limb", range(4))
def test_a_limb_looks_like_itself_where_it_is_and_nowhere_else(limb: int) -> None:
    objective, pose = observed(5, true_body()), clip().poses[5]
    looks = known()
    here, away = (alike(each, objective, looks) for each in (pose, swung(pose, limb, 0.9)))
    assert here.min() > 0.0
    assert away[limb] < 0.5 * here[limb]


def searched(limbs: LimbAppearance, limb: int, off_rad: float, objective: PoseObjective) -> tuple[float, float]:
    """Distance of the end of a limb that is swung off from where it is, before and after the best of many postures."""
    pose, turn, end = swung(clip().poses[5], limb, off_rad), np.zeros(4), LIMBS[limb][2]
    context = limbs.context(limb, pose, objective, known())
    for size in (0.8, 0.4, 0.16, 0.06):
        postures = limbs.postures(limb, context, turn + size * POSTURES)
        turn = postures.turns[np.argmax(postures.score_m2)]
    joints = (kinematics.joints(limbs.body, each)[end] for each in (pose, turned(limb, pose, turn)))
    before, after = (float(np.linalg.norm(joint - clip().joints_m[5, end])) for joint in joints)
    return before, after


@pytest.mark.parametrize("limb", range(4))
def test_a_limb_is_found_by_what_it_looks_like_where_silhouettes_say_nothing(limb: int) -> None:
    before, after = searched(LimbAppearance(true_body()), limb, 0.4, without_silhouettes(5, true_body()))
    assert before > 0.1
    assert after < 0.4 * before


def detected(frame: int, objective: PoseObjective) -> PoseObjective:
    """The views with keypoints where the body has them in this frame."""
    body = objective.body
    world = keypoint_residuals.in_world(body.landmarks, kinematics.forward(body, clip().poses[frame]))
    views: list[ViewCrop | None] = []
    for view in objective.views:
        assert view is not None
        person = np.column_stack([projected(world, view.camera)[0], np.full(len(world), 0.9)])
        views.append(replace(view, person=person))
    return PoseObjective(body, views)


@pytest.mark.parametrize("limb", range(4))
def test_a_limb_is_found_by_its_keypoints_where_nothing_else_tells(limb: int) -> None:
    objective = detected(5, without_silhouettes(5, true_body()))
    before, after = searched(LimbAppearance(true_body(), similarity=False), limb, 0.8, objective)
    assert before > 0.2
    assert after < 0.2 * before


def test_a_score_counts_the_keypoints_that_agree() -> None:
    """In four views an elbow and a wrist, or a knee, an ankle, a heel and two toes; none of a limb elsewhere."""
    plain, pose, away = observed(5, true_body()), clip().poses[5], swung(clip().poses[5], 0, 1.2)
    limbs, told = LimbAppearance(true_body()), detected(5, plain)
    here, there = (limbs.score(each, told, known()) - limbs.score(each, plain, known()) for each in (pose, away))
    np.testing.assert_allclose(here, KEYPOINT.limb_m2 * 4 * np.array([2, 2, 5, 5]), rtol=1e-6)
    assert there[0] < 0.2 * here[0]
    np.testing.assert_allclose(there[1:], here[1:], rtol=1e-6)


@settings(max_examples=10, deadline=None)
@given(st.floats(0.85, 1.15))
def test_light_does_not_change_what_a_limb_looks_like(gain: float) -> None:
    objective, pose = observed(5, true_body()), clip().poses[5]
    brighter: list[ViewCrop | None] = []
    for view in objective.views:
        assert view is not None
        grey = tuple(cv2.convertScaleAbs(level, alpha=gain) for level in view.pyramid)
        brighter.append(replace(view, pyramid=grey))
    looks = known()
    here, there = (alike(pose, each, looks) for each in (objective, PoseObjective(objective.body, brighter)))
    np.testing.assert_allclose(there, here, atol=0.12 * here.max())


def test_a_limb_does_not_look_like_itself_on_the_hall() -> None:
    """Were the hall as grey as a sleeve, a limb would look like itself there, but for the silhouette."""
    objective, pose = observed(5, true_body()), clip().poses[5]
    here = alike(pose, objective, known())
    hall = [view and replace(view, belief=np.full_like(view.belief, -1.0)) for view in objective.views]
    there = alike(pose, PoseObjective(objective.body, hall), known())
    assert here.min() > 0.0
    assert there.max() < 0.0


def test_without_similarity_a_limb_is_scored_by_silhouettes_alone() -> None:
    objective, pose = observed(5, true_body()), clip().poses[5]
    placed = objective.place(pose)[1]
    limbs, reference = LimbAppearance(objective.body, similarity=False), known()
    body, hall = support(objective, pose, placed).T
    np.testing.assert_array_equal(limbs.score(pose, objective, reference), body - hall)
    assert not limbs.similarity(pose, objective, placed, reference).any()


def test_a_limb_that_swings_is_judged_where_each_view_exposed_it() -> None:
    """The views of a frame, taken for those of a clock that is half a frame late, and a body half a frame before."""
    body, frame = true_body(), 5
    late = [view and replace(view, exposure=Exposure(clock=0.5)) for view in crops(frame)]
    before, there = clip().poses[frame - 1], clip().poses[frame]
    half = kinematics.retract(before, 0.5 * kinematics.difference(there, before))
    rates = rates_between(kinematics.forward(body, half), kinematics.forward(body, there), 0.5)
    limbs, looks = LimbAppearance(body), known()
    exposed, frozen = (limbs.score(half, PoseObjective(body, late, each), looks) for each in (rates, None))
    at_once = limbs.score(there, observed(frame, body), looks)
    np.testing.assert_allclose(exposed, at_once, atol=0.002)
    assert np.abs(frozen - at_once).max() > 0.01


@pytest.mark.parametrize("limb", range(4))
def test_each_posture_is_scored_at_its_own_speed(limb: int) -> None:
    """Several at once as one after the other, the frame moving so."""
    body, frame, rng = true_body(), 5, np.random.default_rng(limb)
    views = [view and replace(view, exposure=Exposure(0.4, 0.5)) for view in crops(frame)]
    at_rest = PoseObjective(body, views, AT_REST)
    rates, turns = rng.normal(0.0, 0.1, (3, 16, 12)), rng.normal(0.0, 0.3, (3, 4))
    limbs, looks, pose = LimbAppearance(body), shared(known()), clip().poses[frame]
    context = limbs.context(limb, pose, at_rest, looks)
    together = limbs.postures(limb, context, turns, rates).score_m2
    alone = [
        limbs.postures(limb, replace(context, objective=replace(at_rest, rates=own)), turn[None]).score_m2[0]
        for own, turn in zip(rates, turns, strict=True)
    ]
    np.testing.assert_allclose(together, alone, atol=1e-9)
    assert np.abs(together - limbs.postures(limb, context, turns).score_m2).max() > 0.005


def test_skin_that_is_not_known_says_nothing() -> None:
    objective, pose = observed(5, true_body()), clip().poses[5]
    assert not alike(pose, objective, known(range(0))).any()


def test_a_limb_that_looks_little_like_itself_is_still_worth_more_where_it_is_than_hidden() -> None:
    """Cloth, blur and codecs make a limb less like itself everywhere: hidden, which is worth nothing, it must not
    gain."""
    body, rng = true_body(), np.random.default_rng(5)
    odd = [replace(look, value=look.value + rng.normal(0.0, 22.0, look.value.shape)) for look in shared(known())]
    poses, objectives = [clip().poses[frame] for frame in FRAMES], [observed(frame, body) for frame in FRAMES]
    strict = LimbAppearance(body, neutral=np.full(len(LIMBS), 0.58))
    limbs = strict.calibrated(poses, objectives, odd, np.ones((len(FRAMES), len(LIMBS)), bool))

    def worth(scores: LimbAppearance, off_rad: float) -> Array:
        worths = []
        for true, objective in zip(poses, objectives, strict=True):
            pose = true
            for limb in range(len(LIMBS)):
                pose = swung(pose, limb, off_rad)
            worths.append(scores.similarity(pose, objective, objective.place(pose)[1], odd))
        return np.mean(worths, axis=0)

    assert (worth(strict, 0.0) < 0.0).all()
    assert (worth(limbs, 0.0) > 0.0).all()
    assert (worth(limbs, 0.0) > worth(limbs, 0.9)).all()


def test_a_limb_that_is_nowhere_sure_is_told_from_what_is_elsewhere() -> None:
    body, pose = true_body(), clip().poses[5]
    objective, looks = observed(5, body), shared(known())
    unsure, sure = (
        LimbAppearance(body).calibrated([pose] * 16, [objective] * 16, looks, np.full((16, len(LIMBS)), known)).neutral
        for known in (False, True)
    )
    assert (unsure < sure).all()
    assert (unsure > 0.2).all()


def test_what_a_view_has_not_seen_it_has_from_the_others() -> None:
    def look(value: float, trust: list[float]) -> Appearance:
        return Appearance(np.full((PYRAMID_LEVELS, 3), value, np.float32), np.array(trust, np.float32))

    first, second, third = shared([look(100.0, [1, 0, 0]), look(60.0, [1, 1, 0]), look(80.0, [0, 0.5, 0])])
    np.testing.assert_allclose(first.value[0, :2], [100.0, (60.0 + 0.5 * 80.0) / 1.5])
    np.testing.assert_allclose(second.value[0, :2], 60.0)
    np.testing.assert_allclose(third.value[0, :2], [80.0, 80.0])
    assert first.trust[0] == second.trust[0] == 1.0
    assert 0.0 < first.trust[1] < 1.0
    assert first.trust[2] == second.trust[2] == third.trust[2] == 0.0


def test_two_memories_of_a_view_make_one() -> None:
    one = Appearance(np.full((PYRAMID_LEVELS, 3), 100.0, np.float32), np.array([1.0, 1.0, 0.0], np.float32))
    other = Appearance(np.full((PYRAMID_LEVELS, 3), 40.0, np.float32), np.array([1.0, 0.0, 0.0], np.float32))
    both = one.with_other(other)
    np.testing.assert_allclose(both.value[0, :2], [70.0, 100.0])
    np.testing.assert_allclose(both.trust, [1.0, 1.0, 0.0])


def looked_again(
    limb: int, gone: Sequence[int], looks: list[Appearance], doubtful: Mask, around: tuple[Pose, Pose]
) -> tuple[Reacquired | None, list[Pose]]:
    """A second look at frames in some of which a limb is ``gone`` astray, and the poses that it was given."""
    body, true = true_body(), [clip().poses[frame] for frame in FRAMES]
    objectives = [observed(frame, body) for frame in FRAMES]
    poses = [swung(pose, limb, 0.9) if t in gone else pose for t, pose in enumerate(true)]
    placed = [each.place(pose)[1] for each, pose in zip(objectives, poses, strict=True)]
    return reacquire(LimbAppearance(body), poses, objectives, placed, told(poses, looks, doubtful), around, 1.0), poses


def told(poses: list[Pose], looks: list[Appearance], doubtful: Mask) -> PassResults:
    """Two passes that agree, and are no better."""
    return PassResults([poses, poses], SURE, ~SURE, doubtful, looks)


def test_a_limb_that_was_lost_for_some_frames_is_followed_once_more() -> None:
    body, limb, gone = true_body(), 0, range(2, 5)
    true = [clip().poses[frame] for frame in FRAMES]
    again, poses = looked_again(limb, gone, shared(known()), SURE, (true[0], true[-1]))
    assert again is not None
    assert again.lost[list(gone)][:, list(LIMBS[limb])].all()
    assert not again.lost[:, :4].any()
    end = LIMBS[limb][2]
    for t in gone:
        off = [
            np.linalg.norm(kinematics.joints(body, p[t])[end] - kinematics.joints(body, true[t])[end])
            for p in (poses, again.poses)
        ]
        assert off[0] > 0.2
        assert off[1] < 0.3 * off[0]


def test_what_only_one_pass_has_found_is_taken_up() -> None:
    """Far from the way, from where it was lost and from the frames beside: nothing else would lead there."""
    body, limb = true_body(), 1
    true, objectives = [clip().poses[frame] for frame in FRAMES], [observed(frame, body) for frame in FRAMES]
    far = swung(true[0], limb, 2.4)
    poses = [swung(pose, limb, 2.4) for pose in true]
    placed = [each.place(pose)[1] for each, pose in zip(objectives, poses, strict=True)]
    off = []
    for other in (poses, true):
        passes = PassResults([poses, other], SURE, SURE, ~SURE, shared(known()))
        again = reacquire(LimbAppearance(body), poses, objectives, placed, passes, (far, far), 1.0)
        assert again is not None
        moved = [
            kinematics.joints(body, p) - kinematics.joints(body, q) for p, q in zip(again.poses, true, strict=True)
        ]
        off.append(np.linalg.norm(np.array(moved)[:, LIMBS[limb][2]], axis=1).max())
    assert off[1] < 0.05 < off[0]


def test_a_stretch_is_polished_with_the_limb_where_the_second_look_has_found_it() -> None:
    """And without a leap where the two ways meet."""
    body, limb = true_body(), 0
    true = [clip().poses[frame] for frame in FRAMES]
    poses = [swung(pose, limb, 1.0) if 2 <= t < 5 else pose for t, pose in enumerate(true)]
    views, end = [crops(frame) for frame in FRAMES], LIMBS[limb][2]
    off = []
    for passes in (None, told(poses, shared(known()), SURE)):
        sequence, key = ViewSequence([*views, views[-1]], 1.0), Keyframe(FRAMES[-1], true[-1])
        clocks, config = ClockEstimate.of(4, 0.3), TrackingConfig()
        batch = refine_batch(body, [*poses, true[-1]], sequence, true[:1], key, passes, clocks, config)
        found = [each.pose for each in batch.frames]
        moved = [kinematics.joints(body, p) - kinematics.joints(body, q) for p, q in zip(found, true, strict=False)]
        off.append(np.linalg.norm(np.array(moved)[:, end], axis=1).max())
    assert off[1] < 0.04 < 0.2 < off[0]


@pytest.mark.parametrize("limb", range(4))
def test_a_limb_is_known_as_far_as_it_scores_more_than_elsewhere(limb: int) -> None:
    """One that is seen lies where it is; one that neither silhouettes nor looks tell of, anywhere in its reach."""
    body, pose, rows = true_body(), clip().poses[5], list(LIMBS[limb][1:])
    seen, unseen = (
        posterior_spread(LimbAppearance(body), [pose], [objective], looks, {(0, limb): []})[0]
        for objective, looks in (
            (observed(5, body), shared(known())),
            (without_silhouettes(5, body), known(range(0))),
        )
    )
    assert np.isnan(np.delete(seen, rows)).all()
    assert seen[rows].max() < 0.02
    assert unseen[rows].min() > 0.1


@pytest.mark.parametrize("limb", range(4))
def test_a_limb_that_was_looked_for_where_it_scores_more_is_not_known(limb: int) -> None:
    """It is as far off as that. Postures all over its reach miss the place."""
    body, pose, rows = true_body(), clip().poses[5], list(LIMBS[limb][1:])
    away = swung(pose, limb, 0.33)
    alone, looked_for = (
        posterior_spread(LimbAppearance(body), [away], [observed(5, body)], shared(known()), {(0, limb): there})
        for there in ([], [LimbMotion(pose, AT_REST)])
    )
    apart = np.linalg.norm(kinematics.joints(body, away) - kinematics.joints(body, pose), axis=1)[rows]
    assert looked_for[0][rows] == pytest.approx(apart, rel=0.02)
    assert not np.allclose(alone[0][rows], apart, rtol=0.1)


@pytest.mark.parametrize("limb", range(4))
def test_a_place_counts_once(limb: int) -> None:
    """However often a limb was looked for there; and none about where it is, nor of another limb."""
    body, pose, rows = true_body(), clip().poses[5], list(LIMBS[limb][1:])
    there, near, here, elsewhere = (LimbMotion(swung(pose, limb, turn), AT_REST) for turn in (1.5, 0.05, 0.0, -1.5))
    other = (limb + 2) % len(LIMBS)
    none, once, often = (
        posterior_spread(LimbAppearance(body), [pose], [without_silhouettes(5, body)], known(range(0)), places)[0][rows]
        for places in (
            {(0, limb): []},
            {(0, limb): [there]},
            {(0, limb): [there, near, here, there, near], (0, other): [elsewhere]},
        )
    )
    assert often == pytest.approx(once)
    assert not np.allclose(once, none, rtol=1e-5)


def test_only_a_limb_that_was_sought_is_compared_with_what_else_it_may_be() -> None:
    body, limb = true_body(), 0
    true = [clip().poses[frame] for frame in FRAMES]
    poses = [swung(pose, limb, 0.9) if 2 <= t < 5 else pose for t, pose in enumerate(true)]
    sequence = ViewSequence([crops(frame) for frame in FRAMES], 1.0)
    clocks, config = ClockEstimate.of(4, 0.3), TrackingConfig()
    batch = refine_batch(body, poses, sequence, true[:1], None, told(poses, shared(known()), SURE), clocks, config)
    assert np.isfinite(batch.spread_m[2:5, list(LIMBS[limb][1:])]).all()
    assert np.isnan(np.delete(batch.spread_m, LIMBS[limb], axis=1)).all()


def test_what_the_passes_dispute_is_not_learned_from() -> None:
    """Its looks are of frames that nobody objects to."""
    body, limb = true_body(), 0
    objectives = [observed(frame, body) for frame in FRAMES]
    true = [clip().poses[frame] for frame in FRAMES]
    poses = [swung(pose, 1, 0.9) if 2 <= t < 5 else pose for t, pose in enumerate(true)]  # something has to be lost
    placed = [each.place(pose)[1] for each, pose in zip(objectives, poses, strict=True)]
    other = SURE.copy()
    other[3, LIMBS[1][2]] = True
    learned, own = [], np.isin(body.surface.segment, LIMBS[limb])
    for disputed in (SURE, np.broadcast_to(np.isin(np.arange(16), LIMBS[limb]), SURE.shape)):
        passes = PassResults([poses, poses], disputed, ~disputed, other, known(range(0)))
        again = reacquire(LimbAppearance(body), poses, objectives, placed, passes, (None, None), 1.0)
        assert again is not None
        learned.append(max(float(look.trust[own].max()) for look in again.reference))
    assert learned[0] > 0.0
    assert learned[1] == 0.0


def test_a_limb_that_is_lost_for_long_is_not_forgotten() -> None:
    """Frames that hide it, or take something else for it, say nothing of its looks."""
    body, limb = true_body(), 0
    frames = [frame for frame in FRAMES for _ in range(20)]
    observations = {frame: observed(frame, body) for frame in FRAMES}
    objectives, poses = [observations[frame] for frame in frames], [swung(clip().poses[f], limb, 0.9) for f in frames]
    placed = [each.place(pose)[1] for each, pose in zip(objectives, poses, strict=True)]
    leaping = np.broadcast_to(np.isin(np.arange(16), LIMBS[limb]), (len(frames), 16))
    looks, own = shared(known()), np.isin(body.surface.segment, LIMBS[limb])
    passes = PassResults([poses, poses], leaping, ~leaping, leaping, looks)
    again = reacquire(LimbAppearance(body), poses, objectives, placed, passes, (None, None), 1.0)
    assert again is not None
    for look, before in zip(again.reference, looks, strict=True):
        np.testing.assert_array_equal(look.trust[own], before.trust[own])


def test_a_limb_that_lies_on_the_hall_is_looked_for_though_nothing_is_known_of_its_looks() -> None:
    limb, gone, ends = 0, range(1, 6), (clip().poses[FRAMES[0]], clip().poses[FRAMES[-1]])
    again, _ = looked_again(limb, gone, known(range(0)), SURE, ends)
    assert again is not None
    assert again.lost[list(gone)][:, list(LIMBS[limb])].all()


def test_a_limb_is_found_again_where_only_frames_beside_show_the_way() -> None:
    """The way from before to after leads far past it, and in the middle it is lost: its neighbours know better."""
    body, limb = true_body(), 1
    true = [clip().poses[frame] for frame in FRAMES]
    wide = swung(swung(true[0], limb, 1.2), limb, 0.9)
    doubtful = np.broadcast_to(np.isin(np.arange(16), LIMBS[limb]), SURE.shape)
    again, _ = looked_again(limb, [3], shared(known()), doubtful, (wide, wide))
    assert again is not None
    off = [kinematics.joints(body, p) - kinematics.joints(body, q) for p, q in zip(again.poses, true, strict=True)]
    assert np.linalg.norm(np.array(off)[:, LIMBS[limb][2]], axis=1).max() < 0.08


@pytest.mark.parametrize(
    ("aside_rad", "agreed", "score", "taken"),
    [(0.9, True, 0.2, True), (0.15, False, 0.2, True), (0.15, True, 0.2, False), (0.9, False, 0.02, False)],
)
def test_a_limb_is_taken_where_it_scores_well_and_lies_elsewhere(
    aside_rad: float, agreed: bool, score: float, taken: bool
) -> None:
    """Passes that agree are contradicted by more than the room in clothes alone."""
    body, limb = true_body(), 0
    here = [clip().poses[frame] for frame in FRAMES]
    there = [swung(pose, limb, aside_rad) for pose in here]

    class Told(LimbAppearance):
        def score(self, pose: Pose, *_: object) -> Array:
            return np.full(len(LIMBS), score if any(pose is each for each in there) else score - 0.1)

    views: list[Views] = [[None] * len(crops(5))] * len(FRAMES)
    lost = np.broadcast_to(np.isin(np.arange(16), LIMBS[limb]), SURE.shape)
    again = Reacquired(there, lost, {}, known(range(0)), np.full(len(LIMBS), 0.05))
    pairs = list(zip(here, there, strict=True))
    found = accepted(Told(body), here[0], pairs, ViewSequence(views, 1.0), again, np.full(SURE.shape, agreed))
    off = [kinematics.joints(body, p) - kinematics.joints(body, q) for p, q in zip(found, here, strict=True)]
    assert (np.linalg.norm(np.array(off)[3, LIMBS[limb][2]]) > 0.02) == taken


@given(st.integers(0, 3), st.lists(st.floats(-0.4, 0.4), min_size=4, max_size=4))
def test_a_limb_is_turned_from_one_pose_to_another(limb: int, turn: list[float]) -> None:
    pose = clip().poses[5]
    taken = bounded(limb, pose, np.array([turn]))[0]
    np.testing.assert_allclose(turn_to(limb, pose, turned(limb, pose, taken)), taken, atol=1e-9)


def test_limbs_that_look_like_themselves_are_not_looked_at_again() -> None:
    body = true_body()
    objectives, poses = [observed(frame, body) for frame in FRAMES], [clip().poses[frame] for frame in FRAMES]
    placed = [each.place(pose)[1] for each, pose in zip(objectives, poses, strict=True)]
    passes = told(poses, shared(known()), SURE)
    assert reacquire(LimbAppearance(body), poses, objectives, placed, passes, (None, None), 1.0) is None
    doubtful = SURE.copy()
    doubtful[3, LIMBS[1][2]] = True
    again = reacquire(
        LimbAppearance(body), poses, objectives, placed, told(poses, shared(known()), doubtful), (None, None), 1.0
    )
    assert again is not None
    assert np.flatnonzero(again.lost.any(axis=0)).tolist() == list(LIMBS[1])
    for found, pose in zip(again.poses, poses, strict=True):  # found where it was
        np.testing.assert_allclose(kinematics.joints(body, found), kinematics.joints(body, pose), atol=0.08)


@given(st.integers(1, 4), st.integers(0, 2**32 - 1))
def test_the_smoothest_is_the_best_of_all_ways(frames: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    postures = [
        Postures(np.zeros((3, 4)), rng.normal(0.0, 0.01, 3), rng.normal(0.0, 0.04, (3, 2, 3))) for _ in range(frames)
    ]

    def total(way: Sequence[int]) -> float:
        joints = [each.moved_m[k] for each, k in zip(postures, way, strict=True)]
        leaps = sum(
            min(float(np.sum((b - a) ** 2)) / REACQUISITION.leap_m**2, REACQUISITION.worst_leap)
            for a, b in pairwise(joints)
        )
        return (
            sum(float(each.score_m2[k]) for each, k in zip(postures, way, strict=True)) - REACQUISITION.leap_m2 * leaps
        )

    best = max(total(way) for way in product(range(3), repeat=frames))
    assert total(smoothest(postures)) == pytest.approx(best, abs=1e-12)


def test_a_limb_that_is_hidden_is_led_from_the_frame_before_to_the_one_after() -> None:
    """Nothing is known of it and nothing seen: it is where the frames beside it have it, and between them between."""
    body, limb = true_body(), 0
    start, end = clip().poses[5], swung(clip().poses[5], limb, 0.6)
    blind = [PoseObjective(body, [None] * len(crops(5))) for _ in range(3)]
    lost = np.zeros((3, 16), bool)
    lost[:, LIMBS[limb][1]] = True
    nothing = [Appearance.unseen(body) for _ in crops(5)]
    unseen: list[list[None]] = [[None] * len(crops(5))] * 3
    passes = PassResults([[end] * 3], np.zeros((3, 16), bool), np.zeros((3, 16), bool), lost, nothing)
    again = reacquire(LimbAppearance(body), [end] * 3, blind, unseen, passes, (start, end), 1.0)
    assert again is not None
    for share, pose in zip((0.25, 0.5, 0.75), again.poses, strict=True):
        between = swung(start, limb, 0.6 * share)
        np.testing.assert_allclose(kinematics.joints(body, pose), kinematics.joints(body, between), atol=1e-3)


@given(st.lists(st.booleans(), max_size=12))
def test_runs_are_all_that_is_marked_without_gaps(marks: list[bool]) -> None:
    found = runs(np.array(marks, bool))
    assert [t for run in found for t in run] == np.flatnonzero(marks).tolist()
    assert all(first.stop < second.start for first, second in pairwise(found))
