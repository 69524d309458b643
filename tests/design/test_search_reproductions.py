"""Designs on which searches have gone wrong, with truths from the simulator and the search in `independent`."""

import math
from dataclasses import replace

import pytest
from helpers.small_designs import design
from independent import study
from independent.build import as_design
from independent.problem import Limit, Problem, Variable

import plough_opt as po

HARDPAN = (1600.0, 0.914, 35e3, math.radians(32.0), 0.5, 101325.0)
SEROZEM = (1350.0, 0.794, 20e3, math.radians(28.0), 0.5, 101325.0)


def _fixed(chisel_angle, **others):
    return {"chisel angle": chisel_angle, "damping": 0.0, "ramp time": 0.0} | {
        name.replace("_", " "): value for name, value in others.items()
    }


def _truth(objective, median):
    return {"objective": objective, "median": median, "needle": False, "best_median": median}


RIPPLED = Problem(
    name="an isolating mount in a hardpan",
    soil=HARDPAN,
    fixed=_fixed(math.radians(12.0), tow_speed=1.2, frame_mass=60.0, damping=100.0),
    wave=(0.4, 0.25),
    variables=(
        Variable("wedge angle", math.radians(5.0), math.radians(60.0), math.radians(25.0), False),
        Variable("height", 0.1, 0.5, 0.25, False),
        Variable("stiffness", 2e4, 5e6, 1e5, True),
    ),
    limits=(Limit("loosened radius", "at_least", 0.14), Limit("half angle", "at_most", math.radians(15.0))),
    objective={"force_rms": 1.0},
)
# A needle of RIPPLED: 434 N where a thousandth beside it there are 909 to 1240 N.
NEEDLE = (0.6545926, 0.1692840, 2e4)
SPEED_ALONE = Problem(
    name="the speed alone",
    soil=(1620.09, 0.90021, 7109.7036, 0.24062147, 0.4606643, 2e4),
    fixed=_fixed(
        0.4188031,
        wedge_angle=0.75146215,
        height=0.33870543,
        stiffness=130380.386,
        frame_mass=106.77704,
        damping=10.5183,
    ),
    wave=(0.50109438, 0.23664525),
    start="towed",
    variables=(Variable("tow speed", 0.532908, 3.393752, 2.511933, False),),
    objective={"tow_power": 1.335076707e-4},
)
RAMP = Problem(
    name="a ramp without a wave",
    soil=(1519.3285, 0.79038276, 4454.5792, 0.3058192, 0.21067524, 5e3),
    fixed=_fixed(0.24310669, frame_mass=79.074618, tow_speed=2.5578359, ramp_time=0.22016189),
    variables=(
        Variable("wedge angle", 0.12422092, 0.81414239, 0.16105732, False),
        Variable("height", 0.1, 0.40828244, 0.24434388, False),
        Variable("stiffness", 4963.432, 679155.4, 316596.29, True),
    ),
    limits=(
        Limit("loosened radius", "at_least", 0.04213777),
        Limit("half angle", "at_most", 0.17183714),
        Limit("deflection", "at_most", 0.03213665),
    ),
    objective={"mean_draft": 0.00345266833, "force_rms": 0.00057860588},
)
NARROW = Problem(
    name="a narrow feasible region",
    soil=(1573.497751, 0.925009, 18671.096312, 0.619228, 0.166995, 5e3),
    fixed=_fixed(0.320828, frame_mass=16.690185, tow_speed=2.755835),
    wave=(0.373844, 0.125527),
    duration=0.8,
    steel=False,
    variables=(
        Variable("wedge angle", 0.1663163, 0.8331175, 0.4385, False),
        Variable("height", 0.1, 0.35116, 0.2808, False),
        Variable("stiffness", 3166.0, 5518811.0, 20567.0, True),
    ),
    limits=(Limit("loosened radius", "at_least", 0.1228), Limit("deflection", "at_most", 8e-5)),
    objective={"mean_draft": 1e-3},
)
SPEED_AND_MASS = Problem(
    name="speed and mass beside the geometry",
    soil=SEROZEM,
    fixed=_fixed(math.radians(15.0), wedge_angle=math.radians(30.0), damping=100.0),
    wave=(0.3, 0.6),
    duration=2.0,
    steel=False,
    variables=(
        Variable("height", 0.15, 0.4, 0.25, False),
        Variable("stiffness", 1e4, 1e6, 5e4, True),
        Variable("frame mass", 2.0, 200.0, 80.0, False),
        Variable("tow speed", 0.8, 3.0, 2.0, False),
    ),
    limits=(Limit("loosened radius", "at_least", 0.1),),
    objective={"displacement_rms": 1.0},
)
RUNS_AWAY = Problem(
    name="a guess from which the curvature has no value",
    soil=(1346.07046849, 0.889198156145, 7750.94794373, 0.409361372356, 0.323724741816, 2e4),
    fixed={"chisel angle": 0.429756708846, "ramp time": 0.0},
    wave=(0.441871377853, 0.933249522673),
    variables=(
        Variable("wedge angle", 0.170660224692, 1.19025661758, 0.72810012427, False),
        Variable("height", 0.1, 0.369899822407, 0.352448565623, False),
        Variable("stiffness", 11193.6329852, 867959.896628, 124514.655545, True),
        Variable("tow speed", 0.702939965008, 2.79973332514, 1.97632914752, False),
        Variable("damping", 28.0408284414, 1572.70452079, 58.8340993592, True),
        Variable("frame mass", 8.37023908692, 103.816312731, 34.2740661653, False),
    ),
    limits=(Limit("half angle", "at_most", 0.229652480909),),
    objective={"mean_draft": 0.002398636067507635, "force_rms": 0.009879432653275493},
)
TRUTHS = [
    (RIPPLED, _truth(920.60278199, 922.5690)),
    (SPEED_ALONE, _truth(0.198576905341, 0.198872892)),
    (RAMP, _truth(1.068441053328, 1.0688514)),
    (NARROW, _truth(0.295783317069, 0.29711270)),
    (SPEED_AND_MASS, _truth(4.3912086221e-4, 4.40921134e-4)),
    (RUNS_AWAY, _truth(0.144649040076, 0.14605237)),
]


