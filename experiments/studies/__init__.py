"""Sweeps: `jobs` (a folder a job, whole or not at all), `sweeper` (runs what is missing), `study` (their table),
`page`."""
