"""Wrong footage and papers are named by their cause; right ones raise no note."""

from __future__ import annotations

import contextlib
import re
import shutil
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pzcap.assembly import papers_against_views
from pzcap.body import skeleton
from pzcap.body.kinematics import joints
from pzcap.calibration.blame import focal_in_doubt, lens_moved, sweep_is_foreign
from pzcap.calibration.calibrate import CalibratedCamera, contradiction
from pzcap.calibration.settings import PanZoomConfig
from pzcap.camera_set import calibrate_camera, calibrate_cameras, footage_of
from pzcap.geometry.camera import project
from pzcap.io.capture import read_capture
from pzcap.plausibility import (
    SeenKeyframe,
    SeenViews,
    blames_object,
    check_upright,
    company,
    is_touched,
    lost_body,
    object_of_another_size,
    object_of_other_shape,
    open_circle,
    seen_keyframe,
    unlocated,
    unseen_keyframes,
)
from pzcap.types import Camera, Capture, Keyframe, Pose, PzcapError, Silhouette
from tests.scenes import fabricated
from tests.scenes.captures import facing

TIMECODES = tuple(f"10:00:00:{frame:02}" for frame in range(30))
MARGIN = 0.1


@pytest.fixture(scope="module")
def capture(small_capture: Path) -> Capture:
    return read_capture(small_capture / "capture")


def test_a_sweep_that_does_not_close_says_where() -> None:
    usual = fabricated.reconstruction()
    panorama, camera, reference = usual.panoramas[0], usual.cameras[0], usual.references[0]
    assert panorama is not None
    assert camera is not None
    assert reference is not None
    around = np.deg2rad(np.arange(-100.0, 241.0, 5.0))  # the way to 260 is missing
    part = replace(panorama, full_turn=False, sweep_pan_rad=around)
    known = replace(camera, focal_sigma=0.00123)
    note = open_circle("2", CalibratedCamera(reference, part, known))
    assert note is not None
    assert note.startswith("camera 2: from 120 right to 100 right (degrees from the reference image) its sweep")
    assert "known to 0.12%" in note
    assert open_circle("2", CalibratedCamera(reference, replace(part, full_turn=True), known)) is None


# --------------------------------------------------------------------------------------------------------------
# A sweep of another camera


def test_a_sweep_of_another_camera_is_blamed_and_not_the_zoom_run(
    capture: Capture, small_capture: Path, tmp_path: Path
) -> None:
    first, second = (footage_of(capture, files) for files in capture.cameras[:2])
    assert not sweep_is_foreign(first, PanZoomConfig())
    assert sweep_is_foreign(first._replace(sweep=second.sweep), PanZoomConfig())
    assert not sweep_is_foreign(first._replace(zoom=second.zoom), PanZoomConfig())
    assert not sweep_is_foreign(first._replace(sweep=second.sweep, zoom=None), PanZoomConfig())
    shutil.copytree(small_capture / "capture", tmp_path / "swapped")
    shutil.copy(small_capture / "capture" / "camera2" / "sweep.mp4", tmp_path / "swapped" / "camera1" / "sweep.mp4")
    whole = read_capture(tmp_path / "swapped")
    swapped = replace(whole, cameras=whole.cameras[:1])

    def calibrate(footage: Any, report: Any) -> Any:
        return calibrate_camera(footage, PanZoomConfig(), report)

    with (
        ThreadPoolExecutor(1) as pool,
        pytest.raises(PzcapError, match="it is another camera's, or was shot elsewh") as e,
    ):
        list(calibrate_cameras(swapped, calibrate, pool, []))
    assert f"camera 1: {tmp_path / 'swapped' / 'camera1' / 'sweep.mp4'}: shows nothing of what the ref" in str(e.value)


@pytest.mark.parametrize(("other", "blamed"), [(True, True), (False, False)])
def test_a_sweep_of_another_camera_that_can_be_calibrated_is_blamed_as_well(
    other: bool, blamed: bool, capture: Capture
) -> None:
    """Its focal length is not that of the reference image; that alone is a lens that moved."""
    first, second = capture.cameras[:2]
    one = replace(capture, cameras=(replace(first, sweep=second.sweep if other else first.sweep),))
    whole = fabricated.reconstruction()
    reference, panorama, head = whole.references[0], whole.panoramas[0], whole.cameras[0]
    assert reference is not None
    assert panorama is not None
    assert head is not None
    still = replace(reference, camera=replace(reference.camera, focal_px=head.lens.reference_focal_px / 1.02))

    def calibrate(*_: Any, **__: Any) -> CalibratedCamera:
        return CalibratedCamera(still, panorama, head)

    with (
        ThreadPoolExecutor(1) as pool,
        pytest.raises(PzcapError, match="another camera's") if blamed else contextlib.nullcontext(),
    ):
        list(calibrate_cameras(one, calibrate, pool, []))


