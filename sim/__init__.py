"""The simulator: what a crew would bring home, and the truth beside it."""

import os

# MuJoCo loads the GL library that MUJOCO_GL names as soon as it is imported, and a missing one ends in a traceback from
# deep inside. So the wish is taken out of its sight; `sim.cameras.render` tries it when pictures are needed, and not
# before.
GL_BACKEND = os.environ.pop("MUJOCO_GL", "").lower().strip() or "egl"
