"""Strength that varies along the path: records and their spectra, and stationary motion under them."""

import itertools
import math
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from helpers.differences import differences
from helpers.refusals import refusals
from helpers.scenes import Shank
from scipy import stats
from scipy.integrate import quad
from scipy.linalg import expm, solve_continuous_lyapunov

import plough_opt as po
from plough_opt.motion.equation import Structure, parameters
from plough_opt.soil.strength import rare_peak

# --- records: their spectra, and what is refused ---

HEADINGS = "position [m], cone_index [kPa]"


def record(seed, even=True):
    """Return a record of 40 m of white noise with a standard deviation of 15 %."""
    rng = np.random.default_rng(seed)
    x = np.arange(0.0, 40.0, 0.05) if even else np.sort(rng.uniform(0.0, 40.0, 800))
    return po.StrengthRecord(x, 1.5e6 * (1.0 + 0.15 * rng.standard_normal(len(x))))


@pytest.mark.parametrize("even", [True, False])
def test_the_spectrum_integrates_to_the_variance(even):
    """By Parseval's theorem; windows and uneven spacing cause deviations of a few per cent."""
    made = record(1, even)
    spectrum = po.strength_spectrum(made)
    assert spectrum.variance == pytest.approx(np.var(made.relative()), rel=0.05)
    if not even:
        assert spectrum.wave_number[:2] == pytest.approx(2 * math.pi / 40.0 * np.array([1, 2]), rel=0.01)
    assert np.all((spectrum.lower < spectrum.density) & (spectrum.density < spectrum.upper))
    # Eight segments that overlap by half under a Hann window: Percival, Walden (1993), section 6.17.
    freedom = 36.0 * 8.0**2 / (19.0 * 8.0 - 1.0) if even else 2.0
    assert spectrum.upper / spectrum.density == pytest.approx(freedom / stats.chi2.ppf(0.025, freedom), 1e-12)
    # The density of white noise is constant and lies inside 95 % of the bands.
    inside = []
    for seed in range(40 if even else 4):
        noise = record(seed, even)
        own, level = po.strength_spectrum(noise), float(np.var(noise.relative())) / (math.pi / 0.05)
        inside.append(np.mean((own.lower < level) & (level < own.upper)))
    # By chance it deviates by 0.01, three standard deviations; the rest is the approximation of the bands.
    assert np.mean(inside) == pytest.approx(0.95, abs=0.02)


WRONG_RECORDS = [
    ("", "there are no readings"),
    ("position [m], force [kN]\n1, 2\n", "column 'force .kN.': this column is unknown"),
    ("position [m], cone_index [kPa]\n1, 2\n\n3, 3\n3, 4\n", "line 5: position must increase, but 3 follows 3"),
    pytest.param(f"{HEADINGS}\n" + "1, 2\n" * 2_000_000, "at most 10 MB can be read", id="huge"),
    ("time [s], cone_index [kPa]\n1, 2\n", "need the tow speed"),
]


@pytest.mark.parametrize(("text", "words"), WRONG_RECORDS)
def test_errors_give_file_and_line(text, words, tmp_path):
    (tmp_path / "record.csv").write_text(text, encoding="utf-8")
    with pytest.raises(po.InputError, match=words):
        po.read_strength_record(tmp_path / "record.csv")


def correlated(x, length, seed):
    """Return noise of unit variance with an exponential correlation, exact from point to point."""
    decay, noise = np.exp(-np.diff(x) / length), np.random.default_rng(seed).standard_normal(len(x))
    for k in range(1, len(x)):
        noise[k] = decay[k - 1] * noise[k - 1] + math.sqrt(1.0 - decay[k - 1] ** 2) * noise[k]
    return noise


# --- random strength: the stationary RMS against integrals, orbits and simulations of independent code ---


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


STATIONARY = [
    {"damping": 30.0, "rate_term": 0.05},
    {"damping": 2e4, "inertial_drag": False},
    {"rate_term": 0.02},
    {"speed_term": 0.3},
    {"damping": 30.0, "rate_term": 0.05, "speed_term": 0.2},
]


