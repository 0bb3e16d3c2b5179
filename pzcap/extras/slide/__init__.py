"""The parallax assistant: how to slide the camera on its slide head until it pans about its projection centre.

Section 3.3: when projection centre and pan axis align, what is near stays before the same background however the head
is turned. Here a short pan over something near and something far, both at distances that a tape gives, says how far
the two still are apart. Features are tracked over the pan; each has a direction (azimuth, slope) from the axis and an
inverse distance. Pans, focal length, tilt, roll, principal point and distortion are estimated along with the offset.
"""

from pzcap.extras.slide.assistant import Slide, SlideConfig, advise, solve
from pzcap.extras.slide.tracks import Tracks

__all__ = ["Slide", "SlideConfig", "Tracks", "advise", "solve"]
