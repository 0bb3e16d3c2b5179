"""Advice for sliding the camera on its head, from a short pan past something near and something far (section 3.3).

    python -m experiments.slide CLIP --near 1.5 --far 10 [--near-box LEFT TOP RIGHT BOTTOM] [--focal PX]

CLIP is a video, or a folder of images named in order; the distances are metres from the tripod. Prints what to do and
leaves CLIP_slide.png beside it: features on the near object orange, behind it blue, and as arrows, ten times too long,
what each moved by from the first to the last frame that something in the direction of the background would not have.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from rich.console import Console

from experiments.errors import guard
from experiments.progress import Bars
from experiments.report.pictures import draw_dots, draw_strips
from experiments.terminal import command_line, terminal
from pzcap.extras.slide import Slide, SlideConfig, advise
from pzcap.io.capture import read_image
from pzcap.io.video import VideoReader
from pzcap.types import Image, PzcapError
from pzcap.viewer.drawing import Colour

NEAR: Final[Colour] = (235, 130, 20)
FAR: Final[Colour] = (60, 140, 235)
UNSURE: Final[Colour] = (150, 150, 150)
LONGER: Final = 10.0  # arrows
SUFFIXES: Final = (".png", ".jpg", ".jpeg")


def frames_of(clip: Path, most: int) -> Iterator[Image]:
    """About ``most`` frames of a video or of a folder of images, evenly spaced."""
    if clip.is_dir():
        paths = sorted(path for path in clip.iterdir() if path.suffix.lower() in SUFFIXES)
        for i in np.unique(np.round(np.linspace(0, len(paths) - 1, min(most, len(paths)))).astype(int)):
            yield read_image(paths[i])
        return
    count = sum(1 for _ in VideoReader(clip))
    chosen = set(np.round(np.linspace(0, count - 1, min(most, count))).astype(int).tolist())
    for number, (_, image) in enumerate(VideoReader(clip)):
        if number in chosen:
            yield image


def picture(image: Image, found: Slide) -> Image:
    """The middle frame of the pan (H, W, 3) with features, arrows and advice."""
    scale = max(1, round(1280 / image.shape[1]))
    large = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    drawn: Image = np.asarray(large * 0.6, np.uint8)
    at = np.flatnonzero(found.tracks.frame == len(found.pan_rad) // 2)
    tracks = found.tracks.track[at]
    points = (found.tracks.points_px[at] + 0.5) * scale - 0.5
    ends = points + LONGER * scale * np.clip(found.parallax_px[tracks], -20.0, 20.0)
    kinds = ((found.near, NEAR), (found.far, FAR), (~(found.near | found.far), UNSURE))
    for which, colour in kinds:
        chosen = which[tracks]
        draw_strips(drawn, np.stack([points, ends], axis=1)[chosen], colour, 2)
        draw_dots(drawn, points[chosen], colour, 3.0)
    sentence = found.sentence
    size = min(0.8, 0.8 * (drawn.shape[1] - 20) / cv2.getTextSize(sentence, cv2.FONT_HERSHEY_SIMPLEX, 0.8, 2)[0][0])
    at_left = (10, drawn.shape[0] - 14)
    for colour, width in (((0, 0, 0), 5), ((255, 255, 255), 2)):
        cv2.putText(drawn, sentence, at_left, cv2.FONT_HERSHEY_SIMPLEX, size, colour, width, cv2.LINE_AA)
    return drawn


def assist(
    clip: Path,
    near_m: float,
    far_m: float,
    near_box_px: tuple[float, float, float, float] | None,
    focal_px: float | None,
    console: Console,
) -> tuple[Slide, Path]:
    """The advice for ``clip``, and the picture that was written beside it."""
    if not clip.exists():
        raise PzcapError(f"{clip}: no such clip; give a video, or a folder of images")
    config = SlideConfig()
    images = []
    with Bars(console) as bars:
        for image in frames_of(clip, config.frames):
            images.append(image)
            bars.update("read the pan", len(images), 0)
    with console.status("following features"):
        found = advise(images, near_m, far_m, near_box_px=near_box_px, focal_px=focal_px, config=config)
    target = clip.with_name(f"{clip.stem}_slide.png")
    target.write_bytes(cv2.imencode(".png", picture(images[len(found.pan_rad) // 2], found))[1].tobytes())
    return found, target


def _command() -> None:
    parser = command_line("slide", __doc__)
    parser.add_argument("clip", type=Path, help="a video, or a folder of images")
    parser.add_argument("--near", type=float, required=True, metavar="M", help="distance of the near object")
    parser.add_argument("--far", type=float, required=True, metavar="M", help="distance of what is behind it")
    parser.add_argument(
        "--near-box", type=float, nargs=4, metavar=("LEFT", "TOP", "RIGHT", "BOTTOM"),
        help="where the near object stands in the middle frame, pixels; better too small than too large",
    )  # fmt: skip
    parser.add_argument("--focal", type=float, metavar="PX", help="focal length, if it is known")
    said = parser.parse_args()
    box = None if said.near_box is None else (said.near_box[0], said.near_box[1], said.near_box[2], said.near_box[3])
    found, target = assist(said.clip, said.near, said.far, box, said.focal, terminal(stderr=True))
    print(found.sentence)
    print(
        f"{int(found.near.sum())} features near, {int(found.far.sum())} far, "
        f"{np.degrees(np.ptp(found.pan_rad)):.0f} degrees of pan, {found.residual_px:.2f} px"
    )
    print(target)


def main() -> int:
    """The command. Exit status 0, or 1 with a line on stderr."""
    return guard(_command)


if __name__ == "__main__":
    sys.exit(main())
