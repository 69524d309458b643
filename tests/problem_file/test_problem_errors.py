"""A wrong problem file is refused with one sentence: file, line, key, what was expected, the nearest name."""

import re

import pytest

import plough_opt as po


def line_of(text, fragment):
    """Return the number of the one line of a text that holds a fragment."""
    found = [number for number, line in enumerate(text.split("\n"), 1) if fragment in line]
    assert len(found) == 1, f"{fragment!r} must stand on one line"
    return found[0]


def case(name, old, new, blamed, *pieces):
    """Return old and new text, a fragment of the line to blame, and pieces of the message."""
    return pytest.param(old, new, blamed, pieces, id=name)


def assert_blames(message, text, blamed, pieces):
    assert "\n" not in message
    assert message.startswith(f"share.toml, line {line_of(text, blamed)}: ")
    for piece in pieces:
        assert piece in message


SOIL = 'name = "serozem"'
ACCURACY = "[variables]"
MEAN = 'mean_draft = { per = "1 kN"'

MISSPELT = [
    case("soil", SOIL, f'{SOIL}\ncohesoin = "2 kPa"', "cohesoin", "'soil.cohesoin' is not", "did you mean 'cohesion'"),
    case("share", "chisel_angle", "chisel_angel", "angel", "'share.chisel_angel' is not", "mean 'chisel_angle'?"),
    case("scene", "tow_speed", "tow_sped", "tow_sped", "'scene.tow_sped' is not", "did you mean 'tow_speed'?"),
    case("effects", "damping", "dampin", "dampin", "'effects.dampin' is not", "did you mean 'damping'?"),
    case("wave", "{ amp", "{ phose = 1, amp", "phose", "'effects.strength_wave.phose'", "did you mean 'phase'"),
    case("accuracy", ACCURACY, f"[accuracy]\nmetod = 'rk'\n{ACCURACY}", "metod", "'accuracy.metod'", "mean 'method'?"),
    case("variable", 'guess = "25', 'gues = "25', "gues =", "'variables.share.wedge_angle.gues'", "mean 'guess'?"),
    case("term", MEAN, f"{MEAN}, power = 2", "power", "'minimise.mean_draft.power'", "did you mean 'per'?"),
    case("limit", "{ at_least", "{ at_lest = 1, at_least", "lest", "'require.loosened_radius.at_lest'", "'at_least'"),
    case("table", "[minimise]", "[minimize]", "minimize", "'minimize' is not a known key", "did you mean 'minimise'?"),
    case("path", '"share.height" ', '"share.hight" ', "hight", "'share.hight' cannot be a variable", "'share.height'"),
    case("term's name", "mean_draft = ", "mean_draught = ", "draught", "'mean_draught' cannot be", "'mean_draft'?"),
    case("limit's name", "loosened_radius", "losened", "losened", "'losened' cannot be required", "loosened_radius"),
    case("soil's name", '"serozem" ', '"serozom" ', "serozom", "no soil is named 'serozom'", "mean 'serozem'?"),
    case("form", "damping =", 'formulaton = "printed"\ndamping =', "laton", "'effects.formulaton'", "'formulation'?"),
    case("print", "damping =", 'formulation = "prnt"\ndamping =', "prnt", "'effects.formulation'", "mean 'printed'?"),
    case("choice", "damping =", 'start = "rst"\ndamping =', "rst", "'effects.start'", "did you mean 'rest'?"),
]


# What is misspelt and required is one mistake, not two.
MISSPELT_AND_MISSING = [
    case("table scene", "[scene]", "[scen]", "[scen]", "did you mean 'scene'"),
    case("table soil", "[soil]", "[sol]", "[sol]", "did you mean 'soil'"),
    case("required", 'duration = "2 s"', 'durtion = "2 s"', "durtion", "did you mean 'duration'"),
    case("amplitude", "amplitude = 0.3", "amplitud = 0.3", "amplitud ", "did you mean 'amplitude'"),
    case("lower", 'lower = "5 deg"', 'lowr = "5 deg"', "lowr", "did you mean 'lower'"),
    case("required per", MEAN, 'mean_draft = { pr = "1 kN"', "pr = ", "did you mean 'per'"),
]

