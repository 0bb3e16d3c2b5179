"""Constants of `pzcap check` that no user sets, a table a topic."""

from __future__ import annotations

from typing import Final, NamedTuple


class ViewsTuning(NamedTuple):
    """Views compared with each other by features."""

    most_features: int = 600  # of a view
    most_in_sweep: int = 1200  # of one of the sweep, in which those of a longer zoom have to be
    contrast: float = 50.0  # grey levels, standard deviation that dark halls are brought to
    most_gain: float = 4.0  # by so much at the most
    ratio: float = 0.85  # of the distances of the best and the second best match, at most
    tolerance_px: float = 4.0  # of a match about the similarity that most agree on
    step_width: int = 320  # pixels, of the pictures that are correlated from frame to frame


class ReferenceTuning(NamedTuple):
    """The image of the calibration object."""

    smallest_px: float = 20.0  # of a marker's side
    turned_deg: float = 20.0  # roll from which on the camera is said to be turned


class SweepTuning(NamedTuple):
    """Pan sweep."""

    key_deg: float = 7.0  # degrees between the views that are kept
    thumbnail: int = 160  # pixels that it is wide
    usual_field: float = 1.2  # focal length over width, where no reference image tells it
    least_round_deg: float = 300.0  # from the start, of pictures in which it is looked for again
    least_guessed_deg: float = 150.0  # the same, where the focal length is that guess
    back_deg: float = 30.0  # turning back that no sweep is found from; of 10 degrees, and a stop, one is as good as any
    ring: float = 0.04  # of log focal length between reference image and sweep, that is told
    ring_far: float = 0.15  # the same, from which on calibration has not been tried
    unsure: float = 0.03  # response of the phase correlation, below which a step is not known
    bare: float = 0.5  # share of a sweep's median response below which two frames show next to nothing


class MotionTuning(NamedTuple):
    """The motion against the sweep."""

    samples: int = 8  # pictures that are compared
    tilt_deg: float = 0.35  # against the sweep, from which on the head is said to have moved
    tilts: tuple[float, float] = (15.0, 85.0)  # percentiles of the pictures' tilts: one or two may be placed wrongly
    tilted_deg: float = 0.35  # between pictures, from which on it is said to have been tilted while it filmed
    turned_deg: float = 20.0  # roll against it, from which on the camera is said to be turned
    band_pictures: int = 10  # one after the other, in whose rows bands of light are sought
    row_pictures: int = 40  # the same, in which the comb of interlaced video is
    bands: float = 0.04  # scatter of the brightness of rows from one picture to the next, from which on it is told
    level: float = 0.1  # widths of the picture above or below, from which on it is not that camera's sweep
    sure: float = 80.0  # features that agree, a picture, from which on nobody else's sweep has to be asked
    better: float = 1.5  # times as many features, of the sweep of which it is then said to be
    usual: float = 0.5
    """Share of the pictures that fit: features tell little of a picture at a long zoom, and half of them do
    not."""
    fewest: float = 0.25  # the same, below which all are of something else


class BodyTuning(NamedTuple):
    """Keyframes and the body."""

    keyframes: int = 3  # keyframes that are looked at
    off: float = 0.06  # of a size of 1
    away: float = 0.35  # of the body's height in the picture
    fewest: int = 4  # pictures in which the athlete is found, at least
    changed: int = 12  # grey levels
    rows: int = 9  # that are lit alike
    furthest: float = 1.2  # heights from where the keyframe puts the athlete
    least_score: float = 0.45  # of an outline that is taken for the athlete
    smallest_px: float = 20.0  # height of a body that is looked for


class ForecastTuning(NamedTuple):
    """Terms of the forecast; fitted to captures of the simulator."""

    worth: float = 4.0
    """Variance reached over that of the bound of independent pixels: compression, interpolation, a panorama
    with noise."""
    partial_scale: float = 0.0002  # standard deviation of the scale of a sweep of 120 degrees
    partial_power: float = 2.2  # how much faster than in proportion the scale gets worse with a shorter sweep
    bands: tuple[float, float] = (3.0, 5.0)  # of pan and focal length under bands of light, in those of the floor
    coarse_px: float = 640.0
    """Width of a picture below which the floor of the pan, in pixels, rises: it samples the hall too
    coarsely."""
    body_mm: float = 2.5  # of a joint, by the lengths of the body alone
    joint_px: float = 0.35  # of a joint, pixels at the athlete, by four cameras and a keyframe a second
    full: int = 4  # cameras
    dense_s: float = 1.0  # between keyframes


VIEWS: Final = ViewsTuning()
REFERENCE: Final = ReferenceTuning()
SWEEP: Final = SweepTuning()
MOTION: Final = MotionTuning()
BODY: Final = BodyTuning()
FORECAST: Final = ForecastTuning()
