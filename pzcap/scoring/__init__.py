"""The score of cameras and motion against the truth, from files that a method in any language can write.

    pzcap-score RESULTS TRUTH            # every metric; docs/benchmark.md has the format
    pzcap-score --check RESULTS [TRUTH]  # what is wrong with the files, in one line each

Needs numpy alone: nothing of the estimator, the simulator or the experiments is imported. In reading order: `records`
(what a method says, and what is true), `projection` (the lens), `camera_errors`, `body_errors`, `score` (both, frame by
frame), `totals` (summed up to metrics), `tables`, `files` and `truth_files` (the format, and what is refused),
`suspicions` (what is read and probably not meant), `readers` (formats of others), `command`.
"""
