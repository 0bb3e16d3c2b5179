"""Settings of calibration and localisation: what a camera is fitted with, once a hall and then in every frame."""

from __future__ import annotations

from dataclasses import dataclass, field

from pzcap.calibration.parameters import BeliefConfig
from pzcap.calibration.reference_camera import ReferenceConfig
from pzcap.calibration.sweep import SweepConfig
from pzcap.types import PzcapError

METHODS = ("exact", "paper")


@dataclass(frozen=True, slots=True)
class PanZoomConfig:
    method: str = "exact"
    """Or "paper": no distortion, no tilt, stops at eq. 15."""
    free_tilt: bool = False
    """The heads were tilted while the motion was recorded, too."""
    threshold: float = 1e-4
    """Of AKAZE's response."""
    frame_features: int = 400
    panorama_features: int = 12000
    ratio: float = 0.85
    """Of Lowe's test."""
    zoom_range: tuple[float, float] = (0.5, 5.0)
    """Searched where nothing is known, relative to the reference."""
    search_deg: float = 8.0
    """Beyond the frame's edges, where the frame before is known."""
    min_inliers: int = 12
    sure_agreement: float = 0.85
    """Of an alignment (see `align.Alignment`) alone, or features are asked."""
    same_agreement: float = 0.7
    """Of one that near and far starts led to alike."""
    min_agreement: float = 0.5
    """Of one that features led to."""
    max_pan_sigma_deg: float = 0.05
    """A frame whose matches tell less than this is not valid."""
    pixels: int = 4000
    """Of a frame that are aligned with the panorama: more take longer."""
    floor_px: float = 0.011
    """Systematic error of pan at the sweep's zoom: the least standard deviation claimed."""
    floor_edge_px: float = 0.025
    """The same of the focal length, by what it moves the left and right edges."""
    reference: ReferenceConfig = field(default_factory=ReferenceConfig)
    sweep: SweepConfig = field(default_factory=SweepConfig)
    beliefs: BeliefConfig = field(default_factory=BeliefConfig)

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise PzcapError(f"method {self.method!r} is not known; choose one of {', '.join(METHODS)}")
        if self.free_tilt and self.method == "paper":
            raise PzcapError("the paper's method knows no tilt; take method=exact, or free_tilt=false")
