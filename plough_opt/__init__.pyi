"""The public names of the toolkit and the modules that define them, each imported on first use."""

from . import export as export, expressions as expressions, laws as laws, uncertainty as uncertainty
from .app import plots as plots
from .app.page import explore as explore
from .core.errors import (
    DomainError as DomainError,
    ImplausibleValue as ImplausibleValue,
    InfeasibleDesign as InfeasibleDesign,
    InputError as InputError,
    IntegrationError as IntegrationError,
    NotConverged as NotConverged,
    PloughError as PloughError,
)
from .design import Design as Design, LocalOptimum as LocalOptimum, Optimum as Optimum
from .exchange.building import component as component
from .exchange.component import Component as Component, Input as Input, Output as Output
from .core.saving import load as load
from .laws.forces import (
    added_mass as added_mass,
    cone_index as cone_index,
    loosened_radius as loosened_radius,
    resistance as resistance,
    resistance_coefficients as resistance_coefficients,
    soil_reaction as soil_reaction,
)
from .laws.law import ResistanceLaw as ResistanceLaw, ShareInSoil as ShareInSoil, SoilReaction as SoilReaction
from .laws.law import Printed as Printed
from .motion import Run as Run, simulate as simulate
from .motion.methods import Accuracy as Accuracy
from .motion.batch import Batch as Batch, BatchResult as BatchResult
from .motion.effects import (
    Effects as Effects,
    OwnResistance as OwnResistance,
    Smooth as Smooth,
    SpeedProfile as SpeedProfile,
    StickSlip as StickSlip,
)
from .motion.driven import MotionEquation as MotionEquation
from .motion.run import Machine as Machine
from .motion.scene import Scene as Scene
from .problem_file import Problem as Problem, read_problem as read_problem
from .problem_file.field_data import (
    Penetrometer as Penetrometer,
    read_penetrometer as read_penetrometer,
    read_strength_record as read_strength_record,
)
from .problem_file.sweep import sweep as sweep
from .soil import elastic as elastic, plastic as plastic
from .soil.geometry import Cone as Cone, Wedge as Wedge, deg as deg
from .soil.strength import RandomStrength as RandomStrength, Spectrum as Spectrum
from .soil.soil import Soil as Soil, named_soil as named_soil, soil_names as soil_names
from .soil.strength import StrengthRecord as StrengthRecord, strength_spectrum as strength_spectrum
from .soil.strength import StrengthWave as StrengthWave
from .studies.accuracy import AccuracyStudy as AccuracyStudy, study_accuracy as study_accuracy
from .studies.accuracy import study_design as study_design
from .studies.calibration import (
    Calibration as Calibration,
    Fit as Fit,
    Measurements as Measurements,
    calibrate as calibrate,
    read_measurements as read_measurements,
)
from .studies.sweep.points import Range as Range
from .studies.sweep.result import Sweep as Sweep
from .studies.tradeoff import Goal as Goal, TradeOff as TradeOff, trade_off as trade_off
from .studies.uncertainty import Robust as Robust, SoilDistribution as SoilDistribution

__version__: str
