"""Views of a finished run: `page` (report.html) of `plots` and `pictures`; `recording` (truth and errors) and
`bookmarks` (its worst frames)."""
