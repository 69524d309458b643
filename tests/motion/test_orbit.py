"""The periodic orbit under a strength wave, against SciPy's integration of equation (27)."""

import dataclasses
import math

import numpy as np
import pytest
from helpers.orbit_oracle import monodromy, orbit

import plough_opt as po
from plough_opt.core.expressions import cos, sin

OUTPUTS = 96
ORBITS = ["periodic", "linearised", po.HarmonicBalance(2)]
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
    "conservative": {"inertial_drag": False},
    "slow": {"tow_speed": 0.5, "damping": 300.0},
    "strongest": {"strength_wave": FULL},
    "strongest, soft": {"strength_wave": FULL, "stiffness": 4e3, "damping": 100.0},
    "strongest, short": {"strength_wave": po.StrengthWave(1.0, 0.2), "stiffness": 1e5, "damping": 400.0},
    "weak": {"strength_wave": po.StrengthWave(1e-5, 0.6), "damping": 100.0},
    "retreating": {"height": 0.5, "stiffness": 3e4, "strength_wave": FULL},
    "light": {"added_mass": False, "ambient_pressure": False, "damping": 50.0},
}
STIFFEST = {
    "stiffest": {"stiffness": 1e9},
    "stiffest and damped": {"stiffness": 1e9, "damping": 2e4},
}
SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in STIFFEST]


@pytest.fixture(scope="module")
def scene_of(r1_scene):
    def build(name, **changes):
        own = {"strength_wave": WAVE, "orbit": "periodic"} | (CASES | STIFFEST)[name] | changes
        return r1_scene(**own)

    return build


@pytest.fixture(scope="module")
def solved(scene_of):
    """Return the run of a case and the orbit that SciPy finds from its start, each computed once."""
    known = {}

    def solve(name):
        if name not in known:
            run = po.simulate(scene_of(name), accuracy=po.Accuracy(error=1e-11), outputs=OUTPUTS)
            first = run.deflection[0], run.scene.tow_speed - run.speed[0]
            known[name] = run, orbit(run.scene, first, OUTPUTS)
        return known[name]

    return solve


@pytest.mark.parametrize("name", [*CASES, *SLOW])
def test_orbit_is_the_one_that_scipy_finds_by_shooting(solved, name):
    run, true = solved(name)
    assert run.error_estimate <= 1e-8
    # SciPy's relative tolerance of 1e-12 and the root of the shooting leave about 3e-11.
    size = np.ptp(true.deflection)
    assert run.deflection == pytest.approx(true.deflection, rel=0, abs=2e-10 * size + 1e-14 * np.max(true.deflection))
    assert run.mount_force == pytest.approx(true.force, rel=0, abs=2e-10 * np.max(true.force))
    # The speed of the share is rounded to 1e-16 of itself.
    assert run.scene.tow_speed - run.speed == pytest.approx(
        true.rate, rel=0, abs=1e-9 * np.max(np.abs(true.rate)) + 2e-15
    )


@pytest.mark.parametrize("name", [*CASES, *SLOW])
def test_multipliers_are_those_of_the_monodromy(solved, name):
    run, true = solved(name)
    found = np.poly(np.array(run.floquet)).real
    # Compare sum and product, which are smooth where two multipliers meet; the multipliers themselves are not.
    phase = run.scene.natural_frequency * run.duration
    expected = [1.0, -np.trace(true.monodromy), np.linalg.det(true.monodromy)]
    assert found == pytest.approx(expected, rel=0, abs=1e-9 * max(1.0, np.max(np.abs(expected)), phase))


