"""Limbs that silhouettes do not show: `skin_colour_model` (a bare arm before the trunk), `search` (where else a limb
could be)."""
