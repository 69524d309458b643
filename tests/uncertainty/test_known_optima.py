"""Robust designs: optima with known closed forms, and problem files with an uncertain soil."""

import json
import math
import re
import tomllib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from helpers.commands import call, printed
from helpers.differences import check_derivatives
from helpers.problem_files import PROBLEMS
from helpers.small_designs import design
from scipy import stats

import plough_opt as po
from plough_opt.design.model.program import Program
from plough_opt.problem_file import uncertain
from plough_opt.problem_file.uncertain import distribution_of, measure_of, optimise_robust
from plough_opt.studies.uncertainty.result import RobustOptimum

# --- robust optima with known closed forms, or found by hand on a grid ---
# The soil's properties stand for the uncertain numbers of textbook problems; no run takes part.
# Runs of one structure are in one program.

MEAN, STD = 20e3, 4e3
# A normal distribution in units of 10 kPa, and its cohesion as that number.
FIELD = po.SoilDistribution(po.named_soil("serozem"), cohesion=stats.norm(MEAN, STD), within={"cohesion": (1.0, 1e6)})
M, S = MEAN / 1e4, STD / 1e4


def _numbers(robust):
    return FIELD.values(robust.samples, seed=robust.seed)[:, 0] / 1e4


@pytest.mark.parametrize("kappa", [0.0, 1.0, 2.5])
def test_mean_plus_standard_deviations_of_a_linear_loss(kappa):
    """min over x of mean + kappa std of x theta + x^2/2 is x = -(mean - kappa std) where that is below 0."""
    d, x = design(x=(-1.0, -10.0, 10.0))
    robust = po.Robust(FIELD, lambda soil: {"loss": x * soil.cohesion / 1e4 + x**2 / 2}, samples=256, seed=3)
    d.minimise(robust.mean_plus("loss", kappa))
    best = d.solve(search="near")
    own = _numbers(robust)
    # Where the loss falls with theta its spread is -x std.
    assert best.variables["x"] == pytest.approx(-(own.mean() - kappa * own.std()), abs=1e-8)
    # 256 points of a Sobol sequence.
    assert best.variables["x"] == pytest.approx(-(M - kappa * S), abs=5e-3)


@pytest.mark.parametrize("probability", [0.3, 0.8, 0.95])
def test_chance_constraint_on_a_normal_variable(probability):
    """The least stock that suffices with a probability is mean + z std."""
    d, x = design(x=(0.0, -10.0, 10.0))
    robust = po.Robust(FIELD, lambda soil: {"missing": soil.cohesion / 1e4 - x}, samples=128, seed=3)
    robust.require_probability(d, "enough", "missing", probability, at_most=0.0)
    d.minimise(x)
    best = d.solve(search="near")
    z, own = stats.norm.ppf(probability), _numbers(robust)
    assert best.variables["x"] == pytest.approx(own.mean() + z * own.std(), abs=1e-8)
    # 128 points of a Sobol sequence.
    assert best.variables["x"] == pytest.approx(M + z * S, abs=1e-2)
    (check,) = po.uncertainty.verify(robust, best, samples=4096, seed=9).checks
    # What the distribution itself gives at the optimum lies within the interval of the fresh soils.
    assert check.low <= stats.norm.cdf((best.variables["x"] - M) / S) <= check.high


# --- searched over all variables ----------------------------------


GRID = np.linspace(0.0, 1.0, 20_001)


def _valleys(x, theta):
    """Two valleys that the number moves to and fro: the narrow one is deeper, the broad one forgives more."""
    moved = x - 0.03 * (theta - M) / S
    exp = ca.exp if isinstance(x, ca.MX) else np.exp
    return 2.0 - 1.2 * exp(-(((moved - 0.25) / 0.01) ** 2)) - exp(-(((moved - 0.75) / 0.15) ** 2))


def _by_hand(robust):
    """Return the losses on a grid of designs, a row each, over soils."""
    return _valleys(GRID[:, None], _numbers(robust))


@pytest.mark.parametrize("guess", [0.25, 0.5, 0.99])
def test_the_best_over_samples_is_found_from_the_other_valley(guess):
    d, x = design(x=(guess, 0.0, 1.0))
    robust = po.Robust(FIELD, lambda soil: {"loss": _valleys(x, soil.cohesion / 1e4)}, samples=32, seed=2)
    d.minimise(robust.expected("loss"))
    best, means = d.solve(), _by_hand(robust).mean(axis=1)
    # Beside a minimum the grid is off by half its curvature times half a position's square, some 1e-8.
    assert best.objective == pytest.approx(means.min(), abs=1e-7)
    assert best.variables["x"] == pytest.approx(GRID[means.argmin()], abs=1e-4)