@pytest.mark.parametrize(("damping", "unstable"), [(35.2, True), (35.3, False)])
def test_an_unstable_orbit_carries_a_warning(scene_of, damping, unstable):
    # Between these two the largest multiplier passes through 1, from which it differs by 4e-4 at both.
    run = po.simulate(scene_of("soft", damping=damping), outputs=1)
    first = np.array([run.deflection[0], run.scene.tow_speed - run.speed[0]])
    excess = max(abs(np.linalg.eigvals(monodromy(run.scene, first)))) - 1.0
    assert max(map(abs, run.floquet)) - 1.0 == pytest.approx(excess, abs=1e-9)
    assert (1e-4 < excess < 1e-3) if unstable else (-1e-3 < excess < -1e-4)
    warnings = [text for text in run.warnings if "the orbit is unstable" in text]
    assert len(warnings) == unstable
    assert all(f"grows {1.0 + excess:.4g} times in every wavelength" in text for text in warnings)


@pytest.mark.parametrize("choice", ORBITS, ids=str)
@pytest.mark.parametrize("effects", [{}, {"damping": 100.0, "rate_term": 0.05}, {"inertial_drag": False}])
def test_without_amplitude_the_share_slides_steadily(r1_scene, choice, effects):
    scene = r1_scene(strength_wave=po.StrengthWave(0.0, 0.6), orbit=choice, **effects)
    run = po.simulate(scene, outputs=8)
    assert run.mean_draft == pytest.approx(scene.steady_resistance, rel=1e-15)
    assert run.force_rms == run.displacement_rms == run.error_estimate == 0.0
    assert run.deflection == pytest.approx(np.full(9, scene.steady_resistance / scene.stiffness), rel=1e-15)
    assert run.speed == pytest.approx(np.full(9, 2.0), rel=1e-15)


SLIGHT, LENGTH = 1e-4, 0.2


@dataclasses.dataclass(frozen=True)
class Damper:
    """A resistance that grows with the speed and with its square."""

    first: float
    second: float = 0.0

    def force(self, travel, speed):
        return self.first * speed + self.second * speed**2 + 0.0 * travel


@dataclasses.dataclass(frozen=True)
class Waves:
    """A resistance that varies along the travel, with a mean other than the value at the start."""

    sine: float
    cosine: float
    wavelength: float = LENGTH

    def force(self, travel, speed):
        angle = 2.0 * math.pi / self.wavelength * travel
        return self.sine * sin(angle) + self.cosine * cos(angle) + 0.0 * speed


def with_own(r1_scene, orbit, own, amplitude=SLIGHT):
    return r1_scene(strength_wave=po.StrengthWave(amplitude, LENGTH), orbit=orbit, own=own)


def close(run, exact, within):
    """Return whether averages and mount force of two orbits differ by at most a part of the RMS."""
    size = within * exact.force_rms
    averages = abs(run.mean_draft - exact.mean_draft), abs(run.force_rms - exact.force_rms)
    return max(*averages, abs(run.mount_force - exact.mount_force).max()) <= size


@pytest.mark.parametrize(
    "own",
    [
        (Damper(800.0),),
        (Damper(200.0, 150.0),),
        (Waves(0.3, -0.2),),
        (Damper(300.0, 80.0), Waves(-0.1, 0.4)),
    ],
    ids=["damper", "drag", "waves", "both"],
)
def test_the_linear_response_to_a_slight_wave_is_the_orbit(r1_scene, own):
    exact = po.simulate(with_own(r1_scene, "periodic", own))
    linear = po.simulate(with_own(r1_scene, "linearised", own))
    # The neglected terms are of second order in the deviation, about 1e-4 of the forces here.
    assert close(linear, exact, 1e-3)


def test_an_own_wave_is_as_good_as_the_soils(r1_scene):
    static = float(r1_scene().reaction.static)
    own = with_own(r1_scene, "linearised", (Waves(0.2 * static, 0.0),), amplitude=0.1)
    same = po.simulate(r1_scene(strength_wave=po.StrengthWave(0.3, LENGTH), orbit="linearised"))
    # Exact except for rounding of the coefficients from 16 samples.
    assert close(po.simulate(own), same, 1e-12)


