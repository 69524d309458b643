"""Random strength: the stationary RMS against integrals, orbits and simulations of independent code."""

import dataclasses
import itertools
import math
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import pytest
from helpers.differences import differences
from helpers.refusals import refusals
from scipy.integrate import quad
from scipy.linalg import expm, solve_continuous_lyapunov

import plough_opt as po
from plough_opt.expressions import sin
from plough_opt.motion.equation import Structure, parameters
from plough_opt.soil.random_strength import rare_peak


@dataclass(frozen=True)
class Drawn:
    """The varying part F0 (1 + kappa L'^2) sum(eps sin(q L + phi)) of a resistance."""

    static: float
    rate: float
    size: float
    numbers: tuple[float, ...]
    phases: tuple[float, ...]

    def force(self, travel, speed):
        sines = (sin(q * travel + p) for q, p in zip(self.numbers, self.phases, strict=True))
        return self.static * (1.0 + self.rate * speed**2) * self.size * sum(sines)


def quantiles(random, parts):
    """Return the wave numbers below which the given parts of a spectrum's variance lie."""
    if isinstance(random, po.RandomStrength):
        return np.tan(parts * math.pi / 2.0) / random.correlation_length
    q, density = random.wave_number, random.density
    fine = np.linspace(q[0], q[-1], 200_001)
    below = np.cumsum(np.interp(fine, q, density))
    return np.interp(parts, below / below[-1], fine)


def realisation(scene, count, seed):
    """Return the scene with a realisation of its random strength: waves of equal variance, one from each part of it."""
    random, rng = scene.effects.random_strength, np.random.default_rng(seed)
    numbers = quantiles(random, (np.arange(count) + rng.uniform(size=count)) / count)
    size = math.sqrt(2.0 * random.variance / count)
    phases = rng.uniform(0.0, 2.0 * math.pi, count)
    rate = scene.effects.rate_term or 0.0
    drawn = Drawn(scene.reaction.static, rate, size, tuple(numbers.tolist()), tuple(phases.tolist()))
    return replace(scene, effects=replace(scene.effects, random_strength=None, own=(drawn,)))


RANDOM = po.RandomStrength(rms=0.05, correlation_length=0.3)
# A measured spectrum with an empty band and a peak.
TABLE = po.Spectrum([0.2, 1.0, 3.0, 5.0, 30.0, 31.0, 33.0, 90.0], [4e-4, 9e-4, 0.0, 0.0, 3e-5, 2e-4, 3e-5, 0.0])
DAMPED = {"damping": 600.0}


def scene(random=RANDOM, **effects):
    made = po.Effects(random_strength=random, **(effects or DAMPED))
    return po.Scene(po.named_soil("serozem"), po.Cone(po.deg(12), 0.22), 1.5e5, 45.0, 1.6, made)


def integrated(own, density, ends):
    """Return force, displacement and speed RMS by adaptive quadrature of |H|^2 S with the transfer function H."""
    reaction, v, k = own.reaction, own.tow_speed, own.stiffness
    kappa, c, linear = (getattr(own.effects, name) or 0.0 for name in ("rate_term", "damping", "speed_term"))
    static = reaction.static * (1.0 + linear * v) * (1.0 + kappa * v**2)
    slope = reaction.static * (linear * (1.0 + kappa * v**2) + 2.0 * kappa * v * (1.0 + linear * v))

    def h(q):
        w = q * v
        d = c + 2.0 * reaction.drag * v + slope
        return static / complex(k - own.inertia * w**2, w * d)

    peak = math.sqrt(k / own.inertia) / v
    near_peak = peak * np.array([0.5, 0.9, 0.99, 1.0, 1.01, 1.1, 2.0])
    places = sorted({*ends, *near_peak[(ends[0] < near_peak) & (near_peak < ends[-1])]})

    def total(of):
        def density_of(q):
            return abs(of(q)) ** 2 * density(q)

        pieces = itertools.pairwise(places)
        return math.sqrt(math.fsum(quad(density_of, *ab, epsabs=0.0, epsrel=1e-12, limit=500)[0] for ab in pieces))

    return total(lambda q: complex(k, q * v * c) * h(q)), total(h), total(lambda q: q * v * h(q))


