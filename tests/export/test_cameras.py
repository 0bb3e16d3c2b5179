"""Cameras come back through other people's readers: joints land on the same pixel, in the convention of that reader.

Where a format has no reader on the package index, its published definition is written out here, by hand and on its own.
"""

from __future__ import annotations

import json
import socket
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import jsonschema
import numpy as np
import pandas as pd
import pycolmap
import pytest

from pzcap.export import formats, freed
from pzcap.export.take import Take
from pzcap.geometry.camera import project
from pzcap.types import Array, PzcapError
from tests.scenes import exported, fabricated
from tests.scenes.exported import FRAMES, LOST, NAMES, RATE

WIDTH, HEIGHT = fabricated.WIDTH, fabricated.HEIGHT
PIXELS = 0.02
SEEN = [(number, frame) for number in range(4) for frame in range(FRAMES) if (number, frame) != (0, LOST)]


def truth(number: int, frame: int, k1: float = exported.K1) -> Array:
    """(16, 2) pixels of the joints, (0, 0) the centre of the first."""
    pixels, depth = project(exported.true_camera(number, frame, k1), exported.joints(frame))
    assert (depth > 1.0).all()
    return pixels


def about(axis: int, degrees: float) -> Array:
    """Right-handed rotation about an axis."""
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    a, b = (axis + 1) % 3, (axis + 2) % 3
    turned = np.eye(3)
    turned[[a, a, b, b], [a, b, a, b]] = c, -s, s, c
    return turned


def test_colmap(tmp_path: Path) -> None:
    formats.write(exported.take(), "colmap", tmp_path)
    model = pycolmap.Reconstruction(str(tmp_path))
    assert model.num_images() == len(SEEN)
    files = {"Sud_1": 0, "b_c_2": 1, "b_c_3": 2, "4": 3}
    met = set()
    for image in model.images.values():
        folder, name = image.name.split("/")
        number, frame = files[folder], int(name.removesuffix(".png"))
        met.add((number, frame))
        found = np.array([image.project_point(point) for point in exported.joints(frame)])
        np.testing.assert_allclose(found - 0.5, truth(number, frame), atol=PIXELS)  # centre of the first is (0.5, 0.5)
        assert (image.camera.width, image.camera.height) == (WIDTH, HEIGHT)
    assert met == set(SEEN)


def test_colmap_with_all_coefficients(tmp_path: Path) -> None:
    whole = exported.reconstruction()
    heads = tuple(
        replace(head, lens=replace(head.lens, k2=np.array([0.03]), p1=np.array([0.004]), p2=np.array([-0.006])))
        for head in whole.cameras
        if head is not None
    )
    formats.write(Take(replace(whole, cameras=heads)), "colmap", tmp_path)
    model = pycolmap.Reconstruction(str(tmp_path))
    image = next(image for image in model.images.values() if image.name == "4/000003.png")
    bent = replace(exported.true_camera(3, 3), k2=0.03, p1=0.004, p2=-0.006)
    found = np.array([image.project_point(point) for point in exported.joints(3)])
    np.testing.assert_allclose(found - 0.5, project(bent, exported.joints(3))[0], atol=PIXELS)


def samples(folder: Path) -> dict[int, list[dict[str, Any]]]:
    paths = [path for path in formats.write(exported.take(), "opentrackio", folder) if path.suffix == ".jsonl"]
    return {k: [json.loads(line) for line in path.read_text().splitlines()] for k, path in enumerate(paths)}


def test_opentrackio_by_its_schema(tmp_path: Path) -> None:
    schema = json.loads((Path(__file__).parent / "opentrackio_1_0_1.schema.json").read_text())
    validator = jsonschema.Draft202012Validator(schema)
    ids = set()
    for number, lines in samples(tmp_path).items():
        assert len(lines) == FRAMES - (number == 0)
        for sample in lines:
            validator.validate(sample)
            ids.add(sample["sampleId"])
        assert "static" in lines[0]
        assert lines[0]["static"]["camera"]["label"] == NAMES[number]
        assert lines[0]["timing"]["sampleRate"] == {"num": RATE.numerator, "denom": RATE.denominator}
        assert lines[-1]["timing"]["timecode"]["frames"] == 5 + FRAMES - 1
    assert len(ids) == len(SEEN)


