"""Forward kinematics of many poses at once, with Jacobians.

A pose has 43 degrees of freedom: the root's position (world), then for each segment, in the order of
`types.SEGMENTS`, a rotation vector in the segment's own frame (applied on the right), or the angle of a hinge.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from pzcap.types import HINGE_AXES, PARENTS, SEGMENTS, Array
from sim.people.anthropometry import Tree


def _chain(segment: int) -> tuple[int, ...]:
    """Return a segment and all that it hangs from."""
    chain = [segment]
    while PARENTS[chain[-1]] >= 0:
        chain.append(PARENTS[chain[-1]])
    return tuple(chain)


CHAINS: Final[tuple[tuple[int, ...], ...]] = tuple(_chain(s) for s in range(16))


def _slices() -> tuple[slice, ...]:
    slices, at = [], 3
    for name in SEGMENTS:
        width = 1 if name in HINGE_AXES else 3
        slices.append(slice(at, at + width))
        at += width
    return tuple(slices)


DOFS: Final[tuple[slice, ...]] = _slices()
"""Columns of each segment's joint; the root's position has columns 0 to 2."""
DOF: Final = 43


def skew(v: Array) -> Array:
    """Return the matrices (..., 3, 3) of the cross product with vectors (..., 3)."""
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2] = -v[..., 2], v[..., 1]
    out[..., 1, 0], out[..., 1, 2] = v[..., 2], -v[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -v[..., 1], v[..., 0]
    return out


def exp(v: Array) -> Array:
    """Return rotation matrices (..., 3, 3) of rotation vectors (..., 3)."""
    return Rotation.from_rotvec(v.reshape(-1, 3)).as_matrix().reshape(*v.shape, 3)


def log(r: Array) -> Array:
    """Return rotation vectors (..., 3) of rotation matrices (..., 3, 3)."""
    return Rotation.from_matrix(r.reshape(-1, 3, 3)).as_rotvec().reshape(r.shape[:-1])


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """Poses of a whole clip: roots (T, 3), rotations (T, 16, 3, 3) parent from segment, and where they put it."""

    tree: Tree
    roots_m: Array  # (T, 3)
    rotations: Array  # (T, 16, 3, 3) parent from segment; the pelvis: world from segment
    world: Array  # (T, 16, 3, 3) world from segment
    joints_m: Array  # (T, 16, 3)

    @classmethod
    def place(cls, tree: Tree, roots_m: Array, rotations: Array) -> Frames:
        """Run the forward kinematics."""
        world, joints = np.empty_like(rotations), np.empty(rotations.shape[:3])
        for s, parent in enumerate(PARENTS):
            if parent < 0:
                world[:, s], joints[:, s] = rotations[:, s], roots_m
            else:
                world[:, s] = world[:, parent] @ rotations[:, s]
                joints[:, s] = joints[:, parent] + world[:, parent] @ tree.offsets_m[s]
        return cls(tree, roots_m, rotations, world, joints)

    def moved(self, step: Array) -> Frames:
        """Return the poses after a step (T, 43) in the degrees of freedom."""
        vectors = np.zeros((len(step), 16, 3))
        for s, name in enumerate(SEGMENTS):
            if name in HINGE_AXES:
                vectors[:, s] = step[:, DOFS[s]] * np.array(HINGE_AXES[name])
            else:
                vectors[:, s] = step[:, DOFS[s]]
        return Frames.place(self.tree, self.roots_m + step[:, :3], self.rotations @ exp(vectors))

    def points(self, segment: int, local_m: Array) -> Array:
        """Return where (T, 3) a point fixed in a segment is."""
        return self.joints_m[:, segment] + self.world[:, segment] @ local_m

    def jacobian(self, segment: int, points_m: Array) -> Array:
        """Return d points / d dof (T, 3, 43) of points (T, 3) carried by a segment."""
        out = np.zeros((len(points_m), 3, DOF))
        out[:, :, :3] = np.eye(3)
        for s in CHAINS[segment]:
            self._fill(out, s, points_m - self.joints_m[:, s])
        return out

    def centre_of_mass(self) -> Array:
        """Return the centre of mass (T, 3)."""
        centres = self.joints_m + np.einsum("tsij,sj->tsi", self.world, self.tree.centres_m)
        return np.einsum("s,tsi->ti", self.tree.masses, centres)

    def centre_of_mass_jacobian(self) -> Array:
        """Return d centre of mass / d dof (T, 3, 43)."""
        centres = self.joints_m + np.einsum("tsij,sj->tsi", self.world, self.tree.centres_m)
        moments, masses = self.tree.masses[:, None] * centres, self.tree.masses.copy()
        for s in range(15, 0, -1):
            moments[:, PARENTS[s]] += moments[:, s]
            masses[PARENTS[s]] += masses[s]
        out = np.zeros((len(centres), 3, DOF))
        out[:, :, :3] = np.eye(3)
        for s in range(16):
            self._fill(out, s, moments[:, s] - masses[s] * self.joints_m[:, s])
        return out

    def _fill(self, out: Array, s: int, arms_m: Array) -> None:
        block = -skew(arms_m) @ self.world[:, s]
        name = SEGMENTS[s]
        out[:, :, DOFS[s]] = (block @ np.array(HINGE_AXES[name]))[:, :, None] if name in HINGE_AXES else block
