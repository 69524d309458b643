"""`load`: saved results of every kind, read back as objects of their class."""

from importlib import import_module
from pathlib import Path
from typing import Any, Final

from plough_opt.core.checks import path_of, shown
from plough_opt.core.errors import InputError
from plough_opt.core.saving import Saveable, read_result

# First bytes of an SQLite file, which the store of a sweep is.
_STORE: Final = b"SQLite format 3"
_CLASSES: Final = {
    "plough_opt.motion.run": ("Run",),
    "plough_opt.motion.machine": ("Machine",),
    "plough_opt.motion.batch.result": ("BatchResult",),
    "plough_opt.design.result.optimum": ("LocalOptimum", "Optimum", "Rounded"),
    "plough_opt.studies.tradeoff.result": ("TradeOff",),
    "plough_opt.studies.accuracy.result": ("AccuracyStudy",),
    "plough_opt.studies.calibration.fit": ("Fit",),
    "plough_opt.studies.uncertainty.result": ("RobustOptimum",),
}


def load(path: str | Path) -> Any:
    """Return a result of any kind that ``save``, or a command with ``--json``, wrote.

    It prints, plots and gives data frames as it did when it was saved. What needs more than data, such as the design
    behind an optimum, is not saved: solve again for it.

    Returns:
        A `Run`, `Machine`, `Optimum`, `LocalOptimum`, `TradeOff`, `AccuracyStudy`, `Fit`, `BatchResult`, or a robust
        optimum.

    Raises:
        InputError: there is no such file, or it is not a saved result of this version.

    Example:
        >>> import tempfile, plough_opt as po
        >>> scene = po.Scene(po.named_soil("serozem"), po.Cone("10 deg", "25 cm"), "50 kN/m", "30 kg", "2 m/s")
        >>> run = po.simulate(scene, "0.1 s")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     again = po.load(run.save(f"{folder}/run.json"))
        >>> str(again) == str(run)
        True
    """
    path = path_of("the result", path)
    if is_store(path):
        raise InputError(f"{shown(str(path), 200)} is the store of a sweep: read it with po.Sweep.load")
    classes: list[type[Saveable]] = [
        getattr(import_module(module), name) for module, names in _CLASSES.items() for name in names
    ]
    return read_result(path, {kind.kind: kind for kind in classes})


def is_store(path: Path) -> bool:
    """Return whether a file is the store of a sweep."""
    try:
        with path.open("rb") as file:
            return file.read(len(_STORE)) == _STORE
    except (OSError, ValueError):  # `load` reports it
        return False
