"""Run by an environment that has Pose2Sim: its triangulation and filtering of the project in FOLDER, as it comes."""

import os
import sys

os.chdir(sys.argv[1])

from Pose2Sim import Pose2Sim  # noqa: E402

Pose2Sim.triangulation()
Pose2Sim.filtering()
