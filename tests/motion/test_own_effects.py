"""Resistances of a user's own class and other laws; the public equation of motion."""

from dataclasses import dataclass

import casadi as ca
import numpy as np
import pytest
from helpers import event_splitting, three_modes
from helpers.differences import order_4
from helpers.forces import GAP, SLIP, STICK, Forces
from helpers.linear_motion import oscillation
from helpers.problem_files import SUBSOILER
from helpers.refusals import refusals
from helpers.scenes import SEROZEM, Own, Shank, scene_of
from helpers.small_designs import design
from scipy.integrate import solve_ivp

import plough_opt as po
from plough_opt.core.checks import check_domain
from plough_opt.core.expressions import Expression, exp, where
from plough_opt.laws import AsabeD497, McKyesAli, SphericalCavity, SwickPerumpral, UniversalEarthmoving
from plough_opt.motion.solvers import verified

WAVE = po.StrengthWave(0.3, 0.2)


@dataclass(frozen=True)
class Resting(Shank):
    """The same, with a different resistance at rest."""

    resting: Expression = 0.0

    def at_rest(self, travel):
        return self.resting + self.per_metre * travel


def limited(largest):
    """Return a new class of static resistances, of the same name, as a notebook does when a cell is run again."""

    @dataclass(frozen=True)
    class Limited(po.ResistanceLaw):
        newtons: Expression
        label = "a law with a domain"

        def reaction(self, at):
            del at
            check_domain("force", self.newtons, "N", at_most=largest)
            return po.SoilReaction(static=self.newtons)

    return Limited


Constant = limited(1e9)


def sticking(newtons, *own, **effects):
    """Return a scene with a constant resistance and own ones under stick and slip."""
    slips = {"contact": po.StickSlip(1.3), "start": "rest", "own": own}
    return scene_of(stiffness=2e4, mass=25.0, tow_speed=0.3, medium=Constant(newtons), **slips | effects)


# --- stiff, against exact motions and other methods ---


@pytest.mark.parametrize(
    ("damping", "ground", "method"),
    [*((5e4, 0.0, method) for method in ("auto", "erk", "rosenbrock", "cvodes")), (0.0, 1e7, "auto")],
)
def test_a_stiff_own_resistance(damping, ground, method):
    scene = scene_of(inertial_drag=False, start="rest", own=(Shank(viscous=damping, per_metre=ground),))
    run = po.simulate(scene, 0.2, accuracy=po.Accuracy(method))
    exact, _ = oscillation(scene, run.time, damping, ground)
    # The default error, which a named method's tolerance of 1e-10 reaches too.
    np.testing.assert_allclose(run.deflection, exact, rtol=0.0, atol=1e-8 * np.max(np.abs(exact)))
    assert run.error_estimate < 1e-8


# --- jumps, and forces that run away ---


@pytest.mark.parametrize("start", ["rest", "equilibrium"])
@pytest.mark.parametrize("at", ["speed", "travel"])
def test_a_jump_leaves_equal_steps_for_a_method_that_finds_it(start, at, monkeypatch):
    jump = {"speed": lambda travel, speed: 0.0 * travel - 500.0 * where(speed > 1.9, 1.0, 0.5),
            "travel": lambda travel, speed: 500.0 * where(travel > 0.5, 1.0, 0.5) + 0.0 * speed}[at]  # fmt: skip
    scene, counted, integrate = scene_of(own=(Own(jump),), start=start, strength_wave=WAVE), [], verified.integrate

    def count(case, accuracy, *given, **named):
        counted.append(accuracy.steps or 0)
        return integrate(case, accuracy, *given, **named)

    monkeypatch.setattr(verified, "integrate", count)
    run = po.simulate(scene, 1.0)
    switch = {"speed": lambda _, speed: speed - 1.9, "travel": lambda travel, _: travel - 0.5}[at]
    size = -500.0 if at == "speed" else 500.0
    mean, rms = event_splitting.averages(scene, lambda side: size * (0.5 + 0.5 * side), switch, 1.0)
    error = max(abs(run.mean_draft - mean), abs(run.force_rms - rms)) / mean
    assert error <= run.error_estimate <= 1e-6
    # The law of order 8 would ask for millions.
    assert sum(counted) < 20_000


