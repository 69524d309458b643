"""Every effect beside every other: what runs is right, what is off is absent, and what is refused says why."""

import itertools

import casadi as ca
import numpy as np
import pytest
from helpers import three_modes

import plough_opt as po
from plough_opt.motion.equation import equation_of_motion, signals
from plough_opt.motion.terms import Structure, parameters

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
}
# Refused by themselves, so combined apart from the rest.
FURTHER = {
    "motion": (True, False),
    "orbit": ("transient", "periodic"),
    "formulation": ("derived", "printed"),
}
OWN = {
    "inertial_drag": {"drag"},
    "added_mass": {"added_mass"},
    "entry": {"height"},
    "strength_wave": {"wave_amplitude", "wavelength"},
    "tow_ramp": {"ramp_time"},
    "damping": {"damping"},
    "rate_term": {"rate_term"},
}


def covering(factors, strength=3):
    """Return combinations that hold every choice of any three factors together, by greedy choice among samples."""
    names, random = list(factors), np.random.default_rng(0)
    wanted = {
        (chosen, values)
        for chosen in itertools.combinations(range(len(names)), strength)
        for values in itertools.product(*(range(len(factors[names[k]])) for k in chosen))
    }
    rows = []
    while wanted:
        # One of those that are missing is set; the rest is the best of some samples.
        chosen, values = min(wanted)
        best, covered = None, set()
        for _ in range(8):
            row = [int(random.integers(len(factors[name]))) for name in names]
            for k, value in zip(chosen, values, strict=True):
                row[k] = value
            held = {(c, tuple(row[k] for k in c)) for c in itertools.combinations(range(len(names)), strength)} & wanted
            if len(held) > len(covered):
                best, covered = row, held
        wanted -= covered
        rows.append({name: factors[name][k] for name, k in zip(names, best, strict=True)})
    return rows


def is_on(effects, name):
    return effects[name] not in (None, False)


def refused(effects):
    """Tell whether effects exclude each other, as the documentation says."""
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


COVERING = covering(FACTORS)
ALL = [dict(zip(FACTORS, values, strict=True)) for values in itertools.product(*FACTORS.values())]


def label(effects):
    on = [name for name in FACTORS if name not in ("contact", "start") and is_on(effects, name)]
    return "+".join([type(effects["contact"]).__name__, effects["start"], *on])


def cases():
    """Yield the covering combinations one by one, and as slow tests all others, two dozen at a time."""
    yield from (pytest.param([row], id=label(row)) for row in COVERING)
    others = [row for row in ALL if row not in COVERING]
    for first in range(0, len(others), 24):
        yield pytest.param(others[first : first + 24], id=f"others from {first}", marks=pytest.mark.slow)


def scene_of(soil, effects, **changes):
    return po.Scene(soil, SHARE, 3e4, 24.0, 1.2, po.Effects(**(effects | changes)))


def largest(values):
    return float(np.max(np.abs(values)))


def test_the_covering_array_is_one():
    assert len(COVERING) < 80
    for chosen in itertools.combinations(FACTORS, 3):
        seen = {tuple(row[name] for name in chosen) for row in COVERING}
        assert seen == set(itertools.product(*(FACTORS[name] for name in chosen)))


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


@pytest.mark.parametrize("combinations", list(cases()))
def test_combinations_run_and_are_right(r1_soil, combinations):
    for effects in combinations:
        check_run(r1_soil, effects)


def check_run(r1_soil, effects):
    if refused(effects):
        with pytest.raises(po.InputError, match="entry begins at first contact"):
            po.Effects(**effects)
        return
    scene = scene_of(r1_soil, effects)
    run, expected = po.simulate(scene, 0.5, outputs=10), three_modes.follow(scene, 0.5, outputs=10)
    size = max(abs(expected.mean_draft), expected.force_rms)
    assert largest(run.mount_force - expected.mount_force) < 2e-8 * largest(expected.mount_force)
    assert run.mean_draft == pytest.approx(expected.mean_draft, rel=0, abs=2e-8 * size)
    assert run.force_rms == pytest.approx(expected.force_rms, rel=0, abs=2e-8 * size)
    assert run.tow_power == pytest.approx(expected.tow_power, rel=0, abs=2e-8 * size * scene.tow_speed)


