"""Cameras without timecode: how their recordings of the motion lie to each other in time, by what they heard or saw.

Each way (`sound`, `flash`, `subject_motion`) gives for each pair of cameras how much later the one shows what the other
shows; `offsets` makes of these one offset a camera, and knows when they contradict each other.
"""
