"""Keyframes without a hand: the athlete's pose from a detector's keypoints in views that are localised.

`people` tells the athlete from others and left from right, `triangulation` intersects the rays, `limb_poses` makes a
first pose of the points, `pose_fit` fits the articulated body to the keypoints of all frames and says how well each
pose is known, `selection` chooses the frames that become keyframes, and `keyframes` runs them one after the other.
"""
