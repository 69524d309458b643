"""Wrong values for every argument of every public function: a clear error, or an answer without NaN.

A warning counts as a failure."""

import functools
import inspect
import math
import random
import warnings
from concurrent.futures import ThreadPoolExecutor

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np
import pytest
from helpers.every_result import fit, front, run
from helpers.problem_files import PROBLEMS
from scipy import stats

import plough_opt as po
from plough_opt.studies import uncertainty

# --- a valid call of every public function: the function, and its arguments, each of which tests replace by wrong ones

SOIL = po.named_soil("serozem")
FIRM = po.Soil(1600.0, 0.8, 2e4, 0.5, 0.5, 0.0, youngs_modulus=2e7, poisson_ratio=0.3)
WEDGE = po.Wedge(0.5, 0.26, 0.25)
CONE = WEDGE.equivalent_cone()
STEADY = po.Effects(motion=False)
SCENE = po.Scene(SOIL, WEDGE, 5e4, 45.0, 2.0, STEADY)
CAVITY = po.plastic.Cavity(0.1, 0.4, 0.2)
NODES = ((0.0, 0.0), (0.5, 0.05))
SAMPLES = (1.0, 2.0, 4.0)


@functools.cache
def design():
    """Return a design with one variable and one parameter, its mean draft, and a goal for its loosened radius."""
    d = po.Design()
    angle, speed = d.variable("angle", guess=0.5, lower=0.3, upper=0.8, unit="rad"), d.parameter("speed", 2.0)
    scene = po.Scene(SOIL, po.Wedge(angle, 0.26, 0.25), 5e4, 45.0, speed, STEADY)
    draft = po.simulate(scene, 1.0).mean_draft
    d.minimise(draft / 1e3)
    d.require("radius", scene.loosened_radius, at_least=0.05, unit="m")
    return d, draft, po.Goal("radius of it", scene.loosened_radius, maximise=True)


@functools.cache
def optimum():
    return design()[0].solve(search="local")


@functools.cache
def made():
    return po.component(SCENE, 1.0, inputs=["share.height"], outputs=["mean_draft"])


@functools.cache
def field():
    return po.SoilDistribution(SOIL, cohesion=stats.uniform(1e4, 1e4), density=stats.norm(1350.0, 20.0))


@functools.cache
def robust():
    return po.Robust(field(), lambda soil: {"reach": po.loosened_radius(CONE, soil)}, samples=8)


STIFFNESS = ca.MX.sym("stiffness")


def moving(stiffness):
    return po.Scene(SOIL, WEDGE, stiffness, 45.0, 2.0, po.Effects(damping=400.0))


@functools.cache
def batch():
    return po.Batch(moving(STIFFNESS), 0.1, [STIFFNESS])


PATH = np.linspace(0.0, 8.0, 161)


def record():
    return po.StrengthRecord(PATH, 1e6 + 2e5 * np.sin(9.0 * PATH) + 1e5 * np.cos(31.0 * PATH))


def measured():
    return po.Measurements("mean_draft", [7e3, 8e3, 9e3], {"scene.tow_speed": [1.0, 1.5, 2.0]}, sigma=100.0)


@functools.cache
def problem():
    return po.read_problem(PROBLEMS / "cotton_subsoiler.toml", ["scene.duration=0.1 s"])


FRESH = po.Design()


# So that a sweep with wrong arguments starts no processes.
INLINE = ThreadPoolExecutor(1)


def over(values):
    """Return the first point of a sweep's results."""
    return {"twice": 2.0 * values["x"]}


def _group(prefix, functions, **known):
    """Return name -> function, with those of the known arguments that it has."""
    return {
        f"{prefix}{function.__name__}": (
            function, {name: known[name] for name in inspect.signature(function).parameters if name in known}
        )
        for function in functions
    }  # fmt: skip


def _of(module, names):
    return [getattr(module, name) for name in names.split()]


def _laws():
    """Return name -> function of soil, share or medium, with its required arguments."""
    forces = _of(po, "added_mass loosened_radius resistance resistance_coefficients soil_reaction")
    fields = [own for name in po.elastic.__all__ if inspect.isfunction(own := getattr(po.elastic, name))]
    gas = _of(
        po.plastic,
        """Cavity current_radius density front front_radius front_speed mean_ratio
        particle_acceleration particle_velocity quadrature_error ratio stress surface_pressure wall_pressure""",
    )
    return {
        **_group("", forces, share=CONE, cone=CONE, soil=SOIL, speed=2.0, acceleration=0.0),
        **_group("elastic.", fields, x=0.2, r=0.1, y=0.1, profile=NODES, soil=FIRM, speed=2.0, section_factor=0.5),
        "elastic.knots": (po.elastic.knots, {"profile": lambda x: 0.1 * x, "length": 0.5, "count": 4}),
        **_group("plastic.", gas, cavity=CAVITY, r=0.15, soil=SOIL, radius=0.1, rate=0.4, acceleration=0.2),
    }  # fmt: skip


