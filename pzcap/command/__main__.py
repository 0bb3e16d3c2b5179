"""`python -m pzcap.command`, where the script `pzcap` is not on the path."""

import sys

from pzcap.command.main import main

sys.exit(main())
