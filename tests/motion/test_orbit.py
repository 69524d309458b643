"""Periodic orbits under a strength wave, their derivatives, and whether a share comes to them."""

import functools
import math

import casadi as ca
import numpy as np
import pytest
from helpers.orbit_oracle import follow, monodromy, orbit, period
from helpers.scenes import R1_SOIL, SHARP, Shank, Waves, scene_of

import plough_opt as po

# --- the periodic orbit under a strength wave against SciPy's integration, and against formulas ---

OUTPUTS = 96
WAVE = po.StrengthWave(0.3, 0.6)
FULL = po.StrengthWave(1.0, 0.6)
CASES = {
    "undamped with drag": {},
    "damped": {"damping": 400.0},
    "soft": {"stiffness": 2e3},
    "stiff": {"stiffness": 1e7},
    "resonant": {"stiffness": 1.2e4},
    "resonant and damped": {"stiffness": 1.2e4, "damping": 250.0},
    "rate term": {"rate_term": 0.05, "damping": 100.0},
    "speed term": {"speed_term": 0.2, "damping": 100.0},
    "conservative": {"inertial_drag": False},
    "slow": {"tow_speed": 0.5, "damping": 300.0},
    "strongest": {"strength_wave": FULL},
    "strongest, soft": {"strength_wave": FULL, "stiffness": 4e3, "damping": 100.0},
    "strongest, short": {"strength_wave": po.StrengthWave(1.0, 0.2), "stiffness": 1e5, "damping": 400.0},
    "weak": {"strength_wave": po.StrengthWave(1e-5, 0.6), "damping": 100.0},
    "retreating": {"height": 0.5, "stiffness": 3e4, "strength_wave": FULL},
    "light": {"added_mass": False, "ambient_pressure": False, "damping": 50.0},
    "stiffest": {"stiffness": 1e9},
    "stiffest and damped": {"stiffness": 1e9, "damping": 2e4},
}


@pytest.fixture(scope="module")
def case_of(r1_scene):
    def build(name, **changes):
        own = {"strength_wave": WAVE, "orbit": "periodic"} | CASES[name] | changes
        return r1_scene(**own)

    return build


@pytest.mark.parametrize("name", CASES)
def test_orbit_and_multipliers_are_those_that_scipy_finds_by_shooting(case_of, name):
    run = po.simulate(case_of(name), accuracy=po.Accuracy(error=1e-11), outputs=OUTPUTS)
    true = orbit(run.scene, (run.deflection[0], run.scene.tow_speed - run.speed[0]), OUTPUTS)
    assert run.error_estimate <= 1e-8
    # SciPy's relative tolerance of 1e-12 and the root of the shooting leave about 3e-11.
    size = np.ptp(true.deflection)
    assert run.deflection == pytest.approx(true.deflection, rel=0, abs=2e-10 * size + 1e-14 * np.max(true.deflection))
    assert run.mount_force == pytest.approx(true.force, rel=0, abs=2e-10 * np.max(true.force))
    # The speed of the share is rounded to 1e-16 of itself.
    rate, allowed = run.scene.tow_speed - run.speed, 1e-9 * np.max(np.abs(true.rate)) + 2e-15
    assert rate == pytest.approx(true.rate, rel=0, abs=allowed)
    # Compare sum and product, which are smooth where two multipliers meet; the multipliers themselves are not.
    phase = run.scene.natural_frequency * run.duration
    expected = [1.0, -np.trace(true.monodromy), np.linalg.det(true.monodromy)]
    allowed = 1e-9 * max(1.0, np.max(np.abs(expected)), phase)
    assert np.poly(np.array(run.floquet)).real == pytest.approx(expected, rel=0, abs=allowed)


