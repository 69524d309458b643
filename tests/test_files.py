"""Files are written whole or not at all; processors and notices of a process; texts from strangers stay text."""

import csv
import io
import json
import os
import random
import re
import subprocess
import sys
import unicodedata

import pytest
from helpers.commands import call
from helpers.every_result import EVERY
from helpers.problem_files import SUBSOILER

import plough_opt as po
from plough_opt.app.terminal import print_page
from plough_opt.core.files import write_file, write_files, write_folder
from plough_opt.core.screen import Screen, progress_on
from plough_opt.core.tables import Grid, Page, read_rows, write_rows


def _kept(folder):
    """Return the files in a folder: name -> text."""
    return {path.name: path.read_text() for path in folder.iterdir()}


def test_text_bytes_and_a_writer_come_out_alike_also_in_a_pipe(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    reader = subprocess.Popen(["cat", tmp_path / "pipe"], stdout=subprocess.PIPE)
    write_file(tmp_path / "pipe", "table", "through")
    assert (reader.communicate()[0], (tmp_path / "pipe").is_fifo()) == (b"through", True)
    for name, content in (("a", "é\n"), ("b", "é\n".encode()), ("c", lambda file: file.write("é\n".encode()))):
        assert write_file(tmp_path / "new" / name, "table", content) == tmp_path / "new" / name
    assert {path.read_bytes() for path in (tmp_path / "new").iterdir()} == {b"\xc3\xa9\n"}


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError, SystemExit, OSError(28, "No space left on device")])
def test_an_interrupted_write_leaves_the_existing_file(tmp_path, error):
    def half(file):
        file.write(b"half of")
        raise error

    (tmp_path / "a").write_text("before")
    (tmp_path / "link").symlink_to("a")
    full = isinstance(error, OSError)
    for name in ("a", "b", "link"):
        words = rf"the table '.*{name}' cannot be written: no space left on device" if full else None
        with pytest.raises(po.InputError if full else error, match=words):
            write_file(tmp_path / name, "table", half)
    assert _kept(tmp_path) == {"a": "before", "link": "before"}


def test_links_are_followed_and_stay(tmp_path):
    (tmp_path / "far").mkdir()
    (tmp_path / "far" / "a").write_text("before")
    (tmp_path / "link").symlink_to("far/a")
    (tmp_path / "to nothing").symlink_to("far/b")
    (tmp_path / "twice").symlink_to("link")
    for name in ("link", "twice", "to nothing"):
        write_file(tmp_path / name, "table", name)
        assert (tmp_path / name).is_symlink()
    assert _kept(tmp_path / "far") == {"a": "twice", "b": "to nothing"}


def test_paths_that_cannot_be_written_are_refused(tmp_path, monkeypatch):
    # What the system tells users other than root of a file without the permission to write.
    monkeypatch.setattr(os, "access", lambda path, mode: not (path.name == "a" and mode == os.W_OK))
    (tmp_path / "a").write_text("before")
    (tmp_path / "round").symlink_to("round")
    reasons = {"": "folder", "round": "in a circle", "x" * 300: "too long", "a": "permission denied",
               "/dev/full": "no space left on device"}  # fmt: skip
    for name, why in reasons.items():
        with pytest.raises(po.InputError, match=rf"the table '.*' cannot be written: .*({why})"):
            write_file(tmp_path / name, "table", "after")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "round"]
    assert (tmp_path / "a").read_text() == "before"


def test_of_several_none_is_moved_before_all_are_written(tmp_path):
    (tmp_path / "a").write_text("before")
    with pytest.raises(po.InputError, match=r"'.*a/b' cannot be written: .*is not a folder"):
        write_files({tmp_path / "a": "after", tmp_path / "a" / "b": "after"}, "table")
    assert _kept(tmp_path) == {"a": "before"}


def test_a_folder_is_written_whole_or_not_at_all(tmp_path):
    def fail(file):
        file.write(b"half of")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_folder(tmp_path / "a", "folder", {"whole": "one", "half": fail})
    assert [*tmp_path.iterdir()] == []


