"""Random strength and orbits in a problem file."""

import json
import math
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import printed
from helpers.problem_files import PROBLEMS, changed

import plough_opt as po
from plough_opt.problem_file.uncertain import optimise_robust

# --- random strength in problem files: as quantities or a record, in every question that takes a result ---

GIVEN = 'random_strength = { rms = 0.2, correlation_length = "0.3 m" }'
NAMES = ("stationary_force_rms", "stationary_displacement_rms")
WAVE = 'strength_wave = { amplitude = 0.3, wavelength = "0.2 m" }'


def written(given=GIVEN, *places):
    """Return a problem file with random strength in the place of its wave, and its RMS in that of a run's."""
    return changed((WAVE, given), ("force_rms  =", "stationary_force_rms ="), *places)


@pytest.fixture(autouse=True)
def record(tmp_path):
    """Put a record beside the file."""
    return Path(shutil.copy(PROBLEMS / "transect.csv", tmp_path / "record.csv"))


def test_a_record_becomes_its_spectrum(read, record):
    scene = read(written('random_strength = { record = "record.csv" }')).scene()
    told = po.strength_spectrum(po.read_strength_record(record))
    assert np.array_equal(scene.effects.random_strength.density, told.density)
    broad = read(written('random_strength = { record = "record.csv", base_diameter = "0.5 m" }')).scene()
    assert broad.effects.random_strength.wave_number[-1] <= 4.0 * math.pi
    assert broad.stationary_force_rms < scene.stationary_force_rms


def test_it_is_a_column_of_sweeps_and_an_output_of_components(read):
    problem = read(written(), "scene.duration=0.2 s", "scene.outputs=20")
    over = {"effects.random_strength.rms": [0.1, 0.2], "scene.stiffness": [4e4, 8e4]}
    tables = []
    for method in ("each", "batch"):
        with ThreadPoolExecutor(1) as inline, po.sweep(problem, over, method=method, executor=inline) as found:
            tables.append(found.table)
    made = problem.component([*over], [*NAMES])
    for k in range(4):
        at = {name: tables[0][k][name] for name in over}
        scene = problem.scene(at)
        for found in (*(tuple(table[k][name] for name in NAMES) for table in tables), made(*at.values())):
            assert found == pytest.approx(tuple(getattr(scene, name) for name in NAMES), rel=1e-10)


def test_its_sensitivities_are_those_of_the_closed_form(read):
    """All of it is proportional to the RMS of strength: the objective's slope by that is its second term over it."""
    # Of a steady motion the deflection at every output time is one limit many times over.
    text = written(GIVEN, ("deflection      =", "mean_deflection ="))
    best, run = read(text).optimise(parameters=True, search="near")
    found = best.sensitivity("effects.random_strength.rms")
    assert found.objective == pytest.approx(run.scene.stationary_force_rms / 1e3 / 0.2, rel=1e-6)


def test_it_is_a_measure_of_an_uncertain_soil(read):
    """Over samples of the soil its mean is that of the closed form in each of them."""
    uncertain = "\n[uncertain]\nsamples = 8\nfresh = 100\nsoil.cohesion = "
    uncertain += '{ distribution = "normal", mean = "20 kPa", std = "3 kPa" }\n'
    still = ('damping = "400 N*s/m"', "motion = false"), ('deflection      = { at_most = "0.12 m" }', "")
    problem = read(written(GIVEN, *still) + uncertain)
    found = optimise_robust(problem, lambda *_: None)
    at = found.best.variables
    scenes = [problem.scene({**at, "soil.cohesion": k}) for k in found.robust.samples.property("cohesion").tolist()]
    expected = [scene.stationary_force_rms for scene in scenes]
    assert found.robust.values(at)["stationary_force_rms"] == pytest.approx(expected, rel=1e-9)
    draft = [scene.steady_resistance for scene in scenes]
    assert found.best.objective == pytest.approx((np.mean(draft) + np.mean(expected)) / 1e3, rel=1e-8)


LIKE = "effects.random_strength"


@pytest.mark.parametrize(
    ("given", "words", "places"),
    [
        ("random_strength = { rms = 0.2 }", f"'correlation_length' is missing: give it in [{LIKE}]", []),
        ('random_strength = { record = "none.csv" }', "there is no file", []),
        ('random_strength = { record = "record.csv", rms = 0.2 }', f"'{LIKE}.rms' and a record", []),
        ('random_strength = { record = "record.csv", base_diameter = "3" }', "'base_diameter' = \"3\" has no unit", []),
        ('random_strength = { record = "record.csv", base_diameter = "50 m" }', "no waves longer than 50 m", []),
        ("", "'stationary_force_rms': the stationary RMS needs strength that varies", []),
        ("", "which is missing", [("[variables]", f"[variables]\n'{LIKE}.rms' = {{ lower = 0.1, upper = 0.2 }}")]),
        (GIVEN, "the stationary RMS needs some damping", [('damping = "400 N*s/m"', "inertial_drag = false")]),
    ],
)
def test_what_is_wrong_has_its_line(refusal, given, words, places):
    said = refusal(written(given, *places))
    assert said.startswith("share.toml, line ")
    assert words in said


# --- periodic orbits in problem files: what they become, what commands make of them, what is refused, with its line ---

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


WAVE_LINE = 'strength_wave = { amplitude = 0.3, wavelength = "0.2 m" }\n'


@pytest.mark.parametrize(
    ("text", "fragment", "piece"),
    [
        (orbit('"periodic"\nharmonics = 5'), "harmonics", "'effects.harmonics' belongs to orbit = \"harmonic_"),
        (orbit('"harmonic_balance"\nharmonics = 65'), "harmonics", "'effects.harmonics'"),
        (orbit('"harmonic_balance"\nharmonic = 3'), "harmonic = 3", "did you mean 'harmonics'?"),
        (orbit('"steady"'), "orbit", "'effects.orbit'"),
        (changed(("[effects]\n", '[effects]\norbit = "periodic"\n')), "duration =", "whose duration is one wave"),
        (orbit('"periodic"\nstart = "towed"\nentry = true'), "[effects]", "an orbit has no start"),
        (orbit('"periodic"', (WAVE_LINE, "")), "[effects]", "an orbit needs a strength_wave"),
    ],
    ids=["harmonics", "too many", "misspelt", "unknown", "duration", "start", "no wave"],
)
def test_what_no_orbit_has_is_refused_at_its_line(blames, text, fragment, piece):
    blames(text, fragment, piece)
