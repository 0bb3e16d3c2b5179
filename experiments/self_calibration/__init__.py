"""Ours against self-calibration of a panning and zooming camera: see `experiments.self_calibration.__main__`."""
