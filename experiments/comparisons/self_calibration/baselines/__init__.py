"""Self-calibration from the footage alone: the three methods that the paper names as alternatives to its own.

The paper announces a comparison with them (section 7). Their outlines are kept: the abstracts and what later work says
of them were at hand, the full texts were not, so that details may differ. AKAZE matches stand in place of the features
of their day, and the camera model is that of `pzcap.types` (one coefficient of distortion, square pixels). What else
was simplified stands with each method.
"""

from experiments.comparisons.self_calibration.baselines.library import Library
from experiments.comparisons.self_calibration.baselines.methods import (
    ZoomModel,
    shum_szeliski,
    sinha_pollefeys,
    wu_radke,
)
from experiments.comparisons.self_calibration.baselines.rotations import Frames, Pair
from experiments.comparisons.self_calibration.baselines.shots import Shots, link

__all__ = ["Frames", "Library", "Pair", "Shots", "ZoomModel", "link", "shum_szeliski", "sinha_pollefeys", "wu_radke"]
