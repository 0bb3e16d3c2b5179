"""Records to Rerun, the only package that knows it.

`recording` (events as they come), `columns` (what is known at the end), `layouts` (what the viewer shows), `window` (a
viewer of its own), `drawing` (figures, colours and panoramas as they are drawn).
"""
