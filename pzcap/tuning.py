"""Constants of the notes on a take that no user sets, a table a topic."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np


class PlausibilityTuning(NamedTuple):
    """Contradictions of the footage to the papers."""

    unlocated: float = 0.1  # share of a camera's frames that are not located
    focal: float = 4e-4
    """Difference of the focal lengths of reference image and sweep, which a locked lens keeps to 2e-5, or to 2.0e-4
    with a rolling shutter under mains light; a lens that focused anew in the middle of a sweep leaves 1e-3."""
    focal_sigma: float = 0.01
    """Relative standard deviation of a focal length from which on it is in doubt: 0.0001 to 0.002 where all is
    right."""
    corners_px: float = 0.3
    """Distance of the corners of the calibration object from where object.json has them, in the median: 0.02 to 0.06
    where it is right."""
    upright: float = 0.7
    """Cosine of the angle by which the cameras' upward directions may lie off the world's z axis, in the median."""
    even: int = 127  # of a silhouette, from which on a pixel shows the athlete rather than not
    same_size: float = 0.025  # departure that a hand's keyframes may mimic
    fits: float = 0.5
    """Share of the joints that lie on the athlete, at least: 0.9 where all is right, 0.65 where the object
    alone is not."""
    alike: float = 0.02  # difference of that share that says nothing: a limb is as wide as some steps
    better: float = 0.25  # gain of that share that chance does not bring
    lost_frames: int = 3  # in a row, from which on a body that may be lost, or company, is worth a word
    touching_views: int = 2  # in which somebody else touches the athlete, at least, and in most of all
    touching_reach: float = 0.04  # of the athlete's height in the image: what counts as touching
    touching_share: float = 0.1
    """Of the area of a band so wide and as long as the athlete is tall, that shows somebody else. Where a coach keeps
    1.2 m off, no more than two of four views do; at 0.5 m three or four, most of the time."""
    readout_s: float = 1.5e-3  # read-out time from which on a camera is said to have a rolling shutter
    clock_s: float = 1.5e-3  # offset from which on a clock is said to be off
    sigmas: float = 5.0  # standard deviations from which on either is sure
    tilt_rad: float = np.deg2rad(0.02)
    """Tilt or roll, on average over the motion, from which on a tripod is said to have settled, and step of both from
    which on it is said to have been bumped: right footage has 0.002 degrees."""
    bumped_tripods: int = 2  # from which on a stabiliser is likelier
    bump_frames: int = 15  # before and after a bump, whose medians are compared
    bump_leaves: float = 0.5
    """Share of the scatter of tilt and roll about a bump that the step leaves, at most: a tenth where it rings by 0.03
    degrees and was bumped by 0.1."""
    rocks_rad: float = np.deg2rad(0.15)
    """Tilt and roll together, beside what is usual, from which on a tripod is said to rock: a sprung floor has 0.03
    degrees."""


class SlipTuning(NamedTuple):
    """Frames that a recording lost."""

    reach: int = 4  # frames, early or late, that are told
    parts: int = 4  # of a frame, by which a clock is told
    width: int = 160  # of the picture of the athlete's colours that is kept of a view until the body is known
    most_log_odds: float = 4.0  # of a pixel
    change: float = 8.0
    """Log-odds, a point, summed over the frames, that an offset, or a change of it, has to bring: right footage
    of two seconds brings 1, a frame that was lost in its middle 40."""
    beyond_clock: float = 0.7  # frames beside its clock by which a camera is off whose timecode is wrong
    most_lost: float = 0.1  # probability that the body is lost: beyond, it tells nothing of the cameras
    most_hidden: float = 0.02  # share of the body's places that somebody hides: beyond, a view tells nothing
    near: int = 5  # frames before and after the body's best guess in which pan and zoom may tell the frame
    far: int = 20  # and in which they leap nowhere if they are to contradict the body
    leap_sigmas: float = 6.0  # leap of pan and zoom, beside what is usual, from which on it tells the frame
    repeated: int = 2  # pictures shown twice, from which on a word is said


class LookAheadTuning(NamedTuple):
    """`views`: cameras that are not found in the first frame."""

    frames: int = 90  # that are looked at, at most
    stride: int = 6  # one in so many, then the others back from there


LOOK_AHEAD: Final = LookAheadTuning()
PLAUSIBILITY: Final = PlausibilityTuning()
SLIPS: Final = SlipTuning()
