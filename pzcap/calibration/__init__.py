"""One camera in the empty hall: reference image, sweep and zoom run to a panorama and a pan-zoom camera. In reading
order:

`settings`; `reference_camera` (Tsai) and `marker_pose`; `features`, `sweep` and `correspondences` (which pixels of two
frames show the same); `parameters` (what is estimated) and `beliefs` (what is known of it before); `bundle_adjustment`
(from matches, on `transfer` and `link_sums`), `photometric_bundle_adjustment` (from grey values: `compared_pixels`,
`grey_value_equations`), `fitting` (one after the other) and `minima` (from either side of the axis); `stitching` (the
panorama); `calibrate` leads through all.
"""
