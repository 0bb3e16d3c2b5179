"""The folder keeps every bit, says so in its own words, and refuses what is broken."""

from __future__ import annotations

import dataclasses
import json
import random
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pzcap.io import results
from pzcap.types import PzcapError, Reconstruction
from tests.scenes import fabricated
from tests.test_damaged_files import damaged, mutated

DOCUMENT = Path(__file__).parents[2] / "docs" / "reconstruction.md"


def assert_same(one: Any, two: Any, path: str = "reconstruction") -> None:
    """Equal to the bit, types and shapes included."""
    assert type(one) is type(two), path
    if dataclasses.is_dataclass(one):
        for field in dataclasses.fields(one):
            assert_same(getattr(one, field.name), getattr(two, field.name), f"{path}.{field.name}")
    elif isinstance(one, np.ndarray):
        assert one.dtype == two.dtype, path
        np.testing.assert_array_equal(one, two, err_msg=path)
    elif isinstance(one, tuple):
        assert len(one) == len(two), path
        for index, (a, b) in enumerate(zip(one, two, strict=True)):
            assert_same(a, b, f"{path}[{index}]")
    else:
        assert one == two, path


def with_lateral_colour(made: Reconstruction) -> Reconstruction:
    first, *others = made.cameras
    assert first is not None
    lens = dataclasses.replace(first.lens, lateral_colour=np.array([-1.5e-3, 1e-4, 1e-3]))
    return dataclasses.replace(made, cameras=(dataclasses.replace(first, lens=lens), *others))


def with_leaning_floor(made: Reconstruction) -> Reconstruction:
    first, *others = made.panoramas
    assert first is not None
    hall = dataclasses.replace(first.surroundings, lean=np.array([0.01, -0.02]))
    return dataclasses.replace(made, panoramas=(dataclasses.replace(first, surroundings=hall), *others))


@pytest.mark.parametrize("shape", [lambda r: r, fabricated.without_a_camera, with_lateral_colour, with_leaning_floor])
def test_what_is_loaded_is_what_was_saved(tmp_path: Path, shape: Callable[[Any], Any]) -> None:
    before = shape(fabricated.reconstruction())
    results.save(before, tmp_path / "r")
    assert_same(before, results.load(tmp_path / "r"))


def test_the_same_reconstruction_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        results.save(fabricated.reconstruction(), tmp_path / name)
    files = sorted(path.name for path in (tmp_path / "a").iterdir())
    assert files == [
        "panorama1.png", "panorama2.png", "panorama3.png", "panorama4.png", "reconstruction.json", "reconstruction.npz",
    ]  # fmt: skip
    for file in files:
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes(), file


def test_numpy_alone_reads_it(tmp_path: Path) -> None:
    whole = fabricated.reconstruction()
    results.save(whole, tmp_path)
    script = (
        "import json, sys, numpy as np\n"
        "names = json.load(open('reconstruction.json')); numbers = np.load('reconstruction.npz')\n"
        "neck = names['joints'].index('neck')\n"
        "print(numbers['motion.joints_m'][numbers['motion.valid'], neck][3].tolist())\n"
        "assert 'pzcap' not in sys.modules\n"
    )
    answer = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert whole.motion is not None
    np.testing.assert_array_equal(json.loads(answer.stdout), whole.motion.joints_m[3, 3])


def test_every_key_is_documented(tmp_path: Path) -> None:
    results.save(fabricated.reconstruction(), tmp_path)
    document = DOCUMENT.read_text(encoding="utf-8")
    rows = [line for line in document.splitlines() if line.startswith("| `")]
    named = " ".join(row.split("|")[1] for row in rows)
    for key in np.load(tmp_path / "reconstruction.npz").files:
        key = key.replace("camera1.", "camera{i}.", 1)
        if not key.startswith(("camera{i}", "motion")):
            continue  # of the other cameras
        last = key.rpartition(".")[2]
        assert f"`{key}`" in named or f".{last}`" in named, f"{key} is not in {DOCUMENT.name}"
    for key in json.loads((tmp_path / "reconstruction.json").read_text()):
        assert f"`{key}`" in named, f"{key} is not in {DOCUMENT.name}"