# --------------------------------------------------------------------------------------------------------------
# A lens that focused anew


@pytest.mark.parametrize(
    ("factor", "said"), [(1.0, False), (1.00003, False), (0.99996, False), (1.0012, True), (0.999, True)]
)
def test_a_lens_that_was_moved_between_reference_and_sweep(factor: float, said: bool) -> None:
    whole = fabricated.reconstruction()
    reference, panorama, head = whole.references[0], whole.panoramas[0], whole.cameras[0]
    assert reference is not None
    assert panorama is not None
    assert head is not None
    still = replace(reference, camera=replace(reference.camera, focal_px=head.lens.reference_focal_px / factor))
    note = lens_moved("1", CalibratedCamera(still, panorama, head))
    assert (note is not None) == said
    if note:
        assert note.startswith("camera 1: the focal length of its sweep, ")
        assert note.endswith("focus or zoom have moved; set both by hand and shoot the sweep again")


@pytest.mark.parametrize(
    ("object_px", "sweep_px", "width", "said"),
    [(880.0, 880.0, 640, False), (868.1, 880.0, 640, False), (427.7, 439.0, 320, False), (877.5, 914.2, 640, True)],
)
def test_a_sweep_that_contradicts_the_object_is_doubted(
    object_px: float, sweep_px: float, width: int, said: bool
) -> None:
    """Focal lengths as they were found: right, twice at its worst, and one of a minimum that is not the right one."""
    doubt = contradiction(object_px, sweep_px, width)
    assert doubt == (pytest.approx(np.log(sweep_px / object_px)) if said else 0.0)
    right = turned(0.0)
    found = replace(right, camera=replace(right.camera, focal_sigma=float(np.hypot(1e-4, doubt))))
    note = focal_in_doubt("1", found)
    assert (note is not None) == said
    assert note is None or re.match(r"camera 1: its focal length, \d+ px by the sweep, is in doubt by 4\.1%", note)


@pytest.mark.parametrize(("off_px", "said"), [(0.05, False), (0.5, True)])
def test_an_object_of_another_shape_than_written(off_px: float, said: bool) -> None:
    right = turned(0.0)
    still = replace(right.reference, residuals_px=np.full_like(right.reference.points_px, off_px / np.sqrt(2.0)))
    note = object_of_other_shape("1", replace(right, reference=still))
    assert (note is not None) == said
    if note:
        assert "corners are 0.5 px from where object.json has them" in note


def turned(deg: float) -> CalibratedCamera:
    """A camera that is rolled in the world."""
    whole = fabricated.reconstruction()
    reference, panorama, head = whole.references[0], whole.panoramas[0], whole.cameras[0]
    assert reference is not None
    assert panorama is not None
    assert head is not None
    c, s = np.cos(np.deg2rad(deg)), np.sin(np.deg2rad(deg))
    pose = np.eye(4)
    pose[:3, :3] = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]) @ [[c, -s, 0], [s, c, 0], [0, 0, 1]]
    still = replace(reference, camera=replace(reference.camera, world_T_cam=pose))
    return CalibratedCamera(still, panorama, head)


def test_a_world_that_lies_on_its_side_is_refused() -> None:
    check_upright([turned(0.0), turned(20.0), turned(90.0), None])
    check_upright([])
    for deg in (90.0, 180.0):
        with pytest.raises(PzcapError, match=f"turned by {deg:.0f} degrees in its world, whose z axis has to point up"):
            check_upright([turned(deg), turned(deg), turned(0.0)])


# --------------------------------------------------------------------------------------------------------------
# Keyframes where nobody is


def keyframe(frame: int, place: tuple[float, float, float]) -> Keyframe:
    return Keyframe(frame, Pose(np.array(place), np.tile([1.0, 0.0, 0.0, 0.0], (16, 1))))


@pytest.fixture(scope="module")
def view() -> SeenViews:
    """One camera at the origin's side, looking along +y; the athlete covers the middle of its picture."""
    world_T_cam = np.eye(4)
    world_T_cam[:3, :3] = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    world_T_cam[:3, 3] = (0.0, -10.0, 1.0)
    camera = Camera(640, 480, world_T_cam, 800.0, np.array([319.5, 239.5]), 0.0)
    probability = np.zeros((480, 640), np.uint8)
    probability[160:330, 280:360] = 255
    outline = Silhouette(probability, np.zeros((480, 640, 3), np.uint8), np.zeros((240, 320), np.float32), True)
    return SeenViews((camera, None), (outline, None))


