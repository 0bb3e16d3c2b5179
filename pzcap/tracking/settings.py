"""Settings of the tracking."""

from __future__ import annotations

from dataclasses import dataclass, field

from pzcap.types import PzcapError


@dataclass(frozen=True, slots=True)
class Terms:
    """Residuals that count in one round of iterations, and how."""

    level: int
    """Pyramid level of the brightness, in a view of `ViewTuning.usual_px_per_m`."""
    reach_px: float
    """Distance from the body's contour within which the silhouette's edge is sought."""
    contour_sigma_px: float
    brightness_sigma: float
    """Grey levels; scale of the robust weight."""
    contour_weight: float
    """Neighbouring contour points err together: each counts for this much of an independent one."""
    brightness_weight: float
    """As that of the contour."""
    shading_sigma: float
    """Relative change of a limb's brightness that light may explain."""
    keypoint_weight: float = 0.0
    """As that of the contour: a detector errs alike in all views."""
    keypoint_scale: float = 3.0
    """Sigmas; of the robust weight."""


@dataclass(frozen=True, slots=True)
class Round:
    """Some iterations with the same residuals."""

    terms: Terms
    """Residuals that count."""
    iterations: int
    """At most."""
    stiffness: float = 1.0
    """Factor of the joints' prior; large: the body moves as a whole."""
    solid: bool = True
    """The trunk keeps arms out; else one that is found again may pass through it."""
    surprise_m: float = 0.0
    """The round is left out where predictions have been nearer than this lately."""


def _schedule() -> tuple[Round, ...]:
    def terms(
        level: int, reach: float, contour_sigma: float, contour_weight: float, brightness_sigma: float,
        keypoint_scale: float,
    ) -> Terms:  # fmt: skip
        return Terms(level, reach, contour_sigma, brightness_sigma, contour_weight, 0.15, 0.15, 0.3, keypoint_scale)

    # the edge that is nearest to a hand is often another limb's: limbs by themselves are led to far edges with caution
    return (
        Round(terms(2, 30.0, 8.0, 0.3, 20.0, 10.0), 5, 5.0, solid=False, surprise_m=0.025),
        Round(terms(2, 20.0, 4.0, 0.15, 20.0, 10.0), 4, solid=False),
        Round(terms(1, 10.0, 2.0, 0.2, 15.0, 5.0), 3),
        Round(terms(0, 5.0, 1.0, 0.3, 12.0, 3.0), 1),
    )


@dataclass(frozen=True, slots=True)
class TrackingConfig:
    """Defaults suit a body of 150-400 pixels at 25-60 frames a second."""

    velocity_gain: float = 0.8
    """Share of a frame's motion that the velocity takes on."""
    limit_sigma_rad: float = 0.05
    """Standard deviation beyond the limits of the joints, which are wide and soft."""
    spine_sigma_rad: float = 0.07
    """Standard deviation of the bend of the lumbar and the thoracic joint, about each axis; its distribution has long
    tails."""
    cut_out_margin: float = 0.1
    """Margin that is kept of a view around the body, in sizes of the body."""
    step_tolerance: float = 3e-3
    """Metres, radians: a smaller step ends a round, and a frame that makes one is at rest."""
    schedule: tuple[Round, ...] = field(default_factory=_schedule)
    """Rounds of a fit, coarse to fine."""
    body_size: bool = True
    """Correct the size of the whole body where the first keyframe's silhouettes show another than the tape."""
    drape: bool = True
    """Find in each frame by how much loose clothes (subject.json) are displaced; else they move with the body."""
    shape_weight: float = 0.05
    """Weight of a frame's contour in the estimate of the body's shape: the next frame errs alike. 0: the body stays as
    the tape has it."""
    shape_rounds: int = 16
    """Alternations of correcting the body and the poses of an interval, at most; they end once the joints stay."""
    polishing_sweeps: int = 16
    """Gauss-Newton steps of all frames of an interval together, at most; they end once no frame moves."""
    longest_stretch: int = 200
    """Frames that wait for a keyframe to be tracked backward."""
    longest_lead: int = 120
    """Frames before the first keyframe that are kept to be tracked backward."""
    camera_refinement: bool = True
    """Correct pan and focal length of each view along with the pose, where the background leaves them open."""
    self_collision: bool = True
    """Keep the arms out of the trunk: a hidden forearm could as well be inside it."""
    skin_colours: bool = True
    """Learn the colours of the lower arms at the keyframes, to see an arm before the trunk."""
    clock_sigma: float = 0.3
    """Frame periods, standard deviation, by which the cameras' clocks are off from each other: timecode alone leaves up
    to half a frame. 0: they are locked to each other."""
    second_fields: bool = True
    """Track by both fields of interlaced video: half as far from one pose to the next."""
    contacts: bool = True
    """Tie points at rest on the floor to where they are: a standing foot trembles otherwise."""
    appearance_score: bool = True
    """Judge limbs also by what they look like, where the passes disagree or a limb is lost."""
    reacquisition: bool = True
    """Search between two keyframes for limbs that both passes have lost."""
    shape_refit: bool = True
    """Refit early frames to the body as it is known in the end."""
    keypoint_keyframes: bool = True
    """Find keyframes in a detector's keypoints, where those set by hand are few or none."""

    def __post_init__(self) -> None:
        if not self.schedule or self.schedule[-1].surprise_m > 0.0:
            raise PzcapError("tracking.schedule has no last round that is always made; give it surprise_m: 0")
