"""Sweeps of problem files: the results of single runs, optimisations and batches, and ranges written as texts."""

import math
import pickle

import numpy as np
import pytest
from helpers.problem_files import PROBLEMS, REFERENCE, SUBSOILER
from helpers.refusals import refusals

import plough_opt as po
from plough_opt.core.units import Unit
from plough_opt.problem_file.ranges import read_axis
from plough_opt.problem_file.sweep import plan_of
from plough_opt.studies.sweep import engine

# A design of the wedge angle and the height, without motion: quick to solve.
STEADY = ("effects.motion=false", "scene.duration=0.5 s", "scene.stiffness=50 kN/m")
BRIEF = ("scene.duration=0.2 s", "scene.outputs=40")
OVER = {"soil.cohesion": "5..45 kPa:3", "scene.tow_speed": po.Range(1.0, 3.0, 3)}


@pytest.fixture(scope="module")
def problem():
    return po.read_problem(SUBSOILER, BRIEF)


def test_every_point_has_the_results_of_a_single_simulation(problem, inline):
    table = po.sweep(problem, OVER, executor=inline).table
    assert len(table) == 9
    for row in table:
        changes = (f"soil.cohesion={row['soil.cohesion'] / 1e3} kPa", f"scene.tow_speed={row['scene.tow_speed']} m/s")
        run = po.read_problem(SUBSOILER, (*BRIEF, *changes)).simulate()
        for name in ("mean_draft", "force_rms", "mean_deflection", "tow_power", "peak_force", "error_estimate"):
            assert row[name] == getattr(run, name)
        assert row["loosened_radius"] == run.scene.loosened_radius
        assert row["moving_mass"] == run.scene.mass


def test_each_warning_is_kept_once_with_the_number_of_its_points_and_the_range_of_its_numbers(problem, inline):
    over = {"share.wedge_angle": "30, 55 deg", "soil.cohesion": "3, 40 kPa", "share.height": "1e-170, 0.2 m"}
    swept = po.sweep(problem, over, executor=inline)
    assert [*swept.failures] == [0, 2, 4, 6]  # a share so small that its loosened section is 0 fails
    assert [note.partition(":")[0] for note in swept.notes] == ["at 4 of 8 points", "at 2 of 8 points"]
    most, least = (100.0 * problem.scene({"soil.cohesion": cohesion}).ambient_share for cohesion in (3e3, 40e3))
    assert f"ambient pressure (101.3 kPa) carries {least:.0f} to {most:.0f} %" in swept.notes[0]
    assert "above 20 deg the hypothesis of plane sections does not hold" in swept.notes[1]
    # A batch is told of the ends of all ranges before it begins.
    batch = plan_of(problem, {"soil.cohesion": "3, 40 kPa"}, method="batch").notes
    assert [note for note in batch if f"at an end: ambient pressure (101.3 kPa) carries {most:.0f} %" in note]


def test_an_optimum_does_not_depend_on_the_point_before(inline):
    problem = po.read_problem(REFERENCE, STEADY)
    forwards = po.sweep(problem, {"soil.cohesion": [10e3, 20e3]}, what="optimise", executor=inline).table
    changed = po.read_problem(REFERENCE, (*STEADY, "soil.cohesion=20 kPa"))
    best, run = changed.optimise()
    assert forwards["objective"][1] == best.objective
    assert forwards["share.height"][1] == best.variables["share.height"]
    assert forwards["mean_draft"][1] == run.mean_draft
    assert forwards["margin of loosened_radius"][1] == best.margins["loosened_radius"]


BOX = {"share.wedge_angle": "25..39 deg", "share.height": "0.18..0.28 m", "scene.stiffness": "40..1000 kN/m log"}


