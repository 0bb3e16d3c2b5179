"""Geometry of cameras: from a direction to a pixel and back. In reading order:

`lens` (distortion, the only place with its formula), `camera` (pan, tilt and zoom to pixels and rays), `parallax` (of a
centre beside the axis), `cylinder` (the panorama's), `pinhole` (a camera as kernels take it).
"""
