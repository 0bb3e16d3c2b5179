"""The cameras: from a pose in the hall to a video file.

Read in this order: `optics` (tripod, head and lens), `operator` (pan, zoom and tilt over time) or `trajectories` (the
same from a CSV file), `render` (pictures and masks by MuJoCo), `plate` (from such a picture to the image that the lens
makes), `sensor` (brightness to noisy grey levels), `film` (a camera that puts these together and records).
"""