def seen(key: Keyframe, body: skeleton.Body, views: SeenViews) -> SeenKeyframe:
    """The keyframe judged by views that were cut out alike with and without it."""
    return seen_keyframe(key, body, views, views, MARGIN)


@pytest.mark.parametrize(
    ("place", "there"),
    [((0.0, 0.0, 0.9), True), ((0.3, 0.0, 0.9), True), ((3.0, 0.0, 0.9), False), ((0.0, -30.0, 0.9), False),
     ((300.0, 20.0, 0.9), False), ((8.0, 30.0, 0.9), False)],
)  # fmt: skip
def test_a_keyframe_stands_where_somebody_is_seen(
    place: tuple[float, float, float], there: bool, view: SeenViews, capture: Capture
) -> None:
    assert capture.subject is not None
    body = skeleton.build(capture.subject)
    keys = [keyframe(3, (0.0, 0.0, 0.9)), keyframe(7, place)]
    notes = unseen_keyframes([seen(key, body, view) for key in keys], TIMECODES)
    assert len(notes) == (not there)
    if not there:
        assert notes[0].startswith("keyframe 7 (10:00:00:07): no view shows anybody where it stands, (")


def test_where_all_are_elsewhere_the_frame_is_wrong_and_not_each(view: SeenViews, capture: Capture) -> None:
    assert capture.subject is not None
    body = skeleton.build(capture.subject)
    keys = [keyframe(3, (0.0, 300.0, 900.0)), keyframe(7, (0.0, 310.0, 900.0))]
    (note,) = unseen_keyframes([seen(key, body, view) for key in keys], TIMECODES)
    assert "not metres in the world frame that object.json sets, or object.json is wrong" in note
    blind = SeenViews((None, None), (None, None))
    assert unseen_keyframes([seen(key, body, blind) for key in keys], TIMECODES) == []


# --------------------------------------------------------------------------------------------------------------
# An object of another size


def looking(place: tuple[float, float, float], target: tuple[float, float, float]) -> Camera:
    return Camera(640, 480, facing(np.array(place), np.array(target)), 700.0, np.array([319.5, 239.5]), 0.0)


def seen_at(key: Keyframe, body: skeleton.Body, size: float) -> SeenViews:
    """Views of the body from four corners, where a calibration takes the hall for ``size`` times as large."""
    cameras, outlines = [], []
    for corner in ((-10.0, -8.0, 1.6), (10.0, -8.0, 1.7), (10.0, 8.0, 1.5), (-10.0, 8.0, 1.6)):
        camera = looking(corner, tuple(key.pose.root_position_m))
        evidence = np.full((240, 320), -4.0, np.float32)
        for column, row in np.round(project(camera, joints(body, key.pose))[0] / 2).astype(int):
            evidence[max(row - 4, 0) : row + 5, max(column - 4, 0) : column + 5] = 4.0
        outlines.append(
            Silhouette(np.full((480, 640), 255, np.uint8), np.zeros((480, 640, 3), np.uint8), evidence, True)
        )
        wrong = camera.world_T_cam.copy()
        wrong[:3, 3] *= size
        cameras.append(replace(camera, world_T_cam=wrong))
    return SeenViews(tuple(cameras), tuple(outlines))


@pytest.mark.parametrize(
    ("size", "kind"), [(1.0, ""), (1.01, ""), (1.1, "smaller"), (0.9, "larger"), (1.25, "smaller")]
)
def test_an_object_of_another_size_is_blamed(size: float, kind: str, capture: Capture) -> None:
    """A hall that is taken for too large has an object that is smaller than is written."""
    assert capture.subject is not None
    body = skeleton.build(capture.subject)
    keys = [keyframe(3, (3.0, 1.0, 0.9)), keyframe(7, (-2.0, -3.0, 0.9)), keyframe(9, (1.0, 3.5, 0.9))]
    note = object_of_another_size([seen(key, body, seen_at(key, body, size)) for key in keys])
    assert (note is not None) == bool(kind)
    assert blames_object([note or ""]) == bool(kind)
    if note is not None:
        found = re.search(r"% (smaller|larger) than it says: with every length in it times ([0-9.]+),", note)
        assert found is not None
        assert found[1] == kind
        assert float(found[2]) == pytest.approx(1.0 / size, abs=0.02)


