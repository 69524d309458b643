"""Files that commands may not write to, and files that are left when they are interrupted."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from helpers.commands import call
from helpers.problem_files import SUBSOILER

from plough_opt.app import commands, terminal


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