def _classes():
    """Return name -> class, with its required arguments and others that matter."""
    simple = _of(
        po,
        """Accuracy Cone Effects Goal Printed RandomStrength Range Scene Smooth Soil StickSlip
        StrengthWave Wedge""",
    )
    return {
        **_group("", simple,
                 soil=SOIL, share=WEDGE, effects=STEADY, stiffness=5e4, mass=45.0, damping=300.0, tow_speed=2.0,
                 angle=0.5, half_angle=0.2, chisel_angle=0.26, height=0.25, width=0.1, density=1400.0,
                 density_ratio=0.8, cohesion=2e4, friction_angle=0.5, tool_friction=0.5, youngs_modulus=2e7,
                 poisson_ratio=0.3, amplitude=0.3, wavelength=0.5, rms=0.2, correlation_length=0.3, tow_ramp=0.1,
                 rate_term=0.01, error=1e-6, lower=0.1, upper=0.3, name="a", expression=ca.MX.sym("x"),
                 distribution=stats.norm(0.0, 1.0)),
        "Batch": (po.Batch, {"scene": moving(STIFFNESS), "duration": 1.0, "inputs": [STIFFNESS]}),
        "Calibration": (po.Calibration, {"given": SCENE, "data": measured(), "unknown": {"soil.cohesion": (1e3, 8e4)}}),
        "Penetrometer": (po.Penetrometer, {"name": "a.csv", "insertions": [1.1e6, 0.9e6, 1.3e6]}),
        "Machine": (po.Machine, {"runs": {"left": po.simulate(moving(5e4), 0.1)}}),
        "Input": (po.Input, {"name": "share.height", "lower": 0.1, "upper": 0.3, "value": 0.2, "unit": "m"}),
        "Measurements": (po.Measurements, {
            "result": "mean_draft", "values": [7e3, 8e3, 9e3], "conditions": {"scene.tow_speed": [1.0, 1.5, 2.0]}}),
        "Output": (po.Output, {"name": "mean_draft", "lower": 0.0, "upper": 1e6, "unit": "N"}),
        "Robust": (po.Robust, {"field": field(), "response": lambda soil: {"a": soil.cohesion}, "samples": 8}),
        "SoilDistribution": (po.SoilDistribution, {
            "soil": SOIL, "within": {"cohesion": (1e4, 2e4)}, "correlation": {("cohesion", "density"): 0.1},
            "cohesion": stats.norm(15e3, 1e3), "density": stats.norm(1350.0, 20.0)}),
        "SpeedProfile": (po.SpeedProfile, {"times": (0.0, 2.0), "speeds": (0.5, 1.0)}),
        "Spectrum": (po.Spectrum, {"wave_number": [1.0, 2.0], "density": [0.1, 0.2]}),
        "StrengthRecord": (po.StrengthRecord, {"position": PATH, "value": 1e6 + 2e5 * np.sin(9.0 * PATH)}),
    }  # fmt: skip


