"""Self-calibration: exact on perfect matches, near on noisy ones, each within what its camera model can say."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest
from hydra.core.global_hydra import GlobalHydra
from scipy.spatial.transform import Rotation

from experiments.compare import main
from experiments.comparisons.self_calibration import NAMES, trial
from experiments.comparisons.self_calibration.baselines import (
    Frames,
    Library,
    Pair,
    Shots,
    ZoomModel,
    shum_szeliski,
    sinha_pollefeys,
    wu_radke,
)
from experiments.comparisons.self_calibration.baselines.adjustment import transfer
from experiments.comparisons.self_calibration.baselines.rotations import focals_of
from experiments.metrics import read_metrics
from pzcap.calibration.features import Features
from pzcap.geometry.camera import head_T_cam
from pzcap.geometry.lens import Distortion, distort
from pzcap.types import Array, PzcapError

METHODS: dict[str, Callable[[Shots, Sequence[Pair]], Frames]] = {
    "shum_szeliski": shum_szeliski,
    "sinha_pollefeys": sinha_pollefeys,
    "wu_radke": lambda shots, pairs: wu_radke(shots, pairs)[0],
}
WIDTH, HEIGHT = 640, 480
CENTRE = np.array([(WIDTH - 1) / 2, (HEIGHT - 1) / 2])
OFF_CENTRE = CENTRE + np.array([3.0, -2.0])
PANS = np.deg2rad(np.arange(0, 372, 12.0))
ZOOM = np.exp(np.linspace(np.log(0.7), np.log(2.6), 9))


def truth(principal_px: Array, k1: tuple[float, float]) -> Frames:
    """A full turn at one zoom, and a zoom run; tilted head. k1 is linear in log focal."""
    pans = np.append(PANS, np.full(len(ZOOM), 0.05))
    log_zoom = np.append(np.zeros(len(PANS)), np.log(ZOOM))
    rotation = np.array([head_T_cam(pan, np.deg2rad(-4.0), np.deg2rad(0.5))[:3, :3] for pan in pans])
    lens = np.column_stack([np.log(880.0) + log_zoom, np.tile(principal_px, (len(pans), 1)), k1[0] + k1[1] * log_zoom])
    return Frames(rotation, lens, np.ones(len(pans), bool))


def view(frames: Frames, frame: int, directions: Array) -> tuple[Array, Array]:
    """Where a frame sees directions (N, 3), and which are in the picture; by no code of the adjustment's."""
    points = directions @ frames.rotation[frame]
    front = points[:, 2] > 0.2
    xy = points[:, :2] / np.where(front, points[:, 2], 1.0)[:, None]
    pixels = frames.lens[frame, 1:3] + frames.focal_px[frame] * distort(xy, Distortion(float(frames.lens[frame, 3])))
    return pixels, front & (pixels >= 0).all(axis=1) & (pixels <= (WIDTH - 1, HEIGHT - 1)).all(axis=1)


def pairs_of(frames: Frames, noise: float, wrong: float = 0.0) -> list[Pair]:
    rng = np.random.default_rng(0)
    sphere = rng.normal(size=(9000, 3))
    sphere[:, 2] *= 0.5
    sphere /= np.linalg.norm(sphere, axis=1, keepdims=True)
    seen = [view(frames, k, sphere) for k in range(len(frames.valid))]
    pixels = [points + rng.normal(0, noise, points.shape) if noise else points for points, _ in seen]
    made = []
    for i in range(len(seen)):
        for j in range(i + 1, len(seen)):
            both = np.flatnonzero(seen[i][1] & seen[j][1])
            if len(both) < 30:
                continue
            a, b = pixels[i][both], pixels[j][both].copy()
            bad = rng.random(len(both)) < wrong
            b[bad] += rng.uniform(-15, 15, (bad.sum(), 2))
            homography, _ = cv2.findHomography(a, b, cv2.RANSAC, 3.0)
            made.append(Pair(i, j, a, b, homography))
    return made


def shots_of(count: int) -> Shots:
    nothing = Features(np.zeros((0, 2)), np.zeros((0, 61), np.uint8), np.zeros(0))
    return Shots((nothing,) * count, WIDTH, HEIGHT, tuple(range(len(PANS))), True, tuple(range(len(PANS), count)))


