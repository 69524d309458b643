"""Decimal commas, other spellings of columns, keys and units, and changes that an engineer should hear about."""

import pytest
from helpers.commands import call
from helpers.problem_files import COTTON, PROBLEMS, SUBSOILER, changed

import plough_opt as po

FIELD = PROBLEMS / "field.toml"

# --- decimal commas ---


@pytest.mark.parametrize(
    ("arguments", "pieces"),
    [
        (("check", SUBSOILER, "--set", "scene.tow_speed=8,5 km/h"), ("comma", '"8.5 km/h"')),
        (("check", SUBSOILER, "--set", "scene.steel_density=7,850 kg/m^3"), ("comma", '"7.850', '"7850 kg/m^3"')),
        (("check", SUBSOILER, "--set", "effects.strength_wave.amplitude=0,3"), ("comma", '"0.3"')),
        (("check", SUBSOILER, "--against", "--depth", "0,4 m"), ("comma", '"0.4 m"')),
        (("sweep", SUBSOILER, "--over", "scene.tow_speed=1,5 m/s"), ("comma", '"1.5 m/s"', '"1, 5 m/s"')),
        (("sweep", SUBSOILER, "--over", "scene.tow_speed=1,5..2,5 m/s:3"), ("comma", '"1.5"')),
    ],
)
def test_a_decimal_comma_on_the_command_line_is_named(arguments, pieces):
    done = call(*arguments)
    assert done.status == 2
    assert [piece for piece in pieces if piece not in done.said] == [], done.said


@pytest.mark.parametrize(
    ("old", "new", "number"),
    [
        ("amplitude = 0.3", "amplitude = 0,3", "0.3"),
        ('mean_draft = { per = "1 kN" }', "mean_draft = { per = 1,5 }", "1.5"),
        ('duration = "2 s"', "duration = -2,25", "-2.25"),
    ],
)
def test_a_decimal_comma_outside_quotes_is_named_with_its_line(blames, old, new, number):
    blames(changed((old, new)), new, "comma", number)


READINGS = [(0.0, 244.5, 251.0), (25.0, 644.25, 612.5), (50.0, 1033.0, 998.5)]


def written(folder, heading, mark, comma):
    """Write the readings with a separator of cells and a decimal mark; return the file's path."""
    rows = [mark.join(str(x).replace(".", comma) for x in row) for row in READINGS]
    path = folder / "readings.csv"
    path.write_text("\n".join([heading.replace("|", mark), *rows]), encoding="utf-8")
    return path


def test_semicolon_files_may_have_decimal_commas(tmp_path):
    heading = "depth [cm]|cone_index [kPa]|cone_index [kPa]"
    expected = po.read_penetrometer(written(tmp_path, heading, ",", "."), (0.1, 0.4)).insertions.tolist()
    for mark, comma in ((";", ","), (";", "."), ("\t", ".")):
        found = po.read_penetrometer(written(tmp_path, heading, mark, comma), (0.1, 0.4))
        assert found.insertions.tolist() == expected


@pytest.mark.parametrize(
    ("text", "pieces"),
    [
        ("depth [cm],cone_index [kPa]\n0,0,244,5\n", ("line 2", "semicolons", "commas")),
        ('depth [cm],cone_index [kPa]\n0,"244,5"\n', ("line 2", "comma", "point", "semicolons")),
        ("depth [cm]\tcone_index [kPa]\n0\t244,5\n", ("line 2", "comma", "point", "semicolons")),
        ("depth [cm];cone_index [kPa]\n0,5;244\n10;300.5\n", ("line 2", "line 3", "comma", "point")),
        ("depth [cm];cone_index [kPa]\n0;1.244,5\n", ("line 2", "1.244,5")),
    ],
)
def test_other_files_are_refused_with_the_comma_named(tmp_path, text, pieces):
    path = tmp_path / "readings.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(po.InputError) as caught:
        po.read_penetrometer(path, (0.0, 0.1))
    assert [piece for piece in pieces if piece not in str(caught.value)] == [], caught.value


# --- names of columns and keys, and units ---


@pytest.mark.parametrize(
    "heading",
    ["depth_cm|Cone Index [kPa]|cone-index_kPa", "Depth (cm)|CONE_INDEX (kPa)|cone index_kPa"],
)  # fmt: skip
def test_columns_are_recognised_however_they_are_spelt(tmp_path, heading):
    plain = po.read_penetrometer(
        written(tmp_path, "depth [cm]|cone_index [kPa]|cone_index [kPa]", ",", "."), (0.0, 0.5)
    )
    found = po.read_penetrometer(written(tmp_path, heading, ",", "."), (0.0, 0.5))
    assert found.insertions.tolist() == plain.insertions.tolist()


