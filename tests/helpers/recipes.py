"""A right call of every public function, by name: what to call, and its arguments, each of which is given wrongly."""

import functools
import math
from concurrent.futures import Executor, Future
from pathlib import Path

import casadi as ca
import numpy as np
from scipy import stats

import plough_opt as po
from plough_opt.studies.uncertainty import (
    cvar,
    expected,
    mean_plus,
    probability,
    quantile,
    sobol_indices,
    verify,
    worst,
)
from plough_opt.studies.uncertainty import standard_deviation as deviation

PROBLEMS = Path(__file__).parents[2] / "problems"
SOIL = po.named_soil("serozem")
FIRM = po.Soil(1600.0, 0.8, 2e4, 0.5, 0.5, 0.0, youngs_modulus=2e7, poisson_ratio=0.3)
WEDGE = po.Wedge(0.5, 0.26, 0.25)
CONE = WEDGE.equivalent_cone()
STEADY = po.Effects(motion=False)
SCENE = po.Scene(SOIL, WEDGE, 5e4, 45.0, 2.0, STEADY)
CAVITY = po.plastic.Cavity(0.1, 0.4, 0.2)
NODES = ((0.0, 0.0), (0.5, 0.05))
TINE = po.crosscheck.Tine(0.05, 0.3, 0.7)
PLACE = {"x": 0.2, "r": 0.1, "profile": NODES, "soil": FIRM, "speed": 2.0}
FLAT = {"x": 0.2, "y": 0.1, "profile": NODES, "soil": FIRM, "speed": 2.0}
SAMPLES = (1.0, 2.0, 4.0)


@functools.cache
def design():
    """Return a design of one variable and one parameter, with its run's mean draft and its cone's radius."""
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
def front():
    d, draft, radius = design()
    return po.trade_off(d, draft, radius, points=5, search="local")


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
def fitted():
    return po.calibrate(SCENE, measured(), {"soil.cohesion": (1e3, 8e4)})


@functools.cache
def problem():
    return po.read_problem(PROBLEMS / "cotton_subsoiler.toml", ["scene.duration=0.1 s"])


@functools.cache
def refined():
    return po.refine(lambda n: 1.0 + 1.0 / n, [1, 2, 4])


@functools.cache
def run():
    return po.simulate(SCENE, 1.0)


FRESH = po.Design()


def anew(design):
    """Return a design of its own for every call in the place of FRESH, and whatever else is given."""
    return po.Design() if design is FRESH else design


class Inline(Executor):
    """Does everything at once, in this process: a sweep that is asked wrongly may run, but begins no processes."""

    def submit(self, function, /, *arguments, **named):
        done = Future()
        try:
            done.set_result(function(*arguments, **named))
        except BaseException as error:
            done.set_exception(error)
        return done


def over(values):
    """Return the first point of a sweep's results."""
    return {"twice": 2.0 * values["x"]}


