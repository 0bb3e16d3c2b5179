"""The body and how it moves: stage 6. In the order in which they are best read:

Body
    `body` (skeleton, kinematics), `surface` (its skin), `rigid` (kernels), `keyframes` (poses set by hand).
What images say about a pose
    `views` (cut out around the body), `evidence` leads: `residuals` (brightness, contour), `landmarks` (keypoints),
    `raster` (what of the skin is seen), `complexion` (an arm before the trunk); and about the cameras: `aim`.
From frame to frame
    `tracking` leads, `following` takes a step; `limbs` finds a limb again, `touching` keeps arms out of the trunk.
Between two keyframes
    `interval` leads, in a process of its own (`elsewhere`): `merging` (two passes made one), `likeness` and
    `second_look` (a limb that both have lost), `shape` and `corrections` (the body, corrected), `polishing` with
    `trajectory`, `contact` and `flight` (all frames at once).
In the end
    `hindsight` (early frames with the body as it is known now), `advice` (on keyframes).
"""