SPEED = '"7.2 km/h"'
QUANTITIES = [
    case("unit", SPEED, '"7.2 kg"', "7.2 kg", "'scene.tow_speed' = \"7.2 kg\" has the wrong unit", "quantity in m/s"),
    case("unknown unit", SPEED, '"7 kmh"', "kmh", "'scene.tow_speed'", "unknown unit 'kmh'", "mean 'km/h'"),
    case("no unit", SPEED, "7.2", "tow_speed", "'scene.tow_speed' = 7.2 has no unit", SPEED),
    case("truth value", SPEED, "true", "tow_speed", "'scene.tow_speed' is not a quantity", SPEED),
    case("list", SPEED, "[7.2]", "tow_speed", "'scene.tow_speed' is not a quantity", SPEED),
    case("table", SPEED, "{ a = 1 }", "tow_speed", "'scene.tow_speed' is not a quantity", SPEED),
    case("date", SPEED, "1979-05-27", "tow_speed", "'scene.tow_speed' is not a quantity", SPEED),
    case("infinite", "amplitude = 0.3", "amplitude = inf", "amplitude", "strength_wave.amplitude' = inf", "finite"),
    case("not a number", "amplitude = 0.3", "amplitude = nan", "amplitude", "strength_wave.amplitude'", "finite"),
    case("bound's unit", '"5 deg"', '"5 m"', '"5 m"', "'share.wedge_angle' lower = \"5 m\"", "quantity in rad"),
    case("bound without unit", '"5 deg"', "5", "lower = 5,", "'share.wedge_angle' lower = 5", "no unit", '"25 deg"'),
    case("limit's unit", '"15 deg" }', '"15 m" }', "half_angle", "'half_angle' at_most = \"15 m\"", "quantity in rad"),
    case("limit without unit", '"0.15 m"', "0.15", "loosened", "'loosened_radius' at_least = 0.15 has no unit"),
    case("term's unit", MEAN, 'mean_draft = { per = "1 kg"', "1 kg", "'mean_draft' per = \"1 kg\"", "quantity in N"),
    case("term without unit", MEAN, "mean_draft = { per = 5", "per = 5", "'mean_draft' per = 5", "no unit", '"1 kN"'),
]


CONTRADICTIONS = [
    case("bounds", '"5 deg"', '"65 deg"', "65 deg", "bounds of 'share.wedge_angle' contradict each other",
         "lower 65 deg is not below upper 60 deg"),
    case("equal bounds", '"5 deg"', '"60 deg"', "25 deg", "bounds of 'share.wedge_angle' contradict each other"),
    case("limits", "{ at_most = \"15", "{ at_least = '20 deg', at_most = \"15", "20 deg",
         "limits of 'half_angle' contradict", "at least 20 deg is above at most 15 deg"),
    case("guess", '"25 deg"', '"65 deg"', "65 deg", "guess 65 deg of 'share.wedge_angle'", "bounds 5 deg to 60 deg"),
    case("log from zero", '"10 kN/m"', '"0 kN/m"', "log = true", "'scene.stiffness'", "bound above 0, not 0 kN/m"),
    case("no limit", 'at_most = "15 deg"', "", "half_angle", "'half_angle' has no limit: give at_least, at_most"),
    case("per zero", MEAN, 'mean_draft = { per = "0 N"', "mean_draft = {", "'mean_draft' per = 0 N must be above 0"),
    case("per below zero", MEAN, 'mean_draft = { per = "-1 N"', "-1 N", "'mean_draft' per = -1 N must be above 0"),
    case("fixed variable", "[scene]", "height = '20 cm'\n[scene]", '"share.height"',
         "'share.height' is a variable and has a fixed value too: remove one"),
    case("minimised everywhere", "force_rms  =", "deflection =", "deflection = { per",
         "'deflection' cannot be minimised", "'mean_deflection'"),
]  # fmt: skip


MISSING = [
    case("speed", f"tow_speed = {SPEED}\n", "", "[scene]", "'tow_speed' is missing: give it in [scene]",
         "make 'scene.tow_speed' a variable"),
    case("angle", 'chisel_angle = "15 deg"', "", "[share]", "'chisel_angle' is missing", "'share.chisel_angle'"),
    case("duration", 'duration = "2 s"\n', "", "[scene]", "'duration' is missing: give it in [scene]"),
    case("soil", SOIL, 'density = "1 t/m^3"', "[soil]", "'density_ratio', ", "are missing",
         "the 'name' of a known soil"),
    case("bound", 'lower = "5 deg", ', "", "wedge_angle", "'variables.share.wedge_angle.lower' is missing"),
    case("wavelength", ', wavelength = "0.2 m"', "", "strength_wave",
         "'wavelength' is missing: give it in [effects.strength_wave]"),
    case("per", MEAN, "mean_draft = {", "mean_draft = {", "'minimise.mean_draft.per' is missing"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "missing"), [("[soil]\nname = 'serozem'\n", "'scene' is missing"), ("", "'soil' is")])
