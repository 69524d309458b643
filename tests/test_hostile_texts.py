"""Texts from strangers reach terminals, pages and spreadsheets as text: saved results, problem files, CSV files."""

import csv
import io
import json
import random
import re
import unicodedata
from concurrent.futures import ThreadPoolExecutor

import pytest
from helpers.commands import call
from helpers.every_result import EVERY
from helpers.problem_files import SUBSOILER

import plough_opt as po
from plough_opt.app.terminal import print_page
from plough_opt.core.process import progress_on
from plough_opt.core.screen import Screen
from plough_opt.core.tables import Grid, Page, read_rows, write_rows

# Texts that a terminal obeys, that hide or reorder others, that are markup of rich or HTML, and that are neither.
HOSTILE = [
    *("\x1b[2J\x1b]0;title\x07", "a\x9b2Jb\x90c\x85", "a\u202egnp.exe", "\u2066a\u2069\u200f\u061c", "a\rb\x08\x0bc"),
    *("[/] [bold red]a[/b]", "[link=file:///etc/passwd]a[/link] :boom:", "a\u2028b\u2029c\x0cd\x1ee"),
    *("</script><script>alert(1)</script><img src=x onerror=y>", "\ufeffa\U000e0041", "\x00\x7f\x1b"),
    "{0.__class__} %s %(x)d $\\frac$ \\N{DIGIT ONE}",
]  # fmt: skip


def places(data, path=()):
    """Yield the path of every text and of every key in data, one for all entries of a list."""
    if isinstance(data, dict):
        for key, value in data.items():
            yield "key", (*path, key)
            yield from places(value, (*path, key))
    elif isinstance(data, list):
        for value in data:
            yield from places(value, (*path, "*"))
    elif isinstance(data, str):
        yield "text", path


def changed(data, kind, path, text):
    """Return data in which a text replaces the texts or keys at a path."""
    if not path:
        return text if isinstance(data, str) else data
    if isinstance(data, list):
        return [changed(value, kind, path[1:], text) for value in data]
    if not isinstance(data, dict) or path[0] not in data:
        return data
    name = text if kind == "key" and len(path) == 1 else path[0]
    value = data[path[0]] if name == text else changed(data[path[0]], kind, path[1:], text)
    return {name if key == path[0] else key: value if key == path[0] else old for key, old in data.items()}


def fit_to_print(text):
    """Return whether a text has no character that a terminal obeys, or that hides or reorders others."""
    return not [one for one in text if one != "\n" and unicodedata.category(one) in ("Cc", "Cf", "Cs", "Zl", "Zp")]