@pytest.mark.parametrize("combinations", list(cases()))
def test_what_is_off_is_not_in_the_equation(r1_soil, combinations):
    for effects in combinations:
        check_equation(r1_soil, effects)


def check_equation(r1_soil, effects):
    if refused(effects):
        assert effects["start"] == "equilibrium"
        return
    scene = scene_of(r1_soil, effects)
    structure, known = Structure.of(scene), parameters(scene)
    equation = equation_of_motion(structure)
    stick_slip, smooth = (isinstance(effects["contact"], law) for law in (po.StickSlip, po.Smooth))
    names = set(equation.names) | set(signals(structure).parameters) | set(known)
    for name, own in OWN.items():
        assert is_on(effects, name) or not (own & names), name
    assert stick_slip or "breakaway" not in names
    assert smooth == ("width" in names)
    events = stick_slip or effects["entry"]
    assert equation.states == 2 + events * (2 + effects["entry"] + is_on(effects, "tow_ramp"))
    assert (equation.events is not None) == events
    operations = [equation.function.instruction_id(k) for k in range(equation.function.n_instructions())]
    assert is_on(effects, "strength_wave") == (ca.OP_SIN in operations)
    # Another effect that is switched on adds nodes. (A ramp may take some away, for it starts at rest.)
    for name, choices in FACTORS.items():
        others = {**effects, name: choices[-1]}
        if name in ("strength_wave", "damping", "rate_term", "entry") and not is_on(effects, name):
            if refused(others):
                continue
            more = equation_of_motion(Structure.of(scene_of(r1_soil, others)))
            assert more.function.n_nodes() > equation.function.n_nodes(), name


@pytest.mark.parametrize("entry", [False, True])
@pytest.mark.parametrize("contact", FACTORS["contact"], ids=lambda law: type(law).__name__)
@pytest.mark.parametrize("start", FACTORS["start"])
@pytest.mark.parametrize(
    ("zero", "others"),
    [
        ({"strength_wave": po.StrengthWave(0.0, 0.25)}, {"damping": 120.0}),
        ({"damping": 0.0}, {"strength_wave": po.StrengthWave(0.7, 0.25)}),
        ({"rate_term": 0.0}, {"strength_wave": po.StrengthWave(0.7, 0.25)}),
        ({"tow_ramp": 0.0}, {"strength_wave": po.StrengthWave(0.7, 0.25)}),
    ],
    ids=lambda value: next(iter(value)),
)
def test_zero_strength_equals_off(r1_soil, zero, others, start, contact, entry):
    common = {"start": start, "contact": contact, "entry": entry, **others}
    if entry and start == "equilibrium":
        with pytest.raises(po.InputError, match="entry begins at first contact"):
            po.Effects(**common)
        return
    with_zero, without = (po.simulate(scene_of(r1_soil, common, **more), 0.4, outputs=8) for more in (zero, {}))
    size = largest(without.mount_force) + 1e-9
    # The tolerance's steps may fall otherwise by the last bit; both keep 1e-8.
    assert with_zero.mount_force == pytest.approx(without.mount_force, rel=0, abs=1e-8 * size)
    assert with_zero.mean_draft == pytest.approx(without.mean_draft, rel=0, abs=1e-8 * size)
    assert with_zero.force_rms == pytest.approx(without.force_rms, rel=0, abs=1e-8 * size)
    assert list(np.round(with_zero.mode)) == list(np.round(without.mode))


def test_a_share_that_never_stops_needs_no_law(r1_soil):
    calm = {**ALL[0], "damping": 300.0, "strength_wave": po.StrengthWave(0.02, 0.25)}
    runs = [po.simulate(scene_of(r1_soil, calm, contact=law), 0.5) for law in FACTORS["contact"]]
    assert min(runs[0].speed) > 0.1
    for run in runs[1:]:
        assert run.mount_force == pytest.approx(runs[0].mount_force, rel=0, abs=3e-8 * largest(runs[0].mount_force))
