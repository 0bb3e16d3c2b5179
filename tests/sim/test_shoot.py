"""The shoot as a whole: what is in the pixels agrees with the truth, and the same config gives the same bytes."""

from __future__ import annotations

import errno
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Literal

import cattrs
import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from experiments import footage
from experiments.footage import SMALL
from pzcap.io.capture import frame_sets, read_capture, read_image
from pzcap.io.detections import KEYPOINTS
from pzcap.io.video import VideoReader
from pzcap.types import HINGE_AXES, JOINTS, MEASUREMENTS, SEGMENTS, Array, Pose, PzcapError
from sim import capture_cache, team
from sim import develop as developing
from sim import light as lighting
from sim.cameras.film import FilmCamera
from sim.cameras.operator import PanTiltZoom
from sim.cameras.optics import OpticsConfig
from sim.cameras.sensor import SensorConfig
from sim.capture_cache import kept, make_room, shoot_cached
from sim.light import light_of
from sim.people.crew import CrewConfig, keyframe_indices, measure, pose_by_hand
from sim.people.detector import DetectorConfig
from sim.session import ShootConfig, assemble
from sim.shoot import shoot
from sim.team import Progress
from sim.truth import Truth, load
from tests.scenes.captures import TINY, project

NOISELESS = SensorConfig(read_noise=0.0, shot_noise=0.0, exposure_drift=0.0)


@pytest.fixture(scope="module")
def truth(small_capture: Path) -> Truth:
    return load(small_capture / "truth")


def test_the_library_can_read_it(small_capture: Path, truth: Truth) -> None:
    capture = read_capture(small_capture / "capture")
    sets = frame_sets(capture)
    assert sets.timecodes == truth.timecodes
    assert len(sets) == SMALL.motion_frames
    assert [keyframe.frame for keyframe in sets.keyframes] == [0, 7]
    for frames in sets:
        assert all(image is not None and image.shape == (240, 320, 3) for image in frames.images)
    for c, camera in enumerate(capture.cameras):
        assert camera.sweep is not None
        assert camera.zoom is not None
        assert VideoReader(camera.sweep).frame_count == truth.sweep_pan_rad.shape[1] == 40
        assert VideoReader(camera.zoom).frame_count == truth.zoom_focal_px.shape[1] == 8
        assert truth.camera_names[c] == camera.name
    assert not capture.full_turn


def test_cameras_start_at_different_times(small_capture: Path) -> None:
    cameras = read_capture(small_capture / "capture").cameras
    readers = [VideoReader(camera.motion) for camera in cameras if camera.motion]
    assert len({reader.timecode for reader in readers}) > 1
    assert min(reader.frame_count for reader in readers) >= SMALL.motion_frames


def test_the_calibration_object_is_where_the_truth_says(small_capture: Path, truth: Truth) -> None:
    capture = read_capture(small_capture / "capture")
    assert capture.calibration_object is not None
    corners_m = {marker.id: marker.corners_m for marker in capture.calibration_object.markers}
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    parameters.cornerRefinementWinSize = 2
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    for c, camera in enumerate(capture.cameras):
        assert camera.reference is not None
        grey = cv2.cvtColor(read_image(camera.reference), cv2.COLOR_BGR2GRAY)
        grey = cv2.resize(grey, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)  # small markers
        found, ids, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(grey)
        assert ids is not None
        assert len(ids) >= 6
        errors = []
        numbers = ids.ravel().tolist()
        for number, corners in zip(numbers, found, strict=True):
            if numbers.count(number) > 1:  # something in the hall looks like a marker, too
                continue
            expected = project(truth.reference_camera(c), corners_m[number])
            errors.append((corners[0] + 0.5) / 2 - 0.5 - expected)
        assert np.abs(np.mean(errors, axis=(0, 1))).max() < 0.2
        assert np.sqrt(np.mean(np.square(errors))) < 0.6  # markers of 25 px


def taken(aim: PanTiltZoom, *sensors: SensorConfig) -> list[Array]:
    """Light of the first camera's picture of the object, by each sensor; the last is the finest."""
    session = assemble(replace(TINY, sensor=sensors[-1]))
    stage = session.stage()
    pictures = [FilmCamera(stage, session.rigs[0], sensor).still(aim).astype(np.float64) for sensor in sensors]
    stage.close()
    return pictures


