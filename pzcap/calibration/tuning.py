"""Constants of the calibration, a table a topic; what a user may want to set stands in the settings instead."""

from __future__ import annotations

from typing import NamedTuple


class FeatureTuning(NamedTuple):
    """`features`."""

    least_step: float = 0.04  # image widths. Frames less far apart are left out: they add time, and no information.
    most_skipped: int = 8  # frames in a row that are left out, at most
    max_distance: int = 130
    """Bits of 486. Descriptors further apart are not of the same thing, however much further all others are."""
    sure_links: float = 4.0
    """Times the least number of matches that make a link: fewer near the pan that is expected may be chance."""
    sure_share: float = 0.5
    """Share of the matches of the link before: so may fewer. Where a pan turned back, 65 beside 800 were."""
    few: int = 120
    """Features of a frame; where it shows fewer, fainter ones are sought. Frames of a hall with things on its walls
    show 200 and more."""
    faint: float = 0.1  # times the usual threshold of their response
    least_part_rad: float = 1.5
    """That a part of a sweep between two gaps turns, at least, to be of use: with the field of view, what an athlete in
    the middle of a hall is followed through."""
    least_agreed: float = 0.3
    """Share of the matches across a place of the sweep that agree with all others where it holds together. Seen: 0.94
    and more; 0.008 where it was torn."""
    all_scales: tuple[int, int] = (4, 4)  # octaves of AKAZE, and levels in each, as its authors have it
    few_scales: tuple[int, int] = (2, 2)
    """The same where images are about equally fine: as many matches, in less than half the time."""


class ReferenceTuning(NamedTuple):
    """`reference_camera`."""

    min_markers: int = 3  # fewer do not fix a camera whose lens is unknown
    corner_tolerance: float = 0.25  # share of a marker's side by which Tsai's linear stages may miss its corners
    triples: int = 100  # samples of three markers that are tried where not all of them fit one camera
    corner_sigma_px: float = 0.1  # pixels, of a detected corner: what the prior of k1 is weighed against
    outlier_sigmas: float = 4.0  # standard deviations of the corners' residuals: those beyond count less and less
    pose_agreement: float = 5.0
    """Standard deviations between the pose of the corners and that of the grey values; beyond, the former stays."""
    least_corner_error_px: float = 0.02  # pixels. Corners are not taken for better than this.


class MarkerTuning(NamedTuple):
    """`marker_pose`."""

    margin_cells: float = 0.5  # cells of the white around a marker that are looked at
    blur_px2: float = 0.2  # square pixels: variance of the blur, beside the pixel's own square, before the fit
    blur_sigma_px2: float = 1.0  # standard deviation about that
    least_blur_px2: float = 0.015  # square pixels: its lower bound
    most_blur_px2: float = 9.0  # square pixels: its upper bound
    steps: int = 24  # Gauss-Newton steps, at most
    loose_steps: int = 4  # first steps, in which outliers pull a little (Huber), so that none wins by being there first
    weighed_steps: int = 12  # steps after which the weights stay, lest they and the pose chase each other
    huber: float = 1.345  # standard deviations
    tukey: float = 8.0  # standard deviations: wide, for the tails of what the model misses are long
    least_noise: float = 0.3  # grey levels: what rounding leaves
    settled: float = 0.02  # standard deviations of the pose: a shorter step is the last


