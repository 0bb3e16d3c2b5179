"""Headers that announce more than any machine holds: one line with the limit, before anything is decoded."""

from __future__ import annotations

import io
import json
import resource
import struct
import time
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from pzcap.io import limits, results
from pzcap.io.arrays import announced
from pzcap.io.capture import frame_sets, read_capture, read_image
from pzcap.io.picture_header import is_whole, picture_size
from pzcap.types import PzcapError
from sim import truth
from sim.capture_writer import write_video
from tests.scenes import fabricated
from tests.scenes.fabricated_truth import truth_of

EDGE = 0.5
SECONDS = 10.0


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(width: int, height: int) -> bytes:
    """A whole PNG of a few bytes a row, black."""
    row = b"\0" + b"\0" * (width * 3)
    packed = zlib.compressobj(9)
    data = b"".join(packed.compress(row) for _ in range(height)) + packed.flush()
    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def papers(folder: Path) -> Path:
    """A capture of one camera and its papers."""
    folder.mkdir()
    images = [np.full((48, 64, 3), 90 + k, np.uint8) for k in range(4)]
    write_video(folder / "motion.mp4", images, Fraction(30), crf=12, timecode="10:00:00:00")
    corners = [[0.0, 0.0, EDGE], [EDGE, 0.0, EDGE], [EDGE, 0.0, 0.0], [0.0, 0.0, 0.0]]
    (folder / "object.json").write_text(
        json.dumps({"dictionary": "DICT_4X4_50", "markers": [{"id": 7, "corners_m": corners}]})
    )
    manifest = {
        "format": "pzcap-capture", "version": 1, "name": "a take", "frame_rate": "30/1", "full_turn": True,
        "cameras": [{"name": "1", "motion": "motion.mp4"}], "object": "object.json",
    }  # fmt: skip
    (folder / "capture.json").write_text(json.dumps(manifest))
    return folder


@contextmanager
def in_little(mib: float) -> Iterator[None]:
    """What is done inside takes little time and memory."""
    before, begun = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()  # others may work here, too
    yield
    assert time.process_time() - begun < SECONDS
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 1024 * mib


def test_a_small_file_of_a_billion_pixels_is_not_decoded(tmp_path: Path) -> None:
    path = tmp_path / "reference.png"
    path.write_bytes(png(32_000, 32_000))
    with in_little(100), pytest.raises(PzcapError) as caught:
        read_image(path)
    assert str(caught.value) == f"{path}: 32000 x 32000 pixels, where 16384 a side, 67 million in all are the most"


def test_a_saved_panorama_of_a_billion_pixels_is_not_decoded(tmp_path: Path) -> None:
    results.save(fabricated.reconstruction(), tmp_path)
    (tmp_path / "panorama1.png").write_bytes(png(64, 48).replace(struct.pack(">II", 64, 48), b"\0\0\x80\0" * 2))
    with in_little(100), pytest.raises(PzcapError, match=r"panorama1\.png: 32768 x 32768 pixels, where 268 million"):
        results.load(tmp_path)


def test_a_part_of_two_gigabytes_is_not_waited_for(tmp_path: Path) -> None:
    whole = png(64, 48)
    assert is_whole(whole)
    at = whole.index(b"IDAT") - 4
    damaged = whole[:at] + b"\x7f\xff\xff\xff" + whole[at + 4 :]
    results.save(fabricated.reconstruction(), tmp_path)
    for name, read in (("panorama1.png", lambda _: results.load(tmp_path)), ("reference.png", read_image)):
        (tmp_path / name).write_bytes(damaged)
        with in_little(200), pytest.raises(PzcapError, match=name):
            read(tmp_path / name)


@pytest.mark.parametrize("ending", [".png", ".jpg"])
@pytest.mark.parametrize("size", [(64, 48), (3, 700)])
def test_a_size_is_read_from_the_header(ending: str, size: tuple[int, int]) -> None:
    data = cv2.imencode(ending, np.zeros((size[1], size[0], 3), np.uint8))[1].tobytes()
    assert picture_size(data) == size


@pytest.mark.parametrize(
    "data", [b"", b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"\xff\xd8" + b"\xff" * 99, b"GIF89a" * 9]
)
def test_what_has_no_header_has_no_size(data: bytes, tmp_path: Path) -> None:
    assert picture_size(data) is None
    (tmp_path / "reference.png").write_bytes(data)
    with pytest.raises(PzcapError, match="cannot be decoded"):
        read_image(tmp_path / "reference.png")


def test_the_rate_of_a_billion_digits_is_not_computed(tmp_path: Path) -> None:
    folder = papers(tmp_path / "capture")
    for text, said in (
        ("1e1000000000", "must be a fraction"),
        ("1/0", "must be a fraction"),
        ("0", "0 frames a second; 1 to 1000"),
        ("1" * 9, "1.11111e\\+08 frames a second; 1 to 1000 are plausible"),
    ):
        change(folder / "capture.json", lambda m, text=text: m.update(frame_rate=text))
        with in_little(50), pytest.raises(PzcapError, match=said):
            read_capture(folder)


def change(path: Path, edit: Callable[[Any], object]) -> None:
    value = json.loads(path.read_text())
    edit(value)
    path.write_text(json.dumps(value))


def test_a_frame_millions_of_frames_later_is_damage(tmp_path: Path) -> None:
    folder = papers(tmp_path / "capture")
    images = [np.full((48, 64, 3), 90 + k, np.uint8) for k in range(4)]
    write_video(
        folder / "motion.mp4", images, Fraction(30), crf=12, timecode="10:00:00:00", indices=[0, 1, 2, 3_000_000]
    )
    with in_little(50), pytest.raises(PzcapError, match="4 frames are shown as frames 0 to 3000000; its presen"):
        frame_sets(read_capture(folder))


