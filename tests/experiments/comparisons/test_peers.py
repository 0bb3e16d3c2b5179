"""The peer bench: every method against the truth of the small capture, folders of frames, faults."""

from __future__ import annotations

import csv
import io
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

from experiments import footage
from experiments.compare import main
from experiments.comparisons.harness import Row, print_rows
from experiments.comparisons.peers import COMPARISON, bench, folder
from experiments.comparisons.peers.matching import decompose, fit
from experiments.comparisons.peers.material import Background, Estimate, Material, from_capture
from experiments.metrics import read_metrics
from pzcap.calibration.settings import PanZoomConfig
from pzcap.geometry import camera as geometry
from pzcap.io.capture import read_capture
from pzcap.io.results import save
from pzcap.localisation.panorama_sampler import ViewPlace, warp_background
from pzcap.types import PzcapError, Reconstruction

pytestmark = pytest.mark.xdist_group("pipeline")

EVERY = 4  # 2 of the 8 frames
ACCURATE = {"ours", "ours_tracking", "sift", "akaze", "ecc_difference", "ecc_known", "rays", "hugin"}


def quiet(stage: str, done: int, total: int) -> None:
    del stage, done, total


@pytest.fixture(scope="module")
def material(small_capture: Path, small_run: Reconstruction, tmp_path_factory: pytest.TempPathFactory) -> Material:
    """The first two cameras of the small capture."""
    found = tmp_path_factory.mktemp("found")
    save(small_run, found)
    capture = read_capture(small_capture / "capture")
    two = replace(capture, cameras=capture.cameras[:2])
    return from_capture(two, footage.truth_beside(small_capture / "capture"), found, PanZoomConfig(), True, quiet)


@pytest.fixture(scope="module")
def results(material: Material) -> dict[str, bench.Result]:
    return {result.name: result for result in bench.run(material, tuple(bench.METHODS), EVERY, quiet)}


@pytest.mark.parametrize("name", bench.METHODS)
def test_every_method_is_near_the_truth(results: dict[str, bench.Result], name: str) -> None:
    result = results[name]
    if result.missing is not None:
        assert name == "hugin", result.missing
        pytest.skip("Hugin is not installed")
    assert len(result.answers) == 4
    errors = [answer.errors for answer in result.answers]
    found = np.array([error for error in errors if error is not None])
    assert np.isfinite(found).all()
    # 320 x 240 pixels, a sweep of 80 degrees: calibration alone is off by hundredths of a degree
    pan, focal = (0.1, 0.01) if name in ACCURATE else (0.8, 0.05)
    assert len(found) == 4 if name in ACCURATE else len(found) >= 2
    assert np.median(np.abs(found[:, 0])) < np.deg2rad(pan)
    assert np.median(np.abs(found[:, 1])) < focal


def test_all_methods_get_the_same_views(results: dict[str, bench.Result]) -> None:
    views = {tuple((a.camera, a.frame) for a in r.answers) for r in results.values() if r.missing is None}
    assert len(views) == 1
    assert {frame for _, frame in views.pop()} == {0, 4}


def test_the_threads_are_given_back(material: Material) -> None:
    cv2.setNumThreads(2)
    bench.run(material, (), EVERY, quiet)
    assert cv2.getNumThreads() == 2


def test_a_failure_is_no_answer_or_one_far_off() -> None:
    true = Estimate(0.1, 800.0)
    said = [true, None, Estimate(0.1 + np.deg2rad(1.1), 800.0), Estimate(0.1, 841.0), Estimate(0.1, 838.0)]
    answers = tuple(bench.Answer(0, frame, estimate, true, 0.01) for frame, estimate in enumerate(said))
    summary = bench.summarise([bench.Result("sift", answers, None)])["sift"]
    assert summary is not None
    assert summary.failures == 3
    assert len(summary.pan_rad) == len(summary.focal) == 2