def _with_guess(problem, *guess):
    variables = (replace(v, guess=at) for v, at in zip(problem.variables, guess, strict=True))
    return replace(problem, variables=tuple(variables))


# Longest: seconds to half a minute each.
LONG = (RIPPLED, SPEED_AND_MASS)


@pytest.mark.parametrize(
    ("problem", "truth"),
    [
        pytest.param(problem, truth, id=problem.name, marks=pytest.mark.slow if problem in LONG else ())
        for problem, truth in TRUTHS
    ],
)
def test_the_best_is_found(problem, truth):
    best = as_design(problem)[0].solve()
    verdict = study.judge(problem, truth, best.variables)
    assert verdict.right, verdict


def test_the_guess_decides_nothing():
    best = as_design(_with_guess(NARROW, 0.5, 0.2, 1e6))[0].solve()
    (truth,) = (truth for problem, truth in TRUTHS if problem is NARROW)
    verdict = study.judge(NARROW, truth, best.variables)
    assert verdict.right, verdict


def test_what_is_searched_may_be_named():
    best = as_design(SPEED_AND_MASS)[0].solve(search=["stiffness", "tow speed"])
    assert best.variables["tow speed"] == pytest.approx(0.8, rel=1e-7)
    assert best.objective == pytest.approx(4.3912086221e-4, rel=1e-6)


def test_a_needle_is_known_for_what_it_is():
    best = as_design(_with_guess(RIPPLED, *NEEDLE))[0].solve(search="near", judge="bare")
    # The guess itself has 433.584 N, by the independent simulator.
    assert best.objective <= 433.5841
    assert best.spread.needle
    assert best.spread.median > 1.5 * best.objective


def test_ripples_of_a_basin_are_no_optima_of_their_own():
    problem = replace(RIPPLED, objective={"mean_draft": 1e-3})
    best = as_design(problem)[0].solve()
    assert study.judge(problem, _truth(3.23675616, 3.24366976), best.variables).right
    # Along the stiffness some fifty ripples follow each other, alike to a thousandth.
    assert len(best.local_optima) <= 10
    assert best.search.polished <= 10


