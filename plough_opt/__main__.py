"""Entry point of `plough-opt` and `python -m plough_opt`."""

import gc
import os
import sys

# NumPy's and SciPy's linear algebra starts threads when it is imported, and wakes them for nothing in matrices of a few
# rows: a fifth of a short command's processor time.
_THREADS = ("OPENBLAS_NUM_THREADS", "1")


def main() -> int:
    """Import the command line and run it; return the exit status."""
    os.environ.setdefault(*_THREADS)
    gc.disable()  # until all is imported: hundreds of passes would find nothing
    try:
        from plough_opt.app.main import main as run  # may take seconds, in which Ctrl-C must print no traceback

        return run()
    except KeyboardInterrupt:
        print("stopped: no file was written", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
