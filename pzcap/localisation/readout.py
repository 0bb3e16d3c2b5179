"""Read-out time of a camera: how long after its top row the bottom row of a frame is exposed (rolling shutter).

In a frame whose camera turns by ``w`` a frame period, rows differ in pan by the shear ``s = rho w`` from top to bottom,
rho being the read-out as a share of the frame period; so it is with the log focal length. A frame shows its shear
(`photometric_alignment`), the two before and the two after it show ``w``: rho follows by recursive least squares, and
with it what shear to expect of the next frame. What the panorama itself is sheared by, all frames show beside that,
however they turn: it is estimated with rho, which is no surer than the two can be told apart. rho is negative in a
camera that hangs upside down, and 0 with a global shutter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from pzcap.geometry.camera import wrapped
from pzcap.localisation.tuning import READOUT
from pzcap.types import Array, Localisation, PanZoomCamera

_AROUND: Final = 5  # frames that show the rate in the middle one
_AMID: Final = _AROUND // 2


class Readout(NamedTuple):
    """Estimate of the read-out."""

    share: float  # of the frame period
    sigma: float  # if frames err independently
    believed: float  # sigma before any frame
    panorama: Array = np.zeros(2)  # (2,) shear of pan and log focal that all frames show, whatever their rates
    joint: Array | None = None  # (3, 3) covariance of share and panorama; None: nothing has been seen

    @staticmethod
    def of(camera: PanZoomCamera, frame_rate: float, belief: float) -> Readout:
        """Read-out of the ``camera`` as the sweep has shown it, or else ``belief``, a standard deviation.

        A head that stood still for each frame of the sweep would have shown none: none is not taken for certain.
        """
        if camera.readout_sigma_s == 0.0:
            return Readout(0.0, belief, belief)
        sigma = min(max(camera.readout_sigma_s * frame_rate, READOUT.from_sweep), belief)
        return Readout(camera.readout_s * frame_rate, sigma, sigma)

    def as_before(self) -> Readout:
        """The estimate before any of the frames that have told it is seen once more."""
        sigma = max(self.deviation, READOUT.from_sweep)
        return Readout(self.share, sigma, sigma)

    @property
    def is_open(self) -> bool:
        """True of a shutter that rolls, or may for all that is known, by a read-out that is not known well."""
        return self.sigma > READOUT.from_sweep and abs(self.share) + self.sigma > READOUT.least_share

    @property
    def deviation(self) -> float:
        """Standard deviation that is claimed. Frames that follow each other see the same of the panorama, and err
        alike: what they have told beyond what was believed counts for a share of itself."""
        before = self.believed**-2.0
        return float((before + READOUT.own * (self.sigma**-2.0 - before)) ** -0.5)

    @property
    def is_global(self) -> bool:
        """True of a shutter that is known well enough to expose all rows at once, as most cameras' that seem to do so.
        Errors of the panorama are no longer taken for a shear then."""
        return self.sigma < READOUT.sure and abs(self.share) < READOUT.least_share

    def shear(self, rate: Array, change: Array) -> tuple[Array, Array]:
        """Expected shear (2,) of pan and log focal of a frame, and its standard deviation, from their ``rate`` (2,) a
        frame period, as it was between the two frames before, and by how much that has changed lately (2,)."""
        if self.is_global:
            return np.zeros(2), np.zeros(2)
        off = np.square(READOUT.rate_sigma) + np.square(1.5 * change)  # one and a half periods after that rate
        variance = (self.share**2 + self.sigma**2) * off + self.sigma**2 * rate**2
        return self.share * rate, np.sqrt(variance)

    def updated(self, found: Localisation, expected: Localisation, rate: Array) -> Readout:
        """The estimate after the shear of a frame in which pan and log focal change by ``rate`` (2,) a frame period.
        What counts is the information that was ``found`` beyond what was ``expected``."""
        posterior, prior = found.shear_sigma**-2.0, expected.shear_sigma**-2.0
        gained = np.maximum(posterior - prior, 1e-12 * posterior)
        seen = (posterior * found.shear - prior * expected.shear) / gained
        variance = 1.0 / gained + self.share**2 * np.array(READOUT.central_sigma) ** 2
        design, joint = _design(rate), self._joint()
        gain = joint @ design.T @ np.linalg.inv(design @ joint @ design.T + np.diag(variance))
        state = np.append(self.share, self.panorama)
        state = state + gain @ (seen - design @ state)
        joint = joint - gain @ design @ joint
        joint = 0.5 * (joint + joint.T)
        return Readout(float(state[0]), float(np.sqrt(joint[0, 0])), self.believed, state[1:], joint)

    def _joint(self) -> Array:
        """(3, 3) `joint`, or what it is before anything is seen."""
        if self.joint is not None:
            return self.joint
        return np.asarray(np.diag([self.sigma, *READOUT.systematic]) ** 2, np.float64)


def _design(rate: Array) -> Array:
    """(2, 3) derivatives of the shear of a frame by share and panorama."""
    return np.column_stack([rate, np.eye(2)])


class Sway(NamedTuple):
    """Tilt and roll of a head about where it was locked, lately: most do not at all, and what a frame seems to
    show of it then is noise."""

    tilt_rad: float  # at which it was locked
    variance: Array  # (2,) of tilt and roll

    def updated(self, found: Localisation) -> Sway:
        """The estimate after one more frame, by an expectation-maximisation step of the variance."""
        off = np.array([found.tilt_rad - self.tilt_rad, found.roll_rad])
        share = READOUT.sway_share
        variance = (1.0 - share) * self.variance + share * (off**2 + found.sway_sigma**2)
        return Sway(self.tilt_rad, np.maximum(variance, READOUT.least_sway_rad**2))


class History(NamedTuple):
    """A camera's frames so far, as far as the next needs them."""

    readout: Readout
    sway: Sway
    seen: tuple[Localisation, ...] = ()  # the last frames, one after the other, that were found; four at most
    expected: tuple[Localisation | None, ...] = ()  # what had been expected of each

    @property
    def last(self) -> Localisation | None:
        """The last frame; None where it was not found."""
        return self.seen[-1] if self.seen else None

    def followed_by(self, found: Localisation, expected: Localisation | None) -> History:
        """With one more frame, of which something was ``expected``."""
        if not found.valid:
            return History(self.readout, self.sway)
        seen, expectations, readout = (*self.seen, found), (*self.expected, expected), self.readout
        if len(seen) == _AROUND and not readout.is_global and (amid := expectations[_AMID]) is not None:
            readout = readout.updated(seen[_AMID], amid, rate_amid(seen))
        kept = slice(1 - _AROUND, None)
        return History(readout, self.sway.updated(found), seen[kept], expectations[kept])

    def predicted(self) -> Localisation | None:
        """The next frame's place, if head and zoom ring turn on at the same speed, and the shear that is expected then;
        None if the last frame was lost."""
        last = self.last
        if last is None:
            return None
        sway = np.sqrt(self.sway.variance)
        if len(self.seen) == 1:
            fastest = np.hypot(self.readout.share, self.readout.sigma) * np.array(READOUT.fastest)  # rate is not known
            return replace(last, sway_sigma=sway, shear=np.zeros(2), shear_sigma=fastest)
        before = self.seen[-2]
        rates = np.array([rate_between(one, other) for one, other in pairwise(self.seen)])
        rate, changes = rates[-1], np.diff(rates[-3:], axis=0)
        change = np.sqrt(np.mean(np.square(changes), axis=0)) if len(changes) else np.zeros(2)
        shear, shear_sigma = self.readout.shear(rate, change)
        return replace(
            last, pan_rad=float(wrapped(last.pan_rad + rate[0])), tilt_rad=2 * last.tilt_rad - before.tilt_rad,
            focal_px=last.focal_px * float(np.exp(rate[1])), sway_sigma=sway,
            shear=shear, shear_sigma=shear_sigma,
        )  # fmt: skip


def rate_amid(seen: Sequence[Localisation]) -> Array:
    """Change (2,) of pan and log focal a frame period in the middle one of five frames, by the quartic through them.
    From its two neighbours alone the rate of a camera that swings to and fro is too low, at 1.7 Hz by 2 %."""
    return np.asarray((8.0 * rate_between(seen[1], seen[3]) - rate_between(seen[0], seen[4])) / 12.0, np.float64)


def rate_between(before: Localisation, after: Localisation) -> Array:
    """Change (2,) of pan and log focal."""
    return np.array([float(wrapped(after.pan_rad - before.pan_rad)), np.log(after.focal_px / before.focal_px)])