class TestMany:
    """Sweeps by `po.Batch`."""

    def test_a_design_has_the_same_bits_in_a_batch_of_any_size(self, problem, inline, monkeypatch):
        tables = []
        for size in (32, 1, 3, 13):
            monkeypatch.setattr(engine, "_MOST", size)
            tables.append(po.sweep(problem, BOX, samples=32, method="batch", executor=inline).table.tolist())
        assert tables[1:] == tables[:1] * 3
        plan = plan_of(problem, BOX, samples=2, method="batch")
        places = [dict(zip(BOX, values, strict=True)) for values in ([0.5, 0.2, 1e5], [-0.5, 0.2, 1e5])]
        answers = pickle.loads(pickle.dumps(plan.function)).many(places)
        assert [bool(answer.reason) for answer in answers] == [False, True]  # outside the domain

    def test_results_are_those_of_single_simulations_to_the_wanted_error(self, problem, inline):
        options = {"samples": 16, "executor": inline}
        table, single = (po.sweep(problem, BOX, method=method, **options).table for method in ("batch", "each"))
        assert list(table.dtype.names) == [name for name in single.dtype.names if not name.startswith("peak_")]
        for name in ("mean_draft", "force_rms"):
            # Both have errors up to 1e-8 of the larger of mean draft and RMS force.
            assert np.max(np.abs(table[name] - single[name]) / single["mean_draft"]) < 2e-8
        for name in ("loosened_radius", "half_angle", "moving_mass", "added_mass", "specific_draft", "cone_index"):
            np.testing.assert_allclose(table[name], single[name], rtol=3e-8)
        assert np.max(table["error_estimate"]) < 1e-8

    def test_a_batch_is_used_for_many_points_of_a_scene_that_it_supports(self, problem):
        axes = {"soil.cohesion": po.Range(1e4, 2e4, 100), "scene.tow_speed": po.Range(1.0, 2.0, 100)}
        assert "po.Batch" in plan_of(problem, axes).how
        assert "po.simulate" in plan_of(problem, {**axes, "scene.tow_speed": po.Range(1.0, 2.0, 99)}).how
        assert "po.simulate" in plan_of(problem, axes, method="each").how
        sticky = po.read_problem(PROBLEMS / "stick_slip.toml")
        assert "po.simulate" in plan_of(sticky, axes).how
        with pytest.raises(po.InputError, match="events"):
            plan_of(sticky, axes, method="batch")

    def test_a_batch_of_periodic_orbits(self, inline):
        changed = ("effects.damping=10 N*s/m", "effects.strength_wave.amplitude=1.0", "share.height=45 cm")
        problem = po.read_problem(PROBLEMS / "draft_oscillation_loosening.toml", changed)
        axes = {"scene.stiffness": [3e3, 5e3, 1e4, 1e5], "scene.tow_speed": [1.5, 3.0]}
        batch, single = (po.sweep(problem, axes, method=method, executor=inline) for method in ("batch", "each"))
        for name in ("mean_draft", "force_rms", "tow_power", "loosened_radius"):
            np.testing.assert_allclose(batch.column(name), single.column(name), rtol=1e-6)
        unstable = [[note for note in one.notes if "the orbit is unstable" in note] for one in (batch, single)]
        assert [*map(bool, unstable)] == [True, True]


TEXTS = [
    ("5..45 kPa:3", "Pa", (5e3, 25e3, 45e3)),
    ("10..1000 kN/m:3 log", "N/m", (1e4, 1e5, 1e6)),
    ("500 g..2 kg:3", "kg", (0.5, 1.25, 2.0)),
    ("20..40 deg:2", "rad", (20 * math.pi / 180, 40 * math.pi / 180)),
    ("1..7 km/h:61", "m/s", tuple(Unit("m/s").parse(f"{1 + k / 10:.1f} km/h") for k in range(61))),
    ("5..45 kPa log", "Pa", po.Range(5e3, 45e3, log=True)),
]


@pytest.mark.parametrize(("text", "unit", "expected"), TEXTS)
def test_texts_of_grids_lists_and_samples(text, unit, expected):
    # To the last bit, as from a file.
    assert read_axis(text, Unit(unit), sampled=isinstance(expected, po.Range))[0] == expected


def axis(text, sampled=False):
    return read_axis(text, Unit("Pa"), sampled=sampled)


test_invalid_texts_are_refused = refusals(
    po.InputError,
    (lambda: axis("5..5 kPa:9"), "lower 5 is not below upper 5"),
    (lambda: axis("5..45:9"), '"5" has no unit'),
    (lambda: axis("5..45 kPa"), "is not a range with a number of values"),
    (lambda: axis("5..45 kPa:9", True), "is not the range of a sample"),
    (lambda: axis("5 kPa"), "is one value"),
    (lambda: axis("0..5 kPa:3 log"), "needs a lower bound above 0"),
    (lambda: axis("5, 5 kPa"), "same value twice"),
)
REFUSED = [
    ({"soil.cohesion": [-1e4, 2e4]}, {}, "cohesion = -10000 Pa"),
    ({"soil.cohesion": [1e4, 2e4]}, {"what": "optimize"}, "did you mean 'optimise'"),
    ({"soil.cohesion": [1e4, 2e4]}, {"what": "optimise", "method": "batch"}, "a batch cannot optimise"),
    (dict(zip(BOX, ([0.4, 0.5], [0.2, 0.3], [5e4, 6e4]), strict=True)), {"what": "optimise"}, "variable is fixed"),
]


@pytest.mark.parametrize(("over", "more", "expected"), REFUSED)
def test_invalid_sweeps_are_refused_before_anything_is_computed(problem, inline, over, more, expected):
    with pytest.raises(po.InputError, match=expected):
        po.sweep(problem, over, executor=inline, **more)
