"""What is logged can be read back: every stage, every number, and a file that verifies."""

from __future__ import annotations

import subprocess
import sysconfig
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from pzcap.events import CameraCalibrated, FrameLocalised, FrameSegmented
from pzcap.geometry import camera as geometry
from pzcap.types import (
    CalibrationObject,
    CameraFiles,
    Capture,
    FrameSet,
    Localisation,
    PzcapError,
    Reconstruction,
    Silhouette,
)
from pzcap.viewer import columns, drawing
from pzcap.viewer.recording import Recorder, has_footer
from tests.scenes import fabricated

NAMES = ("1", "2", "north east", "カメラ")


@pytest.fixture(autouse=True)
def strict() -> Iterator[None]:
    """Without it a call that is wrong is a warning, and its data is lost."""
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


def capture(folder: Path) -> Capture:
    edges = np.array([[[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0]], [[1.0, 1.0, 0.0], [1.0, 1.0, 2.0]]])
    return Capture(
        folder=folder,
        name="fabricated",
        frame_rate=Fraction(30),
        cameras=tuple(CameraFiles(name, None, None, None, None) for name in NAMES),
        calibration_object=CalibrationObject("DICT_4X4_50", (), edges),
        subject=None,
        keyframe_poses={},
        full_turn=True,
    )


def frames(count: int) -> Iterator[FrameLocalised | FrameSegmented]:
    rng = np.random.default_rng(0)
    size = (fabricated.HEIGHT, fabricated.WIDTH)
    body = np.zeros(size, np.uint8)
    body[60:180, 100:140] = 255
    for index in range(count):
        image = rng.integers(0, 256, (*size, 3), dtype=np.uint8)
        images = (image, image, None, image)
        points = rng.uniform(0, 200, (300, 2))
        found = Localisation(0.1, -0.07, 440.0, np.eye(2) * 1e-6, True, points, points)
        people = rng.uniform(0.2, 1.0, (1, 26, 3)) * [fabricated.WIDTH, fabricated.HEIGHT, 1.0]
        nobody = people[:0]
        sets = FrameSet(index, f"01:00:00:{index:02d}", images, (people if index else nobody, nobody, nobody, people))
        yield FrameLocalised(sets, (found, None, None, found))
        silhouette = Silhouette(body, image, np.zeros((120, 160), np.float32), True)
        yield FrameSegmented(sets, (None,) * 4, (silhouette, None, None, silhouette), (None,) * 4)


def record(path: Path, whole: Reconstruction, count: int = 3) -> None:
    with Recorder(path, capture(path.parent), name="test") as recorder:
        for index in range(4):
            recorder.event(CameraCalibrated(index, None, 0.0))
        for event in frames(count):
            recorder.event(event)
        recorder.drain()
        columns.send_reconstruction(recorder.rec, whole, None)


def rows(path: Path, entity: str, component: str) -> list[tuple[int, Any]]:
    """(frame, value) of one component of one entity, in order."""
    found = []
    for chunk in RrdReader(path).store().stream().filter(content=entity, components=component).to_chunks():
        batch = chunk.to_record_batch()
        found += list(zip(batch["frame"].to_pylist(), batch[component].to_pylist(), strict=True))
    return sorted(found, key=lambda row: row[0])


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Reconstruction]:
    path = tmp_path_factory.mktemp("recording") / "recording.rrd"
    whole = fabricated.reconstruction()
    record(path, whole)
    return path, whole


def test_the_file_verifies(recording: tuple[Path, Reconstruction]) -> None:
    program = Path(sysconfig.get_path("scripts")) / "rerun"
    subprocess.run([program, "rrd", "verify", recording[0]], check=True, capture_output=True)
    assert has_footer(recording[0])


def test_every_stage_is_there(recording: tuple[Path, Reconstruction]) -> None:
    paths = {str(chunk.entity_path) for chunk in RrdReader(recording[0]).store().stream().to_chunks()}
    assert {
        "/world/floor", "/world/object", "/world/camera/1", "/world/camera/1/view", "/world/camera/1/view/image",
        "/world/camera/1/view/keypoints",
        "/world/camera/1/view/matches", "/world/camera/1/view/outline", "/world/camera/1/view/skeleton",
        "/foreground/1/background", "/foreground/1/probability", "/panorama/1/frame", "/panorama/1/matches",
        "/track/pan/1", "/track/focal/1", "/world/body/skeleton", "/world/body/path", "/world/keyframes/0", "/notes",
        r"/world/camera/north\ east/view/image",
    } <= paths, sorted(paths)  # fmt: skip


def test_tracks_are_read_back_to_the_bit(recording: tuple[Path, Reconstruction]) -> None:
    path, whole = recording
    track = whole.tracks[1]
    assert track is not None
    pan = [value[0] for _, value in rows(path, "/track/pan/2", "Scalars:scalars")]
    np.testing.assert_allclose(pan, np.degrees(track.pan_rad), rtol=0, atol=0)
    focal = rows(path, "/track/focal/2", "Scalars:scalars")
    assert [frame for frame, _ in focal] == list(range(12))
    np.testing.assert_allclose([value[0] for _, value in focal], track.focal_px, rtol=0, atol=0)


