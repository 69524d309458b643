"""Calibration by few rows: what they determine, which unknowns they cannot tell apart, and what is missing."""

import copy
import dataclasses
import math
import re

import numpy as np
import pytest
from helpers.known_soil import BOUNDS, TRUTH, drafts, steady_scene

import plough_opt as po

# --- tables of few, equal, weightless, doubled and permuted rows, and of errors that are proportional to the draft ---

COHESION = {"soil.cohesion": ("1 kPa", "80 kPa")}
BOTH = COHESION | {"soil.tool_friction": (0.05, 1.5)}
LOSSES = ("squares", "soft_l1")


def table(rows, seed=0, **options):
    """Return measured drafts at random speeds and angles, with errors of 3 %."""
    rng = np.random.default_rng(seed)
    speed, angle = rng.uniform(0.8, 3.0, rows), rng.uniform(0.45, 0.95, rows)
    exact = [float(steady_scene(v, a).steady_resistance) for v, a in zip(speed, angle, strict=True)]
    values = np.array(exact) * (1.0 + 0.03 * rng.standard_normal(rows))
    return po.Measurements("mean_draft", values, {"scene.tow_speed": speed, "share.wedge_angle": angle}, **options)


@pytest.mark.parametrize("seed", [*range(4, 12), *(pytest.param(k, marks=pytest.mark.slow) for k in range(12, 80))])
def test_any_small_table_gives_an_answer_or_an_input_error(seed):
    """Equal rows, constant columns, zeros, huge and tiny numbers and weights."""
    rng = np.random.default_rng(seed)
    rows = int(rng.integers(1, 6))
    data = table(rows, seed)
    values, conditions = data.values.copy(), {key: column.copy() for key, column in data.conditions.items()}
    weights = rng.choice([0.0, 1.0, 1e-12, 1e12], rows) if rng.random() < 0.4 else None
    match int(rng.integers(6)):
        case 0:
            values[:] = values[0]
        case 1:
            conditions["scene.tow_speed"][:] = 2.0
        case 2:
            values[rng.integers(rows)] = rng.choice([0.0, 1e12, 1e-12, -1e3, np.nan, np.inf])
        case 3:
            values[:] = 0.0
        case 4:
            conditions = {key: np.full(rows, column[0]) for key, column in conditions.items()}
    try:
        data = po.Measurements("mean_draft", values, conditions, weights=weights)
        sets = [data, table(2, seed + 100)] if rng.random() < 0.3 else data
        fit = po.calibrate(
            steady_scene(), sets, COHESION if seed % 2 else BOTH, loss=str(rng.choice(LOSSES)), starts=2,
            errors=str(rng.choice(["constant", "relative"])),
        )  # fmt: skip
    except (po.InputError, po.NotConverged) as error:
        refusal = str(error)
    else:
        refusal = ""
    if refusal:
        assert refusal.partition(":")[2]
        return
    assert all(np.isfinite(value) for value in (*fit.values.values(), fit.scatter, *fit.optima))
    assert not any(np.isnan(end) for interval in fit.intervals().values() for end in interval)
    assert str(fit) == str(copy.deepcopy(fit))


NAMES = ("soil.cohesion", "soil.tool_friction", "effects.rate_term")
UNKNOWN = {name: (*BOUNDS[name], TRUTH[name]) for name in NAMES}
CONDITIONS, EXACT = drafts(np.linspace(0.8, 3.0, 6), np.radians([25.0, 35.0, 45.0, 55.0]))


def test_errors_that_grow_with_the_draft_are_told():
    """Of 15 sets with proportional errors most, and of 15 with equal ones hardly one."""
    data, rng, told = po.Measurements("mean_draft", EXACT, CONDITIONS), np.random.default_rng(1), []
    own = po.Calibration(steady_scene(), data, UNKNOWN, starts=1)
    for size in (EXACT, np.full(len(EXACT), np.mean(EXACT))):
        fits = [own.fit(EXACT + 0.03 * size * rng.standard_normal(len(EXACT))) for _ in range(15)]
        told.append(sum(any("residuals grow" in text for text in fit.warnings) for fit in fits))
    assert told[0] > 9
    assert told[1] < 3


