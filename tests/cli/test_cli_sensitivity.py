"""`plough-opt optimise --sensitivity`: elasticities of every quantity of the file and of the limits that decide."""

import contextlib
import io
import json

import pytest
from test_cli import cells

import plough_opt as po
from plough_opt.app import main
from plough_opt.core.quantities import QUANTITIES
from plough_opt.problem_file import read_problem


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """Return a quasi-static problem, one quantity in a customary unit, one requirement that decides and one not."""
    path = tmp_path_factory.mktemp("problems") / "static.toml"
    path.write_text(
        """
title = "static"
[soil]
name = "serozem"
cohesion = "20 kPa"
[share]
chisel_angle = "15 deg"
[scene]
tow_speed = "7.2 km/h"
frame_mass = "20 kg"
stiffness = "50 kN/m"
duration = "1 s"
outputs = 10
[effects]
motion = false
[variables]
"share.wedge_angle" = { lower = "5 deg", upper = "60 deg", guess = "25 deg" }
"share.height" = { lower = "0.1 m", upper = "0.5 m", guess = "0.25 m" }
[minimise]
mean_draft = { per = "1 kN" }
[require]
loosened_radius = { at_least = "0.15 m" }
half_angle = { at_most = "15 deg" }
mean_deflection = { at_most = "1 m" }
""",
        encoding="utf-8",
    )
    return path


@pytest.fixture(scope="module")
def saved(file, tmp_path_factory):
    """Return the optimum with its sensitivities, as JSON and read back."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        assert main(["optimise", str(file), "--sensitivity", "--json"]) == 0
    path = tmp_path_factory.mktemp("results") / "best.json"
    path.write_text(out.getvalue(), encoding="utf-8")
    return json.loads(out.getvalue()), po.load(path)


@pytest.mark.parametrize(
    ("name", "key", "value"),
    [
        ("soil.cohesion", "soil.cohesion", "{} Pa"),
        ("soil.ambient_pressure", "soil.ambient_pressure", "{} Pa"),  # of the named soil, not in the file
        ("half_angle at_most", "require.half_angle.at_most", "{} rad"),
    ],
)
def test_it_is_the_file_solved_again_with_another_value(file, saved, name, key, value):
    (found,) = [item for item in saved[1].sensitivities if item.name == name]
    assert saved[1].run.scene.soil.name == "serozem, changed"  # as in the file

    def objective(factor):
        text = value.format(repr(factor * found.value))
        return read_problem(file, [f'{key}="{text}"']).optimise()[0].objective

    one, two = (objective(1.0 + s) - objective(1.0 - s) for s in (1e-3, 2e-3))
    slope = (8.0 * one - two) / 12e-3
    # An objective good to 1e-12 over a step of 1e-3, and the step to the fourth power.
    assert found.elasticity == pytest.approx(slope / saved[1].objective, rel=1e-8, abs=1e-9)


def test_the_table_has_every_quantity_that_matters_in_order_of_size(cli, file, saved):
    done = cli("optimise", file, "--sensitivity")
    assert (done.status, done.err) == (0, "")
    names = [item.name for item in saved[1].sensitivities]
    sizes = [abs(item.elasticity) for item in saved[1].sensitivities]
    assert sizes == sorted(sizes, reverse=True)
    # No mass moves, no spring deflects to its limit, and the plastic gas has no Young's modulus.
    soil = "density density_ratio cohesion friction_angle tool_friction ambient_pressure strength_factor"
    others = {"share.chisel_angle", "scene.tow_speed", "scene.stiffness"}
    limits = {"loosened_radius at_least", "half_angle at_most"}
    assert {*names} == {f"soil.{name}" for name in soil.split()} | others | limits
    places = [done.out.index(f"│ {name} ") for name in names]
    assert places == sorted(places)
    assert cells(done.out, "scene.tow_speed")[0] == "7.2 km/h"
    for item in saved[1].sensitivities:
        shown = f"{item.elasticity:+.3g}" if abs(item.elasticity) > 1e-9 else "0"
        assert cells(done.out, item.name)[1] == shown
    (radius,) = [item for item in saved[1].sensitivities if item.name == "loosened_radius at_least"]
    # The front's radius is proportional to the height, the draft to its square; the angle keeps it.
    assert cells(done.out, radius.name)[1:4] == [f"{radius.elasticity:+.3g}", "0", "+1"]


def test_an_optimum_that_is_not_unique_is_printed_with_a_note(cli, file):
    text = file.read_text(encoding="utf-8").replace('stiffness = "50 kN/m"', "")
    text = text.replace("[variables]", '[variables]\n"scene.stiffness" = { lower = "1 kN/m", upper = "9 kN/m" }')
    flat = file.with_name("flat.toml")
    flat.write_text(text.replace('mean_deflection = { at_most = "1 m" }', ""), encoding="utf-8")
    done = cli("optimise", flat, "--sensitivity")
    assert done.status == 0
    assert "not unique" in done.out
    assert "note: no sensitivities: the optimum is not unique" in " ".join(done.err.split())
    assert "one per cent" not in done.out


def test_no_range_leaves_the_models_domain(cli, cotton):
    """Half a revolution of friction or a chisel of 103 degrees is neither soil nor share, whatever the slopes say."""
    short = ("--set", "scene.duration=0.5 s", "--search", "near")
    saved = json.loads(cli("optimise", cotton, "--sensitivity", "--json", *short).out)
    ends = {item["name"]: (item["valid_from"], item["valid_to"], item["then"]) for item in saved["sensitivities"]}
    assert len(ends) > 10
    reached = 0
    for name, (low, high, then) in ends.items():
        quantity = QUANTITIES.get(name.partition(" ")[0])
        if quantity is None:
            continue
        for end, side, limit in ((low, then[0], quantity.low), (high, then[1], quantity.high)):
            assert end is None or quantity.low <= end <= quantity.high, name
            if side == "the model's domain ends":
                reached += 1
                assert end == limit
    assert reached > 0
