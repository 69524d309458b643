"""Quantities in Python: texts, pint quantities and numbers of every type; likely slips; wrong types refused by name."""

import dataclasses
import decimal
import fractions
import math
import pickle
import warnings
from importlib.resources import files

import casadi as ca
import numpy as np
import pandas
import pint
import pytest
from helpers.refusals import refusals
from helpers.scenes import SEROZEM, scene_of

import plough_opt as po
from plough_opt.core.checks import LEAST, DomainLimit
from plough_opt.core.expressions import exp
from plough_opt.core.units import registry
from plough_opt.motion.scene import quantities_of
from plough_opt.soil import plastic

U = pint.UnitRegistry()


def test_texts_pint_quantities_and_si_numbers_make_the_same_scene():
    def scene(soil, angles, height, stiffness, mass, speed, wave, damping):
        effects = po.Effects(strength_wave=po.StrengthWave(*wave), damping=damping)
        return po.Scene(po.Soil(*soil), po.Wedge(*angles, height), stiffness, mass, speed, effects)

    numbers = scene((1350.0, 0.794, 20e3, po.deg(28), 0.5, 1e5, 10e6), (po.deg(25), po.deg(15)), 0.25, 5e4, 20.0, 2.0,
                    (0.3, 0.2, math.pi / 2), 400.0)  # fmt: skip
    texts = scene(("1.35 g/cm^3", 0.794, "20 kPa", "28 deg", "50 %", "1 bar", "10 MPa"), ("25 deg", "15 deg"), "250 mm",
                  "50 kN/m", "0.02 t", "7.2 km/h", ("30 %", "20 cm", "90 deg"), "0.4 kN*s/m")  # fmt: skip
    soil = (1.35 * U("g/cm^3"), 0.794, 20 * U.kPa, 28 * U.deg, 50 * U.percent, 1 * U.bar, 10 * U.MPa)
    quantities = scene(soil, (25 * U.deg, 15 * U.deg), 25 * U.cm, 50 * U.kN / U.m, 20 * U.kg, 7.2 * U.km / U.h,
                       (0.3, 0.2 * U.m, math.pi / 2), 400 * U.N * U.s / U.m)  # fmt: skip
    # Products of decimal unit factors round by about 1e-16.
    wanted = {name: pytest.approx(value, rel=1e-15) for name, value in quantities_of(numbers).items() if value}
    for made in (texts, quantities):
        assert {name: value for name, value in quantities_of(made).items() if value} == wanted


SLIPS = {
    "stiffness": (lambda x: po.Scene(SEROZEM, po.Cone(0.2, 0.25), x, 20.0, 2.0), 50, "50 kN/m"),
    "tow speed": (lambda x: po.Scene(SEROZEM, po.Cone(0.2, 0.25), 5e4, 20.0, x), 7.2, "7.2 km/h"),
    "share height": (lambda x: po.Cone(0.2, x), 250.0, "250 mm"),
    "cohesion": (lambda x: po.Soil(1350.0, 0.794, x, 0.5, 0.5), 20, "20 kPa"),
    "density of the share's material": (lambda x: po.Cone(0.2, 0.25).solid_mass(x), 7.85, "7.85 g/cm^3"),
}


@pytest.mark.parametrize("name", SLIPS)
def test_a_number_in_another_unit_warns_at_the_callers_line(name):
    make, value, meant = SLIPS[name]
    with pytest.warns(po.ImplausibleValue, match=f"did you mean {meant.replace('^', '.')}?") as caught:
        make(value)
    assert [warning.filename for warning in caught] == [__file__]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        make(meant)  # a value with its unit is meant


def test_a_design_accepts_texts_quantities_and_numbers():
    d = po.Design()
    height = d.variable("height", guess="250 mm", lower="100 mm", upper="0.5 m", tolerance="2 mm")
    d.variable("stiffness", guess=50 * U.kN / U.m, lower="10 kN/m", upper=1e6, unit="N/m", log=True)
    d.minimise(height * d.parameter("cohesion", "20 kPa"))
    d.require("half height", height / 2.0, at_least="60 mm")
    (first, second), (parameter,) = d.declared.variables, d.declared.parameters
    assert (first.guess, first.lower, first.upper, first.unit, first.tolerance) == (0.25, 0.1, 0.5, "m", 0.002)
    assert (second.guess, second.lower, second.upper, second.unit) == (5e4, 1e4, 1e6, "N/m")
    assert (parameter.value, parameter.unit) == (2e4, "Pa")
    assert d.declared.requirements[0].limits_text() == "at least 60 mm"
    best = d.solve(search="near")
    assert best.variables["height"] == pytest.approx(0.12, rel=1e-7)
    assert "120 mm" in str(best)
    assert "100 mm to 500 mm" in str(best)


