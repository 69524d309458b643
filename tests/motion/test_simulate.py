"""What `simulate` finds, against answers from elsewhere."""

import itertools
import math

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import plough_opt as po

WAVE = po.StrengthWave(amplitude=0.3, wavelength=0.6)
FINE = po.Accuracy("dop853", steps=3200)
AVERAGES = ("mean_draft", "force_rms", "mean_deflection", "displacement_rms", "tow_power")
ARRAYS = ("time", "travel", "speed", "deflection", "mount_force", "soil_resistance")


def close_to(expected, allowed):
    """Equal to a fraction of the largest value."""
    return pytest.approx(expected, rel=0, abs=allowed * np.max(np.abs(expected)))


# --- published numbers of problem R1 ---

R1 = [
    # wedge angle deg, height m, stiffness N/m, mean N, RMS N
    (25.0, 0.25, 5e4, 531.047098354, 145.439117595),
    (25.0, 0.25, 6e3, 525.384371406, 209.467549465),
    (25.0, 0.25, 4e5, 530.442387539, 113.154184492),
    (10.0, 0.40, 1e4, 530.957907066, 921.978274273),
    (40.0, 0.15, 5e3, 405.636319546, 107.584572626),
]


@pytest.mark.parametrize(("angle", "height", "stiffness", "mean", "rms"), R1)
def test_reference_values_to_every_digit(r1_scene, angle, height, stiffness, mean, rms):
    scene = r1_scene(angle, height, stiffness, strength_wave=WAVE)
    for accuracy in (FINE, po.Accuracy(error=1e-12)):
        run = po.simulate(scene, 2.0, accuracy=accuracy)
        # Half a unit of the last digit given, and rounding.
        assert run.mean_draft == pytest.approx(mean, rel=0, abs=0.51e-9)
        assert run.force_rms == pytest.approx(rms, rel=0, abs=0.51e-9)


@pytest.mark.parametrize(("angle", "height", "stiffness", "mean", "rms"), R1)
def test_default_accuracy_keeps_its_promise_there(r1_scene, angle, height, stiffness, mean, rms):
    run = po.simulate(r1_scene(angle, height, stiffness, strength_wave=WAVE), 2.0)
    size = max(mean, rms)
    assert run.error_estimate <= 1e-8
    assert run.mean_draft == pytest.approx(mean, rel=0, abs=1e-8 * size)
    assert run.force_rms == pytest.approx(rms, rel=0, abs=1e-8 * size)


# --- an independent solver, written in the travel L ---

SMOOTHSTEP = np.polynomial.Polynomial([0, 0, 0, 10, -15, 6])


def strut(scene, time):
    """Return path and speed of the strut."""
    v, ramp = scene.tow_speed, scene.effects.tow_ramp
    if ramp is None:
        return v * time, v
    u = min(time / ramp, 1.0)
    return v * ramp * SMOOTHSTEP.integ()(u) + v * max(time - ramp, 0.0), v * SMOOTHSTEP(u)


def soil_force(scene, travel, speed):
    """Return the resistance of equation (27), which leaves out the added mass."""
    e, reaction = scene.effects, scene.reaction
    wave = e.strength_wave
    force = reaction.static * (1.0 + (e.rate_term or 0.0) * speed**2)
    if wave is not None:
        force = force * (1.0 + wave.amplitude * np.sin(2 * np.pi * travel / wave.wavelength))
    return force + reaction.drag * speed**2


def mount_force(scene, time, travel, speed):
    path, tow = strut(scene, time)
    return scene.stiffness * (path - travel) + (scene.effects.damping or 0.0) * (tow - speed)


