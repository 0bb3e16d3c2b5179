"""Constants of the segmentation that no user sets, a table a topic. Kernels have them compiled in."""

from __future__ import annotations

from typing import Final, NamedTuple


class BackgroundTuning(NamedTuple):
    """Likelihood of a pixel's colour."""

    largest_log_odds: float = 8.0
    """No pixel alone says more, for or against the body."""
    freedom: float = 4.0
    """Degrees of freedom of the t-distribution of differences from the hall: compression and edges err far at times."""
    peak: float = -2.6
    """Logarithm of its density at 0, of three colours of variance 1."""
    median: float = 2.78
    """Median of the squared difference over the variance of a colour, if that is right."""
    any_colour: float = 0.2
    """Share of colours that the body may have besides those seen."""
    shadow_window: int = 3
    """Half pixels over which a shadow is even."""


class GainTuning(NamedTuple):
    """Match of the background's brightness to the frame's."""

    scales: tuple[float, ...] = (0.15, 0.08, 0.05, 0.04)
    """Scales of the Geman-McClure weight of the logarithm of their ratio, from coarse to fine."""
    shrink: int = 8
    """Resolution at which it is fitted, less than the frame's by this factor."""
    darkest: float = 45.0
    """Sum of three colours below which a ratio says nothing."""
    brightest: float = 720.0
    """The same, above which it may be saturated."""
    least_cells: int = 50
    """Fewer are too little to fit."""


class BodyTuning(NamedTuple):
    """Shape of the body at half resolution."""

    unknown: int = 127
    """Probability (of 255) where nothing is known."""
    panorama_variance: float = 5 / 12
    """Square pixels of the panorama, of its blur: pixels of the sweep (1/12), interpolated twice (1/6 each)."""
    window: int = 3
    """Half pixels over which log-odds are averaged."""
    least_sample: int = 30
    """Half pixels that show which colours the body has; fewer do not."""
    margin_px: int = 16
    """Kept round the body for its boundary."""
    clothes_px: float = 4.0
    """By which clothes may stand off a body."""
    small_hole: int = 8
    """Half pixels: a smaller hole is none."""
    hole_log_odds: float = -2.5
    """Mean: nor is one where the hall is seen no better."""
    near: float = 0.1
    """Of the body's size: a part this far off needs twice the evidence to be kept."""
    least_part: float = 0.02
    """Of the body's evidence, that a part needs."""
    alone: float = 0.3
    """Weight of the soft evidence beside the sharp frame's colours, where nothing is expected."""
    with_expected: tuple[float, float] = (0.15, 0.3)
    """Where something is: weights of the evidence, and of what is expected."""


class BoundaryTuning(NamedTuple):
    """Boundary of the body on the sharp frame."""

    band: int = 5
    """Pixels: as wide is the band about the first guess's boundary that is undecided."""
    unsure: float = 1.5
    """Undecided is the inside, too, where the evidence is less than these log-odds."""
    doubt: float = 1.0
    """And where the sharp frame's colours speak for the body by less: a gap too narrow for the soft evidence."""
    nearby: int = 7
    """Half pixels: window of the colours nearby."""
    least_share: float = 0.01
    """Of that window, that is body: with less, nothing is known of its colours."""
    parts: tuple[float, ...] = (0.0, 0.25, 0.75, 1.0)
    """Of a pixel that may be body: more than half makes it so."""
    colour_variance: float = 50.0
    """Of luma and chroma, added to what is measured nearby."""
    least_likelihood: float = 1e-6
    """A colour that is neither's says nothing."""
    independence: float = 0.7
    """Share of the colours' log-odds that counts: neighbours err together."""
    largest_log_odds: float = 3.0
    """No colour says more."""
    edge_weight: tuple[float, float, float] = (2.5, 1.0, 1.0)
    """By which a step of luma and of chroma separates neighbours."""
    edge_variance: float = 1000.0
    """Ties fall as the exponential of minus the squares of these steps over this."""
    diagonal: float = 0.7
    """Tie between diagonal neighbours; that between direct ones of the same colour is 1, as is a pixel's own weight."""
    sweeps: int = 4
    """Of Gauss-Seidel."""
    overrelaxation: float = 1.1
    """Factor of its steps: converges sooner."""


BACKGROUND: Final = BackgroundTuning()
GAIN: Final = GainTuning()
BODY: Final = BodyTuning()
BOUNDARY: Final = BoundaryTuning()
