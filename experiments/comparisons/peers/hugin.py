"""Hugin's command line tools (cpfind, cpclean, autooptimiser), where they are installed."""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from experiments.comparisons.peers.material import Background, Estimate, Shot
from pzcap.types import PzcapError

TOOLS: Final = ("cpfind", "cpclean", "autooptimiser")
SECONDS: Final = 300.0  # one tool may take


def missing() -> str | None:
    """Reason why it cannot run, None where all of it is installed."""
    return None if all(shutil.which(tool) for tool in TOOLS) else "not installed"


class Hugin:
    """A project of the frame and the frames of the sweep around it, straightened.

    The sweep's frames stay where they are known to be, and so do tilt and roll; yaw and field of view of the frame are
    optimised, then twice the worst control points removed and the rest optimised again. Fewer unknowns and more trust
    in the sweep than by Hugin's own default, which does worse here: with all frames free the worst errors are larger.
    """

    def __init__(self, background: Background) -> None:
        self._background = background
        self._folder = tempfile.TemporaryDirectory(prefix="pzcap-hugin-")
        focal = background.camera.lens.reference_focal_px
        for number, view in enumerate(background.sweep):
            cv2.imwrite(str(self._path(number)), background.straightened(view.image, focal))

    def locate(self, shot: Shot, start: Estimate | None) -> Estimate | None:
        if start is None:
            return None
        around = self._background.around(start.pan_rad, start.focal_px)
        cv2.imwrite(str(self._path(-1)), self._background.straightened(shot.image, start.focal_px))
        focal = self._background.camera.lens.reference_focal_px
        lines = ['p f2 w3000 h1500 v360 n"TIFF_m"', "m i0"]
        lines.append(self._image(-1, start.pan_rad, start.focal_px))
        lines += [self._image(i, self._background.sweep[i].pan_rad, focal) for i in around]
        lines += ["v y0 v0", "v"]
        project = Path(self._folder.name) / "project.pto"
        project.write_text("\n".join(lines) + "\n", encoding="ascii")
        tools = [["cpfind", "--ncores=1", "--prealigned"], ["autooptimiser", "-n"]]
        tools += 2 * [["cpclean", "-w", "-s"], ["autooptimiser", "-n"]]
        for tool in tools:
            if not self._run(tool, project):
                return None
        return self._read(project)

    def _run(self, tool: list[str], project: Path) -> bool:
        try:
            done = subprocess.run([*tool, "-o", str(project), str(project)], capture_output=True, timeout=SECONDS)
        except subprocess.TimeoutExpired:
            return False
        except OSError as error:
            raise PzcapError(f"{tool[0]}: cannot be started ({error.strerror}); install Hugin again") from error
        return done.returncode == 0

    def _image(self, number: int, pan_rad: float, focal_px: float) -> str:
        """The line of an image: angles in degrees, yaw positive to the right; the field of view over its width."""
        camera = self._background.camera
        field = 2 * np.arctan(camera.lens.width / 2 / focal_px)
        yaw, pitch, roll, field = np.degrees([-pan_rad, camera.tilt_rad, camera.roll_rad, field])
        return (
            f"i w{camera.lens.width} h{camera.lens.height} f0 v{field:.12g} y{yaw:.12g} p{pitch:.12g} r{roll:.12g} "
            f'a0 b0 c0 d0 e0 g0 t0 n"{self._path(number)}"'
        )

    def _read(self, project: Path) -> Estimate | None:
        line = next((line for line in project.read_text(encoding="utf-8").splitlines() if line.startswith("i ")), "")
        found = {key: float(value) for key, value in re.findall(r" ([yv])(-?[\d.]+(?:e-?\d+)?)", line)}
        if not {"y", "v"} <= found.keys() or not 0.0 < found["v"] < 179.0:
            return None
        field = np.radians(found["v"])
        return Estimate(
            -float(np.radians(found["y"])), float(self._background.camera.lens.width / 2 / np.tan(field / 2))
        )

    def _path(self, number: int) -> Path:
        return Path(self._folder.name) / ("frame.png" if number < 0 else f"sweep{number}.png")
