"""The pipeline on a small capture: that it reads the capture alone, and does without what was not brought home."""

from __future__ import annotations

import dataclasses
import shutil
import subprocess
import sys
import time
import weakref
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from experiments.comparisons.wrong_footage import recorded_again
from pzcap.calibration.settings import PanZoomConfig
from pzcap.camera_notes import ON_ITS_SIDE
from pzcap.camera_set import calibrate_cameras, taken_over
from pzcap.events import BodyTracked, Finished, FrameLocalised, FrameSegmented, Progress
from pzcap.extras import reconstruct as extras
from pzcap.imaging import comb
from pzcap.io import results
from pzcap.io.capture import frame_sets, read_capture
from pzcap.localisation.covariance import systematic
from pzcap.pipeline import Config, reconstruct, stages
from pzcap.types import Capture, Image, Pose, PzcapError, Reconstruction
from tests.scenes.recorders import TURNS, encode, flag

RECONSTRUCT = """
import sys
from pathlib import Path
from pzcap.io import results
from pzcap.io.capture import read_capture
from pzcap.pipeline import Config, reconstruct
results.save(reconstruct(read_capture(Path(sys.argv[1])), Config()), Path(sys.argv[2]))
foreign = {"mujoco", "sim", "experiments", "hydra", "rerun"} & set(sys.modules)
sys.exit(f"the library imported {foreign}" if foreign else 0)
"""


@pytest.fixture(scope="module")
def capture(small_capture: Path) -> Capture:
    return read_capture(small_capture / "capture")


@pytest.fixture
def reconstruction(small_run: Reconstruction) -> Reconstruction:
    return small_run


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


@pytest.mark.xdist_group("pipeline")
def test_reads_the_capture_alone(small_capture: Path, reconstruction: Reconstruction, tmp_path: Path) -> None:
    """A process that has nothing but a lone copy of the folder gets the same result, to the byte."""
    shutil.copytree(small_capture / "capture", tmp_path / "lone")
    subprocess.run(
        [sys.executable, "-c", RECONSTRUCT, str(tmp_path / "lone"), str(tmp_path / "there")],
        check=True, cwd=tmp_path, timeout=300,
    )  # fmt: skip
    results.save(reconstruction, tmp_path / "here")
    here, there = files(tmp_path / "here"), files(tmp_path / "there")
    assert here
    assert here == there


@pytest.mark.xdist_group("pipeline")
def test_everything_is_found(capture: Capture, reconstruction: Reconstruction) -> None:
    assert reconstruction.notes == ()
    (only,) = extras.completed(reconstruction, capture, extras.Config()).notes
    assert only.startswith("the next keyframe would help most at frame ")
    assert all(track is not None and track.valid.all() for track in reconstruction.tracks)
    assert reconstruction.motion is not None
    assert reconstruction.motion.valid.all()
    assert len(reconstruction.motion.joints_m) == len(reconstruction.timecodes)


@pytest.mark.xdist_group("pipeline")
def test_the_body_has_its_say_about_the_cameras(reconstruction: Reconstruction) -> None:
    """Not about the first keyframe, which is not solved with others; and little, where the background tells so much."""
    for head, track, refined in zip(reconstruction.cameras, reconstruction.tracks, reconstruction.refined, strict=True):
        assert head is not None
        assert track is not None
        assert refined is not None
        shared = systematic(Config().panzoom, head, track.pan_rad, track.focal_px)
        assert np.all(refined.covariance[:, 0, 0] > shared[:, 0, 0])  # the body cannot tell it of one frame
        off, sigma = refined.pan_rad - track.pan_rad, np.sqrt(track.covariance[:, 0, 0])
        assert off[0] == 0.0
        assert np.all(off[1:] != 0.0)
        assert np.all(np.abs(off) < sigma)
        # a frame alone is never believed to better than 1e-7 rad
        assert np.all(refined.covariance[1:, 0, 0] < track.covariance[1:, 0, 0] + 2e-14)
        # the body has more to say of a frame that a codec has repeated in part
        assert np.all(refined.covariance[1:, 0, 0] > 0.4 * track.covariance[1:, 0, 0])


