"""What the equation of motion contains, and that it is equation (27)."""

import itertools
import math

import casadi as ca
import numpy as np
import pytest

import plough_opt as po
from plough_opt.motion.effects.built_in import Damping, InertialDrag, RateTerm, StrengthWaves, TowRamp
from plough_opt.motion.equation import equation_of_motion, signals, start_state
from plough_opt.motion.terms import Structure, parameters, strut

TERMS = {"waves": StrengthWaves(1), "rate": RateTerm(), "drag": InertialDrag(), "ramp": TowRamp(), "damper": Damping()}
FLAGS = (*TERMS, "relaxed")


def structure_of(names):
    start = "rest" if "relaxed" in names else "equilibrium"
    return Structure(tuple(term for name, term in TERMS.items() if name in names), start=start)


STRUCTURES = [
    structure_of({*itertools.compress(FLAGS, flags)}) for flags in itertools.product((0, 1), repeat=len(FLAGS))
]
BARE = STRUCTURES[0]

# What belongs to one effect alone.
OWN = {
    "drag": {"drag"},
    "rate": {"rate_term"},
    "waves": {"wave_amplitude", "wavelength"},
    "ramp": {"ramp_time"},
    "damper": {"damping"},
    "relaxed": set(),
}
NUMBERS = {
    "inertia": 23.0,
    "stiffness": 5e4,
    "static": 510.0,
    "drag": 4.1,
    "tow_speed": 1.9,
    "wave_amplitude": 0.3,
    "wavelength": 0.6,
    "ramp_time": 0.4,
    "damping": 250.0,
    "rate_term": 0.05,
}


def on(structure):
    names = {name for name, term in TERMS.items() if term in structure.terms}
    return names | {"relaxed"} if structure.relaxed else names


def expected_parameters(structure):
    names = {"inertia", "stiffness"}.union(*(OWN[name] for name in on(structure)))
    # In deviations from the start the static resistance cancels unless something varies with it.
    if on(structure) & {"rate", "waves", "relaxed"}:
        names.add("static")
    if on(structure) & {"drag", "rate", "waves", "ramp"}:
        names.add("tow_speed")
    return names


def label(structure):
    return "+".join(sorted(on(structure))) or "none"


def operations(function):
    return [function.instruction_id(i) for i in range(function.n_instructions())]


def size(structure):
    return equation_of_motion(structure).function.n_nodes()


def at_numbers(function, names, time, w, rate):
    return function(time, [w, rate], [NUMBERS[name] for name in names]).full().ravel()


# --- what is off is not in the graph ---


@pytest.mark.parametrize("structure", STRUCTURES, ids=label)
def test_equation_has_exactly_the_parameters_of_its_effects(structure):
    motion = equation_of_motion(structure)
    assert set(motion.names) == expected_parameters(structure)
    assert motion.function.numel_in("parameters") == len(motion.names)
    # ... and depends on each of them.
    assert set(motion.function.jac_sparsity(0, 2).get_col()) == set(range(len(motion.names)))


@pytest.mark.parametrize("structure", STRUCTURES, ids=label)
def test_equation_has_two_states_and_only_the_operations_of_its_effects(structure):
    function = equation_of_motion(structure).function
    assert function.numel_in("state") == function.numel_out("rate") == 2
    assert operations(function).count(ca.OP_SIN) == ("waves" in on(structure))
    assert operations(function).count(ca.OP_FMIN) == structure.ramp
    assert (function.jac_sparsity(0, 0).nnz() > 0) == bool(on(structure) & {"waves", "ramp"})  # time


@pytest.mark.parametrize("structure", STRUCTURES, ids=label)
def test_signals_have_only_the_parameters_of_their_effects(structure):
    observed = signals(structure)
    needed = expected_parameters(structure)
    if structure.ramp and not structure.relaxed:
        needed.add("static")  # in the tow power P s', which holds the whole force at the start
    if structure.relaxed and structure.damper:
        needed.add("tow_speed")  # in the damper's force c V0 at the start
    # A start from rest under a moving strut has z' = V0, whether or not the signals say so.
    allowed = needed | ({"tow_speed"} if structure.relaxed and not structure.ramp else set())
    assert needed <= set(observed.parameters) <= allowed
    assert observed.count == 1 + structure.damper + structure.ramp
    assert observed.squared == 1 + structure.damper
    assert observed.function.numel_out(0) == observed.count


