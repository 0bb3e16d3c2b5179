"""The paper's figures: areas against hand-computed ones, and every figure drawn from next to nothing."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import matplotlib as mpl
import numpy as np
import pytest
from rerun.chunk import RrdReader

from experiments.footage import SMALL
from experiments.paper_figures import __main__ as command
from experiments.paper_figures import calibration, common_field, field, novel_view, page, panoramas, skeletons, zooming
from experiments.paper_figures.canvas import STYLE, Drawn
from experiments.paper_figures.field import FEET, Standing, common_height_px, floor_between, height_px, zoom_range
from experiments.paper_figures.material import Run, load
from pzcap.body import skeleton as body_model
from pzcap.geometry import camera as geometry
from pzcap.geometry.lens import at as lens_at
from pzcap.types import Array, Lens, Localisation, PanZoomCamera, Pose, PzcapError, Subject
from sim.hall.gym import calibration_object
from sim.people.anthropometry import draw_measurements
from sim.restage import Hall
from tests.scenes import fabricated
from tests.scenes.fabricated_truth import truth_of

SIDE_M, EYE_M, WIDTH, HEIGHT, FOCAL_PX = 20.0, 1.0, 320, 240, 440.0
LINE = Standing(1.75, 0.0)
SUBJECT = Subject(draw_measurements(np.random.default_rng(3)), 0.01)


def square() -> list[PanZoomCamera]:
    """Level cameras without distortion in the corners of a square, each looking along the diagonal."""
    principal = np.array([[(WIDTH - 1) / 2, (HEIGHT - 1) / 2]])
    cameras = []
    for k in range(4):
        angle = np.pi / 4 + k * np.pi / 2
        head = np.eye(4)
        head[:3, :3] = fabricated.rotation_z(angle + np.pi)
        head[:3, 3] = *(SIDE_M / np.sqrt(2) * np.array([np.cos(angle), np.sin(angle)])), EYE_M
        cameras.append(PanZoomCamera(Lens(WIDTH, HEIGHT, FOCAL_PX, principal, np.zeros(1)), head, 0.0, 0.0))
    return cameras


@pytest.fixture(scope="module")
def run() -> Run:
    """A fabricated run, its frames and reference images painted at random, and the truth that it has hit."""
    whole = dataclasses.replace(fabricated.reconstruction())
    rng = np.random.default_rng(1)
    images = tuple(rng.integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8) for _ in whole.camera_names)
    return Run(
        whole, calibration_object(), SUBJECT, images, lambda frame: (None, *images[1:]) if frame == 3 else images,
        truth_of(whole), np.arange(len(whole.timecodes)),
    )  # fmt: skip


@pytest.fixture(scope="module")
def shot(run: Run) -> calibration.Shot:
    one = run.located()[0]
    camera = geometry.at(one.camera, -0.05, one.camera.tilt_rad, 1.5 * FOCAL_PX)
    points = np.random.default_rng(2).uniform(20.0, 200.0, (30, 2))
    found = Localisation(-0.05, one.camera.tilt_rad, 1.5 * FOCAL_PX, np.eye(2), True, points, points + 500.0)
    image = run.references[0]
    assert image is not None
    return calibration.Shot(one, image, found, camera, camera, "nothing is seen")


# --------------------------------------------------------------------------------------------------------------


def test_the_area_of_pan_cameras_is_the_square_less_four_quarter_discs() -> None:
    """Feet leave the picture nearer than focal length x height of the eye / half the image."""
    cameras = square()
    floor = floor_between(cameras, 0.05)
    tall = common_height_px(cameras, floor, LINE, "pan", np.array([FOCAL_PX]))
    near = FOCAL_PX * EYE_M / (HEIGHT / 2)
    assert floor.area_m2(floor.inside) == pytest.approx(SIDE_M**2, rel=0.01)
    assert floor.area_m2(tall >= 0) == pytest.approx(SIDE_M**2 - np.pi * near**2, rel=0.005)


def test_zooming_out_shrinks_the_discs() -> None:
    cameras = square()
    floor = floor_between(cameras, 0.05)
    tall = common_height_px(cameras, floor, LINE, "pan-zoom", np.array([FOCAL_PX / 2, FOCAL_PX]))
    near = FOCAL_PX / 2 * EYE_M / (HEIGHT / 2)
    assert floor.area_m2(tall >= 0) == pytest.approx(SIDE_M**2 - np.pi * near**2, rel=0.005)


def test_a_fixed_camera_sees_its_wedge() -> None:
    """Of the square, what lies within the angle of view and beyond the depth at which feet leave the picture."""
    cameras = square()
    floor = floor_between(cameras, 0.05)
    tall = height_px(cameras[0], floor.points_m, LINE, "fixed", np.array([FOCAL_PX]))
    half = np.arctan(WIDTH / 2 / FOCAL_PX)
    near = FOCAL_PX * EYE_M / (HEIGHT / 2)
    expected = SIDE_M**2 * (1 - np.tan(np.pi / 4 - half)) - near**2 * np.tan(half)
    assert floor.area_m2(tall >= 0) == pytest.approx(expected, rel=0.005)


def test_the_longest_focal_length_that_fits_is_taken() -> None:
    camera = square()[0]
    there = camera.world_T_head[:2, 3] + 10.0 * camera.world_T_head[:2, 0]
    focals = np.array([0.5, 1.0, 2.0, 4.0]) * FOCAL_PX
    # of 10 m, the eye 1 m above the floor: 4 x 440 px would put feet 176 px below the middle, and there are 120
    seen = [height_px(camera, there[None], LINE, freedom, focals)[0] for freedom in ("fixed", "pan", "pan-zoom")]
    np.testing.assert_allclose(seen, [FOCAL_PX * 1.75 / 10, FOCAL_PX * 1.75 / 10, 2 * FOCAL_PX * 1.75 / 10])
    assert height_px(camera, there[None], FEET, "fixed", focals)[0] == 0.0


def test_two_cameras_enclose_no_floor() -> None:
    with pytest.raises(PzcapError, match="three cameras"):
        floor_between(square()[:2], 1.0)


def test_the_zoom_range_is_what_the_tracks_show() -> None:
    focals = zoom_range([np.array([300.0, 500.0]), np.array([900.0])], 440.0)
    assert (focals[0], focals[-1]) == pytest.approx((300.0, 900.0))
    assert np.all(np.diff(np.log(focals)) <= field.ZOOM_STEP)


# --------------------------------------------------------------------------------------------------------------


def is_drawn(drawn: Drawn, folder: Path) -> None:
    image = cv2.imread(str(folder / f"{drawn.stem}.png"))
    assert image is not None
    assert image.std() > 5
    assert (folder / f"{drawn.stem}.svg").read_text().startswith("<?xml")
    assert len(drawn.caption) > 80


@pytest.mark.slow
def test_every_figure_is_drawn_from_a_small_run(
    run: Run, shot: calibration.Shot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All but what the simulator adds, which a fabricated run has none of."""
    monkeypatch.setattr(calibration, "shoot_again", lambda _: shot)
    monkeypatch.setattr(skeletons, "_portraits", lambda *_: None)
    monkeypatch.setattr(skeletons, "NOVEL_PX", (60, 66))
    drawn = command.make(run, run, tmp_path, "a command", lambda _: None)
    assert [one.number for one in drawn] == [1, 4, 5, 8, 9, 10, 11, 12, 13]
    text = (tmp_path / page.PAGE).read_text()
    for one in drawn:
        is_drawn(one, tmp_path)
        assert f'src="{one.stem}.png"' in text
        assert f'href="{one.stem}.svg"' in text
    chunks = RrdReader(tmp_path / page.RECORDING).store().stream().to_chunks()
    paths = {str(chunk.entity_path) for chunk in chunks}
    for one in drawn:
        assert f"/figures/{one.stem}/image" in paths


