"""Changes to a problem file from the command line: ``--set KEY=VALUE``."""

import math

import pytest
from helpers.problem_files import COTTON, changed
from helpers.scenes import Shank

from plough_opt.motion.effects import OWN_EFFECTS

CHANGES = [
    ('scene.tow_speed="2.5 m/s"', lambda p: p.scene().tow_speed, 2.5),
    ("scene.tow_speed=2.5 m/s", lambda p: p.scene().tow_speed, 2.5),
    ("effects.strength_wave={amplitude = 0, wavelength = '1 m'}", lambda p: p.scene().effects.waves[0].wavelength, 1.0),
    ("effects.added_mass=false", lambda p: p.scene().effects.added_mass, False),
    ("soil.name=heavy clay", lambda p: p.scene().soil.name, "heavy clay"),
    ("title=A = B", lambda p: p.title, "A = B"),
    ('variables."share.height".upper=0.4 m', lambda p: p.variables["share.height"].upper, 0.4),
    ("variables.share.height.guess=20 cm", lambda p: p.scene().share.height, 0.2),
    ('require.loosened_radius.at_least="0.1 m"', lambda p: p.table.require["loosened_radius"].at_least, "0.1 m"),
    ("variables.soil.density={ lower = '1.3 t/m^3', upper = '1.5 t/m^3' }", lambda p: p.scene().soil.density, 1400.0),
    ("scene.tow_speed=5 mph", lambda p: p.displays["scene.tow_speed"].symbol, "mph"),
]


@pytest.mark.parametrize(("override", "value", "expected"), CHANGES, ids=[text for text, *_ in CHANGES])
def test_a_key_is_changed(read, override, value, expected):
    problem = read(COTTON, override)
    found = value(problem)
    assert found == (pytest.approx(expected, rel=1e-14) if isinstance(expected, float) else expected)
    assert problem.notes == ()


def test_a_field_of_an_own_effect_without_a_unit_is_taken_as_written(read, monkeypatch):
    monkeypatch.setitem(OWN_EFFECTS, "plain", Shank)
    assert read(COTTON, "effects.own=[{effect='plain', viscous=30}]").scene().effects.own == (Shank(viscous=30),)


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


REFUSED = [
    ("scene.tow_speed=2.5", "'scene.tow_speed' = 2.5 has no unit", '"7.2 km/h"'),
    ("scene.tow_sped=2.5 m/s", "'scene.tow_sped' is not a known key", "did you mean 'tow_speed'?"),
    ("share.height=-0.3 m", "share height = -0.3 m", "above 0"),
    ("effects.start=rst", "'effects.start' = 'rst' is unknown", "did you mean 'rest'?"),
    ("effects.motion=no", "'effects.motion' = 'no' must be true or false"),
    ("scene.outputs=2.5", "'scene.outputs' = 2.5 must be a whole number"),
    ("title=3", "'title' = 3 must be a text in quotes"),
    ("scene.outputs=0", "'scene.outputs' = 0 must be at least 1"),
    ("scene..tow_speed=2 m/s", "'scene..tow_speed' is not a key"),
    ("accuracy.error='1e-6'", "'accuracy.error' = '1e-6' must be a number"),
    ("variables.share.hight.upper=0.4 m", "share.hight", "did you mean 'share.height'"),
    ("require.half_angle.at_least=20 deg", "contradict each other", "at least 20 deg is above at most 15 deg"),
    ("scen.tow_speed=2 m/s", "no table is named 'scen'", "did you mean 'scene'?"),
    ("scene.tow_speed.x=3", "'tow_speed' is a value"),
    ("scene.tow_speed", "expected KEY=VALUE", 'like scene.tow_speed="2.5 m/s"'),
    ("variables.scene.tow_speed.upper=3 m/s", "'variables.scene.tow_speed.lower' is missing"),
]


@pytest.mark.parametrize(("override", "pieces"), [(t, pieces) for t, *pieces in REFUSED], ids=[t for t, *_ in REFUSED])
def test_a_change_that_cannot_be_is_blamed_and_not_the_file(refusal, override, pieces):
    message = refusal(COTTON, override)
    assert message.startswith(f"--set {override}: ")
    assert message.count("--set") == 1
    assert "\n" not in message
    assert [piece for piece in pieces if piece not in message] == [], message


def test_a_change_is_short_and_printable(refusal):
    for override, expected in (
        (f"title={'x' * 3000}", "at most 2000 characters can be read"),
        (f"title={'[' * 900}{']' * 900}", "more than 8 deep"),
        ("title=a\x07b", "'title' holds U+0007"),
        ("title=a\udcff", "holds U+DCFF"),
    ):
        assert expected in refusal(COTTON, override)


def test_a_variable_that_is_fixed_and_then_bounded_is_blamed_on_the_bound(refusal):
    message = refusal(COTTON, "share.height=0.3 m", "variables.share.height.upper=0.6 m")
    assert message == "--set variables.share.height.upper=0.6 m: 'variables.share.height.lower' is missing: set it too"


def test_a_change_is_not_blamed_for_a_mistake_of_the_file_in_the_same_table(refusal):
    for place, override, mistake in (
        (('tow_speed = "7.2 km/h"\n', ""), "scene.duration=1 s", "line 9: 'tow_speed' is missing"),
        (('upper = "0.5 m"', 'upper = "0.05 m"'), "variables.share.height.log=true", "line 21: the bounds of"),
    ):
        assert refusal(changed(place), override).startswith(f"share.toml, {mistake}")


def test_a_change_can_mend_a_mistake_of_the_file(read):
    assert read(COTTON.replace('"7.2 km/h"', "7.2"), "scene.tow_speed=2 m/s").scene().tow_speed == 2.0