@pytest.mark.xdist_group("pipeline")
def test_events_come_in_order_and_end_with_the_result(capture: Capture, reconstruction: Reconstruction) -> None:
    localised, separated, tracked, ended = [], [], [], 0
    pictures: list[weakref.ref[Image]] = []
    two = dataclasses.replace(capture, cameras=capture.cameras[:2])
    for event in stages(two, Config(), cameras=reconstruction):
        assert not ended
        match event:
            case FrameLocalised(frames, _):
                localised.append(frames.index)
            case FrameSegmented(frames, _, silhouettes):
                separated.append(frames.index)
                pictures += [weakref.ref(each.background) for each in silhouettes if each is not None]
            case BodyTracked(poses):
                assert all(pose.frame <= separated[-1] for pose in poses)
                tracked += [pose.frame for pose in poses]
            case Finished():
                ended += 1
            case _:
                pass
        # whatever comes of a frame, its pictures are let go: memory does not grow with the video
        assert sum(picture() is not None for picture in pictures) <= len(two.cameras)
    assert localised == separated == tracked == list(range(len(localised)))
    assert ended


def test_cameras_that_nobody_waits_for_are_given_up(capture: Capture) -> None:
    """An interrupted command ends, and not once its cameras are calibrated."""

    def calibrate(_footage: object, report: Callable[[str, int, int], None]) -> Any:
        for number in range(600):
            report("turn", number, 600)
            time.sleep(0.1)

    begun = time.monotonic()
    with ThreadPoolExecutor(2) as pool:
        events = calibrate_cameras(capture, calibrate, pool, [])
        assert isinstance(next(events), Progress)
        events.close()  # type: ignore[attr-defined]
    assert time.monotonic() - begun < 20.0  # of a minute


@pytest.mark.xdist_group("pipeline")
@pytest.mark.parametrize(
    ("missing", "told"),
    [
        ({"subject": None}, "26 of 26 measurements are missing"),
        ({"keyframe_poses": {}}, "keyframes"),
        ({"calibration_object": None}, "calibration object"),
    ],
)
def test_what_is_missing_is_told_and_costs_only_its_own_stages(
    capture: Capture, missing: dict[str, object], told: str
) -> None:
    alone = dataclasses.replace(capture, cameras=capture.cameras[:1], **missing)  # fewer are ready sooner
    result = reconstruct(alone, Config())
    assert any(told in note for note in result.notes)
    assert (result.tracks[0] is None) == ("calibration_object" in missing)
    assert (result.motion is None) == ("keyframe_poses" in missing)  # a body that nobody measured is guessed


@pytest.mark.xdist_group("pipeline")
def test_a_camera_without_a_sweep_is_left_out(capture: Capture) -> None:
    first, second, *_ = capture.cameras
    two = dataclasses.replace(capture, cameras=(dataclasses.replace(first, sweep=None), second))
    result = reconstruct(two, Config())
    assert result.tracks[0] is None
    assert result.tracks[1] is not None
    assert result.motion is not None
    assert any("camera 1" in note and "sweep" in note for note in result.notes)


@pytest.mark.xdist_group("pipeline")
def test_another_take_by_the_same_cameras_needs_their_recordings_alone(
    capture: Capture, reconstruction: Reconstruction, tmp_path: Path
) -> None:
    results.save(reconstruction, tmp_path)
    result = reconstruct(bare(capture), Config(), cameras=results.load(tmp_path))
    taken, *others = result.notes
    assert taken == f"calibrated at the take before, '{capture.name}': camera 1, 2, 3, 4"
    assert not any("camera" in note for note in others)
    for track, before in zip(result.tracks, reconstruction.tracks, strict=True):
        assert track is not None
        assert before is not None
        # read-outs are known from the first frame on, as the take before has shown them
        np.testing.assert_allclose(track.pan_rad, before.pan_rad, atol=1e-5)
    assert result.motion is not None
    assert reconstruction.motion is not None
    apart_m = np.linalg.norm(result.motion.joints_m - reconstruction.motion.joints_m, axis=2)
    assert apart_m.mean() < 1e-3


@pytest.mark.xdist_group("pipeline")
def test_a_camera_that_the_other_take_does_not_know_is_calibrated(
    capture: Capture, reconstruction: Reconstruction
) -> None:
    first, second, *_ = capture.cameras
    unknown = dataclasses.replace(first, name="new", sweep=None)
    result = reconstruct(dataclasses.replace(capture, cameras=(unknown, second)), Config(), cameras=reconstruction)
    assert any("camera new" in note and "sweep" in note for note in result.notes)
    known, again = reconstruction.cameras[1], result.cameras[1]
    assert known is not None
    assert again is not None
    assert again.lens is known.lens  # what the motion tells of its clock is its own
    np.testing.assert_array_equal(again.world_T_head, known.world_T_head)