@pytest.mark.parametrize(
    "effects",
    STATIONARY,
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


def test_slight_waves_have_the_rms_of_their_orbit():
    effects = {"damping": 50.0, "rate_term": 0.03, "speed_term": 0.1}
    waves = tuple(po.StrengthWave(2e-5 + 1e-5 * k, 1.2 / (k + 1), 0.7 * k) for k in range(3))
    own = scene(None, strength_wave=waves, **effects)
    orbit = po.simulate(replace(own, effects=replace(own.effects, orbit="periodic")))
    # The orbit's motion is linear but for the square of the amplitudes.
    assert own.stationary_force_rms == pytest.approx(orbit.force_rms, rel=1e-4)
    assert own.stationary_displacement_rms == pytest.approx(orbit.displacement_rms, rel=1e-4)
    both = scene(RANDOM, strength_wave=waves, **effects)
    apart = scene(RANDOM, **effects).stationary_force_rms, own.stationary_force_rms
    assert both.stationary_force_rms == pytest.approx(math.hypot(*apart), rel=1e-14)


@pytest.mark.parametrize("width", [0.5, 2.5])
def test_a_smooth_contact_is_linearised_too(width):
    """Force and damping follow from differences of the equation's resistance."""
    own = scene(contact=po.Smooth(width), rate_term=0.02, damping=50.0)
    structure, p = Structure.of(own), parameters(own)
    ahead, behind = (structure.resistance(p, 0.0, own.tow_speed + dv) for dv in (1e-5, -1e-5))
    stronger = structure.resistance(p | {"static": 1.001 * p["static"]}, 0.0, own.tow_speed)
    force = (stronger - structure.resistance(p, 0.0, own.tow_speed)) / 1e-3
    d = 50.0 + (ahead - behind) / 2e-5
    plain = replace(own, effects=po.Effects(random_strength=RANDOM, damping=d, inertial_drag=False))
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


def test_the_spectrum_of_a_record_gives_the_response_to_what_was_recorded():
    path = np.arange(0.0, 400.0, 0.04)
    drawn = correlated(path, 0.3, seed=2)
    record = po.StrengthRecord(path, 1.5e6 * (1.0 + 0.15 * drawn))
    found = scene(po.strength_spectrum(record)).stationary_force_rms
    # Eight segments, and a resonance as wide as a dozen of their wave numbers, leave a few per cent.
    assert found == pytest.approx(scene(po.RandomStrength(0.15, 0.3)).stationary_force_rms, rel=0.06)
    short = po.strength_spectrum(record, base_diameter=0.5)
    assert short.wave_number[-1] <= 4.0 * math.pi < po.strength_spectrum(record).wave_number[-1]
    with pytest.raises(po.InputError, match="no waves longer than 300 m"):
        po.strength_spectrum(record, base_diameter=300.0)


STEADY = replace(scene(), effects=po.Effects(motion=False), medium="elastic")
test_scenes_without_a_stationary_response_are_refused = refusals(
    po.InputError,
    (lambda: scene(damping=0.0, inertial_drag=False), "needs some damping"),
    (lambda: scene(own=(Shank(static=30.0),)), "cannot include own resistances"),
    (lambda: scene(formulation="printed"), "needs a spring that holds the share"),
    (lambda: scene(strength_wave=(po.StrengthWave(0.1, 0.4),) * 2), "waves of different lengths"),
    (lambda: replace(scene(motion=False), medium="elastic"), "no meaning in the elastic medium"),
    (lambda: STEADY.stationary_force_rms, r"elastic medium.*: use medium = 'plastic'$"),
)
test_invalid_spectra_are_refused = refusals(
    po.InputError,
    (lambda: po.Spectrum([2.0, 1.0], [1.0, 1.0]), "must increase"),
    (lambda: po.Spectrum([1.0, 2.0], [1.0, -1.0]), "at least 0"),
    (lambda: po.Spectrum([1.0, math.nan], [1.0, 1.0]), "finite"),
)


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
