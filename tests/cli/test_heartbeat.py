"""Lines that say that a computation is under way, on a stream that is not a terminal."""

import io
import time

import pytest
from rich.console import Console

from plough_opt.app import commands
from plough_opt.core import process as module
from plough_opt.core.process import heartbeat
from plough_opt.studies.sweep.sweeping import bar


def until(true):
    """Wait for what another thread does."""
    while not true():
        time.sleep(0.01)


def test_it_says_what_is_being_done_until_it_is_done():
    lines = []
    with heartbeat(lines.append, every=0.01) as told:
        until(lambda: len(lines) >= 2)
        told("calibrating")
        until(lambda: lines[-1].startswith("calibrating: "))
    count = len(lines)
    assert lines[0] == "working: 0 s so far"
    time.sleep(0.05)
    assert len(lines) == count


def test_what_is_soon_done_says_nothing():
    lines = []
    with heartbeat(lines.append):
        pass
    assert lines == []


@pytest.mark.parametrize("error", [BrokenPipeError, ValueError("closed file")])
def test_a_reader_that_went_away_is_no_matter(error):
    tried = []

    def gone(line):
        tried.append(line)
        raise error

    with heartbeat(gone, every=0.01):
        until(lambda: tried)
    assert len(tried) == 1


def test_commands_and_sweeps_say_it(cli, monkeypatch):
    monkeypatch.setattr(module, "EVERY", 0.01)

    def long(_):
        with commands.progress() as told:
            told("calibrating", 0.5)
            time.sleep(0.1)

    monkeypatch.setattr(commands, "soils", long)
    done = cli("soils")
    assert done.status == 0
    assert "calibrating: 0 s so far\n" in done.err
    stream = io.StringIO()
    with bar(Console(file=stream)) as told:
        told(3, 10, 1)
        until(lambda: "3 of 10" in stream.getvalue())
    assert "sweep: 3 of 10 points, 1 failed: 0 s so far\n" in stream.getvalue()