def test_without_a_truth_the_median_of_all_is_what_is_compared_with() -> None:
    pans = {"ours": np.pi - 0.01, "sift": -np.pi + 0.01, "akaze": np.pi}
    results = [
        bench.Result(name, (bench.Answer(0, 0, Estimate(pan, 800.0), None, 0.01),), None) for name, pan in pans.items()
    ]
    found = {name: bench.figures(summary, "agreement.") for name, summary in bench.summarise(results).items()}
    assert found["akaze"]["agreement.pan.median"] == pytest.approx(0.0, abs=1e-9)
    assert found["sift"]["agreement.pan.median"] == pytest.approx(np.rad2deg(0.01))
    assert not bench.scored(results)


@settings(deadline=None, max_examples=30)
@given(st.floats(-0.5, 0.5), st.floats(-0.3, 0.3), st.floats(-0.1, 0.1), st.floats(300.0, 3000.0), st.floats(0.1, 10.0))
def test_a_homography_of_a_rotation_decomposes_into_it(
    pan: float, tilt: float, roll: float, focal: float, factor: float
) -> None:
    rotation = geometry.head_T_cam(pan, tilt, roll)[:3, :3].T @ geometry.head_T_cam(0.0, 0.0, 0.0)[:3, :3]
    homography = np.diag([focal, focal, 1.0]) @ rotation @ np.diag([1 / 800.0, 1 / 800.0, 1.0])
    decomposed = decompose(-factor * homography, 800.0)
    assert decomposed is not None
    np.testing.assert_allclose(decomposed[0], rotation, atol=1e-9)
    assert decomposed[1] == pytest.approx(focal)


def test_the_fit_finds_the_view_among_outliers(material: Material) -> None:
    background = material.backgrounds[0]
    rng = np.random.default_rng(3)
    shape = background.panorama.image.shape
    points_m = background.points(rng.uniform([0, 0], [shape[1], shape[0]], (4000, 2)))
    camera, focal = background.camera, 1.3 * background.camera.lens.reference_focal_px
    pixels, depth = geometry.project(geometry.at(camera, 0.1, camera.tilt_rad, focal), points_m)
    seen = (depth > 0) & np.all((pixels > 0) & (pixels < [camera.lens.width, camera.lens.height]), axis=1)
    noisy = pixels[seen] + rng.normal(0.0, 0.1, (int(seen.sum()), 2))
    noisy[::10] += 5.0
    found = fit(background, noisy, points_m[seen], Estimate(0.11, 1.02 * focal))
    assert found.pan_rad == pytest.approx(0.1, abs=1e-4)
    assert found.focal_px == pytest.approx(focal, rel=1e-3)


# --------------------------------------------------------------------------------------------------------------
# Folders of frames