class BeliefTuning(NamedTuple):
    """Priors of the focal length, relative, and of the lens beyond k1."""

    focal_sigma: float = 0.005
    """From the reference image. A circle that closes fixes it far better, and then ten times this is believed."""
    implausible_px: float = 16.0
    """By how much an object that is as wide as the image would look wider by one focal length than by another, from
    which on the sweep contradicts the object. Seen: up to 9 where it is right (640 and 320 columns), 26 where not."""
    partial_scale_sigma: float = 1e-3
    """Relative: where no circle closes, 0.02 pixels of compression or lens stretch the whole. Fitted to captures."""
    partial_scale_by_fields: float = 3.5e-3
    """The same of interlaced video, every other row of which is made of those beside it. Fitted to `all_cameras` with
    sweeps of 200 degrees."""
    parallax_scale_sigma_m: float = 3e-3
    """Relative, a metre of the projection centre's offset: what stands before the walls shifts against them, and the
    surroundings have walls and floor alone. Fitted to captures by plain heads."""
    travel_by_fields_m: float = 3e-3
    """Metres a unit of log focal, of the projection centre's travel: of interlaced video every other row is made of
    those beside it, and in its zoom run the travel comes out too short by so much. Fitted to captures."""
    usual_lens: float = 0.03  # share of the standard deviations of k2, p1 and p2 that is believed of a lens at first
    unusual: float = 2.0  # standard deviations. A lens that is drawn further from that is given the whole.
    other_side: tuple[float, float] = (0.03, 0.3)
    """Camera heights, and their inverse: offset of the projection centre, to the other side of the axis, and nearness
    of the walls, of the second start."""
    same_focal: float = 5e-4
    """Relative: starts that end nearer to each other in focal length have found the same minimum."""
    deciding: int = 4  # of so many grey values one is used to decide between two minima
    worse_by_features: float = 0.6
    """A minimum whose residuals are so much worse, a share times the square root of the number of matches, is not the
    right one. Seen, where the other one was wrong: 0.3 at most, and 0.4 of a third of the matches of a small image."""
    worse_by_some: float = 12.0
    """Deviance by a part of the grey values and all else that is known, by which a minimum that is worse is not the
    right one. Seen: 31 to 89 where the other one is wrong."""
    object_px: float = 6.0  # standard deviation of the same width by the focal length of the calibration object alone


class FocalTuning(NamedTuple):
    """`focal_from_sweep`: where no calibration object tells the focal length."""

    frames: int = 60
    """Frames of the sweep that are looked at, from its start: a third of a turn at ten degrees a second."""
    pairs: int = 10  # pairs of them that vote
    fewest_pairs: int = 3
    apart: float = 0.35
    """Image widths that the frames of a pair lie apart: the further, the more the focal length shows."""
    shortest: float = 0.4  # image widths: focal lengths from here on are tried
    longest: float = 6.0  # image widths: up to here
    step: float = 0.03  # of their logarithm
    tolerance_px: float = 3.0  # pixels within which matches name one pan; distortion is unknown as yet
    slope_tolerance: float = 0.05  # slopes that are alike: tilt and roll are unknown as yet
    sigma: float = 0.3  # relative standard deviation of the focal length that was voted for
    usual_height_m: float = 1.6  # height of a camera on its tripod, until the scene has told it


class HallTuning(NamedTuple):
    """The hall's distances."""

    azimuths: int = 72  # number of directions round the turn in which walls are estimated
    slopes: int = 10  # number of slopes at which departures from these are estimated from grey values
    wall_nearness: float = 0.15  # inverse camera heights: inverse distance of a wall before anything is known
    nearer: float = 0.2
    """A share of floor's or wall's inverse distance, by which what stands before them is nearer: a bench, a box."""
    shift_px: float = 0.15  # pixels a radian of pan, by which it shifts against them at least: less is chance
    apart_sigma: float = 0.01
    """Camera heights: standard deviation of departures where something stands apart, times the offset of the
    projection centre. The further that is off, the less has to be left open for as large a shift."""
    least_offset: float = 0.003  # camera heights: a projection centre nearer to the axis is taken to be so far off
    min_height_m: float = 0.2  # metres. A camera lower than this over the world's origin does not stand on its floor.


class ZoomTuning(NamedTuple):
    """Zoom run in `correspondences`."""

    steps: tuple[int, ...] = (1, 2, 4, 8)  # zoom frames are matched with those so many frames further on
    spread: tuple[float, ...] = (-0.3, 0.0, 0.3)  # and with the frames of the sweep so many fields of view off
    sure_matches: int = 80  # so many matches that agree end the search for the run's place


class StitchingTuning(NamedTuple):
    """`stitching`."""

    different: float = 8.0  # grey levels, mean over a few pixels, that noise and resampling do not make
    feather_px: float = 12.0  # pixels over which a frame fades in from its upper and lower edge


class BundleTuning(NamedTuple):
    """`bundle_adjustment`."""

    settled_rad: float = 1e-5  # largest change of a pan that ends the adjustment: a hundredth of a pixel
    least_sigma_px: float = 0.01  # no match is better than this, however well all agree


