"""A wrong problem file is refused with one sentence: file, line, key, what was expected, the nearest name."""

import re

import pytest

import plough_opt as po

SOIL = 'name = "serozem"'
ACCURACY = "[variables]"
MEAN = 'mean_draft = { per = "1 kN"'
SPEED = '"7.2 km/h"'
WAVE = 'strength_wave = { amplitude = 0.3, wavelength = "0.2 m" }'

# What stands in the file, what is put there, a fragment of the line to blame, and pieces of the message.
MISSPELT = [
    (SOIL, f'{SOIL}\ncohesoin = "2 kPa"', "cohesoin", "'soil.cohesoin' is not", "did you mean 'cohesion'"),
    (ACCURACY, f"[accuracy]\nmetod = 'rk'\n{ACCURACY}", "metod", "'accuracy.metod'", "mean 'method'?"),
    ('guess = "25', 'gues = "25', "gues =", "'variables.share.wedge_angle.gues'", "mean 'guess'?"),
    ("[minimise]", "[minimize]", "minimize", "'minimize' is not a known key", "did you mean 'minimise'?"),
    ('"share.height" ', '"share.hight" ', "hight", "'share.hight' cannot be a variable", "'share.height'"),
    ("mean_draft = ", "mean_draught = ", "draught", "'mean_draught' cannot be", "'mean_draft'?"),
    ("loosened_radius", "losened", "losened", "'losened' cannot be required", "loosened_radius"),
    ('"serozem" ', '"serozom" ', "serozom", "no soil is named 'serozom'", "mean 'serozem'?"),
    ("damping =", 'formulation = "prnt"\ndamping =', "prnt", "'effects.formulation'", "mean 'printed'?"),
    # What is misspelt and required is one mistake, not two.
    ("[scene]", "[scen]", "[scen]", "did you mean 'scene'"),
    ("amplitude = 0.3", "amplitud = 0.3", "amplitud ", "did you mean 'amplitude'"),
]
QUANTITIES = [
    (SPEED, '"7.2 kg"', "7.2 kg", "'scene.tow_speed' = \"7.2 kg\" has the wrong unit", "quantity in m/s"),
    (SPEED, "7.2", "tow_speed", "'scene.tow_speed' = 7.2 has no unit", SPEED),
    *((SPEED, wrong, "tow_speed", "'scene.tow_speed' is not a quantity", SPEED)
      for wrong in ("[\n  7.2,\n\n  8.2,\n]", "1979-05-27")),
    ("amplitude = 0.3", "amplitude = inf", "amplitude", "strength_wave.amplitude' = inf", "finite"),
    ("amplitude = 0.3", f"amplitude = 1{'0' * 400}", "amplitude", "larger than any number"),
    ('"5 deg"', '"5 m"', '"5 m"', "'share.wedge_angle' lower = \"5 m\"", "quantity in rad"),
    ('"15 deg" }', '"15 m" }', "half_angle", "'half_angle' at_most = \"15 m\"", "quantity in rad"),
    (MEAN, 'mean_draft = { per = "1 kg"', "1 kg", "'mean_draft' per = \"1 kg\"", "quantity in N"),
]  # fmt: skip
CONTRADICTIONS = [
    ('"5 deg"', '"65 deg"', "65 deg", "bounds of 'share.wedge_angle' contradict each other",
     "lower 65 deg is not below upper 60 deg"),
    ('"5 deg"', '"60 deg"', "25 deg", "bounds of 'share.wedge_angle' contradict each other"),
    ("{ at_most = \"15", "{ at_least = '20 deg', at_most = \"15", "20 deg",
     "limits of 'half_angle' contradict", "at least 20 deg is above at most 15 deg"),
    ('"25 deg"', '"65 deg"', "65 deg", "guess 65 deg of 'share.wedge_angle'", "bounds 5 deg to 60 deg"),
    ('"10 kN/m"', '"0 kN/m"', "log = true", "'scene.stiffness'", "bound above 0, not 0 kN/m"),
    ('at_most = "15 deg"', "", "half_angle", "'half_angle' has no limit: give at_least, at_most"),
    (MEAN, 'mean_draft = { per = "0 N"', "mean_draft = {", "'mean_draft' per = 0 N must be above 0"),
    ("[scene]", "height = '20 cm'\n[scene]", '"share.height"',
     "'share.height' is a variable and also has a fixed value"),
    ("force_rms  =", "deflection =", "deflection = { per", "'deflection' cannot be minimised", "'mean_deflection'"),
    *(('"share.height" ', f'"{key}" ', f'"{key}" ', f"'{key}' cannot be a variable")
      for key in ("soil.name", "share")),
    (WAVE + "\ndamping = \"400 N*s/m\"\n\n[variables]",
     "[variables]\n'effects.strength_wave.wavelength' = { lower = '0.1 m', upper = '0.3 m' }",
     "wavelength", "effects.strength_wave"),
]  # fmt: skip
MISSING = [
    (f"tow_speed = {SPEED}\n", "", "[scene]", "'tow_speed' is missing: give it in [scene]",
     "make 'scene.tow_speed' a variable"),
    ('chisel_angle = "15 deg"', "", "[share]", "'chisel_angle' is missing", "'share.chisel_angle'"),
    (SOIL, 'density = "1 t/m^3"', "[soil]", "'density_ratio', ", "are missing", "the 'name' of a known soil"),
    ('lower = "5 deg", ', "", "wedge_angle", "'variables.share.wedge_angle.lower' is missing"),
    (', wavelength = "0.2 m"', "", "strength_wave",
     "'wavelength' is missing: give it in [effects.strength_wave]"),
]  # fmt: skip
DOMAIN = [
    (SOIL, f"{SOIL}\ncohesion = '-2 kPa'", "-2 kPa", "'soil.cohesion' = -2 kPa: ", "at least 0"),
    ('"60 deg"', '"95 deg"', "95 deg", "'share.wedge_angle' upper = 95 deg: ", "wedge angle", "below"),
    ('"0.1 m"', '"0 m"', '"0 m"', "height", "above 0"),
    ('"20 kg"', '"-20 kg"', "-20 kg", "'scene.frame_mass' = -20 kg: ", "mass", "at least 0"),
    ('"2 s"', '"0 s"', "0 s", "duration", "above 0"),
]
SETTINGS = [
    (ACCURACY, f"[accuracy]\n{written}\n{ACCURACY}", *pieces)
    for written, *pieces in (
        ("method = 'cvode'", "cvode", "is named 'cvode': did you mean 'cvodes'?"),
        ("method = 'cvodes'\nsteps = 9", "steps", "'cvodes' has no setting 'steps'"),
        ("error = 2.0", "error", "error = 2 must lie between 1e-12 and 0.1"),
    )
]
# In the words of the file, and not of Python.
TABLES = [
    (f"[soil]\n{SOIL}", 'soil = "serozem"', "soil = ", "'soil' must be a table of keys"),
    ('{ per = "1 kN" }     #', '"1 kN" #', "mean_draft", "'minimise.mean_draft' must be a table of keys"),
]