def test_without_a_truth_and_a_camera_figures_are_drawn_all_the_same(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(skeletons, "NOVEL_PX", (60, 66))
    whole = dataclasses.replace(fabricated.without_a_camera(run.reconstruction), motion=run.reconstruction.motion)
    lacking = dataclasses.replace(run, reconstruction=whole, truth=None, truth_frames=None)
    drawing = (
        panoramas.panoramas, panoramas.located_frames, zooming.focal_lengths, zooming.fixed_focus, zooming.top_view,
        skeletons.skeletons,
    )  # fmt: skip
    with mpl.rc_context(STYLE):
        for draw in drawing:
            drawn = draw(lacking)
            page.save(drawn, tmp_path)
            is_drawn(drawn, tmp_path)


def test_what_the_captions_say_of_a_perfect_run(run: Run) -> None:
    with mpl.rc_context(STYLE):
        assert "by more than 0.000 %" in zooming.focal_lengths(run).caption
        said = common_field.common_field([run], 0.2).caption
    estimated, true = said.split("true cameras (")[1].split(" m²")[0].split(" for ")
    assert float(estimated) == pytest.approx(float(true), rel=0.02)


def test_a_frame_that_is_not_found_is_no_figure(run: Run) -> None:
    """Random panoramas and frames have nothing in common."""
    with pytest.raises(PzcapError, match="not found after pan and zoom"):
        calibration.shoot_again(dataclasses.replace(run, truth=None, truth_frames=None))


def test_without_a_motion_its_figures_say_so(run: Run) -> None:
    still = dataclasses.replace(run, reconstruction=dataclasses.replace(run.reconstruction, motion=None))
    for draw in (skeletons.skeletons, zooming.top_view, zooming.fixed_focus):
        with pytest.raises(PzcapError, match="track"):
            draw(still)


def test_a_missing_run_says_how_to_make_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(PzcapError, match=r"python -m experiments\.run experiment=pedestrian"):
        load(tmp_path / "none", "experiment=pedestrian")
    assert command.main([str(tmp_path / "none"), "--folder", str(tmp_path / "out")]) == 1
    assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "out").exists()