def turned(found: Frames, true: Frames) -> Array:
    """(F,) Angles between rotations after the one rotation that brings the first onto the second."""
    u, _, vt = np.linalg.svd(np.einsum("fij,fkj->ik", true.rotation, found.rotation))
    common = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    return Rotation.from_matrix((common @ found.rotation).transpose(0, 2, 1) @ true.rotation).magnitude()


PLAIN = truth(CENTRE, (0.0, 0.0))
REAL = truth(OFF_CENTRE, (-0.05, 0.06))


def test_a_mosaic_of_frames_that_show_nothing_in_common_is_said() -> None:
    """Of a swing so fast that frames match only those of another zoom."""
    frames = truth(CENTRE, (0.0, 0.0))
    across = [pair for pair in pairs_of(frames, 0.3) if pair.first < len(PANS) <= pair.second]
    with pytest.raises(PzcapError, match="no two of these frames show the same"):
        sinha_pollefeys(shots_of(len(frames.valid)), across)


@pytest.mark.parametrize("method", ["shum_szeliski", "sinha_pollefeys", "wu_radke"])
def test_perfect_matches_give_the_truth_where_the_method_models_it(method: str) -> None:
    true = PLAIN if method == "shum_szeliski" else REAL
    found = METHODS[method](shots_of(len(true.valid)), pairs_of(true, 0.0))
    assert found.valid.all()
    np.testing.assert_allclose(found.focal_px, true.focal_px, rtol=2e-4)
    np.testing.assert_allclose(found.lens[:, 1:3], true.lens[:, 1:3], atol=0.2)
    np.testing.assert_allclose(found.lens[:, 3], true.lens[:, 3], atol=0.004)
    assert turned(found, true).max() < np.deg2rad(0.01)


@pytest.mark.parametrize(("method", "focal"), [("shum_szeliski", 0.02), ("sinha_pollefeys", 2e-3), ("wu_radke", 1e-3)])
def test_noise_and_wrong_matches(method: str, focal: float) -> None:
    """With distortion, which Shum and Szeliski do not model: their focal lengths are right to two per cent only."""
    found = METHODS[method](shots_of(len(REAL.valid)), pairs_of(REAL, 0.3, 0.2))
    assert found.valid.all()
    error = np.abs(found.focal_px / REAL.focal_px - 1)
    print(method, error.max(), np.rad2deg(turned(found, REAL).max()))
    assert error.max() < focal


def test_the_closed_form_gives_both_focal_lengths() -> None:
    first, second = np.diag([800.0, 800.0, 1.0]), np.diag([1300.0, 1300.0, 1.0])
    turn = Rotation.from_rotvec([0.06, 0.2, 0.03]).as_matrix()
    found = focals_of(second @ turn @ np.linalg.inv(first), np.zeros(2))
    np.testing.assert_allclose(found, (800.0, 1300.0), rtol=1e-9)


def test_transfer_derivatives_match_finite_differences() -> None:
    points = np.random.default_rng(0).uniform((0, 0), (639, 479), (12, 2))
    first, second = np.array([6.8, 322.0, 236.0, -0.05]), np.array([7.1, 318.0, 241.0, 0.02])
    one, two = Rotation.from_rotvec([0.1, 0.2, 0.0]), Rotation.from_rotvec([0.15, 0.3, 0.02])

    def at(x: Array) -> Array:
        a, b = one * Rotation.from_rotvec(x[:3]), two * Rotation.from_rotvec(x[7:10])
        return transfer(first + x[3:7], second + x[10:], (b.inv() * a).as_matrix(), points)[0]

    _, by = transfer(first, second, (two.inv() * one).as_matrix(), points)
    numeric = np.stack([(at(step) - at(-step)) / 2e-6 for step in 1e-6 * np.eye(14)], axis=2)
    np.testing.assert_allclose(by, numeric, rtol=1e-5, atol=1e-3)