def test_bare_equation_is_a_spring_and_a_mass():
    # w, w', k0, M and the product, quotient and sign of -k0 w/M.
    assert size(BARE) == 7
    assert equation_of_motion(BARE).names == ("inertia", "stiffness")


def test_bare_signal_is_the_deflection_itself():
    assert signals(BARE).function.n_nodes() == 1


@pytest.mark.parametrize("effect", [name for name in FLAGS if name != "relaxed"])
def test_an_effect_adds_nodes_to_every_graph_without_it(effect):
    for structure in STRUCTURES:
        if effect not in on(structure):
            assert size(structure_of(on(structure) | {effect})) > size(structure)


@pytest.mark.parametrize(
    ("effect", "signal_nodes"),
    # Without damper and ramp the deflection is the only signal, whatever else is on.
    [("drag", 1), ("rate", 1), ("waves", 1), ("relaxed", 1)],
)
def test_effects_that_leave_mount_and_strut_alone_add_no_signal(effect, signal_nodes):
    assert signals(structure_of({effect})).function.n_nodes() == signal_nodes


@pytest.mark.parametrize(
    ("off", "effect", "on_value"),
    [
        ({"inertial_drag": False}, "drag", {"inertial_drag": True}),
        ({"rate_term": None}, "rate", {"rate_term": 0.1}),
        ({"strength_wave": None}, "waves", {"strength_wave": po.StrengthWave(0.3, 0.6)}),
        ({"tow_ramp": None}, "ramp", {"tow_ramp": 0.2}),
        ({"damping": None}, "damper", {"damping": 100.0}),
        ({"start": "equilibrium"}, "relaxed", {"start": "rest"}),
    ],
)
def test_each_effect_of_a_scene_is_one_flag_of_its_structure(r1_scene, off, effect, on_value):
    bare = r1_scene(**({"inertial_drag": False} | off))
    assert Structure.of(bare) == BARE
    assert set(parameters(bare)) == {"inertia", "stiffness", "static", "tow_speed"}
    scene = r1_scene(**({"inertial_drag": False} | on_value))
    assert on(Structure.of(scene)) == {effect}
    assert set(parameters(scene)) == {"inertia", "stiffness", "static", "tow_speed"} | OWN[effect]


def test_added_mass_and_ambient_pressure_are_numbers_of_the_same_graph(r1_scene):
    full, bare = r1_scene(), r1_scene(added_mass=False, ambient_pressure=False)
    assert Structure.of(full) == Structure.of(bare)
    assert parameters(full).keys() == parameters(bare).keys()
    assert parameters(bare)["inertia"] == bare.mass
    assert parameters(bare)["static"] < parameters(full)["static"]


def test_scenes_alike_share_one_graph(r1_scene):
    one, other = r1_scene(25.0, 0.25, 5e4), r1_scene(35.0, 0.2, 1e5)
    assert equation_of_motion(Structure.of(one)) is equation_of_motion(Structure.of(other))


# --- the equation itself ---


def strut_path(structure, time):
    """Path, speed and acceleration of the strut, from the ramp's polynomial."""
    v, ramp = NUMBERS["tow_speed"], NUMBERS["ramp_time"]
    if not structure.ramp:
        return v * time, v, 0.0
    if time >= ramp:
        return v * (time - ramp / 2), v, 0.0
    smoothstep = np.polynomial.Polynomial([0, 0, 0, 10, -15, 6])
    u = time / ramp
    return v * ramp * smoothstep.integ()(u), v * smoothstep(u), v / ramp * smoothstep.deriv()(u)


