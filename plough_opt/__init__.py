"""plough_opt: design of subsoiler ploughshares by optimisation with exact derivatives.

Units are SI and angles are in radians. Every physical function accepts floats, CasADi expressions and, where that makes
sense, NumPy arrays, and returns a result of the same type.
"""

import sys

# `python -m plough_opt` begins sys.path with the current folder, whose files would replace modules of their names.
# The name may follow other short options directly, as in -Bmplough_opt. No other module is imported before this.
if sys.argv[:1] == ["-m"] and not sys.flags.safe_path:
    _options, _, _name = sys.orig_argv[-len(sys.argv)].rpartition("plough_opt")
    if not _name and _options[:1] in ("", "-") and _options.find("m") == len(_options) - 1:
        del sys.path[0]

from typing import Any

import lazy_loader

# The public names are listed in __init__.pyi. Each is imported on first use: some need libraries that load slowly.
_imported, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    """Return a public name, or the version, which is read from the installed package."""
    if name == "__version__":
        from importlib.metadata import version

        return version("plough_opt")
    return _imported(name)
