"""The body, tracked between keyframes and solved between them. In reading order:

Settings
    `settings`; `tuning` holds constants that no user sets.
What images say of a pose
    `observation` (views cropped around the body), `pose_objective` leads: `residuals` (brightness, contour),
    `keypoint_residuals`, `visibility` (which skin is seen), `skin_appearance` (its brightness), `skin_colour_model` (a
    bare arm before the trunk); `camera_refinement` (the cameras, eliminated from it), `drape`
    (loose clothes, likewise).
From frame to frame
    `tracker` leads, `body_size` corrects the size of the whole body before all else, `frame_tracker` takes a step,
    `body_constraints` keeps the pose possible, `keyframes` checks what a hand has set.
Between two keyframes
    `interval_solver` leads, in the worker process (what it gets and gives back: `interval`): `bidirectional_fusion`
    (two passes made one), `limbs`, `appearance`, `reacquisition` and `limb_beam` (a limb that both have lost),
    `body_estimate` (the body as known so far), `batch_refinement` on `view_sequence` and `temporal_constraints` (all
    frames at once), `tracked_body` (how sure each joint is), `shape_refit` (early frames with the body as it is known
    in the end).
"""
