"""Files: footage in, results out. In reading order:

`files` (which paths are opened, and how), `manifest` (the capture's JSON files), `video` (frames and timecode),
`detections` (a detector's keypoints), `capture` (the whole folder, and its frame sets by timecode), `results` (the
reconstruction).
"""