@functools.cache
def recipes():
    """Return name -> function and right arguments."""
    return {
        "Accuracy": (po.Accuracy, {"method": "auto", "error": 1e-6, "steps": None, "tolerance": None,
            "derivatives": 1e-6}),
        "Batch": (po.Batch, {"scene": moving(STIFFNESS), "duration": 1.0, "inputs": [STIFFNESS], "error": 1e-6}),
        "Batch()": (lambda **a: batch()(**a), {"values": [[5e4]], "threads": 1}),
        "Batch.stream": (lambda chunks, threads: list(batch().stream(chunks, threads=threads)),
                         {"chunks": [[[5e4]]], "threads": 1}),
        "Calibration": (po.Calibration, {"given": SCENE, "data": measured(), "unknown": {"soil.cohesion": (1e3, 8e4)},
                                         "loss": "squares", "duration": None, "starts": 1, "title": ""}),
        "Candidate": (po.Candidate, {"result": "mean_draft", "conditions": {"scene.tow_speed": 2.0}, "sigma": 1.0,
                                     "why": ""}),
        "Component()": (lambda **a: made()(**a), {"share_height": 0.2}),
        "Penetrometer": (po.Penetrometer, {"name": "a.csv", "insertions": [1.1e6, 0.9e6, 1.3e6]}),
        "Rig": (po.Rig, {"mass": 100.0, "stiffness": 1e5, "damping": 300.0, "tow_speed": 1.0}),
        "cone_index": (po.cone_index, {"soil": SOIL}),
        "read_penetrometer": (po.read_penetrometer, {"path": "none.csv", "depth": (0.1, 0.3)}),
        "read_strength_record": (po.read_strength_record, {"path": "none.csv", "rig": None, "tow_speed": None}),
        "Cone": (po.Cone, {"half_angle": 0.2, "height": 0.3}),
        "Cone.solid_mass": (CONE.solid_mass, {"density": 7850.0}),
        "Design.variable": (lambda **a: po.Design().variable(**a),
                            {"name": "a", "guess": 0.5, "lower": 0.1, "upper": 1.0, "unit": "m", "log": False,
                             "tolerance": None, "domain": (0.0, 2.0)}),
        "Design.parameter": (lambda **a: po.Design().parameter(**a),
                             {"name": "a", "value": 0.5, "unit": "m", "domain": (0.0, 1.0)}),
        "Design.minimise": (lambda **a: po.Design().minimise(**a), {"objective": ca.MX.sym("x"), "over": None}),
        "Design.require": (lambda **a: po.Design().require(**a),
                           {"name": "a", "expression": ca.MX.sym("x"), "at_least": 1.0, "at_most": 2.0, "unit": "m"}),
        "Design.solve": (lambda **a: design()[0].solve(**a),
                         {"parameters": {"speed": 2.0}, "search": "local", "judge": "tolerance", "seed": 0,
                          "compiled": False, "progress": None}),
        "Effects": (po.Effects, {
            "motion": True, "inertial_drag": True, "added_mass": True, "ambient_pressure": True, "contact": "resisting",
            "start": "rest", "entry": False, "strength_wave": None, "random_strength": None,
            "tow_ramp": 0.1, "damping": 100.0, "rate_term": 0.01,
            "own": (), "orbit": "transient", "formulation": "derived"}),
        "Fit.intervals": (lambda **a: fitted().intervals(**a), {"level": 0.9, "kind": "linearised"}),
        "Fit.next_measurements": (lambda **a: fitted().next_measurements(**a),
                                  {"candidates": [po.Candidate("mean_draft", {"scene.tow_speed": 2.0})]}),
        "Fit.cross_validation": (lambda **a: fitted().cross_validation(**a), {"folds": 3, "seed": 1}),
        "Goal": (po.Goal, {"name": "a", "expression": ca.MX.sym("x"), "unit": "m", "maximise": False}),
        "HarmonicBalance": (po.HarmonicBalance, {"harmonics": 3}),
        "Input": (po.Input, {"name": "share.height", "lower": 0.1, "upper": 0.3, "value": 0.2, "unit": "m",
                             "symbol": None}),
        "Measurements": (po.Measurements, {
            "result": "mean_draft", "values": [7e3, 8e3, 9e3], "conditions": {"scene.tow_speed": [1.0, 1.5, 2.0]},
            "sigma": 100.0, "weights": None, "time": None, "name": "a", "lines": ()}),
        "Measurements.row": (lambda **a: measured().row(**a), {"number": 1}),
        "Measurements.at": (lambda **a: measured().at(**a), {"number": 1}),
        "Machine": (po.Machine, {"runs": {"left": po.simulate(moving(5e4), 0.1)}}),
        "Optimum()": (lambda **a: optimum()(**a), {"item": design()[1]}),
        "Optimum.sensitivity": (lambda **a: optimum().sensitivity(**a), {"name": "speed", "check": False}),
        "Optimum.rounded": (lambda angle: optimum().rounded(angle=angle), {"angle": 0.01}),
        "Optimum.rounded of": (lambda catalogues: optimum().rounded(catalogues), {"catalogues": {"angle": [0.4, 0.5]}}),
        "Output": (po.Output, {"name": "mean_draft", "lower": 0.0, "upper": 1e6, "of": None, "unit": "N"}),
        "Printed": (po.Printed, {"pi_twice": True, "one_third": True, "repelling_spring": True}),
        "Problem.values": (lambda **a: problem().values(**a), {"changes": {"share.height": 0.2}}),
        "Problem.scene": (lambda **a: problem().scene(**a), {"changes": {"share.height": 0.2}}),
        "Problem.simulate": (lambda **a: problem().simulate(**a), {"changes": {"share.height": 0.2}}),
        "Problem.design": (lambda **a: problem().design(**a), {"parameters": False}),
        "Problem.component": (lambda **a: problem().component(**a),
                              {"inputs": ["share.height"], "outputs": ["mean_draft"], "name": "a", "samples": 40}),
        "Range": (po.Range, {"lower": 1.0, "upper": 2.0, "count": 3, "log": False}),
        "Range.at": (po.Range(1.0, 2.0, 3).at, {"fraction": 0.5}),
        "Refinement.size_for": (lambda **a: refined().size_for(**a), {"error": 0.3}),
        "Robust": (po.Robust, {"field": field(), "response": lambda soil: {"a": soil.cohesion}, "samples": 8,
            "seed": 1}),
        "Robust.expected": (lambda **a: robust().expected(**a), {"name": "reach"}),
        "Robust.mean_plus": (lambda **a: robust().mean_plus(**a), {"name": "reach", "kappa": 1.0}),
        "Robust.cvar": (lambda **a: robust().cvar(**a), {"name": "reach", "level": 0.9, "width": 0.01,
            "tail": "upper"}),
        "Robust.worst": (lambda **a: robust().worst(**a), {"name": "reach", "width": 0.01, "tail": "upper"}),
        "Robust.every": (lambda **a: robust().every(**a), {"name": "reach", "at_least": 0.1, "at_most": None}),
        "Robust.probability": (lambda **a: robust().probability(**a),
                               {"name": "reach", "at_least": 0.1, "at_most": None, "width": 0.01}),
        "Robust.require_probability": (lambda design, **a: robust().require_probability(anew(design), **a), {
            "design": FRESH, "requirement": "a", "name": "reach", "probability": 0.9, "at_least": 0.1,
            "at_most": None, "width": 0.01, "unit": "m"}),
        "Robust.bound_from_above": (lambda **a: robust().bound_from_above(**{"design": po.Design()} | a), {
            "name": "reach", "lower": 0.0, "upper": 1.0, "guess": 0.5, "unit": "m"}),
        "Robust.values": (lambda **a: robust().values(**a), {"at": {}, "samples": None}),
        "Robust[]": (lambda name: robust()[name], {"name": "reach"}),
        "Scene": (po.Scene, {"soil": SOIL, "share": WEDGE, "stiffness": 5e4, "mass": 45.0, "tow_speed": 2.0,
                             "effects": STEADY, "medium": "plastic"}),
        "Smooth": (po.Smooth, {"width": 0.1}),
        "Soil": (po.Soil, {
            "density": 1400.0, "density_ratio": 0.8, "cohesion": 2e4, "friction_angle": 0.5, "tool_friction": 0.5,
            "ambient_pressure": 0.0, "youngs_modulus": 2e7, "poisson_ratio": 0.3, "name": "a", "source": "b",
            "density_profile": None}),
        "Soil.with_density_profile": (lambda density, width, order: SOIL.with_density_profile(density, width,
            order=order),
                                      {"density": lambda r, w: 1400.0 + 0.0 * r * w, "width": 0.15, "order": 8}),
        "SoilDistribution": (po.SoilDistribution, {
            "soil": SOIL, "within": {"cohesion": (1e4, 2e4)}, "correlation": {("cohesion", "density"): 0.1},
            "cohesion": stats.norm(15e3, 1e3), "density": stats.norm(1350.0, 20.0)}),
        "SoilDistribution.sample": (lambda **a: field().sample(**a), {"count": 8, "seed": 0}),
        "SoilDistribution.draw": (lambda **a: field().draw(**a), {"count": 8, "seed": 0}),
        "SoilDistribution.corners": (lambda **a: field().corners(**a), {"part": 0.9}),
        "SoilDistribution.at": (lambda **a: field().at(**a), {"uniforms": [[0.5, 0.5]]}),
        "SoilSamples.property": (lambda **a: field().sample(8).property(**a), {"name": "cohesion"}),
        "SoilSamples.each": (lambda **a: field().sample(8).each(**a), {"response": lambda soil: {"a": soil.cohesion}}),
        "Marginal": (po.uncertainty.Marginal,
                     {"distribution": stats.norm(0.0, 1.0), "lower": -1.0, "upper": 1.0, "name": "a"}),
        "Marginal.quantile": (po.uncertainty.Marginal(stats.norm(0.0, 1.0)).quantile, {"probability": 0.5}),
        "Marginal.cdf": (po.uncertainty.Marginal(stats.norm(0.0, 1.0)).cdf, {"value": 0.5}),
        "StickSlip": (po.StickSlip, {"breakaway": 1.2}),
        "RandomStrength": (po.RandomStrength, {"rms": 0.2, "correlation_length": 0.3}),
        "RandomStrength.density": (po.RandomStrength(0.2, 0.3).density, {"wave_number": 4.0}),
        "Spectrum": (po.Spectrum, {"wave_number": [1.0, 2.0], "density": [0.1, 0.2], "lower": None, "upper": None}),
        "StrengthRecord": (po.StrengthRecord, {"position": PATH, "value": 1e6 + 2e5 * np.sin(9.0 * PATH), "rig": None}),
        "strength_spectrum": (po.strength_spectrum, {"record": record(), "base_diameter": 0.1}),
        "strength_waves": (po.strength_waves, {"record": record(), "part": 0.8, "base_diameter": 0.1}),
        "StrengthWave": (po.StrengthWave, {"amplitude": 0.3, "wavelength": 0.5}),
        "Sweep.load": (po.Sweep.load, {"path": "none.db"}),
        "TradeOff.rate": (lambda **a: front().rate(**a), {"number": 1, "of": 1, "by": 0}),
        "TradeOff.cost": (lambda **a: front().cost(**a), {"number": 1, "of": 1, "by": 0}),
        "TradeOff.in_words": (lambda **a: front().in_words(**a), {"number": 1, "of": 1, "by": 0}),
        "TradeOff.hypervolume": (lambda **a: front().hypervolume(**a), {"reference": None}),
        "Wedge": (po.Wedge, {"angle": 0.5, "chisel_angle": 0.26, "height": 0.25}),
        "added_mass": (po.added_mass, {"cone": CONE, "soil": SOIL}),
        "component": (po.component, {
            "scene": SCENE, "duration": 1.0, "inputs": ["share.height"], "outputs": ["mean_draft"],
                "steel_density": None,
            "accuracy": None, "samples": 40, "name": "a"}),
        "deg": (po.deg, {"angle": 30.0}),
        "load": (po.load, {"path": "none.json"}),
        "loosened_radius": (po.loosened_radius, {"cone": CONE, "soil": SOIL}),
        "named_soil": (po.named_soil, {"name": "serozem"}),
        "read_measurements": (po.read_measurements, {"path": "none.csv"}),
        "read_problem": (po.read_problem, {"path": PROBLEMS / "cotton_subsoiler.toml", "overrides": ()}),
        "refine": (po.refine, {"quantity": lambda n: 1.0 / n, "sizes": [1, 2, 4]}),
        "resistance": (po.resistance, {"cone": CONE, "soil": SOIL, "speed": 2.0, "acceleration": 0.0}),
        "resistance_coefficients": (po.resistance_coefficients, {"cone": CONE, "soil": SOIL}),
        "simulate": (po.simulate, {"scene": SCENE, "duration": 1.0, "accuracy": None, "outputs": 40,
            "compiled": False}),
        "soil_reaction": (po.soil_reaction, {"cone": CONE, "soil": SOIL}),
        "elastic.cone_displacement": (po.elastic.cone_displacement, PLACE | {"section_factor": 0.5}),
        "elastic.cone_stress": (po.elastic.cone_stress, PLACE | {"section_factor": 0.5}),
        "elastic.cone_force": (po.elastic.cone_force, {"profile": NODES, "soil": FIRM, "speed": 2.0,
            "section_factor": 0.5,
                                                       "separation": True}),
        "elastic.cone_pressure": (po.elastic.cone_pressure,
                                  {"x": 0.2, "profile": NODES, "soil": FIRM, "speed": 2.0, "section_factor": 0.5}),
        "elastic.knots": (po.elastic.knots, {"profile": lambda x: 0.1 * x, "length": 0.5, "count": 4}),
        "elastic.rayleigh_speed": (po.elastic.rayleigh_speed, {"soil": FIRM}),
        "elastic.shear_modulus": (po.elastic.shear_modulus, {"soil": FIRM}),
        "elastic.shear_wave_speed": (po.elastic.shear_wave_speed, {"soil": FIRM}),
        "elastic.longitudinal_wave_speed": (po.elastic.longitudinal_wave_speed, {"soil": FIRM}),
        "elastic.wedge_displacement": (po.elastic.wedge_displacement, FLAT),
        "elastic.wedge_gradient": (po.elastic.wedge_gradient, FLAT),
        "elastic.wedge_stress": (po.elastic.wedge_stress, FLAT),
        "elastic.wedge_force": (po.elastic.wedge_force,
                                {"profile": NODES, "soil": FIRM, "speed": 2.0, "separation": True}),
        "elastic.wedge_pressure": (po.elastic.wedge_pressure, {"x": 0.2, "profile": NODES, "soil": FIRM, "speed": 2.0}),
        "plastic.Cavity": (po.plastic.Cavity, {"radius": 0.1, "rate": 0.4, "acceleration": 0.2}),
        "plastic.wall_pressure": (po.plastic.wall_pressure, {"soil": SOIL, "radius": 0.1}),
        "plastic.front": (po.plastic.front, {"radius": 0.1, "soil": SOIL}),
        "plastic.ratio": (po.plastic.ratio, {"r": 0.15, "soil": SOIL}),
        "plastic.mean_ratio": (po.plastic.mean_ratio, {"r": 0.15, "soil": SOIL}),
        **{
            f"plastic.{name}": (getattr(po.plastic, name), {"cavity": CAVITY, "soil": SOIL})
            for name in ("front_radius", "front_speed", "surface_pressure")
        },
        **{
            f"plastic.{name}": (getattr(po.plastic, name), {"r": 0.15, "cavity": CAVITY, "soil": SOIL})
            for name in ("current_radius", "density", "particle_acceleration", "particle_velocity", "quadrature_error",
                         "stress")
        },
        "crosscheck.Tine": (po.crosscheck.Tine,
                            {"width": 0.05, "depth": 0.3, "rake_angle": 0.7, "surcharge": 0.0, "adhesion": 0.0}),
        "crosscheck.asabe_draft": (po.crosscheck.asabe_draft,
                                   {"depth": 0.3, "speed": 2.0, "texture": "medium", "point": "narrow", "shanks": 1.0}),
        "crosscheck.compare": (po.crosscheck.compare, {
            "scene": SCENE, "depth": 0.3, "width": 0.08, "rake_angle": 0.7, "texture": "medium", "point": "narrow",
            "speeds": [1.0, 2.0], "rupture_ratio": None, "surcharge": 0.0, "adhesion": 0.0}),
        "crosscheck.godwin_draft": (po.crosscheck.godwin_draft,
                                    {"soil": SOIL, "tine": TINE, "speed": 2.0, "rupture_ratio": None}),
        "crosscheck.mckyes_ali_draft": (po.crosscheck.mckyes_ali_draft, {"soil": SOIL, "tine": TINE, "speed": 2.0}),
        "crosscheck.swick_perumpral_draft": (po.crosscheck.swick_perumpral_draft,
                                             {"soil": SOIL, "tine": TINE, "speed": 2.0}),
        "crosscheck.spherical_cavity_draft": (po.crosscheck.spherical_cavity_draft,
                                              {"cone": CONE, "soil": SOIL, "speed": 2.0}),
        "plots.plot_share": (po.plots.plot_share, {"scene": SCENE}),
        "plots.plot_run": (po.plots.plot_run, {"run": run()}),
        "plots.plot_optimum": (po.plots.plot_optimum, {"best": optimum(), "run": run()}),
        "uncertainty.cvar": (cvar, {"values": SAMPLES, "level": 0.5, "width": 0.1}),
        "uncertainty.expected": (expected, {"values": SAMPLES}),
        "uncertainty.mean_plus": (mean_plus, {"values": SAMPLES, "kappa": 1.0}),
        "uncertainty.probability": (probability, {"values": SAMPLES, "at_least": 1.5, "at_most": None, "width": 0.1}),
        "uncertainty.quantile": (quantile, {"values": SAMPLES, "level": 0.5, "width": 0.1}),
        "uncertainty.standard_deviation": (deviation, {"values": SAMPLES}),
        "uncertainty.worst": (worst, {"values": SAMPLES, "width": 0.1}),
        "uncertainty.sobol_indices": (sobol_indices,
                                      {"robust": robust(), "at": {}, "samples": 8, "seed": 1, "correlated": False}),
        "uncertainty.verify": (verify, {"robust": robust(), "at": {}, "samples": 128, "seed": 1}),
        "trade_off": (po.trade_off, {
            "design": design()[0], "first": design()[1], "second": design()[2], "points": 5, "parameters": None,
            "search": "local", "compiled": False, "title": "", "progress": None}),
        "calibrate": (po.calibrate, {
            "given": SCENE, "data": measured(), "unknown": {"soil.cohesion": (1e3, 8e4)}, "loss": "squares",
            "duration": None, "starts": 1, "title": ""}),
        "sweep": (po.sweep, {
            "what_to_sweep": over, "over": {"x": [1.0, 2.0]}, "what": "simulate", "method": "auto", "samples": None,
            "seed": 0, "store": None, "executor": Inline(), "workers": 1, "retry": False, "progress": False,
                "units": None}),
        "study_accuracy": (po.study_accuracy, {
            "scene": SCENE, "duration": 0.1, "wanted": 1e-6, "outputs": 4, "allowance": 0.01, "derivatives": False,
            "thin": True, "title": "", "progress": None}),
        "study_design": (po.study_design, {
            "design": design()[0], "wanted": 1e-6, "limit": 0.1, "near": False, "thin": True, "title": "",
            "progress": None}),
    }  # fmt: skip


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