def test_a_picture_rendered_finer_is_nearer_to_what_a_lens_would_show() -> None:
    sensors = [replace(NOISELESS, supersampling_still=supersampling) for supersampling in (2.0, 4.0, 8.0)]
    pictures = taken(PanTiltZoom(0.2, 200.0), *sensors)
    coarse, fine = (float(np.sqrt(np.mean((one - pictures[-1]) ** 2))) for one in pictures[:2])
    assert coarse < 15.0  # grey levels: it is the same picture
    assert fine < 0.7 * coarse


def test_a_turned_grid_shows_the_same_picture_more_exactly() -> None:
    turns = ((4.0, 0.0), (4.0, 9.5), (8.0, -13.0))
    sensors = [replace(NOISELESS, supersampling_still=finer, grid_turn_deg=turn_deg) for finer, turn_deg in turns]
    *both, exact = taken(PanTiltZoom(0.2, 200.0), *sensors)
    upright, turned = (float(np.sqrt(np.mean((one - exact) ** 2))) for one in both)
    assert upright < 10.0  # grey levels
    assert turned < 0.9 * upright


def test_without_mipmaps_a_floor_seen_at_a_flat_angle_keeps_its_sharpness() -> None:
    def sharpness(mipmaps: bool) -> tuple[float, float]:
        """Of floor and walls: the mean difference of neighbours in a row."""
        sensor = replace(NOISELESS, supersampling_still=8.0, mipmaps=mipmaps)
        (picture,) = taken(PanTiltZoom(0.9, 200.0), sensor)
        steps = np.abs(np.diff(picture.mean(axis=2), axis=1)).mean(axis=1)
        return float(steps[int(0.55 * len(steps)) :].mean()), float(steps[: len(steps) // 3].mean())

    (floor, walls), (blurred, same) = sharpness(False), sharpness(True)
    assert floor > 1.02 * blurred
    assert abs(walls / same - 1.0) < 0.01


def test_joints_lie_on_the_athlete(truth: Truth) -> None:
    on, seen = 0, 0
    for c in range(4):
        for f in range(len(truth.timecodes)):
            mask = cv2.dilate(truth.mask(c, f).astype(np.uint8), np.ones((3, 3), np.uint8))
            for u, v in np.rint(project(truth.camera(c, f), truth.joints_m[f])).astype(int):
                if 0 <= u < truth.width and 0 <= v < truth.height:
                    seen += 1
                    on += int(mask[v, u])
    assert seen > 0.9 * truth.joints_m[..., 0].size * 4
    assert on > 0.97 * seen


def test_as_many_cameras_as_are_asked_for(tmp_path: Path) -> None:
    drain(shoot(replace(TINY, cameras=5, zoom_frames=0), tmp_path))
    names = tuple("12345")
    assert tuple(files.name for files in read_capture(tmp_path / "capture").cameras) == names
    truth = load(tmp_path / "truth")
    assert truth.camera_names == names
    places_m = truth.reference_world_T_cam[:, :2, 3]
    apart_m = np.linalg.norm(places_m[:, None] - places_m, axis=2)
    assert apart_m[np.triu_indices(5, 1)].min() > 5.0  # the fifth along a wall, where it sees two faces of the object


def test_the_mask_is_where_the_picture_moved(small_capture: Path, truth: Truth) -> None:
    """Inside the mask stands the athlete: coloured otherwise than just outside it."""
    capture = read_capture(small_capture / "capture")
    first = next(iter(frame_sets(capture)))
    for c, image in enumerate(first.images):
        assert image is not None
        mask = truth.mask(c, 0)
        height = np.ptp(np.flatnonzero(mask.any(axis=1)))
        assert 0.1 * SMALL.optics.zoom_max * truth.height < height < 0.75 * truth.height
        edges = cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) != mask
        gradient = np.hypot(
            *(cv2.Sobel(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), cv2.CV_64F, *d) for d in ((1, 0), (0, 1)))
        )
        assert gradient[edges].mean() > 1.3 * gradient.mean()


