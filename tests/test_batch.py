"""Batches against single simulations: equal results, honest errors, failures with reasons; their Taylor series."""

import math
from dataclasses import dataclass, replace

import casadi as ca
import mpmath as mp
import numpy as np
import pytest
from helpers import event_splitting
from helpers.scenes import AVERAGES, R1_RUNS, SEROZEM, Own, Shank, scene_of

import plough_opt as po
from plough_opt.core.expressions import Expression, as_number, exp, maximum, minimum, sin, where
from plough_opt.motion.batch.series import Engine, Graph, Interpreter, series_of

DESIGNS = np.array([[po.deg(25.0), 0.25, 5e4], [po.deg(45.0), 0.15, 8e3], [po.deg(10.0), 0.4, 3e5]])


@pytest.fixture
def errors(r1_scene):
    """Compute the largest error of each design, relative to the larger of mean draft and RMS force."""

    def errors(result, duration, accuracy=None, **effects):
        found, accuracy = [], accuracy or po.Accuracy(error=1e-11)
        for k, (angle, height, stiffness) in enumerate(DESIGNS[: len(result)]):
            scene = r1_scene(math.degrees(angle), height, stiffness, **effects)
            run = po.simulate(scene, duration, accuracy=accuracy, outputs=4)
            units = (1.0, 1.0, stiffness, stiffness, 1.0 / run.scene.tow_speed)
            differences = (abs(getattr(result, name)[k] - getattr(run, name)) for name in AVERAGES)
            size = max(abs(run.mean_draft), run.force_rms)
            found.append(max(unit * d for unit, d in zip(units, differences, strict=True)) / size)
        return np.array(found)

    return errors


def test_truth_of_r1(batch_of, r1_wave):
    *values, mean, rms = np.array(R1_RUNS).T
    result = batch_of(2.0, strength_wave=r1_wave)(np.column_stack(values) * [math.pi / 180.0, 1.0, 1.0])
    assert result.mean_draft == pytest.approx(mean, rel=2e-9)
    assert result.force_rms == pytest.approx(rms, rel=2e-9)
    assert np.all(result.error_estimate < 1e-9)


@pytest.mark.usefixtures("no_compiler")
def test_combinations_of_effects(batch_of, errors, effects):
    result = batch_of(0.6, **effects)(DESIGNS)
    assert np.all(errors(result, 0.6, **effects) < 1e-9)
    assert np.all(result.error_estimate < 1e-9)


SMOOTH = [
    {"start": "rest", "rate_term": 0.05, "speed_term": 0.2},
    {"start": "towed", "tow_ramp": 0.2, "damping": 200.0},
    {"tow_ramp": 0.2},
]


@pytest.mark.usefixtures("no_compiler")
@pytest.mark.parametrize("more", SMOOTH, ids=str)
def test_smooth_contact(batch_of, errors, more):
    effects = {"contact": po.Smooth(0.2), "strength_wave": po.StrengthWave(0.9, 0.3), "tow_speed": 0.8, **more}
    # These shares stop and go, and each stop changes the formula.
    assert np.all(errors(batch_of(0.5, **effects)(DESIGNS), 0.5, **effects) < 2e-9)


def kinked(travel, speed):
    """Return a force with corners and jumps."""
    corners = abs(sin(9.0 * travel)) + maximum(speed - 2.0, 0.0) - minimum(speed, 1.9)
    return 60.0 * (corners + where(sin(5.0 * travel) > 0.3, 1.0, 0.5))


@pytest.mark.usefixtures("no_compiler")
def test_own_resistances_with_corners(batch_of, errors, r1_wave):
    effects = {"strength_wave": r1_wave, "own": (Own(kinked),)}
    # Single simulations do not locate corners; at the tightest tolerance they pass them by many small steps.
    small_steps = po.Accuracy("erk", tolerance=1e-13)
    assert np.all(errors(batch_of(error=1e-8, **effects)(DESIGNS[:2]), 1.0, small_steps, **effects) < 1e-8)