def _functions():
    """Return name -> function, with its required arguments and those that keep it fast."""
    fitted_to = {"given": SCENE, "data": measured(), "unknown": {"soil.cohesion": (1e3, 8e4)}, "starts": 1}
    return {
        "cone_index": (po.cone_index, {"soil": SOIL}),
        "read_penetrometer": (po.read_penetrometer, {"path": "none.csv", "depth": (0.1, 0.3)}),
        **_group("", [po.read_measurements, po.read_strength_record], path="none.csv"),
        **_group("", [po.strength_spectrum], record=record(), base_diameter=0.1),
        "component": (po.component, {"scene": SCENE, "duration": 1.0, "inputs": ["share.height"],
                                     "outputs": ["mean_draft"], "samples": 40}),
        "deg": (po.deg, {"angle": 30.0}),
        "explore": (po.explore, {"question": "none.toml", "path": "none.html"}),
        "load": (po.load, {"path": "none.json"}),
        "named_soil": (po.named_soil, {"name": "serozem"}),
        "read_problem": (po.read_problem, {"path": PROBLEMS / "cotton_subsoiler.toml"}),
        "simulate": (po.simulate, {"scene": SCENE, "duration": 1.0, "outputs": 40}),
        **_group("plots.", _of(po.plots, "plot_share plot_run plot_optimum"), scene=SCENE, run=run(), best=optimum()),
        **_group("uncertainty.", _of(uncertainty, "expected standard_deviation"), values=SAMPLES),
        "uncertainty.verify": (uncertainty.verify, {"robust": robust(), "at": {}, "samples": 128}),
        "trade_off": (po.trade_off, {"design": design()[0], "first": design()[1], "second": design()[2], "points": 5,
                                     "search": "local"}),
        "calibrate": (po.calibrate, fitted_to),
        "sweep": (po.sweep, {"what_to_sweep": over, "over": {"x": [1.0, 2.0]}, "executor": INLINE, "workers": 1}),
        "study_accuracy": (po.study_accuracy, {"scene": SCENE, "duration": 0.1, "outputs": 4, "allowance": 0.01}),
        "study_design": (po.study_design, {"design": design()[0], "limit": 0.1, "seeds": 1}),
    }  # fmt: skip


def _methods():
    """Return name -> method of an existing object, with its required arguments."""
    fit_, best, traded, uncertain = fit(), optimum(), front(), robust()
    reach, half = {"name": "reach"}, {"number": 1, "of": 1, "by": 0}
    declared = {
        "variable": {"name": "a", "guess": 0.5, "lower": 0.1, "upper": 1.0},
        "parameter": {"name": "a", "value": 0.5},
        "minimise": {"objective": ca.MX.sym("x")},
        "require": {"name": "a", "expression": ca.MX.sym("x"), "at_least": 1.0},
    }
    return {
        **{f"Design.{name}": (_on_new_design(name), right) for name, right in declared.items()},
        "Design.solve": (design()[0].solve, {"parameters": {"speed": 2.0}, "search": "local"}),
        "Batch()": (batch().__call__, {"values": [[5e4]]}),
        "Batch.stream": (lambda chunks, threads=1: [*batch().stream(chunks, threads=threads)], {"chunks": [[[5e4]]]}),
        "Component()": (made().__call__, {"share_height": 0.2}),
        "Cone.solid_mass": (CONE.solid_mass, {"density": 7850.0}),
        **_group("Fit.", _of(fit_, "intervals hold_out")),
        "Optimum()": (best.__call__, {"item": design()[1]}),
        "Optimum.sensitivity": (best.sensitivity, {"name": "speed"}),
        "Optimum.rounded": (lambda angle: best.rounded(angle=angle), {"angle": 0.01}),
        "Optimum.rounded of": (lambda catalogues: best.rounded(catalogues), {"catalogues": {"angle": [0.4, 0.5]}}),
        **_group("Problem.", _of(problem(), "values scene simulate"), changes={"share.height": 0.2}),
        **_group("Problem.", _of(problem(), "design component"), inputs=["share.height"], outputs=["mean_draft"]),
        "Range.at": (po.Range(1.0, 2.0, 3).at, {"fraction": 0.5}),
        **_group("Robust.", _of(uncertain, "expected mean_plus values"), **reach, at={}, kappa=1.0,
                 properties=[[1.5e4, 1350.0]]),
        "Robust.require_probability": (
            lambda design, **a: uncertain.require_probability(po.Design() if design is FRESH else design, **a),
            reach | {"design": FRESH, "requirement": "a", "probability": 0.9, "at_least": 0.1, "at_most": None,
                     "unit": "m"}),
        "Robust[]": (uncertain.__getitem__, reach),
        "Soil.with_density_profile": (
            lambda density, width, order=8: SOIL.with_density_profile(density, width, order=order),
            {"density": lambda r, w: 1400.0 + 0.0 * r * w, "width": 0.15}),
        **_group("SoilDistribution.", _of(field(), "sample values"), count=8, seed=0),
        "RandomStrength.density": (po.RandomStrength(0.2, 0.3).density, {"wave_number": 4.0}),
        "Sweep.load": (po.Sweep.load, {"path": "none.db"}),
        **_group("TradeOff.", _of(traded, "rate cost in_words hypervolume"), **half),
    }  # fmt: skip


