"""Constants of the tracking that no user sets, a table a topic. Kernels have them compiled in."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pzcap.types import DOF, Array


class ViewTuning(NamedTuple):
    """Crop of a view, and placement of the body in it."""

    z_scale: float = 2.0  # pixels of a view that one of a z-buffer is wide
    depth_tolerance_m: float = 0.03  # skin so far behind the z-buffer is visible: it is smooth, the buffer coarse
    belief_scale: int = 4  # pixels of a view that one of its evidence is wide, when areas are judged
    full_log_odds: float = 3.0  # evidence for the athlete that counts in full when areas are judged
    usual_px_per_m: float = 130.0  # magnification that `Terms.level` is meant for: an athlete 220 pixels tall
    nearest_m: float = 0.5  # no magnification is reckoned with for less than this distance
    anywhere_px: float = 1e3  # error of a prediction that says nothing
    least_camera_sigma: float = 1e-7  # radians of pan, and of log focal: none is known better


class ContourTuning(NamedTuple):
    """Search for the silhouette's edge along the body's contour."""

    edge: float = 127.5  # probability (0..255) at the edge
    clear_fall: float = 255.0 / 3.0  # fall of the probability within a search step that leaves no doubt
    least_slope: float = 12.75  # slope of the probability, a pixel, from which on it is an edge
    hidden_m: float = 0.06  # a contour point so far behind the z-buffer is hidden
    in_front_m: float = 0.02  # an arm counts as before the body if it is nearer by so much
    robust_sigmas: float = 2.5  # scale of the Geman-McClure weight
    missed_px2: float = 25.0  # squared distance assumed of an edge that the last round does not find within its reach


class BrightnessTuning(NamedTuple):
    """Residuals of the skin's brightness."""

    least_facing: float = 0.15  # cosine: skin seen more obliquely has no residual
    learned_facing: float = 0.25  # cosine: nothing is learned of skin seen more obliquely
    kept: float = 0.98  # share of the trust in skin that is not seen that is left a frame later
    thinnest_px: float = 3.0  # a segment less wide than this at a pyramid level is not seen there


class KeypointTuning(NamedTuple):
    """Residuals of a detector's keypoints."""

    # error of a detector that is sure of itself; on the body, not in the image: whatever the size of a person, the
    # detector looks at a picture of one size
    detector_m: float = 0.015
    posture_m: float = 0.010  # change of where a keypoint is meant to lie, with the posture and the direction of view
    least_confidence: float = 0.05  # a keypoint found with less does not count
    near_m: float = 0.5  # keypoints further off than this are somebody else's
    half_agrees: float = 3.0  # sigmas from where a limb has it, at which a keypoint agrees by half
    # of a limb's score, that a keypoint which agrees is worth: twice what one that does not costs in a fit (weighted by
    # 0.3, of three sigmas at most) by the odds of scores, `ReacquisitionTuning.odds_m2`; chosen on `crew` of seed 19
    limb_m2: float = 0.019
    largest_share: float = 0.7  # of ``near_m`` that the athlete's may be off on average: some limbs may be lost


class BodySizeTuning(NamedTuple):
    """Size of the athlete by the silhouettes of keyframes."""

    step: float = 0.01  # of the logarithm of the sizes that are tried
    steps: int = 25  # so many larger, and as many smaller
    most_log_odds: float = 2.0  # of a pixel, either way: a background that is wrong is sure of it
    fewest_views: int = 3
    sigma: float = 0.015  # of the logarithm, however many views: a skin of ellipses, keyframes that lean one way
    loose: float = 0.15
    """Of the logarithm, for each share of the outline's area that is room between cloth and skin: a third of the room,
    either way, and a size goes with the root of the area. Six clothed takes are off by 0.1 to 7 %, 4 in the root mean
    square; this claims 3 to 4 for them."""
    contradicts_sigmas: float = 3.0  # beyond which the measurements are somebody else's
    open: float = 0.15  # of the size, once they are


class DrapeTuning(NamedTuple):
    """Loose clothes beside the body. The lag was chosen on the floor exercise of seed 0 in clothes 3 cm loose."""

    sigma: float = 0.5  # of the drape along each axis, a share of the room between cloth and skin
    lag: float = 0.9  # share of the room by which cloth hangs behind fast motion
    most_m: float = 0.03  # change of it in a step of the solver
    half_m: float = 0.02  # motion a frame with which it hangs behind by half of that


class ContactTuning(NamedTuple):
    """Points at rest on the floor, and arms inside the trunk."""

    near_m: float = 0.04  # height below which a point may touch the floor: the errors of tape and tracker together
    rest_m: float = 0.004  # motion a frame from which on a point has begun to move; scale of the Geman-McClure weight
    sigma_m: float = 0.001  # motion a frame by which skin and sole give way
    least_weight: float = 0.02  # robust weight below which a point is not in contact
    skin_gives_m: float = 0.015  # depth by which skin gives way, or is not where the body has it
    inside_sigma_m: float = 0.02  # standard deviation of how much deeper an arm is in the trunk