D, X = po.Design(), ca.MX.sym("x")
test_plain_numbers_with_a_unit_that_is_not_si_are_refused_with_the_remedy = refusals(
    po.InputError,
    (lambda: D.variable("height", guess=2, lower=1, upper=3, unit="mm"), '"2 mm" as a string, or 0.002 with unit="m"'),
    (lambda: D.require("draft", X, at_most=5, unit="kN"), '"5 kN" as a string, or 5000 with unit="N"'),
    (lambda: D.parameter("friction", 28, unit="deg"), '"28 deg" as a string, or 0.488692 with unit="rad"'),
    (lambda: D.variable("mixed", guess="2 m", lower="1 kg", upper="3 m"), 'lower = "1 kg" has the wrong unit'),
    (lambda: po.Input("gap", 1.0, 2.0, unit="mm", symbol=X), "a plain number, but 'mm' is not an SI"),
    (lambda: D.variable("far", guess="2 furlongz", lower=0, upper=3), "variable 'far' = \"2 furlongz\" has an unk"),
    (lambda: po.Input("scene.stiffness", "20 kN"), "wrong unit"),
    (lambda: po.Output("mean_draft", upper="8 m"), "wrong unit"),
)


# --- arguments of the wrong type or outside a formula's domain are refused by name ---


SOIL = po.named_soil("serozem")
CONE = po.Cone(0.2, 0.25)
IN_SOIL = po.ShareInSoil(CONE, CONE, SOIL, 1.0)
NODES = [(0.0, 0.0), (0.5, 0.05)]
LINE = np.arange(40.0)


def _record(values, positions=LINE):
    return po.StrengthRecord(positions, values)


def _denser(order=16):
    return SOIL.with_density_profile(lambda r, w: 1350.0 * (1.05 + 0.3 * exp(-((r / w) ** 2))), 0.15, order=order)


# --- arrays where a formula needs one number ---

ARRAYS = {
    "angles": lambda n: po.resistance(po.Cone(np.linspace(0.1, 0.2, n), 0.25), _denser(), 2.0, 0.0),
    "cohesion": lambda n: po.resistance_coefficients(CONE, dataclasses.replace(_denser(), cohesion=1e4 + np.arange(n))),
    "a column of symbols": lambda n: po.soil_reaction(po.Cone(ca.MX.sym("angle", n), 0.25), _denser()),
    "a column of numbers": lambda n: po.soil_reaction(po.Cone(ca.DM(np.linspace(0.1, 0.2, n)), 0.25), _denser()),
    "speeds of a cone": lambda n: po.elastic.cone_force(NODES, SOIL, np.linspace(1.0, 2.0, n)),
    "speeds of integrals": lambda n: po.elastic.fourier.wedge_stress(0.2, 0.1, float, 0.5, SOIL, np.linspace(1, 2, n)),
}


@pytest.mark.parametrize("call", ARRAYS.values(), ids=ARRAYS)
# As many elements as a quadrature has nodes or cells would broadcast against these and give wrong numbers.
@pytest.mark.parametrize("count", [3, 7, 16])
def test_arrays_never_meet_the_nodes_of_a_quadrature(call, count):
    with pytest.raises(po.InputError, match="one number per quantity"):
        call(count)


# --- wrong types, and numbers that would overflow ---


WRONG = {
    "soil of a scene": (lambda: scene_of(soil="serozem"), "scene's soil = 'serozem' must be a Soil, for instance name"),
    "effects": (lambda: po.Scene(SOIL, CONE, 5e4, 25.0, 2.0, None), "scene's effects = None must be an Effects"),
    "a wedge": (lambda: po.added_mass(po.Wedge(0.5, 0.2, 0.25), SOIL), r"must be a Cone: use its equivalent_cone\(\)"),
    "a tuple": (lambda: po.resistance(CONE, SOIL, (0.2, 0.3), 0.0), "speed = .* must be a number or a NumPy array"),
    "8 bits": (lambda: po.Cone(0.2, np.array([1, 10], dtype=np.int8)), "share height has type int8, .* float"),
    "short column": (lambda: _record(np.ones(39)), r"of equal length, not of shapes \(40,\) and \(39,\)"),
    "limits": (lambda: po.Output("mean_draft", lower=2.0, upper=1.0), "'mean_draft': its limits .* 2 is above"),
}