def test_duration_and_ramp_of_each_design(r1_scene, r1_wave):
    k0, duration, ramp = (ca.MX.sym(name) for name in ("k0", "duration", "ramp"))
    batch = po.Batch(r1_scene(25.0, 0.25, k0, strength_wave=r1_wave, tow_ramp=ramp), duration, [k0, duration, ramp])
    values = np.array([[5e4, 0.5, 0.2], [1e4, 1.0, 0.6], [5e4, 0.3, 0.9], [5e4, 0.5, 0.0], [5e4, -1.0, 0.2]])
    result = batch(values)
    for k, (stiffness, time, end) in enumerate(values[:3]):
        scene = r1_scene(25.0, 0.25, stiffness, strength_wave=r1_wave, tow_ramp=end)
        run = po.simulate(scene, time, outputs=4)
        assert (result.mean_draft[k], result.tow_power[k]) == pytest.approx((run.mean_draft, run.tow_power), rel=1e-6)
    assert list(result.failed) == [False, False, False, True, True]
    assert "tow ramp" in result.reasons[3]
    assert result.reasons[4] == "duration = -1 s must be above 0 s"


def test_a_column_of_symbols(r1_scene, r1_wave, batch_of):
    x = ca.MX.sym("x", 3)
    # CasADi evaluates what has no graph of scalar operations.
    table = ca.interpolant("table", "linear", [[0.0, 1e6]], [0.0, 1e6])(x[2])
    solved = ca.solve(ca.diag(x[1:]), x[1:] ** 2, "qr")[1]
    expected = batch_of(strength_wave=r1_wave)(DESIGNS)
    for stiffness in (x[2], table, solved):
        scene = r1_scene(x[0] * (180.0 / math.pi), x[1], stiffness, strength_wave=r1_wave)
        found = po.Batch(scene, 1.0, [x], error=1e-9)(DESIGNS)
        assert found.mean_draft == pytest.approx(expected.mean_draft, rel=1e-12)


def test_designs_outside_the_domain(batch_of, r1_scene, r1_wave):
    batch = batch_of(strength_wave=r1_wave, error=1e-6)
    bad = {1: (po.deg(25.0), -0.2, 5e4), 3: (po.deg(95.0), 0.2, 5e4), 4: (0.4, 0.2, 0.0)}
    bad |= {6: (0.4, math.nan, 5e4), 7: (0.4, 0.2, math.inf), 8: (0.4, 1e200, 5e4)}
    values = np.tile(DESIGNS[0], (9, 1))
    for k, row in bad.items():
        values[k] = row
    result = batch(values)
    assert sorted(result.reasons) == sorted(bad)
    assert list(np.flatnonzero(result.failed)) == sorted(bad)
    for k, (angle, height, k0) in bad.items():
        with pytest.raises(po.DomainError) as caught:
            r1_scene(math.degrees(angle), height, k0)
        assert result.reasons[k].split(" = ")[0] == str(caught.value).split(" = ")[0]
        assert all(math.isnan(getattr(result, name)[k]) for name in AVERAGES)
    assert "share height = -0.2 m must be above 0 m" in result.reasons[1]
    assert np.all(result.mean_draft[~result.failed] == batch(DESIGNS[:1]).mean_draft[0])


# A name in the reason -> a sound and an unsound value, and the scene of a value.
FALLING = SEROZEM.with_density_profile(lambda r: SEROZEM.density * (1.0 + exp(-((2.0 * r) ** 2))), order=4)
WITHOUT_STRENGTH = {"ambient_pressure": False, "inertial_drag": False, "start": "rest"}
UNSOUND = {
    "depth over width": (0.5, 0.05, lambda x: scene_of(share=po.Wedge(x, 0.3, 0.3), medium="universal_earthmoving")),
    "compaction front": (0.2, 9.0, lambda x: scene_of(FALLING, po.Cone(0.3, x))),
    "amplitudes is 1.3": (0.2, 0.8, lambda x: scene_of(
        strength_wave=(po.StrengthWave(0.5, 0.2), po.StrengthWave(x, 0.3)))),
    # This soil itself has no strength.
    "share height": (0.2, -1.0, lambda x: scene_of(
        replace(SEROZEM, cohesion=0.0), po.Cone(0.3, x), own=(Shank(per_metre=9.0 * x),), **WITHOUT_STRENGTH)),
}  # fmt: skip


