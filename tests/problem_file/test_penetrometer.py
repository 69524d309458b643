"""Readings of a field and random strength in problem files."""

import math
import shutil
from pathlib import Path

import numpy as np
import pytest
from helpers.problem_files import COTTON, PROBLEMS, STATIC, changed, refused_files

import plough_opt as po
from plough_opt.problem_file.uncertain import distribution_of, optimise_robust

# --- penetrometer readings in problem files: averages, spreads, and what is wrong with its place ---

WIDE = """\
# three places
depth [cm], cone_index [kPa], cone_index [MPa], cone_index [kPa]
0,100,0.12,90
20,900,1.0,800
30,1500,1.7,1400
40,1600,1.9,1500
50,1700,1.9,1600
"""
# Means over 25 to 45 cm by hand: the trapezoids 25-30, 30-40 and 40-45 cm.
MEANS = [
    (5 * (1200 + 1500) / 2 + 10 * 1550 + 5 * (1600 + 1650) / 2) * 1e3 / 20,
    (5 * (1350 + 1700) / 2 + 10 * 1800 + 5 * 1900) * 1e3 / 20,
    (5 * (1100 + 1400) / 2 + 10 * 1450 + 5 * (1500 + 1550) / 2) * 1e3 / 20,
]


NAME = 'name = "serozem"'


@pytest.fixture
def write(tmp_path):
    """Write a CSV file and a problem file that reads it."""

    def made(text=WIDE, depth='"25..45 cm"', more="", file='"field.csv"', problem=COTTON):
        (tmp_path / "field.csv").write_text(text, encoding="utf-8")
        path = tmp_path / "problem.toml"
        lines = f"{NAME}\npenetrometer = {file}\ndepth = {depth}\n{more}\n"
        path.write_text(changed((NAME, lines), text=problem), encoding="utf-8")
        return path

    return made


def test_an_average_over_depth_of_each_insertion(write):
    found = po.read_penetrometer(write().parent / "field.csv", (0.25, 0.45))
    assert found.insertions == pytest.approx(MEANS, rel=1e-14)
    assert found.mean == pytest.approx(np.mean(MEANS), rel=1e-14)
    assert found.spread == pytest.approx(np.std(MEANS, ddof=1), rel=1e-12)
    law = found.distribution()
    assert [law.mean(), law.std()] == pytest.approx([found.mean, found.spread], rel=1e-12)
    with pytest.raises(po.InputError, match=r"lower 0\.45 is not below upper 0\.25"):
        po.read_penetrometer(write().parent / "field.csv", (0.45, 0.25))


def test_insertions_below_each_other_are_the_same(tmp_path):
    rows = [line.split(",") for line in WIDE.splitlines()[2:]]
    long = ["insertion; depth [m]; cone_index [kPa]"]
    for k, factor in ((1, 1.0), (2, 1e3), (3, 1.0)):
        long += [f"{k}; {float(row[0]) / 100}; {float(row[k]) * factor}" for row in rows]
    (tmp_path / "long.csv").write_text("\n".join(long), encoding="utf-8")
    found = po.read_penetrometer(tmp_path / "long.csv", (0.25, 0.45))
    assert found.insertions == pytest.approx(MEANS, rel=1e-12)


def test_a_file_takes_the_level_from_it(write):
    problem = po.read_problem(write())
    soil = problem.scene().soil
    assert po.cone_index(soil) == pytest.approx(np.mean(MEANS), rel=1e-14)
    assert (soil.cohesion, soil.density_ratio) == (20e3, 0.794)
    assert "3 insertions" in problem.readings
    adjusted = po.read_problem(write(more='adjust = "density ratio"')).scene().soil
    assert adjusted.strength_factor == 1.0
    assert po.cone_index(adjusted) == pytest.approx(np.mean(MEANS), rel=1e-12)
    other = po.read_problem(write(), ['soil.cone_index="2 MPa"']).scene().soil
    assert po.cone_index(other) == pytest.approx(2e6, rel=1e-14)


def test_the_insertions_spread_makes_the_design_robust(write):
    text = changed(("\ndeflection ", "\nmean_deflection "))
    text += '\n[uncertain]\n"soil.cone_index" = { distribution = "penetrometer" }\nsamples = 8\nfresh = 100\n'
    problem = po.read_problem(write(problem=text))
    field = distribution_of(problem.table.uncertain, problem.scene().soil)
    assert field.names == ("strength_factor",)
    mean, spread = field.moments["strength_factor"]
    per = problem.scene().soil.strength_factor / np.mean(MEANS)
    # The moments come by a quadrature over the quantiles.
    assert [mean, spread] == pytest.approx([np.mean(MEANS) * per, np.std(MEANS, ddof=1) * per], rel=1e-8)


