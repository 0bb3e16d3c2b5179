"""Footage of a run: shot now, kept from before, or brought by anyone."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from experiments.config import AppConfig
from pzcap.command.syncing import SYNC, synchronised
from pzcap.io.capture import read_capture
from pzcap.progress import Report, no_report
from sim import truth as truth_files
from sim.cameras.optics import OpticsConfig
from sim.capture_cache import LIGHT_GB, shoot_cached
from sim.hall.gym import GymConfig
from sim.session import ShootConfig
from sim.truth import Truth

SMALL: Final = ShootConfig(
    motion="pedestrian",
    motion_frames=8,
    width=320,
    height=240,
    sweep_deg=80.0,
    zoom_frames=8,
    optics=OpticsConfig(zoom_max=1.8),  # no more than the coarse textures can serve
    gym=GymConfig(texture_px_per_m=80.0),
)
"""Every effect on, as by default, but little of it: four cameras, 320 x 240, 40 sweep frames, 8 frames of motion."""


def capture_in(folder: Path) -> Path:
    """The capture that a user means: ``folder``, or the one inside it where it holds a truth, too."""
    inside = folder / "capture"
    return inside if inside.is_dir() and not (folder / "capture.json").exists() else folder


def reconstruction_in(results: Path) -> Path:
    """The reconstruction that a user means: ``results``, or the one in it where a run left them."""
    inside = results / "reconstruction"
    return inside if inside.is_dir() else results


def capture_of(config: AppConfig, report: Report) -> Path:
    """The capture that a run works on: the one it is told, else that of the shoot's config."""
    if config.capture is not None:
        return capture_in(Path(config.capture).resolve())
    capture = shot(config.shoot, Path(config.output.captures), report, config.output.light_gb) / "capture"
    if config.shoot.crew.sync != "timecode" and not (capture / SYNC).is_file():
        synchronised(read_capture(capture, without_clocks=True), told=report)  # as the crew does; where it cannot be
    return capture  # known, whoever reads the capture says so


def shot(config: ShootConfig, root: Path, report: Report = no_report, light_gb: float = LIGHT_GB) -> Path:
    """The folder of a shoot in ``root``, ``capture/`` and ``truth/`` in it: shot now, or kept from before."""
    shooting = shoot_cached(config, root, light_gb)
    while True:
        try:
            step = next(shooting)
        except StopIteration as end:
            return Path(end.value)
        report(step.stage, step.done, step.total)


def truth_beside(capture: Path) -> Truth | None:
    """The truth that lies beside a capture, if any."""
    folder = capture.resolve().parent / "truth"
    return truth_files.load(folder) if folder.is_dir() else None
