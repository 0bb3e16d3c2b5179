"""Silhouettes: `foreground` leads, `background_model` (hall, shadow or body, by colour), `boundary_refinement` (the
outline)."""
