"""Limits implied by a theory: the speed in an elastic medium stays below that of shear waves."""

import math

import pytest
from helpers.scenes import scene_of
from helpers.small_designs import design

import plough_opt as po
from plough_opt.soil import elastic

NAME = "elastic medium: speed over shear wave speed"
NODES = [(0.0, 0.0), (0.3, 0.03), (0.5, 0.0)]
SOIL = po.named_soil("serozem")
FASTEST = math.sqrt(SOIL.youngs_modulus / (2.0 * (1.0 + SOIL.poisson_ratio)) / SOIL.density)  # 52.8 m/s
# At the shear wave speed itself the fields' slopes are infinite, so a design ends a little below.
LAST = 0.9999

# Every result of the medium, at a point beside the body or on its face.
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
    "draft": lambda soil, v: po.simulate(scene_of(soil, medium="elastic", motion=False, tow_speed=v), 1.0).mean_draft,
}


@pytest.mark.parametrize(
    "result",
    [pytest.param(own, id=name, marks=[pytest.mark.slow] * (name == "draft")) for name, own in RESULTS.items()],
)
def test_fastest_design_stops_at_the_shear_waves_speed(result):
    d, v = design(speed=(20.0, 1.0, 100.0, "m/s"))
    d.minimise(-v / 50.0)
    d.require("the elastic result", result(SOIL, v), at_most=1e12)
    best = d.solve()
    # The limit is met, and reached to within IPOPT's barrier.
    assert best.variables["speed"] <= LAST * FASTEST
    assert best.variables["speed"] == pytest.approx(LAST * FASTEST, rel=1e-9)
    assert set(best.margins) == {"the elastic result", NAME}
    assert best.active == (NAME,)
    (limit,) = (limit for limit in best.limits if limit.name == NAME)
    assert 0.0 <= limit.margin <= 1e-9
    assert (limit.value, limit.limits, limit.unit) == (pytest.approx(LAST, rel=1e-9), "at most 0.9999", "")
    # A limit that is larger by 1 would raise the speed by the shear wave speed.
    assert limit.multiplier == pytest.approx(FASTEST / 50.0, rel=1e-6)


def test_several_results_imply_one_requirement_that_covers_them_all_in_every_solve():
    d, v = design(speed=(10.0, 1.0, 100.0, "m/s"))
    modulus = d.parameter("modulus", 1e6, unit="Pa")
    soft = po.Soil(1400.0, 0.8, 2e4, 0.5, 0.45, youngs_modulus=modulus, poisson_ratio=0.25)
    d.minimise(-v / 50.0)
    stress = elastic.wedge_stress(0.1, 0.1, NODES, SOIL, v)
    d.require("product", stress.xy * stress.zz, at_most=1e20)
    d.require("slower medium", elastic.wedge_pressure(0.1, NODES, soft, v), at_most=1e20)
    for value in (1e6, 4e5, 9e5, 1e6):
        best = d.solve(parameters={"modulus": value})
        assert [limit.name for limit in best.limits].count(NAME) == 1
        # rho V^2 = LAST^2 mu with mu = E/(2 (1 + nu))
        assert best.variables["speed"] == pytest.approx(LAST * math.sqrt(value / 2.5 / 1400.0), rel=1e-9)
        assert best.active == (NAME,)


CONFLICTING = {
    "where speed pays": lambda _v, p: -p / 1e6,
    "where speed costs": lambda v, p: v / 50.0 + 1e-9 * p,
    "with the result required": lambda v, _p: v / 50.0,
}


@pytest.mark.parametrize("objective", CONFLICTING.values(), ids=CONFLICTING)
def test_a_requirement_above_the_waves_speed_is_a_conflict(objective):
    d, v = design(speed=(20.0, 1.0, 100.0, "m/s"))
    pressure = elastic.wedge_pressure(0.1, NODES, SOIL, v)
    d.minimise(objective(v, pressure))
    d.require("pressure", pressure, at_most=1e12, unit="Pa")
    d.require("speed wanted", v, at_least=60.0, unit="m/s")
    with pytest.raises(po.InfeasibleDesign, match="in conflict with requirement 'elastic medium") as caught:
        d.solve()
    # The shortfall is assigned to the requirement; the theory's limit does not give way.
    assert caught.value.conflicts == {"speed wanted": pytest.approx(60.0 - LAST * FASTEST, rel=1e-6)}
    assert caught.value.blockers == [f"requirement '{NAME}' at most 0.9999"]


@pytest.mark.parametrize(("part", "shown"), [(0.5, False), (0.94, False), (0.97, True), (1.0, True)])
def test_a_limit_of_a_law_is_printed_if_it_is_near(part, shown):
    d, v = design(speed=(20.0, 1.0, 100.0, "m/s"))
    d.minimise((v / FASTEST - part) ** 2 + 1e-20 * elastic.wedge_pressure(0.1, NODES, SOIL, v))
    best = d.solve()
    assert best.variables["speed"] == pytest.approx(min(part, LAST) * FASTEST, rel=1e-6)
    assert (NAME in str(best)) == shown
    assert NAME in best.margins


@pytest.mark.parametrize("lower", [1.0, 60.0])
def test_a_start_above_the_waves_speed_is_refused_by_the_limits_name(lower):
    d, v = design(speed=(70.0, lower, 90.0, "m/s"))
    d.minimise(elastic.wedge_pressure(0.1, NODES, SOIL, v) / 1e6)
    with pytest.raises(po.InputError) as caught:
        d.solve(search="near")
    assert f"(speed = 70 m/s) '{NAME}' is {70.0 / FASTEST:.6g}" in str(caught.value)
    assert "only up to 0.9999" in str(caught.value)