def test_what_an_earlier_version_did_not_know_may_be_missing(tmp_path: Path) -> None:
    before = fabricated.reconstruction()
    results.save(before, tmp_path)
    numbers = dict(np.load(tmp_path / "reconstruction.npz"))
    earlier: dict[str, Any] = {key: value for key, value in numbers.items() if not key.endswith("panorama.fine")}
    assert len(earlier) == len(numbers) - 4
    np.savez(tmp_path / "reconstruction.npz", **earlier)
    assert_same(before, results.load(tmp_path))


def test_the_first_version_had_no_body(tmp_path: Path) -> None:
    before = fabricated.reconstruction()
    results.save(before, tmp_path)
    numbers = {k: v for k, v in np.load(tmp_path / "reconstruction.npz").items() if not k.startswith("motion.body.")}
    np.savez(tmp_path / "reconstruction.npz", **numbers)
    manifest = json.loads((tmp_path / "reconstruction.json").read_text()) | {"version": 1}
    del manifest["ends"]
    (tmp_path / "reconstruction.json").write_text(json.dumps(manifest))
    assert before.motion is not None
    without = dataclasses.replace(before, motion=dataclasses.replace(before.motion, body=None))
    assert_same(without, results.load(tmp_path))


def test_a_second_save_replaces_the_first(tmp_path: Path) -> None:
    results.save(fabricated.reconstruction(0), tmp_path)
    other = fabricated.without_a_camera(fabricated.reconstruction(1))
    results.save(other, tmp_path)
    assert_same(other, results.load(tmp_path))


def damage_version(folder: Path) -> None:
    path = folder / "reconstruction.json"
    path.write_text(path.read_text().replace('"version": 2', '"version": 9'))


def damage_timecodes(folder: Path) -> None:
    path = folder / "reconstruction.json"
    content = json.loads(path.read_text())
    content["timecodes"].pop()
    path.write_text(json.dumps(content))


def damage_key(folder: Path) -> None:
    numbers = dict(np.load(folder / "reconstruction.npz"))
    del numbers["camera1.track.focal_px"]
    np.savez(folder / "reconstruction.npz", **numbers)


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (lambda f: (f / "reconstruction.json").unlink(), "never finished"),
        (lambda f: (f / "reconstruction.json").write_text("{"), "not valid JSON"),
        (lambda f: (f / "reconstruction.json").write_text("{}"), "format"),
        (damage_version, "version 9; this pzcap reads versions 1 and 2; install a newer pzcap"),
        (damage_timecodes, "track.pan_rad has 12 rows beside 11 of the timecodes"),
        (damage_key, "camera1.track.focal_px"),
        (lambda f: (f / "reconstruction.npz").unlink(), "missing"),
        (lambda f: (f / "reconstruction.npz").write_bytes(b"PK\x03\x04 cut short"), "truncated"),
        (lambda f: (f / "panorama2.png").write_bytes(b""), "panorama2.png"),
    ],
)
def test_a_broken_folder_is_refused_in_one_line(tmp_path: Path, damage: Callable[[Path], object], says: str) -> None:
    results.save(fabricated.reconstruction(), tmp_path)
    damage(tmp_path)
    with pytest.raises(PzcapError) as error:
        results.load(tmp_path)
    assert says in str(error.value)
    assert "\n" not in str(error.value)