@pytest.mark.parametrize("most", [8, pytest.param(40, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", EVERY)
def test_no_text_of_a_result_commands_a_terminal(tmp_path, name, most):
    """Texts and keys of every kind of result, one after the other; at most so many of each kind, by seed 7."""
    rng, data, path = random.Random(7), json.loads(EVERY[name]().to_json()), tmp_path / "a.json"
    shown = 0
    every = sorted(dict.fromkeys(places(data)))
    for kind, place in rng.sample(every, min(len(every), most)):
        text = rng.choice(HOSTILE)
        path.write_text(json.dumps(changed(data, kind, place, text), ensure_ascii=rng.random() < 0.5), encoding="utf-8")
        for words in ((), ("--problem",), ("--json",))[: 1 + 2 * (rng.random() < 0.1)]:
            done = call("show", path, *words)
            assert done.status in (0, 2), (place, text)
            assert fit_to_print(done.out + done.err), (place, text)
        if done.status == 0:
            shown += 1
            found = po.load(path)
            assert fit_to_print(str(found) + repr(found)), (place, text)
            html = found.shown_page().html()
            assert fit_to_print(html)
            assert not re.search("<(script|img)", html)
    assert 8 * shown > most


def test_a_terminal_gets_only_the_styles_of_the_toolkit():
    out = io.StringIO()
    for text in HOSTILE:
        grid = Grid.of(text, text, text, mark=text)
        grid.caption = text
        grid.row(text, text, bold=True)
        page = Page(text, (grid, text), (text,), text, text)
        print_page(Screen(file=out, force_terminal=True, width=60), page)
        with progress_on(Screen(file=out, force_terminal=True)) as show:
            show(text, 0.5)
    left = re.sub(r"\x1b\[(\d+(;\d+)*m|\?25[lh]|2K|1A)|\r", "", out.getvalue())
    assert fit_to_print(left)
    assert "[/]" in left
    assert r"\x1b[2J\x1b]0;title" in left


def test_messages_and_problem_files_do_not_command_a_terminal(tmp_path):
    """Their texts, names, paths and options; a text that cannot be shown is refused or escaped."""
    source = SUBSOILER.read_text(encoding="utf-8")
    for k, text in enumerate(HOSTILE):
        quoted = json.dumps(text)
        changes = [
            source.replace('"Subsoiler for cotton on serozem"', quoted),
            source.replace('name = "serozem"', f"name = {quoted}"),
            source.replace("loosened_radius = {", f"{quoted} = {{"),
            f'{source}\n[measures]\n{quoted} = {{ formula = "mean_draft", unit = {quoted} }}\n',
        ]
        folder = tmp_path / (f"{k}" + re.sub("[/\x00]", "", text))
        folder.mkdir()
        for number, change in enumerate(changes):
            file = folder / f"{number}.toml"
            file.write_text(change, encoding="utf-8")
            done = call("check", file)
            assert done.status in (0, 2)
            assert fit_to_print(done.out + done.err), (text, number)
        for words in (("check", SUBSOILER, "--set", text), ("simulate", text), ("show", text), ("export", SUBSOILER,
                      "--to", "stl", "--at", "guess", "--output", folder / "a.stl")):  # fmt: skip
            done = call(*words)
            assert done.status in (0, 2)
            assert fit_to_print(done.out + done.err), words


OTHER = [
    *("[" * 100_000, '{"a":' * 100_000, f'{{"schema": 2, "x": {"[" * 3000}{"]" * 3000}}}', '{"schema": NaN}'),
    *('{"schema": -Infinity}', '{"schema": 1e999}', f'{{"schema": {"9" * 5000}}}', '{"schema": 2, "kind": "\\ud800"}'),
    *("\ufeff{}", "null", '"x"', "{}{}", "\x00"),
]


@pytest.mark.parametrize("text", OTHER, ids=range(len(OTHER)))
def test_other_json_is_refused_in_one_sentence(tmp_path, text):
    path = tmp_path / "a.json"
    path.write_text(text, encoding="utf-8")
    done = call("show", path)
    assert (done.status, done.out) == (2, "")
    assert "Traceback" not in done.err
    assert len(done.err) < 1000


@pytest.mark.parametrize("place", ["title", "soil.name"])
def test_a_report_holds_hostile_texts_as_text(tmp_path, place):
    pytest.importorskip("jinja2")
    text = "</script><script>alert(1)</script><img src=x onerror=y> {{ 7 * 7 }} [/]"
    words = ("--set", f"{place}={json.dumps(text)}", "--set", "scene.duration=0.2 s", "--no-accuracy")
    quick = re.sub(r"(?s)\[variables\].*", "", SUBSOILER.read_text(encoding="utf-8"))
    (tmp_path / "a.toml").write_text(quick, encoding="utf-8")
    done = call("report", tmp_path / "a.toml", *words, "--output", tmp_path / "a.html")
    assert done.status in (0, 2)
    if done.status == 0:
        page = (tmp_path / "a.html").read_text(encoding="utf-8")
        assert "alert(1)" in page
        assert "<script>alert" not in page
        assert "<img src=x" not in page


def test_cells_of_a_table_are_shown_as_they_are(tmp_path):
    """Beginnings that a spreadsheet computes get an apostrophe, numbers do not, and both are read back."""
    texts = [
        "=1+1",
        "+1 (x)",
        "-a",
        "@SUM(A1)",
        "\tx",
        "\uff1d1",
        "'=1",
        "''-x",
        "'",
        "plain",
        "a=b",
        "-1.5",
        "-1e-05",
        "+3",
        "",
    ]
    out = io.StringIO()
    write_rows(out, [[f"name {k}" for k in range(len(texts))], texts, [-1.5] * len(texts)])
    (_, *rows) = csv.reader(out.getvalue().splitlines())
    assert [cell for cell in rows[0] if re.match("[=+@\t\uff1d-]", cell)] == ["-1.5", "-1e-05", "+3"]
    assert rows[1] == ["-1.5"] * len(texts)
    path = tmp_path / "a.csv"
    path.write_text(out.getvalue(), encoding="utf-8")
    assert read_rows(path, "texts")[1] == (2, texts)


def formula_of(values):
    raise ValueError(f"=HYPERLINK({values['@a']})")


def test_names_and_reasons_of_a_sweep_are_no_formulas(tmp_path):
    with ThreadPoolExecutor(1) as inline, po.sweep(formula_of, {"@a": [-1.0, 2.0]}, executor=inline) as found:
        rows = [*csv.reader(found.to_csv(tmp_path / "a.csv").read_text(encoding="utf-8").splitlines())]
    reasons = [f"ValueError: =HYPERLINK({value})" for value in (-1.0, 2.0)]
    assert rows == [["point", "'@a", "reason"], ["0", "-1.0", reasons[0]], ["1", "2.0", reasons[1]]]


def test_a_dollar_sign_in_a_picture_is_one(tmp_path):
    data = json.loads(EVERY["Run"]().to_json())
    data["origin"]["title"], data["scene"]["soil"]["name"] = "$\\frac$", "5 $ or $ 6"
    (tmp_path / "a.json").write_text(json.dumps(data), encoding="utf-8")
    run = po.load(tmp_path / "a.json")
    figure = run.plot(tmp_path / "a.svg")
    assert figure.get_suptitle().startswith("$\\frac$")
    assert "<img" in run._repr_html_()
    assert call("compare", tmp_path / "a.json", tmp_path / "a.json", "--plot", tmp_path / "b.png").status == 0
