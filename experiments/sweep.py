"""Run what is missing of a study, on as many cores or machines as the launcher has, and show it.

    python -m experiments.sweep study=noise|zoom_range|readout|...   # a file of conf/study
    python -m experiments.sweep study=noise method=exact,paper hydra/launcher=joblib  # any override of experiments.run

leaves in outputs/study/NAME a folder a job, runs.parquet and index.html. It is `python -m experiments.run -m`: what was
killed goes on where it was.
"""

from __future__ import annotations

import sys

from experiments import run


def main() -> int:
    """The command. Exit status 0, or 1 with a line on stderr for each job that failed."""
    sys.argv.insert(1, "--multirun")
    return run.main()


if __name__ == "__main__":
    sys.exit(main())