def resistance(structure, travel, speed):
    n = NUMBERS
    force = n["static"]
    if "rate" in on(structure):
        force *= 1 + n["rate_term"] * speed**2
    if structure.wave:
        force *= 1 + n["wave_amplitude"] * math.sin(2 * math.pi * travel / n["wavelength"])
    return force + (n["drag"] * speed**2 if "drag" in on(structure) else 0.0)


@pytest.mark.parametrize("structure", STRUCTURES, ids=label)
def test_acceleration_is_that_of_equation_27(structure):
    motion = equation_of_motion(structure)
    n, still = NUMBERS, structure_of(on(structure) - {"waves"})
    for time, w, rate in [(0.0, 0.0, 0.0), (0.1, 3e-3, 0.4), (0.37, -8e-3, 2.5), (0.4, 1e-3, -0.3), (1.7, 0.02, 1.0)]:
        path, speed, acceleration = strut_path(structure, time)
        start = 0.0 if structure.relaxed else resistance(still, 0.0, 0.0 if structure.ramp else n["tow_speed"])
        z = start / n["stiffness"] + w
        mount = n["stiffness"] * z + (n["damping"] * rate if structure.damper else 0.0)
        share = (mount - resistance(structure, path - z, speed - rate)) / n["inertia"]
        # The straight form subtracts forces of some 1e3 N: rounding leaves 1e-13 N, over 23 kg and with margin.
        found = at_numbers(motion.function, motion.names, time, w, rate)
        assert found == pytest.approx([rate, acceleration - share], rel=1e-13, abs=1e-13)


@pytest.mark.parametrize("structure", [s for s in STRUCTURES if not (s.wave or s.relaxed)], ids=label)
def test_nothing_moves_at_a_steady_start(structure):
    motion = equation_of_motion(structure)
    # Exactly zero, without rounding: the steady forces cancel on paper.
    assert list(at_numbers(motion.function, motion.names, 0.0, 0.0, 0.0)) == [0.0, 0.0]


@pytest.mark.parametrize("structure", STRUCTURES, ids=label)
def test_a_share_at_rest_deflects_the_spring_at_the_struts_speed(structure):
    moving = structure.relaxed and not structure.ramp
    assert start_state(structure, NUMBERS).full().ravel() == pytest.approx([0.0, moving * NUMBERS["tow_speed"]])


@pytest.mark.parametrize("structure", STRUCTURES, ids=label)
def test_signals_are_changes_of_deflection_and_force_and_the_tow_power(structure):
    observed, n = signals(structure), NUMBERS
    still = structure_of(on(structure) - {"waves"})
    for time, w, rate in [(0.0, 0.0, 0.0), (0.2, 4e-3, 0.7), (1.3, -2e-2, -0.4)]:
        speed = strut_path(structure, time)[1]
        first_rate = n["tow_speed"] if structure.relaxed and not structure.ramp else 0.0
        change = n["stiffness"] * w + (n["damping"] * (rate - first_rate) if structure.damper else 0.0)
        first = 0.0 if structure.relaxed else resistance(still, 0.0, 0.0 if structure.ramp else n["tow_speed"])
        expected = [w] + [change] * structure.damper + [(first + change) * speed] * structure.ramp
        found = at_numbers(observed.function, observed.parameters, time, w, rate)
        # Beyond the ramp's end its polynomial rounds to 1 within a few last bits.
        assert found == pytest.approx(expected, rel=1e-13, abs=1e-13)


@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
def test_ramp_is_smooth_and_reaches_the_tow_speed(kind):
    structure, t = structure_of({"ramp"}), kind.sym("t")
    mount = strut(structure, NUMBERS, t)
    path, gain = ca.jacobian(mount.path, t), ca.jacobian(mount.gain, t)
    of_time = ca.Function("strut", [t], [mount.path, mount.gain, mount.acceleration, path, gain])
    for time in (0.0, 0.05, 0.2, 0.399, 0.4, 0.7):
        s, v, a, s_slope, v_slope = map(float, of_time(time))
        assert [s, v, a] == pytest.approx(strut_path(structure, time), rel=1e-13, abs=1e-13)
        assert [s_slope, v_slope] == pytest.approx([v, a], rel=1e-13, abs=1e-13)
