"""Pan and zoom of a frame on its panorama. In reading order:

`localise` leads; `photometric_alignment` (the fit of grey values) on `panorama_sampler` (rays and samples),
`frame_pixels` (what is compared), `frame_prior` and `alignment_equations`; `coarse_search` (where nothing is known),
`feature_search` (from matches, eq. 11); `covariance` (what a frame does not show of itself), `duplicate_frames`
(pictures that are the one before); `tuning` (constants).
"""
