"""The pages at 127.0.0.1 on which a hand poses the body, and marks lengths. docs/editor.md says how they are used.

`inverse_kinematics` solves a pose from clicks, `history` keeps every change, `keyframe_file` writes keyframes.json,
`motion_file` what was tracked anew. `footage` decodes frames, `edits` knows each of them, `workspace` has the commands
that change them, `resolve` tracks an interval anew. `showing` is what a page is told, `talk` what it says, `desk` the
threads that do it, `server` HTTP and WebSocket.

Of the other page, `lengths` keeps what is marked, `films` its pictures, `marking` serves it. Both stand on `door`, who
is let in; `alone`, one editor at a time; `paper`, a file that capture.json names; `on_demand`, frames that are kept.
"""
