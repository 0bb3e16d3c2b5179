"""Where each camera stands, and where it looks in every frame: stages 2 to 4. In the order in which they are best read:

Geometry
    `camera` (pan, tilt and zoom to pixels and rays), `cylinder` (eqs. 3-6).
Reference image
    `reference` (Tsai), `markers` (its pose from grey values).
Sweep and zoom run
    `features`, `sweep`, `zoom` and `matching` (which pixels of two frames show the same), `unknowns` (what is
    estimated), `bundle` (from matches), `direct` (from grey values), `panorama`; on request `superresolution` (what is
    within its pixels) and `crossfit` (where the sweep's frames then are); `calibration` leads through all.
A frame of the motion
    `panzoom` leads: `correlate` (where it may be), `solutions` (from matches; eq. 15), `align` (from grey values). That
    stands on `rays` (where pixels look, and what of the empty hall they see), `levels`, `sampling` and `robust`.
    `smooth` is for tracks that are finished.
"""
