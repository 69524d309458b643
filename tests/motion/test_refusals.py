"""Refusals: choices, scenes and runs without meaning, each with its reason.

A motion that cannot be integrated is refused soon, and the message says why.
"""

import math
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import pytest
from helpers.scenes import SEROZEM, SHARE, Own, Waves, scene_of
from helpers.small_designs import design

import plough_opt as po
from plough_opt.core.expressions import where
from plough_opt.core.quantities import QUANTITIES
from plough_opt.laws import McKyesAli, SwickPerumpral
from plough_opt.motion.methods import METHODS, adaptive, fixed_step
from plough_opt.motion.scene import with_quantities
from plough_opt.soil import elastic

STRONG = replace(SEROZEM, cohesion=1e6)
WAVE, SECOND = po.StrengthWave(0.3, 0.2), po.StrengthWave(0.1, 0.3, 0.7)
X = ca.MX.sym("x")


@dataclass(frozen=True)
class Holds(Own):
    """Resistance with another one at rest."""

    resting: object = None

    def at_rest(self, travel):
        return self.resting if travel is not None else None


class Named:
    """Object whose repr does not depend on its value."""

    def __repr__(self):
        return "Named"


def steady(*_):
    return 300.0


# --- choices ---

OWN = "must be a frozen dataclass with a method force"
STILL = {"motion": False}
EFFECTS = [
    *[({"contact": law}, r"must be 'resisting', Smooth\(width\) or StickSlip\(breakaway\)")
      for law in ("stick_slip", None, po.StickSlip)],
    *[({"start": start}, "must be 'equilibrium', 'rest' or 'towed'") for start in ("steady", None)],
    ({"entry": True}, "entry begins at first contact"),
    *[(STILL | {"start": start}, f"start = '{start}' needs motion") for start in ("rest", "towed")],
    *[(STILL | {"contact": law}, "a contact law needs motion") for law in (po.StickSlip(), po.Smooth(0.1))],
    *[(STILL | {"damping": value}, "damping needs motion") for value in (100.0, 0.0)],
    ({"contact": po.Smooth(0.1), "formulation": "printed"}, "the print has no contact law"),
    *[({"strength_wave": WAVE, "orbit": orbit}, "must be 'transient' or 'periodic'")
      for orbit in ("steady", None, "linearised", ["periodic"])],
    ({"strength_wave": ()}, r"strength_wave = \(\)"),
    ({"strength_wave": (0.3,)}, "must be None or a StrengthWave"),
    ({"strength_wave": (WAVE,) * 9}, "9 waves"),
    ({"strength_wave": (WAVE, po.StrengthWave(0.1, 0.2 * math.sqrt(2))), "orbit": "periodic"}, "no common period"),
    ({"strength_wave": (WAVE, po.StrengthWave(0.1, ca.MX.sym("l"))), "orbit": "periodic"}, "numeric wavelengths"),
    ({"strength_wave": (WAVE, SECOND), "orbit": "periodic", "own": (Own(steady),)}, "several .* cannot have own"),
    ({"own": (3.0,)}, rf"own effect 3\.0 {OWN}"),
    ({"own": Own(steady)}, "must be a tuple of effects"),
    *[({"own": (wrong,)}, OWN) for wrong in (Own, SHARE)],
    *[({"own": (Own(field),)}, "own effect Own holds a .*compared by their repr")
      for field in (ca.interpolant("table", "linear", [[-1.0, 3.0]], [1.0, 2.0]), np.zeros(5000), Named(),
                    (1.0, [np.zeros(2)]), {"x": ca.DM([1.0, 2.0])}, ca.MX.sym("x", 3))],
]  # fmt: skip


@pytest.mark.parametrize(("changes", "words"), EFFECTS)
def test_effects_without_meaning_or_that_exclude_each_other_are_refused_with_the_reason(changes, words):
    with pytest.raises(po.InputError, match=words):
        po.Effects(**changes)


@pytest.mark.parametrize("field", ["text", None, (1.0, 2.0), {"a": 1.0}, ca.SX.sym("x"), np.float64(2.0), object()])
def test_fields_of_own_effects_with_a_complete_repr_are_accepted(field):
    assert po.Effects(own=(Own(field),)).own[0].law is field


