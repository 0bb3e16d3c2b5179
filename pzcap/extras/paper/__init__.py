"""The method of the paper, for comparison: `method` puts together `unfolding` (eq. 6), `stitching`, `similarity` (eq.
15)."""