def test_a_file_without_a_table_that_it_needs_is_refused(refusal, text, missing):
    assert f"share.toml: {missing}" in refusal(text)


DOMAIN = [
    case("cohesion", SOIL, f"{SOIL}\ncohesion = '-2 kPa'", "-2 kPa", "'soil.cohesion' = -2 kPa: ", "at least 0"),
    case("density", SOIL, f"{SOIL}\ndensity = '0 t/m^3'", "0 t/m^3", "soil density", "above 0"),
    case(
        "density ratio",
        SOIL,
        f"{SOIL}\ndensity_ratio = 1.2",
        "1.2",
        "'soil.density_ratio' = 1.2: ",
        "density ratio b1 = 1.2",
        "below 1",
    ),
    case("friction angle", SOIL, f"{SOIL}\nfriction_angle = '95 deg'", "95", "friction angle", "below"),
    case(
        "angle's upper bound",
        '"60 deg"',
        '"95 deg"',
        "95 deg",
        "'share.wedge_angle' upper = 95 deg: ",
        "wedge angle",
        "below",
    ),
    case("angle's lower bound", '"5 deg"', '"-5 deg"', "-5 deg", "wedge angle", "above 0"),
    case("height's bound", '"0.1 m"', '"0 m"', '"0 m"', "height", "above 0"),
    case("speed", SPEED, '"-7.2 km/h"', "-7.2", "tow speed", "at least 0"),
    case("frame mass", '"20 kg"', '"-20 kg"', "-20 kg", "'scene.frame_mass' = -20 kg: ", "mass", "at least 0"),
    case("steel density", '"7850 kg/m^3"', '"-7850 kg/m^3"', "-7850", "density", "at least 0"),
    case("duration", '"2 s"', '"0 s"', "0 s", "duration", "above 0"),
    case("outputs", 'duration = "2 s"', "duration = '2 s'\noutputs = 0", "outputs", "outputs' = 0", "at least 1"),
    case("amplitude", "amplitude = 0.3", "amplitude = 1.3", "1.3", "amplitude = 1.3", "at most 1"),
    case("wavelength", '"0.2 m"', '"0 m"', "wavelength", "wavelength", "above 0"),
    case("damping", '"400 N*s/m"', '"-400 N*s/m"', "-400", "damping", "at least 0"),
]


def fixed_share(cotton, angle="25 deg", frame_mass="20 kg"):
    """Return the problem file with its share's measures fixed."""
    text = re.sub(r'"share\..*\n', "", cotton).replace('"20 kg"', f'"{frame_mass}"')
    return text.replace("[scene]", f"wedge_angle = '{angle}'\nheight = '30 cm'\n[scene]")


def test_a_fixed_wedge_angle_beyond_a_right_angle_is_refused(cotton, refusal):
    text = fixed_share(cotton, angle="95 deg")
    assert_blames(refusal(text), text, "wedge_angle", ["wedge angle", "must be below"])


def test_a_frame_mass_below_zero_is_refused_however_heavy_the_share_is(cotton, refusal):
    text = fixed_share(cotton, frame_mass="-1 kg")
    assert_blames(refusal(text), text, "-1 kg", ["mass"])


SETTINGS = [
    case(name, ACCURACY, f"[accuracy]\n{written}\n{ACCURACY}", blamed, piece)
    for name, written, blamed, piece in (
        ("method", "method = 'cvode'", "cvode", "is named 'cvode': did you mean 'cvodes'?"),
        ("setting", "method = 'cvodes'\nsteps = 9", "steps", "'cvodes' has no setting 'steps'"),
        ("range", "error = 2.0", "error", "error = 2 must lie between 1e-12 and 0.1"),
        ("text", "error = 'small'", "small", "'accuracy.error'"),
        ("fraction", "method = 'rk'\nsteps = 1.5", "1.5", "'accuracy.steps'"),
    )
]


