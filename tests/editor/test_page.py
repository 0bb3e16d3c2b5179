"""The page as a person uses it, in headless Chromium, against the command as it is typed."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from pzcap.body import skeleton
from pzcap.body.kinematics import forward, joints, world_points
from pzcap.command.places import link_capture
from pzcap.editor.inverse_kinematics import HANDLES, SEGMENT, handle_points
from pzcap.extras.reconstruct import Config, reconstruct
from pzcap.io import results
from pzcap.io.capture import frame_sets, read_capture
from pzcap.types import Array, Pose
from sim import truth as truths
from tests.scenes import edited
from tests.scenes.browsing import Hand, Serving, chromium
from tests.scenes.captures import project

WRIST = HANDLES.index("left_wrist")


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """Results that tell which capture they are of."""
    folder = tmp_path / "results"
    results.save(edited.found(tracked=True), folder / "reconstruction")
    link_capture(folder, edited.capture(tmp_path / "take"))
    return folder


def test_dragged_seen_in_two_tabs_undone_killed_and_nothing_lost(place: Path, tmp_path: Path) -> None:
    keyframes = tmp_path / "take" / "keyframes.json"
    with chromium() as browser:
        editing = Serving("edit", place)
        hand = Hand(browser, editing.address)
        other = hand.second_tab()
        x, y = edited.true_pixels(0, 1)[WRIST]
        hand.drag(WRIST, 1, x, y)
        assert hand.shown["handles"][1][WRIST] == pytest.approx([x, y], abs=1.0)
        assert [entry["timecode"] for entry in json.loads(keyframes.read_text())] == ["01:00:00:00"]
        other.until("editor.state().shown.clicks.length === 1")
        other.page.keyboard.press("u")
        hand.until("editor.state().overview.keys.length === 0")
        assert not keyframes.exists()
        hand.page.keyboard.press("Control+y")
        hand.until("editor.state().overview.keys.length === 1")
        hand.page.keyboard.press("ArrowRight")
        hand.until("editor.state().frame === 1 && editor.ready()")
        hand.page.keyboard.press("k")
        hand.until("editor.state().overview.keys.length === 2")
        saved, before = keyframes.read_bytes(), hand.shown
        editing.kill()
        hand.until("editor.state().message.includes('Nothing is lost')")
        hand.page.keyboard.press("ArrowLeft")  # to look further does not cover what is said
        assert hand.page.evaluate("() => editor.state().message.startsWith('The server has ended')")
        hand.page.keyboard.press("k")
        assert hand.page.evaluate("() => editor.state().message.startsWith('Nothing was changed now.')")

        editing = Serving("edit", place)
        assert keyframes.read_bytes() == saved
        again = Hand(browser, editing.address)
        again.until("editor.state().overview.keys.length === 2")
        again.go(1)
        assert again.shown["handles"] == before["handles"]
        again.page.keyboard.press("u")
        again.until("editor.state().overview.keys.length === 1")
        again.page.mouse.click(*again.place_of(WRIST, 2))
        again.page.mouse.wheel(0, -900)
        zoomed = again.place_of(WRIST, 2)
        again.page.keyboard.press("ArrowRight")
        again.until("editor.state().frame === 2 && editor.ready()")
        assert again.place_of(WRIST, 2) == pytest.approx(zoomed, abs=2.0)  # it stays in sight
        again.page.mouse.click(zoomed[0] + 30.0, zoomed[1], button="right")
        again.until("editor.state().shown.clicks.length === 1")
        assert again.place_of(WRIST, 2) == pytest.approx((zoomed[0] + 30.0, zoomed[1]), abs=4.0)
        again.page.keyboard.press("0")
        again.until("editor.pictures().every(one => one)")
        picture = np.frombuffer(again.page.screenshot(), np.uint8)
        image = cv2.imdecode(picture, cv2.IMREAD_COLOR)
        assert image is not None
        assert image.shape == (900, 1500, 3)
        assert 0.1 < np.mean(np.abs(image[:, :1200].astype(int) - 94).max(axis=2) < 12) < 0.95  # the grey pictures
        assert not hand.faults + again.faults
        assert editing.end() == 0


def true_handles(truth: truths.Truth, frame: int, body: skeleton.Body) -> Array:
    """(23, 3) joints as they are, the ends as they are on the measured body."""
    frames = forward(body, Pose(truth.root_position_m[frame], truth.rotations[frame]))
    world = world_points(frames, SEGMENT, handle_points(body))
    world[:16] = truth.joints_m[frame]
    return world


@pytest.mark.heavy
def test_from_no_keyframes_to_five_by_dragging_alone(small_capture: Path, tmp_path: Path) -> None:
    """To the true projections with 1 px of noise, which is 2 px at the usual size; then the body is tracked as from
    keyframes set by hand."""
    folder, truth = tmp_path / "take", truths.load(small_capture / "truth")
    folder.mkdir()
    for file in (small_capture / "capture").iterdir():
        if file.name not in ("capture.json", "keyframes.json"):
            (folder / file.name).symlink_to(file.resolve())
    content = json.loads((small_capture / "capture" / "capture.json").read_text())
    (folder / "capture.json").write_text(json.dumps(content | {"keyframes": None}))
    body = skeleton.build(read_capture(folder).subject)  # type: ignore[arg-type]
    rng, frames = np.random.default_rng(0), (0, 7, 3, 5, 1)
    with chromium() as browser, Serving("edit", folder, start_s=600.0) as editing:
        hand = Hand(browser, editing.address)
        for frame in frames:
            hand.go(frame)
            hand.page.keyboard.press("f")
            world = true_handles(truth, frame, body)
            for handle in range(len(HANDLES)):
                for camera in (handle % 4, (handle + 1) % 4):
                    x, y = project(truth.camera(camera, frame), world)[handle] + rng.normal(0.0, 1.0, 2)
                    hand.drag(handle, camera, x, y)
            assert hand.shown["is_key"]
        hand.page.keyboard.press("r")
        hand.until("editor.state().overview.difference", 300.0)
        assert not hand.faults
        assert editing.end() == 0
    keys = frame_sets(read_capture(folder)).keyframes
    assert [key.frame for key in keys] == sorted(frames)
    off = [np.linalg.norm(joints(body, key.pose) - truth.joints_m[key.frame], axis=1) for key in keys]
    assert np.mean(off) < 0.04  # a pixel is 25 mm here
    cameras = results.load(folder / "editing" / "reconstruction")
    errors = []
    for capture in (folder, small_capture / "capture"):
        motion = reconstruct(read_capture(capture), Config(), cameras=cameras).motion
        assert motion is not None
        assert motion.valid.all()
        errors.append(float(np.linalg.norm(motion.joints_m - truth.joints_m, axis=2).mean()))
    assert errors[0] < errors[1] + 0.02
