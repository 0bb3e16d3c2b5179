"""Videos as cameras, phones and editors write them: the right frames in the right order, or one line."""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest
from av.video.reformatter import ColorRange, Colorspace

from pzcap.io.capture import frame_sets, read_capture
from pzcap.io.timecode import frames_per_day, frames_to_timecode, timecode_to_frames
from pzcap.io.video import VideoReader
from pzcap.localisation.fields import BothFields
from pzcap.types import SEGMENTS, Image, PzcapError
from sim.capture_writer import write_video
from tests.scenes.recorders import MIRROR, TURNS, encode, flag, number, pictures, trim

RATE = Fraction(30)
NTSC = Fraction(30000, 1001)
B_FRAMES = {"x264-params": "bframes=3:b-pyramid=normal:b-adapt=0"}


def numbers(reader: VideoReader) -> list[tuple[int, int]]:
    return [(index, number(image)) for index, image in reader]


def capture(folder: Path, videos: dict[str, Path], rate: str = "30/1", **more: Any) -> Path:
    """A capture of these recordings of the motion."""
    cameras = [{"name": name, "motion": path.name} for name, path in videos.items()]
    manifest = {
        "format": "pzcap-capture", "version": 1, "name": "a take", "frame_rate": rate, "full_turn": True,
        "cameras": cameras, **more,
    }  # fmt: skip
    (folder / "capture.json").write_text(json.dumps(manifest))
    return folder


# --------------------------------------------------------------------------------------------------------------
# Order and number of frames


@pytest.mark.parametrize(
    "muxer", [{"use_editlist": "0"}, {"use_editlist": "1"}, {"movflags": "frag_keyframe+empty_moov"}]
)
def test_b_frames_begin_at_the_start_timecode(muxer: dict[str, str], tmp_path: Path) -> None:
    """Decoding makes the first picture late; a camera that writes no edit list does not mean that it is shown late."""
    path = encode(tmp_path / "motion.mp4", pictures(20), RATE, timecode="10:00:00:00", options=B_FRAMES, muxer=muxer)
    assert numbers(VideoReader(path)) == [(k, k) for k in range(20)]
    assert [number(image) for _, image in VideoReader(path).read(7, 12)] == [7, 8, 9, 10, 11]


def test_every_picture_before_an_intra_frame_is_found_by_itself(tmp_path: Path) -> None:
    """An intra frame is decoded before the B frames that are shown before it: a search by time must not land there."""
    options = {"preset": "veryfast", "x264-params": "bframes=3:b-adapt=0:keyint=12:scenecut=0"}
    reader = VideoReader(encode(tmp_path / "motion.mp4", pictures(30), RATE, options=options))
    for k in range(30):
        assert [(index, number(image)) for index, image in reader.read(k, k + 1)] == [(k, k)]


@pytest.mark.parametrize("ending", ["mp4", "mkv", "ts", "flv"])
@pytest.mark.parametrize("codec", ["open-gop=0", "open-gop=1:b-pyramid=normal"])
def test_every_picture_is_found_by_itself_in_any_container(codec: str, ending: str, tmp_path: Path) -> None:
    """Pictures before an intra frame may need some of the group before, and a stream has no index of intra frames."""
    options = {"x264-params": f"bframes=3:b-adapt=0:keyint=12:scenecut=0:{codec}"}
    reader = VideoReader(encode(tmp_path / f"motion.{ending}", pictures(30), RATE, options=options))
    assert numbers(reader) == [(k, k) for k in range(30)]
    for k in range(30):
        assert [(index, number(image)) for index, image in reader.read(k, k + 1)] == [(k, k)]