class SpineTuning(NamedTuple):
    """Bend of the spine, where it shows little."""

    evenness: float = 0.82  # correlation of the lumbar and the thoracic joint's bend
    freedom: float = 6.0  # degrees of, of Student's distribution


class FrameTuning(NamedTuple):
    """Frame-to-frame tracking."""

    appearance_rate: float = 0.15  # share of the image that the appearance takes on with each frame
    joint_persistence: float = 0.2  # share of a joint's velocity that is expected to go on: unseen limbs come to rest
    start_widening: float = 4.0  # factor of a prediction's sigma while the velocity is not known
    leap_sigmas: float = 3.0  # sigmas of the prediction that nobody moves by
    beside_keyframe: int = 2  # frames beside a keyframe in which limbs are still where they are thought to be
    error_m: float = 0.03  # of the joints, by which a prediction errs beside a keyframe, and more in a frame unseen
    error_gain: float = 0.3  # share of the latest frame in the error of the predictions
    # Of body and silhouettes, from which on the whole body is as likely lost as not. Seen: 0.08 at most of an athlete
    # beside a coach, 0.13 in loose clothes as well; 0.15 to 0.25 where the coach was taken for the athlete.
    mismatch: float = 0.12
    mismatch_slope: float = 150.0  # increase of the logarithm of those odds with a mismatch of one
    lost_margin: float = 0.6  # that is kept of a view around a body that is lost, in sizes of the body
    lost_variance: float = 1e4  # relative, of the segments of a body that is lost


class FusionTuning(NamedTuple):
    """Fusion of the forward and the backward pass."""

    agree_m: float = 0.05  # distance of the joints up to which the passes agree about a limb
    leap_m: float = 0.04  # change of a joint's motion in a frame, standard deviation
    worst_leap: float = 10.0  # squares of that, halved, that count at most: a limb that is found again leaps once
    beside_leap: int = 3  # frames around a leap that may be wrong with it
    own_keyframe: float = 2.0  # score of a pass beside its own keyframe: where nothing tells, the leap is in the middle
    leap_m2: float = 0.01  # score of a limb, square metres, that weighs as much as a leap
    odds_m2: float = 0.02  # of it, by which the pass that was chosen is e times as likely right as the other; fitted


class IntervalTuning(NamedTuple):
    """Results of an interval between keyframes; ``fitted``: to captures."""

    misplaced_px: float = 4.0  # misfit of the contours at a joint that is as likely misplaced as not; fitted
    misplaced_slope: float = 4.0  # increase of the logarithm of those odds with a pixel of misfit; fitted
    misplaced_m: float = 0.15  # distance by which a misplaced joint is off; fitted


class ShapeTuning(NamedTuple):
    """Correction of the body's shape, and refit of early frames to it."""

    stride: int = 4  # one of so many frames of an interval corrects the body: its neighbours say the same
    settled_m: float = 1e-4  # a smaller change of the joints ends the rounds of an interval: they close in slowly
    # Factor of a joint's variance for what is not known of the body, where no keyframe was set by hand: what a detector
    # means by a joint is elsewhere in the skin, by the same in all frames. Fitted to what is covered on captures.
    found_keyframes: float = 1.5
    texture_weight: float = 3.0  # of a frame's brightness
    brightness_sigma: float = 25.0  # grey levels, while the shape is not known: more than in tracking
    # weight of a point's displacement along the skin; the rest is that across it: contours show the latter, and the
    # texture, which shows the former, was learned with the body of its time
    refit_along: float = 0.03
    refit_stride: int = 3  # one of so many points of the skin is looked at
    refit_steps: int = 2  # Gauss-Newton steps


class SkinColourTuning(NamedTuple):
    """Colours of the lower arms."""

    luma: int = 4  # factor by which luma counts less than chroma: light changes it
    least_facing: float = 0.3  # cosine: skin that is seen more obliquely may be another part's
    surest: float = 3.0  # log-odds, at most
    soft_px: float = 1.0  # blur of the probability, since chroma has half the resolution


class AppearanceTuning(NamedTuple):
    """Postures of limbs, and their appearance score."""

    reluctance_m2: float = 0.002  # gain that a turn of one radian must bring
    limit_m2: float = 0.2  # that one radian beyond the joint's limits must bring
    weight: float = 6.0  # square metres of silhouette that one of similarity is worth
    half_alike: float = 15.0  # grey levels by which a point half looks otherwise
    neutral: float = 0.46  # likeness (1: as it should be) that is neither like nor unlike, as long as nothing tells
    calibration_stride: int = 5  # one of so many frames tells how like themselves limbs are
    least_seen_m2: float = 0.2  # of a limb, in these frames together, to tell that by
    usual_more: float = 0.2  # likeness where it is, more than elsewhere, of a limb that is never sure to be found
    least_gain: float = 0.8  # factor by which a limb that turns may darken
    largest_gain: float = 1.25  # factor by which it may brighten
    trust_elsewhere: float = 0.5  # trust in what another view has seen
    stride: int = 2  # one of so many points of the skin is looked at
    coarse_stride: int = 4  # and in coarse images
    coarse_level: int = 2  # pyramid level in the usual view, for postures that differ much
    fine_level: int = 1  # pyramid level in the usual view, for those that differ little
    hinge_range_rad: tuple[float, float] = (0.0, 2.6)  # range of an elbow or a knee
    nearest_limb_m: float = 0.5  # a limb nearer to the camera is not judged


