"""One camera in the empty hall: reference image, sweep and zoom run to a panorama and a pan-zoom camera. In reading
order:

`settings`; `reference_camera` (Tsai) and `marker_pose`; `features`, `sweep` and `correspondences` (which pixels of two
frames show the same); `parameters` (what is estimated), `bundle_adjustment` (from matches),
`photometric_bundle_adjustment` (from grey values: `compared_pixels`, `grey_value_equations`); `stitching` (the
panorama); `calibrate` leads through all.
"""
