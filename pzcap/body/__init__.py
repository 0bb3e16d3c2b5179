"""The body. In reading order: `anthropometry` (what a tape has not measured), `skeleton` (measurements to segments),
`joint_limits`, `kinematics` (poses and rigid motions), `segment_equations` (from residuals of points to normal
equations of a pose), `mesh` (the skin), `landmarks` (where a detector's keypoints lie on it), `shape_basis` and
`shape_estimation` (its correction)."""
