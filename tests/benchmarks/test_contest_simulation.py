"""Simulations of R1, compared with other tools at the same error. No test asserts a time."""

import math
from functools import partial

import numpy as np
import pytest
from contest_table import Row, race
from helpers.scenes import R1_RUNS
from peers import r1

import plough_opt as po
from plough_opt.motion.equation import parameters

pytestmark = [pytest.mark.bench, pytest.mark.filterwarnings("ignore")]

WANTED = 1e-6
OUTPUTS, TIGHT = 400, 1e-8
OURS = "plough_opt simulate"
# Groups of designs that need similar numbers of steps, so that tools with fixed steps take few unnecessary ones.
GROUPS = 8


def _domain(count):
    uniform = np.random.default_rng(0).uniform(0.0, 1.0, (3, count))
    return np.column_stack(r1.unscaled(uniform))


def _near_start(count):
    return r1.START * np.random.default_rng(1).uniform(0.999, 1.001, (count, 3))


def _simulated(r1_scene, wave, x, error=1e-11):
    scene = r1_scene(math.degrees(x[0]), x[1], x[2], strength_wave=wave)
    return po.simulate(scene, r1.DURATION, accuracy=po.Accuracy(error=error), outputs=OUTPUTS)


def _error(found, truth):
    """Return the largest error of mean draft and RMS force, relative to the larger of the two."""
    found, truth = np.asarray(found), np.asarray(truth)
    return float(np.max(np.abs(found - truth) / np.max(truth, axis=0)))


def test_hand_written_r1_is_ours(r1_scene, r1_wave):
    for x in (r1.START, r1.LOWER, r1.UPPER):
        known = parameters(r1_scene(math.degrees(x[0]), x[1], x[2], strength_wave=r1_wave))
        ours = [known[name] for name in ("static", "drag", "inertia", "stiffness")]
        # Rounding of about twenty operations.
        np.testing.assert_allclose(r1.equation(*x)[:4], ours, rtol=2e-14)


