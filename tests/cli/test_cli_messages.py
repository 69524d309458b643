"""What a command says beside its results, that it is under way, and what editors and shells complete by."""

import io
import json
import logging
import subprocess
import time

import pytest
from helpers.commands import call, printed
from helpers.problem_files import SUBSOILER
from rich.console import Console

from plough_opt.app import commands
from plough_opt.core import process
from plough_opt.core.process import heartbeat
from plough_opt.studies.sweep.engine import bar

BRIEF = ("--set", "scene.duration=0.2 s", "--set", "scene.outputs=20")


def test_quiet_leaves_results_alone_and_the_error_stream_empty(tmp_path):
    options = ("simulate", SUBSOILER, "--set", "share.height=0.3 m", "--json", *BRIEF)
    loud = call(*options, "--plot", tmp_path / "new" / "a.pdf")
    silent = call(*options, "--plot", tmp_path / "b.png", "--quiet")
    assert "note: " in loud.err
    assert loud.err.endswith(f"wrote {tmp_path / 'new' / 'a.pdf'}\n")
    assert (tmp_path / "new" / "a.pdf").read_bytes().startswith(b"%PDF-")
    assert silent.err == ""
    assert json.loads(silent.out)["averages"] == json.loads(loud.out)["averages"]
    wrong = call("simulate", "-q", SUBSOILER, "--set", "share.hight=0.3 m")
    assert wrong.status == 2
    assert "share.hight" in wrong.err


def test_verbose_says_each_step_and_twice_each_run_and_leaves_logging_as_it_was():
    library, own = logging.getLogger("plough_opt"), logging.getLogger("plough_opt.app.terminal")
    before = library.level, list(library.handlers), own.level
    once, twice = (call("simulate", SUBSOILER, how, *BRIEF).err for how in ("-v", "-vv"))
    assert "simulating" in once
    assert "estimated error" not in once
    assert "estimated error" in twice
    assert (library.level, library.handlers, own.level) == before


def test_bash_completes_commands_and_options(tmp_path):
    script = tmp_path / "completion.sh"
    script.write_text(printed("completion", "bash"), encoding="utf-8")
    for words, last, expected in (("opt", 1, "optimise optimize"), ("optimise --sen", 2, "--sensitivity")):
        line = f"source {script}; COMP_WORDS=(plough-opt {words}); COMP_CWORD={last}; _shtab_plough_opt"
        shell = ["bash", "-c", f'{line}; echo "${{COMPREPLY[@]}}"']
        assert subprocess.check_output(shell, text=True).split() == expected.split()


@pytest.fixture
def soon(monkeypatch):
    """Write lines of progress after hundredths of a second."""
    monkeypatch.setattr(process, "INTERVAL", 0.01)


def until(true):
    """Wait for what another thread does."""
    while not true():
        time.sleep(0.01)


@pytest.mark.usefixtures("soon")
def test_it_says_what_is_being_done_until_it_is_done():
    lines = []
    with heartbeat(lines.append) as told:
        until(lambda: len(lines) >= 2)
        told("calibrating")
        until(lambda: lines[-1].startswith("calibrating: "))
    count = len(lines)
    assert lines[0] == "working: 0 s so far"
    time.sleep(0.05)
    assert len(lines) == count


@pytest.mark.usefixtures("soon")
@pytest.mark.parametrize("error", [BrokenPipeError, ValueError("closed file")])
def test_a_reader_that_went_away_is_no_matter(error):
    tried = []

    def gone(line):
        tried.append(line)
        raise error

    with heartbeat(gone):
        until(lambda: tried)
    assert len(tried) == 1


@pytest.mark.usefixtures("soon")
def test_commands_and_sweeps_say_it(monkeypatch):
    def long(_):
        with commands.progress() as told:
            told("calibrating", 0.5)
            time.sleep(0.1)

    monkeypatch.setattr(commands, "soils", long)
    done = call("soils")
    assert done.status == 0
    assert "calibrating: 0 s so far\n" in done.err
    stream = io.StringIO()
    with bar(Console(file=stream)) as told:
        told(3, 10, 1)
        until(lambda: "3 of 10" in stream.getvalue())
    assert "sweep: 3 of 10 points, 1 failed: 0 s so far\n" in stream.getvalue()
