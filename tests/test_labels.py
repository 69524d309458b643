"""Labels: calls in a graph that do not change its value and can be found again."""

import casadi as ca
import numpy as np
import pytest

from plough_opt.core.checks import Limit
from plough_opt.core.labels import Meanings, attach, labels_in, meaning_of

LOW = Limit("something", at_most=2.0, unit="m")
HIGH = Limit("something else", at_most=3.0)

POINT = np.array([0.7, -1.3, 2.1])


def whole(*outputs, symbol):
    return ca.Function("whole", [symbol], list(outputs), {"never_inline": True})


VALUES = {
    "scalar": lambda x: ca.sin(x[0]) * ca.exp(x[1]) + x[2] ** 3,
    "column": lambda x: ca.vertcat(x[0] * x[1], ca.cos(x[2]), x[0] ** 2),
    "matrix": lambda x: x @ x.T,
    "sparse": lambda x: ca.diag(x**2),
}


@pytest.mark.parametrize("value", VALUES.values(), ids=VALUES)
def test_value_and_all_derivatives_pass_unchanged(value):
    x = ca.MX.sym("x", 3)
    plain = value(x)
    labelled = attach(plain, ca.vertcat(x[0] * x[1], x[2]), LOW, LOW)
    assert labelled.shape == plain.shape
    found = []
    for y in (plain, labelled):
        y = ca.vec(ca.densify(y))
        jacobian = ca.jacobian(y, x)
        weights = ca.DM(np.linspace(1.0, 2.0, y.numel()))
        hessian, gradient = ca.hessian(ca.dot(weights, y), x)
        forward, reverse = ca.jtimes(y, x, ca.DM([1.0, 2.0, 3.0])), ca.jtimes(y, x, weights, True)
        third = ca.jacobian(ca.vec(hessian), x)
        function = whole(y, jacobian, gradient, hessian, forward, reverse, third, symbol=x)
        found.append([np.asarray(part) for part in function(POINT)])
    for own, wanted in zip(found[1], found[0], strict=True):
        # Differentiation through the label adds the same terms in a different order.
        np.testing.assert_allclose(own, wanted, rtol=4e-16, atol=4e-16 * np.max(np.abs(wanted)))


def test_carried_expressions_do_not_affect_the_value_even_if_undefined():
    x = ca.MX.sym("x")
    y = attach(x**3, ca.vertcat(ca.sqrt(-x), ca.log(-x)), LOW, LOW)
    hessian, gradient = ca.hessian(y, x)
    assert [float(part) for part in whole(y, gradient, hessian, symbol=x)(2.0)] == [8.0, 12.0, 12.0]


def test_labels_are_found_each_with_its_meaning():
    x = ca.MX.sym("x", 3)
    parts = [(x[0], x[2], LOW), (x[1], x[2], LOW), (x[0], x[2], HIGH), (x[0], x, LOW)]
    graph = whole(*(attach(value, carried, meaning, meaning) for value, carried, meaning in parts), symbol=x)
    found = [(meaning_of(node.which_function()), node.dep(1).numel()) for node in labels_in(graph)]
    assert sorted(found, key=str) == sorted([(LOW, 1), (LOW, 1), (HIGH, 1), (LOW, 3)], key=str)
    assert len({hash(node.which_function()) for node in labels_in(graph)}) == 3  # equal meanings share one


def called(meanings, key):
    """Return a graph that holds the only reference to the Function it calls."""
    x = ca.MX.sym("x")

    def make():
        return ca.Function("own", [x], [ca.sin(x)], {"never_inline": True}), key

    return meanings.shared(key, make)(x) + 1.0


def test_meanings_live_as_long_as_the_graphs_that_use_them():
    meanings, x, others = Meanings(), ca.MX.sym("x"), []
    kept = {k: called(meanings, k) for k in range(0, 2000, 100)}
    most = 0
    for k in range(2000, 4000):
        called(meanings, k)
        others.append(ca.Function("other", [x], [x]))  # takes the place of a freed one
        most = max(most, len(meanings))
    assert most <= 2 * (64 + len(kept))  # twice those that are alive or cached
    for key, graph in kept.items():
        assert meanings.of(graph.dep(1).dep(0).which_function()) == key


def test_a_new_function_at_a_freed_address_has_no_meaning():
    meanings, x = Meanings(), ca.MX.sym("x")
    places = {hash(meanings.shared(k, lambda: (ca.Function("own", [x], [ca.sin(x)]), "own"))) for k in range(200)}
    # The most recent Functions are cached for similar graphs.
    places -= {hash(function) for function, _ in meanings._recent.values()}
    others = [ca.Function("other", [x], [ca.cos(x)]) for _ in range(2000)]
    assert any(hash(other) in places for other in others)  # else this shows nothing
    assert all(meanings.of(other) is None for other in others)
