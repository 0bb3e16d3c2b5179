"""Constants of the segmentation that no user sets, a table a topic. Kernels have them compiled in."""

from __future__ import annotations

from typing import Final, NamedTuple


class BackgroundTuning(NamedTuple):
    """Likelihood of a pixel's colour."""

    largest_log_odds: float = 8.0  # no pixel alone says more, for or against the body
    freedom: float = 4.0
    """Degrees of freedom of the t-distribution of differences from the hall: compression and edges err far at times."""
    peak: float = -2.6  # logarithm of its density at 0, of three colours of variance 1
    median: float = 2.78  # median of the squared difference over the variance of a colour, if that is right
    any_colour: float = 0.2  # share of colours that the body may have besides those seen
    camera_error_px: float = 0.22
    """By which the hall's edges are off: the camera's error, and parallax that the panorama does not have."""
    floor_range_m: float = 25.0  # from the camera, within which shadows on the floor are expected: those of a hall
    shadow_log_odds: float = -2.5  # of shadow against none on the floor: most of it is lit
    shadow_light: float = 0.65  # share of the light that a shadow usually leaves: a hall has many lamps
    shadow_spread: float = 0.3  # standard deviation of that share's logarithm: shadows differ much
    prediction_for: float = 3.5  # log-odds that a prediction counts with at most, for the body
    prediction_against: float = 1.5  # the same against it: less, so that a limb that is elsewhere is found


class BodyTuning(NamedTuple):
    """Shape of the body at half resolution."""

    clothes_px: float = 4.0  # by which clothes may stand off a body
    hole_log_odds: float = -2.5  # mean: a hole is none where the hall is seen no better
    near: float = 0.1  # of the body's size: a part this far off needs twice the evidence to be kept
    least_part: float = 0.02  # of the body's evidence, that a part needs
    alone: float = 0.3  # weight of the soft evidence beside the sharp frame's colours, where nothing is expected
    with_expected: tuple[float, float] = (0.15, 0.3)  # weights of the evidence, and of what is expected


class OthersTuning(NamedTuple):
    """Other people beside the athlete."""

    apart_px: float = 6.0
    """Pixels off the expected outline from which on foreground may be somebody else's; clothes stand off by less."""
    apart_sigmas: float = 3.0  # of the prediction's error, beside that
    beside_px: float = 2.0
    """Pixels off the outline from which on foreground is no longer the athlete's if it hangs together with that."""
    whole_share: float = 0.25
    """Of the expected body's area, that somebody who is seen whole covers at least: a leg is a sixth."""
    leaving_share: float = 0.08  # the same of a part of somebody, who stands over the edge of what is looked at


class CompanyTuning(NamedTuple):
    """Other people as all views together find them."""

    columns: int = 160  # of a whole view, about, in which everybody is sought; half as many of what is found
    gain_px: int = 2  # pixels of it, to either side, that are compared with the hall as one for their brightness
    blur_px: float = 0.5  # of the hall in it, standard deviation
    least_log_odds: float = -2.0  # hall speaks no louder against its neighbours: a person is a few pixels wide
    range_m: float = 5.0  # about the athlete within which others matter
    step_m: float = 0.15  # between places of the floor
    hips_m: float = 0.7  # height from which on up the middle of a person is filled: below, legs may be apart
    head_m: float = 1.5  # height up to which it is, of the smaller
    half_width_m: float = 0.1  # of that middle, whichever way the person stands
    nearest_m: float = 0.3  # before a camera; who is nearer is not sought
    least_shown: float = 0.5  # share of a person that a view has to show to be asked
    least_views: int = 3  # views that show a person, where there are so many
    filled: float = 0.75  # share of the middle that is foreground in each view
    views_apart: float = 1.2  # views, in all, that show the middle apart from the athlete
    reach_m: float = 0.8  # from the athlete's pelvis, on the floor, within which a person's limbs may touch hers
    profile_m: tuple[tuple[float, float], ...] = (
        (0.0, 0.3), (0.5, 0.28), (1.0, 0.32), (1.45, 0.3), (1.6, 0.16), (1.85, 0.14),
    )  # fmt: skip
    """Heights, and the half widths there within which a person who walks is seen from all sides."""


class BoundaryTuning(NamedTuple):
    """Boundary of the body on the sharp frame."""

    unsure: float = 1.5  # undecided is the inside, too, where the evidence is less than these log-odds
    doubt: float = 1.0
    """And where the sharp frame's colours speak for the body by less: a gap too narrow for the soft evidence."""
    least_share: float = 0.01  # share of body in the window of the colours nearby: with less, nothing is known of them
    parts: tuple[float, ...] = (0.0, 0.25, 0.75, 1.0)  # of a pixel that may be body: more than half makes it so
    colour_variance: float = 50.0  # of luma and chroma, added to what is measured nearby
    least_likelihood: float = 1e-6  # a colour that is neither's says nothing
    independence: float = 0.7  # share of the colours' log-odds that counts: neighbours err together
    largest_log_odds: float = 3.0  # no colour says more
    edge_weight: tuple[float, float, float] = (2.5, 1.0, 1.0)
    """By which a step of luma and of chroma separates neighbours."""
    edge_variance: float = 1000.0  # ties fall as the exponential of minus the squares of these steps over this


BACKGROUND: Final = BackgroundTuning()
BODY: Final = BodyTuning()
BOUNDARY: Final = BoundaryTuning()
COMPANY: Final = CompanyTuning()
OTHERS: Final = OthersTuning()
