from pathlib import Path

import pytest

import plough_opt as po

PROBLEMS = Path(__file__).parents[2] / "problems"


@pytest.fixture(scope="session")
def problems():
    """Return the folder of problem files."""
    return PROBLEMS


@pytest.fixture(scope="session")
def cotton():
    """Return the text of the problem file that the tests change."""
    return (PROBLEMS / "cotton_subsoiler.toml").read_text(encoding="utf-8")


@pytest.fixture(scope="session")
def changed(cotton):
    """Return the problem file's text with some places of it changed."""

    def change(*places):
        text = cotton
        for old, new in places:
            assert text.count(old) == 1, f"{old!r} must stand in the file once"
            text = text.replace(old, new)
        return text

    return change


@pytest.fixture
def read(tmp_path):
    """Read a text as the problem file share.toml."""

    def read(text, *overrides):
        path = tmp_path / "share.toml"
        path.write_text(text, encoding="utf-8")
        return po.read_problem(path, overrides)

    return read


@pytest.fixture
def refusal(read, tmp_path):
    """Return the message with which a text is refused; the file is share.toml in it."""

    def refusal(text, *overrides):
        with pytest.raises(po.InputError) as caught:
            read(text, *overrides)
        return str(caught.value).replace(f"{tmp_path}/", "")

    return refusal


def line_of(text, fragment):
    """Return the number of the one line of a text that holds a fragment."""
    (found,) = [number for number, line in enumerate(text.split("\n"), 1) if fragment in line]
    return found


@pytest.fixture
def blames(refusal):
    """Check that a text is refused in one sentence that names the one line with a fragment, and has some pieces."""

    def check(text, fragment, *pieces):
        message = refusal(text)
        assert "\n" not in message
        assert message.startswith(f"share.toml, line {line_of(text, fragment)}: ")
        assert [piece for piece in pieces if piece not in message] == [], message

    return check