def test_the_fit_is_that_of_iterated_weights():
    """Against weights over the predictions of the fit, which repeated fits with weights lead to."""
    noisy = EXACT * (1.0 + 0.1 * np.random.default_rng(3).standard_normal(len(EXACT)))
    found = po.calibrate(steady_scene(), po.Measurements("mean_draft", noisy, CONDITIONS), UNKNOWN, errors="relative")
    size = noisy
    for _ in range(8):
        data = po.Measurements("mean_draft", noisy, CONDITIONS, weights=1.0 / size**2)
        fit = po.calibrate(steady_scene(), data, UNKNOWN, starts=1)
        size = fit.predicted
    # Weights settle to 1e-4, and the search to 1e-4 of a standard error.
    for name in NAMES:
        assert abs(found.values[name] - fit.values[name]) < 1e-3 * fit.standard_errors[name]
        assert found.standard_errors[name] == pytest.approx(fit.standard_errors[name], rel=1e-3)
    freedom = len(EXACT) - len(NAMES)
    assert found.scatter == pytest.approx(np.sqrt(np.sum((found.residuals / found.predicted) ** 2) / freedom), rel=1e-6)
    assert "of the predicted values" in str(found)


# --- undetermined combinations, against closed forms of the model's own degeneracies ---

STRENGTH = {name: BOUNDS[name] for name in ("soil.cohesion", "soil.ambient_pressure", "soil.tool_friction")}


@pytest.fixture(scope="module")
def confounded(measured):
    """Cohesion and ambient pressure, which enter the draft together, beside a tool friction that does not."""
    return po.calibrate(steady_scene(), measured, STRENGTH)


def test_no_draft_separates_cohesion_and_ambient_pressure(confounded):
    (found,) = confounded.unidentifiable
    assert found.structural
    # F0 goes with nu p_a + 2 k cos(theta)/(1 + sin(theta)): p_a can be offset by tan(theta) of itself in cohesion.
    ratio = found.changes["soil.cohesion"] / found.changes["soil.ambient_pressure"]
    assert ratio == pytest.approx(-math.tan(TRUTH["soil.friction_angle"]), rel=1e-9)
    more, less = re.search(r"more ([\w.]+) can be offset by .+ less ([\w.]+)$", found.words).groups()
    assert {more, less} == set(found.changes) == {"soil.cohesion", "soil.ambient_pressure"}


def test_undetermined_unknowns_have_infinite_intervals(confounded):
    determined = {name: error < math.inf for name, error in confounded.standard_errors.items()}
    assert determined == {"soil.cohesion": False, "soil.ambient_pressure": False, "soil.tool_friction": True}
    for name, interval in confounded.intervals().items():
        assert [math.isfinite(end) for end in interval] == [determined[name]] * 2
    assert confounded.standard_errors["soil.cohesion"] == math.inf
    assert confounded.correlations == {}
    assert np.all(np.isfinite([row.standard_error for row in confounded.rows]))


def test_an_unknown_without_effect_is_named(measured):
    unknown = {"soil.cohesion": BOUNDS["soil.cohesion"], "scene.stiffness": (1e4, 1e6)}
    fit = po.calibrate(steady_scene(), measured, unknown)
    (found,) = fit.unidentifiable
    assert found.words.startswith("scene.stiffness has no effect")
    # It stays at its guess, the scene's own.
    assert fit.values["scene.stiffness"] == pytest.approx(5e4, rel=1e-3)


