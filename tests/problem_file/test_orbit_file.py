"""Periodic orbits in problem files: what they become, what commands make of them, what is refused, with its line."""

import json

import numpy as np
import pytest
from helpers.commands import printed
from helpers.problem_files import changed

import plough_opt as po

FORMS = {'"periodic"': "periodic", '"linearised"': "linearised", '"harmonic_balance"': po.HarmonicBalance(3)}
FORMS['"harmonic_balance"\nharmonics = 7'] = po.HarmonicBalance(7)


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


WAVE = 'strength_wave = { amplitude = 0.3, wavelength = "0.2 m" }\n'


@pytest.mark.parametrize(
    ("text", "fragment", "piece"),
    [
        (orbit('"periodic"\nharmonics = 5'), "harmonics", "'effects.harmonics' belongs to orbit = \"harmonic_"),
        (orbit('"harmonic_balance"\nharmonics = 65'), "harmonics", "'effects.harmonics'"),
        (orbit('"harmonic_balance"\nharmonic = 3'), "harmonic = 3", "did you mean 'harmonics'?"),
        (orbit('"steady"'), "orbit", "'effects.orbit'"),
        (changed(("[effects]\n", '[effects]\norbit = "periodic"\n')), "duration =", "whose duration is one wave"),
        (orbit('"periodic"\nstart = "towed"\nentry = true'), "[effects]", "an orbit has no start"),
        (orbit('"periodic"', (WAVE, "")), "[effects]", "an orbit needs a strength_wave"),
    ],
    ids=["harmonics", "too many", "misspelt", "unknown", "duration", "start", "no wave"],
)
def test_what_no_orbit_has_is_refused_at_its_line(blames, text, fragment, piece):
    blames(text, fragment, piece)