@pytest.mark.parametrize(
    ("old", "new", "blamed", "pieces"),
    [*MISSPELT, *MISSPELT_AND_MISSING, *QUANTITIES, *CONTRADICTIONS, *MISSING, *DOMAIN, *SETTINGS],
)
def test_what_is_wrong_is_refused_at_its_line_with_what_was_expected(changed, refusal, old, new, blamed, pieces):
    text = changed(old, new)
    assert_blames(refusal(text), text, blamed, pieces)


def test_damping_in_a_quasi_static_scene_is_refused_at_one_of_the_two(changed, refusal):
    text = changed("[effects]", "[effects]\nmotion = false")
    message = refusal(text)
    lines = [line_of(text, fragment) for fragment in ("[effects]", "motion", "damping")]
    assert message.endswith("damping needs motion: in a quasi-static scene the mount never moves, so leave it out")
    assert any(message.startswith(f"share.toml, line {line}: ") for line in lines)


def test_a_variable_of_an_effect_that_is_off_is_refused(changed, refusal):
    text = changed('strength_wave = { amplitude = 0.3, wavelength = "0.2 m" }\n', "").replace(
        "[variables]", "[variables]\n'effects.strength_wave.wavelength' = { lower = '0.1 m', upper = '0.3 m' }"
    )
    assert_blames(refusal(text), text, "wavelength", ["effects.strength_wave"])


@pytest.mark.parametrize("key", ["soil.name", "effects.motion", "scene.outputs", "share", "title"])
def test_what_is_no_quantity_cannot_be_a_variable(changed, refusal, key):
    text = changed('"share.height" ', f'"{key}" ')
    assert_blames(refusal(text), text, f'"{key}" ', [f"'{key}' cannot be a variable"])


def test_a_variable_whose_dots_are_not_quoted_is_read_all_the_same(changed, read):
    text = changed('"share.wedge_angle"', "share.wedge_angle").replace('"share.height" ', "share.height ")
    problem = read(text.replace('"scene.stiffness"', "scene.stiffness"))
    assert set(problem.variables) == {"share.wedge_angle", "share.height", "scene.stiffness"}


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ('[soil]\nname = "serozem"', 'soil = "serozem"', "soil"),
        ('{ per = "1 kN" }     #', '"1 kN" #', "minimise.mean_draft"),
        ('{ at_most = "15 deg" }', '"15 deg"', "require.half_angle"),
        ('{ amplitude = 0.3, wavelength = "0.2 m" }', "0.3", "effects.strength_wave"),
        ('{ lower = "0.1 m", upper = "0.5 m", guess = "0.25 m" }', '"0.25 m"', "variables.share.height"),
    ],
    ids=["soil", "term", "limit", "wave", "variable"],
)
def test_a_value_where_a_table_belongs_is_refused_in_the_words_of_the_file(changed, refusal, old, new, key):
    message = refusal(changed(old, new))
    assert f"'{key}'" in message
    assert "dictionary" not in message
    assert "instance of" not in message


@pytest.mark.parametrize("text", ["scene.outputs = true", "accuracy = { method = 'dop853', steps = true }"])
def test_a_truth_value_is_no_number(cotton, refusal, text):
    scene = 'scene.duration = "2 s"\nscene.tow_speed = "2 m/s"\nscene.frame_mass = "20 kg"\n'
    rest = re.sub(r"\[scene\][^\[]*", "", cotton)
    assert "line 4" in refusal(scene + text + "\n" + rest)


def test_a_whole_number_beyond_all_floats_is_refused(changed, refusal):
    text = changed("amplitude = 0.3", f"amplitude = 1{'0' * 400}")
    assert_blames(refusal(text), text, "amplitude", ["amplitude"])