def test_six_unknowns_are_separated_into_determined_and_undetermined(measured):
    fit = po.calibrate(steady_scene(), measured, BOUNDS)
    # Of F0's strength, the drag beside it, tool friction and rate term the data determine four combinations of six.
    assert sum(found.structural for found in fit.unidentifiable) == 2
    named = {name for found in fit.unidentifiable for name in found.changes}
    assert {"soil.cohesion", "soil.ambient_pressure", "soil.friction_angle", "soil.density_ratio"} <= named
    determined = {name for name, error in fit.standard_errors.items() if error < math.inf}
    assert determined == {"soil.tool_friction", "effects.rate_term"}


def test_a_direct_measurement_of_an_unknown_determines_all(measured):
    shear = po.Measurements("soil.ambient_pressure", [60e3], sigma=2e3, name="shear test")
    fit = po.calibrate(steady_scene(), [measured, shear], STRENGTH)
    assert fit.unidentifiable == ()
    assert fit.standard_errors["soil.ambient_pressure"] == pytest.approx(2e3, rel=1e-3)
    assert all("shear" not in row.place for row in fit.hold_out(0.9).rows)


# --- strength factor and density ratio from a penetrometer and the width of a trench, with intervals ---

BASE = dataclasses.replace(po.named_soil("firm sandy loam"), ambient_pressure=5e3)
CONE = po.Cone(po.deg(13.0), 0.24)
SCENE = po.Scene(BASE, CONE, 5e5, 60.0, 1.4, po.Effects(motion=False))
TWO_UNKNOWN = {"soil.strength_factor": (0.1, 200.0), "soil.density_ratio": (0.4, 0.97)}
INDEX, RADIUS = 1.6e6, 0.15


def index_of(density_ratio):
    """Return the law's cone index [Pa] at a density ratio, which tests/test_cone_index.py compares with mpmath."""
    return po.cone_index(dataclasses.replace(BASE, density_ratio=density_ratio))


def ratio_of(radius, cone=CONE):
    """Return the density ratio at which a cone loosens a radius [m]: r* = h tan(beta)/sqrt(1 - b1)."""
    return 1.0 - (cone.height * math.tan(cone.half_angle) / radius) ** 2


def fitted(indices, radii, errors):
    columns = zip(("cone_index", "loosened_radius"), (indices, radii), errors, strict=True)
    return po.calibrate(SCENE, [po.Measurements(name, own, sigma=error) for name, own, error in columns], TWO_UNKNOWN)


def test_one_reading_of_each_determines_both():
    fit = fitted([INDEX], [RADIUS], (1e-3 * INDEX, 1e-3 * RADIUS))
    ratio = ratio_of(RADIUS)
    truth = {"soil.strength_factor": INDEX / index_of(ratio), "soil.density_ratio": ratio}
    assert fit.values == pytest.approx(truth, rel=1e-7)  # of the least squares' steps
    assert [po.cone_index(fit.soil), po.loosened_radius(CONE, fit.soil)] == pytest.approx([INDEX, RADIUS], rel=1e-7)
    assert fit.plot().axes[1].get_xlabel() == "number of the row"
    with pytest.raises(po.InputError, match="leaves fewer than the 2 that 2 unknowns need"):
        fit.hold_out()


def test_errors_agree_with_propagation():
    """By hand: 1 - b1 goes with r^-2; the strength factor with the reading, and against the law's index at that b1."""
    fit = fitted([INDEX], [RADIUS], (1e5, 2e-3))
    ratio, errors = ratio_of(RADIUS), fit.standard_errors
    of_ratio = 2.0 * (1.0 - ratio) * 2e-3 / RADIUS
    slope = math.log(index_of(ratio + 1e-5) / index_of(ratio - 1e-5)) / 2e-5
    assert errors["soil.density_ratio"] == pytest.approx(of_ratio, rel=1e-6)
    relative = errors["soil.strength_factor"] / fit.values["soil.strength_factor"]
    assert relative == pytest.approx(math.hypot(1e5 / INDEX, slope * of_ratio), rel=1e-5)
