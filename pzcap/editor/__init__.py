"""The editor of keyframes: a page at 127.0.0.1 on which a hand poses the body. docs/editor.md says how it is used.

`inverse_kinematics` solves a pose from clicks, `history` keeps every change, `keyframe_file` writes keyframes.json,
`footage` decodes frames, `workspace` brings them together, `resolve` tracks an interval anew, `server` serves the page.
"""
