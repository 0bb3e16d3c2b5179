"""OpenTrackIO 1.0.1 (SMPTE RIS-OSVP): a file of JSON lines a camera, one sample a frame in which it was located.

Metres, degrees and millimetres on a sensor taken to be 36 mm wide; z up, the camera at zero looking along +y, pan
positive to the left. No container is defined for files: a sample a line is a choice of ours.
"""

from __future__ import annotations

import json
import uuid
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any, Final

from pzcap.export.axes import pan_tilt_roll
from pzcap.export.take import SENSOR_WIDTH_MM, LocatedCamera, Take, write_text
from pzcap.types import Camera

_PROTOCOL: Final = {"name": "OpenTrackIO", "version": [1, 0, 1]}
_SPACE: Final = uuid.uuid5(uuid.NAMESPACE_URL, "https://opentrackio.org/pzcap")
_STATIC_EVERY_S: Final = 2


def write(take: Take, folder: Path) -> list[Path]:
    """Write all cameras; the files."""
    return [
        write_text(
            folder / f"{take.file}_{located.file}.jsonl",
            "".join(json.dumps(sample, separators=(",", ":")) + "\n" for sample in _samples(take, located)),
        )
        for located in take.cameras()
    ]


def _samples(take: Take, located: LocatedCamera) -> Iterator[dict[str, Any]]:
    whole = take.reconstruction
    source = f"{whole.capture_name}/{located.name}"
    every, due = max(1, round(_STATIC_EVERY_S * whole.frame_rate)), 0
    for frame, camera in located.frames():
        sample: dict[str, Any] = {
            "protocol": _PROTOCOL,
            "sampleId": _urn(f"{source}/{frame}"),
            "sourceId": _urn(source),
            "sourceNumber": located.number + 1,
            "tracker": {"status": "Optical Good", "recording": False, "slate": whole.capture_name[:1023] or "take"},
            "timing": {
                "mode": "external",
                "sampleRate": _fraction(whole.frame_rate),
                "sequenceNumber": frame,
                "timecode": _timecode(whole.timecodes[frame], whole.frame_rate),
            },
            "lens": _lens(located, camera),
            "transforms": [_transform(camera)],
        }
        pan, focal = located.sigma(frame)
        mm = SENSOR_WIDTH_MM / camera.width
        sample["custom"] = {"pzcap": {"panSigmaDegrees": pan, "pinholeFocalLengthSigma": focal * mm}}
        if frame >= due:
            sample["static"] = {"camera": _static(located, camera, whole.frame_rate)}
            due = frame + every
        yield sample


def _static(located: LocatedCamera, camera: Camera, rate: Fraction) -> dict[str, Any]:
    height_mm = SENSOR_WIDTH_MM * camera.height / camera.width
    return {
        "captureFrameRate": _fraction(rate),
        "activeSensorPhysicalDimensions": {"width": SENSOR_WIDTH_MM, "height": height_mm},
        "activeSensorResolution": {"width": camera.width, "height": camera.height},
        "label": located.name,
    }


def _lens(located: LocatedCamera, camera: Camera) -> dict[str, Any]:
    """OpenLensIO: a point at (x, y) mm of the undistorted picture, from its centre, y down, is seen at radial and
    tangential polynomials of (x, y); so coefficients of normalised coordinates are divided by powers of the focal
    length. Even radial terms are a denominator, which ours has not."""
    mm = SENSOR_WIDTH_MM / camera.width
    focal = mm * camera.focal_px
    x, y = mm * (camera.principal_px + 0.5 - (camera.width / 2.0, camera.height / 2.0))
    # six terms always: a reader is known that takes fewer for no distortion at all
    radial = [camera.k1 / focal**2, 0.0, camera.k2 / focal**4, 0.0, 0.0, 0.0]
    distortion: dict[str, Any] = {"model": "Brown-Conrady U-D", "radial": radial}
    if camera.p1 or camera.p2:
        distortion["tangential"] = [camera.p1 / focal, camera.p2 / focal]
    used = located.track.focal_px[located.track.valid]
    low, high = float(used.min()), float(used.max())
    return {
        "pinholeFocalLength": focal,
        "entrancePupilOffset": 0.0,  # the transform is that of the projection centre
        "encoders": {"zoom": (camera.focal_px - low) / (high - low) if high > low else 0.0},
        "distortion": [distortion],
        "projectionOffset": {"x": float(x), "y": float(y)},
        "distortionOffset": {"x": float(x), "y": float(y)},
    }


def _transform(camera: Camera) -> dict[str, Any]:
    x, y, z = camera.world_T_cam[:3, 3].tolist()
    angles = pan_tilt_roll(camera.world_T_cam[:3, :3])
    return {"translation": {"x": x, "y": y, "z": z}, "rotation": angles._asdict(), "id": "Camera"}


def _timecode(timecode: str, rate: Fraction) -> dict[str, Any]:
    hours, minutes, seconds, frames = (int(part) for part in timecode.replace(";", ":").split(":"))
    drop = {"dropFrame": True} if ";" in timecode else {}
    parts = {"hours": hours, "minutes": minutes, "seconds": seconds, "frames": frames}
    return {**parts, "frameRate": _fraction(rate), **drop}


def _fraction(rate: Fraction) -> dict[str, int]:
    return {"num": rate.numerator, "denom": rate.denominator}


def _urn(name: str) -> str:
    return uuid.uuid5(_SPACE, name).urn
