"""Files that commands may not write to, and files that are left when they are interrupted."""

import os
import shutil
import signal
import subprocess
import sys
import time

import pytest
from helpers.commands import call
from helpers.problem_files import PROBLEMS, SUBSOILER

from plough_opt.app import commands, terminal

FRONT = "draft_against_loosening.toml"
SWEEP = ("--over", "soil.cohesion=5..45 kPa:3")


@pytest.fixture
def own(tmp_path):
    """Return a folder with a problem file and data that a command must leave alone."""
    for name in (FRONT, "calibration.toml", "synthetic_draft.csv"):
        shutil.copy(PROBLEMS / name, tmp_path / name)
    return tmp_path


@pytest.mark.parametrize(
    ("verb", "name", "options", "overwritten"),
    [
        ("tradeoff", FRONT, ("--csv", FRONT), "--csv 'FILE' is the problem file"),
        ("sweep", FRONT, (*SWEEP, "--store", FRONT), "--store 'FILE' is the problem file"),
        ("calibrate", "calibration.toml", ("--output", "synthetic_draft.csv"), "--output 'FILE' is a data file"),
        ("tradeoff", FRONT, ("--csv", "x", "--output", "x"), "--output 'x' is also the file of --csv"),
    ],
)
def test_no_output_overwrites_an_input_or_another_output(own, monkeypatch, verb, name, options, overwritten):
    monkeypatch.chdir(own)
    before = {path.name: path.read_bytes() for path in own.iterdir()}
    data = ("--data", "synthetic_draft.csv") if verb == "calibrate" else ()
    done = call(verb, name, *data, *options)
    assert done.status == 2
    assert f"{overwritten.replace('FILE', options[-1])}, which it would overwrite: name another" in done.err
    assert done.out == ""
    assert {path.name: path.read_bytes() for path in own.iterdir()} == before


@pytest.mark.parametrize(
    ("target", "words"), [(FRONT, "is the problem file"), ("link.csv", "link.csv' cannot be written")]
)
def test_a_link_is_what_it_leads_to_even_in_a_circle(own, target, words):
    (own / "link.csv").symlink_to(own / target)
    done = call("tradeoff", own / FRONT, "--csv", own / "link.csv", "--points", "5", "--set", "scene.duration=0.1 s")
    assert done.status == 2
    assert words in done.err.replace("\n", "")


def test_an_output_in_a_folder_that_is_a_file_is_refused_before_anything_is_computed(own, monkeypatch):
    monkeypatch.setattr(commands, "progress", None)
    done = call("optimise", SUBSOILER, "--plot", own / FRONT / "new" / "a.png")
    assert done.status == 2
    assert done.out == ""
    assert f"cannot be written: '{own / FRONT}' is not a folder" in done.err


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
from plough_opt_command import main
sys.exit(main())
"""
        line = [sys.executable, "-c", code, "init", str(tmp_path / "a.toml")]
        done = subprocess.run(line, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stdout, done.stderr) == (130, "", "stopped: no file was written\n")


def test_no_command_to_the_terminal_comes_out_of_a_name(tmp_path):
    for line in (("check", "\x1b[31m.toml"), ("check", SUBSOILER, "--set", "\x1b]0;x\x07=1"), ("init", "\x1b[2J/a")):
        done = call(*line)
        assert (done.status, done.out) == (2, "")
        assert "\\x1b" in done.err
        assert "\x1b" not in done.err + done.out
    done = call("init", tmp_path / "\x1b[2J.toml")
    assert "wrote" in done.out
    assert "\x1b" not in done.out + done.err


@pytest.mark.parametrize(
    ("variable", "value", "line", "told"),
    [
        ("MPLBACKEND", "bogus", ("simulate", "--plot", "a.png"), "--plot: matplotlib cannot start: "),
        (
            "CC",
            "'",
            ("export", "--to", "fmu", "--output", "a.fmu"),
            '$CC = "\'" is not a command: No closing quotation',
        ),
    ],
)
def test_environments_that_cannot_be_are_bad_input(command, tmp_path, variable, value, line, told):
    done = command(line[0], SUBSOILER, *line[1:], environment={variable: value}, cwd=tmp_path)
    assert done.status == 2
    assert done.err.startswith(f"bad input: {told}")
    assert list(tmp_path.iterdir()) == []