@pytest.mark.parametrize(("damping", "unstable"), [(35.2, True), (35.3, False)])
def test_an_unstable_orbit_carries_a_warning(case_of, damping, unstable):
    # Between these two the largest multiplier passes through 1, from which it differs by 4e-4 at both.
    run = po.simulate(case_of("soft", damping=damping), outputs=1)
    first = np.array([run.deflection[0], run.scene.tow_speed - run.speed[0]])
    excess = max(abs(np.linalg.eigvals(monodromy(run.scene, first)))) - 1.0
    assert max(map(abs, run.floquet)) - 1.0 == pytest.approx(excess, abs=1e-9)
    assert (1e-4 < excess < 1e-3) if unstable else (-1e-3 < excess < -1e-4)
    warnings = [text for text in run.warnings if "the orbit is unstable" in text]
    assert len(warnings) == unstable
    assert all(f"grows {1.0 + excess:.4g} times in every wavelength" in text for text in warnings)


@pytest.mark.parametrize("effects", [{}, {"damping": 100.0, "rate_term": 0.05}, {"inertial_drag": False}])
def test_without_amplitude_the_share_slides_steadily(r1_scene, effects):
    scene = r1_scene(strength_wave=po.StrengthWave(0.0, 0.6), orbit="periodic", **effects)
    run = po.simulate(scene, outputs=8)
    assert run.mean_draft == pytest.approx(scene.steady_resistance, rel=1e-15)
    assert run.force_rms == run.displacement_rms == run.error_estimate == 0.0
    assert run.deflection == pytest.approx(np.full(9, scene.steady_resistance / scene.stiffness), rel=1e-15)
    assert run.speed == pytest.approx(np.full(9, 2.0), rel=1e-15)


@pytest.mark.parametrize("amplitude", [0.1, 0.3])
def test_an_own_wave_is_as_good_as_the_soils(r1_scene, amplitude):
    own = (Waves((0.3 - amplitude) * float(r1_scene().reaction.static)),)
    parts, whole = (
        po.simulate(r1_scene(strength_wave=po.StrengthWave(a, 0.2), own=waves, orbit="periodic", damping=400.0))
        for a, waves in ((amplitude, own), (0.3, ()))
    )
    assert parts.mount_force == pytest.approx(whole.mount_force, rel=1e-8)


@pytest.mark.parametrize("name", ["damped", "rate term", "speed term", "conservative", "slow", "stiffest and damped"])
def test_the_orbit_of_a_slight_wave_is_the_linear_response_of_the_textbook(case_of, name):
    amplitude = 1e-5
    run = po.simulate(case_of(name, strength_wave=po.StrengthWave(amplitude, 0.6)), outputs=48)
    scene, effects, reaction = run.scene, run.scene.effects, run.scene.reaction
    v, damping = scene.tow_speed, effects.damping or 0.0
    linear, kappa = effects.speed_term or 0.0, effects.rate_term or 0.0  # no case has both
    # F(L, L') to first order in w about L = V0 t - z_s, L' = V0: forced by the wave, damped by dF/dL'.
    omega = 2 * math.pi * v / 0.6
    steady = reaction.static * (1 + linear * v + kappa * v**2) + reaction.drag * v**2
    friction = damping + linear * reaction.static + 2 * v * (reaction.drag + kappa * reaction.static)
    push = amplitude * reaction.static * (1 + linear * v + kappa * v**2)
    phasor = push / (scene.stiffness - scene.inertia * omega**2 + 1j * omega * friction)
    phasor *= np.exp(-2j * math.pi / 0.6 * steady / scene.stiffness)
    turning = (phasor * np.exp(1j * omega * np.asarray(run.time))).imag
    # What is neglected is of second order in the amplitude.
    assert run.deflection - steady / scene.stiffness == pytest.approx(turning, rel=0, abs=1e-3 * abs(phasor))
    force = phasor * (scene.stiffness + 1j * omega * damping)
    assert run.force_rms == pytest.approx(abs(force) / math.sqrt(2), rel=1e-3)


# --- derivatives where the amplitude vanishes; `test_effect_combinations` compares others with differences ---


