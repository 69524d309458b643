"""Quantities with units in a problem file, changes by --set, and the JSON schema."""

import json
import math
import tomllib
from dataclasses import replace

import hypothesis.strategies as st
import jsonschema
import pytest
from helpers.commands import printed
from helpers.problem_files import COTTON, PROBLEMS, changed, refused_files
from helpers.refusals import refusals
from helpers.scenes import SEROZEM, Shank, scene_of
from hypothesis import given, settings

import plough_opt as po
from plough_opt.core import units
from plough_opt.core.errors import InputError
from plough_opt.core.units import Unit, display_of
from plough_opt.problem_file import template
from plough_opt.problem_file.written import problem_of

# --- quantities with units: what is read, what is refused and why, and how a value is given back ---

# SI unit, what a user writes, the value in SI worked out by hand.
READ = [
    ("m/s", "7.2 km/h", 2.0),
    ("rad", "15 deg", math.pi / 12),
    ("N*s/m", "400 N s/m", 400.0),
    ("kg/m^3", "1.35 g/cm^3", 1350.0),
    ("m", "-3e2 mm", -0.3),
    ("s^2/m^2", "0.01 s^2/m^2", 0.01),
    ("Pa", "9.80665 m/s^2*kg/m^2", 9.80665),
    ("Pa", "1 kN*m^-1.5*m^-0.5", 1e3),
    ("", "30 %", 0.3),
    ("", "0.3", 0.3),
]


@pytest.mark.parametrize(("unit", "written", "expected"), READ)
def test_a_quantity_is_read_in_si(unit, written, expected):
    value = Unit(unit).parse(written)
    assert isinstance(value, float)
    assert value == pytest.approx(expected, rel=1e-14)


def test_common_units_have_pint_factors():
    # They are parsed without pint, and must be equal to what it gives for any other spelling, to the last bit from pint
    # 0.25 on: pint before rounds miles per hour otherwise.
    for unit, (factor, root) in units._ROOTS.items():
        expected, kind = units.registry().get_root_units(unit.replace("%", "percent"))
        assert (factor, root) == (pytest.approx(expected, rel=2.3e-16, abs=0.0), str(kind)), unit


NO_QUANTITY = "is not a quantity: write it like "
# SI unit, what a user writes, what the refusal says.
WRONG = [
    ("m/s", "7.2 kg", '= "7.2 kg" has the wrong unit: expected a quantity in m/s, like "7.2 km/h"'),
    ("", "0.3 m", '= "0.3 m" has the wrong unit: expected a pure number, like 0.3'),
    *((*case, "wrong unit") for case in (("", "25 deg"), ("", "0.5 rad"), ("rad", "50 %"), ("rad", "3 mm/m"))),
    ("Pa", "20 KPa", "unknown unit 'KPa'", "did you mean", "'kPa'"),
    ("m/s", "5 fast", "unknown unit 'fast': valid names: ", "km/h"),
    ("m", 0.3, '= 0.3 has no unit: write it like "0.3 m"'),
    *(("m/s", written, written) for written in ("7,2 km/h", "[7, 2] km/h")),
    *((unit, other, NO_QUANTITY) for unit in ("m", "") for other in (True, [1.0], {"a": 1}, None, b"2 m")),
    *(("m", written, NO_QUANTITY) for written in ("", " ", "m 2 m)", "\x00", "nan m", "inf m", "9**9**9**9 m")),
    *((unit, value, "finite") for unit, value in (("m", "1e400 m"), ("", math.nan), ("", math.inf), ("", 10**400))),
    *(("m/s", f"1 {power}", "has an unreadable unit") for power in ("m^9^9^9", "m**9**9", "m^-99", "m^1.25")),
    ("m/s", f"{'1' * 400} km/h", "has 405 characters; a quantity may have at most 100: write it like"),
]


@pytest.mark.parametrize(("unit", "written", "pieces"), [(unit, written, pieces) for unit, written, *pieces in WRONG])
def test_what_is_no_quantity_of_the_kind_is_refused(unit, written, pieces):
    with pytest.raises(po.InputError) as caught:
        Unit(unit).parse(written)
    assert [piece for piece in pieces if piece not in str(caught.value)] == []


WRITTEN_UNITS = [(unit, written.split(" ", 1)[1]) for unit, written, _ in READ if " " in str(written)]


@settings(deadline=None)  # the first quantity of all builds the registry of units
@given(number=st.floats(-1e9, 1e9).filter(lambda x: x == 0 or abs(x) > 1e-9), units=st.sampled_from(WRITTEN_UNITS))
def test_a_displayed_quantity_reads_back_as_the_same_value(number, units):
    symbol, written = units
    unit = Unit(symbol)
    value = unit.parse(f"{number!r} {written}")
    shown = display_of(f"1 {written}", unit).text(value, digits=17)
    assert unit.parse(shown) == pytest.approx(value, rel=1e-12, abs=0.0)


# --- changes to a problem file from the command line: ``--set KEY=VALUE`` ---

CHANGES = [
    ("scene.tow_speed=2.5 m/s", lambda p: p.scene().tow_speed, 2.5),
    ("effects.strength_wave={amplitude = 0, wavelength = '1 m'}", lambda p: p.scene().effects.waves[0].wavelength, 1.0),
    ("effects.added_mass=false", lambda p: p.scene().effects.added_mass, False),
    ("soil.name=heavy clay", lambda p: p.scene().soil.name, "heavy clay"),
    ('variables."share.height".upper=0.4 m', lambda p: p.variables["share.height"].upper, 0.4),
    ("variables.soil.density={ lower = '1.3 t/m^3', upper = '1.5 t/m^3' }", lambda p: p.scene().soil.density, 1400.0),
    ("scene.tow_speed=5 mph", lambda p: p.displays["scene.tow_speed"].symbol, "mph"),
]


