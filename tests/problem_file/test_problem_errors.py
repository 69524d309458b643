"""A wrong problem file is refused with one sentence: file, line, key, what was expected, the nearest name."""

import re

import pytest
from helpers.commands import call
from helpers.problem_files import COTTON, SUBSOILER, changed, refused_files

import plough_opt as po
from plough_opt.problem_file.sweep import plan_of

WRONG = refused_files()
# Besides what is in refused.toml: long or deep, and with characters that cannot be printed.
MISTAKES = [
    *WRONG["mistakes"],
    *(("[variables]", f"[trade_off]\n{table}\n[variables]", *pieces) for table, *pieces in WRONG["traded"]),
    ("amplitude = 0.3", f"amplitude = 1{'0' * 400}", "amplitude", "larger than any number"),
    ("[scene]", f"[scene]\nx = {'[' * 400}{']' * 400}", "x = ", "more than 8 deep"),
    ("[scene]", f"[scene]\n{'.'.join('a' * 400)} = 1", "a.a", "more than 8 deep"),
    ("[scene]", f"[scene]\nx = {'1' * 5000}", "x = ", "5004 characters; at most 1000"),
    ("[scene]", '[scene]\nx = "\\u001b[31m"', "x = ", "'scene.x' holds U+001B, a character that cannot be printed"),
]


@pytest.mark.parametrize(
    ("old", "new", "fragment", "pieces"),
    [(old, new, fragment, pieces) for old, new, fragment, *pieces in MISTAKES],
    ids=lambda value: value[:30] if isinstance(value, str) else "",
)
def test_what_is_wrong_is_refused_at_its_line_with_what_was_expected(blames, old, new, fragment, pieces):
    blames(changed((old, new)), fragment, *pieces)


def test_a_file_without_a_table_that_it_needs_is_refused(refusal):
    assert "share.toml: 'scene' is missing" in refusal('[soil]\nname = "serozem"\n')


@pytest.mark.parametrize(("places", "fragment", "piece"), WRONG["forms"])
def test_a_key_is_found_in_any_form(blames, places, fragment, piece):
    blames("# a\u0085comment\u2028\n\n# = [not] a key\n" + changed(*places), fragment, piece)


@pytest.mark.parametrize(("places", "blamed"), WRONG["several"])
def test_all_mistakes_are_listed_in_the_order_of_the_file(refusal, places, blamed):
    text = changed(*places)
    lines = [int(number) for number in re.findall(r"^share\.toml, line (\d+): ", refusal(text), flags=re.MULTILINE)]
    assert all(fragment in text.split("\n")[line - 1] for line, fragment in zip(lines, blamed, strict=True))


def test_many_mistakes_are_counted(refusal):
    lines = refusal("\n".join(f"k{number} = 1" for number in range(3000)) + f"\n{COTTON}").splitlines()
    assert len(lines) == 21
    assert lines[0].startswith("share.toml, line 1: 'k0' is not a known key")
    assert lines[-1] == "... and 2980 more"


JSON = "file.json' is JSON, not a problem file: print a saved result by plough-opt show"


UNREADABLE = [
    ("subsoler.toml", None, "there is no file '{}/subsoler.toml': did you mean '{}/subsoiler.toml'"),
    ("rotavator.toml", None, "that folder contains subsoiler.toml"),
    ("empty/subsoiler.toml", None, "plough-opt init"),
    (".", None, "is a folder: name a problem file in it"),
    ("file.toml", b"title = '\xe9'", "'{}/file.toml' cannot be read as text"),
    ("file.toml", b"# comment\n" * 10_001, "too long for a problem file: at most 100 kB can be read"),
    ("/dev/zero", None, "at most 100 kB"),
    ("file.json", b'{"a": 1}', JSON),
]


@pytest.mark.parametrize(
    ("name", "content", "expected"), UNREADABLE, ids=lambda value: None if isinstance(value, str) else ""
)
def test_a_file_that_cannot_be_read_is_refused_with_the_nearest_name(tmp_path, name, content, expected):
    (tmp_path / "subsoiler.toml").touch()
    (tmp_path / "empty").mkdir()
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(po.InputError, match=re.escape(expected.replace("{}", str(tmp_path)))):
        po.read_problem(tmp_path / name)


@pytest.mark.parametrize("place", ['"7.2 km/h"', '"serozem"', '"0.1 m"', '"0.15 m"'])
def test_a_file_can_run_no_code(tmp_path, monkeypatch, refusal, place):
    monkeypatch.chdir(tmp_path)
    for code in ("__import__('pathlib').Path('ran').touch()", "open('ran', 'w') m/s"):
        assert refusal(changed((place, f'"{code}"'))).startswith("share.toml, line ")
    assert not (tmp_path / "ran").exists()


# --- decimal commas ---


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


# --- changes that deserve a note ---


def test_a_value_outside_its_own_bounds_is_noted():
    assert "outside its bounds 0.1 m to 0.5 m" in call("check", SUBSOILER, "--set", "share.height=0.9 m").err
    assert "outside" not in call("check", SUBSOILER, "--set", "share.height=0.4 m").err


def test_a_sweep_outside_the_bounds_of_a_variable_is_noted():
    problem = po.read_problem(SUBSOILER)
    outside = plan_of(problem, {"scene.stiffness": "5..50 kN/m:2"}).notes
    assert [note for note in outside if "outside" in note and "10 kN/m" in note]
    assert plan_of(problem, {"scene.stiffness": "15..50 kN/m:2"}).notes == ()
