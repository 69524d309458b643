"""Flat directions of optima that are not unique, and stationary points that are not minima."""

import re

import numpy as np
import pytest
from helpers.small_designs import design, sticking

import plough_opt as po


def test_wedge_and_chisel_angle_cannot_be_told_apart(r1_soil):
    # Both angles are free, and only the cone's half angle matters.
    d = po.Design()
    angle = d.variable("wedge angle", guess=po.deg(25.0), lower=po.deg(5.0), upper=po.deg(60.0), unit="rad")
    chisel = d.variable("chisel angle", guess=po.deg(15.0), lower=po.deg(5.0), upper=po.deg(30.0), unit="rad")
    height = d.variable("height", guess=0.25, lower=0.10, upper=0.50, unit="m")
    share = po.Wedge(angle, chisel, height)
    cone = share.equivalent_cone()
    scene = po.Scene(r1_soil, share, 2e4, 25.0, 2.0, po.Effects(strength_wave=po.StrengthWave(0.3, 0.6), damping=300.0))
    run = po.simulate(scene, 1.0)
    d.minimise(run.mean_draft / 1e3 + run.force_rms / 1e3)
    d.require("loosened radius", po.loosened_radius(cone, r1_soil), at_least=0.12, unit="m")
    d.require("half angle", cone.half_angle, at_most=po.deg(15.0), unit="rad")
    best = d.solve(search="local")
    assert best.status == "not unique"
    (direction,) = best.flat_directions
    assert abs(direction["height"]) < 1e-6
    # One angle grows while the other one shrinks.
    assert re.search(r"wedge angle (\+.* chisel angle -|-.* chisel angle \+)", " ".join(str(best).split()))

    def change(part):
        moved = (best.variables[name] + part * direction[name] for name in ("wedge angle", "chisel angle"))
        return abs(po.Wedge(*moved, 0.3).equivalent_cone().half_angle - best(cone).half_angle)

    # A tangent: a tenth of the step leaves a hundredth of the change. Across it 0.3 rad change for one of wedge angle.
    assert change(0.1) / change(1.0) == pytest.approx(0.01, rel=0.1)
    assert change(0.1) < 1e-2 * abs(0.1 * direction["wedge angle"])


# Objective, limits of the sum x + y, the best objective, and a basis of the flat directions.
VALLEYS = {
    "idle variable": (lambda x, _: 1.0 + (x - 0.25) ** 2, {"at_most": 3.0}, 1.0, [[0.0, 1.0]]),
    "total in the objective": (lambda x, y: 1.0 + (x + y - 1.2) ** 2, {"at_most": 3.0}, 1.0, [[1.0, -1.0]]),
    "zero at the optimum": (lambda x, y: (x + y - 0.7) ** 2, {"at_most": 3.0}, 0.0, [[1.0, -1.0]]),
    "total at an active limit": (lambda x, y: x + y, {"at_least": 0.7}, 0.7, [[1.0, -1.0]]),
    "constant objective": (lambda _x, _y: 1.0, {"at_most": 2.5}, 1.0, [[1.0, 0.0], [0.0, 1.0]]),
    "steep": (lambda x, y: 1.0 + 1e4 * (x - 0.25) ** 2 + (y - 0.5) ** 2, {"at_most": 3.0}, 1.0, []),
    "gentle": (lambda x, y: 1.0 + (x - 0.25) ** 2 + 1e-4 * (y - 0.5) ** 2, {"at_most": 3.0}, 1.0, []),
    "quartic": (lambda x, y: 1.0 + (x - 0.25) ** 2 + (y - 0.5) ** 4, {"at_most": 3.0}, 1.0, []),
    "corner": (lambda x, y: x + 2.0 * y + 1.0, {"at_most": 3.0}, 1.0, []),
}


@pytest.mark.parametrize(("objective", "limits", "least", "basis"), VALLEYS.values(), ids=VALLEYS)
def test_flat_directions_known_by_hand(objective, limits, least, basis):
    d, x, y = design(x=(0.9, 0.0, 1.0), y=(0.3, 0.0, 2.0))
    d.minimise(objective(x, y))
    d.require("sum", x + y, **limits)
    best = d.solve()
    assert best.status == ("not unique" if basis else "solved")
    assert best.objective == pytest.approx(least, abs=1e-8)
    assert len(best.flat_directions) == len(basis)
    if basis:
        found = np.array([[direction["x"], direction["y"]] for direction in best.flat_directions])
        assert np.linalg.matrix_rank(found) == len(basis)
        # Each is a step of 1 % of the range of the variable that changes most, within the space of the basis.
        assert np.max(np.abs(found) / [1.0, 2.0], axis=1) == pytest.approx(0.01, rel=1e-9)
        assert found @ (np.eye(2) - np.linalg.pinv(basis) @ basis) == pytest.approx(0.0, abs=1e-8)


# --- stationary points that are not minima ------------------------------------------------------------------


@pytest.mark.parametrize("search", ["auto", "near"])
@pytest.mark.parametrize(("others", "lean"), [(0, 0.8), (0, -0.8), (1, 0.8)])
def test_a_start_on_a_hilltop_or_a_saddle_is_left_on_the_lower_side(others, lean, search):
    d, x = design(x=(0.5, 0.0, 1.0))
    hill = 2.0 - (x - 0.5) ** 2 - lean * (x - 0.5) ** 3
    for k in range(others):
        hill += (d.variable(f"y{k}", guess=0.5, lower=0.0, upper=1.0) - 0.3) ** 2
    d.minimise(hill)
    # The gradient is zero at the start; the ends of x are 0.15 and 0.35 lower.
    assert d.solve(search=search).objective == pytest.approx(1.65, rel=1e-8)


def test_the_hilltops_of_several_variables_are_all_left():
    """Also if a run's events leave the descents to IPOPT, which moves one variable after the other."""
    d, *x = design(**{f"x{k}": (0.5, 0.0, 1.0) for k in range(4)})
    d.minimise(2.0 - sum((v - 0.5) ** 2 + 0.8 * (v - 0.5) ** 3 for v in x) + 1e-12 * sticking((x[0] - 0.5) ** 2))
    assert d.solve(search="near").objective == pytest.approx(2.0 - 4 * 0.35, rel=1e-7)


def test_a_saddle_with_too_little_to_gain_is_an_answer():
    d, x, y = design(x=(0.5, 0.0, 1.0), y=(0.5, 0.0, 1.0))
    # The ends of x are lower by 1e-7, which a descent takes for rounding, and there is nothing else to move to.
    d.minimise(1.0 - 4e-7 * (x - 0.5) ** 2 + (y - 0.5) ** 2)
    best = d.solve(search="near")
    assert best.status == "solved"
    assert best.objective == pytest.approx(1.0, abs=2e-7)
