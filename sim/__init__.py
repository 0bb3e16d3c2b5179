"""The simulator: films what a crew would bring home (``capture/``) and writes the truth beside it (``truth/``).

It knows the library's types and files and none of its mathematics. Read it in this order: `session` (the configuration
and what is set up from it), `shoot` (films a session), then its parts `cameras`, `people`, `hall` and `motion`; `truth`
(the record of how it was) and `collect_truth` (makes it). `scene` is the MuJoCo model, `capture_cache` keeps captures
on disk, `restage` takes further pictures of a shoot.
"""

import os

# MuJoCo loads the GL library that MUJOCO_GL names as soon as it is imported, and a missing one ends in a traceback from
# deep inside. So the wish is taken out of its sight; `sim.cameras.render` tries it when pictures are needed, and not
# before.
GL_BACKEND = os.environ.pop("MUJOCO_GL", "").lower().strip() or "egl"