@pytest.mark.parametrize(("override", "value", "expected"), CHANGES, ids=[text for text, *_ in CHANGES])
def test_a_key_is_changed(read, override, value, expected):
    problem = read(COTTON, override)
    found = value(problem)
    assert found == (pytest.approx(expected, rel=1e-14) if isinstance(expected, float) else expected)
    assert problem.notes == ()


def test_nothing_else_is_changed_and_the_last_change_counts(read):
    first, last = read(COTTON), read(COTTON, "scene.tow_speed=1 m/s", "scene.tow_speed=2.5 m/s")
    assert last.values() == first.values() | {"scene.tow_speed": 2.5}
    assert last.variables == first.variables


def test_a_variable_given_a_value_is_fixed_with_a_note(read):
    problem = read(COTTON, 'share.height="30 cm"', "share.wedge_angle=30 deg")
    assert [*problem.variables] == ["scene.stiffness"]
    assert (problem.scene().share.height, problem.scene().share.angle) == pytest.approx((0.3, math.pi / 6))
    assert problem.notes == (
        "'share.height' is a variable of the file and is now fixed at \"30 cm\"",
        "'share.wedge_angle' is a variable of the file and is now fixed at 30 deg",
    )


@pytest.mark.parametrize(("override", "pieces"), [(text, pieces) for text, *pieces in refused_files()["changes"]])
def test_a_change_that_cannot_be_is_blamed_and_not_the_file(refusal, override, pieces):
    message = refusal(COTTON, override)
    assert message.startswith(f"--set {override}: ")
    assert message.count("--set") == 1
    assert "\n" not in message
    assert [piece for piece in pieces if piece not in message] == [], message


# --- the JSON schema of problem files against an independent validator, and against what reading a file refuses ---

SCHEMA = json.loads(printed("init", "--schema"))
VALIDATOR = jsonschema.Draft202012Validator(SCHEMA)


def test_it_is_a_schema_whose_parts_all_exist():
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    assert '"null"' not in repr(SCHEMA).replace("'", '"')  # TOML has none
    for text in (template(), *(path.read_text(encoding="utf-8") for path in PROBLEMS.glob("*.toml"))):
        VALIDATOR.validate(tomllib.loads(text))


MISTAKES = [
    ('tow_speed = "7.2 km/h"', "tow_speed = 7.2"),
    ('tow_speed = "7.2 km/h"', 'tow_sped = "7.2 km/h"'),
    ('"share.height"      = {', '"share.hight"      = {'),
    ("log = true", 'log = "yes"'),
    ("amplitude = 0.3,", "amplitude = 0.3, height = 2,"),
    ("half_angle      = { at_most", "half_angle      = { at_mots"),
]


@pytest.mark.parametrize(("right", "wrong"), MISTAKES)
def test_a_mistake_is_marked_that_reading_refuses_too(refusal, right, wrong):
    text = changed((right, wrong))
    assert refusal(text)
    assert not VALIDATOR.is_valid(tomllib.loads(text))


# --- scenes of Python as problem files: they say the same scene, or the message names what they cannot say ---

WAVE = po.StrengthWave(0.3, "20 cm")
SAID = {
    "a named soil": scene_of(),
    "its properties": scene_of(soil=replace(SEROZEM, cohesion=25e3, name="mine", source="a trench")),
    "every choice": scene_of(
        inertial_drag=False, added_mass=False, ambient_pressure=False, contact=po.Smooth(0.4), start="rest",
        strength_wave=(WAVE, po.StrengthWave(0.1, 0.5, 0.2)), tow_ramp=0.3, damping=400.0, rate_term=0.02,
    ),
    "events": scene_of(contact=po.StickSlip(1.2), entry=True, start="towed"),
    "an orbit": scene_of(strength_wave=WAVE, damping=400.0, orbit="periodic"),
    "random strength": scene_of(random_strength=po.RandomStrength(0.2, 0.3), damping=400.0),
    "another law": scene_of(medium=po.laws.McKyesAli(depth=0.35)),
    "a speed over time": scene_of(tow_profile=po.SpeedProfile((0.0, 0.5, 1.5), (0.5, 1.0, 0.75))),
    "as printed": scene_of(formulation="printed"),
}  # fmt: skip


@pytest.mark.parametrize("what", SAID)
def test_a_file_says_the_same_scene(what):
    given = SAID[what]
    problem = problem_of(given, None if given.effects.orbit != "transient" else 1.5, 'a "title"')
    assert problem.title == 'a "title"'
    found = problem.scene()
    assert replace(found, soil=replace(found.soil, name=given.soil.name, source=given.soil.source)) == given


def said(**changes):
    return problem_of(scene_of(**changes), 1.0, "")


test_what_a_file_cannot_say_is_named = refusals(
    InputError,
    (lambda: said(share=po.Cone("10 deg", "25 cm")), "a Cone"),
    (lambda: said(soil=SEROZEM.with_density_profile(lambda r: 1000.0 + r)), "scene.soil.density_profile"),
    (lambda: said(own=(Shank(),)), "Shank"),
)