test_wrong_types_are_refused_with_the_right_ones = refusals((po.InputError, po.DomainError), *WRONG.values())


# --- every type of number gives the value of the float, or is refused ---

KINDS = {
    **{kind.__name__: kind for kind in (np.int8, np.int16, np.int32, np.int64, np.uint8, np.uint16, np.uint32)},
    **{kind.__name__: kind for kind in (np.uint64, np.float16, np.float32, np.float64, np.longdouble, complex)},
    "int": int, "a subclass": type("Metres", (float,), {}), "0-d": lambda x: np.array(x), "bool": lambda _: True,
    "0-d int": lambda x: np.array(int(x)), "a fraction": fractions.Fraction, "a decimal": decimal.Decimal,
    "text": lambda x: f"{x}", "None": lambda _: None, "a column": lambda x: pandas.Series([x, x]),
    "a quantity": lambda x: registry().Quantity(x, "m^7"), "a symbol's name": lambda _: "x",
}  # fmt: skip
# Largest value tried and a function of it.
TAKES = {
    "height": (2e9, lambda x: po.Cone(0.17, x).volume),
    "half angle": (1, lambda x: po.Cone(x, 0.25).volume),
    "speed": (1e30, lambda x: po.resistance(CONE, SOIL, x, 0.0)),
    "cohesion": (1e9, lambda x: po.soil_reaction(CONE, dataclasses.replace(SOIL, cohesion=x)).static),
    "cavity": (1e30, lambda x: plastic.front_radius(plastic.Cavity(x, 1.0, 0.0), SOIL)),
    "stiffness": (2e9, lambda x: scene_of(stiffness=x).natural_frequency),
    "tow speed": (1e9, lambda x: scene_of(tow_speed=x).steady_resistance),
    "elastic speed": (30, lambda x: po.elastic.wedge_force(NODES, SOIL, x)),
    "width of a tine": (1e5, lambda x: po.laws.UniversalEarthmoving(x, x, 1.0, adhesion=x).reaction(IN_SOIL).static),
}


@pytest.mark.parametrize("takes", TAKES)
def test_every_type_of_number_gives_the_value_of_the_float_or_is_refused(takes):
    most, function = TAKES[takes]
    random, refused = np.random.default_rng(8), set()
    for name, kind in KINDS.items():
        for value in [float(round(10.0 ** random.uniform(0.0, math.log10(most)))) for _ in range(3)] + [float(most)]:
            with warnings.catch_warnings(), np.errstate(all="ignore"):
                warnings.simplefilter("ignore")  # of implausible sizes, and of casts out of range in this test
                try:
                    given = kind(value)
                except OverflowError:  # an integer without so many digits
                    continue
                try:
                    found = function(given)
                except (po.InputError, po.DomainError):
                    refused.add(name)
                    continue
                expected = function(float(given))
            # A float of four bytes is exactly the float that is expected.
            assert np.all(np.isfinite(found)), (name, value)
            np.testing.assert_allclose(found, expected, rtol=1e-14, err_msg=f"{name} {value}")
    assert refused >= {"complex", "a fraction", "a decimal", "text", "None", "a column", "a quantity", "bool"}
    assert not refused & {"float64", "a subclass", "0-d"}


# --- pickled errors ---


def test_errors_come_back_from_another_process():
    infeasible = po.InfeasibleDesign("no design", {"draft": 3.0}, ["upper bound"])
    for error in (infeasible, po.NotConverged("it stopped", "Restoration_Failed"), po.InputError("wrong")):
        copy = pickle.loads(pickle.dumps(error))
        assert (type(copy), str(copy), vars(copy)) == (type(error), str(error), vars(error))


def test_the_package_is_marked_as_typed():
    assert (files("plough_opt") / "py.typed").is_file()


def test_the_largest_numbers_are_accepted():
    assert math.isfinite(po.resistance(CONE, SOIL, 1e60, 0.0))
    assert math.isfinite(po.Cone(0.2, 1e60).volume)


def test_a_limit_against_underflow_is_zero_in_a_design():
    assert DomainLimit("x", above=0.0, at_least=LEAST).kept == (0.0, None)


def test_numbers_of_numpy_are_ends_of_a_domain():
    po.Design().parameter("p", 0.5, unit="rad", domain=[np.int64(0), np.float32(2)])
