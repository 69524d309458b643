"""Combinations of all effects: correct motion, balance of energy, no trace of effects that are off, and refusals.

The balance is: tow work = change of m L'^2/2 (of m alone) + change of k0 z^2/2 + work of the damper + work on the soil,
which includes the C L'' term and the loss at recapture. Tow work and changes come from the run, the rest from an
independent solver.
"""

import itertools

import casadi as ca
import numpy as np
import pytest
from helpers import three_modes

import plough_opt as po
from plough_opt.motion.equation import Structure, equation_of, parameters

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
OWN = {
    "inertial_drag": {"drag"}, "added_mass": {"added_mass"}, "entry": {"height"}, "tow_ramp": {"ramp_time"},
    "strength_wave": {"wave_amplitude", "wavelength"}, "damping": {"damping"}, "rate_term": {"rate_term"},
    "speed_term": {"speed_term"},
}  # fmt: skip


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


def scene_of(soil, effects, **changes):
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


def imbalance(scene, motion, books, duration):
    """Return the error of the energy balance relative to its largest term."""
    speed, deflection, tow = motion.speed, motion.deflection, motion.tow_power * duration
    kinetic = scene.mass * (speed[-1] ** 2 - speed[0] ** 2) / 2.0
    elastic = scene.stiffness * (deflection[-1] ** 2 - deflection[0] ** 2) / 2.0
    terms = [kinetic, elastic, books.damper_work, books.soil_work]
    swing = scene.stiffness * np.max(deflection**2) / 2.0
    return (tow - sum(terms)) / max(swing, abs(tow), *map(abs, terms))


@pytest.mark.parametrize("combinations", list(split(VALID, COVERING)))
def test_combinations_run_and_are_right(r1_soil, combinations):
    for effects in combinations:
        scene = scene_of(r1_soil, effects)
        # The resistance to a share that is pushed back through a wave changes within millimetres.
        run, expected = three_modes.agreed(scene, 0.5, resistance=10.0)
        # The reference balances up to SciPy's error of about 1e-12.
        assert abs(imbalance(scene, expected, expected, 0.5)) < 5e-12
        # The default promises an error of 1e-8 and usually reaches a tenth of it.
        assert abs(imbalance(scene, run, expected, 0.5)) < 2e-9
        if effects["contact"] != "resisting":
            # Soil that only resists absorbs energy, except for that of the soil carried along.
            carried = scene.reaction.added_mass * np.max(expected.speed) ** 2 / 2.0
            assert expected.soil_work > -carried


@pytest.mark.parametrize("effects", COVERING, ids=label)
def test_effects_that_are_off_are_not_in_the_equation(r1_soil, effects):
    scene = scene_of(r1_soil, effects)
    structure, known = Structure.of(scene), parameters(scene)
    equation = equation_of(structure)
    # The outputs always name the added mass, which is 0 if that effect is off.
    names = set(equation.names) | set(known) - {"added_mass"}
    assert is_on(effects, "added_mass") or known["added_mass"] == 0.0
    for name, own in OWN.items():
        assert is_on(effects, name) or not (own & names), name
    stick_slip, smooth = (isinstance(effects["contact"], law) for law in (po.StickSlip, po.Smooth))
    assert stick_slip or "breakaway" not in names
    assert smooth == ("width" in names)
    events = stick_slip or effects["entry"]
    assert equation.states == 2 + events * (2 + effects["entry"] + is_on(effects, "tow_ramp"))
    assert (equation.events is not None) == events
    operations = [equation.rate.instruction_id(k) for k in range(equation.rate.n_instructions())]
    assert is_on(effects, "strength_wave") == (ca.OP_SIN in operations)


def test_the_bare_equation_is_a_spring_and_a_mass(r1_scene):
    bare, damped = (equation_of(Structure.of(r1_scene(inertial_drag=False, damping=c))) for c in (None, 100.0))
    assert bare.names == ("inertia", "stiffness")
    # w, w', k0, M and the product, quotient and sign of -k0 w/M.
    assert bare.rate.n_nodes() == 7 < damped.rate.n_nodes()
    # Scenes of equal structure share one graph.
    other = r1_scene(35.0, 0.2, 1e5, inertial_drag=False, added_mass=False, ambient_pressure=False)
    assert equation_of(Structure.of(other)) is bare
