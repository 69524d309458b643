"""Limits that a theory brings along: the elastic medium's speed stays below the shear wave's without being asked."""

import math

import casadi as ca
import numpy as np
import pytest

import plough_opt as po
from plough_opt.soil import elastic

NAME = "elastic medium: speed over shear wave speed"
NODES = [(0.0, 0.0), (0.3, 0.03), (0.5, 0.0)]
SOIL = po.named_soil("serozem")
FASTEST = math.sqrt(SOIL.youngs_modulus / (2.0 * (1.0 + SOIL.poisson_ratio)) / SOIL.density)  # 52.8 m/s
# At the shear wave's speed itself the fields' slope is infinite: a design ends a little below.
LAST = 0.9999

# Every result of the medium, at a place beside the body or on its face.
RESULTS = {
    "wedge stress": lambda soil, v: elastic.wedge_stress(0.1, 0.1, NODES, soil, v).xx,
    "wedge gradient": lambda soil, v: elastic.wedge_gradient(0.1, 0.1, NODES, soil, v).uy_y,
    "wedge displacement": lambda soil, v: elastic.wedge_displacement(0.1, 0.1, NODES, soil, v),
    "wedge pressure": lambda soil, v: elastic.wedge_pressure(0.1, NODES, soil, v),
    "wedge force": lambda soil, v: elastic.wedge_force(NODES, soil, v),
    "cone stress": lambda soil, v: elastic.cone_stress(0.1, 0.1, NODES, soil, v).rr,
    "cone displacement": lambda soil, v: elastic.cone_displacement(0.1, 0.1, NODES, soil, v).radial,
    "cone pressure": lambda soil, v: elastic.cone_pressure(0.1, NODES, soil, v),
    "cone force": lambda soil, v: elastic.cone_force(NODES, soil, v),
}
# The forces are graphs of their own size, and like the others in what matters here.
results = pytest.mark.parametrize(
    "result",
    [
        pytest.param(result, id=name, marks=[pytest.mark.slow] if name.endswith("force") else [])
        for name, result in RESULTS.items()
    ],
)


def of_speed(guess=20.0, lower=1.0, upper=100.0):
    d = po.Design()
    return d, d.variable("speed", guess=guess, lower=lower, upper=upper, unit="m/s")


def implied(best):
    return {limit.name: limit for limit in best.limits if limit.kind == "requirement"}[NAME]


@results
def test_fastest_design_stops_at_the_shear_waves_speed(result):
    d, v = of_speed()
    d.minimise(-v / 50.0)
    d.require("the elastic result", result(SOIL, v), at_most=1e12)
    best = d.solve()
    # The limit is kept, and reached to the size of IPOPT's barrier.
    assert best.variables["speed"] <= LAST * FASTEST
    assert best.variables["speed"] == pytest.approx(LAST * FASTEST, rel=1e-9)
    assert set(best.margins) == {"the elastic result", NAME}
    assert best.active == (NAME,)
    limit = implied(best)
    assert 0.0 <= limit.margin <= 1e-9
    assert (limit.value, limit.limits, limit.unit) == (pytest.approx(LAST, rel=1e-9), "at most 0.9999", "")
    # A limit looser by 1 lets the speed grow by one shear wave speed.
    assert limit.multiplier == pytest.approx(FASTEST / 50.0, rel=1e-6)


def test_without_an_elastic_result_nothing_is_required():
    d, v = of_speed()
    d.minimise(-v / 50.0)
    d.require("loosened radius", po.loosened_radius(po.Cone(0.2, 0.3), SOIL) + 0.0 * v, at_least=0.05)
    best = d.solve()
    assert best.variables["speed"] == pytest.approx(100.0, rel=1e-9)
    assert list(best.margins) == ["loosened radius"]


@results
def test_a_design_inside_is_not_affected(result):
    wanted = float(result(SOIL, 31.0))
    scale = abs(wanted)
    d, v = of_speed(guess=29.0)
    d.minimise((v / 30.0 - 1.0) ** 2 + (result(SOIL, v) / scale - wanted / scale) ** 2)
    best = d.solve()

    def objective(speed):
        return (speed / 30.0 - 1.0) ** 2 + ((float(result(SOIL, speed)) - wanted) / scale) ** 2

    # By brute force: the parabola through three numbers beside the optimum.
    x = best.variables["speed"]
    left, middle, right = (objective(x + step) for step in (-1e-3, 0.0, 1e-3))
    assert 30.0 <= x <= 31.0
    assert abs(left - right) / (left - 2.0 * middle + right) * 0.5e-3 < 1e-4
    assert best.objective == pytest.approx(middle, rel=1e-10, abs=1e-20)
    assert best.active == ()
    assert implied(best).margin == pytest.approx(LAST - x / FASTEST, rel=1e-12)
    assert implied(best).multiplier == pytest.approx(0.0, abs=1e-6)


def test_a_soft_medium_limits_its_modulus():
    d = po.Design()
    modulus = d.variable("modulus", guess=1e7, lower=1e4, upper=1e8, unit="Pa", log=True)
    soil = po.Soil(1400.0, 0.8, 2e4, 0.5, 0.45, youngs_modulus=modulus, poisson_ratio=0.25)
    d.minimise(ca.log(modulus))
    d.require("pressure", elastic.wedge_pressure(0.1, NODES, soil, 20.0), at_most=1e12, unit="Pa")
    best = d.solve()
    # rho V^2 = LAST^2 mu with mu = E/(2 (1 + nu))
    assert best.variables["modulus"] == pytest.approx(1400.0 * (20.0 / LAST) ** 2 * 2.5, rel=1e-8)
    assert best.active == (NAME,)