@pytest.mark.parametrize("codec", ["open-gop=0", "open-gop=1"])
def test_a_stream_cut_out_of_another_begins_at_its_first_intra_frame(codec: str, tmp_path: Path) -> None:
    options = {"x264-params": f"bframes=3:b-adapt=0:keyint=12:scenecut=0:{codec}"}
    path = encode(tmp_path / "motion.ts", pictures(30), RATE, options=options)
    data = path.read_bytes()
    path.write_bytes(data[188 * (len(data) // 188 // 4) :])
    reader = VideoReader(path)
    read = numbers(reader)
    assert [index for index, _ in read] == list(range(reader.frame_count))
    assert [image for _, image in read] == list(range(30 - reader.frame_count, 30))
    assert 6 <= reader.frame_count <= 18


@pytest.mark.parametrize("rate", [RATE, Fraction(5)])
def test_a_matroska_that_ends_before_it_says_so_is_cut(rate: Fraction, tmp_path: Path) -> None:
    path = encode(tmp_path / "motion.mkv", pictures(40), rate, options={"x264-params": "keyint=5"})
    assert VideoReader(path).frame_count == 40
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(PzcapError, match=r"motion\.mkv: the video is truncated or damaged; copy it again"):
        VideoReader(path)


def test_a_program_stream_is_read_in_order(tmp_path: Path) -> None:
    path = tmp_path / "motion.mpg"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg2video", rate=RATE, options={"qmin": "1", "qmax": "2", "bf": "2", "g": "12"})
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for image in pictures(30):
            yuv = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2YUV_I420), np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(yuv, format="yuv420p")))
        container.mux(stream.encode())
    reader = VideoReader(path)
    assert numbers(reader) == [(k, k) for k in range(30)]
    assert [number(image) for _, image in reader.read(17, 20)] == [17, 18, 19]


@pytest.mark.parametrize("group", [1, 5, 10])
@pytest.mark.parametrize("shown", [12, 20])
def test_a_recording_trimmed_at_its_end(group: int, shown: int, tmp_path: Path) -> None:
    options = {"x264-params": f"bframes=0:keyint={group}:scenecut=0"}
    path = trim(encode(tmp_path / "motion.mp4", pictures(30), RATE, options=options), Fraction(shown, 30))
    assert numbers(VideoReader(path)) == [(k, k) for k in range(shown)]


def test_a_recording_shown_in_pieces_gets_one_line(tmp_path: Path) -> None:
    """Timecode says when it begins, not when what was cut out would have been."""
    path = encode(tmp_path / "motion.mp4", pictures(30), RATE)
    data = path.read_bytes()
    at = data.find(b"elst")
    entry = data[at + 12 : at + 24]
    pieces = data[:at] + b"elst" + data[at + 4 : at + 8] + (2).to_bytes(4, "big") + entry + entry + data[at + 24 :]
    grown = bytearray(pieces)
    for name in (b"elst", b"edts", b"trak", b"moov"):
        size = grown.find(name) - 4
        grown[size : size + 4] = (int.from_bytes(grown[size : size + 4], "big") + 12).to_bytes(4, "big")
    path.write_bytes(grown)
    with pytest.raises(PzcapError, match=r"edit list shows it in pieces.* export what was recorded, as one"):
        VideoReader(path)


@pytest.mark.parametrize(("ending", "later_s"), [("ts", 72_000), ("avi", 0), ("flv", 0)])
def test_the_first_picture_is_time_0_where_stamps_count_from_anywhere(
    ending: str, later_s: int, tmp_path: Path
) -> None:
    path = encode(
        tmp_path / f"motion.{ending}", pictures(20), RATE, options={"x264-params": "bframes=0"},
        muxer={"output_ts_offset": str(later_s)},
    )  # fmt: skip
    reader = VideoReader(path)
    assert numbers(reader) == [(k, k) for k in range(20)]
    assert reader.times_s[0] == 0.0
    assert later_s <= reader.begins_s < later_s + 2.0


def test_b_frames_that_a_container_gives_no_times_get_one_line(tmp_path: Path) -> None:
    path = encode(tmp_path / "motion.avi", pictures(20), RATE, options=B_FRAMES)
    with pytest.raises(PzcapError, match=r"if it plays well, its container .* ffmpeg -i motion\.avi -crf 10 OUT\.mp4"):
        list(VideoReader(path))