@pytest.mark.parametrize(
    ("old", "new", "fragment", "pieces"),
    [(old, new, fragment, pieces) for old, new, fragment, *pieces in
     (*MISSPELT, *QUANTITIES, *CONTRADICTIONS, *MISSING, *DOMAIN, *SETTINGS, *TABLES)],
    ids=lambda value: value[:30] if isinstance(value, str) else "",
)  # fmt: skip
def test_what_is_wrong_is_refused_at_its_line_with_what_was_expected(changed, blames, old, new, fragment, pieces):
    blames(changed((old, new)), fragment, *pieces)


@pytest.mark.parametrize(("text", "missing"), [("[soil]\nname = 'serozem'\n", "'scene' is missing"), ("", "'soil' is")])
def test_a_file_without_a_table_that_it_needs_is_refused(refusal, text, missing):
    assert f"share.toml: {missing}" in refusal(text)


@pytest.mark.parametrize(
    ("angle", "mass", "fragment", "piece"),
    [("95 deg", "20 kg", "wedge_angle", "must be below"), ("25 deg", "-1 kg", "-1 kg", "mass")],
)
def test_fixed_values_are_refused_whatever_the_others_are(cotton, blames, angle, mass, fragment, piece):
    text = re.sub(r'"share\..*\n', "", cotton).replace('"20 kg"', f'"{mass}"')
    blames(text.replace("[scene]", f"wedge_angle = '{angle}'\nheight = '30 cm'\n[scene]"), fragment, piece)


def test_damping_in_a_quasi_static_scene_is_refused_where_motion_is_taken(changed, blames):
    text = changed(("[effects]", "[effects]\nmotion = false"))
    blames(text, "motion =", "damping needs motion: in a quasi-static scene the mount never moves, so omit it")


def test_a_variable_whose_dots_are_not_quoted_is_read_all_the_same(changed, read):
    names = ("share.wedge_angle", "share.height", "scene.stiffness")
    assert {*read(changed(*((f'"{name}"', name) for name in names))).variables} == {*names}


# The line is right wherever TOML lets a key stand.
@pytest.mark.parametrize(
    "soil",
    [
        "[soil]\nname = 'serozem'\n\n# cohesion\ncohesoin = '2 kPa'",
        "soil = { name = 'serozem', cohesoin = '2 kPa' }",
        "soil.name = 'serozem'\nsoil.cohesoin = '2 kPa'",
        "[\"soil\"]\nname = 'serozem'\n\"cohesoin\" = '2 kPa'",
        '[soil]\nname = """\\\n   serozem"""\ncohesoin = 1\n',
    ],
    ids=["table", "inline table", "dotted", "quoted", "after text over two lines"],
)
def test_a_misspelt_property_is_found(cotton, blames, soil):
    text = f"# a comment\n\n# = [not] a key\n{soil}\n" + cotton.split(SOIL)[1].split("\n", 1)[1]
    blames(text, "cohesoin", "'soil.cohesoin' is not a known key: did you mean 'cohesion'")


