"""Comparisons, `python -m experiments.compare NAME`: variants on the same material, one `harness` for all.

`ablation` (error budget of the body), `operators` (pan and zoom against less), `keypoints` with `triangulation`,
`fixed_tools` (Pose2Sim and aniposelib on virtual fixed cameras), `detectors` (a hand, simulated ones, a real one),
`burden` (worth of what a crew brings), `forecast` (of `pzcap check`, and what is reached), `wrong_footage` (is its
cause named?), `treated_footage` (dates, bars, filters in it: what each costs), `peers` (other people's ways to pan and
zoom), `self_calibration` with its `baselines`.
"""
