"""What a run leaves to look at: `page` (report.html) of `plots` and `pictures`; `recording` (truth and errors) and
`bookmarks` (its worst frames)."""