@pytest.mark.parametrize(
    ("places", "fragment", "piece"),
    [
        ([(WAVE, "strength_wave.amplitude = 0.3\nstrength_wave.wavelength = '2 s'")], "'2 s'", "wavelength"),
        ([(WAVE, ""), ("[effects]", "[effects.strength_wave]\namplitude = 0.3\n\nwavelength = '2 s'\n[effects]")],
         "'2 s'", "strength_wave.wavelength' = \"2 s\" has the wrong unit"),
        ([(f"tow_speed = {SPEED}\n", ""),
          ("[minimise]", "[variables.'scene.tow_speed']\nlower = '1 m/s'\n# bound\nupper = '50 N'\n[minimise]")],
         "50 N'", "'scene.tow_speed' upper = \"50 N\" has the wrong unit"),
        ([('duration = "2 s"', "duration = '2 s' # tow_sped\ntow_sped = 2")], "tow_sped = 2", "'scene.tow_sped'"),
    ],
    ids=["dotted", "table of its own", "variable", "named before"],
)  # fmt: skip
def test_a_key_is_found_in_any_form(changed, blames, places, fragment, piece):
    blames("# a\u0085comment\u2028\n" + changed(*places), fragment, piece)


@pytest.mark.parametrize(
    ("places", "blamed", "pieces"),
    [
        (
            [("tow_speed", "tow_sped"), ("damping", "dampin"), ('"20 kg"', '"20 m"')],
            ["tow_sped", "20 m", "dampin"],
            ["'tow_speed'", "'damping'", "quantity in kg"],
        ),
        (
            [('lower = "5 deg"', 'lower = "65 deg"'), ('lower = "0.1 m"', 'lower = "0.9 m"'),
             ("half_angle", "half_angel"), ("force_rms  =", "force_rsm =")],
            ["65 deg", "0.9 m", "force_rsm", "half_angel"],
            [],
        ),
        (
            [(f'tow_speed = {SPEED}\nframe_mass = "20 kg"\n', "")],
            ["[scene]"] * 2,
            ["'tow_speed' is missing", "'frame_mass' is missing"],
        ),
    ],
    ids=["keys and units", "names, bounds and limits", "missing keys"],
)  # fmt: skip
def test_all_mistakes_are_listed_in_the_order_of_the_file(changed, refusal, places, blamed, pieces):
    text = changed(*places)
    message = refusal(text)
    lines = [int(number) for number in re.findall(r"^share\.toml, line (\d+): ", message, flags=re.MULTILINE)]
    assert all(fragment in text.split("\n")[line - 1] for line, fragment in zip(lines, blamed, strict=True))
    assert all(piece in message for piece in pieces)


@pytest.mark.parametrize(
    ("old", "new", "blamed"),
    [
        (SPEED, "7.2 km/h", "7.2 km/h"),
        ('"400 N*s/m"', '"400 N*s/m', "400 N*s/m"),
        ('"20 kg"', '"20 kg"\nframe_mass = "2 kg"', '"2 kg"'),
        ("[effects]", "[effects]\n[share] # again", "again"),
        ("amplitude = 0.3", "amplitude = 0,3", "0,3"),
    ],
    ids=["no quotes", "open quote", "key twice", "table twice", "comma"],
)
def test_what_is_not_toml_is_refused_at_its_line(changed, blames, old, new, blamed):
    blames(changed((old, new)), blamed, ": not valid TOML: ")


def test_a_text_that_ends_too_early(refusal):
    assert refusal('[scene]\ntow_speed = """7.2\n').startswith("share.toml, line 2: not valid TOML: ")


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("subsoler.toml", "there is no file '{}/subsoler.toml': did you mean '{}/subsoiler.toml'"),
        ("rotavator.toml", "that folder contains binary.toml, subsoiler.toml"),
        ("empty/subsoiler.toml", "plough-opt init"),
        (".", "is a folder: name a problem file in it"),
        ("subsoiler.toml/x.toml", "subsoiler.toml/x.toml"),
        ("binary.toml", "'{}/binary.toml' cannot be read as text"),
    ],
)
def test_a_file_that_cannot_be_read_is_refused_with_the_nearest_name(tmp_path, name, told):
    (tmp_path / "subsoiler.toml").touch()
    (tmp_path / "binary.toml").write_bytes(b"title = '\xe9'")
    (tmp_path / "empty").mkdir()
    with pytest.raises(po.InputError, match=re.escape(told.replace("{}", str(tmp_path)))):
        po.read_problem(tmp_path / name)


@pytest.mark.parametrize(
    "code",
    [
        "__import__('pathlib').Path('ran').touch()",
        "!!python/object/apply:os.system ['touch ran']",
        "open('ran', 'w') m/s",
    ],
)
@pytest.mark.parametrize("place", [SPEED, '"serozem"', '"0.1 m"', '"0.15 m"'], ids=["value", "name", "bound", "limit"])
def test_a_file_can_run_no_code(tmp_path, monkeypatch, changed, refusal, code, place):
    monkeypatch.chdir(tmp_path)
    assert refusal(changed((place, f'"{code}"'))).startswith("share.toml, line ")
    assert not (tmp_path / "ran").exists()
