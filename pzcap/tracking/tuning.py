"""Constants of the tracking that no user sets, a table a topic. Kernels have them compiled in."""

from __future__ import annotations

from typing import NamedTuple


class ViewTuning(NamedTuple):
    """Crop of a view, and placement of the body in it."""

    z_scale: float = 2.0
    """Pixels of a view that one of a z-buffer is wide."""
    depth_tolerance_m: float = 0.03
    """Skin so far behind the z-buffer is still visible: it is smooth, and the buffer coarse."""
    belief_scale: int = 4
    """Pixels of a view that one of its evidence is wide, when areas are judged."""
    full_log_odds: float = 3.0
    """Evidence for the athlete that counts in full when areas are judged."""
    usual_px_per_m: float = 130.0
    """Magnification that the pyramid levels of `Terms` are meant for: an athlete 220 pixels tall."""
    nearest_m: float = 0.5
    """No magnification is reckoned with for less than this distance."""


class ContourTuning(NamedTuple):
    """Search for the silhouette's edge along the body's contour."""

    edge: float = 127.5
    """Probability (0..255) at the edge."""
    clear_fall: float = 255.0 / 3.0
    """Fall of the probability within a search step that leaves no doubt."""
    least_slope: float = 12.75
    """Slope of the probability, a pixel, from which on it is an edge."""
    hidden_m: float = 0.06
    """A contour point so far behind the z-buffer is hidden."""
    in_front_m: float = 0.02
    """An arm counts as before the body if it is nearer by so much."""
    robust_sigmas: float = 2.5
    """Scale of the Geman-McClure weight."""
    missed_px2: float = 25.0
    """Squared distance assumed of an edge that the last round does not find within its reach."""


class BrightnessTuning(NamedTuple):
    """Residuals of the skin's brightness."""

    least_facing: float = 0.15
    """Cosine: skin seen more obliquely has no residual."""
    learned_facing: float = 0.25
    """Cosine: nothing is learned of skin seen more obliquely."""
    thinnest_px: float = 3.0
    """A segment less wide than this at a pyramid level is not seen there."""


class KeypointTuning(NamedTuple):
    """Residuals of a detector's keypoints."""

    detector_m: float = 0.015
    """Error of a detector that is sure of itself. On the body, not in the image: whatever the size of a person, the
    detector looks at a picture of one size."""
    posture_m: float = 0.010
    """Change of where a keypoint is meant to lie, with the posture and the direction of view."""
    least_confidence: float = 0.05
    """A keypoint found with less does not count."""
    near_m: float = 0.5
    """Keypoints further off than this are somebody else's."""
    largest_share: float = 0.7
    """Share of ``near_m`` that the keypoints of the athlete may be off on average: some limbs may be lost."""


class CameraTuning(NamedTuple):
    """Refinement of the cameras."""

    least_sigma: float = 1e-7
    """Radians of pan, and of log focal: none is known better."""


class SelfCollisionTuning(NamedTuple):
    """Arms inside the trunk."""

    skin_gives_m: float = 0.015
    """Depth by which skin gives way, or is not where the body has it."""
    sigma_m: float = 0.02
    """Standard deviation of what goes deeper."""


class ContactTuning(NamedTuple):
    """Points at rest on the floor."""

    near_m: float = 0.04
    """Height below which a point may touch the floor: the errors of tape and tracker together."""
    rest_m: float = 0.004
    """Motion a frame from which on a point has begun to move; scale of the Geman-McClure weight."""
    sigma_m: float = 0.001
    """Motion a frame by which skin and sole give way."""
    least_weight: float = 0.02
    """Robust weight below which a point is not in contact."""


class FrameTuning(NamedTuple):
    """Frame-to-frame tracking."""

    leap_sigmas: float = 3.0
    """Sigmas of the prediction that nobody moves by."""
    beside_keyframe: int = 2
    """Frames beside a keyframe in which limbs are still where they are thought to be."""
    error_gain: float = 0.3
    """Share of the latest frame in the error of the predictions."""


class FusionTuning(NamedTuple):
    """Fusion of the forward and the backward pass."""

    agree_m: float = 0.05
    """Distance of the joints up to which the passes agree about a limb."""
    leap_m: float = 0.04
    """Change of a joint's motion in a frame, standard deviation."""
    worst_leap: float = 10.0
    """Squares of that, halved, that count at most: a limb that is found again leaps once."""
    beside_leap: int = 3
    """Frames around a leap that may be wrong with it."""
    own_keyframe: float = 2.0
    """Score of a pass beside its own keyframe: where nothing tells, the leap is in the middle."""
    leap_m2: float = 0.01
    """Score of a limb, square metres, that weighs as much as a leap."""
    apart_m: float = 0.02
    """A limb that was reacquired nearer than this was not lost."""