def results(values):
    stiffness, mass, speed, wavelength, amplitude, damping = values
    effects = {"strength_wave": po.StrengthWave(amplitude, wavelength), "damping": damping, "orbit": "periodic"}
    scene = scene_of(R1_SOIL, SHARP, stiffness, mass, speed, **effects)
    # At most 0.2 rad per step of order 8, which leaves rounding.
    run = po.simulate(scene, accuracy=po.Accuracy("dop853", steps=120), outputs=48)
    averages = [run.mean_draft, run.force_rms, run.mean_deflection, run.displacement_rms, run.tow_power]
    at_times = [run.deflection[16], run.mount_force[24], run.soil_resistance[7], run.speed[12], run.duration]
    return averages + at_times


def test_derivatives_are_finite_and_right_without_amplitude():
    x, weights = ca.MX.sym("x", 6), ca.MX.sym("weights", 10)
    found = ca.vertcat(*results(ca.vertsplit(x)))
    first = ca.Function("first", [x], [found, ca.jacobian(found, x)])
    second = ca.Function("second", [x, weights], [ca.hessian(ca.dot(weights, found), x)[0]])
    at, some = np.array([3e4, 25.0, 2.0, 0.6, 0.0, 300.0]), np.array([3e4, 25.0, 2.0, 0.6, 1e-4, 300.0])
    value, slopes = (np.asarray(result) for result in first(at))
    for part in (value, slopes, np.asarray(second(at, np.ones(10)))):
        assert np.all(np.isfinite(part))
    change = (np.asarray(first(some)[0]) - value) / 1e-4
    # The deflection changes in proportion to the amplitude, with a correction of first order in it ...
    assert slopes[5, 4] == pytest.approx(change[5, 0], rel=1e-3)
    # ... and the mean draft by its square.
    assert slopes[0, 4] == pytest.approx(0.0, abs=1e-9 * value[0, 0])
    # Derivatives by other quantities are those of steady sliding, on which c has no effect.
    deflection = value[2, 0]
    assert slopes[2, 0] == pytest.approx(-deflection / 3e4, rel=1e-9)
    assert slopes[2, [1, 3, 5]] == pytest.approx(np.zeros(3), abs=1e-12 * deflection)


# --- where a share that starts from equilibrium ends up, compared with the periodic orbit that was found ---

# The orbit is stable (its larger multiplier is 0.73) and never retreats, but equilibrium leads to another motion.
TWO_MOTIONS = scene_of(
    po.Soil(1285.32, 0.829167, 41721.3, 0.472563, 0.689544, 0.0),
    po.Wedge(0.859646, 0.30097, 0.332078),
    *(8856.09, 18.1717, 1.13819),
    strength_wave=po.StrengthWave(0.262576, 0.0633886),
    damping=153.44,
    orbit="periodic",
)
SHORT_WAVE = po.StrengthWave(0.3, 0.2)


def settled_on(scene, after, over):
    """Return, by SciPy, the states of a share from equilibrium at the ends of so many wavelengths.

    Beside them stand the RMS of the mount force [N] over the last wavelengths, and whether the share then retreats.
    """
    each = 60
    equilibrium = (scene.reaction.static + scene.reaction.drag * scene.tow_speed**2) / scene.stiffness
    times = np.linspace(0.0, after * period(scene), after * each + 1)
    z, rate = follow(scene, (equilibrium, 0.0), times[-1], times, rtol=1e-9)
    force = (scene.stiffness * z + scene.effects.damping * rate)[-over * each :]
    return np.array([z, rate])[:, ::each], float(np.std(force)), bool(np.max(rate[-over * each :]) > scene.tow_speed)


def test_another_motion_than_the_stable_orbit_is_named():
    run = po.simulate(TWO_MOTIONS)
    assert max(map(abs, run.floquet)) < 0.8
    assert run.speed.min() > 0.0
    ends, rms, retreats = settled_on(TWO_MOTIONS, after=120, over=6)
    np.testing.assert_allclose(ends[:, -1], ends[:, -7], rtol=1e-6, atol=1e-8)
    assert min(np.max(np.abs(ends[:, -1] - ends[:, -1 - k])) for k in range(1, 6)) > 1e-2
    found = run.settles
    assert (found.orbit, found.period, found.averaged, found.retreats) == (False, 6, 6, retreats)
    # The mean over 60 samples a wavelength is exact; the states are within 1e-6 of the limit.
    assert found.force_rms == pytest.approx(rms, rel=1e-6)
    (warning,) = [text for text in run.warnings if "equilibrium" in text]
    assert warning.startswith("a share that starts from equilibrium comes to a period-6 motion of RMS 423.4 N")
    assert "although the orbit is stable" in warning


