"""Entry point of `plough-opt` and `python -m plough_opt`."""

import sys


def main() -> int:
    """Import the command line and run it; return the exit status."""
    try:
        from plough_opt.app.main import main as run  # may take seconds, in which Ctrl-C must print no traceback

        return run()
    except KeyboardInterrupt:
        print("stopped: no file was written", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