UNIFORM_FIELD = po.SoilDistribution(
    po.named_soil("serozem"), cohesion=stats.lognorm(0.3, scale=20e3), density_ratio=stats.beta(8, 4, 0.7, 0.14)
)
FIXED = po.Accuracy("dop853", steps=60)


def _program(d):
    return Program.of(d.declared).with_steps(np.zeros(0))


def _path(count):
    """Return the program of averages over soils, of the path in one of them, and of a run of another structure."""
    d, angle, height, k0 = design(angle=(0.5, 0.2, 0.9), height=(0.25, 0.1, 0.4), stiffness=(2e4, 5e3, 1e5, "", True))
    share = po.Wedge(angle, po.deg(15.0), height)
    effects = po.Effects(strength_wave=po.StrengthWave(0.3, 0.6))
    runs = []

    def response(soil):
        scene = po.Scene(soil, share, k0, 20.0 + share.equivalent_cone().solid_mass(7850.0), 2.0, effects)
        runs.append(po.simulate(scene, 0.8, accuracy=FIXED, outputs=5))
        return {"draft": runs[-1].mean_draft / 1e3, "rms": runs[-1].force_rms / 1e3, "radius": scene.loosened_radius}

    robust = po.Robust(UNIFORM_FIELD, response, samples=count, seed=1)
    other = replace(runs[0].scene, soil=UNIFORM_FIELD.soil, effects=po.Effects(damping=300.0))
    other = po.simulate(other, 0.5, accuracy=FIXED)
    d.minimise(robust.mean_plus("draft", 1.0) + robust.mean_plus("rms", 2.0) + other.mean_draft / 1e3)
    robust.require_probability(d, "radius", "radius", 0.9, at_least=0.1)
    d.require("deflection", other.deflection, at_most=0.3)
    return _program(d)


def test_derivatives_against_differences():
    check_derivatives(_path(6).built.nlp, np.array([0.61, 0.43, 0.37]), np.zeros(0), 1e-7, 1e-6)


def test_the_graph_of_the_derivatives_does_not_grow_with_the_samples():
    sizes = [_path(count).built.nlp.slopes.n_instructions() for count in (4, 12)]
    assert sizes[0] == sizes[1]


# --- problem files with an uncertain soil, from the command line: solved, verified, mistakes reported with their line

FILE = PROBLEMS / "uncertain_field.toml"
TEXT = FILE.read_text(encoding="utf-8")
# A height is chosen in eight soils, without motion, and every measure is used.
QUICK = (
    "uncertain.samples=8", "uncertain.fresh=300", "effects={motion=false}", 'share.wedge_angle="39 deg"',
    'scene.stiffness="60 kN/m"', "minimise={mean_draft={per='1 kN', measure='mean + 1 std'}}",
    "require.specific_draft={at_most='1 MPa', measure='expected'}",
    "require.cone_index={at_least='1 Pa', measure='mean - 1.5 std'}",
    "require.tow_power={at_least='1 W', measure='nominal'}", "require.added_mass={at_most='1000 kg'}",
)  # fmt: skip
SET = [word for change in QUICK for word in ("--set", change)]


@pytest.fixture
def written(tmp_path):
    """Return a function that writes the file with a change, and returns its path."""

    def write(change=("", "")):
        assert change[0] in TEXT
        path = tmp_path / "field.toml"
        path.write_text(TEXT.replace(*change), encoding="utf-8")
        return path

    return write


@pytest.fixture(scope="module")
def command(tmp_path_factory):
    """What the command prints of the file, its picture, and the optimum behind it."""
    picture, optima = tmp_path_factory.mktemp("found") / "field.png", []

    def noted(*arguments):
        optima.append(optimise_robust(*arguments))
        return optima[0]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(uncertain, "optimise_robust", noted)
        out = printed("optimise", FILE, *SET, "--json", "--plot", picture)
    return SimpleNamespace(printed=out, picture=picture, optimum=optima[0])


@pytest.fixture(scope="module")
def found(command):
    return command.optimum


def test_the_command_saves_both_optima_and_every_check(command, tmp_path):
    assert command.picture.read_bytes().startswith(b"\x89PNG")
    (tmp_path / "found.json").write_text(command.printed, encoding="utf-8")
    assert RobustOptimum.load(tmp_path / "found.json").to_json() == command.printed.rstrip()
    saved = json.loads(command.printed)
    assert saved["kind"] == "robust optimum"
    assert {check["result"]: check["text"] for check in saved["fresh"]["checks"]} == {
        "mean_draft": "mean + 1 standard deviations", "loosened_radius": "probability of at least 0.15 m",
        "mean_deflection": "probability of at most 0.1 m", "specific_draft": "mean",
        "cone_index": "mean - 1.5 standard deviations", "added_mass": "probability of at most 1000 kg",
    }  # fmt: skip