class PhotometricTuning(NamedTuple):
    """`photometric_bundle_adjustment`."""

    tile_px: int = 16  # side of the squares that each give the same number of edges, so that they come from everywhere
    choice: float = 8.0
    """Edges of a frame that are looked for, times the pixels of a pair that are compared: a pair that overlaps by an
    eighth still has them."""
    border: float = 6.0  # pixels at the edge left out, times the smoothing, which reaches beyond
    steps: int = 4  # Gauss-Newton steps, at most
    some: int = 4
    """One of so many pixels is compared at first: focal length, walls and projection centre make up for each other, and
    come to rest slowly."""
    steps_on_some: int = 12  # Gauss-Newton steps on these, at most
    open_steps: int = 4  # Gauss-Newton steps on these with all distances open, at most: what stands apart shows soon
    driven: float = 0.7
    """Share of the projection centre's offset by which it moves in these, from which on it is light that moves it.
    Seen: 0.08 to 0.43 in clean footage of 640 columns, 0.97 and more in that of 320, or with mains light and noise."""
    rounds: int = 2
    """Rounds in which it is told on these what stands before the walls and on the floor, and what follows from that."""
    steps_of_round: int = 3  # Gauss-Newton steps of a round, at most
    settled_on_some_rad: float = 1e-5  # largest change of a pan that ends these
    match_scale_px: float = 1.0  # scale of the robust weight of matches of features
    alike: float = 40.0
    """Pixels that tell as much against a belief as one independent one would: what is left over is no noise but the
    same in neighbouring ones, and in all overlaps of a frame."""
    doubt: float = 16.0
    """Ratio of the parameters' variance to that by independent pixels, where each overlap by itself is off by no more
    than its pixels let one expect: a frame errs alike in all its overlaps. Fitted to captures."""
    doubt_apart: float = 8.0
    """The same where what stands apart from floor and walls is told from them: taken for these, it makes the focal
    length too long. Fitted to sixteen cameras."""
    settled_rad: float = 2e-7  # largest change of a pan that ends the adjustment: a five thousandth of a pixel


class PropagationTuning(NamedTuple):
    """`propagation`."""

    pans: int = 24  # pans round the turn at which the covariance is computed; between them it is interpolated
    zooms: tuple[float, ...] = (0.7, 1.0, 1.5, 2.2, 3.3, 5.0)  # focal lengths, in units of the sweep's, at which it is
    grid: tuple[int, int] = (12, 9)  # pixels of a frame that are traced, across and down
    beside: tuple[float, ...] = (-0.6, -0.4, -0.2, 0.0, 0.2, 0.4, 0.6)
    """Fields of view off, of the sweep's frames that they are traced to."""


class BlameTuning(NamedTuple):
    """`blame`: the wrong file where two do not show the same."""

    sweep_frames: int = 90  # of a full turn, a tenth of a picture apart
    zoom_frames: int = 8
    many: int = 60
    """Matches of two pictures that one camera took of one place: in the halls here 400 and more; two cameras have
    20."""
    fewer: float = 0.2  # share of those, that pictures of two cameras have


class LateralTuning(NamedTuple):
    """`lateral_colour`."""

    every: int = 8  # one frame of the sweep in so many is looked at
    least_frames: int = 5
    window: int = 9  # pixels at half the resolution
    flat: float = 2.0  # variance of grey values below which a window is flat
    steep: float = 2.0  # grey levels a pixel from which on there is an edge
    sigmas: float = 4.0  # standard deviations from which on it is sure
    kept: float = 0.87  # share of a fringe that the softer chroma of video keeps: 0.8 to 0.97
    least_px: float = 0.15  # in the corners; less is left as it is. Seen where there is none: 0.07.


FEATURES = FeatureTuning()
REFERENCE = ReferenceTuning()
MARKERS = MarkerTuning()
BELIEF = BeliefTuning()
FOCAL = FocalTuning()
HALL = HallTuning()
ZOOM = ZoomTuning()
STITCHING = StitchingTuning()
BUNDLE = BundleTuning()
PHOTOMETRIC = PhotometricTuning()
PROPAGATION = PropagationTuning()
BLAME = BlameTuning()
LATERAL = LateralTuning()