def test_zoom_and_sweep_follow_the_config(truth: Truth) -> None:
    zoom = truth.zoom_focal_px / truth.reference_focal_px[:, None]
    np.testing.assert_allclose(zoom[:, [0, -1]], [[SMALL.optics.zoom_min, SMALL.optics.zoom_max]] * 4)
    assert np.abs(np.rad2deg(truth.zoom_pan_rad)).max() <= 5
    assert (np.diff(truth.sweep_pan_rad, axis=1) > 0).all()
    assert (truth.sweep_pan_rad[:, 0] < 0).all()
    assert (truth.sweep_pan_rad[:, -1] > 0).all()
    assert (truth.focal_px >= SMALL.optics.zoom_min * truth.reference_focal_px[:, None] - 1e-6).all()
    assert (truth.focal_px <= SMALL.optics.zoom_max * truth.reference_focal_px[:, None] + 1e-6).all()


def test_scene_points_lie_in_the_hall(truth: Truth) -> None:
    assert truth.scene_points_m.shape[0] == 4
    assert truth.scene_points_m.shape[1] > 400
    assert (np.abs(truth.scene_points_m) <= [15.01, 10.01, 8.01]).all()
    distance = np.linalg.norm(truth.scene_points_m - truth.reference_world_T_cam[:, None, :3, 3], axis=2)
    assert distance.min() > 0.5


def test_the_crew_brings_papers_with_errors(small_capture: Path, truth: Truth) -> None:
    capture = read_capture(small_capture / "capture")
    assert capture.subject is not None
    errors = [capture.subject.measurements_m[name] - truth.measurements_m[name] for name in MEASUREMENTS]
    assert 0.002 < np.std(errors) < 0.009
    pose = next(iter(capture.keyframe_poses.values()))
    assert 0.0005 < np.linalg.norm(pose.root_position_m - truth.root_position_m[0]) < 0.03


def test_the_tape_has_its_error() -> None:
    true = dict.fromkeys(MEASUREMENTS, 0.5)
    rng = np.random.default_rng(0)
    read = [list(measure(true, CrewConfig(), rng, {}).measurements_m.values()) for _ in range(200)]
    assert np.std(read) == pytest.approx(0.005, rel=0.05)
    assert measure(true, CrewConfig(tape_sigma_m=0.0), rng, {}).measurements_m == true


def test_hands_pose_with_their_error() -> None:
    rng = np.random.default_rng(0)
    true = Pose(np.zeros(3), Rotation.random(16, rng=1).as_quat(scalar_first=True))
    posed = [pose_by_hand(true, CrewConfig(), rng) for _ in range(300)]
    distances = np.linalg.norm([pose.root_position_m for pose in posed], axis=1)
    assert np.sqrt(np.mean(distances**2)) == pytest.approx(0.010, rel=0.06)
    reference = Rotation.from_quat(true.rotations, scalar_first=True)
    turns = np.array(
        [(reference.inv() * Rotation.from_quat(p.rotations, scalar_first=True)).as_rotvec() for p in posed]
    )
    assert np.rad2deg(np.sqrt(np.mean(np.sum(turns**2, axis=2)))) == pytest.approx(3.0, rel=0.05)
    for name, axis in HINGE_AXES.items():
        assert np.abs(np.cross(turns[:, SEGMENTS.index(name)], axis)).max() < 1e-12
    exact = pose_by_hand(true, CrewConfig(keyframe_position_m=0.0, keyframe_rotation_deg=0.0), rng)
    np.testing.assert_allclose(exact.rotations, true.rotations, atol=1e-12)


def test_keyframes_are_one_a_second() -> None:
    assert keyframe_indices(171, 30, CrewConfig()) == [0, 34, 68, 102, 136, 170]
    assert keyframe_indices(8, 30, CrewConfig()) == [0, 7]
    assert keyframe_indices(1, 30, CrewConfig()) == [0]
    assert len(keyframe_indices(171, 30, CrewConfig(keyframes_per_s=2))) == 11


