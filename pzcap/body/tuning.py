"""Constants of the body that no user sets. Those fitted to captures say so."""

from __future__ import annotations

from typing import NamedTuple


class ShapeTuning(NamedTuple):
    """Correction of the body from the images."""

    stations: int = 6  # along a segment, evenly spaced: some five centimetres apart
    skin_sigma: float = 0.16  # of a segment's skin as a whole, from where the tape's girths put it, over its radius
    station_sigma: float = 0.26  # of the skin at one station, beside that
    centred_sigma_m: float = 0.005  # of a hinge from the middle of its limb
    loose: float = 0.3  # sigma of the skin beside that, a share of the room that loose clothes leave
    slide: float = 3.0  # sigma of a segment's texture along and across it, a multiple of what lengths are known to
    slide_arm_m: float = 0.2  # that sigma, divided by this, is the one about it
    # Factor of the texture's curvature as Gauss-Newton has it: robust weights, and texture as fine as the pixels, make
    # it flatter (0.25-0.5 measured). Taken at its word, each step would stop far short.
    texture_curvature: float = 0.4
    # Factors of the deviations that are left of the tape's, in lengths and in the skin: of lengths a little too little
    # is left, since frames err alike; of the skin too much, since people are more like each other than is assumed.
    # What cloth adds to the skin's is left as it is. These, and the next one, are fitted to what captures have covered.
    doubt_of_lengths: float = 1.35
    doubt_of_skin: float = 0.28
    # Deviation of a joint's distance from where it is, metres, for what no correction describes: rings about hinges are
    # no body. Fitted likewise.
    undescribed_m: float = 0.0018
    # Frames that tell something of their own, beyond the first, if no two postures are alike: those that are err alike.
    postures: float = 50.0


SHAPE = ShapeTuning()
