"""Run by ``python -m classify``."""

import sys

from classify.cli.main import main

sys.exit(main())