def test_a_sweep_of_a_phone_may_vary_in_rate(tmp_path: Path) -> None:
    gaps = np.random.default_rng(2).uniform(1 / 8, 1 / 3, 29)
    times = [0.0, *np.cumsum(gaps).tolist()]
    path = encode(tmp_path / "sweep.mp4", pictures(30), RATE, times_s=times, timecode="10:00:00:00")
    reader = VideoReader(path)
    assert not reader.constant_rate
    assert numbers(reader) == [(k, k) for k in range(30)]
    assert [number(image) for _, image in reader.read(11, 14)] == [11, 12, 13]
    with pytest.raises(PzcapError, match=r"sweep\.mp4: its frame rate varies, and is 4\.\d* frames/s on average where"):
        read_capture(capture(tmp_path, {"1": path}))


# --------------------------------------------------------------------------------------------------------------
# Pictures


@pytest.mark.parametrize("degrees", [0, 90, 180, 270])
def test_pictures_are_turned_as_every_player_turns_them(degrees: int, tmp_path: Path) -> None:
    shown = pictures(6)
    stored = [np.ascontiguousarray(np.rot90(image, degrees // 90)) for image in shown]
    path = flag(encode(tmp_path / "motion.mp4", stored, RATE), TURNS[degrees])
    reader = VideoReader(path)
    assert (reader.width, reader.height) == (64, 48)
    assert reader.on_its_side == (degrees in (90, 270))
    for (_, image), wanted in zip(reader, shown, strict=True):
        assert image.shape == wanted.shape
        assert np.abs(image.astype(float) - wanted).max() < 6


def test_a_mirrored_recording_gets_one_line(tmp_path: Path) -> None:
    path = flag(encode(tmp_path / "motion.mp4", pictures(6), RATE), MIRROR)
    with pytest.raises(PzcapError, match=r"metadata mirror it.*ffmpeg -i motion\.mp4 -crf 10 OUT"):
        VideoReader(path)


def narrow(stream: Any) -> None:
    stream.codec_context.sample_aspect_ratio = Fraction(8, 9)


def test_pixels_that_are_not_square_get_one_line(tmp_path: Path) -> None:
    path = encode(tmp_path / "sweep.mp4", pictures(6), RATE, setup=narrow)
    with pytest.raises(PzcapError, match=r"pixels are 8:9, not square; .*ffmpeg -i sweep\.mp4 -vf scale=iw\*sar"):
        VideoReader(path)


@pytest.mark.parametrize("first", [0, 1])
def test_of_interlaced_pictures_the_first_field_is_read(first: int, tmp_path: Path) -> None:
    """Woven of a field at the frame's time and one of half a frame later, when all is elsewhere."""
    fields = [np.roll(pictures(1)[0], 3 * k, axis=1) for k in range(12)]
    woven = [np.array(fields[2 * k]) for k in range(6)]
    for k, picture in enumerate(woven):
        picture[1 - first :: 2] = fields[2 * k + 1][1 - first :: 2]
    order = "tff=1" if first == 0 else "bff=1"
    path = encode(tmp_path / "motion.mp4", woven, RATE, options={"x264-params": order, "crf": "2"})
    reader = VideoReader(path)
    assert reader.interlaced
    read = list(reader)
    assert [index for index, _ in read] == list(range(6))
    for k, (_, image) in enumerate(read):
        off = [np.abs(image.astype(float) - fields[2 * k + later]).mean() for later in (0, 1)]
        assert off[0] < 0.3 * off[1]
    for k, (index, image, second) in enumerate(reader.read_fields()):
        assert index == k
        np.testing.assert_array_equal(image, read[k][1])
        assert second is not None
        off = [np.abs(second.astype(float) - fields[2 * k + later]).mean() for later in (0, 1)]
        assert off[1] < 0.3 * off[0]
    (again,) = reader.read(4, 5)
    assert again[0] == 4
    assert np.abs(again[1].astype(float) - fields[8]).mean() < 0.3 * np.abs(again[1].astype(float) - fields[9]).mean()
    for (_, image, second), (_, between) in zip(reader.read_fields(), BothFields(reader), strict=True):
        assert second is not None
        np.testing.assert_allclose(between, (image.astype(float) + second) / 2, atol=0.5)


def coloured(path: Path, image: Image, codec: str, pix_fmt: str, hd: bool, full: bool) -> Path:
    with av.open(str(path), "w") as container:
        options = {"libx264": {"crf": "4"}, "mjpeg": {"qmin": "1", "qmax": "1"}}.get(codec, {})
        stream = container.add_stream(codec, rate=RATE, options=options)
        stream.pix_fmt, (stream.height, stream.width) = pix_fmt, image.shape[:2]
        context: Any = stream.codec_context
        context.color_range = 2 if full else 1
        if hd:
            context.colorspace = context.color_primaries = context.color_trc = 1
        for k in range(3):
            frame = av.VideoFrame.from_ndarray(image, format="bgr24").reformat(
                format=pix_fmt, dst_colorspace=Colorspace.ITU709 if hd else Colorspace.ITU601,
                src_color_range=ColorRange.JPEG, dst_color_range=ColorRange.JPEG if full else ColorRange.MPEG,
            )  # fmt: skip
            frame.pts, frame.time_base = k, 1 / RATE
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


@pytest.mark.parametrize(
    ("codec", "pix_fmt", "hd", "full", "ending"),
    [
        ("libx264", "yuv420p", False, False, "mp4"),
        ("libx264", "yuv420p", True, False, "mp4"),
        ("libx264", "yuv420p", False, True, "mp4"),
        ("libx264", "yuv420p", True, True, "mp4"),
        ("libx264", "yuv444p", True, False, "mp4"),
        ("prores_ks", "yuv422p10le", True, False, "mov"),
        ("mjpeg", "yuvj420p", False, True, "mov"),
    ],
)
def test_colours_are_those_that_were_filmed(
    codec: str, pix_fmt: str, hd: bool, full: bool, ending: str, tmp_path: Path
) -> None:
    """A sweep of one codec and a motion of another must agree, or all of the hall looks like the athlete."""
    colours = ((40, 40, 200), (40, 150, 40), (200, 60, 40), (128, 128, 128), (230, 230, 230), (30, 30, 30))
    image = np.zeros((48, 96, 3), np.uint8)
    for k, colour in enumerate(colours):
        image[:, 16 * k : 16 * (k + 1)] = colour
    _, read = next(iter(VideoReader(coloured(tmp_path / f"motion.{ending}", image, codec, pix_fmt, hd, full))))
    for k, colour in enumerate(colours):
        np.testing.assert_allclose(read[8:40, 16 * k + 5 : 16 * k + 11].mean(axis=(0, 1)), colour, atol=3.0)


# --------------------------------------------------------------------------------------------------------------
# Clocks


@pytest.mark.parametrize("rate", [NTSC, Fraction(60000, 1001)])
def test_drop_frame_timecode_keeps_to_the_clock(rate: Fraction) -> None:
    day = frames_per_day(rate, drop=True)
    assert abs(day / rate - 24 * 3600) < 0.1
    for frame in (*range(4000), *range(day // 2, day // 2 + 20_000), day - 1):
        timecode = frames_to_timecode(frame, rate, drop=True)
        assert timecode[8] == ";"
        assert timecode_to_frames(timecode, rate) == frame
    assert frames_to_timecode(day, rate, drop=True) == "00:00:00;00"


def test_drop_frame_leaves_out_two_numbers_a_minute_but_every_tenth() -> None:
    assert timecode_to_frames("00:01:00;02", NTSC) == timecode_to_frames("00:00:59;29", NTSC) + 1
    assert timecode_to_frames("00:10:00;00", NTSC) == timecode_to_frames("00:09:59;29", NTSC) + 1
    for timecode, rate in (("00:01:00;01", NTSC), ("10:20:30;00", RATE), ("10:20:30;00", Fraction(24000, 1001))):
        with pytest.raises(PzcapError, match="timecode"):
            timecode_to_frames(timecode, rate)


def test_drop_frame_recordings_across_a_minute(tmp_path: Path) -> None:
    """Camera 2 starts four frames later. Keyframes may be written with a colon, as people do."""
    videos = {}
    for name, start, first in (("1", "10:00:59;20", 0), ("2", "10:00:59;24", 4)):
        videos[name] = tmp_path / f"{name}.mp4"
        write_video(videos[name], pictures(30)[first:], NTSC, crf=4, timecode=start)
    sets = frame_sets(read_capture(capture(tmp_path, videos, "30000/1001")))
    assert sets.timecodes[0] == "10:00:59;24"
    assert sets.timecodes[5:8] == ("10:00:59;29", "10:01:00;02", "10:01:00;03")
    for frames in sets:
        assert [number(image) for image in frames.images if image is not None] == [4 + frames.index] * 2


@pytest.mark.parametrize("separator", [":", ";"])
def test_keyframes_in_drop_frame_recordings(separator: str, tmp_path: Path) -> None:
    video = tmp_path / "1.mp4"
    write_video(video, pictures(30), NTSC, crf=4, timecode="10:00:59;20")
    still = {"root_position_m": [0, 0, 1], "rotations_wxyz": {segment: [1, 0, 0, 0] for segment in SEGMENTS}}
    for timecode, frame in ((f"10:01:00{separator}02", 10), (f"10:01:00{separator}00", None)):
        (tmp_path / "keyframes.json").write_text(json.dumps([{"timecode": timecode, **still}]))
        read = read_capture(capture(tmp_path, {"1": video}, "30000/1001", keyframes="keyframes.json"))
        if frame is None:
            with pytest.raises(PzcapError, match='keyframe: timecode "10:01:00;00" does not exist'):
                frame_sets(read)
        else:
            assert [keyframe.frame for keyframe in frame_sets(read).keyframes] == [frame]


def test_clocks_of_both_kinds_get_one_line(tmp_path: Path) -> None:
    videos = {}
    for name, start in (("1", "10:00:59;20"), ("2", "10:00:59:20")):
        videos[name] = tmp_path / f"{name}.mp4"
        write_video(videos[name], pictures(9), NTSC, crf=4, timecode=start)
    with pytest.raises(PzcapError, match=r"some clocks count drop-frame .* and some do not: .* set all alike"):
        frame_sets(read_capture(capture(tmp_path, videos, "30000/1001")))


def test_a_hundred_and_twenty_frames_a_second(tmp_path: Path) -> None:
    fast = Fraction(120)
    write_video(tmp_path / "1.mp4", pictures(30), fast, crf=4, timecode="11:05:53:105")
    assert VideoReader(tmp_path / "1.mp4").timecode == "11:05:53:105"
    sets = frame_sets(read_capture(capture(tmp_path, {"1": tmp_path / "1.mp4"}, "120/1")))
    assert (sets.timecodes[0], sets.timecodes[14], sets.timecodes[15]) == (
        "11:05:53:105",
        "11:05:53:119",
        "11:05:54:00",
    )


@pytest.mark.parametrize(
    ("said", "expected"),
    [("30/1", "has 30000/1001 frames/s where capture.json says 30"), ("25/1", "where capture.json says 25")],
)
def test_a_rate_that_is_not_the_videos_gets_one_line(said: str, expected: str, tmp_path: Path) -> None:
    write_video(tmp_path / "1.mp4", pictures(9), NTSC, crf=4, timecode="10:00:00:00")
    with pytest.raises(PzcapError, match=expected):
        read_capture(capture(tmp_path, {"1": tmp_path / "1.mp4"}, said))


def test_matroska_whose_times_are_whole_milliseconds(tmp_path: Path) -> None:
    write_video(tmp_path / "1.mkv", pictures(40), NTSC, crf=4, timecode="10:00:00:00")
    assert numbers(VideoReader(tmp_path / "1.mkv")) == [(k, k) for k in range(40)]
