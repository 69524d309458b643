"""Entry point of `plough-opt`, outside the package so that a Ctrl-C during its import prints no traceback."""

import sys


def main() -> int:
    """Import the command line and run it; return the exit status."""
    try:
        from plough_opt.app import main as run  # may take seconds

        return run()
    except KeyboardInterrupt:
        print("stopped: no file was written", file=sys.stderr)
        return 130
