"""The skin that the tracker wears: a closed mesh of elliptical rings about every segment, from tape measurements.

A ring is an ellipse across the segment's axis; its perimeter is the girth that was measured there. Between two
measured girths the half axes are interpolated (monotone cubics, so no ring bulges beyond its neighbours), and both
ends are rounded off. The shape between the measurements (depth over width of a cross section, where along a limb it
is thickest) is that of an average adult and the same for everybody.

Source
    R. Butler et al., *Arch height index measurement system*, J. American Podiatric Medical Association 98 (2008): at
    half its length the back of a foot that bears weight stands as high as 0.34 of the length from heel to ball, a
    quarter of the whole. To be checked: entered from memory.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.special import ellipe

from pzcap.types import SEGMENTS, THORAX_FRACTION, Array, Indices

RING_SPACING_M = 0.022
POINT_SPACING_M = 0.028
_CAP_RINGS = 4


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """Vertices with outward normals in their segment's frame, and the triangles between them.

    Points and normals lie in memory a coordinate after the other, so that kernels fill whole vectors with them.
    """

    points_m: Array  # (V, 3)
    normals: Array  # (V, 3) unit
    segment: Indices  # (V,) index into SEGMENTS
    area_m2: Array  # (V,) of skin that the vertex stands for
    faces: Indices  # (F, 3) counter-clockwise seen from outside
    edges: Indices  # (E, 2) the rings and the lines along the segment; every edge lies in one segment

    @staticmethod
    def of(points_m: Array, segment: Indices, faces: Indices, edges: Indices) -> Surface:
        """The surface of a mesh."""
        normals, area = vertex_normals(points_m, faces)
        return Surface(np.asfortranarray(points_m), np.asfortranarray(normals), segment, area, faces, edges)

    def scaled(self, ratio: float) -> Surface:
        """The same mesh so many times as large: its normals stay."""
        return replace(self, points_m=ratio * self.points_m, area_m2=ratio**2 * self.area_m2)

    def moved(self, points_m: Array) -> Surface:
        """The same mesh with its vertices elsewhere."""
        return Surface.of(points_m, self.segment, self.faces, self.edges)


def vertex_normals(points_m: Array, faces: Indices) -> tuple[Array, Array]:
    """Unit normals (V, 3) of the vertices of a mesh, and the area (V,) that each stands for."""
    a, b, c = (points_m[faces[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)  # of length twice the triangle's area
    normals, area = np.zeros_like(points_m), np.zeros(len(points_m))
    for k in range(3):
        np.add.at(normals, faces[:, k], across)
        np.add.at(area, faces[:, k], np.linalg.norm(across, axis=1) / 6.0)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True).clip(1e-12), area


@dataclass(frozen=True, slots=True)
class _Station:
    """One measured cross section: where along the axis, how deep over wide, its girth, its centre beside the axis."""

    along_m: float
    girth_m: float
    depth_over_width: float = 1.0
    forward_m: float = 0.0


def ellipse_half_axes(girth_m: float, depth_over_width: float) -> tuple[float, float]:
    """Half axes (depth, width) of the ellipse with this perimeter and this ratio of its axes."""
    scale = girth_m / _perimeter(depth_over_width, 1.0)
    return scale * depth_over_width, scale


def _perimeter(depth: float, width: float) -> float:
    """Perimeter of the ellipse with these half axes."""
    short, long = min(depth, width), max(depth, width)
    return 4.0 * long * float(ellipe(1.0 - (short / long) ** 2))


def _stations(m: Mapping[str, float], skirt_m: float) -> dict[str, tuple[Array, list[_Station], float, float]]:
    """Per segment: the frame of its rings, its cross sections in ascending order, and how far each cap stands out.

    The frame's columns are where a ring's depth, width and axis point in the segment's: right-handed. A skirt,
    which stands ``skirt_m`` off the skin (0: none), is part of the pelvis: down to the middle of the thighs, as wide as
    the hips.
    """
    # widened by its room, as all cloth is, it ends at the middle of the thighs
    hem = _Station(min(skirt_m - 0.5 * m["thigh"], -0.09), m["girth_hips"], 0.80)
    trunk, thorax_length = m["trunk"], (1.0 - THORAX_FRACTION) * m["trunk"]
    shoulder = thorax_length - m["shoulder_drop"]
    up, down = np.eye(3), np.diag([1.0, -1.0, -1.0])  # limbs hang: depth stays forward, so width turns over
    ahead = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])  # the foot: depth is up, the axis ahead
    table: dict[str, tuple[Array, list[_Station], float, float]] = {
        "pelvis": (up, [
            hem if skirt_m else _Station(-0.09, 0.80 * m["girth_hips"], 0.72),
            _Station(0.00, m["girth_hips"], 0.72),
            _Station(0.13 * trunk, 0.97 * m["girth_hips"], 0.70),
            _Station(0.27 * trunk, 1.03 * m["girth_waist"], 0.72),
        ], 0.04, 0.04),
        "lumbar": (up, [
            _Station(-0.02 * trunk, 1.02 * m["girth_waist"], 0.72),
            _Station(0.10 * trunk, m["girth_waist"], 0.72),
            _Station(0.30 * trunk, 0.94 * m["girth_chest"], 0.72),
        ], 0.04, 0.04),
        "thorax": (up, [
            _Station(-0.02 * trunk, 0.93 * m["girth_chest"], 0.72),
            _Station(0.45 * thorax_length, m["girth_chest"], 0.70),
            _Station(shoulder, 0.94 * m["girth_chest"], 0.55),
            _Station(shoulder + 0.6 * m["shoulder_drop"], 0.60 * m["girth_chest"], 0.55),
            _Station(thorax_length, 1.1 * m["girth_neck"], 0.9),
        ], 0.04, 0.01),
        "head": (up, [
            _Station(-0.01, m["girth_neck"], 1.0),
            _Station(0.25 * m["head"], m["girth_neck"], 1.0, 0.01),
            _Station(0.42 * m["head"], 0.86 * m["girth_head"], 1.1, 0.015),
            _Station(0.66 * m["head"], m["girth_head"], 1.25, 0.015),
            _Station(0.84 * m["head"], 0.86 * m["girth_head"], 1.25, 0.01),
            _Station(0.95 * m["head"], 0.52 * m["girth_head"], 1.25, 0.0),
        ], 0.02, 0.05 * m["head"]),
    }  # fmt: skip
    # the acromion stands 2 to 3.5 cm above the joint (sources: `pzcap.body.anthropometry`), and little on top of it
    upper_arm = (down, [
        _Station(-0.01, 1.08 * m["girth_upper_arm"]),
        _Station(0.35 * m["upper_arm"], m["girth_upper_arm"]),
        _Station(m["upper_arm"], m["girth_elbow"]),
    ], 0.028, 0.03)  # fmt: skip
    forearm = (down, [
        _Station(0.0, m["girth_elbow"]),
        _Station(0.22 * m["forearm"], m["girth_forearm"]),
        _Station(m["forearm"], m["girth_wrist"], 0.87),
    ], 0.03, 0.02)  # fmt: skip
    # Palms face back in the zero pose, so that hands are broad from left to right, and wrists with them. A hand was
    # measured stretched, and nobody holds his fingers straight: bent a little they reach a twelfth less.
    hand = (down, [
        _Station(0.0, m["girth_wrist"], 0.83),
        _Station(0.35 * m["hand"], 1.15 * m["girth_wrist"], 0.38),
        _Station(0.65 * m["hand"], 0.95 * m["girth_wrist"], 0.33),
        _Station(0.86 * m["hand"], 0.55 * m["girth_wrist"], 0.33),
    ], 0.02, 0.06 * m["hand"])  # fmt: skip
    thigh = (down, [
        _Station(-0.03, 0.97 * m["girth_thigh"]),
        _Station(0.15 * m["thigh"], m["girth_thigh"]),
        _Station(0.60 * m["thigh"], 0.5 * (m["girth_thigh"] + m["girth_knee"])),
        _Station(m["thigh"], m["girth_knee"]),
    ], 0.05, 0.04)  # fmt: skip
    shank = (down, [
        _Station(0.0, m["girth_knee"]),
        _Station(0.12 * m["shank"], 0.95 * m["girth_knee"]),
        _Station(0.32 * m["shank"], m["girth_calf"]),
        _Station(0.75 * m["shank"], 0.5 * (m["girth_ankle"] + 0.8 * m["girth_calf"])),
        _Station(m["shank"], m["girth_ankle"], 1.2),
    ], 0.04, 0.03)  # fmt: skip
    # a foot's rings stand across x: "depth" is its height, "forward" how far its middle is above the ankle; the ball's
    # height and all widths are by hand
    sole, length = -m["ankle_height"], m["foot"]

    def foot_ring(x: float, top: float, width: float) -> _Station:
        depth, across = (top - sole) / 2, width / 2
        return _Station(x, _perimeter(depth, across), depth / across, (top + sole) / 2)

    foot = (ahead, [
        foot_ring(-0.22 * length, 0.35 * sole, 0.20 * length),
        foot_ring(-0.10 * length, 0.0, 0.27 * length),
        foot_ring(0.08 * length, 0.0, 0.28 * length),
        foot_ring(0.25 * length, sole + 0.25 * length, 0.33 * length),
        foot_ring(0.46 * length, sole + 0.16 * length, 0.37 * length),
        foot_ring(0.68 * length, 0.70 * sole, 0.30 * length),
    ], 0.03 * length, 0.07 * length)  # fmt: skip
    for side in ("left_", "right_"):
        table |= {side + "upper_arm": upper_arm, side + "forearm": forearm, side + "hand": hand}
        table |= {side + "thigh": thigh, side + "shank": shank, side + "foot": foot}
    return table


def build_surface(measurements_m: Mapping[str, float], skirt_m: float = 0.0) -> Surface:
    """The skin of a person with these tape measurements (keys ``pzcap.types.MEASUREMENTS``), in a skirt that
    stands ``skirt_m`` off it (0: in none)."""
    points, segment, faces, edges, count = [], [], [], [], 0
    table = _stations(measurements_m, skirt_m)
    for index, name in enumerate(SEGMENTS):
        frame, stations, near_cap_m, far_cap_m = table[name]
        vertices, triangles, lines = _loft(stations, near_cap_m, far_cap_m)
        points.append(vertices @ frame.T)
        segment.append(np.full(len(vertices), index))
        faces.append(triangles + count)
        edges.append(lines + count)
        count += len(vertices)
    return Surface.of(np.concatenate(points), np.concatenate(segment), np.concatenate(faces), np.concatenate(edges))


def girths_along(measurements_m: Mapping[str, float], count: int, skirt_m: float) -> dict[str, Array]:
    """Girths (count,) of every segment by name, evenly spaced from its lower end to its upper (of a foot: from the heel
    to the toes)."""
    found = {}
    for name, (frame, stations, near_cap_m, far_cap_m) in _stations(measurements_m, skirt_m).items():
        along, girths = (np.array(column) for column in zip(*((s.along_m, s.girth_m) for s in stations), strict=True))
        evenly = np.interp(np.linspace(along[0] - near_cap_m, along[-1] + far_cap_m, count), along, girths)
        found[name] = evenly if frame[:, 2].max() > 0.0 else evenly[::-1]
    return found


def _loft(stations: list[_Station], near_cap_m: float, far_cap_m: float) -> tuple[Array, Indices, Indices]:
    """Vertices (V, 3) with the axis along z and depth along x, triangles (F, 3) and edges (E, 2)."""
    along = np.array([s.along_m for s in stations])
    axes = np.array([ellipse_half_axes(s.girth_m, s.depth_over_width) for s in stations])
    shape = PchipInterpolator(along, np.column_stack([axes, [s.forward_m for s in stations]]))
    rings = max(3, round((along[-1] - along[0]) / RING_SPACING_M) + 1)
    z = np.linspace(along[0], along[-1], rings)
    depth, width, forward = shape(z).T
    # quarter circles on both ends; the poles themselves are single vertices
    turn = np.linspace(0.0, np.pi / 2, _CAP_RINGS + 1)[1:-1]
    z = np.concatenate([z[0] - near_cap_m * np.sin(turn[::-1]), z, z[-1] + far_cap_m * np.sin(turn)])
    shrink = np.concatenate([np.cos(turn[::-1]), np.ones(rings), np.cos(turn)])
    pad = len(turn)
    depth, width, forward = (np.pad(v, pad, mode="edge") for v in (depth, width, forward))
    girth = max(s.girth_m for s in stations)
    around = int(np.clip(2 * round(girth / POINT_SPACING_M / 2), 10, 28))
    phi = 2 * np.pi * np.arange(around) / around
    depths, widths = (shrink * depth)[:, None] * np.cos(phi), (shrink * width)[:, None] * np.sin(phi)
    ring = np.stack(np.broadcast_arrays(forward[:, None] + depths, widths, z[:, None]), axis=-1)
    poles = np.array([[forward[0], 0.0, along[0] - near_cap_m], [forward[-1], 0.0, along[-1] + far_cap_m]])
    vertices = np.concatenate([ring.reshape(-1, 3), poles])
    index = np.arange(len(z) * around).reshape(len(z), around)
    right = np.roll(index, -1, axis=1)
    a, b, c, d = index[:-1], right[:-1], right[1:], index[1:]
    near, far = len(vertices) - 2, len(vertices) - 1

    def rows(*columns: Indices | int) -> Indices:
        return np.stack(np.broadcast_arrays(*columns), axis=-1).reshape(-1, len(columns))

    ends = rows(right[0], index[0], near), rows(index[-1], right[-1], far)
    triangles = np.concatenate([rows(a, b, c), rows(a, c, d), *ends])
    return vertices, triangles, np.concatenate([rows(index, right), rows(a, d)])