def test_a_save_that_is_cut_off_leaves_no_half_result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    results.save(fabricated.reconstruction(), tmp_path)

    def full_disk(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez_compressed", full_disk)
    with pytest.raises(OSError, match="No space"):
        results.save(fabricated.reconstruction(1), tmp_path)
    assert not list(tmp_path.glob(".*"))
    with pytest.raises(PzcapError, match="never finished"):
        results.load(tmp_path)


def nan(value: Any) -> Any:
    value = value.copy()
    value.flat[0] = np.nan
    return value


@pytest.mark.parametrize(
    ("key", "change", "says"),
    [
        ("camera1.track.pan_rad", nan, "pan_rad holds what is no number"),
        ("camera1.track.pan_rad", lambda v: v[:-1], "pan_rad has 11 rows beside 12 of the timecodes"),
        ("camera1.track.valid", lambda v: v.astype(float), "valid holds float64"),
        ("camera1.track.covariance", lambda v: v[:, 0], r"covariance has the shape (12, 2), not (F, 2, 2)"),
        ("camera2.track.focal_px", lambda v: -v, "focal_px is -660.0; it must be above 0"),
        ("camera1.camera.world_T_head", lambda v: 2 * v, "world_T_head is no rotation and translation"),
        ("camera1.camera.lens.k1", lambda v: v[:0], "k1 holds no coefficient"),
        ("camera1.camera.lens.width", lambda v: v + 0.5, "width holds float64"),
        ("camera1.panorama.px_per_rad", lambda v: 0 * v, "px_per_rad is 0.0; it must be above 0"),
        ("motion.rotations", lambda v: 2 * v, "rotations holds a quaternion whose length is not 1"),
        ("motion.sigma_m", lambda v: -v, "sigma_m holds what is below 0"),
        ("motion.keyframes", lambda v: v + 1, "keyframes names a frame that is not there"),
        ("motion.joints_m", lambda v: v[:, :15], "joints_m has the shape (12, 15, 3), not (F, 16, 3)"),
        ("motion.joints_m", lambda v: v.astype(str), "joints_m holds <U32"),
        ("motion.body.skin_segment", lambda v: v + 1, "skin_segment names a segment that is not there"),
        ("motion.body.skin_segment", lambda v: v[:-1], "skin_segment has 63 rows beside 64 of skin_m"),
        ("motion.body.skin_faces", lambda v: v - 1, "skin_faces names a vertex that is not there"),
        ("motion.body.ends_m", lambda v: v[:6], "ends_m has the shape (6, 3), not (7, 3)"),
    ],
)
def test_a_value_that_cannot_be_is_named(tmp_path: Path, key: str, change: Callable[[Any], Any], says: str) -> None:
    results.save(fabricated.reconstruction(), tmp_path)
    numbers = dict(np.load(tmp_path / "reconstruction.npz"))
    np.savez(tmp_path / "reconstruction.npz", **{**numbers, key: change(numbers[key])})
    with pytest.raises(PzcapError) as error:
        results.load(tmp_path)
    assert f"{tmp_path / 'reconstruction.npz'}: {key.rpartition('.')[0]}" in str(error.value)
    assert says in str(error.value)


@pytest.mark.parametrize("name", ["reconstruction.json", "reconstruction.npz", "panorama1.png"])
def test_damaged_bytes_are_told_in_one_line(name: str, tmp_path: Path) -> None:
    results.save(fabricated.reconstruction(), tmp_path)
    content = (tmp_path / name).read_bytes()
    for seed in range(60):
        (tmp_path / name).write_bytes(damaged(content, random.Random(seed)))
        loaded_or_one_line(tmp_path)


def test_damaged_values_are_told_in_one_line(tmp_path: Path) -> None:
    results.save(fabricated.reconstruction(), tmp_path)
    plain = json.loads((tmp_path / "reconstruction.json").read_text())
    for seed in range(200):
        (tmp_path / "reconstruction.json").write_text(json.dumps(mutated(plain, random.Random(seed))))
        loaded_or_one_line(tmp_path)


def loaded_or_one_line(folder: Path) -> None:
    said = f"{folder}: nothing"
    try:
        results.load(folder)
    except PzcapError as error:
        said = str(error)
    assert str(folder) in said
    assert "\n" not in said


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("frame_rate", "1e1000000000", "is no fraction"),
        ("frame_rate", "1001", "is 1001 frames a second"),
        ("capture", "\x1b[2J", "holds control characters"),
        ("notes", ["a note", "\x9b31m"], "holds control characters"),
    ],
)
def test_texts_of_a_manifest_that_never_come_from_save(tmp_path: Path, key: str, value: object, said: str) -> None:
    results.save(fabricated.reconstruction(), tmp_path)
    path = tmp_path / results.MANIFEST
    path.write_text(json.dumps(json.loads(path.read_text()) | {key: value}))
    with pytest.raises(PzcapError, match=f'"{key}" {said}'):
        results.load(tmp_path)
