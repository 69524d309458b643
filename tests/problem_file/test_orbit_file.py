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


@pytest.fixture
def written(cotton):
    """Return the problem file's text for an orbit, without a duration."""

    def written(form, *changes):
        text = cotton
        for old, new in ((DURATION, ""), ("[effects]\n", f"[effects]\norbit = {form}\n"), *changes):
            assert text.count(old) == 1, f"{old!r} must stand in the file once"
            text = text.replace(old, new)
        return text

    return written


def line_of(text, fragment):
    found = [number for number, line in enumerate(text.split("\n"), 1) if fragment in line]
    assert len(found) == 1, f"{fragment!r} must stand on one line"
    return found[0]


@pytest.mark.parametrize("form", FORMS)
def test_an_orbit_of_a_file_is_that_of_the_effects(read, written, form):
    problem = read(written(form))
    assert problem.scene().effects.orbit == FORMS[form]
    run = problem.simulate()
    expected = po.simulate(problem.scene())
    assert run.duration == pytest.approx(0.2 / 2.0, rel=1e-15)
    assert np.array_equal(run.mount_force, expected.mount_force)
    assert run.mean_draft == expected.mean_draft


def test_a_file_without_an_orbit_has_a_transient(read, cotton):
    assert read(cotton).scene().effects.orbit == "transient"
    text = cotton.replace("[effects]\n", '[effects]\norbit = "transient"\n')
    assert read(text).scene() == read(cotton).scene()


def test_an_orbit_may_be_asked_for_from_outside(read, written):
    problem = read(written('"periodic"'), "effects.orbit=linearised")
    assert problem.scene().effects.orbit == "linearised"


def test_the_design_of_a_file_is_that_of_its_orbit(read, written):
    _, run = read(written('"linearised"')).design()
    assert run.scene.effects.orbit == "linearised"


REFUSED = [
    ('"periodic"', [("[effects]", f"{DURATION}[effects]")], "duration =", "duration of its own, one wavelength"),
    ('"linearised"', [("[effects]", f"{DURATION}[effects]")], "duration =", "leave it out"),
    ('"periodic"\nharmonics = 5', [], "harmonics", "'effects.harmonics' belongs to orbit = \"harmonic_balance\""),
    ('"transient"\nharmonics = 5', [("[effects]", f"{DURATION}[effects]")], "harmonics", "belongs to orbit ="),
    ('"harmonic_balance"\nharmonics = 0', [], "harmonics", "'effects.harmonics'"),
    ('"harmonic_balance"\nharmonics = 65', [], "harmonics", "'effects.harmonics'"),
    ('"harmonic_balance"\nharmonics = 2.5', [], "harmonics", "'effects.harmonics'"),
    ('"harmonic_balance"\nharmonics = "3"', [], "harmonics", "'effects.harmonics'"),
    ('"harmonic_balance"\nharmonic = 3', [], "harmonic = 3", "did you mean 'harmonics'?"),
    ('"steady"', [], "orbit", "'effects.orbit'"),
    ("3", [], "orbit", "'effects.orbit'"),
]


@pytest.mark.parametrize(("form", "changes", "blamed", "piece"), REFUSED)
def test_what_no_orbit_has_is_refused_at_its_line(written, refusal, form, changes, blamed, piece):
    text = written(form, *changes)
    message = refusal(text)
    assert message.startswith(f"share.toml, line {line_of(text, blamed)}: ")
    assert piece in message
    assert "\n" not in message


@pytest.mark.parametrize(
    ("change", "piece"),
    [
        (('strength_wave = { amplitude = 0.3, wavelength = "0.2 m" }\n', ""), "an orbit needs a strength_wave"),
        (("damping =", "motion = false\ndamping ="), "motion"),
        (("damping =", 'start = "rest"\ndamping ='), "an orbit has no start"),
        (("damping =", 'tow_ramp = "0.2 s"\ndamping ='), "an orbit has no start"),
        (("damping =", 'start = "towed"\nentry = true\ndamping ='), "an orbit has no start"),
        (("damping =", 'contact = "stick_slip"\ndamping ='), "an orbit takes contact = 'resisting'"),
        (("damping =", 'formulation = "printed"\ndamping ='), "repelling spring has no lasting orbit"),
    ],
    ids=["wave", "motion", "start", "ramp", "entry", "contact", "print"],
)
def test_effects_that_exclude_an_orbit_are_refused_in_one_line(written, refusal, change, piece):
    message = refusal(written('"periodic"', change))
    assert message.startswith("share.toml")
    assert piece in message
    assert "\n" not in message


def test_a_transient_needs_its_duration(cotton, refusal):
    text = cotton.replace(DURATION, "")
    message = refusal(text)
    assert message.startswith(f"share.toml, line {line_of(text, '[scene]')}: 'duration' is missing")
