"""Cameras brought together by what they hear, in a hall with an echo, a fan beside one of them, and landings."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from scipy.signal import resample_poly

from pzcap.io.video import VideoReader
from pzcap.synchronisation import sound
from pzcap.synchronisation.sound import SAMPLES_PER_S, Sound
from pzcap.types import Array
from sim.capture_writer import write_video
from sim.hall import sound as hall
from tests.scenes.recorders import number, pictures

PLACES = np.array([[12.0, 9.0, 2.0], [-14.0, 9.0, 2.0], [-12.0, -9.0, 2.0], [11.0, -9.0, 2.0]])
BEGIN_S = np.array([-0.3, -0.8, 0.0, -0.5])
CLAPS_S = (0.15, 0.46, 0.89)


def heard(
    claps_s: tuple[float, ...], begin_s: Array = BEGIN_S, duration_s: float = 3.0, rates: Array | None = None,
    cameras: int = 4,
) -> list[Sound]:  # fmt: skip
    rng = np.random.default_rng(1)
    events = [(time, np.array([*rng.uniform(-0.5, 0.5, 2), 1.2]), hall.clap(rng)) for time in claps_s]
    events.append((1.6, np.array([3.0, -2.0, 0.0]), 0.2 * hall.clap(rng, softness=5.0)))
    fan = rng.normal(size=round((13.0 + duration_s) * hall.SAMPLES_PER_S))
    found = []
    for c, place in enumerate(PLACES[:cameras]):
        rate = 1.0 if rates is None else float(rates[c])
        own = np.random.default_rng(10 + c)
        fan_m = np.array([9.0, -6.0, 4.0])
        samples = hall.recorded(events, fan_m, fan, place, float(begin_s[c]), rate, duration_s, own)
        samples = resample_poly(samples.astype(float), SAMPLES_PER_S, hall.SAMPLES_PER_S)
        found.append(Sound(samples, float(np.linalg.norm(place - [0.0, 0.0, 1.0]))))
    return found


def test_claps_in_the_middle_tell_the_start_to_milliseconds() -> None:
    found = list(sound.delays(heard(CLAPS_S)))
    assert len(found) == 6
    for each in found:
        assert each.delay_s == pytest.approx(BEGIN_S[each.a] - BEGIN_S[each.b], abs=0.003)
        assert each.sigma_s < 0.01


def test_sound_of_a_file_is_on_the_clock_of_its_pictures(tmp_path: Path) -> None:
    """AAC begins with samples that nobody hears, and H.264 with pictures out of order."""
    samples = np.zeros(2 * hall.SAMPLES_PER_S, np.float32)
    samples[hall.SAMPLES_PER_S // 2 :][:200] = 0.5
    write_video(tmp_path / "a.mp4", pictures(60), Fraction(30), crf=20, sound=samples)
    for path in (tmp_path / "a.mp4", streamed(tmp_path / "a.mp4", 0), streamed(tmp_path / "a.mp4", 80_000)):
        reader = VideoReader(path)
        assert reader.indices[0] == 0
        assert [number(image) for _, image in reader.read(0, 3)] == [0, 1, 2]
        found = sound.sound_of(reader.path, None, reader.begins_s)
        assert found is not None
        assert np.flatnonzero(np.abs(found.samples) > 0.2)[0] / SAMPLES_PER_S == pytest.approx(0.5, abs=0.002)
    write_video(tmp_path / "b.mp4", pictures(6), Fraction(30), crf=20)
    assert sound.sound_of(tmp_path / "b.mp4", None) is None


def streamed(path: Path, begins_s: int) -> Path:
    """A video as a transport stream, whose clock says ``begins_s`` or a little more as it begins."""
    out = path.with_name(f"{path.stem}{begins_s}.mts")
    with av.open(str(path)) as source, av.open(str(out), "w", "mpegts", {"output_ts_offset": str(begins_s)}) as copy:
        streams = {
            each.index: copy.add_stream_from_template(each) for each in (*source.streams.video, *source.streams.audio)
        }
        for packet in source.demux(*source.streams.video, *source.streams.audio):
            if packet.dts is not None:
                packet.stream = streams[packet.stream.index]
                copy.mux(packet)
    return out


def test_a_hall_in_which_nothing_bangs_leaves_doubt() -> None:
    """What hums is heard by all at once, and from where it stands, not from the middle."""
    rng = np.random.default_rng(0)
    hiss = [Sound(rng.normal(size=3 * SAMPLES_PER_S), 15.0) for _ in range(3)]
    assert list(sound.delays(hiss)) == []


def test_claps_at_even_intervals_leave_doubt() -> None:
    """Each fits the one after it nearly as well."""
    even = tuple(np.arange(0.0, 2.4, 0.3).tolist())
    begin_s = np.array([-0.3, 0.9, 0.0, -0.6])
    for each in sound.delays(heard(even, begin_s)):
        assert each.delay_s == pytest.approx(begin_s[each.a] - begin_s[each.b], abs=0.005)


@pytest.mark.heavy
def test_a_clock_that_drifts_is_told_by_a_long_take() -> None:
    rates = np.array([1.0, 1.0 + 8e-5])
    claps = tuple(np.sort(np.random.default_rng(2).uniform(1.0, 119.0, 40)).tolist())
    sounds = heard(claps, duration_s=120.0, rates=rates, cameras=2)
    [delay] = sound.delays(sounds)
    np.testing.assert_allclose(sound.rates(sounds, np.array([0.0, -delay.delay_s])), rates, atol=2e-5)
