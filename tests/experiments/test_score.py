"""The score is an instrument: a known error has to be read off it, and no other."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.metrics import format_value, meets_target, read_metrics, run_info, write_metrics
from experiments.report import plots
from experiments.score import Score, score
from experiments.silhouette_score import ForegroundScorer, iou, outline_distance
from experiments.totals import metrics
from pzcap.geometry import camera as geometry
from pzcap.scoring.metric import Metric
from pzcap.scoring.projection import project
from pzcap.scoring.records import CameraPoses
from pzcap.types import Camera, PzcapError, Reconstruction
from sim.truth import Truth
from tests.scenes import fabricated
from tests.scenes.fabricated_truth import HEIGHT, WIDTH, body_mask, shadow_mask, truth_of

F = 12


@pytest.fixture(scope="module")
def whole() -> Reconstruction:
    return fabricated.reconstruction(frames=F)


@pytest.fixture(scope="module")
def truth(whole: Reconstruction) -> Truth:
    return truth_of(whole)


def values(result: Score) -> dict[str, float | None]:
    return {metric.key: metric.value for metric in metrics(result)}


def change(whole: Reconstruction, field: str, number: int, **values: Any) -> Reconstruction:
    parts = list(getattr(whole, field))
    parts[number] = dataclasses.replace(parts[number], **values)
    return dataclasses.replace(whole, **{field: tuple(parts)})


def test_a_perfect_reconstruction_scores_zero(whole: Reconstruction, truth: Truth) -> None:
    found = values(score(whole, truth, None))
    for key in ("panzoom.pan.rms", "panzoom.pan.max", "panzoom.focal.max", "panorama.pan.rms", "body.mpjpe.max",
                "reference.position.max", "panzoom.lost", "body.lost", "panzoom.nees"):  # fmt: skip
        assert found[key] == pytest.approx(0.0, abs=1e-9), key
    assert found["panzoom.reprojection.rms"] == pytest.approx(0.0, abs=1e-6)
    assert found["body.keyframes"] == 2


def test_cameras_that_the_body_has_corrected_are_scored_beside_those_of_the_background(
    whole: Reconstruction, truth: Truth
) -> None:
    track = whole.tracks[0]
    assert track is not None
    off = change(whole, "refined", 0, pan_rad=track.pan_rad + np.deg2rad(0.02), focal_px=1.01 * track.focal_px)
    found = values(score(off, truth, None))
    share = np.sqrt(1.0 / len(whole.tracks))  # one camera's, in a mean of squares
    assert found["panzoom.refined.pan.rms"] == pytest.approx(0.02 * share)
    assert found["panzoom.refined.focal.rms"] == pytest.approx(1.0 * share)
    assert found["panzoom.pan.rms"] == pytest.approx(0.0, abs=1e-9)
    nobody = dataclasses.replace(whole, motion=None, refined=(None,) * len(whole.tracks))
    assert values(score(nobody, truth, None))["panzoom.refined.pan.rms"] is None


def test_read_outs_and_clocks_are_scored_but_for_what_all_clocks_share(whole: Reconstruction, truth: Truth) -> None:
    off, heads = whole, whole.cameras
    for number, (clock_s, readout_s) in enumerate([(0.003, 0.002), (0.001, 0.0), (0.001, 0.0), (0.003, 0.0)]):
        head = heads[number]
        assert head is not None
        off = change(off, "cameras", number, clock_s=clock_s, readout_s=readout_s)
    found = values(score(off, truth, None))
    assert found["cameras.readout.rms"] == pytest.approx(1.0)
    assert found["cameras.clock.rms"] == pytest.approx(1.0)
    late = dataclasses.replace(truth, clock_offset_s=truth.clock_offset_s + np.array([0.002, 0.0, 0.0, 0.002]))
    assert values(score(off, late, None))["cameras.clock.rms"] == pytest.approx(0.0, abs=1e-9)
    nobody = dataclasses.replace(whole, motion=None, refined=(None,) * len(whole.tracks))
    assert values(score(nobody, truth, None))["cameras.clock.rms"] is None


def test_every_metric_of_the_list_is_there(whole: Reconstruction, truth: Truth) -> None:
    found = values(score(whole, truth, None))
    assert set(found) == {
        "reference.reprojection.rms", "reference.position.max", "panorama.pan.rms",
        "panzoom.pan.rms", "panzoom.pan.median", "panzoom.pan.p95", "panzoom.pan.max",
        "panzoom.focal.rms", "panzoom.focal.median", "panzoom.focal.p95", "panzoom.focal.max",
        "panzoom.refined.pan.rms", "panzoom.refined.focal.rms",
        "panzoom.reprojection.rms", "panzoom.reprojection.mean", "panzoom.reprojection.p95",
        "panzoom.jac5", "panzoom.jac10", "panzoom.jac20", "panzoom.rotation.rms", "panzoom.position.rms",
        "panzoom.position.similarity", "body.size.similarity",
        "panzoom.rotation.common.median", "panzoom.rotation.common.rms",
        "panzoom.completeness", "body.completeness", "panzoom.lost",
        "panzoom.bound_ratio.pan", "panzoom.bound_ratio.focal", "panzoom.nees",
        "cameras.readout.rms", "cameras.clock.rms", "foreground.iou", "foreground.outline", "foreground.shadow",
        "body.mpjpe.mean", "body.mpjpe.p95", "body.mpjpe.max", "body.mpjpe.inverted", "body.mpjpe.airborne",
        "body.mpjpe.similarity", "body.mpjpe.true_cameras", "body.covered", "body.beyond3",
        "body.limb.rms", "body.limb.max", "body.keyframes", "body.lost",
    }  # fmt: skip
    assert found["foreground.iou"] is None  # no silhouette came


def test_a_known_pan_and_zoom_error_is_read_off(whole: Reconstruction, truth: Truth) -> None:
    track = whole.tracks[2]
    assert track is not None
    off = change(whole, "tracks", 2, pan_rad=track.pan_rad + np.deg2rad(0.2), focal_px=track.focal_px * 1.01)
    found = values(score(off, truth, None))
    assert found["panzoom.pan.max"] == pytest.approx(0.2)
    assert found["panzoom.pan.rms"] == pytest.approx(0.1)  # one camera of four; no offset is removed
    assert found["panzoom.focal.rms"] == pytest.approx(0.5)
    # (0.2 deg / 1e-4)^2 and (log 1.01 / 1e-3)^2, halved, over four cameras
    expected = (np.deg2rad(0.2) ** 2 / 1e-8 + np.log(1.01) ** 2 / 1e-6) / 2 / 4
    assert found["panzoom.nees"] == pytest.approx(expected)
    # in the middle of the image 0.2 deg are focal * tan(0.2 deg) = 1.5 to 2.3 px; one camera in four
    assert 0.7 < (found["panzoom.reprojection.rms"] or 0.0) < 2.6


def test_the_error_is_held_against_the_bound_of_the_same_frames(whole: Reconstruction, truth: Truth) -> None:
    perfect = score(whole, truth, None)
    for errors in perfect.cameras:
        assert errors.pan_bound_rad is not None
        assert errors.pan_bound_rad.valid.all()
    bounds = [(e.pan_bound_rad, e.focal_bound) for e in perfect.cameras]
    off = whole
    for number, (pan, focal) in enumerate(bounds):
        track = whole.tracks[number]
        assert track is not None
        assert pan is not None
        assert focal is not None
        sign = np.where(np.arange(F) % 2, 1.0, -1.0)
        off = change(
            off, "tracks", number, pan_rad=track.pan_rad + 3.0 * sign * pan.values,
            focal_px=track.focal_px * (1.0 - 5.0 * sign * focal.values), valid=np.arange(F) != number,
        )  # fmt: skip
    found = values(score(off, truth, None))
    assert found["panzoom.bound_ratio.pan"] == pytest.approx(3.0)
    assert found["panzoom.bound_ratio.focal"] == pytest.approx(5.0)


def test_errors_in_units_of_their_covariance_are_uncorrelated(whole: Reconstruction, truth: Truth) -> None:
    """Errors drawn from a covariance with a correlation of 0.9 come out as if drawn from a unit matrix."""
    track = whole.tracks[0]
    assert track is not None
    covariance = np.array([[1e-8, 0.9e-7], [0.9e-7, 1e-6]])
    drawn = np.random.default_rng(0).multivariate_normal(np.zeros(2), covariance, F)
    off = change(
        whole, "tracks", 0, pan_rad=track.pan_rad + drawn[:, 0], focal_px=track.focal_px * np.exp(drawn[:, 1]),
        covariance=np.tile(covariance, (F, 1, 1)),
    )  # fmt: skip
    errors = score(off, truth, None).cameras[0]
    assert errors.normalised is not None
    assert errors.nees is not None
    np.testing.assert_allclose(
        errors.nees.values, np.einsum("fi,ij,fj->f", drawn, np.linalg.inv(covariance), drawn) / 2
    )
    assert abs(np.mean(np.prod(errors.normalised, axis=1))) < 0.6


def test_the_papers_panorama_has_no_bound(whole: Reconstruction, truth: Truth) -> None:
    found = values(score(dataclasses.replace(whole, method="paper"), truth, None))
    assert found["panzoom.bound_ratio.pan"] is None


def test_a_pan_over_the_back_is_not_a_turn_off(whole: Reconstruction, truth: Truth) -> None:
    track = whole.tracks[0]
    assert track is not None
    off = change(whole, "tracks", 0, pan_rad=track.pan_rad + 2 * np.pi)
    assert values(score(off, truth, None))["panzoom.pan.max"] == pytest.approx(0.0, abs=1e-9)


def test_the_sweep_is_scored_without_its_common_offset(whole: Reconstruction, truth: Truth) -> None:
    panorama = whole.panoramas[1]
    assert panorama is not None
    wave = np.deg2rad(0.1) * np.sin(np.arange(30) / 30 * 4 * np.pi)
    off = change(whole, "panoramas", 1, sweep_pan_rad=panorama.sweep_pan_rad + 1.0 + wave)
    expected = 0.1 / np.sqrt(2) / 2
    assert values(score(off, truth, None))["panorama.pan.rms"] == pytest.approx(expected, rel=1e-3)


def test_a_sweep_of_which_frames_were_left_out_is_scored_by_those_that_were_used(
    whole: Reconstruction, truth: Truth
) -> None:
    panorama = whole.panoramas[1]
    assert panorama is not None
    wave = np.deg2rad(0.1) * np.tile([1.0, -1.0], 5)
    off = change(whole, "panoramas", 1, sweep_pan_rad=panorama.sweep_pan_rad[::3] + wave)
    others = [len(one.sweep_pan_rad) for number, one in enumerate(whole.panoramas) if number != 1 and one is not None]
    expected = 0.1 * np.sqrt(len(wave) / (len(wave) + sum(others)))
    assert values(score(off, truth, None))["panorama.pan.rms"] == pytest.approx(expected, rel=1e-3)


def test_lost_counts_recorded_views_only(whole: Reconstruction, truth: Truth) -> None:
    track = whole.tracks[0]
    assert track is not None
    off = change(whole, "tracks", 0, valid=np.arange(F) >= 3, focal_px=np.where(np.arange(F) >= 3, track.focal_px, 0.0))
    recorded = np.ones((4, F), bool)
    recorded[0, :2] = False
    found = values(score(off, dataclasses.replace(truth, recorded=recorded), None))
    assert found["panzoom.lost"] == 1
    assert found["panzoom.focal.max"] == pytest.approx(0.0, abs=1e-9)


def test_joint_errors_leave_keyframes_out(whole: Reconstruction, truth: Truth) -> None:
    motion = whole.motion
    assert motion is not None
    joints = motion.joints_m.copy()
    joints[0] += 1.0  # a keyframe: not scored, but lost
    joints[3, 4] += [0.0, 0.03, 0.04]
    joints[5, :, 2] += 0.01
    off = dataclasses.replace(whole, motion=dataclasses.replace(motion, joints_m=joints))
    found = values(score(off, truth, None))
    assert found["body.mpjpe.max"] == pytest.approx(50.0)
    assert found["body.mpjpe.mean"] == pytest.approx((50.0 + 16 * 10.0) / 160)
    assert found["body.mpjpe.airborne"] == pytest.approx(10.0)
    assert found["body.mpjpe.inverted"] is None
    assert found["body.lost"] == 1


def test_covered_is_the_share_of_joints_within_their_claimed_sigma(whole: Reconstruction, truth: Truth) -> None:
    motion = whole.motion
    assert motion is not None
    sigma = np.full(motion.sigma_m.shape, 0.012)
    sigma[:, 4:] = 0.008
    sigma[motion.keyframes] = 1.0  # not scored
    off = dataclasses.replace(motion, joints_m=motion.joints_m + np.array([0.0, 0.0, 0.01]), sigma_m=sigma)
    assert values(score(dataclasses.replace(whole, motion=off), truth, None))["body.covered"] == pytest.approx(25.0)


def test_frame_sets_beyond_the_truth_are_not_scored(whole: Reconstruction, truth: Truth) -> None:
    """As when the camera that started last was not brought: three frame sets more at the start."""
    later = dataclasses.replace(
        whole, timecodes=("00:59:59:27", "00:59:59:28", "00:59:59:29", *truth.timecodes[: F - 3])
    )
    result = score(later, truth, None)
    assert result.truth_frames.tolist() == [0, 0, 0, *range(F - 3)]
    for errors in result.cameras:
        assert errors.pan_rad is not None
        assert errors.pan_rad.valid.tolist() == [False] * 3 + [True] * (F - 3)
    assert result.body is not None
    assert not result.body.valid[:3].any()
    assert result.lost == 0


def test_a_limb_that_is_too_long_is_read_off(whole: Reconstruction, truth: Truth) -> None:
    assert whole.motion is not None
    joints = whole.motion.joints_m.copy()
    joints[:, 5:7] += 0.03 * (joints[:, 5] - joints[:, 4])[:, None]  # left upper arm; what hangs on it goes along
    found = values(
        score(dataclasses.replace(whole, motion=dataclasses.replace(whole.motion, joints_m=joints)), truth, None)
    )
    assert found["body.limb.max"] == pytest.approx(3.0)
    assert found["body.limb.rms"] == pytest.approx(3.0 / np.sqrt(15.0))


def test_a_truth_of_another_capture_is_refused(whole: Reconstruction, truth: Truth) -> None:
    with pytest.raises(PzcapError, match="another capture"):
        score(whole, dataclasses.replace(truth, timecodes=("00:00:00:00",) * F), None)


def test_what_was_not_reconstructed_is_not_scored(whole: Reconstruction, truth: Truth) -> None:
    found = values(score(fabricated.without_a_camera(whole), truth, None))
    assert found["body.mpjpe.mean"] is None
    assert found["panzoom.lost"] == F
    assert found["panzoom.pan.rms"] == pytest.approx(0.0, abs=1e-9)


def test_silhouettes_are_scored_where_the_body_is_tall(whole: Reconstruction, truth: Truth) -> None:
    scorer = ForegroundScorer(truth, whole.camera_names)
    estimate = body_mask()
    estimate[:, 100:110] = False  # a sixth is missing
    estimate |= shadow_mask()
    scorer.add(0, truth.timecodes[0], 0, np.where(estimate, 255, 0).astype(np.uint8))
    scorer.add(1, truth.timecodes[1], 0, np.where(body_mask(), 200, 100).astype(np.uint8))
    small = dataclasses.replace(truth, mask_bits=truth.mask_bits * 0)
    nothing = ForegroundScorer(small, whole.camera_names)
    nothing.add(0, truth.timecodes[0], 0, np.full((HEIGHT, WIDTH), 255, np.uint8))
    assert nothing.errors(F) is None

    views = scorer.errors(F)
    assert views is not None
    body, dark = body_mask().sum(), (shadow_mask() & ~body_mask()).sum()
    assert views[0].iou.values[0] == pytest.approx((body * 5 / 6) / (body + dark))
    assert views[0].iou.values[1] == 1.0
    assert views[0].outline_px.values[1] == 0.0
    assert views[0].shadow.values[0] == pytest.approx(dark / body)
    assert list(np.flatnonzero(views[0].shadow.valid)) == [0]  # the truth knows the shadow of every tenth frame
    assert not views[1].iou.valid.any()


def test_silhouettes_of_a_rolling_shutter_are_scored_as_if_all_rows_were_exposed_at_once(
    whole: Reconstruction, truth: Truth
) -> None:
    """A camera that turns to the left by 8 px from the first row to the last, whose true mask is sheared by that."""
    rate, period_s = 8.0 / truth.focal_px[0, 0], 1 / float(truth.frame_rate)
    pan_rad, mask_bits = truth.pan_rad.copy(), truth.mask_bits.copy()
    pan_rad[0] = rate * np.arange(F)
    shear = np.array([[1.0, 8.0 / HEIGHT, 4.0 / HEIGHT - 4.0], [0.0, 1.0, 0.0]])
    size = (WIDTH, HEIGHT)
    sheared = cv2.warpAffine(body_mask().astype(np.uint8), shear, size, flags=cv2.INTER_NEAREST) > 0
    mask_bits[0, 5] = np.packbits(sheared)
    rolled = dataclasses.replace(
        truth, pan_rad=pan_rad, mask_bits=mask_bits, readout_s=np.where(np.arange(len(pan_rad)) == 0, period_s, 0.0),
        focal_px=np.repeat(truth.focal_px[:, :1], F, axis=1),
    )  # fmt: skip
    assert iou(body_mask(), sheared) < 0.97
    scorer = ForegroundScorer(rolled, whole.camera_names)
    scorer.add(5, truth.timecodes[5], 0, np.where(body_mask(), 255, 0).astype(np.uint8))
    views = scorer.errors(F)
    assert views is not None
    assert views[0].iou.values[5] > 0.985


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 15), st.integers(0, 2**31))
def test_outline_distance_measures_a_dilation(radius: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    true = np.zeros((200, 200), np.uint8)
    cv2.circle(true, (100, 100), int(rng.integers(20, 70)), 1, -1)
    grown = cv2.dilate(true, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1)))
    assert outline_distance(grown > 0, true > 0) == pytest.approx(radius, abs=0.45)
    assert outline_distance(true > 0, grown > 0) == pytest.approx(outline_distance(grown > 0, true > 0))
    assert iou(grown > 0, true > 0) == pytest.approx(true.sum() / grown.sum())


def test_an_empty_silhouette_is_as_wrong_as_the_body_is_tall() -> None:
    assert outline_distance(np.zeros((HEIGHT, WIDTH), bool), body_mask()) == 220


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**31), st.floats(-0.1, 0.1), st.floats(-0.02, 0.02), st.floats(-0.005, 0.005))
def test_the_score_projects_as_the_library_does(seed: int, k1: float, k2: float, p1: float) -> None:
    """Two programs, one lens: the independent projection agrees with pzcap.geometry.camera wherever the lens does not
    fold."""
    rng = np.random.default_rng(seed)
    transform = fabricated.world_T_head(0) @ np.diag([1.0, 1.0, 1.0, 1.0])
    transform[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    points, principal = rng.uniform(-15, 15, (50, 3)), rng.uniform(100, 200, 2)
    bent = (k1, k2, p1, -p1)
    poses = CameraPoses(transform[None, :3, :3], transform[None, :3, 3], principal[None], np.array([bent]))
    pixels, seen = project(poses, 500.0, 0, points)
    other, depth = geometry.project(Camera(320, 240, transform, 500.0, principal, *bent), points)
    assert np.all(depth[seen] > 0.1)
    near = seen & np.all(np.abs(other - principal) < 500.0, axis=1)
    np.testing.assert_allclose(pixels[near], other[near], atol=1e-6)


def test_metrics_json_is_what_it_says(tmp_path: Path) -> None:
    found = [Metric("panzoom.pan.rms", 0.0125, "deg"), Metric("foreground.iou", None, "1", "higher")]
    run = run_info({"seed": 3}, 3, ["camera 1: its shutter rolls"])
    write_metrics(tmp_path / "metrics.json", found, run)
    content = json.loads((tmp_path / "metrics.json").read_text())
    assert content["panzoom.pan.rms"] == {"value": 0.0125, "unit": "deg", "direction": "lower"}
    assert content["foreground.iou"] == {"value": None, "unit": "1", "direction": "higher"}
    assert set(content["_run"]) == {"config", "seed", "versions", "machine", "notes"}
    assert set(content["_run"]["machine"]) == {"cpu", "cores", "system"}
    assert read_metrics(tmp_path / "metrics.json") == (tuple(found), run)


@pytest.mark.parametrize(
    ("value", "text"), [(None, "–"), (0.0, "0"), (171.0, "171"), (0.01234, "0.0123"), (3.456, "3.46"), (1234.5, "1234")]
)
def test_values_are_read_by_people(value: float | None, text: str) -> None:
    assert format_value(Metric("x", value, "px")) == text


def test_targets() -> None:
    assert meets_target(Metric("panzoom.pan.rms", 0.003, "deg")) is True
    assert meets_target(Metric("panzoom.pan.rms", 0.0031, "deg")) is False
    assert meets_target(Metric("panzoom.pan.rms", None, "deg")) is None
    assert meets_target(Metric("speed.fps", 15.0, "1/s", "higher")) is True
    assert meets_target(Metric("speed.fps", 14.0, "1/s", "higher")) is False
    assert meets_target(Metric("panorama.pan.rms", 1.0, "deg")) is None


def test_the_picture_says_whether_the_covariance_can_be_believed(whole: Reconstruction, truth: Truth) -> None:
    """Errors drawn from the claim are believable; of three times its size they are not. A camera may be missing."""
    rng, off = np.random.default_rng(2), whole
    for number, scale in enumerate((1.0, 3.0)):
        track = whole.tracks[number]
        assert track is not None
        drawn = scale * rng.normal(size=(F, 2)) * [1e-4, 1e-3]
        off = change(
            off, "tracks", number, pan_rad=track.pan_rad + drawn[:, 0], focal_px=track.focal_px * np.exp(drawn[:, 1])
        )
    picture = plots.honesty(off, score(off, truth, None))
    assert "believable" in picture
    assert re.search(r"sigma [23]\.\dx too small", picture)
    assert "nan" not in picture.lower()
    lacking = fabricated.without_a_camera(whole)
    assert "Camera 2" in plots.honesty(lacking, score(lacking, truth, None))
