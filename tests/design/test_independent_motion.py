"""The simulator that judges the search: against an adaptive integrator, and against published values of R1."""

import itertools

import numpy as np
import pytest
from independent.fast import simulate
from independent.motion import NAMES, Motion, share
from scipy.integrate import solve_ivp

R1_SOIL = (1400.0, 0.8, 15e3, np.radians(30.0), 0.5, 1e4)
# Wedge angle [deg], height [m], stiffness [N/m]; mean and RMS [N] of a reference integration at 1e-11.
R1_ROWS = (
    (25.0, 0.25, 5e4, 531.047098354, 145.439117595),
    (25.0, 0.25, 6e3, 525.384371406, 209.467549465),
    (25.0, 0.25, 4e5, 530.442387539, 113.154184492),
    (10.0, 0.40, 1e4, 530.957907066, 921.978274273),
    (40.0, 0.15, 5e3, 405.636319546, 107.584572626),
)


def test_r1_has_its_published_averages():
    angle, height, stiffness, mean, rms = np.array(R1_ROWS).T
    s = share(R1_SOIL, np.radians(angle), np.radians(15.0), height)
    motion = Motion(
        s.static, s.drag, 20.0 + s.steel + s.added_mass, stiffness, 0.0, 2.0, 0.3, 0.6, 0.0, "equilibrium", 2.0
    )
    found = simulate(motion)
    # The table has twelve digits; at 0.7 rad in a step the method has eight and more.
    assert found.mean_draft == pytest.approx(mean, rel=3e-9)
    assert found.force_rms == pytest.approx(rms, rel=3e-8)
    fine = simulate(motion, phase=0.3)
    assert fine.mean_draft == pytest.approx(mean, rel=1e-11)
    assert fine.force_rms == pytest.approx(rms, rel=1e-11)


def _adaptive(motion, number):
    """Return averages and paths of one run by DOP853 at 1e-11, in the deflection z itself."""
    one = motion.take([number])
    f0, fd, mass, k0, c, v0, eps, ell, ramp = (
        float(getattr(one, name)[0])
        for name in ("static", "drag", "inertia", "stiffness", "damping", "speed", "amplitude", "wavelength", "ramp")
    )

    def strut(t):
        if ramp == 0.0:
            return v0 * t, v0, 0.0
        u = min(t / ramp, 1.0)
        path = v0 * (ramp * (u**6 - 3 * u**5 + 2.5 * u**4) + max(t - ramp, 0.0))
        return path, v0 * u**3 * (10 - 15 * u + 6 * u * u), 30 * v0 / ramp * u**2 * (1 - u) ** 2

    def rates(t, state):
        z, rate = state[:2]
        path, speed, acceleration = strut(t)
        force = f0 * (1 + eps * np.sin(2 * np.pi * (path - z) / ell)) + fd * (speed - rate) ** 2
        pull = k0 * z + c * rate
        return [rate, (force - pull) / mass + acceleration, z, z * z, pull, pull * pull, pull * speed]

    speed = 0.0 if ramp else v0
    z = (f0 + fd * speed**2) / k0 if one.start == "equilibrium" else 0.0
    state, rate = [z, speed if one.start == "rest" else 0.0, 0, 0, 0, 0, 0], []
    times = np.linspace(0.0, one.duration, 401)
    ends = [0.0, ramp, one.duration] if 0.0 < ramp < one.duration else [0.0, one.duration]
    for begin, end in itertools.pairwise(ends):
        done = solve_ivp(rates, (begin, end), state, method="DOP853", rtol=1e-11, atol=1e-14, dense_output=True)
        state = done.y[:, -1]
        inside = times[(times >= begin) & (times < end) | (times == end) & (end == one.duration)]
        rate += list(done.sol(inside)[:2].T)
    z, zz, p, pp, power = state[2:] / one.duration
    path = np.array(rate)
    averages = [p, np.sqrt(pp - p * p), z, np.sqrt(zz - z * z), power]
    return averages, path[:, 0], k0 * path[:, 0] + c * path[:, 1]


@pytest.mark.parametrize("start", ["equilibrium", "rest", "towed"])
@pytest.mark.parametrize("ramp", [0.0, 0.3])
def test_runs_agree_with_an_adaptive_integrator(start, ramp):
    random = np.random.default_rng(5)
    s = share(R1_SOIL, random.uniform(0.2, 0.9, 2), 0.3, random.uniform(0.15, 0.4, 2))
    motion = Motion(
        s.static, s.drag, 40.0 + s.steel + s.added_mass, 10.0 ** random.uniform(4.0, 6.0, 2),
        random.uniform(50.0, 500.0, 2), random.uniform(1.0, 3.0, 2), [0.4, 0.2], 0.5, ramp, start, 0.8,
    )  # fmt: skip
    found, fine = simulate(motion, paths=True), simulate(motion)
    for number in range(2):
        averages, deflection, force = _adaptive(motion, number)
        for name, value in zip(NAMES, averages, strict=True):
            # The RMS of the adaptive run is a difference of squares, which costs it digits.
            assert getattr(found, name)[number] == pytest.approx(value, rel=1e-8), name
            assert getattr(fine, name)[number] == pytest.approx(value, rel=1e-7), name
        # Degree 5 between steps of 0.3 rad: some 1e-8 of the oscillation.
        assert found.deflection[:, number] == pytest.approx(deflection, abs=1e-7 * np.max(np.abs(deflection)))
        assert found.mount_force[:, number] == pytest.approx(force, abs=3e-6 * np.max(np.abs(force)))


def test_designs_side_by_side_do_not_touch():
    s = share(R1_SOIL, 0.5, 0.3, 0.25)
    stiffness = np.geomspace(5e3, 5e6, 150)
    motion = Motion(s.static, s.drag, 40.0, stiffness, 100.0, 2.0, 0.3, 0.4, 0.0, "rest", 1.0)
    together = simulate(motion)
    for number in (0, 13, 149):
        alone = simulate(motion.take([number]))
        # Sums over stages are taken in another order in shorter arrays.
        assert alone.mean_draft[0] == pytest.approx(together.mean_draft[number], rel=1e-12)
        assert alone.displacement_rms[0] == pytest.approx(together.displacement_rms[number], rel=1e-10)