@pytest.mark.parametrize("seed", range(12))
def test_a_force_that_runs_away_is_a_cause_or_the_run_ends(seed):
    random = np.random.default_rng(seed)
    size, power = 10.0 ** random.uniform(-1.0, 5.0) * random.choice([-1.0, 1.0]), int(random.integers(2, 6))
    law = [lambda _, v: size * v**power, lambda _, v: size * v * exp(0.3 * power * v)][seed % 2]
    effects = {"start": random.choice(["rest", "towed"]), "contact": ["resisting", po.Smooth(0.1)][random.integers(2)]}
    scene = scene_of(stiffness=10.0 ** random.uniform(4.0, 6.0), own=(Own(law),), **effects)
    try:
        run = po.simulate(scene, random.uniform(0.1, 0.5), outputs=20)
    except po.IntegrationError as error:
        words = str(error)
    else:
        words = "own effect"
        assert np.isfinite(run.mount_force).all()
        assert run.error_estimate <= 1e-8 or run.checks.notes
    assert "own effect" in words


# --- under stick and slip ---


@pytest.mark.parametrize("wave", [None, po.StrengthWave(0.8, 0.3)], ids=["even", "wave"])
def test_motion_is_that_of_scipy(wave):
    own = sticking(1000.0, Resting(300.0, 30.0, 0.0, 40.0, 700.0), strength_wave=wave, damping=50.0)
    run, exact = three_modes.agreed(own, 1.0, outputs=200)
    assert run.error_estimate < 1e-8
    assert exact.count(STICK, SLIP) > 0


def test_derivatives_go_through_the_moments_at_which_it_moves():
    x = ca.MX.sym("rest")
    run = po.simulate(sticking(1000.0, Resting(300.0, resting=x)), 1.0, outputs=4)
    both = ca.Function("f", [x], [run.mean_draft, ca.gradient(run.mean_draft, x)])
    # Differences of integrations to 1e-10.
    slope = order_4(lambda rest: float(both(rest)[0]), 600.0, 0.05)
    assert float(both(600.0)[1]) == pytest.approx(slope, rel=1e-4)


# --- designs and tables ---


@dataclass(frozen=True)
class Looked(Shank):
    """The same, times what a function says at the travel, such as a lookup table."""

    table: object = lambda travel: ca.interpolant("ones", "linear", [[-1.0, 3.0]], [1.0, 1.0])(travel)

    def force(self, travel, speed):
        return self.table(travel) * super().force(travel, speed)


@pytest.mark.parametrize("kind", [Shank, Looked])
def test_a_design_varies_and_rebuilds_it(kind):
    d, viscous = design(viscous=(400.0, 10.0, 2000.0, "N s/m"))

    def objective(value):
        run = po.simulate(scene_of(own=(kind(0.0, value),), strength_wave=WAVE), 1.0)
        return run.mean_draft / 1e3 + 4.0 * run.force_rms / 1e3

    d.minimise(objective(viscous))
    best = d.solve(search="local")
    own = best.variables["viscous"]
    assert best(kind(0.0, viscous)) == kind(0.0, own)
    assert best.gap < 1e-8
    assert objective(own) == pytest.approx(best.objective, rel=1e-8)
    assert objective(own) < min(objective(0.97 * own), objective(1.03 * own))


@pytest.mark.parametrize("compiled", [False, True])
def test_tables_behind_functions_are_kept_apart(compiled):
    # Different tables must not share a graph, even if a new one has the memory address of a deleted one.
    for value in (100.0, 500.0, 100.0):
        table = ca.interpolant("table", "linear", [[-1.0, 3.0]], [value, value])
        drafts = [
            po.simulate(scene_of(own=(own,), start="towed"), 0.5, outputs=4, compiled=compiled).mean_draft
            for own in (Shank(viscous=value), Looked(viscous=1.0, table=lambda travel, table=table: table(travel)))
        ]
        # Each run has an error of up to 1e-8.
        assert drafts[1] == pytest.approx(drafts[0], rel=1e-7)


