"""Video and timecode."""

from __future__ import annotations

import threading
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pzcap.io.timecode import frames_per_day, frames_to_timecode, timecode_to_frames
from pzcap.io.video import VideoReader
from pzcap.types import Image, PzcapError
from sim.capture_writer import write_video

RATE = Fraction(30)
RATES = [Fraction(24), Fraction(25), RATE, Fraction(30000, 1001), Fraction(60)]


def images(count: int, width: int = 64, height: int = 48) -> list[Image]:
    """Smooth pictures, each of its own brightness, so that a frame can be told from its neighbours."""
    rng = np.random.default_rng(3)
    base = cv2.resize(rng.integers(60, 150, (6, 8, 3), dtype=np.uint8), (width, height), interpolation=cv2.INTER_CUBIC)
    return [np.asarray(cv2.convertScaleAbs(base, beta=4 * k), np.uint8) for k in range(count)]


@given(rate=st.sampled_from(RATES), data=st.data())
def test_timecode_and_frames_are_inverse(rate: Fraction, data: st.DataObject) -> None:
    frames = data.draw(st.integers(0, frames_per_day(rate) - 1))
    timecode = frames_to_timecode(frames, rate)
    assert timecode_to_frames(timecode, rate) == frames
    assert frames_to_timecode(frames + frames_per_day(rate), rate) == timecode


def test_timecode_reads_hours_minutes_seconds_frames() -> None:
    assert timecode_to_frames("01:02:03:04", RATE) == ((1 * 60 + 2) * 60 + 3) * 30 + 4


@pytest.mark.parametrize("timecode", ["01:02:03;04", "1:2:3:4", "24:00:00:00", "00:60:00:00", "00:00:00:30", ""])
def test_bad_timecode_is_refused(timecode: str) -> None:
    with pytest.raises(PzcapError, match="timecode"):
        timecode_to_frames(timecode, RATE)


@pytest.mark.parametrize("suffix", ["mp4", "mov", "mkv"])
@pytest.mark.parametrize("indices", [None, [0, 1, 2, 5, 6, 9], [2, 3, 4, 7]])
def test_frames_come_back_at_their_index(tmp_path: Path, suffix: str, indices: list[int] | None) -> None:
    expected = list(range(7)) if indices is None else indices
    path = tmp_path / f"video.{suffix}"
    sent = images(len(expected))
    write_video(path, sent, RATE, crf=12, timecode="01:02:03:04", indices=indices)
    reader = VideoReader(path)
    assert (reader.width, reader.height, reader.frame_rate, reader.timecode) == (64, 48, RATE, "01:02:03:04")
    assert reader.indices.tolist() == expected
    received = list(reader)
    assert [index for index, _ in received] == expected
    for (_, image), original in zip(received, sent, strict=True):
        error = image.astype(float) - original
        assert np.abs(error.mean(axis=(0, 1))).max() < 1.3  # no colour cast
        assert np.abs(error).max() < 25


def test_reading_from_the_middle_gives_the_same_frames(tmp_path: Path) -> None:
    path = tmp_path / "video.mp4"
    write_video(path, images(40), RATE, crf=20)
    whole = dict(VideoReader(path))
    part = dict(VideoReader(path).read(17, 23))
    assert list(part) == list(range(17, 23))
    assert all(np.array_equal(image, whole[index]) for index, image in part.items())


def test_a_video_without_timecode_says_so(tmp_path: Path) -> None:
    write_video(tmp_path / "video.mp4", images(2), RATE, crf=20)
    assert VideoReader(tmp_path / "video.mp4").timecode is None


def test_the_same_frames_give_the_same_bytes(tmp_path: Path) -> None:
    """In any thread, whatever its stack holds: x264 has been seen to depend on that."""
    rng = np.random.default_rng(0)
    noisy = [
        np.asarray(cv2.add(image, rng.integers(0, 9, image.shape, np.uint8)), np.uint8)
        for image in images(12, 320, 240)
    ]
    paths = [tmp_path / f"{k}.mp4" for k in range(4)]
    for path in paths:
        thread = threading.Thread(target=lambda p=path: write_video(p, noisy, RATE, crf=12, timecode="10:00:00:00"))
        thread.start()
        thread.join()
    assert len({path.read_bytes() for path in paths}) == 1


def test_what_an_edit_list_cuts_off_is_not_seen(tmp_path: Path) -> None:
    """As when a recording was trimmed without encoding it again."""
    write_video(tmp_path / "whole.mp4", images(30), RATE, crf=12)
    with av.open(str(tmp_path / "whole.mp4")) as whole, av.open(str(tmp_path / "cut.mp4"), "w") as cut:
        stream = whole.streams.video[0]
        copy = cut.add_stream_from_template(stream)
        for packet in whole.demux(stream):
            if packet.pts is not None and packet.dts is not None and packet.time_base is not None:
                ten = round(Fraction(10, 30) / packet.time_base)
                packet.pts, packet.dts, packet.stream = packet.pts - ten, packet.dts - ten, copy
                cut.mux(packet)
    reader = VideoReader(tmp_path / "cut.mp4")
    assert reader.indices.tolist() == list(range(20))
    brightness = [float(image.mean()) for _, image in reader]
    assert brightness[0] == pytest.approx(float(images(30)[10].mean()), abs=1)


def _missing(path: Path) -> None:
    path.unlink()


def _empty(path: Path) -> None:
    path.write_bytes(b"")


def _truncated(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-2000])


def _text(path: Path) -> None:
    path.write_text("not a video at all\n" * 100)


def _noise(path: Path) -> None:
    data = bytearray(path.read_bytes())
    third = len(data) // 3
    data[third : 2 * third] = np.random.default_rng(1).bytes(third)
    path.write_bytes(data)


def _sound(path: Path) -> None:
    with av.open(str(path), "w", format="mp4") as container:
        stream = container.add_stream("aac", rate=44100)
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), format="fltp", layout="mono")
        frame.sample_rate = 44100
        container.mux(stream.encode(frame))
        container.mux(stream.encode())


@pytest.mark.parametrize("damage", [_missing, _empty, _truncated, _text, _noise, _sound])
def test_a_bad_file_gets_one_line_that_names_it(tmp_path: Path, damage: Callable[[Path], None]) -> None:
    path = tmp_path / "video.mp4"
    rng = np.random.default_rng(0)
    busy = [np.asarray(cv2.add(image, rng.integers(0, 40, image.shape, np.uint8)), np.uint8) for image in images(30)]
    write_video(path, busy, RATE, crf=12)
    damage(path)
    with pytest.raises(PzcapError) as caught:
        list(VideoReader(path))
    assert "video.mp4" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_folder_that_does_not_exist_gets_one_line(tmp_path: Path) -> None:
    with pytest.raises(PzcapError, match=r"nowhere.*cannot write the video"):
        write_video(tmp_path / "nowhere" / "video.mp4", images(2), RATE, crf=20)


def test_a_full_disk_gets_one_line(tmp_path: Path) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full here")
    (tmp_path / "video.mp4").symlink_to("/dev/full")
    with pytest.raises(PzcapError, match="full"):
        write_video(tmp_path / "video.mp4", images(2), RATE, crf=20)
