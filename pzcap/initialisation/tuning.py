"""Constants of the initialisation that no user sets, a table a topic; ``fitted``: to simulated detectors."""

from __future__ import annotations

from typing import NamedTuple


class PeopleTuning(NamedTuple):
    """The athlete among others, and sides."""

    least_confidence: float = 0.1  # a keypoint found with less does not count
    agree_m: float = 0.15  # a ray that passes by further off is of something else
    sides_agree_m: tuple[float, ...] = (0.15, 0.15, 0.1)  # the same where sides are told: of arms, legs and face
    most_people: int = 3  # in a view: those nearest to its middle
    most_views: int = 6  # with more, not all ways to choose people are tried
    most_patterns: int = 40  # ways to exchange sides, beyond which more views at a time are not exchanged
    central: float = 4.0  # worth of standing in the middle of a view: cameras follow the athlete; in agreeing views
    jump: float = 20.0  # agreeing views that a leap to somebody else costs
    jump_m: float = 1.0  # that nobody moves by in a frame
    exchange: float = 0.05  # agreeing rays a keypoint that an exchange of a view's sides costs
    change: float = 0.2  # the same that it costs to begin, or end, such an exchange: detectors err for some frames
    step: float = 2.0  # agreeing rays that a leap of a keypoint costs
    step_m: float = 0.3  # that no keypoint moves by in a frame


class FitTuning(NamedTuple):
    """Fit of the body to keypoints."""

    stretch: int = 300  # frames that are fitted together
    beyond: int = 20  # and so many of the next ones
    scales: tuple[float, ...] = (10.0, 5.0, 3.0)  # sigmas, of the robust weights, from round to round
    iterations: int = 6  # of a round, at most
    tolerance: float = 3e-3  # metres, radians: a smaller step ends a round
    longest_step: float = 0.5  # metres, radians
    damping: float = 1.0  # 1 / rad^2 or m^2: what nothing says does not move
    acceleration: float = 1.5  # factor of the tracker's sigma of an acceleration
    # standard deviations of joints about rest; wide: they only keep from folding what no keypoint shows
    head_deg: float = 40.0
    hand_deg: float = 29.0
    foot_deg: float = 40.0
    limit_rad: float = 0.05  # standard deviation beyond the limits of the joints, which are wide and soft
    spine_rad: float = 0.15  # wider than the tracker's: shoulders and hips of a detector are off together
    rounds: int = 2  # of learning what the detector means, and of fitting anew
    stride: int = 3  # one of so many frames is learned from: its neighbours say the same
    doubt: float = 20.0  # so many keypoints tell as much as one would of that: it changes with the posture
    open: float = 2.0  # 1 / rad^2: information on what nothing shows, such as the twist of a straight arm


class SelectionTuning(NamedTuple):
    """Choice of keyframes."""

    growth_m2: float = 3e-4  # of the variance of a joint with each frame from a keyframe
    one_sided: float = 3.0  # factor of that before the first keyframe and after the last
    spacing_s: float = 1.5  # a longer interval between two keyframes is worth another
    unknown_m2: float = 1.0  # variance without any keyframe


class JudgementTuning(NamedTuple):
    """Poses that are sure enough to start from."""

    least_views: int = 2
    usual_misfit: float = 0.6  # sigmas, of the keypoints from the fitted body: what is more makes a pose less sure
    largest_misfit: float = 1.5  # sigmas, from which on a pose is no candidate
    largest_move: float = 2.0  # squared, in sigmas a degree of freedom, by which the images may move the pose
    misplaced: float = 0.6  # probability of any joint's being misplaced, from which on the images do not bear it out


