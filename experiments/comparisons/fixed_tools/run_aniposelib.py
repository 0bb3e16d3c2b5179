"""Run by an environment that has aniposelib: FOLDER with calibration.toml and keypoints.npz to places, as JSON."""

import json
import sys

import numpy as np
from aniposelib.cameras import CameraGroup

cameras = CameraGroup.load(f"{sys.argv[1]}/calibration.toml")
arrays = np.load(f"{sys.argv[1]}/keypoints.npz")
count, frames, rows, _ = arrays["points"].shape
places = cameras.triangulate(arrays["points"].reshape(count, -1, 2), progress=False)
print(json.dumps({"names": cameras.get_names(), "places": places.reshape(frames, rows, 3).tolist()}))
