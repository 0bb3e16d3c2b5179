"""Settings of calibration and localisation: what a camera is fitted with, once a hall and then in every frame."""

from __future__ import annotations

from dataclasses import dataclass, field

from pzcap.calibration.beliefs import BeliefConfig
from pzcap.calibration.reference_camera import ReferenceConfig
from pzcap.calibration.sweep import SweepConfig
from pzcap.types import PzcapError

METHODS = ("exact", "paper")


@dataclass(frozen=True, slots=True)
class PanZoomConfig:
    """Settings of one camera's calibration and localisation."""

    method: str = "exact"
    """Or "paper": no distortion, no tilt, stops at eq. 15."""
    free_tilt: bool = False
    """Estimate a tilt in every frame, for heads that were tilted while the motion was recorded; else it is constant."""
    threshold: float = 1e-4
    """Response of AKAZE from which on a feature counts, in frame and panorama; lower than in the sweep's own frames."""
    ratio: float = 0.85
    """Distance of the best match over that of the second best, at most (Lowe's test); wrong ones do not agree."""
    zoom_range: tuple[float, float] = (0.5, 5.0)
    """Focal lengths searched where nothing is known, relative to the reference: a zoom lens has no others."""
    sure_agreement: float = 0.85
    """Agreement (`Alignment`) of grey values that is enough alone; with less the frame is searched for."""
    same_agreement: float = 0.7
    """Agreement that is enough where fits from near and far come to one place: noise and a bare wall lower it."""
    pixels: int = 4000
    """Pixels of a frame that are compared with the panorama, about; more take longer."""
    floor_px: float = 0.008
    """Pixels at the reference zoom: systematic error of pan, the least standard deviation claimed."""
    floor_edge_px: float = 0.018
    """Pixels by which the same error of the focal length moves the left and right edges."""
    reference: ReferenceConfig = field(default_factory=ReferenceConfig)
    """Calibration of the reference image."""
    sweep: SweepConfig = field(default_factory=SweepConfig)
    """Matching and stitching of the sweep and the zoom run."""
    beliefs: BeliefConfig = field(default_factory=BeliefConfig)
    """Knowledge of a camera before its footage is seen."""

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise PzcapError(f"method {self.method!r} is not known; choose one of {', '.join(METHODS)}")
        if self.free_tilt and self.method == "paper":
            raise PzcapError("the paper's method knows no tilt; take method=exact, or free_tilt=false")