OUTSIDE = {
    "scene.stiffness": [0.0, -5e4], "scene.mass": [0.0], "scene.tow_speed": [-2.0], "share.height": [0.0],
    "effects.strength_wave.amplitude": [-0.1, 1.1], "effects.strength_wave.wavelength": [0.0, -0.6],
    "effects.random_strength.rms": [-0.1, 1.2], "effects.random_strength.correlation_length": [0.0],
    "effects.tow_ramp": [-1e-3], "effects.damping": [-1e-3], "effects.rate_term": [-1e-3],
    "effects.speed_term": [-1e-3], "effects.contact_width": [0.0], "effects.breakaway": [0.999],
}  # fmt: skip


@pytest.mark.parametrize("name", OUTSIDE)
def test_numbers_outside_their_domain_are_refused_by_name(name):
    contact = po.StickSlip() if name == "effects.breakaway" else po.Smooth(0.1)
    effects = {"strength_wave": WAVE, "random_strength": po.RandomStrength(0.1, 0.3), "tow_ramp": 0.1}
    scene = scene_of(contact=contact, damping=400.0, rate_term=0.01, speed_term=0.1, **effects)
    for wrong in (*OUTSIDE[name], math.nan, math.inf):
        with pytest.raises(po.DomainError, match=f"{QUANTITIES[name].called} = {wrong:g}.* must be"):
            with_quantities(scene, {name: wrong})


# --- accuracies ---

# Setting -> a valid value, the methods that have it, and invalid values.
SETTINGS = {
    "error": (1e-6, ("auto",), [0.0, 1e-13, 0.5, math.nan, "1e-6", ca.MX.sym("error")]),
    "derivatives": (1e-4, ("auto",), [0.0, 1e-11, 0.2, "fine", True]),
    "steps": (100, fixed_step(), [0, -3, [3], 2.5, True, 10**8]),
    "tolerance": (1e-9, adaptive(), [0.0, 1e-15, 1.0, [1e-8], np.array([1e-8, 1e-9])]),
}


@pytest.mark.parametrize("method", METHODS)
def test_each_method_has_its_own_settings_only_within_their_ranges(method):
    for name, (value, methods, wrong) in SETTINGS.items():
        if method in methods:
            assert getattr(po.Accuracy(method, **{name: value}), name) == value
            for other in wrong:
                with pytest.raises(po.InputError, match=f"accuracy {name}( = .* must be|: .* is not a number)"):
                    po.Accuracy(method, **{name: other})
        else:
            with pytest.raises(po.InputError, match=f"method '{method}' has no setting '{name}'"):
                po.Accuracy(method, **{name: value})


# --- scenes and runs ---


def run(duration=1.0, method=None, outputs=4, compiled=False, **changes):
    """Return a function that simulates a scene with changes."""
    given = {"outputs": outputs, "accuracy": method and po.Accuracy(method), "compiled": compiled}
    return lambda: po.simulate(scene_of(**changes), duration, **given)


def elastics(**changes):
    return lambda: scene_of(**{"medium": "elastic", "motion": False} | changes)