class TestWhereKeysStand:
    """The line is right wherever TOML lets a key stand."""

    HEAD = "# a comment\n\n# = [not] a key\n"

    @pytest.mark.parametrize(
        ("soil", "blamed"),
        [
            ("[soil]\nname = 'serozem'\n\n# cohesoin\ncohesoin = '2 kPa'", "cohesoin = '"),
            ("soil = { name = 'serozem', cohesoin = '2 kPa' }", "cohesoin"),
            ("soil.name = 'serozem'\nsoil.cohesoin = '2 kPa'", "cohesoin"),
            ("[\"soil\"]\nname = 'serozem'\n\"cohesoin\" = '2 kPa'", "cohesoin"),
            ("['soil']\n'name' = 'serozem'\n  cohesoin  =  '2 kPa'  # comment", "cohesoin"),
            ('[soil]\nname = """\\\n   serozem"""\ncohesoin = 1\n', "cohesoin"),
        ],
        ids=["table", "inline table", "dotted", "quoted", "literal quotes", "after text over two lines"],
    )
    def test_a_misspelt_soil_property(self, cotton, refusal, soil, blamed):
        text = self.HEAD + soil + "\n" + cotton.split(SOIL)[1].split("\n", 1)[1]
        assert_blames(refusal(text), text, blamed, ["'soil.cohesoin' is not a known key: did you mean 'cohesion'"])

    @pytest.mark.parametrize(
        ("wave", "blamed"),
        [
            ("strength_wave.amplitude = 0.3\nstrength_wave.wavelength = '2 s'", "'2 s'"),
            ("[effects.strength_wave]\namplitude = 0.3\n\nwavelength = '2 s'", "'2 s'"),
            ("strength_wave = { amplitude = 0.3, wavelength = '2 s' }", "'2 s'"),
        ],
        ids=["dotted", "table of its own", "inline table"],
    )
    def test_a_wrong_unit_in_the_strength_wave(self, changed, refusal, wave, blamed):
        text = changed('strength_wave = { amplitude = 0.3, wavelength = "0.2 m" }\ndamping = "400 N*s/m"', wave)
        assert_blames(refusal(text), text, blamed, ["'effects.strength_wave.wavelength' = \"2 s\" has the wrong unit"])

    def test_a_wrong_unit_in_a_variable_with_a_table_of_its_own(self, cotton, refusal):
        own = "[variables.'share.height']\nlower = '10 cm'\n# the upper bound\nupper = '50 N'\n[minimise]"
        text = re.sub(r'"share.height".*\n', "", cotton).replace("[minimise]", own)
        assert_blames(refusal(text), text, "50 N'", ["'share.height' upper = \"50 N\" has the wrong unit"])

    def test_a_wrong_unit_in_a_limit_with_a_table_of_its_own(self, cotton, refusal):
        text = cotton + "[require.mean_deflection]\n\nat_least = '0 m'\nat_most = '50 N'\n"
        assert_blames(refusal(text), text, "50 N'", ["'mean_deflection' at_most = \"50 N\" has the wrong unit"])

    def test_a_key_that_is_named_in_comments_and_in_other_tables_before(self, cotton, refusal):
        text = cotton.replace("[scene]", '# tow_sped = 1\n[scene]\n# tow_sped\n"outputs" = 9').replace(
            'duration = "2 s"', "duration = '2 s'\ntow_sped = 2"
        )
        assert_blames(refusal(text), text, "tow_sped = 2", ["'scene.tow_sped'"])

    def test_a_list_over_several_lines_is_blamed_where_its_key_stands(self, changed, refusal):
        text = changed(SPEED, "[\n  7.2,\n\n  8.2,\n]")
        assert_blames(refusal(text), text, "tow_speed", ["'scene.tow_speed' is not a quantity"])

    @pytest.mark.parametrize("separator", ["\u0085", "\u2028"], ids=["next line", "line separator"])
    def test_a_line_ends_only_where_toml_says(self, changed, refusal, separator):
        text = f"# a{separator}comment\n" + changed("tow_speed", "tow_sped")
        assert_blames(refusal(text), text, "tow_sped", ["did you mean 'tow_speed'?"])


class TestSeveralMistakes:
    """All mistakes of a file are listed, each with its line."""

    @pytest.mark.parametrize(
        ("changes", "blamed", "pieces"),
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
                [(SOIL, f"{SOIL}\ncohesion = '-2 kPa'\ndensity_ratio = 1.2"), (SPEED, '"-1 km/h"')],
                ["-2 kPa", "1.2", "-1 km/h"],
                [],
            ),
        ],
        ids=["keys and units", "names, bounds and limits", "values"],
    )  # fmt: skip
    def test_in_the_order_of_the_file(self, cotton, refusal, changes, blamed, pieces):
        text = cotton
        for old, new in changes:
            text = text.replace(old, new)
        message = refusal(text)
        found = re.findall(r"^share\.toml, line (\d+): ", message, flags=re.MULTILINE)
        assert [*map(int, found)] == [line_of(text, fragment) for fragment in blamed]
        assert all(piece in message for piece in pieces)

    def test_in_missing_keys(self, changed, refusal):
        message = refusal(changed('tow_speed = "7.2 km/h"\nframe_mass = "20 kg"\n', ""))
        assert "'tow_speed' is missing" in message
        assert "'frame_mass' is missing" in message


