"""Mirrors the rooms."""

import experiments  # noqa: F401  (says how many threads linear algebra may have, before numpy is imported)