class ReacquisitionTuning(NamedTuple):
    """Reacquisition of lost limbs."""

    rounds: int = 3  # of it, at most: one limb that is found may show where another is
    window: int = 2  # frames on either side that a verdict takes in
    beside: int = 6  # frames on either side of a lost one that may be wrong with it
    largest_hall: float = 0.25  # share of hall in what a limb covers, all views together, from which on it is lost
    least_area_m2: float = 0.05  # covered area to tell that by
    unlike_m2: float = 0.0  # negative similarity from which on a limb is lost: it looks less like itself than not
    lost_share: float = 0.4  # of the limb's median score, below which it is lost
    promising_m2: float = 0.01  # that a limb scores more in another place, at least, for it to be sought about there
    sizes_rad: tuple[float, ...] = (0.3, 0.14, 0.06)  # spread of the postures tried, from coarse to fine
    leap_m: float = 0.08  # motion of a joint in a frame, besides what was expected, that is usual
    leap_m2: float = 0.005  # cost of that in a limb's score; it grows as the square of the length
    worst_leap: float = 10.0  # squares that count at most: an arm that swings moves further, and scores where it is
    least_score_m2: float = 0.05  # of a limb that is taken as reacquired: where it is truly, it is mostly well seen
    least_share: float = 0.4  # of its median score, that is enough where it is never seen so well
    short_of: float = 4.0  # cost of a score that falls short of that, a share of what is missing
    least_gain_m2: float = 0.002  # by which the score must be more: a search finds what looks a little better
    odds_m2: float = 0.007  # of score by which one posture is e times as likely as another; fitted
    apart_m: float = 0.02  # a limb that was reacquired nearer than this was not lost
    # nor one nearer than this that both passes had there: clothes look like a limb beside; so far apart two places are
    apart_agreed_m: float = 0.1


class BeamLook(NamedTuple):
    """A look at the postures about some hypotheses."""

    spread_rad: float  # of the postures about each
    coarse: bool  # in coarse images
    width: int  # hypotheses that are left after it


class BeamTuning(NamedTuple):
    """Beam search of a lost limb."""

    # a limb's motion changes by 0.3 from frame to frame; where coarse images show two places alike, fine ones may not
    looks: tuple[BeamLook, ...] = (BeamLook(0.3, True, 8), BeamLook(0.1, False, 4))
    apart_m: float = 0.03  # distance of the joints of two hypotheses, at least


class ClockTuning(NamedTuple):
    """Clocks of the cameras from the moving body."""

    doubt: float = 16.0  # so many residuals tell as much as one would: the skin errs alike in all frames of a camera
    drift: float = 1e-4  # standard deviation of a clock's rate, a share of it
    short: float = 0.08  # share of itself by which a clock comes out too small: 2 to 14 % in trials
    together: float = 1e4  # information on the sum of all clocks, which no image shows
    settled: float = 0.003  # frame periods; a smaller change ends the rounds of an interval
    rounds: int = 6  # of an interval, at most


class KeyframeTuning(NamedTuple):
    """Poses that no person takes."""

    hinge_rad: float = np.deg2rad(25.0)  # beside the axis of a hinge
    limit_rad: float = np.deg2rad(20.0)  # beyond a joint's limits
    floor_m: float = 0.15  # below the floor
    fastest_m_s: float = 12.0  # of the pelvis: the fastest sprinters'


def _sigma(position_m: float, rotation_rad: float) -> Array:
    """Standard deviation (43,) in a pose's tangent: of the root, and of each joint."""
    return np.r_[np.full(3, position_m), np.full(DOF - 3, rotation_rad)]


HAND_SIGMA = _sigma(0.010, 0.052)  # of a keyframe as a hand sets it
PREDICTION_SIGMA = _sigma(0.1, 0.20)  # of a prediction, a frame: a landing stops the root at once
ACCELERATION_SIGMA = _sigma(0.01, 0.05)  # of the acceleration, a frame squared
VIEW = ViewTuning()
CLOCK = ClockTuning()
CONTOUR = ContourTuning()
BRIGHTNESS = BrightnessTuning()
KEYPOINT = KeypointTuning()
BODY_SIZE = BodySizeTuning()
DRAPE = DrapeTuning()
CONTACT = ContactTuning()
SPINE = SpineTuning()
FRAME = FrameTuning()
FUSION = FusionTuning()
INTERVAL = IntervalTuning()
SHAPE = ShapeTuning()
APPEARANCE = AppearanceTuning()
SKIN_COLOUR = SkinColourTuning()
REACQUISITION = ReacquisitionTuning()
BEAM = BeamTuning()
KEYFRAME = KeyframeTuning()
