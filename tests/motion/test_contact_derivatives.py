"""First and second derivatives through stick, slip and gap, and designs by each contact law."""

import casadi as ca
import numpy as np
import pytest

import plough_opt as po

SHARE = po.Wedge(po.deg(25.0), po.deg(15.0), 0.25)
WAVE = po.StrengthWave(0.6, 0.3)
EXACT = po.Accuracy("erk", tolerance=1e-12)
NAMES = ("stiffness", "mass", "tow speed", "cohesion", "law", "damping")

# name: contact of the law's number, the number, effects, duration [s]
CASES = {
    "sticks": (po.StickSlip, 1.3, {"start": "rest", "strength_wave": WAVE}, 0.45),
    "gap": (po.StickSlip, 1.2, {"start": "rest", "strength_wave": po.StrengthWave(1.0, 0.6)}, 0.9),
    "smooth": (po.Smooth, 0.3, {"start": "rest", "strength_wave": WAVE}, 0.45),
}
SPEEDS = {"gap": 2.0}
OUTPUTS = 5


def scene_of(soil, case, factors):
    """Return a scene in which every number of `NAMES` is a factor away."""
    contact, number, effects, _ = CASES[case]
    k, m, v, c, law, d = factors
    soil = po.Soil(
        density=soil.density,
        density_ratio=soil.density_ratio,
        cohesion=15e3 * c,
        friction_angle=soil.friction_angle,
        tool_friction=soil.tool_friction,
        ambient_pressure=soil.ambient_pressure,
    )
    everything = po.Effects(contact=contact(number * law), damping=40.0 * d, **effects)
    return po.Scene(soil, SHARE, 1e4 * k, 24.0 * m, SPEEDS.get(case, 1.0) * v, everything)


def results(run):
    return [run.mean_draft, run.force_rms, run.mount_force[2], run.mount_force[-1], run.travel[-1]]


def symbolic(soil, case):
    x = ca.MX.sym("x", len(NAMES))
    run = po.simulate(scene_of(soil, case, ca.vertsplit(x)), CASES[case][3], accuracy=EXACT, outputs=OUTPUTS)
    return x, ca.vertcat(*results(run))


def differences(function, x, step):
    """Return the Jacobian by central differences of order 6."""
    columns = []
    for direction in np.eye(len(x)):
        values = [np.ravel(function(x + i * step * direction)) for i in (-3, -2, -1, 1, 2, 3)]
        columns.append(np.array([-1, 9, -45, 45, -9, 1]) @ np.array(values) / (60 * step))
    return np.array(columns).T


AT = np.array([1.02, 0.97, 1.01, 1.03, 0.99, 1.04])


@pytest.mark.parametrize("case", CASES)
def test_values_are_those_of_numbers(r1_soil, case):
    x, values = symbolic(r1_soil, case)
    run = po.simulate(scene_of(r1_soil, case, AT), CASES[case][3], accuracy=EXACT, outputs=OUTPUTS)
    found = ca.Function("values", [x], [values])(AT).full().ravel()
    assert found == pytest.approx(results(run), rel=1e-9)
    if case != "smooth":
        seen = po.simulate(scene_of(r1_soil, case, AT), CASES[case][3], outputs=400).mode
        assert (2.0 if case == "gap" else 1.0) in seen


@pytest.mark.parametrize(
    "case", ["sticks", *(pytest.param(case, marks=pytest.mark.slow) for case in ("gap", "smooth"))]
)
def test_gradients_and_hessians_equal_high_order_differences(r1_soil, case):
    x, values = symbolic(r1_soil, case)
    size = np.abs(ca.Function("values", [x], [values])(AT).full().ravel())
    scaled = values / ca.DM(size)
    f = ca.Function("f", [x], [scaled])
    jacobian = ca.Function("jacobian", [x], [ca.jacobian(scaled, x)])
    slopes = jacobian(AT).full()
    # Tolerance 1e-12 over the step: 1e-9 of noise; truncation is of the sixth power of the step.
    expected = differences(lambda at: f(at).full(), AT, 1e-3)
    assert slopes == pytest.approx(expected, rel=0, abs=3e-7 * np.max(np.abs(expected)))
    for row in range(1 if case == "gap" else 2):
        gradient = ca.Function("gradient", [x], [ca.gradient(scaled[row], x)])
        hessian, _ = ca.hessian(scaled[row], x)
        found = ca.Function("hessian", [x], [hessian])(AT).full()
        expected = differences(lambda at, g=gradient: g(at).full(), AT, 1e-3)
        assert gradient(AT).full().ravel() == pytest.approx(slopes[row], rel=0, abs=1e-7 * np.max(np.abs(slopes[row])))
        assert found == pytest.approx(expected, rel=0, abs=2e-6 * np.max(np.abs(expected)))
        assert found == pytest.approx(found.T, rel=0, abs=1e-6 * np.max(np.abs(found)))


@pytest.mark.parametrize(
    "contact",
    [
        pytest.param(po.StickSlip(1.2), marks=pytest.mark.slow, id="stick_slip"),
        pytest.param(po.Smooth(0.2), id="smooth"),
    ],
)
def test_a_design_finds_what_brute_force_finds(r1_soil, contact):
    effects = po.Effects(contact=contact, start="rest", strength_wave=WAVE, damping=200.0)
    lower, upper = 5e3, 5e4

    def cost(stiffness):
        run = po.simulate(po.Scene(r1_soil, SHARE, stiffness, 24.0, 1.0, effects), 1.0, outputs=10)
        return (run.mean_draft + run.force_rms) / 1e3, run

    d = po.Design()
    k0 = d.variable("stiffness", guess=1.5e4, lower=lower, upper=upper, unit="N/m", log=True)
    objective, run = cost(k0)
    d.minimise(objective)
    best = d.solve()
    tried = np.geomspace(lower, upper, 30)
    least = min(cost(k)[0] for k in tried)
    found = cost(best(k0))[0]
    assert best.status
    assert (best(run).mean_draft + best(run).force_rms) / 1e3 == pytest.approx(found, rel=1e-7)
    # No tried stiffness beats the design, and its neighbours on either side are worse.
    assert found <= least + 1e-7
    for factor in (0.995, 1.005):
        beside = min(max(best(k0) * factor, lower), upper)
        assert cost(beside)[0] >= found - 1e-9