@pytest.mark.xdist_group("pipeline")
def test_a_camera_that_was_moved_since_the_other_take_is_named(
    capture: Capture, reconstruction: Reconstruction
) -> None:
    first, *others = reconstruction.cameras
    assert first is not None
    tilted = dataclasses.replace(first, tilt_rad=first.tilt_rad + 0.05)
    before = dataclasses.replace(reconstruction, cameras=(tilted, *others))
    result = reconstruct(dataclasses.replace(bare(capture), keyframe_poses={}), Config(), cameras=before)
    (moved,) = (note for note in result.notes if "moved" in note)
    assert moved.startswith("camera 1: no frame agrees")
    assert result.tracks[0] is not None
    assert not result.tracks[0].valid.any()


@pytest.mark.heavy
@pytest.mark.xdist_group("pipeline")
def test_motions_that_were_exchanged_or_mirrored_are_named(
    capture: Capture, reconstruction: Reconstruction, tmp_path: Path
) -> None:
    """Their tripods are not blamed for it."""
    one, other, *_ = bare(capture).cameras
    exchanged = (dataclasses.replace(one, motion=other.motion), dataclasses.replace(other, motion=one.motion))
    two = dataclasses.replace(bare(capture), subject=None, cameras=exchanged)
    notes = reconstruct(two, Config(), cameras=reconstruction).notes
    assert [note for note in notes if "motion" in note] == [
        f"camera {a}: its motion fits the sweep of camera {b}, and not its own: the files of two cameras were exchanged"
        for a, b in ((1, 2), (2, 1))
    ]
    mirrored = recorded_again(dataclasses.replace(two, cameras=(one, other)), tmp_path, mirrored=True)
    notes = reconstruct(mirrored, Config(), cameras=reconstruction).notes
    assert "camera 1: its motion is mirrored against its sweep" in notes


@pytest.mark.xdist_group("pipeline")
def test_cameras_of_another_setup_are_refused(capture: Capture, reconstruction: Reconstruction) -> None:
    strangers = dataclasses.replace(reconstruction, camera_names=("a", "b", "c", "d"))
    with pytest.raises(PzcapError, match="another setup"):
        taken_over(capture, strangers, "exact", [])
    with pytest.raises(PzcapError, match="method=exact, not paper"):
        taken_over(capture, reconstruction, "paper", [])
    camera = reconstruction.cameras[0]
    assert camera is not None
    finer = dataclasses.replace(camera, lens=dataclasses.replace(camera.lens, width=1920))
    other = dataclasses.replace(reconstruction, cameras=(finer, *reconstruction.cameras[1:]))
    with pytest.raises(PzcapError, match="320x240 pixels, where camera 1 had 1920x240"):
        taken_over(capture, other, "exact", [])


def bare(capture: Capture) -> Capture:
    """What is filmed of a second take: the motion."""
    cameras = tuple(dataclasses.replace(files, reference=None, sweep=None, zoom=None) for files in capture.cameras)
    return dataclasses.replace(capture, cameras=cameras, calibration_object=None)


@pytest.mark.xdist_group("pipeline")
def test_the_paper_method_runs_on_the_same_footage(capture: Capture) -> None:
    config = extras.Config(panzoom=PanZoomConfig(method="paper"))
    result = extras.reconstruct(dataclasses.replace(capture, cameras=capture.cameras[:2]), config)
    assert result.method == "paper"
    assert all(track is not None and track.valid.any() for track in result.tracks)


def test_a_method_that_the_core_has_not_is_said_in_one_line(capture: Capture) -> None:
    with pytest.raises(PzcapError, match=r"method 'paper' .* pzcap.extras"):
        reconstruct(capture, Config(panzoom=PanZoomConfig(method="paper")))


def woven(capture: Capture, found: Reconstruction, folder: Path, *, told: bool = True) -> Capture:
    """The capture's motion as cameras record it that weave two fields into a frame, at half the frame rate, which the
    files tell or not; posed by hand where it was ``found`` in its first and its last frame."""
    assert found.motion is not None
    rate, instants = capture.frame_rate / 2, [frames.images for frames in frame_sets(capture)]
    pairs, cameras = list(zip(instants[::2], instants[1::2], strict=False)), []
    for camera, files in enumerate(capture.cameras):
        frames, times_s = [], []
        for number, (first, second) in enumerate(pairs):
            even, odd = first[camera], second[camera]
            if even is not None and odd is not None:
                frames.append(even.copy())
                frames[-1][1::2] = odd[1::2]
                times_s.append(float(number / rate))
        path = encode(
            folder / f"{files.name}.mp4", frames, rate, timecode="01:00:00:00", times_s=times_s,
            options={"crf": "2"} | ({"x264-params": "tff=1"} if told else {}),
        )  # fmt: skip
        cameras.append(dataclasses.replace(files, motion=path))
    poses = {
        f"01:00:00:{number:02d}": Pose(found.motion.root_position_m[2 * number], found.motion.rotations[2 * number])
        for number in (0, len(pairs) - 1)
    }
    return dataclasses.replace(capture, cameras=tuple(cameras), frame_rate=rate, keyframe_poses=poses)


