"""The capture folder: written and read back, damaged in every way, and its recordings aligned by timecode."""

from __future__ import annotations

import itertools
import json
import shutil
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from pzcap.io.capture import frame_sets, read_capture, read_image
from pzcap.io.manifest import read_subject
from pzcap.io.timecode import frames_to_timecode, timecode_to_frames
from pzcap.types import (
    MEASUREMENTS,
    CalibrationObject,
    CameraFiles,
    Capture,
    Image,
    KnownLength,
    Mark,
    Marker,
    Pose,
    PzcapError,
    Subject,
)
from sim.capture_writer import write_capture, write_subject, write_video
from tests.scenes import specials

RATE = Fraction(30)
WIDTH, HEIGHT = 64, 48
START = timecode_to_frames("10:20:29:25", RATE)  # of the frame sets


def picture(clock: int, camera: int) -> Image:
    """Blue tells the time, green the camera."""
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    image[:] = (40 + 8 * (clock - START), 60 + 40 * camera, 100)
    return image


def told_time(image: Image) -> int:
    return START + round((float(image[..., 0].mean()) - 40) / 8)


def pose(seed: int) -> Pose:
    rng = np.random.default_rng(seed)
    rotations = rng.normal(size=(16, 4))
    return Pose(rng.normal(size=3), rotations / np.linalg.norm(rotations, axis=1, keepdims=True))


