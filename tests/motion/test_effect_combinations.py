"""Combinations of all effects: correct motion, derivatives, costs and refusals."""

import itertools
import zlib

import casadi as ca
import numpy as np
import pytest
from helpers import three_modes
from helpers.differences import differences
from helpers.scenes import SEROZEM, scene_of

import plough_opt as po
from plough_opt.app.main import main
from plough_opt.motion import effect_costs
from plough_opt.motion.equation import Structure, equation_of
from plough_opt.motion.scene import quantities_of, with_quantities

SHARE = po.Wedge(po.deg(45.0), po.deg(15.0), 0.25)
FACTORS = {
    "inertial_drag": (True, False),
    "added_mass": (True, False),
    "ambient_pressure": (True, False),
    "contact": ("resisting", po.Smooth(0.1), po.StickSlip(1.2)),
    "start": ("equilibrium", "rest", "towed"),
    "entry": (False, True),
    "strength_wave": (None, po.StrengthWave(0.7, 0.25)),
    "tow_ramp": (None, 0.15),
    "damping": (None, 120.0),
    "rate_term": (None, 0.08),
    "speed_term": (None, 0.2),
}
# Mostly refused, so combined only in the test of refusals.
FURTHER = {"motion": (True, False), "orbit": ("transient", "periodic"), "formulation": ("derived", "printed")}


def choices(effects):
    return {(name, repr(choice)) for name, choice in effects.items()}


def triples(effects):
    return set(itertools.combinations(sorted(choices(effects)), 3))


def thinned(rows, held=choices):
    """Return rows, chosen greedily, that together hold everything that any row holds."""
    sets = [held(row) for row in rows]
    wanted, chosen = set().union(*sets), []
    while wanted:
        best = max(range(len(rows)), key=lambda k: len(sets[k] & wanted))
        wanted -= sets[best]
        chosen.append(rows[best])
    return chosen


def is_on(effects, name):
    return effects[name] not in (None, False)


def refused(effects):
    """Return whether effects exclude each other according to the documentation."""
    contact, still = effects["contact"] != "resisting", not effects.get("motion", True)
    orbit, printed = effects.get("orbit") == "periodic", effects.get("formulation") == "printed"
    started = effects["start"] != "equilibrium"
    return (
        (effects["entry"] and not started)
        or (still and (started or contact or printed or orbit or effects["damping"] is not None))
        or (printed and (contact or orbit))
        or (orbit and (contact or started or effects["entry"]))
        or (orbit and (effects["tow_ramp"] is not None or effects["strength_wave"] is None))
    )


ALL = [dict(zip(FACTORS, values, strict=True)) for values in itertools.product(*FACTORS.values())]
# Every choice of any three effects, from a sample that has them all.
COVERING = thinned([ALL[k] for k in np.random.default_rng(0).permutation(len(ALL))[:400]], triples)
VALID, COVERING = ([row for row in rows if not refused(row)] for rows in (ALL, COVERING))


def label(effects):
    on = [name for name in FACTORS if name not in ("contact", "start") and is_on(effects, name)]
    return "+".join([type(effects["contact"]).__name__, effects["start"], *on])


def split(rows, first, title=label):
    """Yield the first rows one by one and, as slow tests, all others in groups of 24."""
    yield from (pytest.param([row], id=title(row)) for row in first)
    others = [row for row in rows if row not in first]
    for k in range(0, len(others), 24):
        yield pytest.param(others[k : k + 24], id=f"others from {title(others[k])}", marks=pytest.mark.slow)


def scene_in(soil, effects, **changes):
    return po.Scene(soil, SHARE, 3e4, 24.0, 1.2, po.Effects(**(effects | changes)))


def test_effects_are_built_or_refused_with_a_reason():
    choices = FACTORS | FURTHER
    refusals = 0
    for values in itertools.product(*choices.values()):
        effects = dict(zip(choices, values, strict=True))
        if refused(effects):
            refusals += 1
            with pytest.raises(po.InputError) as caught:
                po.Effects(**effects)
            assert len(str(caught.value)) > 40
        else:
            assert po.Effects(**effects).start == effects["start"]
    assert 0 < refusals < np.prod([len(values) for values in choices.values()])