@pytest.mark.parametrize(("text", "words"), refused_files()["readings"])
def test_what_is_wrong_with_a_file_has_its_place(write, text, words):
    path = write(text)
    with pytest.raises(po.InputError, match=words):
        po.read_penetrometer(path.parent / "field.csv", (0.25, 0.45))
    with pytest.raises(po.InputError, match=r"problem\.toml, line \d+"):
        po.read_problem(path)


@pytest.mark.parametrize(("changes", "words"), refused_files()["depths"])
def test_what_contradicts_itself_is_refused(write, changes, words):
    with pytest.raises(po.InputError, match=words):
        po.read_problem(write(**changes))


# --- a file's cone index is measured: whatever else varies or is uncertain, the soil keeps it ---

SEROZEM = 'name = "serozem"\n'
DEEP = '"0.15 m" }\ncone_index = { at_least = "1 MPa" }'
TEXT = changed((SEROZEM, f'{SEROZEM}cone_index = "1.5 MPa"\n'), ('"0.12 m" }', DEEP), text=STATIC)
UNCERTAIN = """\
[uncertain]
samples = 8
fresh = 100
"soil.cohesion" = { distribution = "lognormal", mean = "20 kPa", std = "6 kPa" }
"soil.density_ratio" = { distribution = "beta", mean = 0.794, std = 0.02, lower = 0.70, upper = 0.88 }
"""


def test_samples_of_other_properties_keep_it(read):
    found = optimise_robust(read(TEXT + UNCERTAIN), lambda *_: None)
    values = found.fresh.values
    # The strength factor follows in every sample: solved in closed form, to all digits but the last.
    assert values["cone_index"] == pytest.approx(np.full(100, 1.5e6), rel=1e-12)
    assert np.std(values["loosened_radius"]) > 1e-3


def test_draft_owes_nothing_to_a_cohesion_beneath_it(read):
    """Static draft follows from the cone index alone: its slope by cohesion is 0, by the reading draft over reading."""
    best, run = read(TEXT).optimise(parameters=True, search="near")
    reading = best.sensitivity("soil.cone_index")
    assert reading.objective == pytest.approx(run.scene.reaction.static / 1e3 / 1.5e6, rel=1e-6)
    assert abs(best.sensitivity("soil.cohesion").objective * 2e4) < 1e-6 * best.objective


# --- a compression test in a problem file: b1 follows the ambient pressure, however that is changed ---

COMPACTION = 'compaction = { pressure = ["25 kPa", "0.05 MPa", "200 kPa"], volume_lost = [0.01, 0.021, 0.066] }'
TESTED = changed((NAME, f'{NAME}\nambient_pressure = "50 kPa"\n{COMPACTION}'), text=STATIC)


def test_the_density_ratio_follows_the_ambient_pressure_of_the_file(read):
    problem = read(TESTED)
    assert problem.scene().soil.density_ratio == pytest.approx(0.979, rel=1e-14)
    # Halfway between 50 and 200 kPa on the scale of the logarithm.
    halfway = 1.0 - (0.021 * 0.066) ** 0.5
    assert problem.scene({"soil.ambient_pressure": 1e5}).soil.density_ratio == pytest.approx(halfway, rel=1e-14)
    again = read(TESTED, "soil.ambient_pressure=100 kPa")
    assert again.scene().soil.density_ratio == pytest.approx(halfway, rel=1e-14)
    assert problem.scene({"soil.density_ratio": 0.8}).soil.density_ratio == 0.8


def test_the_sensitivity_to_the_ambient_pressure_holds_the_density_ratios_part(read):
    """It is the difference of two optima; the density ratio itself is no quantity of the file."""
    problem, step = read(TESTED, "soil.ambient_pressure=70 kPa"), 100.0
    apart = [read(TESTED, f"soil.ambient_pressure={p} Pa").optimise()[0] for p in (7e4 - step, 7e4 + step)]
    slope = (apart[1].objective - apart[0].objective) / (2.0 * step)
    best, _ = problem.optimise(parameters=True)
    assert best.sensitivity("soil.ambient_pressure").objective == pytest.approx(slope, rel=1e-4)
    assert "soil.density_ratio" not in problem.numbers()


@pytest.mark.parametrize(("change", "words"), refused_files()["compaction"])
def test_compression_tests_that_contradict_the_file_are_refused(refusal, change, words):
    said = refusal(TESTED, *change.split(" and "))
    assert words in said
    assert said.count("\n") <= 1  # the mistake, and not everything that follows from it


# --- random strength in problem files: as quantities or a record, in every question that takes a result ---

GIVEN = 'random_strength = { rms = 0.2, correlation_length = "0.3 m" }'
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


@pytest.mark.parametrize(("given", "words", "places"), refused_files()["strength"])
def test_what_is_wrong_has_its_line(refusal, given, words, places):
    said = refusal(written(given, *places))
    assert said.startswith("share.toml, line ")
    assert words in said
