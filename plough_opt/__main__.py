"""Entry point of `plough-opt` and `python -m plough_opt`."""

import gc
import os
import sys


def main() -> int:
    """Import the command line and run it; return the exit status."""
    # NumPy's and SciPy's linear algebra starts threads when it is imported, a fifth of the processor time of a short
    # command, which matrices of a few rows do not use.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    gc.disable()  # until all is imported: hundreds of passes would find nothing
    try:
        from plough_opt.app.main import main as run  # may take seconds, in which Ctrl-C must print no traceback

        return run()
    except KeyboardInterrupt:
        print("stopped: no file was written", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
