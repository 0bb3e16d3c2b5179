"""`pzcap marker-cube`: the calibration object to print, true to size, and the object.json that says where it is.

Four upright faces, nine markers each, about the origin of the world, on the floor. PDF is written here: filled
rectangles and a line of text are all that a sheet is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

import cv2
import numpy as np

from pzcap.io.files import write_bytes, write_json
from pzcap.types import Array, Marker, PzcapError

DICTIONARY: Final = "DICT_4X4_50"
CELLS: Final = 6  # cells of a marker along an edge: four of the pattern, and the black frame
EDGE_RANGE_M: Final = (0.2, 8.0)
_POINTS_PER_M: Final = 72.0 / 0.0254
_LARGEST_M: Final = 14400 / _POINTS_PER_M  # the largest sheet that PDF knows


class Layout(NamedTuple):
    """Markers on a face."""

    pitch: float = 0.33  # distance of the centres of neighbouring markers, of the edge of the cube
    marker: float = 0.25  # edge of a marker, of the edge of the cube
    quiet: float = 0.75  # white about a marker, in cells: half a cell is needed


_LAYOUT: Final = Layout()


@dataclass(frozen=True, slots=True)
class Cube:
    """A cube of markers that stands on the floor about the origin."""

    edge_m: float = 2.0

    def __post_init__(self) -> None:
        low, high = EDGE_RANGE_M
        if not low <= self.edge_m <= high:
            raise PzcapError(f"--edge {self.edge_m:g}: a cube of {low:g} to {high:g} m can be seen and be printed")

    @property
    def marker_m(self) -> float:
        """Edge of a marker."""
        return _LAYOUT.marker * self.edge_m

    @property
    def sheet_m(self) -> float:
        """Edge of a sheet, a marker and the white about it."""
        return self.marker_m * (1.0 + 2.0 * _LAYOUT.quiet / CELLS)

    def markers(self) -> list[Marker]:
        """Markers 0 to 35: nine a face, from the top left in rows, the faces to -y, +x, +y and -x."""
        found = []
        for face, outward in enumerate(((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0))):
            normal, up = np.array(outward), np.array([0.0, 0.0, 1.0])
            right, centre = np.cross(up, normal), self.edge_m / 2 * (normal + up)
            for k in range(9):
                middle = centre + _LAYOUT.pitch * self.edge_m * ((k % 3 - 1) * right + (1 - k // 3) * up)
                signs = ((-1, 1), (1, 1), (1, -1), (-1, -1))
                corners = [middle + self.marker_m / 2 * (a * right + b * up) for a, b in signs]
                found.append(Marker(9 * face + k, np.array(corners)))
        return found

    def edges_m(self) -> Array:
        """(12, 2, 3) to draw."""
        h = self.edge_m / 2
        corners = [(x, y, z) for z in (0.0, self.edge_m) for x, y in ((-h, -h), (h, -h), (h, h), (-h, h))]
        pairs = [(i, (i + 1) % 4) for i in range(4)]
        pairs = [*pairs, *((a + 4, b + 4) for a, b in pairs), *((i, i + 4) for i in range(4))]
        return np.array(corners)[np.array(pairs)]


def write_cube(cube: Cube, folder: Path, *, replace: bool) -> int:
    """Write marker_cube.pdf and object.json into ``folder``; the exit status. PzcapError where there is an object.json,
    which somebody may have corrected, and it is not to be ``replace``d."""
    markers, measured = cube.markers(), folder / "object.json"
    if measured.exists() and not replace:
        raise PzcapError(f"{measured}: is there already, and may have been corrected by hand; give --replace, or --out")
    write_bytes(folder / "marker_cube.pdf", pdf([_sheet(cube, marker) for marker in markers], cube.sheet_m))
    content = {
        "dictionary": DICTIONARY,
        "markers": [{"id": marker.id, "corners_m": np.round(marker.corners_m, 6).tolist()} for marker in markers],
        "wireframe_m": np.round(cube.edges_m(), 6).tolist(),
    }
    write_json(measured, content, indent=None)
    print(f"{folder / 'marker_cube.pdf'}: {len(markers)} sheets of {100 * cube.sheet_m:.1f} cm, to print at 100 %")
    print(f"{measured}: where their corners are on a cube of {cube.edge_m:g} m, on the floor")
    print("print flat and matt; measure what you have built, and correct object.json where it is off by a millimetre")
    return 0


def black_cells(number: int) -> list[tuple[int, int, int]]:
    """Row, first column and length of every run of black cells of a marker."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, DICTIONARY))
    image = cv2.aruco.generateImageMarker(dictionary, number, CELLS)
    runs = []
    for row in range(CELLS):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], image[row] < 128, [0]]).astype(int)))
        runs += [(row, int(start), int(stop - start)) for start, stop in edges.reshape(-1, 2)]
    return runs


def _sheet(cube: Cube, marker: Marker) -> str:
    """The drawing of one sheet, in points from its lower left."""
    cell = cube.marker_m / CELLS * _POINTS_PER_M
    quiet, height = _LAYOUT.quiet * cell, cube.sheet_m * _POINTS_PER_M
    lines = ["0 g"]
    for row, column, length in black_cells(marker.id):
        lines.append(
            f"{quiet + column * cell:.4f} {height - quiet - (row + 1) * cell:.4f} {length * cell:.4f} {cell:.4f} re"
        )
    face, place = divmod(marker.id, 9)
    text = (
        f"marker {marker.id}, face {['-y', '+x', '+y', '-x'][face]}, row {place // 3 + 1} from the top, "
        f"column {place % 3 + 1} from the left; black {1000 * cube.marker_m:.1f} mm"
    )
    size = min(0.2 * quiet, 0.9 * (height - 2 * quiet) / len(text) / 0.5)
    return "\n".join([*lines, "f", f"0.6 g BT /F1 {size:.3f} Tf {quiet:.3f} {0.15 * quiet:.3f} Td ({text}) Tj ET"])


def pdf(drawings: Sequence[str], edge_m: float) -> bytes:
    """A PDF of square sheets, a page for each of ``drawings``."""
    if edge_m > _LARGEST_M:
        raise PzcapError(
            f"a sheet of {edge_m:.2f} m is larger than PDF knows ({_LARGEST_M:.2f} m); give a smaller --edge"
        )
    edge = f"{edge_m * _POINTS_PER_M:.4f}"
    pages = " ".join(f"{4 + 2 * k} 0 R" for k in range(len(drawings)))
    objects = [
        "<< /Type /Catalog /Pages 2 0 R >>",
        f"<< /Type /Pages /Kids [{pages}] /Count {len(drawings)} >>",
        "<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
    ]
    for k, drawing in enumerate(drawings):
        resources = "/Resources << /Font << /F1 3 0 R >> >>"
        box = f"/MediaBox [0 0 {edge} {edge}]"
        objects.append(f"<< /Type /Page /Parent 2 0 R {box} {resources} /Contents {5 + 2 * k} 0 R >>")
        objects.append(f"<< /Length {len(drawing) + 1} >>\nstream\n{drawing}\nendstream")
    content, places = "%PDF-1.4\n", []
    for number, each in enumerate(objects, start=1):
        places.append(len(content))
        content += f"{number} 0 obj\n{each}\nendobj\n"
    table = "".join(f"{place:010} 00000 n \n" for place in places)
    trailer = f"trailer\n<< /Size {len(objects) + 1} /Root 1 0 R >>\nstartxref\n{len(content)}\n%%EOF\n"
    return (content + f"xref\n0 {len(objects) + 1}\n0000000000 65535 f \n{table}{trailer}").encode("ascii")