@pytest.mark.parametrize(
    "effects",
    [
        {"damping": 30.0, "rate_term": 0.05},
        {"damping": 2e4, "inertial_drag": False},
        {"rate_term": 0.02},
        {"speed_term": 0.3},
        {"damping": 30.0, "rate_term": 0.05, "speed_term": 0.2},
    ],
    ids=["damped", "overdamped", "by the soil alone", "by its growth with speed", "by everything"],
)
@pytest.mark.parametrize("length", [0.01, 20.0])
def test_the_closed_form_is_the_integral(effects, length):
    own = scene(po.RandomStrength(0.05, length), **effects)
    # Beyond the last end |H|^2 S falls as q^-6, and with k0 + i w c as q^-4: 1e-10 of the integral is omitted.
    ends = [0.0, 0.01, 0.1, 1.0, 10.0, 100.0, 1e3, 1e4, 1e5]
    force, place, speed = integrated(own, own.effects.random_strength.density, ends)
    found = own.stationary_force_rms, own.stationary_displacement_rms, own._stationary.speed_rms
    assert found == pytest.approx((force, place, speed), rel=1e-8)


@pytest.mark.parametrize(("damping", "near"), [(600.0, 1e-11), (5.0, 2e-4)])
def test_a_table_is_integrated_through_its_resonance(damping, near):
    """Down to 1e-3 of critical damping, where the resonance is 1e-3 as wide as the panel around it."""
    own = scene(TABLE, damping=damping, inertial_drag=False)
    force, place, _ = integrated(own, lambda q: np.interp(q, TABLE.wave_number, TABLE.density), [*TABLE.wave_number])
    assert (own.stationary_force_rms, own.stationary_displacement_rms) == pytest.approx((force, place), rel=near)


def test_waves_have_the_rms_of_their_linearised_orbit():
    effects = {"damping": 50.0, "rate_term": 0.03, "speed_term": 0.1}
    waves = tuple(po.StrengthWave(0.02 + 0.01 * k, 1.2 / (k + 1), 0.7 * k) for k in range(3))
    own = scene(None, strength_wave=waves, **effects)
    orbit = po.simulate(dataclasses.replace(own, effects=dataclasses.replace(own.effects, orbit="linearised")))
    # Two closed forms of the same response.
    assert own.stationary_force_rms == pytest.approx(orbit.force_rms, rel=1e-12)
    assert own.stationary_displacement_rms == pytest.approx(orbit.displacement_rms, rel=1e-12)
    both = scene(RANDOM, strength_wave=waves, **effects)
    apart = scene(RANDOM, **effects).stationary_force_rms, own.stationary_force_rms
    assert both.stationary_force_rms == pytest.approx(math.hypot(*apart), rel=1e-14)


def test_a_rigid_share_transmits_the_whole_fluctuation():
    own = scene(motion=False, rate_term=0.05, strength_wave=po.StrengthWave(0.3, 0.6))
    mean = own.reaction.static * (1.0 + 0.05 * own.tow_speed**2)
    assert own.stationary_force_rms == pytest.approx(math.hypot(0.05, 0.3 / math.sqrt(2.0)) * mean, rel=1e-15)
    assert own.stationary_displacement_rms == 0.0
    # A stiff, damped mount tends to that like M V/(2 d lambda).
    stiff = dataclasses.replace(scene(damping=1e7), stiffness=1e13)
    assert stiff.stationary_force_rms == pytest.approx(0.05 * stiff.reaction.static, rel=2e-5)


@pytest.mark.parametrize("width", [0.5, 2.5])
def test_a_smooth_contact_is_linearised_too(width):
    """Force and damping follow from differences of the equation's resistance."""
    own = scene(contact=po.Smooth(width), rate_term=0.02, damping=50.0)
    structure, p = Structure.of(own), parameters(own)
    ahead, behind = (structure.resistance(p, 0.0, own.tow_speed + dv) for dv in (1e-5, -1e-5))
    stronger = structure.resistance(p | {"static": 1.001 * p["static"]}, 0.0, own.tow_speed)
    force = (stronger - structure.resistance(p, 0.0, own.tow_speed)) / 1e-3
    d = 50.0 + (ahead - behind) / 2e-5
    plain = dataclasses.replace(own, effects=po.Effects(random_strength=RANDOM, damping=d, inertial_drag=False))
    expected = plain.stationary_displacement_rms * force / plain.reaction.static
    assert own.stationary_displacement_rms == pytest.approx(expected, rel=1e-8)  # error of the differences


