"""Lasting orbits in problem files: what they become, and what is refused, with the line to blame."""

import numpy as np
import pytest

import plough_opt as po

FORMS = {
    '"periodic"': "periodic",
    '"linearised"': "linearised",
    '"harmonic_balance"': po.HarmonicBalance(3),
    '"harmonic_balance"\nharmonics = 7': po.HarmonicBalance(7),
}
DURATION = 'duration = "2 s"\n'


def orbit(form, *places):
    """Return the changes that make the problem file one for an orbit, without a duration."""
    return (DURATION, ""), ("[effects]\n", f"[effects]\norbit = {form}\n"), *places


@pytest.mark.parametrize("form", FORMS)
def test_an_orbit_of_a_file_is_that_of_the_effects(read, changed, form):
    problem = read(changed(*orbit(form)))
    assert problem.scene().effects.orbit == FORMS[form]
    run = problem.simulate()
    assert run.duration == pytest.approx(0.2 / 2.0, rel=1e-15)
    assert np.array_equal(run.mount_force, po.simulate(problem.scene()).mount_force)


def test_an_orbit_may_be_asked_for_from_outside_and_is_that_of_the_design(read, changed, cotton):
    assert read(cotton).scene().effects.orbit == "transient"
    problem = read(changed(*orbit('"periodic"')), "effects.orbit=linearised")
    assert problem.design()[1].scene.effects.orbit == "linearised"


@pytest.mark.parametrize(
    ("form", "fragment", "piece"),
    [
        ('"periodic"\nharmonics = 5', "harmonics", "'effects.harmonics' belongs to orbit = \"harmonic_balance\""),
        *((f'"harmonic_balance"\nharmonics = {count}', "harmonics", "'effects.harmonics'") for count in (0, 65, 2.5)),
        ('"harmonic_balance"\nharmonic = 3', "harmonic = 3", "did you mean 'harmonics'?"),
        ('"steady"', "orbit", "'effects.orbit'"),
        ("3", "orbit", "'effects.orbit'"),
    ],
)
def test_what_no_orbit_has_is_refused_at_its_line(changed, blames, form, fragment, piece):
    blames(changed(*orbit(form)), fragment, piece)


def test_a_duration_belongs_to_a_transient(changed, blames):
    blames(changed(orbit('"periodic"')[1]), "duration =", "orbit", "one wavelength")


@pytest.mark.parametrize(
    ("effects", "piece"),
    [
        ("motion = false", "motion"),
        ('start = "rest"', "an orbit has no start"),
        ('tow_ramp = "0.2 s"', "an orbit has no start"),
        ('start = "towed"\nentry = true', "an orbit has no start"),
        ('contact = "stick_slip"', "an orbit needs contact = 'resisting'"),
        ('formulation = "printed"', "repelling spring has no periodic orbit"),
    ],
)
def test_effects_that_exclude_an_orbit_are_refused_in_one_line(changed, refusal, effects, piece):
    message = refusal(changed(*orbit('"periodic"', ("damping =", f"{effects}\ndamping ="))))
    assert message.startswith("share.toml")
    assert piece in message
    assert "\n" not in message


def test_an_orbit_needs_a_wave(changed, refusal):
    wave = 'strength_wave = { amplitude = 0.3, wavelength = "0.2 m" }\n', ""
    assert "an orbit needs a strength_wave" in refusal(changed(*orbit('"periodic"', wave)))