@pytest.mark.parametrize("combinations", list(split(VALID, COVERING)))
def test_combinations_run_and_are_right(r1_soil, combinations):
    for effects in combinations:
        scene = scene_in(r1_soil, effects)
        # The resistance to a share that is pushed back through a wave changes within millimetres.
        three_modes.agreed(scene, 0.5, resistance=10.0)


def test_the_bare_equation_is_a_spring_and_a_mass(r1_scene):
    bare, damped = (equation_of(Structure.of(r1_scene(inertial_drag=False, damping=c))) for c in (None, 100.0))
    assert bare.names == ("inertia", "stiffness")
    # w, w', k0, M and the product, quotient and sign of -k0 w/M.
    assert bare.rate.n_nodes() == 7 < damped.rate.n_nodes()
    # Scenes of equal structure share one graph.
    other = r1_scene(35.0, 0.2, 1e5, inertial_drag=False, added_mass=False, ambient_pressure=False)
    assert equation_of(Structure.of(other)) is bare


# --- first and second derivatives of every combination of effects, against differences of high order ---

# Quantities of scenes, SI. About two waves pass, and the mount makes one and a half oscillations. The ramp ends neither
# at an output nor at the end of a step.
NUMBERS = {
    "soil.density": 1400.0, "soil.density_ratio": 0.8, "soil.cohesion": 15e3, "soil.friction_angle": po.deg(30.0),
    "soil.tool_friction": 0.5, "soil.ambient_pressure": 1e4, "share.wedge_angle": po.deg(45.0),
    "share.chisel_angle": po.deg(15.0), "share.height": 0.15, "scene.stiffness": 8e4, "scene.mass": 24.0,
    "scene.tow_speed": 1.2, "duration": 0.2, "effects.tow_ramp": 0.061, "effects.damping": 120.0,
    "effects.rate_term": 0.08, "effects.speed_term": 0.2, "effects.strength_wave.amplitude": 0.7,
    "effects.strength_wave.wavelength": 0.1, "effects.contact_width": 0.3, "effects.breakaway": 1.2,
}  # fmt: skip
OUTPUTS, INNER = 4, 2
STEP = 3e-4


def numbers_of(effects):
    """Return the quantities, by name, around which the scenes of a combination are drawn."""
    own = quantities_of(scene_in(SEROZEM, effects)) | {"duration": 0.2}
    found = {name: value for name, value in NUMBERS.items() if own[name] is not None}
    if effects.get("formulation") == "printed":
        # Its spring repels: two e-foldings are enough. The share starts so far ahead that a short wave turns too fast.
        longer = {"effects.strength_wave.wavelength": 1.0} if effects["strength_wave"] else {}
        found |= {"scene.stiffness": 2e4, "scene.mass": 500.0} | longer
    return found


def scene_with(effects, x):
    """Return the scene of a combination with the quantities x, floats or expressions."""
    return with_quantities(scene_in(SEROZEM, effects), {name: x[name] for name in x if name != "duration"})


def has_events(effects):
    return effects.get("entry", False) or isinstance(effects.get("contact"), po.StickSlip)


def is_smooth(effects):
    return isinstance(effects.get("contact"), po.Smooth)


def method_of(effects):
    if effects.get("motion") is False:
        return None
    if is_smooth(effects):
        return po.Accuracy("erk", tolerance=1e-13)
    located = has_events(effects) or effects.get("tow_ramp") is not None
    return po.Accuracy("erk", tolerance=1e-12) if located else po.Accuracy("dop853", steps=200)


def simulated(effects, x, accuracy, outputs=OUTPUTS):
    duration = None if effects.get("orbit", "transient") != "transient" else x["duration"]
    return po.simulate(scene_with(effects, x), duration, accuracy=accuracy, outputs=outputs)