@pytest.mark.parametrize("name", UNSOUND)
def test_designs_are_refused_as_a_single_scene_is(name):
    x, (sound, unsound, scene) = ca.MX.sym("x"), UNSOUND[name]
    result = po.Batch(scene(x), 0.1, [x])([[sound], [unsound]])
    assert result.mean_draft[0] == pytest.approx(po.simulate(scene(sound), 0.1).mean_draft, rel=1e-6)
    with pytest.raises(po.DomainError, match=name) as caught:
        scene(unsound).check_reaction()
    assert result.reasons == {1: str(caught.value)}


def test_motions_without_an_end(batch_of, r1_wave):
    runaway = batch_of(60.0, strength_wave=r1_wave, formulation="printed", error=1e-4)(DESIGNS[:1])
    assert "has no finite mean" in runaway.reasons[0]
    ringing = batch_of(strength_wave=r1_wave, start="rest", error=1e-4)([*DESIGNS, [0.4, 0.2, 1e15]])
    assert list(ringing.failed) == [False, False, False, True]
    assert "takes more than 200000 steps" in ringing.reasons[3]


OTHER_SCENES = [
    ({"own": (Own(lambda travel, speed: 3.0 * ca.floor(travel) * speed),)}, "operation .floor."),
    ({"motion": False}, "quasi-static"),
    ({"contact": po.StickSlip()}, "events of StickSlip"),
    ({"entry": True, "start": "rest"}, "events of the entry"),
]


@pytest.mark.parametrize(
    ("effects", "match"), OTHER_SCENES, ids=lambda value: value if isinstance(value, str) else next(iter(value))
)
def test_other_scenes_are_refused(batch_of, effects, match):
    with pytest.raises(po.InputError, match=match):
        batch_of(**effects)


def test_wrong_inputs(batch_of, r1_scene, r1_wave):
    k0, other = ca.MX.sym("k0"), ca.MX.sym("other")
    scene, batch = r1_scene(25.0, 0.25, k0, strength_wave=r1_wave), batch_of(strength_wave=r1_wave, error=1e-6)
    for call, match in (
        (lambda: po.Batch(scene, 1.0, [other]), "depends on k0"),
        (lambda: po.Batch(scene, 1.0, [2.0 * k0]), "CasADi symbols"),
        (lambda: po.Batch(scene, 1.0, k0), "list of the CasADi symbols"),
        (lambda: po.Batch(scene, 1.0, [k0, k0]), "named twice"),
        (lambda: po.Batch(scene, 1.0, [k0, ca.SX.sym("other")]), "all SX or all MX"),
        (lambda: po.Batch(scene, 1.0, [k0], error=0.0), "error = 0 must be at least 1e-11"),
        (lambda: po.Batch(scene, 1.0, [k0], error="1e-6"), "error: '1e-6' is not a number"),
        (lambda: po.Batch(scene, [1.0], [k0]), "duration = .* must be"),
        (lambda: po.Batch(scene, "-1 s", [k0]), "duration = .* must be"),
        (lambda: batch(DESIGNS[0]), r"shape \(3,\).*3 inputs"),
        (lambda: batch([["25 deg", 0.25, 5e4]]), "values of a batch must be numbers"),
        (lambda: batch(DESIGNS, threads=1.5), "threads = .* must be a whole number"),
        (lambda: next(batch.stream(3.0)), "chunks = .* must be a list"),
        (lambda: po.Batch(r1_scene(stiffness=ca.fmod(k0, 2e5)), 1.0, [k0]), "cannot evaluate the operation 'fmod'"),
    ):
        with pytest.raises((po.InputError, po.DomainError), match=match):
            call()