class HeadsTuning(NamedTuple):
    """Poses of the cameras to each other by the moving body."""

    first_points: int = 600  # that first values are found from
    fewest_points: int = 40  # that two cameras, or a camera and others, have to see in common
    step_deg: float = 2.0  # of the headings that are tried
    steps: int = 6  # of reweighting
    fine_rad: float = 0.010  # a heading is refined until its step is so fine
    least_lever: float = 0.05  # sine of the angle between a ray and the base line: a ray along it tells nothing
    least_worth: float = 0.15  # of the first pair: share of rays that agree times the sine at which they meet
    least_agreement: float = 0.2  # share of a further camera's rays that agree
    agree_rad: float = 0.02  # rays further off than this are wrong
    first_adjusted: int = 2  # more cameras than so many are adjusted before the next is placed
    least_sigma_rad: float = 3e-4  # of a ray: no detector is better
    iterations: int = 40
    loose: float = 6.0  # sigmas of the robust weights, in the first half of the iterations
    tight: float = 3.0
    lean_rad: float = 0.005  # of a head from the vertical, each way: a third of a degree
    settled_rad: float = 1e-6
    damping: float = 1e-4  # of a point, against one ray: one that nothing weighs stays
    doubt: float = 10.0  # so many keypoints tell as much as one would: frames that are alike mislead alike
    most_frames: int = 300  # that are used
    rounds: int = 2  # of telling people and sides, and of adjusting anew
    fewest_lengths: int = 8  # of a limb, that its length is the median of
    floor_percentile: float = 2.0  # of the feet's heights: lower ones are wrong
    sole_m: float = 0.01  # that a foot's keypoints lie above the floor


class FloorTuning(NamedTuple):
    """Heads placed by the floor that their panoramas have in common."""

    reach_m: float = 8.0  # half the side of the square of floor that is used, about the middle of what is done
    step_m: float = 0.5  # from a patch to the next
    patch_m: float = 1.2  # side of a patch
    cells_m: tuple[float, ...] = (0.05, 0.05, 0.025)  # of the rectified pictures, from round to round
    search_m: tuple[float, ...] = (1.5, 0.5, 0.15)  # how far a patch is sought, from round to round
    least_contrast: float = 4.0  # grey levels, standard deviation: a patch of less is bare
    least_correlation: float = 0.7  # normalised, of a patch that is found
    least_lead: float = 0.1  # of its correlation over any elsewhere: patterns repeat
    lobe_m: float = 0.3  # half the width of a correlation's peak: what lies beyond is elsewhere
    fewest: int = 40  # patches that each camera has in common with others
    least_agreement: float = 0.6  # share of the patches whose rays meet
    largest_sigma_rad: float = 2e-3  # of a ray; a pixel or so: rays that are off by more have met by chance
    doubt: float = 6.0  # patches overlap: so many tell as much as one
    lowest_m: float = 0.3  # of a camera above the floor
    steps: int = 5  # of reweighting the level
    tight: float = 3.0  # sigmas of its robust weights
    flat_m: float = 0.002  # a floor is no flatter
    apart: float = 4.0  # sigmas of the heads' places by keypoints, by which the floor may correct them


class HeightTuning(NamedTuple):
    """Height of the athlete by contours."""

    tried: int = 60  # frames whose poses are fitted to keypoints
    frames: int = 20  # of these, from all over the take, whose contours are used
    fewest: int = 3
    rounds: int = 6  # of fitting poses and shape in turns
    step_m: float = 1e-4  # for the slope of the height
    sigma: float = 0.004  # of its logarithm, however many frames: hair, shoes, outlines that are off alike
    open: float = 10.0  # times the sigma of the scale by limbs, by which the size is open: contours alone tell it


class LengthsTuning(NamedTuple):
    """Scale of the world by lengths that were measured."""

    click_px: float = 1.0  # of a mark, each way
    floor_m: float = 0.003  # of the floor's height, where the floor has placed the cameras
    floor_by_feet_m: float = 0.02  # the same where the feet alone tell where it is
    most_condition: float = 1e8  # of the equations of a point: beyond it its lines of sight are parallel
    most_misfit: float = 4.0  # sigmas by which lines of sight pass each other: more shows different points
    least_m: float = 0.05  # between the ends of a length
    most_sigmas: float = 4.0  # of a length from the others: more contradicts them
    before: int = 2  # frames before a mark's that show how the camera turns there


PEOPLE = PeopleTuning()
HEADS = HeadsTuning()
FLOOR = FloorTuning()
HEIGHT = HeightTuning()
LENGTHS = LengthsTuning()
SELECTION = SelectionTuning()
JUDGEMENT = JudgementTuning()
FIT = FitTuning()
