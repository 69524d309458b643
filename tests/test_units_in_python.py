"""Quantities in Python: texts and pint quantities as well as SI numbers, refusals with a remedy, likely slips."""

import dataclasses
import math
import warnings

import casadi as ca
import numpy as np
import pint
import pytest
from helpers.refusals import refusals
from helpers.scenes import SEROZEM, scene_of

import plough_opt as po
from plough_opt.app.main import main
from plough_opt.core.quantities import EVERY
from plough_opt.motion.scene import quantities_of, with_quantities
from plough_opt.problem_file import template

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


def test_arrays_may_have_a_unit():
    np.testing.assert_allclose(po.Cone(0.2, U.Quantity([20.0, 30.0], "cm")).height, [0.2, 0.3], rtol=1e-15)


test_invalid_quantities_are_refused = refusals(
    po.InputError,
    (lambda: scene_of(stiffness="50 kg"), '= "50 kg" has the wrong unit: expected a quantity in N/m, like "50 kN/m"'),
    (lambda: scene_of(stiffness="fifty"), 'stiffness = "fifty" is not a quantity: write it like "50 kN/m"'),
    (lambda: scene_of(stiffness="50"), 'stiffness = "50" has no unit: write it like "50 kN/m"'),
    (lambda: scene_of(stiffness=50 * U.kg), 'stiffness = "50 kilogram" has the wrong unit'),
)


SLIPS = {
    "stiffness": (lambda x: po.Scene(SEROZEM, po.Cone(0.2, 0.25), x, 20.0, 2.0), 50, "50 kN/m"),
    "tow speed": (lambda x: po.Scene(SEROZEM, po.Cone(0.2, 0.25), 5e4, 20.0, x), 7.2, "7.2 km/h"),
    "share height": (lambda x: po.Cone(0.2, x), 250.0, "250 mm"),
    "height in cm": (lambda x: po.Cone(0.2, x), 5.0, "5 cm"),
    "cohesion": (lambda x: po.Soil(1350.0, 0.794, x, 0.5, 0.5), 20, "20 kPa"),
    "density of the share's material": (lambda x: po.Cone(0.2, 0.25).solid_mass(x), 7.85, "7.85 g/cm^3"),
    "parameter": (lambda x: po.Design().parameter("stiffness", x, unit="N/m"), 50, "50 kN/m"),
    "cone index": (lambda x: po.Soil.from_cone_index(x, SEROZEM), 1500.0, "1500 kPa"),
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


def test_an_implausible_value_warns_once_and_not_where_the_toolkit_copies_it():
    scene = scene_of(stiffness="50 N/m", motion=False)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        po.simulate(scene, 0.1)
        with pytest.raises(po.ImplausibleValue):
            dataclasses.replace(scene, stiffness=60.0)
        assert with_quantities(scene, {"scene.stiffness": 60.0}).stiffness == 60.0


def test_typical_values_are_plausible():
    for quantity in EVERY.values():
        assert quantity.slip(quantity.typical) == "", quantity.name
        assert quantity.plausible[0] < quantity.typical <= quantity.plausible[1]


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


def test_a_unit_outside_physics_only_labels_reports():
    assert D.variable("price", guess=2.0, lower=1.0, upper=3.0, unit="EUR").name() == "price"


def test_an_implausible_value_in_a_file_is_noted(capsys, tmp_path):
    path = tmp_path / "slip.toml"
    path.write_text(template().replace('tow_speed = "7.2 km/h"', 'tow_speed = "7.2 m/s"'), encoding="utf-8")
    problem = po.read_problem(path)
    (caution,) = problem.cautions
    assert caution == "scene.tow_speed = 7.2 m/s: did you mean 7.2 km/h?"
    assert main(["check", str(path)]) == 0
    said = capsys.readouterr().err
    assert f"note: {caution}" in said
    assert "ImplausibleValue" not in said


def test_durations_bounds_and_limits_accept_texts_and_pint():
    scene, stiffness = scene_of(), ca.MX.sym("stiffness")
    varied = scene_of(stiffness=stiffness, damping=400.0)
    given = po.Input("scene.stiffness", "20 kN/m", 200.0 * U.kN / U.m)
    assert (given.lower, given.upper) == pytest.approx((2e4, 2e5), rel=1e-15)
    assert po.Output("mean_draft", upper="8 kN").upper == 8e3
    wanted = po.Batch(varied, 0.2, [stiffness])([[5e4]]).mean_draft
    for duration in ("200 ms", 0.2 * U.s):
        assert po.simulate(scene, duration).duration == 0.2
        assert po.Batch(varied, duration, [stiffness])([[5e4]]).mean_draft == wanted
        made = po.component(scene, duration, inputs=[given], outputs=["mean_draft"])
        assert made(5e4) == po.component(scene, 0.2, inputs=["scene.stiffness"], outputs=["mean_draft"])(5e4)
