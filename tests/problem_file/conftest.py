import pytest

import plough_opt as po


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


@pytest.fixture
def blames(refusal):
    """Check that a text is refused in one sentence that names the one line with a fragment, and has some pieces."""

    def check(text, fragment, *pieces):
        message = refusal(text)
        (line,) = [number for number, line in enumerate(text.split("\n"), 1) if fragment in line]
        assert "\n" not in message
        assert message.startswith(f"share.toml, line {line}: ")
        assert [piece for piece in pieces if piece not in message] == [], message

    return check
