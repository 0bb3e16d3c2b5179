"""Materials of tests: footage, files, commands."""

import experiments  # noqa: F401  # first: of `python -m tests.scenes.stub_sweep` it sees that it is a command