def test_cameras_pan_and_zoom(recording: tuple[Path, Reconstruction]) -> None:
    path, whole = recording
    camera, track = whole.cameras[0], whole.tracks[0]
    assert camera is not None
    assert track is not None
    at = geometry.of_track(camera, track, 7)
    matrix = np.reshape(rows(path, "/world/camera/1/view", "Pinhole:image_from_camera")[7][1], (3, 3)).T
    np.testing.assert_allclose(matrix[[0, 1], [0, 1]], at.focal_px, rtol=1e-6)
    np.testing.assert_allclose(matrix[:2, 2], at.principal_px + 0.5, rtol=1e-6)
    place = rows(path, "/world/camera/1", "Transform3D:translation")[7][1]
    np.testing.assert_allclose(np.ravel(place), at.world_T_cam[:3, 3], rtol=1e-6)
    # Each row replaces the pinhole of the row before: without its resolution the viewer shows nothing.
    assert len(rows(path, "/world/camera/1/view", "Pinhole:resolution")) == 12


def test_a_dropped_frame_clears_the_view(recording: tuple[Path, Reconstruction]) -> None:
    cleared = rows(recording[0], r"/world/camera/north\ east/view/image", "Clear:is_recursive")
    assert [frame for frame, _ in cleared] == [0, 1, 2]


def test_a_reconstruction_without_a_camera_or_a_body_is_logged(tmp_path: Path) -> None:
    record(tmp_path / "r.rrd", fabricated.without_a_camera(fabricated.reconstruction()), count=1)
    assert has_footer(tmp_path / "r.rrd")


def test_a_run_that_fails_leaves_no_recording(tmp_path: Path) -> None:
    path = tmp_path / "r.rrd"
    with pytest.raises(PzcapError, match="broken"), Recorder(path, capture(tmp_path), name="test"):
        raise PzcapError("the sweep is broken")
    assert list(tmp_path.iterdir()) == []


def test_the_workers_error_reaches_the_caller(tmp_path: Path) -> None:
    event = next(frames(1))
    assert isinstance(event, FrameLocalised)
    wrong = FrameLocalised(event.frames, event.localisations[:2])

    def go() -> None:
        with Recorder(tmp_path / "r.rrd", capture(tmp_path), name="test") as recorder:
            recorder.event(wrong)
            recorder.drain()

    with pytest.raises(ValueError, match="zip"):
        go()
    assert list(tmp_path.iterdir()) == []


def test_a_file_without_a_footer_is_told(tmp_path: Path) -> None:
    whole = fabricated.reconstruction()
    record(tmp_path / "r.rrd", whole)
    content = (tmp_path / "r.rrd").read_bytes()
    (tmp_path / "cut.rrd").write_bytes(content[: len(content) // 2])
    assert not has_footer(tmp_path / "cut.rrd")


def test_two_recordings_have_two_ids(tmp_path: Path) -> None:
    one = Recorder(tmp_path / "a.rrd", capture(tmp_path), name="a")
    two = Recorder(tmp_path / "b.rrd", capture(tmp_path), name="b")
    with one, two:
        assert one.rec.get_recording_id() != two.rec.get_recording_id()
        assert one.rec.get_application_id() == two.rec.get_application_id() == "pzcap-v1"


def test_the_viewer_gets_no_character_that_its_font_lacks() -> None:
    assert columns.plain("カメラ 1").isascii()
    assert columns.plain("カメラ") != columns.plain("カラメ")


def test_footprints_surround_what_the_camera_sees() -> None:
    whole = fabricated.reconstruction()
    camera, panorama = whole.cameras[0], whole.panoramas[0]
    assert camera is not None
    assert panorama is not None
    ahead = geometry.at(camera, 0.0, -0.07, 440.0)
    (border,) = drawing.footprint(panorama, camera, ahead)
    assert border[:, 0].min() < panorama.origin_px[0] < border[:, 0].max()
    width = 2 * np.arctan(fabricated.WIDTH / 2 / 440.0) * panorama.px_per_rad
    assert np.ptp(border[:, 0]) == pytest.approx(width, rel=0.05)
    behind = geometry.at(camera, np.pi, -0.07, 440.0)
    parts = drawing.footprint(panorama, camera, behind)
    assert len(parts) >= 2  # cut where the turn wraps
    for part in parts:
        assert part[:, 0].min() >= -1e-9
        assert part[:, 0].max() <= panorama.image.shape[1]


def test_outlines_are_closed() -> None:
    probability = np.zeros((50, 60), np.uint8)
    probability[10:40, 20:30] = 200
    (outline,) = drawing.outlines(probability)
    np.testing.assert_array_equal(outline[0], outline[-1])
    assert outline.min(axis=0).tolist() == [20, 10]
    assert outline.max(axis=0).tolist() == [29, 39]


def test_tips_hang_where_a_standing_body_has_them() -> None:
    whole = fabricated.reconstruction()
    assert whole.motion is not None
    figure = drawing.figures(whole.motion.joints_m, whole.motion.rotations)
    assert figure.shape == (12, 21, 3)
    assert figure[0, 16, 2] > figure[0, 3, 2]  # head above the neck
    assert figure[0, 17, 2] < figure[0, 6, 2]  # finger tips below the wrist
    assert figure[0, 19, 0] > figure[0, 12, 0]  # toes before the ankle