# --- the public equation of motion, against the model's equations written again, and integrated by SciPy ---

LONG_WAVE = po.StrengthWave(0.3, 0.4, 0.7)
SCENES = {
    "plain": {},
    "damped": {"damping": 300.0, "strength_wave": LONG_WAVE},
    "rate term": {"rate_term": 0.05, "strength_wave": (LONG_WAVE, po.StrengthWave(0.2, 1.1)), "start": "rest"},
    "smooth": {"contact": po.Smooth(0.8), "damping": 300.0},
    "entry": {"entry": True, "start": "towed", "damping": 300.0},
    "stick and slip": {"contact": po.StickSlip(1.3), "strength_wave": LONG_WAVE, "start": "rest"},
    "printed": {"formulation": "printed", "damping": 300.0},
}


def flat(column):
    return np.asarray(column).ravel()


def arguments(equation):
    return [equation.controls, equation.parameters]


@pytest.mark.parametrize("effects", SCENES.values(), ids=SCENES)
def test_rate_and_outputs_are_those_of_the_model(effects):
    rng, controls = np.random.default_rng(11), ["tow_speed", "stiffness"] + ["damping"] * ("damping" in effects)
    scene = scene_of(**effects)
    equation, sign = scene.equation(controls=controls), -1.0 if effects.get("formulation") else 1.0
    for _ in range(40):
        travel, speed, z = rng.uniform(-0.1, 0.6), rng.uniform(0.01, 3.0), rng.uniform(-0.05, 0.1)
        u = [rng.uniform(0.0, 4.0), rng.uniform(1e4, 1e5), rng.uniform(10.0, 900.0)][: len(controls)]
        forces = Forces(scene)
        forces.k, forces.c = sign * u[1], u[2] if len(u) > 2 else 0.0
        mode = rng.choice([SLIP, GAP]) if isinstance(scene.effects.contact, po.StickSlip) else SLIP
        x = [travel, speed, z, float(mode), travel + 0.01, float(travel > 0.25)][: len(equation.names["state"])]
        pull = forces.k * z + forces.c * (u[0] - speed)
        acceleration = forces.acceleration(mode, pull, travel, speed)
        expected = [speed, acceleration, u[0] - speed, *[0.0] * (len(x) - 3)]
        assert flat(equation.rate(0.3, x, u, [])) == pytest.approx(expected, rel=1e-12, abs=1e-12)
        force, soil, again, tow, place, power = map(float, equation.outputs(0.3, x, u, []))
        resisted = forces.soil(travel, speed) + forces.carried(travel) * acceleration if mode == SLIP else 0.0
        assert [force, again, tow, place] == pytest.approx([pull, acceleration, u[0], travel + z], rel=1e-12, abs=1e-12)
        assert [soil, power] == pytest.approx([resisted, pull * u[0]], rel=1e-12, abs=1e-12 * abs(pull))


SPEEDS = {"tow_profile": po.SpeedProfile((0.0, 0.4, 0.9), (0.5, 1.0, 0.7))}


@pytest.mark.parametrize("effects", [{}, {"damping": 300.0, "strength_wave": LONG_WAVE, "tow_ramp": 0.3}, SPEEDS])
def test_at_constant_speed_it_gives_the_run_of_the_toolkit(effects):
    scene = scene_of(start="rest", **effects)
    equation, run = scene.equation(), po.simulate(scene, 1.0, accuracy=po.Accuracy(error=1e-10))
    start = flat(equation.start(*arguments(equation)))
    found = solve_ivp(lambda t, x: flat(equation.rate(t, x, [], [])), (0.0, 1.0), start, "DOP853", run.time,
                      rtol=1e-12, atol=1e-12).y  # fmt: skip
    assert found[0] == pytest.approx(run.travel, abs=1e-9)
    assert found[2] == pytest.approx(run.deflection, abs=1e-9)
    forces = equation.outputs.map(len(run.time))(run.time, found, [], [])
    assert flat(forces[0]) == pytest.approx(run.mount_force, abs=1e-8 * run.peak_force)
    assert flat(forces[1]) == pytest.approx(run.soil_resistance, abs=1e-6 * run.peak_force)