LENGTH = KnownLength(
    "side",
    12.0,
    0.01,
    ((Mark("1", "sweep", 2, np.array([3.5, 4.0])),), (Mark("2", "motion", 0, np.array([5.0, 6.25])),)),
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A capture of three cameras. Camera 1 starts 3 frames early, camera 2 in time; camera 3 drops two frames."""
    folder = tmp_path / "capture"
    cameras = []
    for camera, (early, late, dropped) in enumerate([(3, 0, ()), (0, 2, ()), (1, 4, (4, 5))]):
        place = folder / f"camera{camera + 1}"
        place.mkdir(parents=True)
        indices = [i for i in range(early + 10 + late) if i - early not in dropped]
        write_video(
            place / "motion.mp4", [picture(START - early + i, camera) for i in indices], RATE, crf=5,
            timecode=frames_to_timecode(START - early, RATE), indices=indices,
        )  # fmt: skip
        write_video(place / "sweep.mp4", [picture(START + i, camera) for i in range(4)], Fraction(5), crf=12)
        write_video(place / "zoom.mp4", [picture(START + i, camera) for i in range(4)], Fraction(5), crf=12)
        cv2.imwrite(str(place / "reference.png"), picture(START, camera))
        files = (place / name for name in ("reference.png", "sweep.mp4", "zoom.mp4", "motion.mp4"))
        cameras.append(CameraFiles(str(camera + 1), *files))
    marker = Marker(7, np.array([[0, 0, 1.0], [1, 0, 1], [1, 0, 0], [0, 0, 0]]))
    write_capture(
        Capture(
            folder=folder,
            name="test",
            frame_rate=RATE,
            cameras=tuple(cameras),
            calibration_object=CalibrationObject("DICT_4X4_50", (marker,), np.zeros((2, 2, 3))),
            subject=Subject({name: 0.1 + 0.01 * k for k, name in enumerate(MEASUREMENTS)}, 0.005),
            keyframe_poses={frames_to_timecode(START + k, RATE): pose(k) for k in (9, 0)},
            full_turn=True,
            lengths=(LENGTH,),
        )
    )
    return folder


def edit(path: Path, change: Callable[[Any], Any]) -> None:
    """Change a JSON file: ``change`` edits the value in place or returns another."""
    value = json.loads(path.read_text())
    changed = change(value)
    path.write_text(json.dumps(value if changed is None else changed))


def test_what_is_written_is_read_back(folder: Path) -> None:
    capture = read_capture(folder)
    assert (capture.name, capture.frame_rate, capture.full_turn) == ("test", RATE, True)
    assert [camera.name for camera in capture.cameras] == ["1", "2", "3"]
    assert capture.cameras[1].zoom == folder / "camera2" / "zoom.mp4"
    assert capture.calibration_object is not None
    assert capture.calibration_object.markers[0].id == 7
    np.testing.assert_array_equal(capture.calibration_object.markers[0].corners_m[1], [1, 0, 1])
    assert capture.subject is not None
    assert capture.subject.measurements_m["trunk"] == pytest.approx(0.11)
    read, written = capture.keyframe_poses[frames_to_timecode(START + 9, RATE)], pose(9)
    np.testing.assert_allclose(read.rotations, written.rotations, atol=1e-12)
    np.testing.assert_allclose(read.root_position_m, written.root_position_m, atol=1e-12)
    (length,) = capture.lengths
    assert (length.name, length.length_m, length.sigma_m) == ("side", 12.0, 0.01)
    for marks, there in zip(length.ends, LENGTH.ends, strict=True):
        assert [(m.camera, m.video, m.frame, *m.px) for m in marks] == [
            (m.camera, m.video, m.frame, *m.px) for m in there
        ]


@pytest.mark.parametrize(
    "person",
    [
        Subject({}, 0.005),
        Subject({"stature": 1.71, "foot": 0.26}, 0.005, {"foot": 0.01}, 61.5, "female"),
    ],
)
def test_a_subject_may_be_known_in_part(folder: Path, person: Subject) -> None:
    write_subject(folder / "subject.json", person)
    assert read_capture(folder).subject is not None
    found = read_subject(folder / "subject.json")
    assert (found.measurements_m, found.sigma_m) == (person.measurements_m, person.sigma_m)
    assert (found.sigmas_m, found.mass_kg, found.sex) == (person.sigmas_m, person.mass_kg, person.sex)
    assert [found.sigma_of(name) for name in ("stature", "foot")] == [0.005, person.sigmas_m.get("foot", 0.005)]


def test_a_capture_can_be_moved(folder: Path, tmp_path: Path) -> None:
    shutil.move(folder, tmp_path / "elsewhere")
    assert len(frame_sets(read_capture(tmp_path / "elsewhere"))) == 10


def test_frame_sets_show_one_instant_each(folder: Path) -> None:
    sets = frame_sets(read_capture(folder))
    assert len(sets) == 10
    assert sets.timecodes[0] == "10:20:29:25"
    assert sets.timecodes[5] == "10:20:30:00"
    listed = list(sets)
    assert [frames.index for frames in listed] == list(range(10))
    for frames in listed:
        assert frames.timecode == sets.timecodes[frames.index]
        for camera, image in enumerate(frames.images):
            if camera == 2 and frames.index in (4, 5):
                assert image is None
            else:
                assert image is not None
                assert told_time(image) == START + frames.index
                assert abs(float(image[..., 1].mean()) - (60 + 40 * camera)) < 3


def test_a_range_equals_that_part_of_the_whole(folder: Path) -> None:
    sets = frame_sets(read_capture(folder))
    whole = list(sets)
    part = list(sets.between(3, 8))
    assert [frames.index for frames in part] == [3, 4, 5, 6, 7]
    for frames in part:
        for image, expected in zip(frames.images, whole[frames.index].images, strict=True):
            assert (image is None) == (expected is None)
            if image is not None and expected is not None:
                np.testing.assert_array_equal(image, expected)
    assert list(sets.between(4, 4)) == []


def test_a_reader_that_stops_early_leaves_nothing_running(folder: Path) -> None:
    import threading

    before = threading.active_count()
    assert len(list(itertools.islice(frame_sets(read_capture(folder)), 2))) == 2
    import gc

    gc.collect()
    assert threading.active_count() <= before


def test_keyframes_are_found_by_timecode_in_order(folder: Path) -> None:
    keyframes = frame_sets(read_capture(folder)).keyframes
    assert [keyframe.frame for keyframe in keyframes] == [0, 9]
    np.testing.assert_allclose(keyframes[1].pose.rotations, pose(9).rotations, atol=1e-12)


def test_recordings_align_across_midnight(folder: Path) -> None:
    early = folder / "camera1" / "motion.mp4"
    late = folder / "camera2" / "motion.mp4"
    write_video(early, [picture(START, 0)] * 8, RATE, crf=12, timecode="23:59:59:27")
    write_video(late, [picture(START, 1)] * 8, RATE, crf=12, timecode="00:00:00:00")
    edit(folder / "capture.json", lambda m: m.update(cameras=m["cameras"][:2], keyframes=None))
    sets = frame_sets(read_capture(folder))
    assert sets.timecodes == tuple(f"00:00:00:0{k}" for k in range(5))


@pytest.mark.parametrize("kind", ["reference", "sweep", "zoom", "motion"])
def test_a_file_that_was_not_brought_is_none(folder: Path, kind: str) -> None:
    edit(folder / "capture.json", lambda m: m["cameras"][1].update({kind: None}))
    capture = read_capture(folder)
    assert getattr(capture.cameras[1], kind) is None
    images = next(iter(frame_sets(capture))).images
    assert (images[1] is None) == (kind == "motion")
    assert images[0] is not None


@pytest.mark.parametrize("key", ["object", "subject", "keyframes"])
def test_papers_that_were_not_brought_are_none(folder: Path, key: str) -> None:
    edit(folder / "capture.json", lambda m: m.pop(key) and None)
    capture = read_capture(folder)
    found = {
        "object": capture.calibration_object is not None,
        "subject": capture.subject is not None,
        "keyframes": bool(capture.keyframe_poses),
    }
    assert found == {name: name != key for name in found}


def _first_rotation(keyframes: Any) -> Any:
    return keyframes[0]["rotations_wxyz"]


JSON_FAULTS: dict[str, tuple[str, Callable[[Any], Any], str]] = {
    "another format": ("capture.json", lambda m: m.update(format="bvh"), "format"),
    "a version to come": ("capture.json", lambda m: m.update(version=2), "version 1"),
    "no frame rate": ("capture.json", lambda m: m.pop("frame_rate") and None, '"frame_rate" is missing'),
    "a bad frame rate": ("capture.json", lambda m: m.update(frame_rate="thirty"), "frame_rate"),
    "another frame rate": ("capture.json", lambda m: m.update(frame_rate="25/1"), "25"),
    "no cameras": ("capture.json", lambda m: m.update(cameras=[]), "at least one camera"),
    "a name twice": ("capture.json", lambda m: m["cameras"][1].update(name="1"), "name of its own"),
    "a missing video": ("capture.json", lambda m: m["cameras"][1].update(sweep="gone.mp4"), "gone.mp4"),
    "no list": ("capture.json", lambda _: [1], "JSON object"),
    "an unknown dictionary": ("object.json", lambda o: o.update(dictionary="DICT_9X9"), "DICT_9X9"),
    "a corner of two numbers": ("object.json", lambda o: o["markers"][0].update(corners_m=[[0, 1]] * 4), "corners_m"),
    "a marker twice": ("object.json", lambda o: o["markers"].append(o["markers"][0]), "id of its own"),
    "a misspelt measurement": (
        "subject.json",
        lambda s: s["measurements_m"].update(thig=s["measurements_m"].pop("thigh")),
        'unknown measurement "thig"; the nearest are thigh',
    ),
    "the sigma of what was not measured": (
        "subject.json", lambda s: s.update(measurements_m={"stature": 1.7}, sigmas_m={"shank": 0.01}), '"shank" is not'
    ),
    "a misspelt entry of the subject": ("subject.json", lambda s: s.update(sigma={"shank": 0.01}), "the nearest are"),
    "a mass in grams": ("subject.json", lambda s: s.update(mass_kg=62000), "62000 kg"),
    "a sex that the regression does not know": ("subject.json", lambda s: s.update(sex=["male"]), '"female", "male"'),
    "a negative length": ("subject.json", lambda s: s["measurements_m"].update(foot=-0.2), "foot"),
    "a length in words": ("subject.json", lambda s: s["measurements_m"].update(foot="26 cm"), "foot"),
    "a quaternion that is none": ("keyframes.json", lambda k: _first_rotation(k).update(head=[1, 1, 0, 0]), "head"),
    "a quaternion that is not finite": (
        "keyframes.json", lambda k: _first_rotation(k).update(head=[float("nan"), 1, 0, 0]), "head"
    ),
    "a segment left out": ("keyframes.json", lambda k: _first_rotation(k).pop("lumbar") and None, "lumbar"),
    "an unknown segment": ("keyframes.json", lambda k: _first_rotation(k).update(tail=[1, 0, 0, 0]), "tail"),
    "a bad timecode": ("keyframes.json", lambda k: k[0].update(timecode="noon"), "noon"),
    "a keyframe twice": ("keyframes.json", lambda k: k[0].update(timecode=k[1]["timecode"]), "second keyframe"),
    "a length of nothing": ("lengths.json", lambda one: one[0].update(length_m=0.0), "above 0"),
    "a length that is a guess": ("lengths.json", lambda one: one[0].update(sigma_m=3.0), "a tenth of the length"),
    "an end without a mark": ("lengths.json", lambda one: one[0].update(to=[]), "each end needs a mark"),
    "a mark in no video": ("lengths.json", lambda one: one[0]["to"][0].update(video="still"), '"sweep", "zoom" or'),
    "a mark between two pictures": ("lengths.json", lambda one: one[0]["to"][0].update(frame=1.5), "counted from 0"),
    "a mark by no camera": ("lengths.json", lambda one: one[0]["to"][0].update(camera="9"), "the cameras are 1, 2, 3"),
    "a mark after the end": ("lengths.json", lambda one: one[0]["from"][0].update(frame=4), "no picture 4: it holds 4"),
    "a mark beside the picture": ("lengths.json", lambda one: one[0]["to"][0].update(px=[-3.0, 2.0]), "outside the"),
    "a keyframe outside": ("keyframes.json", lambda k: k[0].update(timecode="10:20:40:00"), "outside"),
}  # fmt: skip


@pytest.mark.parametrize("fault", JSON_FAULTS)
def test_a_fault_in_the_papers_gets_one_line(folder: Path, fault: str) -> None:
    file, change, expected = JSON_FAULTS[fault]
    edit(folder / file, change)
    with pytest.raises(PzcapError) as caught:
        frame_sets(read_capture(folder))
    assert expected in str(caught.value)
    assert "\n" not in str(caught.value)
    assert str(folder) in str(caught.value)


def test_a_file_without_any_keyframe_is_as_good_as_none(folder: Path) -> None:
    """Keyframes may be found in keypoints, and a hand may have taken its own back."""
    edit(folder / "keyframes.json", lambda _: [])
    assert frame_sets(read_capture(folder)).keyframes == ()


def _no_timecode(folder: Path) -> None:
    write_video(folder / "camera2" / "motion.mp4", [picture(START, 1)] * 3, RATE, crf=12)


def _another_hour(folder: Path) -> None:
    write_video(folder / "camera2" / "motion.mp4", [picture(START, 1)] * 3, RATE, crf=12, timecode="11:00:00:00")


def _another_size(folder: Path) -> None:
    write_video(folder / "camera2" / "sweep.mp4", [np.zeros((64, 80, 3), np.uint8)] * 3, RATE, crf=12)


def _truncated(folder: Path) -> None:
    path = folder / "camera2" / "motion.mp4"
    path.write_bytes(path.read_bytes()[:600])


def _no_picture(folder: Path) -> None:
    (folder / "camera2" / "reference.png").write_bytes(b"\x89PNG")


def _no_json(folder: Path) -> None:
    (folder / "camera2").rename(folder / "kept")
    (folder / "capture.json").write_text("{'name': 1}")


def _no_manifest(folder: Path) -> None:
    (folder / "capture.json").unlink()


def _detect(folder: Path, camera: int, pictures: int) -> None:
    """Let a detector find somebody at column ``n`` of the ``n``-th picture of a camera."""
    place = folder / f"camera{camera}" / "keypoints"
    place.mkdir()
    for n in range(pictures):
        people = [{"pose_keypoints_2d": [float(n), 0.0, 1.0] * 25}]
        (place / f"motion_{n:012d}_keypoints.json").write_text(json.dumps({"people": people}))

    def name(manifest: Any) -> None:
        manifest["cameras"][camera - 1]["keypoints"] = f"camera{camera}/keypoints"

    edit(folder / "capture.json", name)


def _keypoints_gone(folder: Path) -> None:
    edit(folder / "capture.json", lambda m: m["cameras"][0].update(keypoints="found"))


def _keypoints_of_another_video(folder: Path) -> None:
    _detect(folder, 2, 50)


def _keypoints_broken(folder: Path) -> None:
    _detect(folder, 2, 5)
    (folder / "camera2" / "keypoints" / "motion_000000000003_keypoints.json").write_text('{"people": [{')


@pytest.mark.parametrize(
    ("damage", "expected"),
    [
        (_no_timecode, "no SMPTE timecode"),
        (_another_hour, "no timecode in common"),
        (_another_size, "one size"),
        (_truncated, "truncated"),
        (_no_picture, "cannot be decoded"),
        (_no_json, "not valid JSON"),
        (_no_manifest, "cannot be read"),
        (_keypoints_gone, "found is missing"),
        (_keypoints_of_another_video, "where the video holds"),
        (_keypoints_broken, "not valid JSON"),
    ],
)
def test_damage_gets_one_line(folder: Path, damage: Callable[[Path], None], expected: str) -> None:
    damage(folder)
    with pytest.raises(PzcapError, match=expected) as caught:
        frame_sets(read_capture(folder))
    assert "\n" not in str(caught.value)


def test_a_missing_image_gets_one_line(tmp_path: Path) -> None:
    with pytest.raises(PzcapError, match="no such image"):
        read_image(tmp_path / "reference.png")


def test_keypoints_come_with_their_pictures(folder: Path) -> None:
    """A detector counts pictures: camera 1 started 3 frames early, camera 3 one, and dropped frames 4 and 5 since."""
    _detect(folder, 1, 13)
    _detect(folder, 3, 12)
    capture = read_capture(folder)
    write_capture(capture)
    assert read_capture(folder).cameras[0].keypoints == folder / "camera1" / "keypoints"
    assert read_capture(folder).cameras[1].keypoints is None
    sets = list(frame_sets(capture))
    assert [float(frames.keypoints[0][0, 0, 0]) for frames in sets] == [float(k + 3) for k in range(10)]
    assert all(frames.keypoints[1].shape == (0, 26, 3) for frames in sets)
    counts = [[float(person[0, 0]) for person in frames.keypoints[2]] for frames in sets]
    assert counts == [[1], [2], [3], [4], [], [], [5], [6], [7], [8]]


def test_without_keypoints_a_frame_set_has_none(folder: Path) -> None:
    assert all(frames.keypoints == () for frames in frame_sets(read_capture(folder)))


# --------------------------------------------------------------------------------------------------------------
# What it opens


@pytest.mark.parametrize("kind", ["motion", "sweep", "reference", "keypoints", "object", "subject", "keyframes"])
@pytest.mark.parametrize("name", ["../outside", "camera1/../../outside", "/dev/null", "{folder}/capture.json"])
def test_a_name_that_leads_out_of_the_folder_gets_one_line(folder: Path, kind: str, name: str) -> None:
    (folder.parent / "outside").write_text("{}")
    name = name.format(folder=folder)

    def lead_out(manifest: Any) -> None:
        where = manifest if kind in ("object", "subject", "keyframes") else manifest["cameras"][1]
        where[kind] = name

    edit(folder / "capture.json", lead_out)
    with pytest.raises(PzcapError) as caught:
        read_capture(folder)
    assert str(folder / "capture.json") in str(caught.value)
    assert f"{kind}: {name} leads out of the folder; put the file, or a link to it, inside" in str(caught.value)


def test_links_are_followed(folder: Path, tmp_path: Path) -> None:
    video = folder / "camera1" / "motion.mp4"
    video.rename(tmp_path / "card.mp4")
    video.symlink_to(tmp_path / "card.mp4")
    (tmp_path / "link").symlink_to(folder, target_is_directory=True)
    assert len(frame_sets(read_capture(tmp_path / "link"))) == 10


PLACES = (
    "capture.json", "object.json", "subject.json", "keyframes.json", "camera1/reference.png", "camera2/sweep.mp4",
    "camera2/zoom.mp4", "camera3/motion.mp4", "camera1/keypoints.json", "camera2/keypoints/1.json",
)  # fmt: skip


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("kind", ["a pipe", "a folder", "a socket", "a device"])
def test_what_is_no_file_is_refused_before_it_is_opened(folder: Path, place: str, kind: str) -> None:
    (folder / "camera2" / "keypoints").mkdir()
    for name in ("camera1/keypoints.json", "camera2/keypoints/1.json"):
        (folder / name).write_text("[]" if name.startswith("camera1") else '{"people": []}')

    def name_keypoints(manifest: Any) -> None:
        manifest["cameras"][0]["keypoints"], manifest["cameras"][1]["keypoints"] = (
            "camera1/keypoints.json", "camera2/keypoints"
        )  # fmt: skip

    edit(folder / "capture.json", name_keypoints)
    frame_sets(read_capture(folder))
    (folder / place).unlink()
    specials.make(folder / place, kind)
    if kind == "a folder" and place == "camera1/keypoints.json":
        kind = "holds no .json file"  # it may be a folder
    with pytest.raises(PzcapError, match=kind) as caught:
        frame_sets(read_capture(folder))
    assert str(folder / place) in str(caught.value)