def test_keyframes_that_are_wrong_themselves_do_not_blame_the_object(capture: Capture) -> None:
    assert capture.subject is not None
    body = skeleton.build(capture.subject)
    right = [keyframe(3, (3.0, 1.0, 0.9)), keyframe(7, (-2.0, -3.0, 0.9)), keyframe(9, (1.0, 3.5, 0.9))]
    moved = [keyframe(3, (3.3, 1.5, 0.9)), keyframe(7, (-2.4, -2.6, 0.9)), keyframe(9, (1.6, 3.5, 0.9))]
    wrong = [seen(key, body, seen_at(true, body, 1.0)) for key, true in zip(moved, right, strict=True)]
    assert object_of_another_size(wrong) is None
    assert object_of_another_size([seen(right[0], body, seen_at(right[0], body, 1.1))]) is None


def test_a_body_that_is_expected_elsewhere_hides_no_object_of_another_size(capture: Capture) -> None:
    """A tracker that follows wrong keyframes cuts out what it expects there."""
    assert capture.subject is not None
    body = skeleton.build(capture.subject)
    keys = (keyframe(3, (3.0, 1.0, 0.9)), keyframe(7, (-2.0, -3.0, 0.9)))
    judged = [seen_keyframe(key, body, seen_at(key, body, 1.0), seen_at(key, body, 1.1), MARGIN) for key in keys]
    found = papers_against_views(body, judged, TIMECODES)
    assert blames_object(found.notes)
    assert found.misplaced


def test_where_a_keyframe_is_wrong_no_camera_is_said_to_have_lost_frames(view: SeenViews, capture: Capture) -> None:
    assert capture.subject is not None
    body = skeleton.build(capture.subject)
    found = papers_against_views(body, [seen(keyframe(3, (0.0, 300.0, 900.0)), body, view)], TIMECODES)
    assert "no view shows anybody where it stands" in found.notes[0]
    assert found.misplaced


# --------------------------------------------------------------------------------------------------------------
# A body that may be lost


def test_stretches_in_which_the_body_may_be_lost_are_named() -> None:
    sure = dict.fromkeys(range(30), 0.01)
    assert lost_body(sure | {4: 0.9, 5: 0.9}, TIMECODES) == []  # two frames: an odd light
    (one,) = lost_body(sure | dict.fromkeys(range(7, 12), 0.8), TIMECODES)
    assert "in 5 frames: 7 to 11 (10:00:00:07 to 10:00:00:11); " in one
    (three,) = lost_body(sure | dict.fromkeys([0, 1, 2, 7, 8, 9, 10, 20, 21, 22], 0.8), TIMECODES)
    assert "in 10 frames: 7 to 10 (10:00:00:07 to 10:00:00:10) and 2 more stretches; " in three


# --------------------------------------------------------------------------------------------------------------
# Somebody else at the athlete's side


def outline(gap_px: int | None) -> Silhouette:
    """An athlete 120 px tall, and as tall a person so far to the right; None: alone."""
    probability, others = np.zeros((240, 320), np.uint8), np.zeros((120, 160), np.uint8)
    probability[60:180, 100:140] = 255
    if gap_px is not None:
        others[30:90, (140 + gap_px) // 2 : (180 + gap_px) // 2] = 1
    return Silhouette(probability, np.zeros((240, 320, 3), np.uint8), np.zeros((120, 160), np.float32), True, others)


@pytest.mark.parametrize(
    ("gaps_px", "touched"),
    [
        ([0, 0, 0, None], True),
        ([0, 2, 60, 0], True),
        ([0, 0, None, None], False),  # one stands before the athlete, or behind
        ([40, 40, 40, 40], False),
        ([None] * 4, False),
        ([0, 0], True),
        ([0, None], False),
    ],
)
def test_somebody_at_the_athletes_side_touches_in_most_views(gaps_px: list[int | None], touched: bool) -> None:
    views = [outline(gap) for gap in gaps_px]
    assert is_touched(views) == touched
    assert is_touched([*views, None, replace(outline(0), valid=False)]) == touched  # lost views say nothing


def test_footage_that_nobody_was_told_from_the_athlete_in_has_no_company() -> None:
    unknown = replace(outline(0), others=np.zeros((0, 0), np.uint8))
    assert not is_touched([unknown] * 4)


def test_stretches_with_somebody_at_the_athletes_side_are_named() -> None:
    assert company([3, 4, 9], TIMECODES) == []
    (one,) = company([3, 4, 7, 8, 9, 10], TIMECODES)
    assert "in 4 frames: 7 to 10 (10:00:00:07 to 10:00:00:10): a hand or a foot" in one


def test_a_camera_that_is_blind_for_long_is_named() -> None:
    valid, timecodes = np.ones(60, bool), [f"10:00:00:{frame:02}" for frame in range(60)]
    valid[40:46] = False
    assert unlocated("b", valid, timecodes) == []
    valid[50] = False
    (note,) = unlocated("b", valid, timecodes)
    assert "camera b: not located in 7 of 60 frames from 40 (10:00:00:40) to 50 (10:00:00:50)" in note
