"""The page of a check: what was found, and pictures of each camera. One file, nothing is loaded from elsewhere."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from pzcap.command.check.findings import Finding, Level, worst
from pzcap.command.check.motion_check import Places
from pzcap.command.check.reference_check import Reference
from pzcap.command.check.sweep_check import Sweep
from pzcap.io.files import write_bytes
from pzcap.types import Image

_COLOURS: Final = {Level.OK: "#2e7d32", Level.WARN: "#b26a00", Level.FAIL: "#c62828"}
_STYLE: Final = """
body { font: 15px/1.45 system-ui, sans-serif; margin: 2em auto; max-width: 68em; padding: 0 1em; color: #222 }
table { border-collapse: collapse; width: 100%; margin: .6em 0 }
td { padding: .25em .6em; border-top: 1px solid #ddd; vertical-align: top }
td:first-child { font-weight: 600; white-space: nowrap }
img { max-width: 100%; margin: .3em 0; display: block }
figcaption { color: #666 }
figure { margin: .8em 0 }
@media (prefers-color-scheme: dark) { body { background: #181818; color: #ddd } td { border-color: #444 } }
"""


@dataclass(frozen=True, slots=True, eq=False)
class Pictures:
    """Pictures of one camera."""

    reference: Reference | None = None
    sweep: Sweep | None = None
    motion: Places | None = None


def write_page(path: Path, title: str, findings: Sequence[Finding], pictures: dict[str, Pictures]) -> None:
    """Write the page."""
    verdict = {
        Level.OK: "Nothing has to be shot again.",
        Level.WARN: "It can be worked with; look at what is marked.",
        Level.FAIL: "Shoot again what is marked red, while you can.",
    }[worst(findings)]
    parts = [
        f"<h1>{html.escape(title)}</h1><p><strong>{verdict}</strong></p>",
        _table(f for f in findings if not f.camera),
    ]
    for camera, shown in pictures.items():
        own = [finding for finding in findings if finding.camera == camera]
        parts.append(f"<h2>Camera {html.escape(camera)}</h2>{_table(own)}{_figures(shown)}")
    body = "\n".join(parts)
    text = (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{html.escape(title)}</title>'
        f"<style>{_STYLE}</style><body>{body}</body></html>\n"
    )
    write_bytes(path, text.encode(errors="replace"))  # names may hold what no text does


def _table(findings: Iterable[Finding]) -> str:
    rows = "".join(
        f'<tr><td style="color:{_COLOURS[finding.level]}">{finding.level.value}</td>'
        f"<td>{html.escape(finding.subject)}</td><td>{html.escape(finding.text)}</td></tr>"
        for finding in findings
    )
    return f"<table>{rows}</table>" if rows else ""


def _figures(shown: Pictures) -> str:
    parts = []
    if shown.reference is not None:
        parts.append(_figure(_marked(shown.reference), "Reference image: corners of the markers that were found"))
    if shown.sweep is not None:
        parts.append(_figure(_strip(shown.sweep), "Sweep, from left to right, a picture every seven degrees"))
    if shown.motion is not None:
        caption = "Pictures of the motion; framed red where they do not fit the sweep"
        parts.append(_figure(_row(shown.motion), caption))
    return "".join(parts)


def _figure(image: Image, caption: str) -> str:
    data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 80])[1].tobytes()
    source = f"data:image/jpeg;base64,{base64.b64encode(data).decode()}"
    said = html.escape(caption)
    return f'<figure><img src="{source}" alt="{said}"><figcaption>{said}</figcaption></figure>'


def _marked(reference: Reference) -> Image:
    image = reference.image.copy()
    if reference.camera is not None:
        for quad in reference.camera.points_px.reshape(-1, 4, 2):
            cv2.polylines(image, [np.round(quad).astype(np.int32)], True, (60, 220, 255), 2, cv2.LINE_AA)
    return _resized(image, 800)


def _strip(sweep: Sweep) -> Image:
    order = np.argsort(-sweep.key_angles_rad)
    rows = [[sweep.thumbnails[k] for k in order[start : start + 9]] for start in range(0, len(order), 9)]
    blank: Image = np.zeros_like(sweep.thumbnails[0])
    return np.vstack([np.hstack(row + [blank] * (9 - len(row))) for row in rows])


def _row(places: Places) -> Image:
    framed = []
    for image, relation in zip(places.images, places.relations, strict=True):
        small = _resized(image, 300)
        if not relation.found:
            small = small.copy()
            cv2.rectangle(small, (0, 0), (small.shape[1] - 1, small.shape[0] - 1), (40, 40, 200), 12)
        framed.append(small)
    framed += [np.zeros_like(framed[0])] * (-len(framed) % 4)
    return np.vstack([np.hstack(framed[start : start + 4]) for start in range(0, len(framed), 4)])


def _resized(image: Image, width: int) -> Image:
    if image.shape[1] <= width:
        return image
    size = (width, round(width * image.shape[0] / image.shape[1]))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
