"""plough_opt: design of subsoiler ploughshares by optimisation with exact derivatives.

Units are SI and angles are in radians. Every physical function accepts floats, CasADi expressions and, where that makes
sense, NumPy arrays, and returns a result of the same type.
"""

from typing import TYPE_CHECKING, Any

from plough_opt import expressions, laws
from plough_opt.core.errors import (
    DomainError,
    ImplausibleValue,
    InfeasibleDesign,
    InputError,
    IntegrationError,
    NotConverged,
    PloughError,
)
from plough_opt.core.refinement import Refinement, refine
from plough_opt.design import Design, LocalOptimum, Optimum
from plough_opt.exchange.component import Component, Input, Output, component
from plough_opt.laws.forces import (
    added_mass,
    cone_index,
    loosened_radius,
    resistance,
    resistance_coefficients,
    soil_reaction,
)
from plough_opt.laws.law import ResistanceLaw, ShareInSoil, SoilReaction
from plough_opt.laws.printed import Printed
from plough_opt.motion import Run, simulate
from plough_opt.motion.accuracy import Accuracy
from plough_opt.motion.effects import Effects, HarmonicBalance, OwnResistance, Smooth, StickSlip
from plough_opt.motion.machine import Machine
from plough_opt.motion.scene import Scene
from plough_opt.soil import elastic, plastic
from plough_opt.soil.geometry import Cone, Wedge, deg
from plough_opt.soil.random_strength import RandomStrength, Spectrum
from plough_opt.soil.soil import Soil, named_soil, soil_names
from plough_opt.soil.waves import StrengthWave

if TYPE_CHECKING:
    __version__: str

    from plough_opt import uncertainty
    from plough_opt.app import plots
    from plough_opt.exchange.results import load
    from plough_opt.motion.batch import Batch, BatchResult
    from plough_opt.problem_file import Problem, read_problem
    from plough_opt.problem_file.readings import Penetrometer, read_penetrometer, read_strength_record
    from plough_opt.problem_file.sweeping import sweep
    from plough_opt.soil.record_waves import RecordWaves, strength_waves
    from plough_opt.soil.strength_record import Rig, StrengthRecord, strength_spectrum
    from plough_opt.studies import crosscheck
    from plough_opt.studies.accuracy.result import AccuracyStudy
    from plough_opt.studies.accuracy.study import study_accuracy, study_design
    from plough_opt.studies.calibration import Calibration, Candidate, Fit, Measurements, calibrate, read_measurements
    from plough_opt.studies.sweep.points import Range
    from plough_opt.studies.sweep.result import Sweep
    from plough_opt.studies.tradeoff import Goal, TradeOff, trade_off
    from plough_opt.studies.uncertainty import Robust, SoilDistribution

# Names that need pint, pydantic, scipy or matplotlib are imported on first use, because those libraries load slowly.
_NAMES_LATER = {
    "plough_opt.motion.batch": ("Batch", "BatchResult"),
    "plough_opt.studies.accuracy.result": ("AccuracyStudy",),
    "plough_opt.studies.accuracy.study": ("study_accuracy", "study_design"),
    "plough_opt.studies.calibration": (
        "Calibration", "Candidate", "Fit", "Measurements", "calibrate", "read_measurements",
    ),
    "plough_opt.problem_file": ("Problem", "read_problem"),
    "plough_opt.problem_file.readings": ("Penetrometer", "read_penetrometer", "read_strength_record"),
    "plough_opt.soil.record_waves": ("RecordWaves", "strength_waves"),
    "plough_opt.soil.strength_record": ("Rig", "StrengthRecord", "strength_spectrum"),
    "plough_opt.exchange.results": ("load",),
    "plough_opt.studies.sweep.points": ("Range",),
    "plough_opt.studies.sweep.result": ("Sweep",),
    "plough_opt.problem_file.sweeping": ("sweep",),
    "plough_opt.studies.tradeoff": ("Goal", "TradeOff", "trade_off"),
    "plough_opt.studies.uncertainty": ("Robust", "SoilDistribution"),
}  # fmt: skip
_LATER = {name: module for module, names in _NAMES_LATER.items() for name in names}
_MODULES_LATER = {
    "export": "plough_opt.export",
    "crosscheck": "plough_opt.studies.crosscheck",
    "plots": "plough_opt.app.plots",
    "uncertainty": "plough_opt.uncertainty",
}


def __getattr__(name: str) -> Any:
    """Return a name of ``_LATER`` or a module, imported on first use."""
    import importlib

    if name == "__version__":
        from importlib.metadata import version

        return version("plough_opt")
    if name in _MODULES_LATER:
        return importlib.import_module(_MODULES_LATER[name])
    if name not in _LATER:
        raise AttributeError(f"module 'plough_opt' has no attribute '{name}'")
    return getattr(importlib.import_module(_LATER[name]), name)


def __dir__() -> list[str]:
    """Return the names in the package, including those imported on first use."""
    return sorted({*globals(), *_LATER, *_MODULES_LATER, "__version__"})


__all__ = [
    "Accuracy", "AccuracyStudy", "Batch", "BatchResult", "Calibration", "Candidate", "Component", "Cone", "Design",
    "DomainError", "Effects", "Fit", "Goal", "HarmonicBalance", "ImplausibleValue", "InfeasibleDesign", "Input",
    "InputError", "IntegrationError", "LocalOptimum", "Machine", "Measurements", "NotConverged", "Optimum",
    "Output", "OwnResistance", "Penetrometer", "PloughError", "Printed", "Problem", "RandomStrength", "Range",
    "RecordWaves", "Refinement", "ResistanceLaw", "Rig", "Robust", "Run", "Scene", "ShareInSoil", "Smooth", "Soil",
    "SoilDistribution", "SoilReaction", "Spectrum", "StickSlip", "StrengthRecord", "StrengthWave", "Sweep",
    "TradeOff", "Wedge", "added_mass", "calibrate", "component", "cone_index", "crosscheck", "deg", "elastic",
    "expressions", "laws", "load", "loosened_radius", "named_soil", "plastic", "plots", "read_measurements",
    "read_penetrometer", "read_problem", "read_strength_record", "refine", "resistance", "resistance_coefficients",
    "simulate", "soil_names", "soil_reaction", "strength_spectrum", "strength_waves", "study_accuracy",
    "study_design", "sweep", "trade_off", "uncertainty",
]  # fmt: skip