def listing(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def drain(progress: Iterator[Progress]) -> list[Progress]:
    return list(progress)


@pytest.fixture(scope="module")
def lit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the tiny shoot and its light. Others of the same light are developed there sooner."""
    root = tmp_path_factory.mktemp("lit")
    footage.shot(TINY, root)
    return root


def captured(config: ShootConfig, root: Path) -> dict[str, bytes]:
    """The files of a shoot that is kept in ``root``."""
    found = listing(footage.shot(config, root))
    assert found.pop("complete") == b""
    return found


def test_the_same_config_gives_the_same_bytes(lit: Path, tmp_path: Path) -> None:
    steps = drain(shoot(TINY, tmp_path))
    assert all(0 <= step.done <= step.total for step in steps)
    first, second = captured(TINY, lit), listing(tmp_path)
    assert len(first) == 4 * 4 + 4 + 3
    assert first.keys() == second.keys()
    assert [name for name in first if first[name] != second[name]] == []


def test_a_shoot_is_reused_and_a_killed_one_is_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shot = []

    def pretend(config: ShootConfig, _: Path, folder: Path) -> Iterator[Progress]:
        (folder / "capture").mkdir()
        yield Progress("develop", 1, 2)
        shot.append(config.seed)
        yield Progress("develop", 2, 2)

    monkeypatch.setattr(capture_cache, "film", lambda *_: iter(()))
    monkeypatch.setattr(capture_cache, "develop", pretend)
    killed = shoot_cached(TINY, tmp_path)
    next(killed)
    killed.close()
    assert shot == []
    assert [path.name.startswith("light-") for path in tmp_path.iterdir()] == [True]  # that was filmed by then
    folders = []
    for config in (TINY, TINY, replace(TINY, seed=1)):
        run = shoot_cached(config, tmp_path)
        try:
            while True:
                next(run)
        except StopIteration as end:
            folders.append(end.value)
    assert shot == [0, 1]
    assert folders[0] == folders[1] != folders[2]
    assert (folders[0] / "capture").is_dir()


def test_the_config_survives_plain_data() -> None:
    converter = cattrs.Converter(forbid_extra_keys=True)
    config = replace(SMALL, optics=OpticsConfig(k1_wide=-0.1), sensor=SensorConfig(dropped_share=0.05))
    plain = json.loads(json.dumps(converter.unstructure(config)))
    assert converter.structure(plain, ShootConfig) == config


GAPPY = replace(TINY, motion_frames=8, sensor=SensorConfig(dropped_share=0.4, sub_exposures=1))


def test_dropped_frames_are_gaps(lit: Path) -> None:
    folder = footage.shot(GAPPY, lit)
    truth = load(folder / "truth")
    assert not truth.recorded.all()
    sets = frame_sets(read_capture(folder / "capture"))
    present = np.array([[image is not None for image in frames.images] for frames in sets]).T
    np.testing.assert_array_equal(present, truth.recorded)


def test_a_detector_finds_the_athlete_and_changes_no_footage(lit: Path) -> None:
    """In the frames that were not dropped, and in them alone."""
    config = replace(GAPPY, detector=DetectorConfig(enabled=True))
    without, found = (listing(footage.shot(one, lit) / "capture") for one in (GAPPY, config))
    assert [name for name in without if found[name] != without[name]] == ["capture.json"]
    folder = footage.shot(config, lit)
    truth = load(folder / "truth")
    joints = [JOINTS.index(name) for name in KEYPOINTS if name in JOINTS]
    points = [KEYPOINTS.index(JOINTS[joint]) for joint in joints]
    off = []
    for f, frames in enumerate(frame_sets(read_capture(folder / "capture"))):
        for c, people in enumerate(frames.keypoints):
            assert len(people) == truth.recorded[c, f]
            for person in people[:, points]:
                distance = np.linalg.norm(
                    person[:, :2] - project(truth.camera(c, f), truth.joints_m[f, joints]), axis=1
                )
                off += distance[person[:, 2] > 0].tolist()
    assert len(off) > 100
    assert np.median(off) < 3.0


def test_two_processes_film_the_same_bytes_as_one(lit: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    one = captured(TINY, lit)
    monkeypatch.setattr(team, "FEW", 0)
    monkeypatch.setattr(team, "free_cores", lambda: 2)
    steps = drain(shoot(TINY, tmp_path))
    assert list(dict.fromkeys(step.stage for step in steps)) == ["build", "film", "develop"]
    assert steps[-1].done == steps[-1].total
    assert one == listing(tmp_path)


def test_what_fails_in_another_process_ends_the_shoot_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(team, "FEW", 0)
    monkeypatch.setattr(team, "free_cores", lambda: 2)
    steps = shoot(TINY, tmp_path)
    assert [next(steps).stage for _ in range(2)] == ["build", "build"]
    (folder,) = tmp_path.glob(".light-*/camera1")
    shutil.rmtree(folder)
    with pytest.raises(PzcapError, match=r"camera1.*cannot write the video: No such file or directory"):
        drain(steps)
    assert list(tmp_path.iterdir()) == []


def test_other_noise_is_developed_from_light_that_was_filmed_before(
    lit: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Noise, exposure, compression, vignetting, lost frames, lamps, papers and keypoints; and no byte is other than
    if all had been filmed for them alone."""
    others = replace(
        TINY,
        gym=replace(TINY.gym, lights_on=1.2),
        optics=replace(TINY.optics, vignetting=0.7),
        sensor=SensorConfig(
            read_noise=5.0, shot_noise=0.1, exposure_drift=0.1, crf_motion=30, crf_still=20, dropped_share=0.3
        ),
        crew=CrewConfig(keyframes_per_s=5.0),
        detector=DetectorConfig(enabled=True),
    )
    drain(shoot(others, tmp_path))
    monkeypatch.setattr(capture_cache, "film", None)
    found = captured(others, lit)
    assert "capture/camera1/keypoints" in {str(Path(name).parent) for name in found}
    assert found == listing(tmp_path)
    assert light_of(replace(TINY, crew=CrewConfig(walks_in_sweep=True))) != light_of(TINY)


def test_light_depends_on_what_brings_the_cameras_together_where_their_clocks_differ() -> None:
    """Without timecode those frames of clocks that differ belong together that are nearest."""

    def light(sync: Literal["timecode", "sound", "flash"], clock_offset: float) -> ShootConfig:
        sensor = SensorConfig(clock_offset=clock_offset)
        return light_of(replace(TINY, sensor=sensor, crew=CrewConfig(sync=sync)))

    assert light("sound", 0.0) == light("timecode", 0.0) == light_of(TINY)
    assert light("sound", 0.5) == light("flash", 0.5) != light("timecode", 0.5)


def test_light_that_was_not_used_for_longest_goes_first(tmp_path: Path) -> None:
    for age_h, name in enumerate(("light-a-0-000000000000", "light-b-0-000000000000", "c-0-000000000000")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "frames").write_bytes(bytes(1_000_000))
        (tmp_path / name / "complete").touch()
        used_s = time.time() - 3600.0 * (age_h + 0.5)
        os.utime(tmp_path / name / "complete", (used_s, used_s))
    assert [one.folder.name[:7] for one in kept(tmp_path)] == ["light-a", "light-b", "c-0-000"]
    assert make_room(tmp_path, 0.003) == []
    assert [one.folder.name[:7] for one in make_room(tmp_path, 0.0)] == ["light-b"]  # what may be in use stays
    assert {path.name[:7] for path in tmp_path.iterdir()} == {"light-a", "c-0-000"}


def test_a_failing_encoder_ends_the_shoot(lit: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise PzcapError("the disk is full")

    monkeypatch.setattr(developing, "write_video", full)
    with pytest.raises(PzcapError, match="the disk is full"):
        footage.shot(replace(TINY, sensor=SensorConfig(read_noise=3.0)), lit)


def test_an_unknown_motion_gets_one_line(tmp_path: Path) -> None:
    with pytest.raises(PzcapError, match="pedestrian"):
        drain(shoot(replace(TINY, motion="pedestrain"), tmp_path))


def test_a_full_disk_gets_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(lighting, "assemble", full)
    with pytest.raises(PzcapError, match="the disk is full"):
        drain(shoot(TINY, tmp_path))


@pytest.mark.parametrize(("backend", "expected"), [("nothing", "set it to one of"), ("glfw", "apt-get install")])
def test_no_gl_gets_one_line(tmp_path: Path, backend: str, expected: str) -> None:
    """In a process of its own: the backend is chosen when MuJoCo is first imported."""
    script = (
        "import sys; from pathlib import Path\n"
        "from sim.shoot import shoot; from sim.session import ShootConfig; from pzcap.types import PzcapError\n"
        "try: list(shoot(ShootConfig(), Path(sys.argv[1])))\n"
        "except PzcapError as error: print(error); sys.exit(3)"
    )
    environment = {**os.environ, "MUJOCO_GL": backend, "DISPLAY": "", "WAYLAND_DISPLAY": ""}
    run = subprocess.run(
        [sys.executable, "-c", script, str(tmp_path)], env=environment, capture_output=True, text=True, check=False
    )
    assert run.returncode == 3, run.stderr
    assert expected in run.stdout
    assert run.stdout.count("\n") == 1