def test_frames_that_were_dropped_are_no_damage(tmp_path: Path) -> None:
    folder = papers(tmp_path / "capture")
    images = [np.full((48, 64, 3), 90 + k, np.uint8) for k in range(4)]
    write_video(folder / "motion.mp4", images, Fraction(30), crf=12, timecode="10:00:00:00", indices=[0, 1, 2, 900])
    assert len(frame_sets(read_capture(folder))) == 901


PAPER_FAULTS: dict[str, tuple[str, Callable[[Any], object], str]] = {
    "a million markers": (
        "object.json", lambda o: o.update(markers=o["markers"] * 100_000), "100000 markers, where DICT_4X4_50 has 50"
    ),
    "a marker that the dictionary has not": ("object.json", lambda o: o["markers"][0].update(id=77), "0 to 49"),
    "millimetres": (
        "object.json",
        lambda o: o["markers"][0].update(corners_m=[[1000 * x for x in c] for c in o["markers"][0]["corners_m"]]),
        "500 m from the origin|side of 500 m; 0.01 to 5 are plausible: give metres",
    ),
    "centimetres": (
        "object.json",
        lambda o: o["markers"][0].update(corners_m=[[100 * x for x in c] for c in o["markers"][0]["corners_m"]]),
        "a side of 50 m; 0.01 to 5 are plausible: give metres",
    ),
    "corners crosswise": (
        "object.json",
        lambda o: o["markers"][0]["corners_m"].insert(1, o["markers"][0]["corners_m"].pop(2)),
        "sides of 0.500 to 0.707 m, and is square; give its corners in turn",
    ),
    "a number of 400 digits": (
        "object.json", lambda o: o["markers"][0].update(corners_m=[[10**400] * 3] * 4), "finite"
    ),
    "a thousand cameras": (
        "capture.json",
        lambda m: m.update(cameras=[{"name": str(k), "motion": "motion.mp4"} for k in range(1000)]),
        "1000 cameras, where 64 are the most",
    ),
}  # fmt: skip


@pytest.mark.parametrize("fault", PAPER_FAULTS)
def test_papers_beyond_a_limit_get_one_line(fault: str, tmp_path: Path) -> None:
    folder = papers(tmp_path / "capture")
    read_capture(folder)
    file, edit, said = PAPER_FAULTS[fault]
    change(folder / file, edit)
    with in_little(200), pytest.raises(PzcapError, match=said) as caught:
        read_capture(folder)
    assert str(folder / file) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_paper_of_many_megabytes_is_not_parsed(tmp_path: Path) -> None:
    folder = papers(tmp_path / "capture")
    with (folder / "object.json").open("r+b") as file:
        file.truncate(limits.PAPER_BYTES + 2**20)
    with in_little(50), pytest.raises(PzcapError, match=r"object\.json: 17 MiB, where 16 MiB are the most"):
        read_capture(folder)


def test_an_array_that_says_more_than_follows_is_not_read(tmp_path: Path) -> None:
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (10**6, 10**3)})
    with zipfile.ZipFile(tmp_path / "one.npz", "w") as archive:
        archive.writestr("values.npy", header.getvalue())
    with in_little(50), pytest.raises(ValueError, match="which is not what follows"):
        announced(tmp_path / "one.npz")


def test_an_array_whose_header_is_no_header(tmp_path: Path) -> None:
    """NumPy's own reader of headers ends in an error of Python's tokenizer there."""
    header = (
        b"\x93NUMPY\x01\x00\x76\x00"
        + b"{'descr': '<f8', 'fortran_order': False, 'shape': ((4, 12), }".ljust(117)
        + b"\n"
    )
    with zipfile.ZipFile(tmp_path / "one.npz", "w") as archive:
        archive.writestr("values.npy", header)
    with pytest.raises(ValueError, match="has a header that is none"):
        announced(tmp_path / "one.npz")


def test_a_reconstruction_of_zeros_that_packs_a_thousandfold_is_not_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(results, "_LEAST_BYTES", 2**20)
    results.save(fabricated.reconstruction(), tmp_path)
    with np.load(tmp_path / results.ARRAYS) as found:
        arrays = dict(found)
    np.savez_compressed(tmp_path / results.ARRAYS, allow_pickle=False, **arrays, more=np.zeros(2**23))
    with in_little(50), pytest.raises(PzcapError, match=r"it holds 0.0\d+ GiB, where 0.0\d+ GiB are the most"):
        results.load(tmp_path)


def test_a_truth_of_gigabytes_is_not_read(tmp_path: Path) -> None:
    """Zeros pack well: the shape of the sweep is nowhere else, so that it has a limit of its own."""
    truth.save(truth_of(fabricated.reconstruction()), tmp_path)
    with np.load(tmp_path / "truth.npz") as found:
        arrays = dict(found)
    cameras = len(arrays["roll_rad"])
    arrays["sweep_pan_rad"] = np.zeros((cameras, 10**6))
    arrays["sweep_world_T_cam"] = np.broadcast_to(np.zeros(1), (cameras, 10**6, 1, 1))
    np.savez_compressed(tmp_path / "truth.npz", **arrays)
    with in_little(50), pytest.raises(PzcapError, match=r"sweep_pan_rad has the shape \(\d, 1000000\), not"):
        truth.load(tmp_path)