def test_streams_and_threads_equal_one_call(batch_of, r1_wave):
    batch = batch_of(0.1, strength_wave=r1_wave, error=1e-3)
    values = np.repeat(DESIGNS, 12000, axis=0) * np.random.default_rng(0).uniform(0.5, 1.5, (36000, 3))
    values[20000, 1] = -1.0
    whole, threaded = batch(values), batch(values, threads=2)
    parts = list(batch.stream([values[:1], values[1:25000], values[25000:]]))
    assert [len(part) for part in parts] == [1, 24999, 11000]
    for name in (*AVERAGES, "error_estimate", "steps"):
        joined = np.concatenate([getattr(part, name) for part in parts])
        for found in (joined, getattr(threaded, name)):
            assert np.array_equal(found, getattr(whole, name), equal_nan=True)
    assert parts[1].reasons[19999] == whole.reasons[20000]
    assert threaded.reasons == whole.reasons
    assert list(whole.reasons) == [20000]


# --- how a batch follows the errors of its steps: by single steps, over long runs, and whoever else is in the call ---

NAMES = (*AVERAGES, "error_estimate", "steps")
# A design whose neighbouring motions diverge beyond the range of floating point.
CHAOTIC = (0.639427778, 0.482322562, 8104.16376)


def designs(count, seed=0):
    low, high = np.array([[po.deg(5.0), 0.1, math.log(5e3)], [po.deg(60.0), 0.5, math.log(5e5)]])
    values = np.random.default_rng(seed).uniform(low, high, (count, 3))
    values[:, 2] = np.exp(values[:, 2])
    return values


def difference(one, finer):
    """Return the difference of each design's force, relative to the larger of mean draft and RMS force."""
    made = np.maximum(abs(one.mean_draft - finer.mean_draft), abs(one.force_rms - finer.force_rms))
    return made / np.maximum(finer.mean_draft, finer.force_rms)


@pytest.mark.parametrize("error", [pytest.param(1e-3, marks=pytest.mark.slow), 1e-6])
def test_the_estimate_is_honest(batch_of, r1_wave, error):
    values = designs(3000, 3)
    result, finer = (batch_of(2.0, e, strength_wave=r1_wave)(values) for e in (error, 1e-10))
    made = difference(result, finer)
    assert not result.missed.any()
    assert np.all(made < error)
    assert np.all(made < result.error_estimate)
    # A bound, but a useful one: for half of the designs it is less than some hundred times the error.
    assert np.median(result.error_estimate / made) < 1000.0


def test_designs_that_miss_the_wanted_error_by_far_are_repeated_until_they_meet_it(batch_of):
    result = batch_of(8.0, 1e-4, strength_wave=po.StrengthWave(0.9, 0.6))(designs(400))
    # At first a fifth misses it, some a hundred thousandfold.
    assert np.mean(result.missed) < 0.01


@pytest.mark.parametrize("damping", [None, pytest.param(250.0, marks=pytest.mark.slow)])
def test_long_runs_keep_the_wanted_error(batch_of, r1_scene, r1_wave, damping):
    values = designs(400)
    effects = {"strength_wave": r1_wave, "damping": damping}
    short, long = (batch_of(duration, 1e-6, **effects)(values) for duration in (2.0, 32.0))
    # Three motions in a thousand diverge from their neighbours too fast, and are reported as missed.
    assert np.mean(long.missed) < 0.01
    # Errors that add up need steps shorter by the 16th root of 16, a fifth.
    assert np.median(long.steps / short.steps) < 16.0 * 1.25
    finer = batch_of(32.0, **effects)(values)
    sure = finer.error_estimate < 1e-8
    assert np.mean(sure) > 0.98
    assert np.all(difference(long, finer)[sure] < long.error_estimate[sure])
    for k in (0, 1):
        scene = r1_scene(math.degrees(values[k, 0]), *values[k, 1:], **effects)
        run = po.simulate(scene, 32.0, accuracy=po.Accuracy(error=1e-9), outputs=4)
        # Rounding of that many steps of order 8 adds up to about 1e-10.
        assert finer.mean_draft[k] == pytest.approx(run.mean_draft, rel=2e-9)
        assert finer.force_rms[k] == pytest.approx(run.force_rms, rel=2e-9)


