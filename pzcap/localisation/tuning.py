"""Constants of the localisation that no user sets, a table a topic. Kernels have them compiled in."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np


class LevelTuning(NamedTuple):
    """A resolution of the panorama at which a frame is aligned with it."""

    halvings: int  # of the panorama's size
    steps: int  # Gauss-Newton steps, at most
    reach_px: float  # error of the start, pixels of the panorama, from which the fit still finds its way
    pixels: int | None = None  # pixels of the frame that are compared, about; None: as many as the settings say


class AlignmentTuning(NamedTuple):
    """Fit of a frame's grey values to the panorama's."""

    border_px: int = 3  # pixels at the frame's edge that are not compared
    settled_px: float = 0.025  # pixels of the frame. A smaller step ends the fit, and leaves a tenth of that.
    settled_share: float = 0.2
    """Share of the residuals' scale. Only steps that make no pixel brighter by more end the fit."""
    near_px: float = 0.2
    """Pixels of the frame. On the finest level few pixels are compared until a step is smaller, and then all."""
    sparse: int = 4  # one of so many pixels is compared until then
    scale_sigmas: float = 4.0
    """Scale of the Geman-McClure weight, standard deviations of the residuals; smaller ones are less exact."""
    doubt: float = 4.0
    """So many pixels tell as much against a belief as one independent one would: those of one edge err alike."""
    tiles: tuple[int, int] = (8, 6)  # parts of the frame, across and down, that err independently of each other
    least_noise: float = 1.0  # grey levels. Residuals have no smaller standard deviation.
    least_curvature: float = 0.6
    """The cost's second derivative counts as at least this share of what the Gauss-Newton matrix has."""
    gain_scales: tuple[float, ...] = (0.3, 0.15, 0.08)
    """Scales of the Geman-McClure weight in the first fit of gain and vignetting, relative to the gain."""
    least_pixels: int = 50  # compared where the panorama is known; with fewer there is no fit
    linear: float = 1e-3  # change of log focal, or radians of tilt, up to which rays are linear in it, to 0.001 pixels
    free_tilt_rad: float = 0.5  # radians, standard deviation, of a tilt that is free: as good as unknown
    kicked_rad: float = 0.02  # radians, standard deviation, of tilt and roll of a tripod that was kicked
    kicked_sigmas: float = 5.0  # standard deviations of tilt or roll, as believed, from which on a tripod was kicked
    sure_agreement: float = 0.5
    """Agreement from which on a reference image, or a frame of the sweep, is where it was looked for."""
    same_px: float = 0.1  # pixels of the panorama by which two fits that have come to the same place differ, at most
    features_moved_px: float = 3.0  # pixels of the panorama by which features and grey values may differ about a place


class SearchTuning(NamedTuple):
    """Coarse search by correlation."""

    width_px: int = 56  # pixels that a frame is wide when it is compared, at most; at least half as many
    zoom_step: float = 0.05  # of log focal: edges of the nearest zoom tried are off by less than one of these pixels
    least_correlation: float = 0.4  # least correlation of a place
    least_contrast: float = 1.0  # grey levels, standard deviation: a frame of less correlates with anything


class FeatureTuning(NamedTuple):
    """Search by features."""

    of_frame: int = 400  # at most: enough for a place, and matched quickly
    of_panorama: int = 12000  # at most: it shows many times what a frame does
    search_rad: float = np.deg2rad(8.0)
    """Beyond the frame's edges, within which they are matched where the frame before is known."""
    least_inliers: int = 12  # matches that determine a place; with fewer they only say where to look
    most_pan_sigma_rad: float = np.deg2rad(0.05)  # matches that leave more do not determine a place
    least_agreement: float = 0.5  # of the grey values, that is enough where features determine the place


class ReadoutTuning(NamedTuple):
    """Read-out time from successive frames."""

    rate_sigma: tuple[float, float] = (6e-4, 2e-3)
    """Change of the rates of pan (radians) and of log focal from one frame to the next, a frame period: a hand's."""
    central_sigma: tuple[float, float] = (6e-5, 2e-4)  # errors of the same rates from the frames before and after
    systematic: tuple[float, float] = (1e-4, 1e-4)
    """Standard deviation of the shear of the panorama itself, which all frames show: that of pan as far as it is left
    in a sweep that is put right."""
    sway_share: float = 0.15  # share of a frame in what is believed of the sway of the next
    least_sway_rad: float = 2e-5
    """Standard deviation of the sway, at least: a thousandth of a degree. It grows as soon as a head moves."""
    panorama_rad: float = 0.01
    """Standard deviation of tilt, roll and shears of a panorama before it is compared with a picture."""
    least_shear_rad: float = 1e-4
    """Shear of a panorama from which on its frames are put right: 0.006 degrees, a few hundredths of a pixel in most
    rows."""
    zoom_shear: float = 5e-5
    """Shear of log focal that frames of a zoom run are known to, together, and from which on they are put right: it
    makes the travel of the projection centre a millimetre too long."""
    least_zoomed: int = 6  # frames of a zoom run that tell of the read-out, at least
    contradiction: float = 4.0
    """Standard deviations by which sweep and zoom run have to differ to be taken for filmed otherwise."""
    sweep_rounds: int = 3  # times that a sweep is put right, at most
    from_sweep: float = 0.015
    """Frame periods, standard deviation, at least, of a read-out that only the sweep has shown."""
    own: float = 0.06
    """Share of what a frame tells of the read-out that its neighbours do not. Fitted to the errors of twelve cameras of
    `rolling_shutter`, `all_cameras` and `crew`."""
    sure: float = 0.01
    """Frame periods, standard deviation from which on a read-out is known well enough to be told from none."""
    least_share: float = 0.03
    """Frame periods of a read-out, at least: a millisecond; the fastest sensors that roll take three."""
    negligible_px: float = 0.02  # pixels of the frame by which rows may be displaced without being put right
    fastest: tuple[float, float] = (0.01, 0.01)
    """Rates a frame period, standard deviation, of a frame that is searched for without one before it."""


class RepetitionTuning(NamedTuple):
    """`duplicate_frames`: pictures that are the picture before."""

    block_px: int = 8
    levels: int = 1  # grey levels by which no pixel of a repeated block has changed
    steep: float = 10.0  # grey levels from a pixel to the next, root mean square, of a block that counts half
    turned: int = 3  # pictures in which the camera turns until it is known what is written over them:
    stayed: float = 0.6  # blocks that stay in a larger share of them
    sigma_px: float = 0.4
    """Pixels, standard deviation by which a picture that is repeated as a whole is off where nothing was changing."""
    most: float = 0.2  # share from which on a picture is taken for the one before, encoded once more,
    missed_px: float = 2.0  # where it should have moved by more pixels than this: no codec passes over so many


LEVELS: Final = (LevelTuning(3, 4, 15.0, 1500), LevelTuning(1, 2, 4.0, 2000), LevelTuning(0, 12, 1.5))
ALIGNMENT: Final = AlignmentTuning()
SEARCH: Final = SearchTuning()
FEATURES: Final = FeatureTuning()
READOUT: Final = ReadoutTuning()
REPETITION: Final = RepetitionTuning()
