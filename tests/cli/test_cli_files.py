"""What a command says beside its results, files it may not write to, interruptions, and completion."""

import io
import json
import logging
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from helpers.commands import call, printed
from helpers.problem_files import SUBSOILER
from rich.console import Console

from plough_opt.app import commands, terminal
from plough_opt.core import process
from plough_opt.core.process import heartbeat
from plough_opt.studies.sweep.engine import bar

# --- files that commands may not write to, and files that are left when they are interrupted ---


def test_a_closed_output_is_no_traceback():
    line = f'"{sys.executable}" -m plough_opt check "{SUBSOILER}" >&-'
    done = subprocess.run(["sh", "-c", line], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.usefixtures("ctrl_c")
class TestInterruptions:
    @pytest.mark.parametrize("goes_on", [True, False])
    def test_one_that_casadi_took_for_a_failed_evaluation_stops_the_command_all_the_same(self, monkeypatch, goes_on):
        def swallowing(_):
            with terminal.progress() as told:
                try:
                    os.kill(os.getpid(), signal.SIGINT)
                    time.sleep(60.0)
                except KeyboardInterrupt:
                    pass
                if goes_on:
                    told("the next stage", 0.5)
                    raise AssertionError("it went on")
            raise AssertionError("it was done")

        before = signal.getsignal(signal.SIGINT)
        with monkeypatch.context() as patched:
            patched.setattr(commands, "soils", swallowing)
            done = call("soils")
        assert (done.status, done.err) == (130, "stopped: no file was written\n")
        assert signal.getsignal(signal.SIGINT) is before
        assert call("soils").status == 0  # the next command knows nothing of it
        with ThreadPoolExecutor(1) as other:  # in which Python can set no handler
            assert other.submit(call, "soils").result().status == 0

    def test_files_that_are_written_already_are_not_denied(self, monkeypatch, tmp_path):
        def interrupted(_):
            terminal.wrote(tmp_path / "a.csv")
            raise KeyboardInterrupt

        monkeypatch.setattr(commands, "soils", interrupted)
        done = call("soils")
        assert done.status == 130
        assert done.err.endswith("a.csv\nstopped: no other file was written\n")

    def test_one_during_the_imports_is_no_traceback(self, tmp_path):
        code = """
import sys
class Interrupt:
    def find_spec(self, name, path=None, target=None):
        if name == "casadi":
            raise KeyboardInterrupt
sys.meta_path.insert(0, Interrupt())
from plough_opt.__main__ import main
sys.exit(main())
"""
        line = [sys.executable, "-c", code, "init", str(tmp_path / "a.toml")]
        done = subprocess.run(line, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stdout, done.stderr) == (130, "", "stopped: no file was written\n")


def test_an_output_that_may_not_be_written_is_refused(monkeypatch, tmp_path):
    monkeypatch.setattr(os, "access", lambda *_: False)  # a superuser may write anywhere
    done = call("simulate", SUBSOILER, "--plot", tmp_path / "a.png")
    assert (done.status, done.err.endswith("a.png' cannot be written: permission denied\n")) == (2, True)


def test_environments_that_cannot_be_are_bad_input(command, tmp_path):
    for variable, value, line, told in (
        ("MPLBACKEND", "bogus", ("simulate", "--plot", "a.png"), "--plot: matplotlib cannot start: "),
        ("CC", "'", ("export", "--to", "fmu", "--output", "a.fmu"), '$CC = "\'" is not a command: No closing'),
    ):
        done = command(line[0], SUBSOILER, *line[1:], environment={variable: value}, cwd=tmp_path)
        assert done.status == 2
        assert done.err.startswith(f"bad input: {told}")
        assert list(tmp_path.iterdir()) == []


# --- what a command says beside its results, that it is under way, and what editors and shells complete by ---

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
