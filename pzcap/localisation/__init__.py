"""Pan and zoom of a frame on its panorama. In reading order:

`localise` leads; `photometric_alignment` (from grey values) on `panorama_sampler` (rays and samples); `coarse_search`
(where nothing is known), `panzoom_solvers` (from matches, eq. 11); `covariance` (what a frame does not show of itself).
"""
