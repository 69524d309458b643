"""A pytest plugin that notes which functions of the package the tests enter, in this process.

`ENTERED` in the environment names the JSON file: processor time of the whole session [s], and per module the first
lines of its functions that were entered.
"""

import json
import os
import sys
import threading
import time
from collections import defaultdict
from pathlib import Path

import plough_opt

PACKAGE = str(Path(plough_opt.__file__).parent)
_codes = {}


def _note(frame, _event, _argument):
    code = frame.f_code
    _codes[id(code)] = code  # by identity, which is quick; no value is returned, so lines inside are not traced


def pytest_sessionfinish():
    """Write what was entered."""
    sys.settrace(None)
    threading.settrace(None)
    modules = defaultdict(set)
    for code in list(_codes.values()):
        if code.co_filename.startswith(PACKAGE):
            modules[os.path.relpath(code.co_filename, PACKAGE)].add(code.co_firstlineno)
    told = {"seconds": time.process_time(), "entered": {name: sorted(lines) for name, lines in modules.items()}}
    Path(os.environ["ENTERED"]).write_text(json.dumps(told), encoding="utf-8")


threading.settrace(_note)
sys.settrace(_note)