def test_a_guess_that_is_the_optimum_already_is_solved():
    d, height = design(height=(0.25, 0.15, 0.4, "m"))
    d.minimise(((height - 0.3) ** 2 - 0.0025) ** 2 * 1e4)
    best = d.solve()
    # Both 0.25 and 0.35 are optima, of zero.
    assert best.objective == pytest.approx(0.0, abs=1e-15)


SOIL = (1300.0, 0.8, 5e3, 0.5, 0.4)


def _soil(**changed):
    return po.Soil(*SOIL) if not changed else replace(po.Soil(*SOIL), **changed)


def _standing(**changed):
    given = {"soil": _soil(), "share": po.Cone(0.2, 0.3), "stiffness": 5e4, "mass": 80.0, "tow_speed": 1.0}
    return po.Scene(**given | changed)


# Name of a quantity, bounds that reach beyond its domain, and a law of it that no run holds.
BEYOND = [
    ("density ratio", 0.1, 1.2, lambda x: po.loosened_radius(po.Cone(0.2, 0.3), _soil(density_ratio=x))),
    ("density ratio", 0.1, 1.2, lambda x: po.added_mass(po.Cone(0.2, 0.3), _soil(density_ratio=x))),
    ("density ratio", 0.1, 1.2, lambda x: po.soil_reaction(po.Cone(0.2, 0.3), _soil(density_ratio=x)).static),
    ("density ratio", 0.1, 1.2, lambda x: po.plastic.wall_pressure(_soil(density_ratio=x)).strength),
    ("density ratio", 0.1, 1.2, lambda x: _standing(soil=_soil(density_ratio=x)).steady_resistance),
    ("density ratio", 0.1, 1.2, lambda x: _standing(soil=_soil(density_ratio=x)).reaction.static),
    (
        "friction angle",
        0.1,
        math.pi / 2.0,
        lambda x: po.resistance_coefficients(po.Cone(0.2, 0.3), _soil(friction_angle=x)).A,
    ),
    ("share height", -0.1, 0.6, lambda x: po.Cone(0.2, x).volume),
    ("half angle", 0.1, 1.7, lambda x: po.Cone(x, 0.3).solid_mass(7850.0)),
    ("wedge angle", 0.1, 1.7, lambda x: po.Wedge(x, 0.3, 0.3).equivalent_cone().half_angle),
    ("speed", -0.1, 1.7, lambda x: po.resistance(po.Cone(0.2, 0.3), _soil(), x, 0.0)),
    ("stiffness", -1.0, 1e5, lambda x: _standing(stiffness=x).natural_frequency),
    ("Poisson's ratio", 0.1, 0.6, lambda x: po.elastic.shear_modulus(_soil(youngs_modulus=1e7, poisson_ratio=x))),
]


@pytest.mark.parametrize(
    ("name", "lower", "upper", "law"), BEYOND, ids=[f"{k}-{name}" for k, (name, *_) in enumerate(BEYOND)]
)
def test_bounds_beyond_the_domain_are_refused_without_a_run(name, lower, upper, law):
    d, x = design(x=(0.3, lower, upper))
    d.minimise(law(x))
    with pytest.raises(po.DomainError, match=rf"at the (lower|upper) bound of 'x': {name}"):
        d.solve()


def test_a_law_of_a_runs_result_is_no_obstacle():
    d, height = design(height=(0.3, 0.1, 0.5))
    share = po.Cone(0.2, height)
    scene = po.Scene(_soil(), share, 5e4, 80.0, 1.5, po.Effects(strength_wave=po.StrengthWave(0.3, 0.4)))
    run = po.simulate(scene, 0.5)
    d.minimise(po.resistance(share, _soil(), run.mean_deflection * 10.0, 0.0))
    # The smallest share has the least resistance at any speed.
    assert d.solve().variables["height"] == pytest.approx(0.1, abs=1e-9)