def test_opentrackio(tmp_path: Path) -> None:
    """By OpenLensIO's formulas and figure: z up, y forward, pan, tilt and roll right-handed about z, x and y."""
    for number, lines in samples(tmp_path).items():
        sensor = lines[0]["static"]["camera"]["activeSensorPhysicalDimensions"]
        for sample in lines:
            frame = sample["timing"]["sequenceNumber"]
            place, turn = sample["transforms"][-1]["translation"], sample["transforms"][-1]["rotation"]
            rotation = about(2, turn["pan"]) @ about(0, turn["tilt"]) @ about(1, turn["roll"])
            right, forward, up = ((exported.joints(frame) - [place[axis] for axis in "xyz"]) @ rotation).T
            lens = sample["lens"]
            focal = lens["pinholeFocalLength"]
            x, y = focal * right / forward, -focal * up / forward  # mm from the centre, y down
            [distortion] = lens["distortion"]
            assert distortion["model"] == "Brown-Conrady U-D"
            assert len(distortion["radial"]) == 6
            l1, l2, l3, l4, l5, l6 = distortion["radial"]
            r2 = x * x + y * y
            factor = (1 + l1 * r2 + l3 * r2**2 + l5 * r2**3) / (1 + l2 * r2 + l4 * r2**2 + l6 * r2**3)
            x, y = factor * x + lens["projectionOffset"]["x"], factor * y + lens["projectionOffset"]["y"]
            corner = np.column_stack(
                [x * WIDTH / sensor["width"] + WIDTH / 2, y * HEIGHT / sensor["height"] + HEIGHT / 2]
            )
            np.testing.assert_allclose(corner - 0.5, truth(number, frame), atol=PIXELS)
            assert lens["distortionOffset"] == lens["projectionOffset"]


def test_pan_to_the_left_is_positive_in_opentrackio_and_negative_in_freed(tmp_path: Path) -> None:
    whole = exported.reconstruction()
    assert whole.refined[1] is not None
    left = replace(whole.refined[1], pan_rad=whole.refined[1].pan_rad + np.deg2rad(5.0))
    before, after = (
        Take(replace(whole, refined=(whole.refined[0], track, *whole.refined[2:])))
        for track in (whole.refined[1], left)
    )
    pans: list[list[float]] = []
    for k, take in enumerate((before, after)):
        folder = tmp_path / str(k)
        lines = sorted(p for p in formats.write(take, "opentrackio", folder) if p.suffix == ".jsonl")
        named = next(path for path in lines if path.stem.endswith("b_c_2"))
        messages = next(p for p in formats.write(take, "freed", folder) if p.name.endswith("b_c_2.d1"))
        sample = json.loads(named.read_text().splitlines()[0])
        pans.append([sample["transforms"][0]["rotation"]["pan"], parsed(messages.read_bytes()[:29])["pan"]])
    change = (np.array(pans[1]) - pans[0] + 180.0) % 360.0 - 180.0
    np.testing.assert_allclose(change, [5.0, -5.0], atol=0.1)


def parsed(message: bytes) -> dict[str, float]:
    """A D1 message by the protocol's manual."""
    assert len(message) == 29
    assert message[0] == 0xD1
    assert (0x40 - sum(message[:28])) % 256 == message[28]

    def signed(start: int) -> int:
        value = int.from_bytes(message[start : start + 3], "big")
        return value - 2**24 if value >= 2**23 else value

    names = ("pan", "tilt", "roll", "x", "y", "z")
    values = {name: signed(2 + 3 * k) / (32768 if k < 3 else 64) for k, name in enumerate(names)}
    return {**values, "camera": message[1], "zoom": int.from_bytes(message[20:23], "big")}