@dataclass(frozen=True)
class Jumping:
    """Resistances that jump with speed and travel, and a spring that begins at a place."""

    pull: Expression
    speed: Expression
    below: Expression
    bump: Expression
    place: Expression
    spring: Expression
    begins: Expression

    def force(self, travel, speed):
        at_speed = self.pull * where(speed > self.speed, 1.0, self.below)
        return (
            at_speed
            + self.bump * where(travel > self.place, 1.0, 0.0)
            + self.spring * maximum(travel - self.begins, 0.0)
        )


def jumps(count, seed):
    """Return designs of `Jumping` and a tow speed, many with switches at zero at the start, or with two at once."""
    random, rows = np.random.default_rng(seed), []
    for _ in range(count):
        pace = random.choice([0.5, 1.0, 2.0])
        speed = random.choice([pace, 0.0, pace * random.uniform(0.5, 1.2)])
        place = random.choice([0.0, 0.1, random.uniform(-0.05, 0.5)])
        pull, below, bump = random.uniform(-300.0, 300.0), random.uniform(0.0, 1.0), random.choice([0.0, 300.0, -200.0])
        rows.append([pull, speed, below, bump, place, random.choice([0.0, 5000.0]), random.choice([0.0, 0.1]), pace])
    return rows


@pytest.mark.parametrize(
    ("start", "count"),
    [("rest", 20), *(pytest.param(start, 80, marks=pytest.mark.slow) for start in ("rest", "towed", "equilibrium"))],
)
def test_the_estimate_covers_jumps_at_the_start_and_two_at_once(start, count):
    symbols = [ca.MX.sym(f"x{k}") for k in range(8)]

    def scene(own, pace):
        return scene_of(own=(own,), start=start, tow_speed=pace, strength_wave=po.StrengthWave(0.3, 0.2))

    rows = jumps(count, 1)
    result = po.Batch(scene(Jumping(*symbols[:7]), symbols[7]), 0.4, symbols, error=1e-10)(rows)
    for k, row in enumerate(rows):
        one = Jumping(*row[:7])

        def own(travel, speed, sides, one=one):
            del speed
            at_speed = one.pull * (1.0 if sides[0] else one.below)
            return at_speed + one.bump * sides[1] + one.spring * (travel - one.begins) * sides[2]

        switches = [
            lambda _, __, speed, one=one: speed - one.speed,
            lambda _, travel, __, one=one: travel - one.place,
            lambda _, travel, __, one=one: travel - one.begins,
        ]
        mean, rms = event_splitting.averages(scene(one, row[7]), own, switches, 0.4)
        error = max(abs(result.mean_draft[k] - mean), abs(result.force_rms[k] - rms)) / max(abs(mean), rms)
        # The reference is as exact as its tolerance of 2e-13 for each step.
        assert error <= result.error_estimate[k] + 2e-12, (k, row)


def test_motions_that_forget_their_start(batch_of, r1_wave):
    result = batch_of(600.0, 1e-4, strength_wave=r1_wave)([CHAOTIC, (po.deg(25.0), 0.25, 5e4)])
    assert not result.failed.any()
    assert list(result.missed) == [True, False]
    assert result.error_estimate[0] > 1.0
    assert np.all(np.isfinite(result.mean_draft))


