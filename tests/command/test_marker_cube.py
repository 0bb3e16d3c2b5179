"""The cube to print: a sheet has its size, a marker on it is found, and object.json says where it hangs."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pypdfium2
import pytest

from pzcap.command.main import main
from pzcap.command.marker_cube import Cube
from pzcap.io.manifest import read_object
from sim.hall.gym import calibration_object


def test_it_is_the_cube_of_the_documentation() -> None:
    """Nine markers of 0.5 m on each face of a cube of 2 m: what the simulator hangs up."""
    for ours, known in zip(Cube().markers(), calibration_object().markers, strict=True):
        assert ours.id == known.id
        np.testing.assert_allclose(ours.corners_m, known.corners_m, atol=1e-9)
    np.testing.assert_allclose(Cube().edges_m(), calibration_object().wireframe_m, atol=1e-9)


@pytest.mark.parametrize("edge", [0.6, 2.0])
def test_a_print_is_found_and_has_its_size(edge: float, tmp_path: Path) -> None:
    assert main(["marker-cube", "--out", str(tmp_path), "--edge", str(edge)]) == 0
    markers = read_object(tmp_path / "object.json").markers
    document = pypdfium2.PdfDocument(tmp_path / "marker_cube.pdf")
    assert len(document) == len(markers) == 36
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50))
    for number in (0, 7, 22, 35):
        page = document[number]
        metres = page.get_width() / 72 * 0.0254
        image = page.render(scale=600 / page.get_width()).to_numpy()
        corners, ids, _ = detector.detectMarkers(np.ascontiguousarray(image[..., :3]))
        assert ids is not None
        assert ids.ravel().tolist() == [number]
        found = corners[0][0]  # from the marker's own top left, clockwise
        side = np.linalg.norm(np.diff(np.vstack([found, found[:1]]), axis=0), axis=1)
        true = np.linalg.norm(markers[number].corners_m[1] - markers[number].corners_m[0])
        np.testing.assert_allclose(side * metres / image.shape[1], true, rtol=0.01)
        assert found[0, 0] < found[1, 0]
        assert found[0, 1] < found[3, 1]
        assert f"marker {number}, face" in page.get_textpage().get_text_bounded()


def test_a_face_is_read_from_the_left_as_one_stands_before_it() -> None:
    for face, outward in enumerate(((0, -1), (1, 0), (0, 1), (-1, 0))):
        first, second, fourth = (Cube().markers()[9 * face + k].corners_m.mean(axis=0) for k in (0, 1, 3))
        to_the_right = np.cross([0, 0, 1], [*outward, 0])
        np.testing.assert_allclose(second - first, 0.66 * to_the_right, atol=1e-9)
        np.testing.assert_allclose(fourth - first, [0, 0, -0.66], atol=1e-9)


def test_a_cube_that_cannot_be(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["marker-cube", "--out", str(tmp_path), "--edge", "20"]) == 1
    assert "a cube of 0.2 to 8 m" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_an_object_that_was_corrected_by_hand_is_not_written_over(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "object.json").write_text("corrected")
    assert main(["marker-cube", "--out", str(tmp_path)]) == 1
    assert "give --replace, or --out" in capsys.readouterr().err
    assert (tmp_path / "object.json").read_text() == "corrected"
    assert main(["marker-cube", "--out", str(tmp_path), "--replace"]) == 0
    assert (tmp_path / "object.json").read_text() != "corrected"
