"""The body. In reading order: `skeleton` (from tape to segments and poses), `kinematics` (kernels of rigid motions),
`mesh` (the skin), `landmarks` (where a detector's keypoints lie on it), `shape_basis` and `shape_estimation` (its
correction)."""
