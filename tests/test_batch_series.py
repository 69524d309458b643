"""Taylor series of a batch's right-hand sides against high precision, and its operations in C and NumPy."""

import casadi as ca
import mpmath as mp
import numpy as np
import pytest

from plough_opt.core.expressions import as_number
from plough_opt.motion.batch.series import Engine, Graph, Interpreter, series_of

ORDER = 12
# x(t): within the domain of all functions, and with all coefficients other than zero.
PATH = (0.4, 0.3, -0.2, 0.11, 0.07, -0.05)
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
    given = graph.given(*(ca.SX(c) for c in PATH), *[ca.SX(0)] * (ORDER + 1 - len(PATH)))
    (series,) = series_of(graph, ca.Function("f", [x], [function(x)]), [[given]])
    for k in range(ORDER + 1):
        graph.extend(k)
    return [float(as_number(series[k])) for k in range(ORDER + 1)]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_series_of(name):
    function, precise = FUNCTIONS[name]
    with mp.workdps(60):
        path = [mp.mpf(c) for c in PATH]
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


def test_operations_in_c_and_numpy(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    function = _operations()
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p", 2)
    step = ca.Function("step", [x, p], [ca.vertcat(x[0] + 1.0, x[1] + x[0] / p[1])])
    engine = Engine({"operations": function}, [(step, 0)], 2)
    assert engine.compiled
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
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
