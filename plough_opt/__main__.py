"""`python -m plough_opt`: the command line."""

import sys

from plough_opt.cli import main

sys.exit(main())