class TestToml:
    """A text that is not TOML is refused at its line."""

    @pytest.mark.parametrize(
        ("old", "new", "blamed"),
        [
            (SPEED, "7.2 km/h", "7.2 km/h"),
            ('"400 N*s/m"', '"400 N*s/m', "400 N*s/m"),
            ("[effects]", "[effects", "[effects"),
            ('"20 kg"', '"20 kg"\nframe_mass = "2 kg"', '"2 kg"'),
            ("[effects]", "[effects]\n[share]", None),
            ("tow_speed =", "tow_speed :", "tow_speed"),
            ("amplitude = 0.3", "amplitude = 0,3", "0,3"),
            ("true }", "True }", "True }"),
        ],
        ids=["no quotes", "open quote", "open bracket", "key twice", "table twice", "colon", "comma", "capital"],
    )
    def test_the_line_is_named(self, changed, refusal, old, new, blamed):
        text = changed(old, new)
        line = line_of(text, blamed) if blamed else line_of(text, "[effects]") + 1
        assert refusal(text).startswith(f"share.toml, line {line}: not valid TOML: ")

    def test_a_text_that_ends_too_early(self, refusal):
        assert refusal('[scene]\ntow_speed = """7.2\n').startswith("share.toml, line 2: not valid TOML: ")


class TestFiles:
    """What is not a readable file is refused, with the nearest name."""

    def refusal(self, path):
        with pytest.raises(po.InputError) as caught:
            po.read_problem(path)
        return str(caught.value)

    def test_a_missing_file_suggests_the_nearest(self, tmp_path):
        for name in ("subsoiler.toml", "other.toml"):
            (tmp_path / name).touch()
        message = self.refusal(tmp_path / "subsoler.toml")
        beginning = f"there is no file '{tmp_path}/subsoler.toml': did you mean '{tmp_path}/subsoiler.toml'"
        assert message.startswith(beginning)

    def test_only_a_name_that_is_near_is_suggested(self, tmp_path):
        (tmp_path / "rotavator.toml").touch()
        assert "did you mean" not in self.refusal(tmp_path / "subsoiler.toml")

    @pytest.mark.parametrize(
        ("name", "told"),
        [
            ("subsoiler.toml", "plough-opt init"),
            ("nowhere/subsoiler.toml", "there is no file"),
            (".", "is a folder: name a problem file in it"),
            ("taken/x.toml", "taken/x.toml"),
            ("subsoiler" * 40, "subsoiler"),
        ],
        ids=["empty folder", "missing folder", "folder", "file taken for a folder", "name too long"],
    )
    def test_what_cannot_be_read(self, tmp_path, name, told):
        (tmp_path / "taken").touch()
        assert told in self.refusal(tmp_path / name)

    @pytest.mark.parametrize("content", [b"\xff\xfes\x00o\x00", b"title = '\xe9'", b"\x89PNG\r\n\x1a\n\x00\x00"])
    def test_a_file_that_is_no_text(self, tmp_path, content):
        path = tmp_path / "share.toml"
        path.write_bytes(content)
        assert f"'{path}' cannot be read as text" in self.refusal(path)


@pytest.mark.parametrize(
    "code",
    [
        "__import__('pathlib').Path('ran').touch()",
        "{open('ran', 'w')}",
        "$(touch ran)",
        "`touch ran`",
        "!!python/object/apply:os.system ['touch ran']",
        "open('ran', 'w') m/s",
    ],
    ids=["import", "braces", "dollar", "backquotes", "tag", "call with unit"],
)
@pytest.mark.parametrize("place", [SPEED, '"serozem"', '"0.1 m"', '"0.15 m"'], ids=["value", "name", "bound", "limit"])
def test_a_file_can_run_no_code(tmp_path, monkeypatch, changed, refusal, code, place):
    monkeypatch.chdir(tmp_path)
    message = refusal(changed(place, f'"{code}"'))
    assert message.startswith("share.toml, line ")
    assert not (tmp_path / "ran").exists()