@pytest.mark.parametrize("where", ["start", "domain"])
def test_very_many_designs(batch_of, r1_scene, r1_wave, where, contest, peer):
    task = f"mean and RMS force of very many designs {'near the start' if where == 'start' else 'all over the domain'}"
    designs = {"start": _near_start, "domain": _domain}[where]
    values, few = designs(16384), designs(16384)[:4096]
    batch = batch_of(r1.DURATION, WANTED, strength_wave=r1_wave)
    reference = batch_of(r1.DURATION, 1e-10, strength_wave=r1_wave)(values)
    truth = np.array([reference.mean_draft, reference.force_rms])
    for k in range(0, len(values), len(values) // 12):
        run = _simulated(r1_scene, r1_wave, values[k])
        # The error of the reference plus that of the simulation.
        assert _error(truth[:, [k]], [[run.mean_draft], [run.force_rms]]) < 2e-10
    found = batch(values)
    error = _error([found.mean_draft, found.force_rms], truth)
    assert error < WANTED
    tools = {"plough_opt Batch, compiled": (lambda: batch(values), len(values), error)}
    tools |= _fixed_step_peers(few, truth[:, : len(few)], GROUPS if where == "domain" else 1, peer)
    spent = race({name: function for name, (function, _, _) in tools.items()}, 5)
    for name, (_, count, error) in tools.items():
        each = spent[name].per(count)
        contest.rows.append(Row(task, name, each, error, note=f"{1.0 / each.cpu:.3g} designs per second"))


def _fixed_step_peers(values, truth, groups, peer):
    """Return the tools that take classical Runge-Kutta steps, as few as each group of designs allows."""
    p = np.array(r1.equation(*values.T))
    fastest = (p[3] + r1.AMPLITUDE * p[0] * 2.0 * math.pi / r1.WAVELENGTH) / p[2]
    parts = [(np.ascontiguousarray(p[:, k]), truth[:, k]) for k in np.array_split(np.argsort(fastest), groups)]
    runs = {}
    if (c := peer("c_rk4")) is not None:
        runs[f"RK4 in C, {c.WIDTH} designs side by side"] = c.vector()
        runs["RK4 in C, a design at a time"] = c.scalar()
    if (numba := peer("numba_rk4")) is not None:
        runs["RK4 in Numba"] = numba.batch
    if (jax := peer("jax_rk4")) is not None:
        runs["RK4 in JAX, vmap and jit"] = jax.batch

    def error(run, part, wanted, steps):
        mean, spread = np.asarray(run(part, steps))
        return _error((part[3] * (part[4] + mean), part[3] * spread), wanted)

    found, steps = {}, None
    for name, run in runs.items():
        steps = steps or [
            next(n for n in (int(50 * 1.1**k) for k in range(80)) if error(run, *part, n) < WANTED) for part in parts
        ]
        reached = max(error(run, *part, n) for part, n in zip(parts, steps, strict=True))
        # All tools take the same steps and differ only by rounding.
        assert reached < WANTED * (1.0 + 1e-3)

        def every(run=run, steps=steps):
            for (part, _), n in zip(parts, steps, strict=True):
                np.asarray(run(part, n))

        found[name] = every, len(values), reached
    return found


def test_one_simulation(r1_scene, r1_wave, contest, peer):
    truth = _simulated(r1_scene, r1_wave, r1.START)
    task = f"one simulation of {OUTPUTS} outputs, mount force to {TIGHT:g}"
    assert _error([[truth.mean_draft], [truth.force_rms]], np.array(R1_RUNS[0])[3:, None]) < 1e-11

    def error(found):
        mean, rms, force = found
        errors = [np.max(np.abs(force - truth.mount_force)) / truth.peak_force]
        if mean is not None:
            errors.append(_error([[mean], [rms]], [[truth.mean_draft], [truth.force_rms]]))
        return float(max(errors))

    scene, read = r1_scene(strength_wave=r1_wave), f"problem = po.read_problem({r1.PROBLEM!r})"
    setup = f"import plough_opt as po; from peers import r1; {read}; s = problem.scene()"
    rows = {}
    for name, compiled in ((OURS, False), (f"{OURS}, compiled before", True)):
        simulate = partial(po.simulate, scene, r1.DURATION, compiled=compiled)
        run = simulate()
        ours = error((run.mean_draft, run.force_rms, run.mount_force))
        assert ours < TIGHT
        call = f"po.simulate(s, {r1.DURATION!r}, compiled={compiled})"
        rows[name] = (simulate, ours, "and once more for its error estimate", setup, call)
    p = [float(x) for x in r1.equation(*r1.START)]
    rows |= _scipy_rows(p, error, contest)
    if (numba := peer("numba_rk4")) is not None:
        steps = next(n for n in range(OUTPUTS, 40 * OUTPUTS, OUTPUTS) if error(numba.forces(*p, n, OUTPUTS)) < TIGHT)
        setup = "from peers import r1, numba_rk4; p = [float(x) for x in r1.equation(*r1.START)]"
        call = f"numba_rk4.forces(*p, {steps}, {OUTPUTS})"
        forces = partial(numba.forces, *p, steps, OUTPUTS)
        rows["RK4 in Numba"] = (forces, error(forces()), f"{steps} steps", setup, call)
    contest.hold(task, rows, 7)


def _scipy_rows(p, error, contest):
    """Return SciPy's integrators, each with the loosest tolerance that reaches the wanted error."""
    from peers import scipy_ivp

    rows = {}
    setup = "from peers import r1, scipy_ivp; p = r1.equation(*r1.START)"
    for method in ("DOP853", "LSODA", "RK45", "Radau", "odeint"):
        for averages in (True, False):
            name = f"SciPy {method}, {'with' if averages else 'without'} mean and RMS"
            for tolerance in 10.0 ** -np.arange(6.0, 13.01, 0.25):
                arguments = (method, float(f"{tolerance:.2g}"), OUTPUTS, averages)
                reached = error(scipy_ivp.solve(p, *arguments))
                if reached < TIGHT:
                    call, solve = f"scipy_ivp.solve(p, *{arguments!r})", partial(scipy_ivp.solve, p, *arguments)
                    rows[name] = (solve, reached, f"rtol {arguments[1]:g}", setup, call)
                    break
            else:
                contest.missing[name] = f"no tolerance reaches {TIGHT:g}"
    return rows
