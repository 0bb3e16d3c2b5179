"""The people: the athlete who is filmed and the crew beside the cameras.

Read in this order: `anthropometry` (measurements and the tree of segments), `athlete` (the MuJoCo model of them),
`clothing` (its textures), `crew` (tape, keyframes, a walk through the sweep), `detector` (keypoints with errors),
`company` (others in the hall), `loose_clothing` (cloth and hair that lag and swing).
"""