# --- a process: the processors it may use, and CasADi's notices, which a stream of the commands drops ---


@pytest.mark.parametrize("what", ["po.simulate(scene(5e4), 0.5)", "design.solve(search='near')"])
def test_simulations_and_designs_with_events_leave_the_error_stream_empty(what):
    code = f"""
import plough_opt as po

def scene(stiffness):
    effects = po.Effects(strength_wave=po.StrengthWave(0.9, 0.2), damping=200.0, contact=po.StickSlip(1.2))
    return po.Scene(po.named_soil("serozem"), po.Cone("10 deg", "25 cm"), stiffness, 25.0, 0.5, effects)

design = po.Design()
stiffness = design.variable("stiffness", guess="50 kN/m", lower="40 kN/m", upper="60 kN/m")
design.minimise(po.simulate(scene(stiffness), 0.3).force_rms / 1e3)
{what}
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    assert done.stderr == ""


# --- texts from strangers reach terminals, pages and spreadsheets as text: saved results, problem files, CSV files ---


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
        grid = Grid.of(text, text, text, "")
        grid.caption = text
        grid.row(text, text, text, bold=True)
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
            source.replace("loosened_radius = {", f"{quoted} = {{"),
            f"{source}\n[{quoted}]\n{quoted} = {quoted}\n",
        ]
        folder = tmp_path / (f"{k}" + re.sub("[/\x00]", "", text))
        folder.mkdir()
        for number, change in enumerate(changes):
            file = folder / f"{number}.toml"
            file.write_text(change, encoding="utf-8")
            done = call("check", file)
            assert done.status in (0, 2)
            assert fit_to_print(done.out + done.err), (text, number)
        for words in (("check", SUBSOILER, "--set", text), ("simulate", text), ("show", text)):
            done = call(*words)
            assert done.status in (0, 2)
            assert fit_to_print(done.out + done.err), words


def test_cells_of_a_table_are_shown_as_they_are(tmp_path):
    """Beginnings that a spreadsheet computes get an apostrophe, numbers do not, and both are read back."""
    texts = [
        "=1+1", "+1 (x)", "-a", "@SUM(A1)", "\tx", "\uff1d1", "'=1", "''-x", "'", "plain", "a=b", "-1.5", "-1e-05",
        "+3", "",
    ]  # fmt: skip
    out = io.StringIO()
    write_rows(out, [[f"name {k}" for k in range(len(texts))], texts, [-1.5] * len(texts)])
    (_, *rows) = csv.reader(out.getvalue().splitlines())
    assert [cell for cell in rows[0] if re.match("[=+@\t\uff1d-]", cell)] == ["-1.5", "-1e-05", "+3"]
    assert rows[1] == ["-1.5"] * len(texts)
    path = tmp_path / "a.csv"
    path.write_text(out.getvalue(), encoding="utf-8")
    assert read_rows(path, "texts")[1] == (2, texts)


def test_any_text_of_a_table_is_read_back(tmp_path):
    draw, path = random.Random(7), tmp_path / "a.csv"
    signs = ["a", "1", " ", "#", "'", '"', ",", ";", "\t", "\r", "\n", "\r\n", "=", "\u2028", "\x0b", "\x85", "°"]
    for _ in range(400):
        width = draw.randint(1, 4)
        rows = [["".join(draw.choices(signs, k=draw.randint(0, 5))) for _ in range(width)]
                for _ in range(draw.randint(1, 5))]  # fmt: skip
        rows = [[*row, "end"] for row in rows]  # a row of blanks is none
        with path.open("w", encoding="utf-8", newline="") as file:
            write_rows(file, rows)
        assert [cells for _, cells in read_rows(path, "texts")] == rows
        with path.open(encoding="utf-8", newline="") as file:  # Python's own reader finds the same cells
            assert [[cell.lstrip("'") for cell in row] for row in csv.reader(file)] == [
                [cell.lstrip("'") for cell in row] for row in rows
            ]