APART = [
    (True, 1003, {}),
    (False, 61, {}),
    pytest.param(True, 1003, {"contact": po.Smooth(0.2), "tow_ramp": 0.3, "start": "rest"}, marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("compiled", "count", "effects"), APART, ids=["compiled", "plain", "smooth contact"])
def test_designs_do_not_depend_on_each_other(batch_of, r1_wave, request, compiled, count, effects):
    if not compiled:
        request.getfixturevalue("no_compiler")
    batch = batch_of(4.0 if compiled else 1.0, 1e-5, strength_wave=r1_wave, **effects)
    assert batch.compiled == compiled
    values, random = designs(count), np.random.default_rng(1)
    # Some designs are repeated with shorter steps, and one fails.
    values[5] = CHAOTIC
    values[7, 1] = -1.0
    whole = batch(values)
    assert list(whole.reasons) == [7]
    order = random.permutation(count)
    for chosen in (order, order[:1], order[:17], order[17:60], np.array([5])):
        part = batch(values[chosen])
        for name in NAMES:
            assert np.array_equal(getattr(part, name), getattr(whole, name)[chosen], equal_nan=True), name


# --- taylor series of a batch's right-hand sides against high precision, and its operations in C and NumPy ---

ORDER = 12
# x(t): within the domain of all functions, and with all coefficients other than zero.
X_PATH = (0.4, 0.3, -0.2, 0.11, 0.07, -0.05)
ELEMENTARY = "exp expm1 log log1p sin cos tan sinh cosh tanh asin atan asinh atanh erf sqrt"
FUNCTIONS = {name: (getattr(ca, name), getattr(mp, name)) for name in ELEMENTARY.split()} | {
    "inverse": (lambda x: 1.0 / x, lambda x: 1 / x),
    "square": (lambda x: x**2, lambda x: x**2),
    "fifth": (lambda x: x**5, lambda x: x**5),
    "power": (lambda x: x**2.7, lambda x: x ** mp.mpf(2.7)),
    "power of itself": (lambda x: x**x, lambda x: x**x),
    "hypot": (lambda x: ca.hypot(x, x**2), lambda x: mp.sqrt(x**2 + x**4)),
    "quotient": (lambda x: ca.sin(x) / (1.0 + x**2), lambda x: mp.sin(x) / (1 + x**2)),
    "alike": (lambda x: (3.0 * x - 1.0) * (2.0 - x), lambda x: (3 * x - 1) * (2 - x)),
    "difference": (lambda x: x * (2.0 - x) - 2.0 * x, lambda x: -(x**2)),
    "sine of a mixture": (lambda x: ca.sin(2.0 * x - x**2 / 3.0), lambda x: mp.sin(2 * x - x**2 / 3)),
    "size": (lambda x: ca.fabs(-x) + ca.fabs(x), lambda x: 2 * x),
    "capped": (lambda x: ca.fmin(x, 0.9) * ca.fmax(x, 0.1), lambda x: x**2),
    "chosen": (lambda x: ca.if_else(x < 0.5, ca.sin(x), 7.0), mp.sin),
    "chosen by both": (lambda x: ca.if_else(ca.logic_and(x < 0.5, ca.logic_not(x <= 0.1)), x, 7.0), lambda x: x),
    "sign": (lambda x: x * ca.sign(-x), lambda x: -x),
    # Any number but 0 is true.
    "chosen by a negative number": (lambda x: ca.if_else(ca.sign(-x), ca.sin(x), 7.0), mp.sin),
}


def coefficients(function):
    x = ca.SX.sym("x")
    graph = Graph()
    given = graph.given(*(ca.SX(c) for c in X_PATH), *[ca.SX(0)] * (ORDER + 1 - len(X_PATH)))
    (series,) = series_of(graph, ca.Function("f", [x], [function(x)]), [[given]])
    for k in range(ORDER + 1):
        graph.extend(k)
    return [float(as_number(series[k])) for k in range(ORDER + 1)]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_series_of(name):
    function, precise = FUNCTIONS[name]
    with mp.workdps(60):
        path = [mp.mpf(c) for c in X_PATH]
        expected = [float(c) for c in mp.taylor(lambda t: precise(sum(c * t**k for k, c in enumerate(path))), 0, ORDER)]
    # The recurrences add up to a dozen products of coefficients that are larger than their sum.
    scale = max(abs(c) for c in expected)
    assert coefficients(function) == pytest.approx(expected, rel=2e-13, abs=1e-14 * scale)


def test_any_constant_but_0_is_true():
    x, condition = ca.SX.sym("x"), ca.SX.sym("condition")
    graph = Graph()
    given = [graph.given(ca.SX(0.4), ca.SX(0.3))], [graph.constant(ca.SX(-2.0))]
    (series,) = series_of(graph, ca.Function("f", [x, condition], [ca.if_else(condition, x, 7.0)]), given)
    for k in range(2):
        graph.extend(k)
    assert [float(as_number(series[k])) for k in range(2)] == [0.4, 0.3]


def _operations():
    """Return a Function with every operation that a batch knows, of three numbers."""
    x, y, z = (ca.SX.sym(name) for name in "xyz")
    unit = ca.tanh(x) * 0.999
    conditions = [x < y, x <= y, ca.eq(x, y), ca.ne(x, y), ca.logic_not(x < y)]
    conditions += [ca.logic_and(x < y, y < z), ca.logic_or(x < y, y < z)]
    conditions += [ca.eq(x < y, y < z), ca.ne(x < y, y < z), (x < y) + 2.0 * (y < z)]
    values = [x + y, x - y, x * y, x / z, -x, ca.exp(x), ca.log(z), z**y, z**2.5, ca.sqrt(z), x**2, 2.0 * x]
    values += [ca.sin(x), ca.cos(x), ca.tan(x), ca.asin(unit), ca.acos(unit), ca.atan(x), ca.sign(x), ca.fabs(x)]
    values += [ca.floor(x), ca.ceil(x), ca.if_else(x < y, x, z), ca.if_else(y, x, z), ca.erf(x), ca.fmin(x, y)]
    values += [ca.fmax(x, y), 1.0 / z, ca.sinh(x), ca.cosh(x), ca.tanh(x), ca.asinh(x), ca.acosh(1.0 + z)]
    values += [ca.atanh(unit), ca.atan2(x, y), ca.log1p(z), ca.expm1(x), ca.hypot(x, y), x / 7.0, 3.0 - x, x - 3.0]
    v = ca.SX.sym("v", 3)
    inner = ca.Function("inner", [x, y, z], [ca.vertcat(*conditions, *values)])
    return ca.Function("operations", [v], [inner(v[0], v[1], v[2])])


def test_operations_in_c_and_numpy(tmp_path, monkeypatch, request):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    function = _operations()
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p", 2)
    step = ca.Function("step", [x, p], [ca.vertcat(x[0] + 1.0, x[1] + x[0] / p[1])])
    engine = Engine({"operations": function}, [(step, 0)], 2)
    assert engine.compiled
    request.getfixturevalue("no_compiler")
    plain = Engine({"operations": function}, [(step, 0)], 2)
    assert not plain.compiled
    random = np.random.default_rng(0)
    rows = random.uniform([[-3.0], [-3.0], [0.1]], [[3.0], [3.0], [5.0]], (3, 203))
    rows[1, :5] = rows[0, :5]
    rows[1, 5] = 0.0
    expected = np.asarray(function.map(rows.shape[1])(rows))
    # The C library's vector functions keep four units in the last place, of which atanh near 1 makes ten times as many.
    interpreted = Interpreter(function)(rows)
    assert interpreted == pytest.approx(expected, rel=1e-14, abs=1e-15)
    for few in (1, 8, 9):  # one by one, or as arrays
        assert np.array_equal(Interpreter(function)(rows[:, :few]), interpreted[:, :few])
    assert engine.evaluate("operations", rows) == pytest.approx(expected, rel=1e-14, abs=1e-15)
    # The sum 0 + 1 + ... (n - 1) over what divides it, for each design its own number of steps.
    ends, parts = np.arange(203.0) % 17.0, random.uniform(1.0, 2.0, 203)
    order = random.permutation(203)
    for one in (engine, plain):
        states = np.zeros((2, 203))
        assert np.array_equal(one.run(np.vstack([ends, parts]), states, order, 1000), ends)
        assert states[1] == pytest.approx(ends * (ends - 1.0) / 2.0 / parts, rel=1e-14)