@pytest.mark.xdist_group("pipeline")
def test_both_fields_of_interlaced_video_are_tracked(
    capture: Capture, reconstruction: Reconstruction, tmp_path: Path
) -> None:
    """They are as near to each other in time as the frames that they are made of; told are frames alone."""
    events = list(stages(woven(capture, reconstruction, tmp_path), Config(), cameras=reconstruction))
    last = events[-1]
    assert isinstance(last, Finished)
    found, whole = last.reconstruction.motion, reconstruction.motion
    assert found is not None
    assert whole is not None
    frames = len(found.joints_m)
    assert frames == len(reconstruction.timecodes) // 2
    assert sum(isinstance(event, BodyTracked) for event in events) == 2 * frames + 1  # and the end
    off = np.linalg.norm(found.joints_m - whole.joints_m[: 2 * frames : 2], axis=2)
    assert off.mean() < 0.005
    assert not any("interlaced" in note for note in last.reconstruction.notes)


@pytest.mark.xdist_group("pipeline")
def test_interlaced_video_that_is_not_said_to_be_is_named(
    capture: Capture, reconstruction: Reconstruction, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # the motion is four frames long, which are sure of nothing, and the cameras hardly turn
    monkeypatch.setattr(comb, "COMB", comb.COMB._replace(least=3, panned_px=0.1, sigmas=3.0))
    silent = dataclasses.replace(woven(capture, reconstruction, tmp_path, told=False), subject=None)
    named = [note for note in reconstruct(silent, Config(), cameras=reconstruction).notes if "interlaced" in note]
    assert named
    assert all("-x264-params tff=1" in note for note in named)


def turning(capture: Capture, folder: Path, repeated: Sequence[int]) -> Capture:
    """The capture's motion, of which the first camera, a phone held upright, turns on by 5 pixels a frame, and its
    pictures of the frames ``repeated`` are the ones before once more."""
    pictures: list[Image] = []
    for frames in frame_sets(capture):
        picture = frames.images[0]
        assert picture is not None
        turned = cv2.warpAffine(
            picture, np.array([[1.0, 0.0, -5.0 * frames.index], [0.0, 1.0, 0.0]]), picture.shape[1::-1],
            borderMode=cv2.BORDER_REPLICATE,
        )  # fmt: skip
        stored = np.ascontiguousarray(np.rot90(turned))
        pictures.append(pictures[-1] if frames.index in repeated else np.asarray(stored, np.uint8))
    times_s = [float(number / capture.frame_rate) for number in range(len(pictures))]
    timecode = frame_sets(capture).timecodes[0]
    path = encode(folder / f"{len(repeated)}.mp4", pictures, capture.frame_rate, timecode=timecode, times_s=times_s)
    one, *others = capture.cameras
    return dataclasses.replace(capture, cameras=(dataclasses.replace(one, motion=flag(path, TURNS[90])), *others))


@pytest.mark.xdist_group("pipeline")
def test_pictures_that_are_shown_twice_are_named_and_their_pan_is_carried_on(
    capture: Capture, reconstruction: Reconstruction, tmp_path: Path
) -> None:
    filmed, at = dataclasses.replace(bare(capture), subject=None, keyframe_poses={}), [4, 6]
    whole, found = (
        reconstruct(turning(filmed, tmp_path, repeated), Config(), cameras=reconstruction) for repeated in ([], at)
    )
    named = [[note for note in each.notes if "once more" in note] for each in (whole, found)]
    assert not named[0]
    for each in (whole, found):
        assert [note for note in each.notes if "held upright" in note] == [f"camera 1: {ON_ITS_SIDE}"]
    assert not any("held upright" in note for note in reconstruction.notes)
    assert [note[:55] for note in named[1]] == ["camera 1: in 2 frames, the first of them 4 (11:05:53:07"]
    before, after = whole.tracks[0], found.tracks[0]
    assert before is not None
    assert after is not None
    off = np.abs(after.pan_rad - before.pan_rad)[at]
    assert np.all(off * after.focal_px[at] < 2.0)  # 5 where it is left where the picture shows it
    assert np.all(off < 3.0 * np.sqrt(after.covariance[at, 0, 0]))