def freed_pixels(found: dict[str, float], table: pd.DataFrame, points: Array) -> Array:
    """Pixels of points by a message and the zoom table: pan and roll clockwise, from above and from behind."""
    rotation = about(2, -found["pan"]) @ about(0, found["tilt"]) @ about(1, found["roll"])
    place = np.array([found["x"], found["y"], found["z"]]) / 1000.0
    right, forward, up = ((points - place) @ rotation).T
    at = {name: np.interp(found["zoom"], table["zoom"], table[name]) for name in table.columns}
    x, y = right / forward, -up / forward
    bent = 1 + at["k1"] * (x * x + y * y)
    return np.column_stack(
        [at["principal_x_px"] + at["focal_px"] * bent * x, at["principal_y_px"] + at["focal_px"] * bent * y]
    )


def test_freed(tmp_path: Path) -> None:
    files = formats.write(exported.take(), "freed", tmp_path)
    for number, stem in enumerate(("Sud_1", "b_c_2", "b_c_3", "4")):
        content = next(path for path in files if path.name.endswith(f"{stem}.d1")).read_bytes()
        table = pd.read_csv(next(path for path in files if path.name.endswith(f"{stem}_zoom.csv")))
        messages = [parsed(content[29 * frame : 29 * frame + 29]) for frame in range(FRAMES)]
        assert len(content) == 29 * FRAMES
        assert {message["camera"] for message in messages} == {number + 1}
        for frame, message in enumerate(messages):
            if (number, frame) == (0, LOST):
                assert message == messages[frame - 1]
                continue
            # what 24 bits of angle and place, 16 of zoom, and a straight line between rows of the table leave
            found = freed_pixels(message, table, exported.joints(frame))
            np.testing.assert_allclose(found, truth(number, frame), atol=PIXELS)


def test_freed_is_sent_by_udp_at_the_rate_of_the_take() -> None:
    pauses: list[float] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listening:
        listening.bind(("127.0.0.1", 0))
        listening.settimeout(5.0)
        sent = freed.send(exported.take(), "127.0.0.1", listening.getsockname()[1], pauses.append)
        assert sent == FRAMES
        heard = [parsed(listening.recv(64)) for _ in range(4 * FRAMES)]
    assert [message["camera"] for message in heard] == [1.0, 2.0, 3.0, 4.0] * FRAMES
    assert pauses[-1] == pytest.approx((FRAMES - 1) / float(RATE), abs=0.2)


def test_freed_reaches_so_far(tmp_path: Path) -> None:
    whole = exported.reconstruction()
    far = np.diag([1.0, 1.0, 1.0, 1.0])
    far[0, 3] = 200.0
    heads = tuple(None if head is None else replace(head, world_T_head=far) for head in whole.cameras)
    with pytest.raises(PzcapError, match="131 m"):
        formats.write(Take(replace(whole, cameras=heads)), "freed", tmp_path)


def test_soccernet(tmp_path: Path) -> None:
    """By the definition of its development kit: the world's z down, tilt 90 level, pan to the right."""
    formats.write(exported.take(), "soccernet", tmp_path)
    for number, stem in enumerate(("Sud_1", "b_c_2", "b_c_3", "4")):
        paths = sorted((tmp_path / stem).glob("camera_*.json"))
        assert len(paths) == FRAMES - (number == 0)
        for path in paths:
            frame, read = int(path.stem.rpartition("_")[2]), json.loads(path.read_text())
            orientation = (
                about(2, read["pan_degrees"]) @ about(0, read["tilt_degrees"]) @ about(2, read["roll_degrees"])
            )
            assert abs(read["roll_degrees"]) < 90.0
            points = exported.joints(frame) * [1.0, -1.0, -1.0]
            x, y, z = ((points - read["position_meters"]) @ orientation).T
            matrix = np.diag([read["x_focal_length"], read["y_focal_length"], 1.0])
            matrix[:2, 2] = read["principal_point"]
            k1, k2, k3, k4, k5, k6 = read["radial_distortion"]
            coefficients = np.array(
                [k1, k2, *read["tangential_distortion"], k3, k4, k5, k6, *read["thin_prism_distortion"]]
            )
            seen = np.column_stack([x, y, z])
            found = cv2.projectPoints(seen, np.zeros(3), np.zeros(3), matrix, coefficients)[0][:, 0]
            np.testing.assert_allclose(found, truth(number, frame), atol=PIXELS)