def results(run):
    return [run.mean_draft, run.force_rms, run.mount_force[INNER], run.mount_force[-1]]


def along(at, direction, t):
    """Return the quantities at the place t along a direction."""
    return {name: value * (1.0 + t * direction[name]) for name, value in at.items()}


def drawn(effects):
    """Return a place and a direction along which nothing about the events changes.

    Where two events, or an event and an output, meet within the differences, these depend on their step.
    """
    for attempt in range(40):
        base = numbers_of(effects)
        # Some shares nearly stop in every oscillation, so their runs end before the first one.
        base["duration"] *= (1.0, 0.8, 0.65, 0.5)[attempt // 10]
        random = np.random.default_rng([zlib.crc32(title(effects).encode()), attempt])
        at = {name: value * random.uniform(0.92, 1.08) for name, value in base.items()}
        direction = {name: random.choice([-1.0, 1.0]) * random.uniform(0.3, 1.0) for name in base}

        def beside(t, at=at, direction=direction):
            return np.array(results(simulated(effects, along(at, direction, *t), method_of(effects))))

        if not has_events(effects):
            return at, direction
        wide, close = (differences(beside, np.zeros(1), step) for step in (STEP, 0.6 * STEP))
        if np.max(np.abs(wide - close)) < 1e-6 * np.max(np.abs([*wide.ravel(), *beside((0.0,))])):
            return at, direction
    pytest.fail("no place without coincidence")


def derivatives(effects, at, direction, accuracy):
    """Return the Functions t -> (results, slopes) and (t, weights) -> curvature of the weighted sum."""
    t, weights = ca.MX.sym("t"), ca.MX.sym("weights", 4)
    found = ca.vertcat(*results(simulated(effects, along(at, direction, t), accuracy)))
    first = ca.Function("first", [t], [found, ca.jacobian(found, t)])
    second = ca.Function("second", [t, weights], [ca.hessian(ca.dot(weights, found), t)[0]])
    return first, second


def title(effects):
    """Return the name of a combination in the list of tests."""
    if "entry" in effects:
        return label(effects)
    return "+".join(f"{name}={effects[name]}" for name in sorted(effects))


def meetings(effects):
    """Return the choices of a combination, and the pairs of those that bring events, kinks and waves."""
    found = choices(effects)
    meet = sorted(choice for choice in found if choice[0] in ("contact", "entry", "tow_ramp", "strength_wave"))
    return found | set(itertools.combinations(meet, 2))


def products(**choices):
    return [dict(zip(choices, values, strict=True)) for values in itertools.product(*choices.values())]


ON = {"inertial_drag": (True, False), "ambient_pressure": (True, False), "rate_term": (None, 0.08)}
WAVE, RAMP, DAMPER, MASS = (None, po.StrengthWave(0.7, 0.1)), (None, 0.1), (None, 120.0), (True, False)
STARTS = ("equilibrium", "rest", "towed")
THIN = thinned(COVERING, meetings)
STILL = products(motion=(False,), strength_wave=WAVE, tow_ramp=RAMP, **ON)
ORBITS = products(orbit=("periodic",), strength_wave=WAVE[1:], damping=DAMPER, added_mass=MASS, **ON)
PRINTED = products(
    formulation=("printed",), start=STARTS, strength_wave=WAVE, tow_ramp=RAMP, damping=DAMPER, added_mass=MASS, **ON
)


CASES = [(VALID, THIN), *((rows, thinned(rows)) for rows in (STILL, ORBITS, PRINTED))]


@pytest.mark.parametrize("combinations", [case for both in CASES for case in split(*both, title)])
def test_slope_and_curvature_are_those_of_differences(combinations):
    for effects in combinations:
        check_slope_and_curvature(effects, *drawn(effects))


def check_slope_and_curvature(effects, at, direction):
    first, second = derivatives(effects, at, direction, method_of(effects))
    values, slopes = (np.asarray(result).ravel() for result in first(0.0))
    run = simulated(effects, at, None)
    # A numeric run promises 1e-8.
    assert values == pytest.approx(results(run), rel=0, abs=2e-8 * np.max(np.abs(run.mount_force)))
    size = max(abs(values[0]), values[1])
    weights = np.cos(np.arange(4)) / size

    def beside(t):
        value, slope = (np.asarray(result).ravel() for result in first(*t))
        return np.append(value / size, slope @ weights)

    *expected, bend = differences(beside, np.zeros(1), STEP).ravel()
    if is_smooth(effects):
        # Tolerance 1e-13 over the step. Where a step of integration meets an end of the smooth contact's step, a fifth
        # derivative jumps: a local error of 1e-13, differentiated twice by its place in the step. It leaves 1e-9 to
        # 1e-7 of the curvature, and 5e-5 for one combination in five hundred.
        allowed = 1e-7, (1e-6 if effects in THIN else 1e-4)
    elif has_events(effects) or effects.get("tow_ramp") is not None:
        # Tolerance 1e-12 over the step is 3e-9, which unstable motions amplify about a hundred times.
        allowed = 2e-6, 2e-6
    else:
        # Rounding, about 1e-14 over the step, amplified by unstable motions.
        allowed = 1e-9, 1e-9
    assert np.max(np.abs(slopes / size - expected) / np.maximum(1.0, np.abs(expected))) < allowed[0]
    assert abs(float(second(0.0, weights)) - bend) < allowed[1] * max(1.0, abs(bend))
    if effects in THIN and not is_smooth(effects) and not effects["entry"]:
        # The default accuracy gives derivatives to 1e-6.
        default = derivatives(effects, at, direction, None)
        found, truth = (
            np.array([one(0.0)[1].full().ravel(), [float(two(0.0, unit)) for unit in np.eye(4)]])
            for one, two in (default, (first, second))
        )
        assert np.max(np.abs(found - truth) / np.maximum(size, np.abs(truth))) < 1e-6


def test_slope_and_curvature_of_a_share_that_leaves_a_gap():
    effects = {**VALID[0], "contact": po.StickSlip(1.2), "start": "rest", "strength_wave": WAVE[1]}
    numbers = {"share.wedge_angle": po.deg(25.0), "share.height": 0.25, "scene.stiffness": 1e4, "scene.tow_speed": 2.0}
    at, direction = drawn(effects)
    wave = {"effects.strength_wave.amplitude": 0.95, "effects.strength_wave.wavelength": 0.6}
    at |= numbers | wave | {"duration": 0.5}
    assert 2.0 in simulated(effects, at, None, 400).mode
    check_slope_and_curvature(effects, at, direction)


# --- cost of each effect: nodes, states and events of the equation, and refusals ---


def scene(**changes):
    return scene_of(**{"strength_wave": po.StrengthWave(0.3, 0.2), "damping": 300.0} | changes)


@pytest.fixture(scope="module")
def costs():
    return {cost.name: cost for cost in effect_costs.effect_costs(scene(), 0.1)}


def nodes(**changes):
    equation = equation_of(Structure.of(scene(**changes)))
    return equation.rate.n_nodes() + (0 if equation.events is None else equation.events.n_nodes())


def test_nodes_are_those_that_the_effect_adds(costs):
    off = {"damping": {"damping": None}, "strength wave": {"strength_wave": None}, "added mass": {"added_mass": False}}
    assert {name: (costs[name].nodes, costs[name].on) for name in off} == {
        name: (nodes() - nodes(**without), True) for name, without in off.items()
    }
    entry = nodes(entry=True, start="towed") - nodes(start="towed")
    assert (costs["entry"].nodes, costs["entry"].on) == (entry, False)


def test_only_events_add_states(costs):
    found = {name: (cost.states, cost.events) for name, cost in costs.items() if cost.states or cost.events}
    assert found == {"stick and slip": (2, 1), "entry": (3, 2)}


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
