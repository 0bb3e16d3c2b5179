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
    """Settings of the calibration and of the localisation."""

    method: str = "exact"
    """Either "exact", or "paper": no distortion, no tilt, stops at eq. 15."""
    free_tilt: bool = False
    """The heads were tilted while the motion was recorded, too, so that tilt is found in every frame."""
    threshold: float = 1e-4
    """Response of AKAZE from which on a feature counts: lower than in the sweep, for a frame may be blurred."""
    frame_features: int = 400
    """Features of a frame, at most, the strongest first: enough to tell the place, and fast."""
    panorama_features: int = 12000
    """Features of the panorama, at most, the strongest first: some hundred in each field of view."""
    ratio: float = 0.85
    """Lowe's ratio test: distance of the nearest descriptor to that of the second nearest, at most."""
    zoom_range: tuple[float, float] = (0.5, 5.0)
    """Focal lengths, relative to the reference, searched where nothing is known: those of usual zoom lenses."""
    search_deg: float = 8.0
    """Degrees beyond the frame's edges that are searched where the frame before is known: a fast pan between frames."""
    min_inliers: int = 12
    """Matches that agree on a place, at least; with fewer the grey values alone have to bear it out."""
    sure_agreement: float = 0.85
    """Agreement of an alignment (`photometric_alignment.Alignment`) that is relied on without features."""
    same_agreement: float = 0.7
    """Agreement that is relied on where alignments from near and from far have come to the same place."""
    min_agreement: float = 0.5
    """Agreement that is relied on where features have found the place."""
    max_pan_sigma_deg: float = 0.05
    """Degrees. A frame whose matches determine its pan less well than this is not valid."""
    pixels: int = 4000
    """Pixels of a frame that are aligned with the panorama, about: more take longer."""
    floor_px: float = 0.011
    """Pixels at the sweep's zoom: systematic error of pan, the least standard deviation claimed. Fitted to captures."""
    floor_edge_px: float = 0.025
    """Pixels by which it moves the left and right edges: the same of the focal length. Fitted to captures."""
    reference: ReferenceConfig = field(default_factory=ReferenceConfig)
    """Fit to the reference image."""
    sweep: SweepConfig = field(default_factory=SweepConfig)
    """Matching of sweep and zoom run."""
    beliefs: BeliefConfig = field(default_factory=BeliefConfig)
    """Prior standard deviations."""

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise PzcapError(f"method {self.method!r} is not known; choose one of {', '.join(METHODS)}")
        if self.free_tilt and self.method == "paper":
            raise PzcapError("the paper's method knows no tilt; take method=exact, or free_tilt=false")
