"""Designs on which searches have gone wrong, in addition to those in `independent/reproduction_problems.json`."""

from dataclasses import replace

import pytest
from helpers.small_designs import design
from independent import study
from independent.build import as_design

import plough_opt as po

KNOWN = study.problems("reproduction")
RIPPLED, NARROW, SPEED_AND_MASS = 0, 3, 4
# A needle of RIPPLED: 434 N, while a thousandth of the range away there are 909 to 1240 N.
NEEDLE = (0.6545926, 0.1692840, 2e4)


def _with_guess(number, *guess):
    problem, _ = KNOWN[number]
    variables = (replace(v, guess=at) for v, at in zip(problem.variables, guess, strict=True))
    return replace(problem, variables=tuple(variables))


def seeds(first):
    """Return five seeds, of which all but the first are slow."""
    return pytest.mark.parametrize(
        "seed", [k if k == first else pytest.param(k, marks=pytest.mark.slow) for k in range(5)]
    )


@seeds(1)
def test_the_guess_decides_nothing(seed):
    best = as_design(_with_guess(NARROW, 0.5, 0.2, 1e6))[0].solve(seed=seed)
    verdict = study.judge(*KNOWN[NARROW], best.variables)
    assert verdict.right, verdict


@seeds(2)
def test_the_searched_variables_may_be_named(seed):
    best = as_design(KNOWN[SPEED_AND_MASS][0])[0].solve(search=["stiffness", "tow speed"], seed=seed)
    assert best.variables["tow speed"] == pytest.approx(0.8, rel=1e-7)
    assert best.objective == pytest.approx(4.3912086221e-4, rel=1e-6)


@pytest.mark.slow
def test_a_needle_is_recognised():
    best = as_design(_with_guess(RIPPLED, *NEEDLE))[0].solve(search="near", judge="bare")
    # The guess itself has 433.584 N, by the independent simulator.
    assert best.objective <= 433.5841
    assert best.spread.needle
    assert best.spread.median > 1.5 * best.objective


@seeds(3)
def test_ripples_of_a_basin_are_not_separate_optima(seed):
    problem = replace(KNOWN[RIPPLED][0], objective={"mean_draft": 1e-3})
    best = as_design(problem)[0].solve(seed=seed)
    truth = {"objective": 3.23675616, "median": 3.24366976, "needle": False}
    assert study.judge(problem, truth, best.variables).right
    # Along the stiffness some fifty ripples follow each other, equal to a thousandth.
    assert len(best.local_optima) <= 10
    assert best.search.polished <= 10


@seeds(0)
def test_a_guess_at_the_optimum_is_solved(seed):
    d, height = design(height=(0.25, 0.15, 0.4, "m"))
    d.minimise(((height - 0.3) ** 2 - 0.0025) ** 2 * 1e4)
    best = d.solve(seed=seed)
    # Both 0.25 and 0.35 are optima with an objective of 0.
    assert best.objective == pytest.approx(0.0, abs=1e-15)
    assert not best.spread.needle


SOIL = (1300.0, 0.8, 5e3, 0.5, 0.4)


def _soil(**changed):
    return replace(po.Soil(*SOIL), **changed)


def _standing(**changed):
    given = {"soil": _soil(), "share": po.Cone(0.2, 0.3), "stiffness": 5e4, "mass": 80.0, "tow_speed": 1.0}
    return po.Scene(**given | changed)


def _run(amplitude=0.3, *, motion=True, **changed):
    effects = po.Effects(motion=motion, strength_wave=po.StrengthWave(amplitude, 0.4))
    return po.simulate(_standing(effects=effects, **changed), 0.5)


# Name of a quantity, bounds that reach beyond its domain, and a law of it outside any run or in one.
BEYOND = [
    ("density ratio", 0.1, 1.2, lambda x: po.loosened_radius(po.Cone(0.2, 0.3), _soil(density_ratio=x))),
    ("density ratio", 0.1, 1.2, lambda x: po.added_mass(po.Cone(0.2, 0.3), _soil(density_ratio=x))),
    ("density ratio", 0.1, 1.2, lambda x: po.soil_reaction(po.Cone(0.2, 0.3), _soil(density_ratio=x)).static),
    ("density ratio", 0.1, 1.2, lambda x: po.plastic.wall_pressure(_soil(density_ratio=x)).strength),
    ("density ratio", 0.1, 1.2, lambda x: _standing(soil=_soil(density_ratio=x)).steady_resistance),
    ("density ratio", 0.1, 1.2, lambda x: _standing(soil=_soil(density_ratio=x)).reaction.static),
    ("friction angle", 0.1, 1.58, lambda x: po.resistance_coefficients(po.Cone(0.2, 0.3), _soil(friction_angle=x)).A),
    ("share height", -0.1, 0.6, lambda x: po.Cone(0.2, x).volume),
    ("half angle", 0.1, 1.7, lambda x: po.Cone(x, 0.3).solid_mass(7850.0)),
    ("wedge angle", 0.1, 1.7, lambda x: po.Wedge(x, 0.3, 0.3).equivalent_cone().half_angle),
    ("speed", -0.1, 1.7, lambda x: po.resistance(po.Cone(0.2, 0.3), _soil(), x, 0.0)),
    ("stiffness", -1.0, 1e5, lambda x: _standing(stiffness=x).natural_frequency),
    ("stiffness", -1.0, 1e5, lambda x: _run(stiffness=x).mean_deflection),
    ("wedge angle", 0.1, 1.7, lambda x: _run(motion=False, share=po.Wedge(x, 0.3, 0.3)).mean_draft),
    ("density ratio", 0.1, 1.0, lambda x: _run(motion=False, soil=_soil(density_ratio=x)).mean_draft),
    ("strength wave amplitude", 0.0, 1.5, lambda x: _run(x).force_rms),
    ("strength wave amplitude", 0.0, 1.5, lambda x: _run(x, motion=False).force_rms),
    ("Poisson's ratio", 0.1, 0.6, lambda x: po.elastic.shear_modulus(_soil(youngs_modulus=1e7, poisson_ratio=x))),
]


@pytest.mark.parametrize(
    ("name", "lower", "upper", "law"), BEYOND, ids=[f"{k}-{name}" for k, (name, *_) in enumerate(BEYOND)]
)
def test_bounds_beyond_the_domain_of_a_law_are_refused(name, lower, upper, law):
    d, x = design(x=(0.3, lower, upper))
    d.minimise(law(x))
    with pytest.raises(po.DomainError, match=rf"at the (lower|upper) bound of 'x': {name}"):
        d.solve()


def test_a_law_may_depend_on_a_runs_result():
    d, height = design(height=(0.3, 0.1, 0.5))
    share = po.Cone(0.2, height)
    d.minimise(po.resistance(share, _soil(), _run(share=share).mean_deflection * 10.0, 0.0))
    # The smallest share has the least resistance at any speed.
    assert d.solve().variables["height"] == pytest.approx(0.1, abs=1e-9)
