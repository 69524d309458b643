"""docs/theory.md: every equation has its function and its test."""

import inspect
import re
from functools import reduce
from pathlib import Path

import pytest

import plough_opt as po

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "docs" / "theory.md").read_text(encoding="utf-8")
EQUATIONS = re.findall(
    r"^\| \((\d+)\) \| (.+) \| `([\w.]+)` \| \[.+\]\(\.\./(.+)\) \| `(tests/[\w/.]+)` \|$", TEXT, flags=re.MULTILINE
)
LETTER = (ROOT / "tests" / "test_source_equations.py").read_text(encoding="utf-8")


def test_the_table_has_every_equation_once():
    assert [int(number) for number, *_ in EQUATIONS] == list(range(1, 28))


@pytest.mark.parametrize(("number", "what", "function", "file", "test"), EQUATIONS, ids=[row[0] for row in EQUATIONS])
def test_an_equation_has_its_function_and_its_test(number, what, function, file, test):
    assert what.strip()
    defined = reduce(getattr, function.split("."), po)
    source = (ROOT / file).read_text(encoding="utf-8")
    assert (
        inspect.getsourcefile(inspect.unwrap(getattr(defined, "fget", defined))) == str(ROOT / file)
        or f"({number})" in source
    )
    assert re.search(rf"def test_equation_{number}(_|\()", LETTER)
    assert (ROOT / test).exists()


@pytest.mark.parametrize("name", sorted(set(re.findall(r"`((?:plastic|elastic|plots)\.\w+)`", TEXT))))
def test_a_named_function_exists(name):
    assert reduce(getattr, name.split("."), po) is not None


def test_links_within_the_page_lead_to_headings():
    headings = {re.sub(r"[^\w -]", "", heading).strip().lower().replace(" ", "-")
                for heading in re.findall(r"^#+ (.+)$", TEXT, flags=re.MULTILINE)}  # fmt: skip
    assert set(re.findall(r"\]\(#([\w-]+)\)", TEXT)) <= headings
