"""Random strength in problem files: as quantities or a record, in every question that takes a result."""

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import plough_opt as po
from plough_opt.problem_file.robust_design import optimise_robust

GIVEN = 'random_strength = { rms = 0.2, correlation_length = "0.3 m" }'
RECORD = 'random_strength = { record = "record.csv" }'
NAMES = ("stationary_force_rms", "stationary_displacement_rms")


@pytest.fixture
def written(changed):
    """Return the problem file's text with random strength in the place of its wave, and its RMS in that of a run's."""

    def written(given=GIVEN, *changes):
        text = changed(('strength_wave = { amplitude = 0.3, wavelength = "0.2 m" }', given))
        text = text.replace("force_rms", "stationary_force_rms")
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        return text

    return written


@pytest.fixture(autouse=True)
def record(tmp_path):
    """Write a record of two waves in noise beside the file."""
    x = np.arange(0.0, 30.0, 0.05)
    noise = np.random.default_rng(1).standard_normal(len(x))
    y = 1500.0 * (1.0 + 0.2 * np.sin(8.0 * x) + 0.1 * np.sin(3.0 * x + 1.0) + 0.05 * noise)
    rows = "\n".join(f"{a:.2f}, {b:.1f}" for a, b in zip(x, y, strict=True))
    (tmp_path / "record.csv").write_text(f"position [m], cone_index [kPa]\n{rows}\n", encoding="utf-8")
    return tmp_path / "record.csv"


def test_a_record_becomes_its_spectrum(read, written, record):
    scene = read(written(RECORD)).scene()
    told = po.strength_spectrum(po.read_strength_record(record))
    assert np.array_equal(scene.effects.random_strength.density, told.density)
    broad = read(written('random_strength = { record = "record.csv", base_diameter = "0.5 m" }')).scene()
    assert broad.effects.random_strength.wave_number[-1] <= 4.0 * math.pi
    assert broad.stationary_force_rms < scene.stationary_force_rms


def test_it_is_a_column_of_sweeps_and_an_output_of_components(read, written):
    problem = read(written(), "scene.duration=0.2 s", "scene.outputs=20")
    over = {"effects.random_strength.rms": [0.1, 0.2], "scene.stiffness": [4e4, 8e4]}
    tables = []
    for method in ("each", "batch"):
        with ThreadPoolExecutor(1) as inline, po.sweep(problem, over, method=method, executor=inline) as found:
            tables.append(found.table)
    made = problem.component(["effects.random_strength.rms", "scene.stiffness"], [*NAMES])
    for k in range(4):
        at = {name: tables[0][k][name] for name in over}
        scene = problem.scene(at)
        values = made(*at.values())
        for j, name in enumerate(NAMES):
            expected = getattr(scene, name)
            assert [table[k][name] for table in tables] == pytest.approx([expected] * 2, rel=1e-10)
            assert values[j] == pytest.approx(expected, rel=1e-10)


def test_its_sensitivities_are_those_of_the_closed_form(read, written):
    """All of it is proportional to the RMS of strength: the objective's slope by that is its second term over it."""
    # Of a steady motion the deflection at every output time is one limit many times over.
    text = written(GIVEN, ("deflection      =", "mean_deflection ="))
    best, run = read(text).optimise(parameters=True, search="near")
    found = best.sensitivity("effects.random_strength.rms")
    part = float(run.scene.stationary_force_rms) / 1e3
    assert found.objective == pytest.approx(part / 0.2, rel=1e-6)


@pytest.mark.parametrize("motion", ["false", pytest.param("true", marks=pytest.mark.slow)])
def test_it_is_a_measure_of_an_uncertain_soil(read, written, motion):
    """Over samples of the soil its mean is that of the closed form in each of them."""
    uncertain = (
        '\n[uncertain]\n"soil.cohesion" = { distribution = "normal", mean = "20 kPa", std = "3 kPa" }\n'
        "samples = 8\nfresh = 100\n"
    )
    damping = ('damping = "400 N*s/m"', "motion = false" if motion == "false" else 'damping = "400 N*s/m"')
    problem = read(written(GIVEN, damping, ('deflection      = { at_most = "0.12 m" }', "")) + uncertain)
    found = optimise_robust(problem, lambda *_: None)
    at = found.best.variables
    scenes = [problem.scene({**at, "soil.cohesion": k}) for k in found.robust.samples.property("cohesion").tolist()]
    expected = [scene.stationary_force_rms for scene in scenes]
    assert found.robust.values(at)["stationary_force_rms"] == pytest.approx(expected, rel=1e-9)
    draft = [scene.steady_resistance for scene in scenes]
    assert found.best.objective == pytest.approx((np.mean(draft) + np.mean(expected)) / 1e3, rel=1e-8)


LIKE = "effects.random_strength"


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("random_strength = { rms = 0.2 }", f"'correlation_length' is missing: give it in [{LIKE}]"),
        ('random_strength = { record = "none.csv" }', "there is no file"),
        ('random_strength = { record = "record.csv", rms = 0.2 }', f"'{LIKE}.rms' and a record"),
        ('random_strength = { record = "record.csv", base_diameter = "3" }', "'base_diameter' = \"3\" has no unit"),
        ('random_strength = { record = "record.csv", base_diameter = "50 m" }', "no waves longer than 50 m"),
        ("", "'stationary_force_rms': the stationary RMS needs strength that varies"),
    ],
)
def test_what_is_wrong_has_its_line(refusal, written, given, words):
    said = refusal(written(given))
    assert said.startswith("share.toml, line ")
    assert words in said


def test_what_belongs_to_it_needs_it_and_its_rms_a_damper(refusal, written):
    said = refusal(written("", ("[variables]", f"[variables]\n'{LIKE}.rms' = {{ lower = 0.1, upper = 0.2 }}")))
    assert f"'{LIKE}.rms' belongs to {LIKE}, which is missing" in said
    said = refusal(written(GIVEN, ('damping = "400 N*s/m"', "inertial_drag = false")))
    assert "the stationary RMS needs some damping" in said
