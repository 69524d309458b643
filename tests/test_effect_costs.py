"""Cost of each effect: nodes, states and events of the equation, operations of a run, and refusals."""

import math

import pytest
from helpers.scenes import scene_of

import plough_opt as po
from plough_opt.app.main import main
from plough_opt.motion import effect_costs, integrators
from plough_opt.motion.equation import Structure, equation_of
from plough_opt.motion.integrators import integration
from plough_opt.motion.steps import step


def scene(**changes):
    return scene_of(**{"strength_wave": po.StrengthWave(0.3, 0.2), "damping": 300.0} | changes)


@pytest.fixture(scope="module")
def costs():
    return {cost.name: cost for cost in effect_costs.effect_costs(scene(), 0.1)}


def nodes(**changes):
    equation = equation_of(Structure.of(scene(**changes)))
    return equation.rate.n_nodes() + (0 if equation.events is None else equation.events.n_nodes())


# Effect -> the changes that switch it on and off; one of the two is empty.
PAIRS = {
    "inertial drag": ({}, {"inertial_drag": False}),
    "added mass": ({}, {"added_mass": False}),
    "strength wave": ({}, {"strength_wave": None}),
    "damping": ({}, {"damping": None}),
    "speed term": ({"speed_term": 0.1}, {}),
    "rate term": ({"rate_term": 0.01}, {}),
    "tow ramp": ({"tow_ramp": 0.1}, {}),
    "stick and slip": ({"contact": po.StickSlip()}, {}),
    "entry": ({"entry": True, "start": "towed"}, {"start": "towed"}),
}


def test_nodes_are_those_that_the_effect_adds(costs):
    for name, (on, off) in PAIRS.items():
        assert (costs[name].nodes, costs[name].on) == (nodes(**on) - nodes(**off), not on), name


def test_only_events_add_states(costs):
    found = {name: (cost.states, cost.events) for name, cost in costs.items() if cost.states or cost.events}
    assert found == {"stick and slip": (2, 1), "entry": (3, 2)}
    # An adaptive method with events takes more operations than steps of order 8.
    assert all(costs[name].operations > 1.0 for name in found)


def operations(**changes):
    run = po.simulate(scene(**changes), 0.1)
    # Three quarters of the steps check.
    steps = run.accuracy.steps + math.ceil(0.75 * run.accuracy.steps)
    return steps * step(equation_of(Structure.of(run.scene))).n_instructions()


def test_operations_are_those_of_the_steps_of_a_run_and_its_check(costs):
    assert costs["strength wave"].operations == operations() / operations(strength_wave=None)


def test_the_equation_of_motion_costs_what_a_quasi_static_run_does_not_take():
    found = {cost.name: cost for cost in effect_costs.effect_costs(scene(damping=None), 0.1)}["equation of motion"]
    assert (found.on, found.nodes, found.states, found.events) == (True, nodes(damping=None), 2, 0)
    # Panels of 0.5 rad of twice the frequency of the wave, each with 10 places for the run and 16 for its check.
    panels = math.ceil(4.0 * math.pi * 2.0 / 0.2 * 0.1 / 0.5)
    each = effect_costs._of_resistance(Structure.of(scene(damping=None, motion=False)))
    assert found.operations == operations(damping=None) / (26 * panels * each)


def test_operations_of_an_adaptive_method_are_those_of_the_run_and_its_check(monkeypatch):
    tolerances = {integrators: [], effect_costs: []}
    for module, seen in tolerances.items():

        def noted(structure, accuracy, timeline, seen=seen):
            seen.append(accuracy.tolerance)
            return integration(structure, accuracy, timeline)

        monkeypatch.setattr(module, "integration", noted)
    effect_costs._operations(scene(contact=po.StickSlip()), 0.1)
    assert sorted(tolerances[effect_costs]) == pytest.approx(sorted(tolerances[integrators][-2:]), rel=1e-12)


def test_a_periodic_orbit_is_measured_too():
    found = {cost.name: cost for cost in effect_costs.effect_costs(scene(orbit="periodic"), None)}
    assert found["periodic orbit"].on
    assert not found["periodic orbit"].refused
    assert "has no start" in found["start at rest"].refused


def test_the_command_prints_a_row_for_each(costs, capsys, tmp_path):
    file = tmp_path / "share.toml"
    assert main(["init", str(file)]) == 0
    capsys.readouterr()
    assert main(["check", str(file), "--effects", "--set", 'scene.duration="0.1 s"']) == 0
    out = capsys.readouterr().out
    assert all(name in out for name in costs)
    assert "damping needs motion" in out
