"""ASABE D497: the form against a published example, the subsoiler's rows by hand, refusals, symbols."""

import casadi as ca
import numpy as np
import pytest

import plough_opt as po
from plough_opt.laws.tines import draft_of_row
from plough_opt.studies.crosscheck import asabe_draft

KM_PER_H = 1 / 3.6


def test_the_form_is_that_of_a_published_example():
    """A chisel plough: 0.7 [91 + 5.4 x 10 + 0] 45 tools x 15 cm = 68 512.5 N at 10 km/h."""
    assert draft_of_row((91.0, 5.4, 0.0), 0.7, 0.15, 10 * KM_PER_H, 45) == pytest.approx(68512.5, rel=1e-14)


BY_HAND = [
    ("narrow", "fine", (9.69, 10.84, 12.57, 14.87)),
    ("narrow", "medium", (6.78, 7.59, 8.80, 10.41)),
    ("winged", "coarse", (5.68, 6.37, 7.41, 8.79)),
]


@pytest.mark.parametrize(("point", "texture", "kilonewtons"), BY_HAND)
def test_the_subsoilers_rows_by_hand(point, texture, kilonewtons):
    """At 40 cm and 3, 5, 7 and 9 km/h, worked by hand to two decimals."""
    speeds = np.array([3.0, 5.0, 7.0, 9.0]) * KM_PER_H
    found = asabe_draft(0.4, speeds, texture, point=point) / 1e3
    assert found == pytest.approx(kilonewtons, abs=0.0051)
    assert asabe_draft(0.4, speeds[0], texture, point=point, shanks=3) == pytest.approx(3e3 * found[0], rel=1e-15)


def test_symbols_give_the_numbers():
    x = ca.SX.sym("x", 2)
    symbolic = ca.Function("f", [x], [asabe_draft(*ca.vertsplit(x), "medium")])
    assert float(symbolic([0.35, 1.7])) == pytest.approx(asabe_draft(0.35, 1.7, "medium"), rel=1e-15)


REFUSED = [
    ((0.4, 1.0, "fin"), {}, po.InputError, "did you mean 'fine'"),
    ((0.4, 1.0, "fine"), {"point": "wing"}, po.InputError, "did you mean 'winged'"),
    ((0.0, 1.0, "fine"), {}, po.DomainError, "working depth"),
    ((0.4, -1.0, "fine"), {}, po.DomainError, "speed"),
    ((0.4, 1.0, "fine"), {"shanks": 0}, po.DomainError, "shanks"),
]


@pytest.mark.parametrize(("arguments", "options", "error", "words"), REFUSED)
def test_refusals(arguments, options, error, words):
    with pytest.raises(error, match=words):
        asabe_draft(*arguments, **options)
