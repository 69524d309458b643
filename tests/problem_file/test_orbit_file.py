"""Periodic orbits in problem files: what they become, what commands make of them, what is refused, with its line."""

import json

import numpy as np
import pytest
from helpers.commands import printed
from helpers.problem_files import changed

import plough_opt as po

FORMS = {
    '"periodic"': "periodic",
    '"linearised"': "linearised",
    '"harmonic_balance"': po.HarmonicBalance(3),
    '"harmonic_balance"\nharmonics = 7': po.HarmonicBalance(7),
}


def orbit(form, *places):
    """Return the problem file for an orbit, without a duration."""
    return changed(('duration = "2 s"\n', ""), ("[effects]\n", f"[effects]\norbit = {form}\n"), *places)


@pytest.mark.parametrize("form", FORMS)
def test_an_orbit_of_a_file_is_that_of_the_effects(read, form):
    problem = read(orbit(form))
    assert problem.scene().effects.orbit == FORMS[form]
    run = problem.simulate()
    assert run.duration == pytest.approx(0.2 / 2.0, rel=1e-15)
    assert np.array_equal(run.mount_force, po.simulate(problem.scene()).mount_force)


@pytest.mark.parametrize("form", ["periodic", "linearised"])
def test_simulate_reports_saves_and_draws_an_orbit(read, tmp_path, form):
    file, picture = read(orbit(f'"{form}"')).name, tmp_path / "orbit.svg"
    assert ("a share from equilibrium" in printed("simulate", file)) == (form == "periodic")
    run = json.loads(printed("simulate", file, "--json", "--plot", picture))
    assert run["time"][-1] == pytest.approx(0.1, rel=1e-12)
    assert run["mount_force"][-1] == pytest.approx(run["mount_force"][0], rel=1e-10)
    assert (run["error_estimate"] <= 1e-8) == (form == "periodic")
    assert picture.stat().st_size > 1000


@pytest.mark.parametrize("form", ["linearised", pytest.param("periodic", marks=pytest.mark.slow)])
def test_optimise_saves_and_draws_an_orbit_asked_for_from_outside(read, tmp_path, form):
    picture = tmp_path / "design.svg"
    options = ("--set", f"effects.orbit={form}", "--json", "--search", "near", "--plot", picture)
    done = json.loads(printed("optimise", read(orbit('"harmonic_balance"')).name, *options))
    assert done["run"]["scene"]["effects"]["orbit"] == form
    assert done["run"]["time"][-1] == pytest.approx(0.1, rel=1e-12)
    assert picture.stat().st_size > 1000


@pytest.mark.parametrize(
    ("form", "fragment", "piece"),
    [
        ('"periodic"\nharmonics = 5', "harmonics", "'effects.harmonics' belongs to orbit = \"harmonic_balance\""),
        ('"harmonic_balance"\nharmonics = 65', "harmonics", "'effects.harmonics'"),
        ('"harmonic_balance"\nharmonic = 3', "harmonic = 3", "did you mean 'harmonics'?"),
        ('"steady"', "orbit", "'effects.orbit'"),
    ],
)
def test_what_no_orbit_has_is_refused_at_its_line(blames, form, fragment, piece):
    blames(orbit(form), fragment, piece)


def test_a_duration_belongs_to_a_transient(blames):
    blames(changed(("[effects]\n", '[effects]\norbit = "periodic"\n')), "duration =", "orbit", "one wavelength")


@pytest.mark.parametrize(
    ("old", "new", "piece"),
    [
        ("damping =", 'start = "towed"\nentry = true\ndamping =', "an orbit has no start"),
        ('strength_wave = { amplitude = 0.3, wavelength = "0.2 m" }\n', "", "an orbit needs a strength_wave"),
    ],
)
def test_effects_that_exclude_an_orbit_are_refused_in_one_line(refusal, old, new, piece):
    message = refusal(orbit('"periodic"', (old, new)))
    assert message.startswith("share.toml")
    assert piece in message
    assert "\n" not in message
