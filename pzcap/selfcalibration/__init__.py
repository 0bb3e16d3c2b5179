"""Self-calibration from the footage alone: the three methods that the paper names as alternatives to its own.

The paper announces a comparison with them (section 7). Their outlines are kept: the abstracts and what later work says
of them were at hand, the full texts were not, so that details may differ. AKAZE matches stand in place of the features
of their day, and the camera model is that of `pzcap.types` (one coefficient of distortion, square pixels). What else
was simplified stands with each method.
"""

from pzcap.selfcalibration.complete import ZoomModel, wu_radke
from pzcap.selfcalibration.library import Library
from pzcap.selfcalibration.mosaic import shum_szeliski
from pzcap.selfcalibration.outwards import sinha_pollefeys
from pzcap.selfcalibration.rotations import Frames, Pair
from pzcap.selfcalibration.shots import Shots, link

__all__ = [
    "Frames",
    "Library",
    "Pair",
    "Shots",
    "ZoomModel",
    "link",
    "shum_szeliski",
    "sinha_pollefeys",
    "wu_radke",
]
