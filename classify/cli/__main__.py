"""Run by ``python -m classify.cli``."""

import sys

from classify.cli.main import main

sys.exit(main())
