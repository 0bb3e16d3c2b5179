"""Silhouettes: `foreground` leads, `background_model` (hall, shadow or body, by colour), `parts` (which of it is the
athlete), `expected` (where the tracker has the body), `boundary_refinement` (the outline), `others` and `company`
(somebody else)."""
