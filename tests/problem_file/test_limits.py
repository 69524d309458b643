"""Limits of a problem file: what lies beyond is refused at once, with its place."""

import pytest

import plough_opt as po


@pytest.mark.parametrize(
    ("inserted", "line", "told"),
    [
        ("x = " + "[" * 400 + "]" * 400, 10, "more than 8 deep"),
        (".".join("a" * 400) + " = 1", 10, "more than 8 deep"),
        ("x = " + "1" * 996, 10, "'scene.x' is larger than any number"),
        ("x = " + "1" * 5000, 10, "5004 characters; at most 1000"),
        ('x = "\\u001b[31m"', 10, "'scene.x' holds U+001B, a character that cannot be printed"),
        ('damping = "1 m^9^9^9"', 10, "'scene.damping' is not a known key"),
    ],
    ids=lambda value: str(value)[:20],
)
def test_what_cannot_be_read_is_told_with_its_line(changed, refusal, inserted, line, told):
    message = refusal(changed(("[scene]", f"[scene]\n{inserted}")))
    assert message.startswith(f"share.toml, line {line}: ")
    assert told in message


@pytest.mark.parametrize("written", ["1 m^9^9^9", "1 m**9**9", "1 m^-99", "1 m^1.25"])
def test_powers_of_units_are_one_digit(changed, cotton, refusal, written):
    file, variable = changed(("7.2 km/h", written)), changed(("0.1 m", written))
    for message in (refusal(file), refusal(cotton, f'share.height="{written}"'), refusal(variable)):
        assert f'= "{written}" has an unreadable unit' in message


@pytest.mark.parametrize("written", ["9.80665 m/s^2*kg/m^2", "1 N*m^-2", "1 N*m**-2", "1 kN*m^-1.5*m^-0.5"])
def test_units_with_powers_are_read(cotton, read, written):
    assert read(cotton, f'soil.cohesion="{written}"').fixed["soil.cohesion"] in (9.80665, 1.0, 1000.0)


def test_quantities_and_files_are_short(changed, cotton, refusal):
    said = refusal(changed(("7.2 km/h", f"{'1' * 400} km/h")))
    assert "has 405 characters; a quantity may have at most 100: write it like" in said
    assert "too long for a problem file: at most 100 kB can be read" in refusal(cotton + "# comment\n" * 10_000)
    with pytest.raises(po.InputError, match="at most 100 kB"):  # nor is one without an end read to it
        po.read_problem("/dev/zero")


def test_json_is_not_taken_for_a_long_or_misspelt_problem_file(tmp_path):
    path = tmp_path / "run.json"
    for text in ('{"a": 1}', "\ufeff\n{" + '"a": [' + "1, " * 40_000 + "1]}"):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(po.InputError, match=r"run\.json' is JSON, not a problem file .*: .* plough-opt show"):
            po.read_problem(path)


def test_many_mistakes_are_counted(cotton, refusal):
    message = refusal("\n".join(f"k{number} = 1" for number in range(3000)) + "\n" + cotton)
    lines = message.splitlines()
    assert len(lines) == 21
    assert lines[0].startswith("share.toml, line 1: 'k0' is not a known key")
    assert lines[-1] == "... and 2980 more"


def test_a_change_is_short(cotton, refusal):
    assert "at most 2000 characters can be read" in refusal(cotton, f"title={'x' * 3000}")
    assert "more than 8 deep" in refusal(cotton, f"title={'[' * 900}{']' * 900}")
    assert "'title' holds U+0007" in refusal(cotton, "title=a\x07b")
    assert "holds U+DCFF" in refusal(cotton, "title=a\udcff")
