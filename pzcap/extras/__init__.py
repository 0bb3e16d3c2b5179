"""Parts that one comparison, one experiment or one tool needs; it imports the core, and nothing in the core imports it.

`reconstruct` (the pipeline with all of these), `paper` (the paper's own method), `superresolution` and `leave_half_out`
(the hall within pixels), `rts_smoother` (finished tracks smoothed), `keyframe_diagnostics` (keyframes judged, the next
one advised), `slide` (which way to slide a camera on its head).
"""
