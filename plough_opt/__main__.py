"""Entry point of `python -m plough_opt`, the command line."""

import sys

from plough_opt.app import main

sys.exit(main())