# Without drag in the soil the last one comes nearer by only 0.2 % in every wavelength.
@pytest.mark.parametrize(("stiffness", "damping", "drag"), [(5e4, 20.0, True), (3e5, 400.0, True), (1e6, 1.0, False)])
def test_a_share_that_comes_to_the_orbit(r1_scene, damping, stiffness, drag):
    effects = {"strength_wave": SHORT_WAVE, "damping": damping, "inertial_drag": drag}
    run = po.simulate(r1_scene(stiffness=stiffness, orbit="periodic", **effects))
    assert run.settles.orbit is True
    assert run.settles.force_rms == run.force_rms
    assert not [text for text in run.warnings if "equilibrium" in text]
    assert run.settles.text.startswith("comes to this orbit (after ")
    # A run from the start, one wavelength longer, ends as near to the orbit as stated. Its own error is far smaller.
    count = run.settles.wavelengths
    followed = po.simulate(
        r1_scene(stiffness=stiffness, **effects), (count + 1) * run.duration, outputs=40 * (count + 1)
    )
    away = np.max(np.abs(followed.deflection[-41:] - run.deflection[::10])) / (np.ptp(run.deflection) / 2.0)
    assert away <= 1.5 * run.settles.distance + 1e-9


def test_a_share_that_is_driven_away_from_the_start():
    effects = {"strength_wave": po.StrengthWave(0.6, 1.0), "damping": 100.0}
    given = {"share": po.Wedge(1.0, 0.3, 0.4), "stiffness": 3e4, "mass": 5.0, **effects}
    run = po.simulate(scene_of(orbit="periodic", **given))
    assert (run.settles.orbit, run.settles.period, run.settles.force_rms) == (False, None, np.inf)
    assert any("equilibrium is driven away without bound" in text for text in run.warnings)
    with pytest.raises(po.IntegrationError, match="drives the share away without bound"):
        po.simulate(scene_of(**given), run.duration)


def test_an_undamped_share_never_settles(r1_scene):
    run = po.simulate(r1_scene(strength_wave=SHORT_WAVE, inertial_drag=False, orbit="periodic"))
    assert run.settles.orbit is None
    (warning,) = [text for text in run.warnings if "equilibrium" in text]
    assert "has not settled after 64 wavelengths" in warning
    assert "nothing damps a deviation from the orbit" in warning


# --- periodic orbits of many designs at once against single orbits ---

# A common period of 0.6 m.
TWO = (po.StrengthWave(0.2, 0.6), po.StrengthWave(0.3, 0.2, 1.0))
# Name -> effects of a scene with such a damping and such a strength wave, if it has them.
KINDS = {
    "damped": lambda damping, wave: {"damping": damping, "strength_wave": wave},
    "undamped": lambda _, wave: {"strength_wave": wave},
    "rate term": lambda damping, wave: {"damping": damping, "strength_wave": wave, "rate_term": 0.03},
    "conservative": lambda _, wave: {"strength_wave": wave, "inertial_drag": False, "added_mass": False},
    "two waves": lambda damping, _: {"damping": damping, "strength_wave": TWO},
    "light": lambda damping, wave: {"damping": damping, "strength_wave": wave, "ambient_pressure": False},
}
PER_KIND = 40
# Blocks of designs of each kind: the first in every test run, the others in slow ones.
BLOCKS = [pytest.param(k, marks=pytest.mark.slow if k else ()) for k in range(0, PER_KIND, 8)]
LOW = np.array([0.17, 0.15, 3.5, 20.0, 1.0, 50.0, 0.0, 0.2])
HIGH = np.array([0.6, 0.40, 6.0, 60.0, 4.0, 600.0, 1.0, 1.0])


