"""`plough-opt optimise --sensitivity`: elasticities of every quantity of the file and of the limits that decide."""

import json
from itertools import pairwise

import pytest
from helpers.commands import call, cells, printed
from helpers.problem_files import STATIC, SUBSOILER, changed

import plough_opt as po
from plough_opt.core.quantities import QUANTITIES

# One quantity in a customary unit, one requirement that decides and one that does not.
FREE = '"share.wedge_angle" = { lower = "5 deg", upper = "60 deg", guess = "25 deg" }'
LIMITS = 'half_angle = { at_most = "15 deg" }\nmean_deflection = { at_most = "1 m" }\n'
TEXT = changed(
    ('wedge_angle = "35 deg"\n', ""), ("[variables]", f"[variables]\n{FREE}"),
    ('name = "serozem"', 'name = "serozem"\ncohesion = "20 kPa"'), ("0.12 m", "0.15 m"), text=STATIC + LIMITS,
)  # fmt: skip


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("problems") / "static.toml"
    path.write_text(TEXT, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def saved(file):
    """Return the optimum with its sensitivities, read back from JSON."""
    path = file.with_name("best.json")
    path.write_text(printed("optimise", file, "--sensitivity", "--json"), encoding="utf-8")
    return po.load(path)


@pytest.mark.parametrize(
    ("name", "key", "value"),
    [
        ("soil.cohesion", "soil.cohesion", "{} Pa"),
        ("soil.ambient_pressure", "soil.ambient_pressure", "{} Pa"),  # of the named soil, not in the file
        ("half_angle at_most", "require.half_angle.at_most", "{} rad"),
    ],
)
def test_it_is_the_file_solved_again_with_another_value(file, saved, name, key, value):
    (found,) = [item for item in saved.sensitivities if item.name == name]
    assert saved.run.scene.soil.name == "serozem, changed"  # as in the file

    def objective(factor):
        text = value.format(repr(factor * found.value))
        return po.read_problem(file, [f'{key}="{text}"']).optimise()[0].objective

    one, two = (objective(1.0 + s) - objective(1.0 - s) for s in (1e-3, 2e-3))
    # An objective good to 1e-12 over a step of 1e-3, and the step to the fourth power.
    assert found.elasticity == pytest.approx((8.0 * one - two) / 12e-3 / saved.objective, rel=1e-8, abs=1e-9)


def test_the_table_has_every_quantity_that_matters_in_order_of_size(file, saved):
    done = call("optimise", file, "--sensitivity")
    assert (done.status, done.err) == (0, "")
    names = [item.name for item in saved.sensitivities]
    sizes = [abs(item.elasticity) for item in saved.sensitivities]
    assert sizes == sorted(sizes, reverse=True)
    # No mass moves, no spring deflects to its limit, and the plastic gas has no Young's modulus.
    soil = "density density_ratio cohesion friction_angle tool_friction ambient_pressure strength_factor"
    others = {"share.chisel_angle", "scene.tow_speed", "scene.stiffness"}
    limits = {"loosened_radius at_least", "half_angle at_most"}
    assert {*names} == {f"soil.{name}" for name in soil.split()} | others | limits
    places = [done.out.index(f"│ {name} ") for name in names]
    assert places == sorted(places)
    assert cells(done.out, "scene.tow_speed")[0] == "7.2 km/h"
    for item in saved.sensitivities:
        shown = f"{item.elasticity:+.3g}" if abs(item.elasticity) > 1e-9 else "0"
        assert cells(done.out, item.name)[1] == shown
    (radius,) = [item for item in saved.sensitivities if item.name == "loosened_radius at_least"]
    # The front's radius is proportional to the height, the draft to its square; the angle keeps it.
    assert cells(done.out, radius.name)[1:4] == [f"{radius.elasticity:+.3g}", "0", "+1"]
    # No percentage is one of a variable whose best value is 0.
    free = "variables.effects.rate_term={ lower = '0 s^2/m^2', upper = '1 s^2/m^2' }"
    out = printed("optimise", file, "--sensitivity", "--set", free)
    assert ("value 0" in out, " 0 s^2/m^2 │" in out) == (True, True)


def test_an_optimum_that_is_not_unique_is_printed_with_a_note(file):
    free = '"scene.stiffness" = { lower = "1 kN/m", upper = "9 kN/m" }\n"share.wedge'
    flat = file.with_name("flat.toml")
    text = changed(('stiffness = "60 kN/m"\n', ""), ('"share.wedge', free), text=TEXT.replace("\nmean_defl", "\n#"))
    flat.write_text(text, encoding="utf-8")
    done = call("optimise", flat, "--sensitivity", "--search", "8", "-v")
    assert done.status == 0
    stages = [line.split(" s  ")[1] for line in done.err.splitlines()]
    assert all(one != two for one, two in pairwise(stages))  # each once, however often it is reported
    # Parameters instead of numbers round otherwise, which may change the number of designs along the flat direction.
    assert str(po.read_problem(flat).optimise(search=8)[0].search).partition(" tried")[2] in done.out
    assert "not unique" in done.out
    assert "note: no sensitivities: the optimum is not unique" in done.said
    assert "one per cent" not in done.out


def test_no_range_leaves_the_models_domain():
    """Half a revolution of friction or a chisel of 103 degrees is neither soil nor share, whatever the slopes say."""
    short = ("--set", "scene.duration=0.5 s", "--search", "near")
    saved = json.loads(printed("optimise", SUBSOILER, "--sensitivity", "--json", *short))
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
