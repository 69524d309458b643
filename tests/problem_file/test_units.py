"""Quantities with units: what is read, what is refused and why, and how a value is given back."""

import math
import subprocess
import sys
from pathlib import Path

import hypothesis.strategies as st
import pytest
from hypothesis import given, settings

import plough_opt as po
from plough_opt.core import units
from plough_opt.core.units import Unit, display_of

# SI unit, what a user writes, the value in SI worked out by hand.
READ = [
    ("m/s", "7.2 km/h", 2.0),
    ("m/s", "10 mph", 4.4704),
    ("rad", "15 deg", math.pi / 12),
    ("rad", "15°", math.pi / 12),
    ("N*s/m", "400 N s/m", 400.0),
    ("kg/m^3", "1.35 g/cm^3", 1350.0),
    ("kg/m^3", "1.35 g/cm³", 1350.0),
    ("m", "-3e2 mm", -0.3),
    ("s^2/m^2", "0.01 s^2/m^2", 0.01),
    ("Pa", "9.80665 m/s^2*kg/m^2", 9.80665),
    ("Pa", "1 N*m**-2", 1.0),
    ("Pa", "1 kN*m^-1.5*m^-0.5", 1e3),
    ("", "30 %", 0.3),
    ("", "0.3", 0.3),
    ("", 1, 1.0),
]


@pytest.mark.parametrize(("unit", "written", "expected"), READ)
def test_a_quantity_is_read_in_si(unit, written, expected):
    value = Unit(unit).parse(written)
    assert isinstance(value, float)
    assert value == pytest.approx(expected, rel=1e-14)


def test_common_units_have_pint_factors():
    # They are parsed without pint, and must be equal to the last bit to what it gives for any other spelling.
    for unit, (factor, root) in units._ROOTS.items():
        expected, kind = units.registry().get_root_units(unit.replace("%", "percent"))
        assert (factor, root) == (expected, str(kind)), unit


def test_the_problems_are_read_without_a_registry_of_units():
    code = """if True:
        import sys
        import plough_opt as po
        for path in sys.argv[1:]:
            problem = po.read_problem(path)
            for share in problem.shares.values() or [problem]:
                share.scene()
        sys.exit("pint" in sys.modules)"""
    problems = sorted(map(str, Path("problems").glob("*.toml")))
    assert subprocess.run([sys.executable, "-c", code, *problems], check=False).returncode == 0


NO_QUANTITY = "is not a quantity: write it like "
# SI unit, what a user writes, what the refusal says.
REFUSED = [
    ("m/s", "7.2 kg", '= "7.2 kg" has the wrong unit: expected a quantity in m/s, like "7.2 km/h"'),
    ("", "0.3 m", '= "0.3 m" has the wrong unit: expected a pure number, like 0.3'),
    # An angle is not a pure number, nor the reverse.
    *((*case, "wrong unit") for case in (("", "25 deg"), ("", "0.5 rad"), ("rad", "50 %"), ("rad", "3 mm/m"))),
    # An unknown unit with the nearest, or with those that are usual.
    ("Pa", "20 KPa", "unknown unit 'KPa'", "did you mean", "'kPa'"),
    ("N/m", "50 kN/mm2", "unknown unit 'mm2'", "did you mean", "'mm'"),
    ("m/s", "5 fast", "unknown unit 'fast': valid names: ", "km/h"),
    ("m", "2 m/s/", "is not a quantity: its unit cannot be read"),
    # A number without its unit, and a unit without its number.
    ("m", 0.3, '= 0.3 has no unit: write it like "0.3 m"'),
    ("rad", "25", '= "25" has no unit: write it like "25 deg"'),
    ("m/s", "km/h", 'like "7.2 km/h"'),
    # A decimal comma is not read as another number.
    *(("m/s", written, written) for written in ("7,2 km/h", "[7, 2] km/h")),
    *((unit, other, NO_QUANTITY) for unit in ("m", "") for other in (True, [1.0], {"a": 1}, None, b"2 m")),
    *(("m", written, NO_QUANTITY) for written in ("", " ", "m 2 m)", "\x00", "nan m", "inf m", "9**9**9**9 m")),
    *((unit, value, "finite") for unit, value in (("m", "1e400 m"), ("", math.nan), ("", math.inf), ("", 10**400))),
    # Powers of units are one digit; a larger one is not computed.
    *(("m/s", f"1 {power}", "has an unreadable unit") for power in ("m^9^9^9", "m**9**9", "m^-99", "m^1.25")),
    ("m/s", f"{'1' * 400} km/h", "has 405 characters; a quantity may have at most 100: write it like"),
]


@pytest.mark.parametrize(("unit", "written", "pieces"), [(unit, written, pieces) for unit, written, *pieces in REFUSED])
def test_what_is_no_quantity_of_the_kind_is_refused(unit, written, pieces):
    with pytest.raises(po.InputError) as caught:
        Unit(unit).parse(written)
    assert [piece for piece in pieces if piece not in str(caught.value)] == []


@pytest.mark.parametrize(
    ("unit", "written", "symbol", "factor", "value", "text"),
    [
        ("m/s", "7.2 km/h", "km/h", 1 / 3.6, 2.5, "9 km/h"),
        ("N/m", "50 kN/m", "kN/m", 1e3, 123456.0, "123.46 kN/m"),
        ("", "30 %", "%", 0.01, 0.125, "12.5 %"),
        ("", 0.3, "", 1.0, 0.25, "0.25"),
    ],
)
def test_results_are_given_in_the_unit_of_the_user(unit, written, symbol, factor, value, text):
    display = display_of(written, Unit(unit))
    assert display.symbol == symbol
    assert display.factor == pytest.approx(factor, rel=1e-12)
    assert display.text(value) == text


WRITTEN_UNITS = [(unit, written.split(" ", 1)[1]) for unit, written, _ in READ if " " in str(written)]


@settings(deadline=None)  # the first quantity of all builds the registry of units
@given(number=st.floats(-1e9, 1e9).filter(lambda x: x == 0 or abs(x) > 1e-9), units=st.sampled_from(WRITTEN_UNITS))
def test_a_displayed_quantity_reads_back_as_the_same_value(number, units):
    symbol, written = units
    unit = Unit(symbol)
    value = unit.parse(f"{number!r} {written}")
    shown = display_of(f"1 {written}", unit).text(value, digits=17)
    assert unit.parse(shown) == pytest.approx(value, rel=1e-12, abs=0.0)