def test_events_lead_a_sticking_share_through_its_modes():
    scene = scene_of(contact=po.StickSlip(1.4), start="rest", damping=300.0, strength_wave=po.StrengthWave(0.9, 0.3))
    equation, run = scene.equation(), po.simulate(scene, 0.6)
    assert len(np.unique(run.mode)) > 1

    def value(k):
        def of(t, x):
            return float(equation.events(t, x, [], [])[0][k])

        of.terminal, of.direction = True, -1.0
        return of

    now, x, count = 0.0, flat(equation.start([], [])), 0
    while now < 0.6:
        found = solve_ivp(lambda t, x: flat(equation.rate(t, x, [], [])), (now, 0.6), x, "DOP853", rtol=1e-12,
                          atol=1e-12, events=[value(0), value(1)], max_step=5e-3)  # fmt: skip
        now, x = found.t[-1], found.y[:, -1]
        if found.status == 1:
            x, count = flat(equation.events(now, x, [], [])[1]), count + 1
    assert count > 1
    assert x[:3] == pytest.approx([run.travel[-1], run.speed[-1], run.deflection[-1]], abs=1e-7)


def test_parameters_are_differentiable_and_in_any_graph():
    scene = scene_of()
    equation = scene.equation(controls=("tow_speed",), parameters=("share.height", "scene.stiffness"))
    x, p = ca.MX.sym("x", 3), ca.MX.sym("p", 2)
    slope = ca.Function("slope", [x, p], [ca.jacobian(equation.rate(0.0, x, 2.0, p)[1], p)])
    at, h = flat(equation.start(*arguments(equation))), 1e-6

    def acceleration(height, stiffness):
        other = scene_of(share=po.Wedge(po.deg(30.0), po.deg(15.0), height), stiffness=stiffness).equation()
        return float(other.rate(0.0, at, [], [])[1])

    by_height = (acceleration(0.25 + h, 5e4) - acceleration(0.25 - h, 5e4)) / (2.0 * h)
    by_stiffness = (acceleration(0.25, 5e4 + 1.0) - acceleration(0.25, 5e4 - 1.0)) / 2.0
    assert flat(slope(at, equation.parameters)) == pytest.approx([by_height, by_stiffness], rel=1e-6)
    assert {equation.units[name] for name in equation.names["parameters"]} == {"m", "N/m"}
    assert [*equation.units] == [name for names in equation.names.values() for name in names]
    assert "  parameters[1]  scene.stiffness  50000  N/m\n" in str(equation)


def equation(effects, **asked):
    return lambda: scene_of(**effects).equation(**asked)


test_refusals_name_the_cause = refusals(
    po.InputError,
    (equation({}, controls=("mass",)), "'mass' cannot be a control"),
    (equation({}, controls=("scene.tow_speed",)), "'scene.tow_speed' cannot be a control"),
    (equation({}, controls="tow_speed"), "must be a tuple"),
    (equation({}, controls=("tow_speed", "tow_speed")), "different names"),
    (equation({}, controls=("damping",)), "has no 'effects.damping'"),
    (equation({}, controls=("stiffness",), parameters=("scene.stiffness",)), "cannot be a parameter"),
    (equation({}, parameters=("soil.colour",)), "no quantity 'soil.colour'"),
    (equation({"tow_ramp": 0.5}, controls=("tow_speed",)), "tow_ramp and the control"),
    (equation(SPEEDS, controls=("tow_speed",)), "tow_profile and the control"),
    (equation({}, controls=None), "must be a tuple"),
    (equation({"motion": False}), "quasi-static scene"),
    (equation({"orbit": "periodic", "strength_wave": LONG_WAVE}), "orbit"),
    (equation({"damping": ca.MX.sym("damping")}), "scene with symbols"),
)