def built(kind, x):
    """Return the scene of a kind at the quantities of `LOW`: numbers, or symbols."""
    share = po.Wedge(x[0], po.deg(15.0), x[1])
    effects = KINDS[kind](x[5], po.StrengthWave(x[6], x[7]))
    return scene_of(R1_SOIL, share, x[2], x[3], x[4], orbit="periodic", **effects)


@pytest.fixture(scope="module")
def designs():
    """Return the 240 designs: a row of `LOW`'s quantities for each, by kind."""
    rows = np.random.default_rng(31).uniform(LOW, HIGH, (len(KINDS), PER_KIND, len(LOW)))
    rows[..., 2] = 10.0 ** rows[..., 2]
    return dict(zip(KINDS, rows, strict=True))


@pytest.fixture(scope="module")
def batch_of():
    """Return the function from a kind to its batch to an error, compiled once."""

    @functools.cache
    def batch_of(kind, error=1e-9):
        x = [ca.MX.sym(f"x{k}") for k in range(len(LOW))]
        return po.Batch(built(kind, x), None, x, error=error)

    return batch_of


def single(kind, row):
    """Return the run of a single orbit, or the message of its error."""
    try:
        return po.simulate(built(kind, row.tolist()), accuracy=po.Accuracy(error=1e-11), outputs=64)
    except po.IntegrationError as error:
        return str(error)


@pytest.mark.parametrize("block", BLOCKS)
@pytest.mark.parametrize("kind", KINDS)
def test_a_batch_finds_single_orbits_with_honest_errors(designs, batch_of, kind, block):
    rows = designs[kind][block : block + 8]
    found = batch_of(kind)(rows)
    both = (found, batch_of(kind, 1e-5)(rows)) if kind == "damped" else (found,)
    lost: list[int] = []
    for k, row in enumerate(rows):
        run = single(kind, row)
        if isinstance(run, str):
            assert found.reasons[k] == run
            continue
        if k in found.reasons:
            assert "no periodic orbit" in found.reasons[k]
            lost.append(k)
            continue
        size = max(abs(run.mean_draft), run.force_rms)
        for result in both:
            error = max(abs(result.mean_draft[k] - run.mean_draft), abs(result.force_rms[k] - run.force_rms)) / size
            assert error <= result.error_estimate[k] + 1e-10
            assert result.error_estimate[k] <= result.wanted
            assert result.mean_deflection[k] == pytest.approx(run.mean_deflection, rel=2 * result.wanted)
            assert result.displacement_rms[k] == pytest.approx(run.displacement_rms, abs=result.wanted * size / row[2])
            assert result.tow_power[k] == pytest.approx(run.tow_power, rel=result.wanted)
        assert found.largest_multiplier[k] == pytest.approx(max(map(abs, run.floquet)), rel=1e-4)
        assert found.unstable[k] == any("unstable" in warning for warning in run.warnings)
    # Far from the linear response Newton's steps may lead anywhere: a batch misses the orbit of one of all designs.
    assert lost == ([2] if (kind, block) == ("undamped", 8) else [])
    assert any("unstable" in warning for warning in found.warnings) == found.unstable.any()
    assert any("equilibrium" in warning for warning in found.warnings)
    assert found.to_dataframe()["largest_multiplier"].tolist() == pytest.approx(
        found.largest_multiplier.tolist(), nan_ok=True
    )


def test_orbits_that_a_batch_refuses(r1_scene):
    damping, wave = ca.MX.sym("damping"), po.StrengthWave(0.3, 0.6)

    def batch(duration=None, **effects):
        return po.Batch(r1_scene(damping=damping, strength_wave=wave, **effects), duration, [damping])

    for call, match in (
        (lambda: batch(orbit="periodic", own=(Shank(per_metre=10.0),)), "own resistances repeat"),
        (lambda: batch(1.0, orbit="periodic"), "one wavelength"),
        (lambda: batch(), "duration is missing"),
    ):
        with pytest.raises(po.InputError, match=match):
            call()