# The first pulls the share ever faster to a place, and the second begins suddenly.
DRAWN = Own(lambda travel, speed: 0.0 * speed - 50.0 / (0.3 - travel))
BED = Own(lambda travel, speed: where(travel > 0.3, 1e6, 0.0) * speed)
ENTERS = {"start": "rest", "entry": True}
SLIPS = {"start": "rest", "contact": po.StickSlip(1.2)}
DEEP = (po.StrengthWave(0.8, 0.2), po.StrengthWave(0.5, 0.3, 0.7))
INPUT = [
    (run(None), "the duration is missing"),
    (run(None, strength_wave=WAVE), "the duration is missing"),
    (run(None, motion=False), "the duration is missing"),
    (run(0.3, strength_wave=WAVE, orbit="periodic"), "lasts one wavelength .* omit the duration"),
    *[(run(duration), r"duration|one number per quantity")
      for duration in ("1", np.array([1.0, 2.0]), ca.DM([1.0, 2.0]), ca.MX.sym("duration", 2))],
    (run(stiffness=ca.MX.sym("stiffness", 2)), "one number per quantity"),
    (run(stiffness=np.array([1e4, 2e4])), "stiffness is an array of 2 values"),
    (run(method="rk", motion=False), "'rk' has nothing to integrate"),
    (lambda: scene_of().wave_period, "no strength_wave and therefore no period"),
    (lambda: po.Machine({}), "the run of at least one share"),
    *[(run(outputs=outputs), "outputs = .* must be a whole number")
      for outputs in ("4", None, 2.5, math.nan, True, 0, -4)],
    (lambda: po.simulate(SEROZEM, 1.0), "must be a Scene"),
    (lambda: po.simulate(scene_of(), 1.0, accuracy="rk"), "must be an Accuracy"),
    (run(stiffness=X, compiled=True), "cannot be compiled by itself"),
    *[(run(None, method, strength_wave=WAVE, orbit="periodic"), f"'{method}' cannot find an orbit: use 'auto', or 'do")
      for method in METHODS if method not in ("auto", "dop853")],
    *[(run(1.0, method, tow_speed=speed, **effects), f"'{method}' cannot locate.*'erk' or 'rosenbrock'")
      for method in METHODS if method not in ("auto", "erk", "rosenbrock")
      for effects in (SLIPS, ENTERS) for speed in (1.0, X)],
    *[(run(1.0, method, stiffness=ca.SX.sym("k0")), f"'{method}' takes MX symbols only: .*casadi.MX, or use 'dop853'")
      for method in METHODS if method not in ("auto", "dop853")],
    (run(None, stiffness=ca.SX.sym("k0"), strength_wave=WAVE, orbit="periodic"),
     r"an orbit takes MX symbols only.*use casadi\.MX"),
    (run(None, strength_wave=WAVE, orbit="periodic", own=(Waves(30.0, 0.0, 0.31),)),
     r"Waves.*one wavelength \(0\.2 m\) further on.*simulate from a start"),
    # Where both resistances are infinite, their difference is not a number.
    (run(None, strength_wave=WAVE, orbit="periodic",
         own=(Own(lambda travel, speed: where(speed < 1.5, math.inf, 30.0 * travel)),)), "Own.*further on"),
    *[(run(own=(Own(lambda *_, force=force: force),)), r"Own\.force returned")
      for force in (None, ca.DM([1.0, 2.0]), "12 N")],
    # A silent own effect, one that holds less than the force of slipping, and one without a number.
    (run(own=(Own(steady),), **SLIPS), r"Own does not define its force at rest.*at_rest\(travel\)"),
    (run(own=(Holds(steady, 200.0),), **SLIPS), r"Holds holds a share at rest with 200 N.*with 300 N: at_rest must"),
    (run(own=(Holds(steady, "much"),), **SLIPS), r"Holds\.at_rest returned 'much'"),
    (elastics(motion=True), r"motion has no meaning in the elastic medium.*Effects\(motion=False\)"),
    (elastics(own=(Own(steady),)), "own has no meaning in the elastic medium"),
    (elastics(strength_wave=WAVE), "strength_wave has no meaning"),
    (elastics(rate_term=0.1), "rate_term has no meaning"),
    (elastics(speed_term=0.1), "speed_term has no meaning"),
    (elastics(formulation=po.Printed(repelling_spring=False)), "printed formulation is one of the plastic gas"),
    (elastics(medium="viscous"), "no resistance law is named 'viscous'.*elastic.*plastic"),
    (run(soil=replace(SEROZEM, youngs_modulus=None), medium="elastic", motion=False), "needs youngs_modulus"),
    *[(lambda effects=effects: scene_of(medium=SwickPerumpral(width=0.1), **effects),
       "no meaning in Swick-Perumpral, which gives the force of steady")
      for effects in ({}, {"motion": False, "strength_wave": WAVE})],
    (lambda: scene_of(medium=McKyesAli(width=0.1), **ENTERS), "how the resistance grows while the share enters"),
    (lambda: scene_of(medium=McKyesAli(), formulation="printed"), "is one of the plastic gas"),
    *[(lambda law=law: scene_of(medium=law), "must be a ResistanceLaw, such as McKyesAli")
      for law in (McKyesAli, 3, None, object())],
]  # fmt: skip
DOMAIN = [
    *[(run(duration), "duration = ") for duration in (0.0, -1.0, math.nan, math.inf, [1.0])],
    (run(None, tow_speed=0.0, strength_wave=WAVE, orbit="periodic"), "tow speed = 0.*has no orbit"),
    (run(medium="elastic", motion=False, tow_speed=1.1 * elastic.shear_wave_speed(SEROZEM)),
     r"speed over shear wave speed = 1\.1"),
    (run(strength_wave=DEEP, damping=400.0), r"strength by a factor of -0\.156\d at a travel of 0\.15[78]\d m"),
    (run(strength_wave=DEEP, stiffness=X), r"amplitudes is 1\.3"),
]  # fmt: skip
COUNTLESS = "times: use a shorter duration or a longer wave"
LATE = [
    *[(run(2.0, strength_wave=po.StrengthWave(0.3, 1e-6), motion=motion), COUNTLESS) for motion in (True, False)],
    *[(run(1e9, strength_wave=po.StrengthWave(0.3, 0.6), motion=motion), COUNTLESS) for motion in (True, False)],
    *[(run(method=method, stiffness=stiffness, own=(own,)), words) for method, stiffness, own, words in (
        ("erk", 5e4, DRAWN, r"a resistance drives the share away.* let own effects oppose the motion"),
        ("dop853", 5e4, BED, ": steps are too long"),
        ("erk", 1e12, DRAWN, r"it oscillates \S+ times: .* a softer or a damped mount"))],
    # A stiff mount would take minutes.
    (run(stiffness=1e12, start="rest"), "times, which would take"),
    (run(None, stiffness=1e9, tow_speed=0.5, strength_wave=po.StrengthWave(0.3, 4.0), orbit="periodic"),
     r"1e\+06 kN/m.*turns in one wavelength.*softer.*Effects\(motion=False\).*dop853"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("error", "attempt", "words"),
    [(error, *row) for error, rows in
     ((po.InputError, INPUT), (po.DomainError, DOMAIN), (po.IntegrationError, LATE)) for row in rows],
    ids=lambda value: value[:40] if isinstance(value, str) else "",
)  # fmt: skip
def test_what_has_no_meaning_is_refused_with_the_reason(error, attempt, words):
    with pytest.raises(error, match=words):
        attempt()


def test_a_run_that_ends_before_the_strength_is_negative_is_valid():
    assert run(0.07, strength_wave=DEEP, motion=False)().mean_draft > 0.0


def test_a_design_refuses_an_orbit_that_its_scene_or_a_bound_cannot_have():
    for words, upper, changes in (
        ("further on", 6e4, {"strength_wave": WAVE, "own": (Waves(30.0, 0.0, 0.31),)}),
        ("at the upper bound of 'stiffness': the periodic orbit of", 1e9,
         {"tow_speed": 0.5, "strength_wave": po.StrengthWave(0.3, 4.0)}),
    ):  # fmt: skip
        d, stiffness = design(stiffness=(5e4, 4e4, upper))
        d.minimise(po.simulate(scene_of(stiffness=stiffness, orbit="periodic", **changes)).force_rms)
        with pytest.raises(po.PloughError, match=words):
            d.solve()


def test_a_symbolic_run_refuses_what_it_lacks():
    symbolic = run(stiffness=X, strength_wave=WAVE)()
    for name, what in (("error_estimate", "error estimate"), ("seconds", "computing time")):
        with pytest.raises(po.InputError, match=f"no {what}: simulate the scene with numbers"):
            getattr(symbolic, name)
    for name, array in (("peak_force", "mount_force"), ("peak_deflection", "deflection")):
        with pytest.raises(po.InputError, match=f"no {name}.*limit run.{array}"):
            getattr(symbolic, name)
    assert "cannot be checked" in symbolic.warnings[0]


def test_only_a_numeric_periodic_orbit_has_multipliers_and_settles():
    for words, kept in (
        ("periodic orbit", run(0.3, strength_wave=WAVE)()),
        ("a symbolic run has no", run(None, stiffness=X, strength_wave=WAVE, orbit="periodic")()),
    ):
        for name in ("floquet", "settles"):
            with pytest.raises(po.InputError, match=words):
                getattr(kept, name)


@dataclass(frozen=True)
class Undefined(po.ResistanceLaw):
    """Law with given coefficients."""

    coefficients: tuple
    label = "a law with a gap"
    standing = "fitted below 1 m/s"

    def reaction(self, at):
        del at
        return po.SoilReaction(*self.coefficients)


@pytest.mark.parametrize("effects", [{}, STILL, SLIPS, {"strength_wave": WAVE, "orbit": "periodic", "damping": 400.0}])
@pytest.mark.parametrize(
    ("coefficients", "words"),
    [((math.nan, 1.0, 0.0), "static resistance = nan"), ((1e3, math.inf, 0.0), "squared speed = inf"),
     ((1e3, 1.0, -50.0), "moving mass .* = -30 kg must be above 0")],
)  # fmt: skip
def test_a_law_without_a_value_is_named_with_its_range(coefficients, words, effects):
    with pytest.raises(po.DomainError, match=f"{words}.*a law with a gap.*fitted below 1 m/s"):
        run(None if "orbit" in effects else 0.2, medium=Undefined(coefficients), **effects)()


# --- motions without an end ---


def refusal(scene, duration, **keywords):
    with pytest.raises(po.IntegrationError) as caught:
        po.simulate(scene, duration, **keywords)
    return str(caught.value)


@pytest.mark.parametrize("rate_term", [None, 0.1])
@pytest.mark.parametrize(("mass", "effects"), [(0.07, {"start": "rest"}), (45.0, {"start": "towed"})])
def test_a_share_driven_away_by_the_soil(mass, effects, rate_term):
    message = refusal(scene_of(STRONG, SHARE, 1e3, mass, 1.0, rate_term=rate_term, **effects), 0.6)
    assert "under contact 'resisting' the soil does once a share retreats: use contact = StickSlip()" in message
    assert "oscillat" not in message


ROOTED = Own(lambda travel, speed: 100.0 * po.expressions.sqrt(0.3 - travel) + 0.0 * speed)  # no value beyond 0.3 m
NEVER = Own(lambda travel, speed: float("nan") * speed + 0.0 * travel)
STUCK = Holds(steady, math.inf)


NOT_FINITE = [
    (ROOTED, "0.3", {}),
    (ROOTED, "0.3", {"start": "towed", "entry": True}),
    (ROOTED, "0.3", {"contact": po.Smooth(0.2), "start": "rest"}),
    (ROOTED, "0.3", {"motion": False}),
    (NEVER, "0 m", {}),
    (STUCK, "0 m and at rest", {"contact": po.StickSlip(), "start": "rest"}),
]


@pytest.mark.parametrize(
    ("own", "at", "effects"), NOT_FINITE, ids=["resisting", "entry", "smooth", "quasi-static", "always", "at rest"]
)
def test_an_own_effect_that_returns_no_finite_number_is_named(own, at, effects):
    message = refusal(scene_of(mass=45.0, tow_speed=1.5, own=(own,), **effects), 1.0)
    returned = "inf" if own is STUCK else "nan"
    assert f"the own effect {type(own).__name__} returns {returned} N at a travel of {at}" in message
    assert "must return a finite resistance" in message


@pytest.mark.parametrize("damping", [None, 200.0])
def test_where_no_orbit_is_found_the_message_names_a_remedy(r1_scene, damping, capfd):
    effects = {"tow_speed": 0.3, "strength_wave": po.StrengthWave(1.0, 0.2)}
    with pytest.raises(po.IntegrationError, match=r"no periodic orbit of a share .*2 kN/m.*damp.*orbit = 'transient'"):
        po.simulate(r1_scene(stiffness=2e3, damping=damping, orbit="periodic", **effects))
    # CasADi must not print a page on the root that it did not find.
    assert capfd.readouterr() == ("", "")


def test_at_the_resonance_of_a_conservative_mount_there_is_no_orbit(capfd):
    scene = scene_of(inertial_drag=False, strength_wave=WAVE, orbit="periodic")
    scene = replace(scene, stiffness=scene.inertia * scene.wave_frequency**2)
    with pytest.raises(po.IntegrationError, match="damp the mount"):
        po.simulate(scene)
    assert capfd.readouterr() == ("", "")
