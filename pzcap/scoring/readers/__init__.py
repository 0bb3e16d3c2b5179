"""Readers of other programs' files, as they are: `colmap` and `soccernet` (cameras), `trc`, `c3d` and `bvh` (bodies).

`read` finds out which it is. Each reader turns its own conventions into those of `pzcap.types`; what a file does not
say (axes, unit, names of joints, number of the first frame) comes from `Conventions`.
"""