@pytest.mark.parametrize("orbit", ORBITS, ids=str)
def test_own_resistances_that_do_not_repeat_with_the_wave_have_no_orbit(r1_scene, orbit):
    refused = with_own(r1_scene, orbit, (Waves(30.0, 0.0, wavelength=0.31),))
    with pytest.raises(po.InputError, match=r"Waves.*one wavelength \(0\.2 m\) further on.*simulate from a start"):
        po.simulate(refused)
    design = po.Design()
    stiffness = design.variable("stiffness", guess=5e4, lower=4e4, upper=6e4)
    design.minimise(po.simulate(dataclasses.replace(refused, stiffness=stiffness)).force_rms)
    with pytest.raises(po.InputError, match="further on"):
        design.solve()


@pytest.mark.parametrize("choice", ["steady", None, 3, po.HarmonicBalance, ["periodic"]])
def test_an_unknown_orbit_is_refused(choice):
    with pytest.raises(po.InputError, match="must be 'transient', 'periodic' or 'linearised', or HarmonicBalance"):
        po.Effects(strength_wave=WAVE, orbit=choice)


@pytest.mark.parametrize("harmonics", [0, 65, 2.5, "3", True, None])
def test_harmonics_are_a_whole_number_up_to_64(harmonics):
    with pytest.raises(po.InputError, match="must be a whole number from 1 to 64"):
        po.HarmonicBalance(harmonics)


@pytest.mark.parametrize("choice", ORBITS, ids=str)
def test_runs_that_no_orbit_has_are_refused(r1_scene, choice):
    scene = r1_scene(strength_wave=WAVE, orbit=choice)
    with pytest.raises(po.InputError, match=r"duration .* is one wavelength .* omit it"):
        po.simulate(scene, 0.3)
    with pytest.raises(po.DomainError, match=r"tow speed = 0.*has no orbit"):
        po.simulate(dataclasses.replace(scene, tow_speed=0.0))
    # A stiff mount would take minutes.
    stiff = dataclasses.replace(scene, stiffness=1e9, tow_speed=0.5, effects=po.Effects(
        strength_wave=po.StrengthWave(0.3, 4.0), orbit=choice))  # fmt: skip
    with pytest.raises(
        po.IntegrationError, match=r"1e\+06 kN/m.*turns in one wavelength.*softer.*Effects\(motion=False\).*dop853"
    ):
        po.simulate(stiff)
    design = po.Design()
    stiffness = design.variable("stiffness", guess=5e4, lower=1e4, upper=1e9)
    design.minimise(po.simulate(dataclasses.replace(stiff, stiffness=stiffness)).force_rms)
    with pytest.raises(po.DomainError, match="at the upper bound of 'stiffness': the periodic orbit of"):
        design.solve()


@pytest.mark.parametrize("effects", [{}, {"strength_wave": WAVE}, {"motion": False}])
def test_a_missing_duration_is_refused(r1_scene, effects):
    with pytest.raises(po.InputError, match="the duration is missing"):
        po.simulate(r1_scene(**effects))


@pytest.mark.parametrize("method", ["erk", "rosenbrock", "cvodes", "idas", "collocation", "rk"])
def test_methods_that_find_no_orbit_are_refused(r1_scene, method):
    with pytest.raises(po.InputError, match=f"'{method}' cannot find an orbit: use 'auto', or 'dop853'"):
        po.simulate(r1_scene(strength_wave=WAVE, orbit="periodic"), accuracy=po.Accuracy(method))


@pytest.mark.parametrize("damping", [None, 200.0])
def test_where_no_orbit_is_found_the_message_names_a_remedy(scene_of, damping, capfd):
    scene = scene_of("strongest", strength_wave=po.StrengthWave(1.0, 0.2), stiffness=2e3, tow_speed=0.3)
    scene = dataclasses.replace(scene, effects=dataclasses.replace(scene.effects, damping=damping))
    with pytest.raises(po.IntegrationError, match=r"no periodic orbit of a share .*2 kN/m.*damp.*orbit = 'transient'"):
        po.simulate(scene)
    # CasADi must not print a page on the root that it did not find.
    assert capfd.readouterr() == ("", "")