def write_folder(where: Path, background: Background, pans: list[float], *, sweep: bool) -> Path:
    """A test set of frames rendered from a panorama, as anybody else would write it."""
    camera, lens = background.camera, background.camera.lens
    plain = replace(camera, offset_m=np.zeros(2))
    focal = 1.2 * lens.reference_focal_px

    def render(path: Path, pan: float, focal_px: float) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        image, _ = warp_background(background.panorama, plain, ViewPlace(pan, camera.tilt_rad, focal_px))
        cv2.imwrite(str(path), image)

    for number, pan in enumerate(pans):
        render(where / "frames" / f"{number:03}.png", pan, focal)
    if sweep:
        for number in range(13):
            render(where / "sweep" / f"{number:03}.png", np.deg2rad(5.0 * number - 30.0), lens.reference_focal_px)
    else:
        known = background.panorama.valid.astype(np.uint8) * 255
        cv2.imwrite(str(where / "panorama.png"), np.dstack([background.panorama.image, known]))
        (where / "panorama.json").write_text(json.dumps({
            "px_per_rad": background.panorama.px_per_rad, "origin_px": list(background.panorama.origin_px),
            "full_turn": False,
        }))  # fmt: skip
    (where / "camera.json").write_text(json.dumps({
        "focal_px": lens.reference_focal_px, "principal_px": lens.principal_px.tolist(), "k1": lens.k1.tolist(),
        "tilt_deg": float(np.rad2deg(camera.tilt_rad)), "roll_deg": float(np.rad2deg(camera.roll_rad)),
    }))  # fmt: skip
    first = np.deg2rad(-30.0) if sweep else 0.0
    with (where / "truth.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(folder.COLUMNS)
        writer.writerows([f"{n:03}", float(np.rad2deg(pan - first)), focal] for n, pan in enumerate(pans))
    return where


@pytest.fixture(scope="module")
def frames_folder(material: Material, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_folder(tmp_path_factory.mktemp("frames"), material.backgrounds[0], [-0.1, 0.0, 0.1], sweep=False)


def test_a_panorama_and_frames_come_back_as_they_were_written(frames_folder: Path, material: Material) -> None:
    read = folder.from_folder(frames_folder, PanZoomConfig(), quiet)
    written, found = material.backgrounds[0], read.backgrounds[0]
    np.testing.assert_array_equal(found.panorama.image, written.panorama.image)
    np.testing.assert_array_equal(found.panorama.valid, written.panorama.valid)
    assert found.panorama.px_per_rad == written.panorama.px_per_rad
    np.testing.assert_array_equal(found.panorama.origin_px, written.panorama.origin_px)
    np.testing.assert_array_equal(found.camera.lens.principal_px, written.camera.lens.principal_px)
    assert found.camera.tilt_rad == pytest.approx(written.camera.tilt_rad)
    truths = [shot.truth for shot in read.shots()]
    assert [t.pan_rad for t in truths if t is not None] == pytest.approx([-0.1, 0.0, 0.1])


def test_a_sweep_is_stitched_by_the_camera_that_is_known(material: Material, tmp_path: Path) -> None:
    written = write_folder(tmp_path, material.backgrounds[0], [-0.1, 0.1], sweep=True)
    read = folder.from_folder(written, PanZoomConfig(), quiet)
    assert np.rad2deg(read.backgrounds[0].panorama.sweep_pan_rad) == pytest.approx(np.arange(0.0, 61.0, 5.0), abs=0.02)
    for result in bench.run(read, ("ours", "sift", "rays", "paper", "ecc_known"), 1, quiet):
        if result.name in ("paper", "ecc_known"):
            assert result.missing is not None
            continue
        errors = np.array([answer.errors for answer in result.answers], np.float64)
        assert np.abs(errors[:, 0]).max() < np.deg2rad(0.05), result.name
        assert np.abs(errors[:, 1]).max() < 0.005, result.name


def test_the_command_leaves_a_table_a_plot_and_every_answer(
    frames_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setattr("sys.argv", [
        "compare", "peers", f"capture={frames_folder}", "methods=[ours,sift,rays]", "every=2",
        f"hydra.run.dir={tmp_path}",
    ])  # fmt: skip
    assert main() == 0
    printed = capfd.readouterr().out
    assert "ours, cold start" in printed
    assert "needs a sweep" in printed
    figures = {metric.key: metric.value for metric in read_metrics(tmp_path / "metrics.json")[0]}
    assert figures["peers.sift.failures"] == 0
    assert figures["peers.rays.failures"] is None
    sift = figures["peers.sift.pan.p95"]
    assert sift is not None
    assert sift < 0.1
    with (tmp_path / "answers.csv").open(newline="") as file:
        assert [row["method"] for row in csv.DictReader(file)] == ["ours", "ours", "sift", "sift"]
    assert cv2.imread(str(tmp_path / "errors.png")) is not None


# --------------------------------------------------------------------------------------------------------------
# Faults


def edit(name: str, **changes: Any) -> Callable[[Path], None]:
    def change(where: Path) -> None:
        tree = json.loads((where / name).read_text()) | changes
        (where / name).write_text(json.dumps({key: value for key, value in tree.items() if value is not None}))

    return change


def truth_line(line: str) -> Callable[[Path], None]:
    def change(where: Path) -> None:
        (where / "truth.csv").write_text(f"frame,pan_deg,focal_px\n{line}\n")

    return change


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (lambda where: shutil.rmtree(where / "frames"), "frames: holds no images"),
        (lambda where: (where / "camera.json").unlink(), "camera.json: cannot be read"),
        (lambda where: (where / "camera.json").write_text("{"), "camera.json: is not valid JSON"),
        (edit("camera.json", focal_px=None), "focal_px"),
        (edit("camera.json", focal_px=-1.0), "it must be above 0"),
        (edit("camera.json", tilt=1.0), "unknown key 'tilt'; did you mean tilt_deg?"),
        (edit("camera.json", principal_px=[[1.0]]), "principal_px is a list of [x, y]"),
        (lambda where: (where / "panorama.png").unlink(), "neither panorama.png nor the folder sweep"),
        (lambda where: (where / "panorama.png").write_bytes(b"no"), "panorama.png: is no PNG"),
        (lambda where: (where / "panorama.json").unlink(), "panorama.json: cannot be read"),
        (edit("panorama.json", full_turn=True), "of a full turn it must be 2 pi px_per_rad"),
        (
            lambda where: (where / "truth.csv").write_text("frame,pan\n"),
            "its first line must be frame,pan_deg,focal_px",
        ),
        (truth_line("000,north,800"), "line 2: pan_deg and focal_px must be numbers"),
        (truth_line("000,1.0"), "line 2: pan_deg and focal_px must be numbers"),
        (truth_line("000,1.0,0"), "focal_px above 0"),
        (truth_line("999,1.0,800"), "there is no frames/999.png"),
        (lambda where: cv2.imwrite(str(where / "frames" / "001.png"), np.zeros((9, 9, 3), np.uint8)), "is 9x9 where"),
    ],
)
def test_what_is_wrong_with_a_folder_is_said_in_one_line(
    frames_folder: Path, tmp_path: Path, damage: Callable[[Path], Any], says: str, monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    broken = Path(shutil.copytree(frames_folder, tmp_path / "frames_folder"))
    damage(broken)
    err = refused(
        monkeypatch, capfd, f"capture={broken}", f"hydra.run.dir={tmp_path / 'run'}", "methods=[sift]", "every=1"
    )
    assert says in err


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["methods=[orb]"], "no method 'orb'; choose from ours, "),
        (["evry=2"], "unknown key 'evry'; did you mean every?"),
        (["every=0"], "every is 0; give 1 or more"),
        (["method=paper"], "choose with methods=[ours,paper,...]"),
        (["capture=/nowhere"], "holds neither capture.json (docs/capture.md) nor camera.json (docs/peers.md)"),
    ],
)
def test_what_is_wrong_with_the_command_is_said_in_one_line(
    frames_folder: Path, tmp_path: Path, arguments: list[str], says: str, monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    first = [] if arguments[0].startswith("capture") else [f"capture={frames_folder}"]
    assert says in refused(monkeypatch, capfd, *first, *arguments, f"hydra.run.dir={tmp_path}")


def test_a_reconstruction_of_another_capture_is_refused(small_capture: Path, tmp_path: Path) -> None:
    capture = read_capture(small_capture / "capture")
    with pytest.raises(PzcapError, match=r"no reconstruction\.json"):
        from_capture(capture, None, tmp_path, PanZoomConfig(), False, quiet)


def refused(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Start the command, which must fail with one line; return it."""
    monkeypatch.setattr("sys.argv", ["compare", "peers", *arguments])
    assert main() == 1
    out, err = capfd.readouterr()
    assert out == ""
    lines = [line for line in err.splitlines() if line.startswith("error: ")]
    assert len(lines) == 1
    assert "Traceback" not in err
    return lines[0]


def test_results_of_an_earlier_bench_do_not_outlive_a_failure(
    frames_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    for name in COMPARISON.results:
        (tmp_path / name).write_text("old")
    refused(monkeypatch, capfd, f"capture={frames_folder}", "every=0", f"hydra.run.dir={tmp_path}")
    assert not any((tmp_path / name).exists() for name in COMPARISON.results)


def test_no_label_or_reason_is_cut_however_narrow_the_console() -> None:
    out = io.StringIO()
    rows = [Row(name, method.label, bench.figures(None, "")) for name, method in bench.METHODS.items()]
    print_rows(Console(file=out, width=40), COMPARISON, "title", [*rows, Row("x", "X", {}, missing="not installed")])
    lines = out.getvalue().splitlines()
    assert all(sum(method.label in line for line in lines) == 1 for method in bench.METHODS.values())
    assert any("not installed" in line for line in lines)