def test_several_results_bring_one_requirement_that_keeps_them_all():
    d, v = of_speed(guess=10.0)
    soft = po.Soil(1400.0, 0.8, 2e4, 0.5, 0.45, youngs_modulus=1e6, poisson_ratio=0.25)
    d.minimise(-v / 50.0)
    stress = elastic.wedge_stress(0.1, 0.1, NODES, SOIL, v)
    for name, expression in {
        "xx": stress.xx,
        "yy": stress.yy,
        "xx elsewhere": elastic.wedge_stress(0.2, 0.1, NODES, SOIL, v).xx,
        "of a slower medium": elastic.wedge_pressure(0.1, NODES, soft, v),
        "twice": stress.xy * stress.zz,
    }.items():
        d.require(name, expression, at_most=1e20)
    best = d.solve()
    assert [limit.name for limit in best.limits].count(NAME) == 1
    assert best.variables["speed"] == pytest.approx(LAST * math.sqrt(1e6 / 2.5 / 1400.0), rel=1e-9)


def test_the_limit_holds_in_every_solve_and_for_parameters():
    d, v = of_speed()
    modulus = d.parameter("modulus", 1e7, unit="Pa")
    soil = po.Soil(1400.0, 0.8, 2e4, 0.5, 0.45, youngs_modulus=modulus, poisson_ratio=0.25)
    d.minimise(-v / 50.0)
    d.require("pressure", elastic.wedge_pressure(0.1, NODES, soil, v), at_most=1e12, unit="Pa")
    for value in (1e7, 4e6, 9e6, 1e7):
        best = d.solve(parameters={"modulus": value})
        assert best.variables["speed"] == pytest.approx(LAST * math.sqrt(value / 2.5 / 1400.0), rel=1e-9)
        assert best.active == (NAME,)


CONFLICTING = {
    "where speed pays": lambda _v, p: -p / 1e6,
    "where speed costs": lambda v, p: v / 50.0 + 1e-9 * p,
    "with the result required": lambda v, _p: v / 50.0,
}


@pytest.mark.parametrize("objective", CONFLICTING.values(), ids=CONFLICTING)
def test_a_requirement_above_the_waves_speed_is_a_conflict(objective):
    d, v = of_speed()
    pressure = elastic.wedge_pressure(0.1, NODES, SOIL, v)
    d.minimise(objective(v, pressure))
    d.require("pressure", pressure, at_most=1e12, unit="Pa")
    d.require("speed wanted", v, at_least=60.0, unit="m/s")
    with pytest.raises(po.InfeasibleDesign, match="in conflict with requirement 'elastic medium") as caught:
        d.solve()
    # The theory's end does not give way.
    assert caught.value.conflicts == {"speed wanted": pytest.approx(60.0 - LAST * FASTEST, rel=1e-6)}
    assert caught.value.blockers == [f"requirement '{NAME}' at most 0.9999"]


@pytest.mark.parametrize("lower", [1.0, 60.0])
def test_a_start_above_the_waves_speed_is_refused_by_the_limits_name(lower):
    d, v = of_speed(guess=70.0, lower=lower, upper=90.0)
    d.minimise(elastic.wedge_pressure(0.1, NODES, SOIL, v) / 1e6)
    with pytest.raises(po.InputError) as caught:
        d.solve(search="near")
    assert f"(speed = 70 m/s) '{NAME}' is {70.0 / FASTEST:.6g}" in str(caught.value)
    assert "only up to 0.9999" in str(caught.value)


@results
def test_numbers_carry_nothing_and_are_the_values_of_the_labelled_expression(result):
    number = result(SOIL, 17.0)
    assert isinstance(number, float)
    v = ca.MX.sym("v")
    function = ca.Function("f", [v], [result(SOIL, v)], {"never_inline": True})
    assert sum(function.instruction_id(k) == ca.OP_CALL for k in range(function.n_instructions())) > 0
    # Numbers and symbols differ by the last bits of a dozen functions, sums with both signs by a few more.
    assert float(function(17.0)) == pytest.approx(number, rel=2e-13)


@results
def test_expressions_work_in_opti_as_they_are(result):
    wanted = float(result(SOIL, 31.0))
    opti = ca.Opti()
    v = opti.variable()
    opti.minimize((v / 30.0 - 1.0) ** 2)
    opti.subject_to(result(SOIL, v) / wanted == 1.0)
    opti.subject_to(opti.bounded(25.0, v, 40.0))
    opti.set_initial(v, 29.0)
    opti.solver("ipopt", {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-12})
    assert opti.solve().value(v) == pytest.approx(31.0, rel=1e-9)


@pytest.mark.parametrize("name", [name for name in RESULTS if "force" not in name])
def test_derivatives_pass_the_limit_unchanged(name):
    found = []
    for speed in (ca.MX.sym("v"), ca.SX.sym("v")):
        hessian, gradient = ca.hessian(RESULTS[name](SOIL, speed), speed)
        found.append([float(part) for part in ca.Function("f", [speed], [gradient, hessian])(17.0)])
    # The same operations but for the label; the chain rule takes them in another order.
    np.testing.assert_allclose(found[0], found[1], rtol=1e-12)