def _check(verification, result="loosened_radius"):
    return next(check for check in verification.checks if check.result == result)


def test_the_optimum_follows_from_the_samples(found):
    """The radius is proportional to the height, so the robust height follows from the soils' mean and spread."""
    problem = po.read_problem(FILE, QUICK)
    scenes = [problem.scene({"share.height": 1.0}), *_field(problem).sample(8, seed=1)]
    radii = np.array([po.loosened_radius(scenes[0].cone, soil) for soil in scenes[1:]])
    k = stats.norm.ppf(0.95)
    height = 0.15 / (radii.mean() - k * radii.std())
    assert found.best.variables["share.height"] == pytest.approx(height, rel=1e-8)


def _field(problem):
    return distribution_of(problem.table.uncertain, problem.scene().soil)


@pytest.mark.slow
def test_the_robust_design_loosens_more_soils_widely_enough():
    """The shipped question by smoothed quantiles and a worst tenth instead of moments: a height of 0.2746 m."""
    found = optimise_robust(po.read_problem(FILE), lambda *_: None)
    assert found.best.gap < 1e-8
    assert found.best.variables["share.height"] == pytest.approx(0.2746, rel=4e-3)
    assert found.best.variables["scene.stiffness"] == pytest.approx(86.93e3, rel=4e-3)
    nominal, robust = (_check(own).fresh for own in (found.nominal_fresh, found.fresh))
    assert nominal < 0.6
    assert 0.95 < robust < 0.975
    assert found.fresh.confirmed
    assert found.best.active == ("loosened_radius", "half_angle")
    objectives = [optimum.objective for optimum in found.best.local_optima]
    assert objectives == sorted(objectives)
    assert len(objectives) >= 2


def test_overrides_reach_a_distribution():
    table = po.read_problem(FILE, ['uncertain.soil.cohesion.std="3 kPa"']).table.uncertain.soil["soil.cohesion"]
    assert (table.std, table.mean) == ("3 kPa", "20 kPa")
    other = "uncertain={soil.cohesion={distribution='triangular', lower='10 kPa', mode='20 kPa', upper='60 kPa'}}"
    # The mean of the three, and the root of (a^2 + b^2 + c^2 - ab - bc - ca)/18; both come by a quadrature.
    moments = _field(po.read_problem(FILE, [other])).moments["cohesion"]
    assert moments == pytest.approx((30e3, 1e3 * math.sqrt(2100 / 18)), rel=1e-8)


MISTAKES = tomllib.loads(Path(__file__).with_name("mistakes.toml").read_text(encoding="utf-8"))["mistakes"]


@pytest.mark.parametrize(("old", "new", "line", "words"), MISTAKES)
def test_mistakes_are_reported_with_their_line(written, old, new, line, words):
    done = call("optimise", written((old, new)))
    assert (done.status, f"line {line}:" in done.err, words in done.err) == (2, True, True), done.err


WITHOUT_ANSWER = [
    (("[minimise]", '"soil.cohesion" = {lower = "9 kPa", upper = "30 kPa"}\n[minimise]'), (), 2, "so it cannot be"),
    ((TEXT[TEXT.index("[uncertain]") : TEXT.index("[share]")], ""), (), 2, "belongs to an uncertain soil"),
    (("", ""), ("--sensitivity",), 2, "--sensitivity"),
    (('"0.15 m"', '"0.295 m"'), (*SET, "--set", 'share.wedge_angle="38 deg"'), 1, "loosened_radius"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("change", "arguments", "status", "words"),
    WITHOUT_ANSWER,
    ids=["an uncertain variable", "measures without an uncertain soil", "sensitivity", "no solution"],
)
def test_questions_that_cannot_be_answered(written, change, arguments, status, words):
    done = call("optimise", written(change), *arguments)
    assert (done.status, words in done.err) == (status, True)


def test_the_tables_of_the_page_are_those_of_the_file():
    page = (FILE.parents[1] / "docs" / "howto" / "uncertain_soil.md").read_text(encoding="utf-8")
    given = tomllib.loads("".join(re.findall(r"```toml\n(.*?)```", page, flags=re.DOTALL)))
    file, table = tomllib.loads(TEXT), given["uncertain"]
    assert {key: table[key] for key in file["uncertain"]} == file["uncertain"]
    assert table["fresh"] == 4096
    assert given["minimise"] == file["minimise"]
    assert given["require"]["loosened_radius"] == file["require"]["loosened_radius"]
    for text in re.findall(r"^\| `([^`=]+)` \|", page, flags=re.MULTILINE):
        assert text in ("uniform", "triangular", "beta", "normal") or measure_of(text) != ""
