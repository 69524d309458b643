"""Derivatives through events and ramps: their forms, the methods that find a ramp's end, and ramps of no time."""

import casadi as ca
import numpy as np
import pytest
from helpers.scenes import scene_of

import plough_opt as po

WAVE = po.StrengthWave(0.5, 0.4)
SUDDEN = {
    "motion": {"damping": 400.0},
    "stick and slip": {"damping": 400.0, "start": "rest", "contact": po.StickSlip(1.2)},
    "entry": {"damping": 400.0, "start": "towed", "entry": True},
    "quasi-static": {"motion": False, "strength_wave": WAVE},
}


@pytest.mark.parametrize("case", ["stick and slip", "entry"])
def test_second_derivatives_through_events_are_those_of_a_gradient(case):
    t = ca.MX.sym("t", 2)
    effects = SUDDEN[case] | {"strength_wave": WAVE, "tow_ramp": 0.2 * (1.0 + t[1])}
    draft = po.simulate(scene_of(stiffness=5e4 * (1.0 + t[0]), tow_speed=1.5, **effects), 0.5, outputs=4).mean_draft
    gradient, units = ca.gradient(draft, t), ca.horzsplit(ca.DM.eye(2))
    ways = [
        ca.hessian(draft, t)[0],
        ca.jacobian(gradient, t),
        ca.horzcat(*(ca.jtimes(gradient, t, unit) for unit in units)),
        ca.horzcat(*(ca.jtimes(gradient, t, unit, True) for unit in units)),
    ]
    found = [np.asarray(part) for part in ca.Function("ways", [t], ways)(0.0)]
    for other in found[1:]:
        # The same steps, added up in another order.
        assert other == pytest.approx(found[0], rel=0, abs=1e-9 * np.max(np.abs(found[0])))
    # The limit that the documentation states.
    with pytest.raises(
        RuntimeError, match=r"those_of_a_gradient_as_by_casadi_hessian:\n.*\nEvent support not implemented"
    ):
        ca.jacobian(ca.jacobian(draft, t), t)


@pytest.mark.parametrize("method", ["erk", "rosenbrock"])
def test_named_adaptive_methods_find_the_end_of_a_ramp(method):
    x = ca.MX.sym("x")
    scene = scene_of(damping=400.0, tow_ramp=x, start="rest")
    runs = [po.simulate(scene, 1.0, accuracy=a, outputs=7) for a in (po.Accuracy(method, tolerance=1e-11), None)]
    results = [(run.mean_draft, ca.gradient(run.mean_draft, x), ca.hessian(run.mean_draft, x)[0]) for run in runs]
    found = [float(part) for part in ca.Function("found", [x], [*results[0], *results[1]])(0.301)]
    # Without a step that ends there the slope has an error of 1e-5.
    for value, truth, allowed in zip(found[:3], found[3:], (1e-10, 1e-7, 1e-5), strict=True):
        assert value == pytest.approx(truth, rel=allowed)


@pytest.mark.parametrize("case", SUDDEN)
def test_a_symbolic_ramp_of_no_time_has_the_limit_of_short_ones(case):
    x = ca.MX.sym("x")
    draft = po.simulate(scene_of(tow_ramp=x, **SUDDEN[case]), 1.0, outputs=4).mean_draft
    found = ca.Function("found", [x], [draft, ca.gradient(draft, x)])
    there, beside = (np.array([float(part) for part in found(ramp)]) for ramp in (0.0, 1e-7))
    # In 1e-7 s the strut falls behind by 1e-7 m. Event times have errors of 1e-12 of the run, which are a tenth of the
    # slope for so short a ramp.
    assert there[0] == pytest.approx(beside[0], rel=2e-7)
    assert there[1] == pytest.approx(beside[1], rel=0.2 if "contact" in SUDDEN[case] or case == "entry" else 1e-3)