class IntervalTuning(NamedTuple):
    """Results of an interval between keyframes."""

    misplaced_px: float = 4.0
    """Misfit of the contours at a joint that is as likely misplaced as not. Fitted to captures."""
    misplaced_slope: float = 4.0
    """Increase of the logarithm of those odds with a pixel of misfit. Fitted to captures."""
    misplaced_m: float = 0.15
    """Distance by which a misplaced joint is off. Fitted to captures."""


class ShapeTuning(NamedTuple):
    """Correction of the body's shape."""

    stride: int = 4
    """One of so many frames of an interval corrects the body: its neighbours say the same."""
    brightness_sigma: float = 25.0
    """Grey levels, while the shape is not known: more than in tracking."""


class BatchTuning(NamedTuple):
    """Batch refinement of an interval."""

    least_gain_m2: float = 0.002
    """Score that a limb must gain a frame to be taken as reacquired: a search finds what looks a little better."""


class RefitTuning(NamedTuple):
    """Refit of early frames to the body as it is known in the end."""

    along: float = 0.03
    """Weight of a point's displacement along the skin; the rest is that across it. Contours show the latter, and the
    texture, which shows the former, was learned with the body of its time."""
    stride: int = 3
    """One of so many points of the skin is looked at."""
    steps: int = 2
    """Gauss-Newton steps."""


class SkinColourTuning(NamedTuple):
    """Colours of the lower arms."""

    luma: int = 4
    """Factor by which luma counts less than chroma: light changes it."""
    least_facing: float = 0.3
    """Cosine: skin that is seen more obliquely may be another part's."""
    surest: float = 3.0
    """Log-odds, at most."""
    soft_px: float = 1.0
    """Blur of the probability, since chroma has half the resolution."""


class AppearanceTuning(NamedTuple):
    """Appearance score of limbs."""

    reluctance_m2: float = 0.002
    """Gain that a turn of one radian must bring."""

    weight: float = 6.0
    """Square metres of silhouette that one of similarity is worth."""
    half_alike: float = 15.0
    """Grey levels by which a point half looks otherwise."""
    neutral: float = 0.58
    """Likeness (1: as it should be) that is neither like nor unlike."""
    least_gain: float = 0.8
    """Factor by which a limb that turns may darken."""
    largest_gain: float = 1.25
    """Factor by which it may brighten."""
    trust_elsewhere: float = 0.5
    """Trust in what another view has seen."""
    stride: int = 2
    """One of so many points of the skin is looked at."""
    coarse_level: int = 2
    """Pyramid level in the usual view, for postures that differ much."""
    fine_level: int = 1
    """Pyramid level in the usual view, for those that differ little."""


class LimbTuning(NamedTuple):
    """Postures of limbs, and their support by the silhouettes."""

    hinge_range_rad: tuple[float, float] = (0.0, 2.6)
    """Range of an elbow or a knee."""
    nearest_m: float = 0.5
    """A limb nearer to the camera is not judged."""


class ReacquisitionTuning(NamedTuple):
    """Reacquisition of lost limbs."""

    window: int = 2
    """Frames on either side that a verdict takes in."""
    beside: int = 6
    """Frames on either side of a lost one that may be wrong with it."""
    largest_hall: float = 0.25
    """Share of hall in what a limb covers, all views together, from which on it is lost."""
    least_area_m2: float = 0.05
    """Covered area to tell that by."""
    unlike_m2: float = 0.006
    """Negative similarity from which on a limb is lost: less is an odd light."""
    sizes_rad: tuple[float, ...] = (0.8, 0.4, 0.16, 0.06)
    """Spread of the postures tried, from coarse to fine."""
    coarse_rad: float = 0.3
    """Postures that are spread by more are scored in coarse images."""
    leap_m: float = 0.04
    """Motion of a joint in a frame, besides what was expected, that is usual."""
    leap_m2: float = 0.005
    """Cost of that in a limb's score; it grows as the square of the length."""
    worst_leap: float = 10.0
    """Squares that count at most: an arm that swings moves further, and still scores most where it is seen."""


VIEW = ViewTuning()
CONTOUR = ContourTuning()
BRIGHTNESS = BrightnessTuning()
KEYPOINT = KeypointTuning()
CAMERA = CameraTuning()
SELF_COLLISION = SelfCollisionTuning()
CONTACT = ContactTuning()
FRAME = FrameTuning()
FUSION = FusionTuning()
INTERVAL = IntervalTuning()
SHAPE = ShapeTuning()
BATCH = BatchTuning()
REFIT = RefitTuning()
APPEARANCE = AppearanceTuning()
LIMB = LimbTuning()
SKIN_COLOUR = SkinColourTuning()
REACQUISITION = ReacquisitionTuning()