@pytest.mark.parametrize("random", [RANDOM, TABLE], ids=["model", "table"])
@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
def test_expressions_have_the_values_of_numbers_and_exact_slopes(random, kind):
    def rms(height, stiffness, damping, speed):
        made = po.Effects(random_strength=random, damping=damping, rate_term=0.02)
        own = po.Scene(po.named_soil("serozem"), po.Cone(po.deg(12), height), stiffness, 45.0, speed, made)
        return [own.stationary_force_rms, own.stationary_displacement_rms]

    x, values = kind.sym("x", 4), np.array([0.22, 1.5e5, 600.0, 1.6])
    symbolic = ca.vertcat(*rms(*ca.vertsplit(x)))
    found, slopes = (np.array(one) for one in ca.Function("f", [x], [symbolic, ca.jacobian(symbolic, x)])(values))
    # Symbolic roots are rounded below 1e-12 of the steady force.
    assert found.ravel() == pytest.approx(rms(*values), rel=1e-10)
    wanted = differences(lambda y: np.array(rms(*(values * (1.0 + y)))), np.zeros(4))
    np.testing.assert_allclose(slopes * values, wanted, rtol=1e-9)  # the error of the differences


@pytest.mark.parametrize(("draws", "near"), [(2, 0.06), pytest.param(20, 0.02, marks=pytest.mark.slow)])
@pytest.mark.parametrize("random", [RANDOM, TABLE], ids=["model", "table"])
def test_simulated_realisations_have_the_stationary_rms(random, draws, near):
    """Sixty waves over about four hundred oscillations: a draw scatters by 3 %, the start contributes 0.5 %."""
    own = scene(po.RandomStrength(0.02, 0.3) if random is RANDOM else random)
    steps = po.Accuracy("dop853", steps=3000)
    runs = [po.simulate(realisation(own, 60, seed), 40.0, accuracy=steps) for seed in range(draws)]
    for name in ("force_rms", "displacement_rms"):
        found = np.sqrt(np.mean([getattr(run, name) ** 2 for run in runs]))
        assert found == pytest.approx(getattr(own, f"stationary_{name}"), rel=near), name


def test_the_spectrum_of_a_record_gives_the_response_to_what_was_recorded():
    drawn = realisation(scene(po.RandomStrength(0.15, 0.3)), 400, 2).effects.own[0]
    path = np.arange(0.0, 200.0, 0.04)
    record = po.StrengthRecord(path, 1.5e6 * (1.0 + drawn.force(path, 0.0) / drawn.static))
    found = scene(po.strength_spectrum(record)).stationary_force_rms
    # Eight segments, and a resonance as wide as a dozen of their wave numbers, leave a few per cent.
    assert found == pytest.approx(scene(po.RandomStrength(0.15, 0.3)).stationary_force_rms, rel=0.06)
    short = po.strength_spectrum(record, base_diameter=0.5)
    assert short.wave_number[-1] <= 4.0 * math.pi < po.strength_spectrum(record).wave_number[-1]
    with pytest.raises(po.InputError, match="no waves longer than 300 m"):
        po.strength_spectrum(record, base_diameter=300.0)


STEADY = dataclasses.replace(scene(), effects=po.Effects(motion=False), medium="elastic")
test_scenes_without_a_stationary_response_are_refused = refusals(
    po.InputError,
    (lambda: scene(damping=0.0, inertial_drag=False), "needs some damping"),
    (lambda: scene(own=realisation(scene(), 2, 0).effects.own), "cannot include own resistances"),
    (lambda: scene(formulation="printed"), "needs a spring that holds the share"),
    (lambda: dataclasses.replace(scene(), tow_speed=0.0), "needs a tow speed above 0"),
    (lambda: scene(strength_wave=(po.StrengthWave(0.1, 0.4),) * 2), "waves of different lengths"),
    (lambda: dataclasses.replace(scene(motion=False), medium="elastic"), "no meaning in the elastic medium"),
    (lambda: scene(0.2), "random_strength = 0.2 must be None, a RandomStrength"),
    (lambda: STEADY.stationary_force_rms, r"elastic medium.*: use medium = 'plastic'$"),
)
test_invalid_spectra_are_refused = refusals(
    po.InputError,
    (lambda: po.Spectrum([1.0], [1.0]), "at least two"),
    (lambda: po.Spectrum([2.0, 1.0], [1.0, 1.0]), "must increase"),
    (lambda: po.Spectrum([1.0, 2.0], [1.0, -1.0]), "at least 0"),
    (lambda: po.Spectrum([1.0, math.nan], [1.0, 1.0]), "finite"),
    (lambda: po.Spectrum("ab", "cd"), "must be numbers"),
)


