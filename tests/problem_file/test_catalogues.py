"""Catalogues and steps in a problem file: the best design in their values, and what it costs."""

import itertools
import json

import pytest
from helpers.commands import call, cells, printed
from helpers.problem_files import STATIC, changed

import plough_opt as po
from plough_opt.problem_file.schema import file_schema

HEIGHT = '"share.height" = { lower = "0.1 m", upper = "0.5 m", guess = "0.25 m" }'
ANGLE = '"share.wedge_angle" = { lower = "20 deg", upper = "40 deg" }'


def offering(height="", angle=None):
    """Return the static problem with more keys of its height and, if given, with the wedge angle as a variable."""
    lines = [HEIGHT.replace(" }", f"{height} }}")]
    fixed = [] if angle is None else [('wedge_angle = "35 deg"\n', "")]
    lines += [] if angle is None else [ANGLE.replace(" }", f"{angle} }}")]
    return changed((HEIGHT, "\n".join(lines)), *fixed, text=STATIC)


@pytest.fixture
def cheapest(read):
    """Return the least objective of designs that meet the requirement, each simulated by itself."""

    def least(text, angles, heights):
        found = {}
        for angle, height in itertools.product(angles, heights):
            run = read(text, f"share.wedge_angle={angle} deg", f"share.height={height} m").simulate()
            if run.scene.loosened_radius >= 0.12:
                found[angle, height] = run.mean_draft / 1e3
        return min(found.items(), key=lambda one: one[1])

    return least


def test_the_best_of_a_catalogue_is_given_beside_the_best(read, cheapest):
    heights = (0.2, 0.22, 0.24, 0.26, 0.3)
    text = offering(f", catalogue = {[f'{x} m' for x in heights]}")
    best, _ = read(text).optimise()
    (_, height), objective = cheapest(STATIC, [35.0], heights)
    assert best.bought.variables["share.height"] == height
    assert best.bought.objective == pytest.approx(objective, rel=1e-6)
    assert best.bought.objective > best.objective
    assert best.variables["share.height"] not in heights
    assert read(STATIC).optimise()[0].bought is None


def test_steps_and_catalogues_go_together(read, cheapest, tmp_path):
    text = offering(', step = "2 cm"', ', catalogue = ["24 deg", "30 deg", "36 deg", "70 deg"]')
    assert [note for note in read(text).cautions if "20 deg to 40 deg, leave out of its catalogue 70 deg" in note]
    best, _ = read(text).optimise()
    (angle, height), objective = cheapest(text, [24.0, 30.0, 36.0], [0.02 * k for k in range(5, 26)])
    assert best.bought.variables == pytest.approx({"share.height": height, "share.wedge_angle": po.deg(angle)})
    assert best.bought.objective == pytest.approx(objective, rel=1e-6)
    assert "catalogue" in str(best)
    assert f"{best.bought.cost_percent:+.2g} %" in str(best)
    again = po.load(best.save(tmp_path / "best.json"))
    assert str(again) == str(best)
    assert again.bought.variables == best.bought.variables


def test_commands_print_and_save_it(tmp_path):
    path = tmp_path / "share.toml"
    path.write_text(offering(', step = "2 cm"'), encoding="utf-8")
    out = printed("optimise", path, "--over", "worst")
    assert "corners" in out
    saved = json.loads(printed("optimise", path, "--json"))
    height = saved["bought"]["variables"]["share.height"]
    assert cells(printed("optimise", path).partition("best from the catalogue")[2], "share.height")[1:] == [
        f"{height:.5g} m", "catalogue",
    ]  # fmt: skip
    printed("report", path, "--no-accuracy", "-o", tmp_path / "a.html")
    page = (tmp_path / "a.html").read_text(encoding="utf-8")
    shown = f"{height:.5g}\N{NO-BREAK SPACE}m"
    assert f"From the catalogue: share height {shown} (objective +" in page
    table = tmp_path / "a.csv"
    heading = next(line for line in printed("optimise", path, "--csv", table).splitlines() if "Best design" in line)
    assert f"; from the catalogue {saved['bought']['objective']:.6g} (+" in heading
    assert heading.endswith(f"with share.height {height:.4g} m")
    assert table.read_text().splitlines()[-1] == f"from the catalogue,{saved['bought']['objective']!r},{height!r}"
    for at, size in (("catalogue", height), ("best", saved["variables"]["share.height"])):
        said = printed("export", path, "--to", "stl", "--at", at, "-o", tmp_path / f"{at}.stl")
        assert f"height {1e3 * size:.4g} mm" in said
    assert printed("export", path, "--to", "stl", "-o", tmp_path / "usual.stl").startswith(
        "Share of the best design from"
    )


def test_a_catalogue_in_which_nothing_will_do_leaves_the_best_with_a_warning(tmp_path):
    path = tmp_path / "share.toml"
    path.write_text(offering(', catalogue = ["0.11 m", "0.12 m"]'), encoding="utf-8")
    done = call("optimise", path)
    assert done.status == 0
    assert "nothing in the catalogue" in done.out
    assert "loosened_radius" in done.out.partition("nothing in the catalogue")[2]
    done = call("export", path, "--to", "stl", "-o", tmp_path / "a.stl")
    assert (done.status, "--at best" in done.said) == (1, True)
    path.write_text(STATIC, encoding="utf-8")
    assert "no variable" in call("export", path, "--to", "stl", "--at", "catalogue", "-o", tmp_path / "a.stl").said


WRONG_CATALOGUES = [
    (', catalogue = ["0.7 m"]', ("catalogue", "between its bounds", "0.1 m to 0.5 m")),
    (', catalogue = ["200 kg"]', ("catalogue", "wrong unit")),
    (', catalogue = ["0.2"]', ("catalogue", "no unit")),
    (", catalogue = []", ("catalogue", "at least 1")),
    (', catalogue = ["0.2 m"], step = "1 cm"', ("catalogue", "step", "remove one")),
    (', step = "0 cm"', ("step", "above 0")),
    (', step = "0.7 m"', ("step", "0.1 m to 0.5 m")),
    (", step = true", ("step",)),
]


@pytest.mark.parametrize(("more", "pieces"), WRONG_CATALOGUES)
def test_a_wrong_catalogue_is_refused_with_its_line(blames, more, pieces):
    blames(offering(more), "share.height", *pieces)


def test_a_catalogue_is_for_one_soil(refusal):
    text = offering(', step = "1 cm"') + '\n[uncertain]\n"soil.cohesion" = { distribution = "normal", std = "2 kPa" }\n'
    assert "one soil" in refusal(text)


def test_editors_complete_catalogues():
    assert {"catalogue", "step"} <= {*file_schema()["$defs"]["VariableTable"]["properties"]}