def _on_new_design(verb):
    """Return a method of `Design` that creates a new design for every call."""

    @functools.wraps(getattr(po.Design, verb))
    def call(**arguments):
        return getattr(po.Design(), verb)(**arguments)

    return call


def _named_arguments(function):
    """Return the optional arguments of a function with their defaults."""
    kinds = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    given = inspect.signature(function).parameters.values()
    return {one.name: one.default for one in given if one.kind in kinds and one.default is not inspect.Parameter.empty}


@functools.cache
def recipes():
    """Return name -> function, and valid values of all its arguments."""
    every = _laws() | _classes() | _functions() | _methods()
    return {name: (function, _named_arguments(function) | right) for name, (function, right) in every.items()}


WRONG = {
    "None": None, "text": "x", "digits": "3", "bytes": b"3", "list": [], "numbers": [1.0], "texts": ["x"], "tuple": (),
    "dict": {}, "table": {"x": "y"}, "True": True, "nan": math.nan, "inf": math.inf, "-inf": -math.inf, "complex": 1j,
    "huge": 10**400, "0": 0, "-1": -1, "half": -1.5, "array": np.array([1.0, 2.0]),
    "no array": np.array([]), "array of text": np.array(["x"]), "array of nan": np.array([math.nan, 1.0]),
    "square": np.eye(2), "objects": np.array([None, {}]), "object": object(), "symbol": ca.MX.sym("x"),
    "column": ca.MX.sym("x", 2), "SX": ca.SX.sym("x"), "function": lambda *_, **__: None, "soil": SOIL,
    "largest": 1e308, "-largest": -1e308, "least": 5e-324, "-0": -0.0, "1e60": 1e60, "1e-60": 1e-60, "2^64": 2**64,
    "short": np.float32(0.5), "switch": np.True_, "vaster": 10**5000, "control": "\x1b[2J", "half a pair": "\udcff",
}  # fmt: skip


# --- wrong values for every argument of every public function: a clear error, or an answer without NaN ---
# A warning counts as a failure.

# Cases that are valid although they look wrong, or that cannot be checked.
LEFT_OUT = {
    # Values without expressions are returned unchanged.
    *(("Optimum()", "item", wrong) for wrong in WRONG),
    # Starts processes; tested with sweeps.
    ("sweep", "executor", "None"),
    # Whole numbers with more digits than Python prints.
    ("sweep", "samples", "vaster"),
    # An SX expression with an MX scene.
    ("Batch", "duration", "SX"),
    # Takes minutes to build: SX expands the quadratures of the force.
    *(("elastic.cone_force", argument, "SX") for argument in ("speed", "section_factor")),
}


def cases():
    """Return all triples of function, argument and wrong value in a reproducible random order."""
    found = [
        (name, argument, wrong)
        for name, (_, arguments) in recipes().items()
        for argument in arguments
        for wrong in WRONG
        if (name, argument, wrong) not in LEFT_OUT
    ]
    random.Random(0).shuffle(found)
    return found


def complaint(name, argument, wrong):
    """Return the defect of the answer to one case, or None."""
    function, arguments = recipes()[name]
    try:
        with warnings.catch_warnings():
            # An implausible value may be intended.
            warnings.simplefilter("ignore", po.ImplausibleValue)
            answer = function(**arguments | {argument: WRONG[wrong]})
    except po.PloughError as error:
        text = str(error)
        printed = text.replace("\n", "").isprintable()
        return None if text and printed else f"message {text!r}"
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    finally:
        plt.close("all")
    is_number = isinstance(answer, float | np.ndarray) and np.asarray(answer).dtype.kind == "f"
    return f"answer {answer}" if is_number and np.any(np.isnan(answer)) else None


@pytest.mark.parametrize("count", [300, pytest.param(None, marks=pytest.mark.slow)], ids=["some", "all"])
def test_wrong_arguments_are_refused(count, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # a sweep may write its file here
    told = {case: said for case in cases()[:count] if (said := complaint(*case))}
    assert told == {}


def test_valid_arguments_are_accepted():
    # They read files.
    missing = ("explore", "load", "read_measurements", "read_penetrometer", "read_strength_record", "Sweep.load")
    elsewhere = ("trade_off", "calibrate", "sweep", "study_accuracy", "study_design", "uncertainty.verify")
    for name, (function, arguments) in recipes().items():
        if name in missing:
            with pytest.raises(po.InputError, match=r"there is no|cannot be read"):
                function(**arguments)
        elif name not in elsewhere:
            function(**arguments)