# --------------------------------------------------------------------------------------------------------------


def test_eq_17_moves_points_towards_the_principal_point(run: Run) -> None:
    """A bright dot of the variable focus image is found where eq. 17 puts it."""
    one = run.located()[1]
    reference = one.camera.lens.reference_focal_px
    for ratio in (0.8, 1.25):
        focal = reference / ratio
        image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
        image[150:153, 200:203] = 255
        fixed = zooming.at_fixed_focus(image, one, 0.0, one.camera.tilt_rad, focal).astype(float)
        here, there = (lens_at(one.camera.lens, f)[0] for f in (focal, reference))
        expected = there + ratio * (np.array([201.0, 151.0]) - here)
        x, y = expected.round().astype(int)
        patch = fixed[y - 5 : y + 6, x - 5 : x + 6, 0]
        rows, columns = np.mgrid[y - 5 : y + 6, x - 5 : x + 6]
        found = np.array([np.sum(columns * patch), np.sum(rows * patch)]) / patch.sum()
        np.testing.assert_allclose(found, expected, atol=0.15)


def test_the_novel_view_wears_what_the_cameras_saw(run: Run) -> None:
    """All cameras see plain green: so is the athlete, where any camera sees them."""
    green = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    green[:] = (0, 200, 0)
    painted = dataclasses.replace(run, views=lambda _: (green,) * 4)
    motion = run.reconstruction.motion
    assert motion is not None
    view = novel_view.virtual_camera(run, motion.joints_m[4, 0], 120, 132)
    picture = novel_view.render(painted, body_model.build(SUBJECT), 4, view).astype(int)
    chest = geometry.project(view, motion.joints_m[4, 1:2])[0][0].round().astype(int)
    np.testing.assert_allclose(picture[chest[1], chest[0]], [0, 200, 0], atol=12)


def test_the_athlete_is_portrayed_where_they_stand(run: Run) -> None:
    motion = run.reconstruction.motion
    assert motion is not None
    view = novel_view.virtual_camera(run, motion.joints_m[4, 0], 120, 132)
    with Hall(SMALL) as hall:
        first, second = (hall.portray(view, Pose(motion.root_position_m[f], motion.rotations[f])) for f in (4, 7))
    changed = np.abs(first.astype(int) - second).max(axis=2) > 30
    for frame in (4, 7):
        x, y = geometry.project(view, motion.joints_m[frame, :1])[0][0].round().astype(int)
        assert changed[y - 3 : y + 4, x - 3 : x + 4].mean() > 0.5


def test_the_object_is_photographed_where_the_true_camera_sees_it() -> None:
    with Hall(SMALL) as hall:
        focal = 1.3 * SMALL.width * SMALL.optics.reference_focal
        image, camera = hall.photograph_object(0, -0.05, focal), hall.camera(0, -0.05, focal)
    target = calibration_object()
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, target.dictionary)))
    corners, ids, _ = detector.detectMarkers(cv2.resize(image, None, fx=3, fy=3, interpolation=cv2.INTER_CUBIC))
    assert ids is not None
    known: dict[int, Array] = {marker.id: marker.corners_m for marker in target.markers}
    for number, found in zip(ids.ravel(), corners, strict=True):
        expected = geometry.project(camera, known[int(number)])[0]
        np.testing.assert_allclose((found[0] + 0.5) / 3 - 0.5, expected, atol=1.0)