def solve_in_travel(scene, duration, outputs):
    """Integrate L and L' of (27) with the integrals of P, z, P s', (P - mean P)^2 and (z - mean z)^2."""
    mass = scene.mass + scene.reaction.added_mass
    speed = 0.0 if scene.effects.tow_ramp or scene.effects.start == "rest" else scene.tow_speed
    static, rate = scene.reaction.static, scene.effects.rate_term or 0.0
    steady = static * (1 + rate * speed**2) + scene.reaction.drag * speed**2
    deflection = 0.0 if scene.effects.start == "rest" else steady / scene.stiffness
    times = np.linspace(0.0, duration, outputs + 1)
    breaks = [0.0, *([scene.effects.tow_ramp] if scene.effects.tow_ramp else []), duration]

    def integrate(mean_force, mean_deflection):
        def rates(t, x):
            travel, v = x[:2]
            path, tow = strut(scene, t)
            force, z = mount_force(scene, t, travel, v), path - travel
            squares = (force - mean_force) ** 2, (z - mean_deflection) ** 2
            return [v, (force - soil_force(scene, travel, v)) / mass, force, z, force * tow, *squares]

        state, columns = np.array([-deflection, speed, 0.0, 0.0, 0.0, 0.0, 0.0]), []
        for start, end in itertools.pairwise(breaks):
            # Every output is the end of a step, for SciPy's dense output is of lower order.
            stops = [start, *times[(times > start) & (times < end)], end]
            for a, b in itertools.pairwise(stops):
                if a in times:
                    columns.append(state)
                state = solve_ivp(rates, (a, b), state, method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
        return np.array([*columns, state]).T

    _, _, *sums = integrate(0.0, 0.0)[:, -1] / duration
    mean_force, mean_deflection, power = sums[:3]
    states = integrate(mean_force, mean_deflection)
    travel, v = states[:2]
    force = np.array([mount_force(scene, t, *x) for t, x in zip(times, states[:2].T, strict=True)])
    resistance = soil_force(scene, travel, v)
    return {
        "time": times,
        "travel": travel,
        "speed": v,
        "deflection": np.array([strut(scene, t)[0] for t in times]) - travel,
        "mount_force": force,
        # What stops the share is the resistance with the added mass: m L'' = P - F.
        "soil_resistance": force - scene.mass * (force - resistance) / mass,
        "mean_draft": mean_force,
        "force_rms": math.sqrt(states[5, -1] / duration),
        "mean_deflection": mean_deflection,
        "displacement_rms": math.sqrt(states[6, -1] / duration),
        "tow_power": power,
    }


def assert_agrees(run, expected, allowed):
    for name, truth in expected.items():
        # Where nothing oscillates the RMS is rounding: it is a fraction of the mean that counts.
        size = expected.get({"force_rms": "mean_draft", "displacement_rms": "mean_deflection"}.get(name), truth)
        assert getattr(run, name) == pytest.approx(truth, rel=0, abs=allowed * np.max(np.abs(size))), name


def test_an_independent_solver_agrees(r1_scene, effects):
    scene = r1_scene(**effects)
    expected = solve_in_travel(scene, 0.6, outputs=6)
    # The travel of the reference is exact to about 1e-13 m, of a deflection of some 1e-2 m.
    assert_agrees(po.simulate(scene, 0.6, accuracy=FINE, outputs=6), expected, 1e-10)
    assert_agrees(po.simulate(scene, 0.6, outputs=6), expected, 1e-8)


@pytest.mark.parametrize(
    ("soil", "share", "speed", "duration"),
    [("hardpan", (15.0, 0.35, 2e4), 1.2, 0.9), ("heavy clay", (35.0, 0.15, 3e5), 2.8, 0.7)],
)
def test_an_independent_solver_agrees_on_other_soils(r1_scene, soil, share, speed, duration):
    scene = r1_scene(
        *share,
        tow_speed=speed,
        soil=po.named_soil(soil),
        strength_wave=po.StrengthWave(0.8, 0.25),
        rate_term=0.1,
        damping=600.0,
        tow_ramp=0.31,
    )
    assert_agrees(po.simulate(scene, duration, accuracy=FINE, outputs=7), solve_in_travel(scene, duration, 7), 1e-10)


# --- exact solutions ---


def sum_of_exponentials(amplitudes, exponents, duration):
    """Return mean and RMS over the duration of the real part of sum a exp(lambda t), in closed form."""

    def average(exponent):
        return np.expm1(exponent * duration) / (exponent * duration) if abs(exponent) > 0 else 1.0

    terms = list(zip(amplitudes, exponents, strict=True))
    mean = sum((a * average(x)).real for a, x in terms)
    square = sum(
        (a * b * average(x + y) + a * np.conj(b) * average(x + np.conj(y))).real / 2 for a, x in terms for b, y in terms
    )
    return mean, math.sqrt(square - mean**2)


@pytest.mark.parametrize("damping", [None, 0.0, 250.0, 900.0])
def test_linear_oscillation_from_rest(r1_scene, damping):
    scene = r1_scene(inertial_drag=False, start="rest", damping=damping)
    duration = 1.0
    run = po.simulate(scene, duration, accuracy=FINE, outputs=50)
    # z = z_s + exp(-d t) (-z_s cos(w t) + (V0 - d z_s)/w sin(w t)), as the real part of a exp(x t).
    k, c, z_s = scene.stiffness, damping or 0.0, scene.reaction.static / scene.stiffness
    d = c / (2 * scene.inertia)
    w = math.sqrt(k / scene.inertia - d**2)
    a, x = -z_s - 1j * (scene.tow_speed - d * z_s) / w, -d + 1j * w
    wave = np.exp(x * run.time)
    rate = (a * x * wave).real
    mean_z, rms_z = sum_of_exponentials([a], [x], duration)
    mean_p, rms_p = sum_of_exponentials([a * (k + c * x)], [x], duration)
    # 3200 steps of order 8 over seven oscillations leave rounding only.
    assert run.deflection == close_to(z_s + (a * wave).real, 1e-12)
    assert run.speed == close_to(scene.tow_speed - rate, 1e-12)
    assert run.travel == close_to(scene.tow_speed * run.time - z_s - (a * wave).real, 1e-12)
    assert run.mount_force == close_to(k * (z_s + (a * wave).real) + c * rate, 1e-12)
    assert run.mean_deflection == pytest.approx(z_s + mean_z, rel=1e-12)
    assert run.displacement_rms == pytest.approx(rms_z, rel=1e-12)
    assert run.mean_draft == pytest.approx(scene.reaction.static + mean_p, rel=1e-12)
    assert run.force_rms == pytest.approx(rms_p, rel=1e-12)
    assert run.tow_power == pytest.approx(run.mean_draft * scene.tow_speed, rel=1e-12)


@pytest.mark.parametrize("accuracy", [None, FINE, po.Accuracy("cvodes"), po.Accuracy("rosenbrock")])
@pytest.mark.parametrize("effects", [{}, {"rate_term": 0.05}, {"damping": 250.0}, {"inertial_drag": False}])
def test_a_steady_start_stays_steady_exactly(r1_scene, effects, accuracy):
    scene = r1_scene(**effects)
    run = po.simulate(scene, 2.0, accuracy=accuracy, outputs=40)
    steady = scene.steady_resistance
    assert run.force_rms == run.displacement_rms == 0.0
    assert np.ptp(run.deflection) == np.ptp(run.mount_force) == np.ptp(run.speed) == 0.0
    assert run.mean_draft == pytest.approx(steady, rel=1e-15)
    assert run.mean_deflection == pytest.approx(steady / scene.stiffness, rel=1e-15)
    assert run.error_estimate == 0.0
    assert run.peak_force == run.mount_force[0]


def test_the_smallest_oscillation_keeps_its_digits(r1_scene):
    amplitude, duration = 1e-9, 1.3
    scene = r1_scene(strength_wave=po.StrengthWave(amplitude, 0.6))
    run = po.simulate(scene, duration, accuracy=FINE)
    # To first order in the amplitude M w'' + 2 Fd V0 w' + k0 w = eps F0 sin(2 pi (V0 t - z_s)/ell).
    reaction, k, inertia, v = scene.reaction, scene.stiffness, scene.inertia, scene.tow_speed
    c, omega = 2 * reaction.drag * v, 2 * math.pi * v / 0.6
    z_s = scene.steady_resistance / k
    forced = -1j * amplitude * reaction.static * np.exp(-2j * math.pi * z_s / 0.6)
    forced /= k - inertia * omega**2 + 1j * c * omega
    d = c / (2 * inertia)
    own = math.sqrt(k / inertia - d**2)
    w0, rate0 = -forced.real, -(forced * 1j * omega).real
    free = w0 - 1j * (rate0 + d * w0) / own
    mean, rms = sum_of_exponentials([forced, free], [1j * omega, -d + 1j * own], duration)
    # The next order in the amplitude is 1e-9 of this one; force_rms is 1e-10 of the mean draft.
    assert run.force_rms < 1e-9 * run.mean_draft
    assert run.force_rms == pytest.approx(k * rms, rel=1e-8)
    assert run.displacement_rms == pytest.approx(rms, rel=1e-8)
    assert run.mean_draft - scene.steady_resistance == pytest.approx(k * mean, abs=1e-15 * run.mean_draft)


# --- the error estimate ---


def sampled_scenes(count):
    """Yield keywords of scenes and durations, spread over what a user may ask."""
    random = np.random.default_rng(20260)
    for _ in range(count):
        start = str(random.choice(["rest", "equilibrium"]))
        keywords = {
            "wedge_angle_deg": random.uniform(5.0, 60.0),
            "height": random.uniform(0.1, 0.5),
            "stiffness": 10 ** random.uniform(3.7, 5.7),
            "tow_speed": random.uniform(0.5, 3.0),
            "strength_wave": po.StrengthWave(random.uniform(0.1, 1.0), random.uniform(0.15, 1.0)),
            "inertial_drag": random.random() < 0.8,
            # A share that starts at rest may be driven back, and then a rate term without bound.
            "rate_term": random.choice([None, 0.05]) if start == "equilibrium" else None,
            "damping": random.choice([None, 300.0]),
            "tow_ramp": random.choice([None, random.uniform(0.05, 0.8)]),
            "start": start,
        }
        yield keywords, random.uniform(0.3, 3.0)


@pytest.mark.parametrize(("keywords", "duration"), list(sampled_scenes(30)))
def test_error_estimate_is_honest(r1_scene, keywords, duration):
    scene = r1_scene(**keywords)
    run = po.simulate(scene, duration, outputs=50)
    # At most some 400 rad of oscillation: steps of 0.1 rad leave rounding only.
    truth = po.simulate(scene, duration, accuracy=po.Accuracy("dop853", steps=4000), outputs=50)
    size = max(abs(truth.mean_draft), truth.force_rms)
    error = max(
        abs(run.mean_draft - truth.mean_draft) / size,
        abs(run.force_rms - truth.force_rms) / size,
        np.max(np.abs(run.mount_force - truth.mount_force)) / np.max(np.abs(truth.mount_force)),
    )
    assert error <= max(5.0 * run.error_estimate, 1e-11)
    assert run.error_estimate <= 1e-8


@pytest.mark.parametrize("wanted", [1e-3, 1e-6, 1e-10, 1e-12])
def test_a_wanted_error_is_met(r1_scene, wanted):
    scene = r1_scene(strength_wave=WAVE, damping=250.0, tow_ramp=0.3)
    run = po.simulate(scene, 2.0, accuracy=po.Accuracy(error=wanted))
    truth = po.simulate(scene, 2.0, accuracy=FINE)
    assert run.error_estimate <= wanted
    assert run.mean_draft == pytest.approx(truth.mean_draft, rel=2 * wanted)
    assert run.force_rms == pytest.approx(truth.force_rms, rel=0, abs=2 * wanted * truth.mean_draft)


@pytest.mark.slow
def test_a_missed_error_is_told(r1_scene):
    # A mount so stiff oscillates a hundred thousand times in a second: following that to 1e-8 would take minutes.
    run = po.simulate(r1_scene(stiffness=1e13, strength_wave=WAVE), 2.0)
    quasi = po.simulate(r1_scene(stiffness=1e13, strength_wave=WAVE, motion=False), 2.0)
    assert any("was not reached" in warning for warning in run.warnings)
    assert abs(run.mean_draft / quasi.mean_draft - 1) < run.error_estimate


# --- numbers and symbols ---

STEPS = po.Accuracy("dop853", steps=60)


def strengths(effects):
    """Return effects whose numbers may be scaled by a symbol each, the names and the way to build them."""
    names = [name for name in ("rate_term", "damping") if effects[name] is not None]
    if effects["strength_wave"] is not None:
        names += ["amplitude", "wavelength"]

    def build(factors):
        scaled = dict(effects)
        for name in ("rate_term", "damping"):
            if name in factors:
                scaled[name] = effects[name] * factors[name]
        if "amplitude" in factors:
            wave = effects["strength_wave"]
            scaled["strength_wave"] = po.StrengthWave(
                wave.amplitude * factors["amplitude"], wave.wavelength * factors["wavelength"]
            )
        return scaled

    return names, build


def symbolic_run(r1_scene, effects, kind, factors):
    """Return the symbols and the run of a scene in which every number but the ramp's time is a factor away."""
    names, build = strengths(effects)
    x = kind.sym("x", 4 + len(names))
    angle, height, stiffness, speed, *rest = ca.vertsplit(x)
    scaled = build(dict(zip(names, rest, strict=True)))
    scene = r1_scene(25.0 * angle, 0.25 * height, 5e4 * stiffness, tow_speed=2.0 * speed, **scaled)
    assert len(factors) >= x.numel()
    return x, po.simulate(scene, 0.5, accuracy=STEPS, outputs=10)


FACTORS = np.array([1.1, 0.9, 1.2, 0.95, 1.05, 0.9, 1.15, 1.1])


@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
def test_numbers_and_symbols_run_alike(r1_scene, effects, kind):
    x, symbolic = symbolic_run(r1_scene, effects, kind, FACTORS)
    names, build = strengths(effects)
    factors = FACTORS[: x.numel()]
    scaled = build(dict(zip(names, factors[4:], strict=True)))
    scene = r1_scene(25.0 * 1.1, 0.25 * 0.9, 5e4 * 1.2, tow_speed=2.0 * 0.95, **scaled)
    numeric = po.simulate(scene, 0.5, accuracy=STEPS, outputs=10)
    compared = (*ARRAYS, *AVERAGES, "specific_draft")
    of_x = ca.Function("run", [x], [getattr(symbolic, name) for name in compared])
    values = dict(zip(compared, of_x.call([ca.DM(factors)]), strict=True))
    for name in compared:
        expected = getattr(numeric, name)
        size = numeric.mean_draft if name == "force_rms" else np.max(np.abs(expected))
        size = numeric.mean_deflection if name == "displacement_rms" else size
        # The same operations in another order; a symbolic RMS is rounded off by 1e-12 of the steady force.
        assert values[name].full().ravel() == pytest.approx(expected, rel=0, abs=5e-12 * size), name


@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
def test_duration_and_ramp_may_be_symbols(r1_scene, kind):
    x = kind.sym("x", 2)
    accuracy = po.Accuracy("dop853", steps=1000)
    symbolic = po.simulate(r1_scene(strength_wave=WAVE, tow_ramp=x[0]), x[1], accuracy=accuracy, outputs=5)
    of_x = ca.Function("run", [x], [symbolic.mean_draft, symbolic.force_rms, symbolic.time[-1]])
    mean, rms, end = map(float, of_x.call([ca.DM([0.3, 0.8])]))
    numeric = po.simulate(r1_scene(strength_wave=WAVE, tow_ramp=0.3), 0.8, accuracy=accuracy, outputs=5)
    # No step ends at a ramp whose end is a symbol: there the method is of order 3, with steps of 0.8 ms.
    assert mean == pytest.approx(numeric.mean_draft, rel=1e-9)
    assert rms == pytest.approx(numeric.force_rms, rel=1e-8)
    assert end == pytest.approx(0.8, rel=1e-15)


def slopes_by_differences(function, x, step):
    """Return the Jacobian by central differences of order 6."""
    columns = []
    for direction in np.eye(len(x)):
        values = [function(ca.DM(x + i * step * direction)).full().ravel() for i in (-3, -2, -1, 1, 2, 3)]
        columns.append(np.array([-1, 9, -45, 45, -9, 1]) @ np.array(values) / (60 * step))
    return np.array(columns).T


def test_derivatives_equal_high_order_differences(r1_scene, effects):
    x, run = symbolic_run(r1_scene, effects, ca.MX, FACTORS)
    # Both as fractions of the mean draft, by relative changes of the variables: all of order one.
    size = float(ca.Function("size", [x], [run.mean_draft])(FACTORS[: x.numel()]))
    values = ca.vertcat(run.mean_draft, run.force_rms) / size
    gradient = ca.jacobian(values, x)
    hessian = ca.jacobian(ca.vec(gradient), x)
    at = FACTORS[: x.numel()]
    f, g = ca.Function("f", [x], [values]), ca.Function("g", [x], [ca.vec(gradient)])
    slopes, curvatures = g(at).full().reshape(2, -1, order="F"), ca.Function("h", [x], [hessian])(at).full()
    step = 2e-3
    # Truncation (20 step)^6/140 for a phase of 20 rad, rounding 1e-15/step; slopes reach 10, curvatures 100.
    assert slopes == close_to(slopes_by_differences(f, at, step), 1e-9)
    assert curvatures == close_to(slopes_by_differences(g, at, step), 1e-9)


def test_constant_expressions_are_numbers(r1_scene):
    plain = po.simulate(r1_scene(stiffness=5e4, strength_wave=WAVE), 1.0)
    wrapped = po.simulate(r1_scene(stiffness=ca.MX(5e4), strength_wave=WAVE), ca.DM(1.0))
    assert wrapped.mean_draft == plain.mean_draft
    assert wrapped.error_estimate == plain.error_estimate
    assert isinstance(wrapped.mount_force, np.ndarray)


def test_a_symbolic_run_says_what_it_cannot_have(r1_scene):
    run = po.simulate(r1_scene(stiffness=ca.MX.sym("stiffness"), strength_wave=WAVE), 1.0, outputs=5)
    for name, what in (("error_estimate", "error estimate"), ("seconds", "time taken")):
        with pytest.raises(po.InputError, match=f"no {what}: simulate the scene with numbers"):
            getattr(run, name)
    for name, array in (("peak_force", "mount_force"), ("peak_deflection", "deflection")):
        with pytest.raises(po.InputError, match=f"no {name}.*limit run.{array} itself"):
            getattr(run, name)
    assert "cannot be checked" in run.warnings[0]


# --- what a run carries ---


def test_a_run_of_numbers_carries_floats_and_arrays(r1_scene):
    run = po.simulate(r1_scene(strength_wave=WAVE), 2.0, outputs=25)
    for name in ARRAYS:
        assert getattr(run, name).shape == (26,)
        assert np.all(np.isfinite(getattr(run, name)))
    assert list(run.time) == pytest.approx(np.linspace(0.0, 2.0, 26), rel=1e-15)
    assert run.seconds > 0.0
    assert run.peak_force == max(run.mount_force)
    assert run.peak_deflection == max(run.deflection)
    radius = po.loosened_radius(run.scene.cone, run.scene.soil)
    assert run.specific_draft == pytest.approx(run.mean_draft / (math.pi * radius**2), rel=1e-15)


def test_outputs_do_not_change_what_is_averaged(r1_scene):
    scene = r1_scene(strength_wave=WAVE, damping=250.0)
    few, many = (po.simulate(scene, 1.0, accuracy=FINE, outputs=outputs) for outputs in (1, 400))
    assert len(few.time) == 2
    for name in AVERAGES:
        assert getattr(few, name) == pytest.approx(getattr(many, name), rel=1e-12), name
    assert few.mount_force[-1] == pytest.approx(many.mount_force[-1], rel=1e-11)


# --- warnings and refusals ---


def test_a_share_that_is_driven_back_carries_a_warning(r1_scene):
    run = po.simulate(r1_scene(10.0, 0.40, 1e4, strength_wave=WAVE, start="rest"), 2.0)
    (warning,) = [text for text in run.warnings if "retreats" in text]
    assert f"{-min(run.speed):.3g} m/s" in warning
    assert "real soil does not" in warning


def test_a_share_that_goes_forward_carries_none(r1_scene):
    run = po.simulate(r1_scene(strength_wave=po.StrengthWave(0.05, 0.6)), 2.0)
    assert min(run.speed) > 0.0
    assert not [text for text in run.warnings if "retreats" in text]


def test_a_share_at_rest_under_a_ramp_that_starts_steady_is_no_retreat(r1_scene):
    run = po.simulate(r1_scene(tow_ramp=0.5, damping=2000.0), 1.0)
    assert not [text for text in run.warnings if "retreats" in text]


@pytest.mark.parametrize("duration", [0.0, -1.0, math.nan, math.inf])
def test_a_duration_must_be_positive(r1_scene, duration):
    with pytest.raises(po.DomainError, match="duration = "):
        po.simulate(r1_scene(), duration)


def test_a_run_prints_as_a_line(r1_scene):
    run = po.simulate(r1_scene(strength_wave=WAVE), 2.0)
    # Mean and RMS of R1 at its start.
    text = "<Run: 2 s in 400 intervals by dop853, mean draft 531.047 N, RMS 145.439 N, error estimate "
    assert repr(run).startswith(text)
    assert float(repr(run)[len(text) : -1]) == pytest.approx(run.error_estimate, rel=0.05)


def test_a_symbolic_run_prints_as_a_line(r1_scene):
    assert repr(po.simulate(r1_scene(stiffness=ca.MX.sym("k0")), 2.0)) == "<Run: expressions of a scene's symbols>"
