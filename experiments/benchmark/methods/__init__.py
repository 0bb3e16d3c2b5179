"""The methods of this tree that enter the benchmark: one capture in, plain results out, scored as anybody's are.

`rows` (which there are, and the tracks that they enter), `given` (what they get, and the form of their answer),
`cameras` and `bodies` (their runs).
"""