def test_a_share_that_would_stop_carries_a_warning():
    calm, wild = (scene(po.RandomStrength(rms, 0.3), damping=100.0) for rms in (0.02, 0.9))
    for own in (calm, wild):
        warned = any("sometimes stops or retreats" in text for text in own.warnings())
        assert warned == (3.0 * own._stationary.speed_rms > own.tow_speed) == (own is wild)


# Damping [N s/m], correlation length [m], and the least part of all passes that exceed the peak: upcrossings of a mount
# with hardly any damping come in clusters.
PEAKS = [(600.0, 0.3, 0.035), (3000.0, 0.05, 0.035), (30.0, 1.0, 0.01)]


@pytest.mark.parametrize(("damping", "length", "least"), PEAKS)
def test_the_peak_is_exceeded_in_a_twentieth_of_simulated_passes(damping, length, least):
    """The linear motion z'' and a correlation of first order, (z, z', s), in exact steps of white noise."""
    own, passes, seconds = scene(po.RandomStrength(0.05, length), damping=damping), 2000, 5.0
    k, m, v, static = own.stiffness, float(own.inertia), own.tow_speed, own.reaction.static
    d = damping + 2.0 * own.reaction.drag * v
    rates = np.array([[0.0, 1.0, 0.0], [-k / m, -d / m, static / m], [0.0, 0.0, -v / length]])
    noise = np.diag([0.0, 0.0, 2.0 * 0.05**2 * v / length])
    covariance = solve_continuous_lyapunov(rates, -noise)
    step = 2.0 * math.pi / math.sqrt(k / m) / 30.0
    forward = expm(rates * step)
    kicks = np.linalg.cholesky(covariance - forward @ covariance @ forward.T)
    rng = np.random.default_rng(1)
    x = np.linalg.cholesky(covariance) @ rng.standard_normal((3, passes))
    observed = np.array([[k, damping, 0.0], [1.0, 0.0, 0.0]])
    largest = observed @ x
    for _ in range(round(seconds / step)):
        x = forward @ x + kicks @ rng.standard_normal(x.shape)
        largest = np.maximum(largest, observed @ x)
    found = own._stationary
    deviations, slopes = (np.sqrt(np.diag(own @ covariance @ own.T)) for own in (observed, observed @ rates))
    assert (found.force_rms, found.displacement_rms) == pytest.approx(deviations, rel=1e-12)
    assert (found.force_rate_rms, found.speed_rms) == pytest.approx(slopes, rel=1e-10)
    for peaks, deviation, rate in zip(largest, deviations, slopes, strict=True):
        exceeded = np.mean(peaks > rare_peak(deviation, rate, seconds))
        # A part of 5 % of 2000 passes has a standard error of 0.5 %.
        assert least < exceeded < 0.05 + 0.015


def test_the_peaks_of_a_pass():
    own = scene()
    found, mean = own._stationary, own.steady_resistance
    crossings = found.force_rate_rms / (2.0 * math.pi * found.force_rms) * 1000.0 / own.tow_speed
    wanted = mean + found.force_rms * math.sqrt(2.0 * math.log((0.5 + crossings) / 0.05))
    assert own.stationary_peak_force == pytest.approx(wanted, rel=1e-14)
    assert own.stationary_peak_deflection > mean / own.stiffness
    # Constant strength has no peaks, and neither does a share that follows the strut rigidly.
    assert scene(po.RandomStrength(0.0, 0.3)).stationary_peak_force == mean
    with pytest.raises(po.InputError, match="mount that moves"):
        _ = scene(motion=False).stationary_peak_force
    for random in (RANDOM, TABLE):
        x = ca.MX.sym("x")
        peak = dataclasses.replace(scene(random), stiffness=x).stationary_peak_force
        number = dataclasses.replace(scene(random), stiffness=1.7e5).stationary_peak_force
        assert float(ca.evalf(ca.substitute(peak, x, 1.7e5))) == pytest.approx(number, rel=1e-9)


def test_a_table_does_not_offer_the_peak_of_the_simulated_motion_alone():
    text = str(po.simulate(scene(), 0.2))
    assert "peak mount force without random strength" in text
    assert "mount force exceeded in 5 % of passes of 1 km" in text
    assert "exceeded" not in str(po.simulate(scene(None), 0.2))