@pytest.mark.parametrize(
    ("heading", "proposed"),
    [("Tiefe [cm]|cone_index [kPa]|cone_index [kPa]", "depth"), ("depth [cm]|Kegel [MPa]|Kegel [MPa]", "cone_index"),
     ("dept [cm]|cone_index [kPa]|cone_index [kPa]", "depth")],
)  # fmt: skip
def test_of_other_columns_the_nearest_by_name_or_unit_is_proposed(tmp_path, heading, proposed):
    with pytest.raises(po.InputError, match=f"did you mean '{proposed}'"):
        po.read_penetrometer(written(tmp_path, heading, ",", "."), (0.0, 0.5))


def test_measurements_are_read_by_the_same_headings(tmp_path):
    path = tmp_path / "draft.csv"
    path.write_text("Scene.Tow_Speed (km/h);Mean Draft [kN];Sigma [%]\n3,5;1,775;3\n5;1,9;3\n", encoding="utf-8")
    found = po.read_measurements(path)
    assert (found.result, [*found.conditions]) == ("mean_draft", ["scene.tow_speed"])
    assert found.values == pytest.approx([1775.0, 1900.0])
    assert found.sigma == pytest.approx([53.25, 57.0])


@pytest.mark.parametrize(
    ("key", "full"),
    [("tow_speed", "scene.tow_speed"), ("speed", "scene.tow_speed"), ("stiffness", "scene.stiffness"),
     ("hight", "share.height"), ("cohesion", "soil.cohesion")],
)  # fmt: skip
def test_a_key_without_its_table_proposes_the_whole_key(key, full):
    assert f"did you mean '{full}'" in call("check", SUBSOILER, "--set", f"{key}=2").said


def test_units_of_every_trade_are_read_or_listed():
    for written_as, si in (("0.5 bar", 5e4), ("10 psi", 68947.57293168363), ("2 kgf/cm^2", 196133.0)):
        found = po.read_problem(SUBSOILER, [f"soil.cohesion={written_as}"]).fixed["soil.cohesion"]
        assert found == pytest.approx(si, rel=1e-12)
    assert po.read_problem(SUBSOILER, ["share.chisel_angle=15°"]).scene().share.chisel_angle == po.deg(15.0)
    assert po.read_problem(SUBSOILER, ["share.height=11 in"]).fixed["share.height"] == pytest.approx(0.2794)
    assert po.read_problem(SUBSOILER, ["scene.stiffness=5 tf/m"]).fixed["scene.stiffness"] == pytest.approx(49033.25)
    said = call("check", SUBSOILER, "--set", "scene.stiffness=5 tonf/m").said
    assert '"tf"' in said
    assert "lbf" in said
    for key, unit, listed in (("share.height", "zoll", ("in", "cm", "mm")), ("soil.cohesion", "xyz", ("bar", "psi"))):
        names = call("check", SUBSOILER, "--set", f"{key}=3 {unit}").said.partition("valid names: ")[2].split(", ")
        assert {*listed} <= {*names}
        assert "km/h" not in names


# --- changes that deserve a note ---


def test_a_value_outside_its_own_bounds_is_noted():
    assert "outside its bounds 0.1 m to 0.5 m" in call("check", SUBSOILER, "--set", "share.height=0.9 m").err
    assert "outside" not in call("check", SUBSOILER, "--set", "share.height=0.4 m").err


def test_a_sweep_outside_the_bounds_of_a_variable_is_noted():
    from plough_opt.problem_file.sweep import ProblemSweep

    problem = po.read_problem(SUBSOILER)
    outside = ProblemSweep.of(problem, {"scene.stiffness": "5..50 kN/m:2"}).notes
    assert [note for note in outside if "outside" in note and "10 kN/m" in note]
    assert ProblemSweep.of(problem, {"scene.stiffness": "15..50 kN/m:2"}).notes == ()


def test_a_changed_soil_under_a_penetrometer_says_what_it_does_to_the_draft():
    plain = float(po.read_problem(FIELD).scene().steady_resistance)
    for change, unused in (("soil.name=serozem", False), ("soil.cone_index=0.5 MPa", True)):
        (note,) = po.read_problem(FIELD, [change]).notes
        now = float(po.read_problem(FIELD, [change]).scene().steady_resistance)
        assert f"{plain / 1e3:.4g} kN to {now / 1e3:.4g} kN" in note
        assert ("not used" in note) == unused
    assert po.read_problem(FIELD, ["scene.tow_speed=6 km/h"]).notes == ()


def test_a_wrong_depth_of_a_penetrometer_speaks_of_depths(refusal, tmp_path):
    (tmp_path / "insertions.csv").write_text((PROBLEMS / "insertions.csv").read_text(), encoding="utf-8")
    text = COTTON.replace('name = "serozem"', 'name = "serozem"\npenetrometer = "insertions.csv"\ndepth = "25-45 cm"')
    message = refusal(text)
    assert "range of depths" in message
    assert '"25..45 cm"' in message
    assert "sample" not in message