def test_an_effect_of_ones_own_enters_too():
    scene = scene_of(own=(Shank(150.0, 80.0),))
    bare, equation = scene_of().equation(), scene.equation()
    x = [0.1, 1.5, 0.05]
    change = float(equation.rate(0.0, x, [], [])[1] - bare.rate(0.0, x, [], [])[1])
    assert change == pytest.approx(-(150.0 + 80.0 * 1.5) / float(scene.inertia), rel=1e-12)


SHARE = po.Wedge(po.deg(30), po.deg(35), 0.25)
LOADS = {"surcharge": 500.0, "adhesion": 300.0}
OTHERS = (
    McKyesAli(width=0.1, **LOADS), UniversalEarthmoving(width=0.1, **LOADS), AsabeD497("fine", "winged", 2.0),
    SphericalCavity(),
)  # fmt: skip


def draft_of(law, speed):
    return law.reaction(po.ShareInSoil(SHARE, SHARE.equivalent_cone(), SEROZEM, speed)).at(speed)


def scene(law, **changes):
    wavy = {"strength_wave": po.StrengthWave(0.3, 0.2), "damping": 400.0, "stiffness": 5e5, "mass": 40.0}
    return scene_of(share=SHARE, medium=law, **wavy | changes)


@pytest.mark.parametrize("law", OTHERS, ids=lambda law: law.label)
def test_motion_and_steady_resistance_follow_from_the_drafts_formula(law):
    three_modes.agreed(scene(law), 0.6)
    for speed in (0.0, 1.0, 3.0):
        assert scene(law, tow_speed=speed).steady_resistance == pytest.approx(draft_of(law, speed), rel=1e-14)


def test_law_of_steady_sliding_gives_its_draft():
    steady = po.simulate(scene_of(share=SHARE, medium=SwickPerumpral(width=0.1), motion=False), 1.0)
    assert steady.mean_draft == pytest.approx(draft_of(SwickPerumpral(width=0.1), 2.0), rel=1e-14)


def test_what_a_law_lacks_is_omitted_with_a_warning_or_refused():
    own = scene(McKyesAli(width=0.1))
    run = po.simulate(own, 0.2)
    assert own.inertia == own.mass
    assert any("does not include soil that moves with the share" in text for text in run.warnings)
    for value in (lambda: run.specific_draft, lambda: own.loosened_radius, lambda: own.carried_soil):
        with pytest.raises(po.InputError, match="has no meaning in McKyes-Ali, which"):
            value()
    assert own.ambient_share == 0.0


def read(medium):
    """Return a problem with a medium, without requirements that only the plastic gas meets."""
    return po.read_problem(SUBSOILER, ["require={}", f"scene.medium={medium}"])


def test_problem_file_names_a_law_with_its_own_quantities():
    own = read("{law='mckyes_ali', width='10 cm', depth='30 cm', rake_angle='35 deg'}").scene()
    assert own.law == McKyesAli(width=0.1, depth=0.3, rake_angle=po.deg(35))


WRONG_MEDIA = [
    ("{law='mckyes'}", "no law is named 'mckyes'.*mckyes_ali"),
    ("{law='mckyes_ali', dept='30 cm'}", "'dept' is not a quantity of McKyesAli.*depth"),
    ("{law='mckyes_ali', depth='30 kg'}", "'depth' = \"30 kg\" has the wrong unit"),
    ("3", "must be a resistance law, such as"),
]


@pytest.mark.parametrize(("medium", "message"), WRONG_MEDIA)
def test_problem_file_refuses_anything_else(medium, message):
    with pytest.raises(po.InputError, match=message):
        read(medium)


def test_a_problem_file_whose_share_no_wedge_fits_names_law_and_ranges():
    problem = po.read_problem(SUBSOILER, ["require={}", "scene.medium=mckyes_ali"])
    with pytest.raises(po.InputError, match=r"share.height from 0.1 m to 0.5 m.*McKyes-Ali.*least force of a wedge"):
        problem.optimise()
