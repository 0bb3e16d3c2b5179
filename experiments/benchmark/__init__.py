"""The benchmark: captures that are frozen, methods that enter it, and the board. docs/benchmark.md.

`release` (conf/benchmark/VERSION.yaml: which captures there are), `make` (shoots them), `fingerprint` (are they those
of the release?), `methods` (those of this tree), `score` (a method's results on a split, an entry of the board),
`board` (the page). The score itself is `pzcap.scoring`.
"""