def test_the_library_finds_frames_and_forgets_what_is_gone() -> None:
    """Features with descriptors of their own: found by them anywhere, then frame by frame; half removed."""
    rng = np.random.default_rng(2)
    sphere = rng.normal(size=(6000, 3)) * (1, 1, 0.4)
    sphere /= np.linalg.norm(sphere, axis=1, keepdims=True)
    words = rng.integers(0, 256, (6000, 61)).astype(np.uint8)

    def shoot(frames: Frames, frame: int, there: Array) -> Features:
        pixels, inside = view(frames, frame, sphere)
        inside &= there
        return Features(pixels[inside] + rng.normal(0, 0.2, (inside.sum(), 2)), words[inside], np.zeros(inside.sum()))

    everything = np.ones(6000, bool)
    shots = Shots(tuple(shoot(REAL, k, everything) for k in range(len(REAL.valid))), WIDTH, HEIGHT)
    model = ZoomModel(float(np.log(880.0)), OFF_CENTRE, np.array([-0.05, 0.06, 0.0]))
    library = Library(shots, REAL, model)
    pans, log_zooms = 0.4 + 0.02 * np.arange(20), np.linspace(0.1, 0.6, 20)
    moving = Frames(
        np.array([head_T_cam(pan, np.deg2rad(-4.0), np.deg2rad(0.5))[:3, :3] for pan in pans]),
        np.array([model.lens(np.log(880.0) + x) for x in log_zooms]), np.ones(20, bool),
    )  # fmt: skip
    gone = rng.random(6000) < 0.5
    before = len(library)
    for k in range(20):
        rotation, lens, valid = library.locate(shoot(moving, k, everything if k < 3 else ~gone))
        assert valid
        assert abs(np.exp(lens[0]) / moving.focal_px[k] - 1) < 5e-4
        assert Rotation.from_matrix(rotation.T @ moving.rotation[k]).magnitude() < np.deg2rad(0.02)
    assert len(library) < before


def test_the_small_capture_by_the_command(
    small_capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """All methods on all sets of frames of one camera: every figure is there, and ours is near.

    Eight frames of motion hardly pan: what the mosaics make of them is not looked at.
    """
    GlobalHydra.instance().clear()
    manifest = json.loads((small_capture / "capture" / "capture.json").read_text())
    manifest["cameras"] = manifest["cameras"][2:3]
    (tmp_path / "capture").mkdir()
    (tmp_path / "capture" / "capture.json").write_text(json.dumps(manifest))
    for path in (*(small_capture / "capture").glob("camera*"), *(small_capture / "capture").glob("[!c]*.json")):
        (tmp_path / "capture" / path.name).symlink_to(path)
    (tmp_path / "truth").symlink_to(small_capture / "truth")
    monkeypatch.setattr(
        "sys.argv",
        ["compare", "self_calibration", f"capture={tmp_path / 'capture'}", f"hydra.run.dir={tmp_path / 'out'}"],
    )
    assert main() == 0
    found, _ = read_metrics(tmp_path / "out" / "metrics.json")
    value = {metric.key: metric.value for metric in found}
    assert len(value) == 4 * 3 * 7
    for condition in trial.CONDITIONS:
        focal, failures = value[f"selfcal.ours.{condition}.focal.median"], value[f"selfcal.ours.{condition}.failures"]
        assert focal is not None
        assert focal < 1.0
        assert failures is not None
        assert failures <= 1
    assert all(value[f"selfcal.{method}.empty.seconds"] for method in trial.METHODS)
    assert (tmp_path / "out" / "self_calibration.png").stat().st_size > 10000
    out = capsys.readouterr().out
    assert all(out.count(name) >= 3 for name in NAMES.values())


def test_errors_are_what_was_put_in() -> None:
    """A common rotation is not an error, a turn about the vertical of one frame is; one that is far off has failed."""
    common = Rotation.from_rotvec([0.3, -0.8, 1.5]).as_matrix()
    rotation = common @ REAL.rotation
    rotation[4] = Rotation.from_rotvec(common @ [0.0, 0.0, np.deg2rad(0.5)]).as_matrix() @ rotation[4]
    lens = REAL.lens.copy()
    lens[7, 0] += np.log(1.1)
    lens[9, 1] += 2.0
    errors = trial.errors_of(Frames(rotation, lens, REAL.valid), REAL, 1.0)
    assert np.flatnonzero(errors.failed).tolist() == [7]
    assert errors.pan_rad[4] == pytest.approx(np.deg2rad(0.5), rel=0.05)
    assert errors.pan_rad[[0, 1, 2, 8]].max() < np.deg2rad(0.03)
    assert errors.principal_px[9] == pytest.approx(2.0)
