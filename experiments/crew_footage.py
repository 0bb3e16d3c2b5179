"""Footage as a crew brings it home, shot by the simulator: files under the names that a camera gives them, no timecode,
no capture.json. To try the command `pzcap` on, as with footage of one's own.

    python -m experiments.crew_footage hydra.run.dir=FOLDER                        # conf/experiment/no_timecode.yaml
    python -m experiments.crew_footage shoot.crew.sync=flash shoot.motion_frames=90 hydra.run.dir=FOLDER

FOLDER then holds camera1/ to camera4/ with GOPR0033.PNG, GX010034.MP4 and so on, and the crew's papers: object.json,
subject.json, keyframes.json.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import Final

import hydra
from hydra.core.config_store import ConfigStore
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from experiments import footage
from experiments.config import build, default_tree, plain
from experiments.errors import guard, reported
from experiments.progress import Bars
from experiments.run import CONF
from experiments.terminal import terminal
from pzcap.io.capture import FOOTAGE, read_capture
from pzcap.types import CameraFiles

_FIRST: Final = 33
_APART: Final = 20  # numbers of two cameras


def carry_home(capture: Path, folder: Path) -> None:
    """Copy the files of ``capture`` to ``folder`` under a crew's names."""
    found = read_capture(capture, without_clocks=True)
    for number, camera in enumerate(found.cameras):
        place = folder / f"camera{camera.name}"
        place.mkdir(parents=True, exist_ok=True)
        for name, path in crew_names(camera, _FIRST + _APART * number).items():
            shutil.copyfile(path, place / name)
    for paper in ("object.json", "subject.json", "keyframes.json"):
        if (capture / paper).is_file():
            shutil.copyfile(capture / paper, folder / paper)


def crew_names(camera: CameraFiles, first: int) -> dict[str, Path]:
    """Names that a camera gives to its files, in the order in which they were shot."""
    files = [getattr(camera, kind) for kind in FOOTAGE]
    names = {}
    for number, path in enumerate((path for path in files if path is not None), start=first):
        still = path.suffix.lower() in (".png", ".jpg")
        names[f"GOPR{number:04d}{path.suffix.upper()}" if still else f"GX01{number:04d}.MP4"] = path
    return names


def _run() -> None:
    ConfigStore.instance().store(name="base", node=default_tree())

    @hydra.main(version_base="1.3", config_path=str(CONF), config_name="config")
    def job(composed: DictConfig) -> None:
        out, err = terminal(), terminal(stderr=True)
        with reported():
            config = build(plain(composed))
            folder = Path(HydraConfig.get().runtime.output_dir)
            with Bars(err) as bars:
                shot = footage.shot(config.shoot, Path(config.output.captures), bars.update, config.output.light_gb)
            carry_home(shot / "capture", folder)
            out.print(str(folder), highlight=False, soft_wrap=True)

    if not any(argument.startswith("experiment=") for argument in sys.argv[1:]):
        sys.argv.append("experiment=no_timecode")
    job()


def main() -> int:
    """The command. Exit status 0, or 1 with a line on stderr."""
    return guard(_run)


if __name__ == "__main__":
    sys.exit(main())