def test_chan(tmp_path: Path) -> None:
    """By Nuke's definition: y up, looking along -z, turned about z, then x, then y. No lens but a field of view: the
    principal point is taken from the table beside, and the take has a lens that does not bend."""
    files = formats.write(exported.take(0.0), "chan", tmp_path)
    for number, stem in enumerate(("Sud_1", "b_c_2", "b_c_3", "4")):
        rows = np.loadtxt(next(p for p in files if p.name.endswith(f"{stem}.chan")))
        table = pd.read_csv(next(p for p in files if p.name.endswith(f"camera_{stem}.csv")))
        assert rows.shape == (FRAMES - (number == 0), 8)
        for frame_number, *place, x, y, z, field in rows:
            frame = int(frame_number) - 1
            rotation = about(1, y) @ about(0, x) @ about(2, z)
            points = exported.joints(frame) @ [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]
            right, up, back = ((points - place) @ rotation).T
            focal = HEIGHT / 2 / np.tan(np.deg2rad(field) / 2)
            offset = table.loc[frame, ["principal_x_px", "principal_y_px"]].to_numpy(float)
            found = np.column_stack([focal * right / -back, focal * -up / -back]) + offset
            np.testing.assert_allclose(found, truth(number, frame, 0.0), atol=PIXELS)


def test_the_table_beside_holds_what_a_format_loses(tmp_path: Path) -> None:
    table = pd.read_csv(
        next(p for p in formats.write(exported.take(), "chan", tmp_path) if p.name.endswith("Sud_1.csv"))
    )
    camera, whole = exported.true_camera(0, 3), exported.reconstruction()
    row = table.loc[3]
    assert row["timecode"] == whole.timecodes[3]
    assert row["k1"] == pytest.approx(camera.k1)
    assert row["focal_px"] == pytest.approx(camera.focal_px)
    assert row["focal_sigma_px"] == pytest.approx(1e-3 * camera.focal_px)
    assert row["pan_sigma_deg"] == pytest.approx(np.rad2deg(1e-4))
    assert table["valid"].tolist() == [int(frame != LOST) for frame in range(FRAMES)]
    assert np.isnan(table.loc[LOST, "focal_px"])
    assert row["exposed_s"] == row["time_s"]
    assert row["pan_shear_deg"] == row["focal_shear_px"] == 0.0


def test_the_table_beside_tells_when_rows_were_exposed(tmp_path: Path) -> None:
    """A camera whose clock is 4 ms late, and whose shutter rolls while it turns and zooms."""
    whole = exported.reconstruction()
    head, track = whole.cameras[0], whole.refined[0]
    assert head is not None
    assert track is not None
    rolled = replace(track, shear=np.tile([0.002, -0.01], (FRAMES, 1)))
    late = replace(
        whole, cameras=(replace(head, clock_s=0.004), *whole.cameras[1:]), refined=(rolled, *whole.refined[1:])
    )
    paths = formats.write(Take(late), "chan", tmp_path)
    row = pd.read_csv(next(path for path in paths if path.name.endswith("Sud_1.csv"))).loc[3]
    assert row["exposed_s"] - row["time_s"] == pytest.approx(0.004)
    assert row["pan_shear_deg"] == pytest.approx(np.rad2deg(0.002))
    assert row["focal_shear_px"] == pytest.approx(-0.01 * row["focal_px"])


def test_a_take_without_cameras(tmp_path: Path) -> None:
    whole = exported.reconstruction()
    with pytest.raises(PzcapError, match="no camera was located"):
        formats.write(Take(replace(whole, cameras=(None,) * 4)), "colmap", tmp_path)
