"""Pages and recordings of a run: `page` (report.html) of `plots` and `pictures`; `recording` (truth and errors) and
`bookmarks` (its worst frames)."""
