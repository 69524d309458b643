"""`plough-opt sweep`: tables, resumption, Ctrl-C and failures."""

import csv
import re
import signal
import subprocess
import sys

import numpy as np
import pytest
from helpers import swept
from helpers.commands import call
from helpers.problem_files import REFERENCE, SUBSOILER

import plough_opt as po

BRIEF = ("--set", "scene.duration=0.2 s", "--set", "scene.outputs=40")
OVER = ("--over", 'soil.cohesion="5..45 kPa:3"', "--over", "scene.tow_speed=1 m/s, 3 m/s")


def test_a_sweep_is_reported_written_and_resumed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    command = ("sweep", SUBSOILER, *BRIEF, *OVER, "--workers", "1")
    done = call(*command, "--csv", "deep/table.csv", "--npz", "table.npz", "--plot", "deep/picture.svg")
    assert done.status == 0, done.err
    assert "Subsoiler for cotton on serozem\n6 points, 0 failed" in done.out
    assert re.search(r"│ mean_draft +│ +[0-9.]+ kN │ cohesion 5 kPa +│ +[0-9.]+ kN │ cohesion 45 kPa", done.out)
    assert "Each point is simulated by po.simulate; stored in cotton_subsoiler-" in done.out
    assert "Note: at 6 of 6 points: ambient pressure (101.3 kPa) carries" in done.out
    assert "wrote deep/table.csv" in done.err
    assert "</svg>" in (tmp_path / "deep" / "picture.svg").read_text()
    rows = list(csv.reader((tmp_path / "deep" / "table.csv").read_text().splitlines()))
    assert rows[0][:4] == ["point", "soil.cohesion [Pa]", "scene.tow_speed [m/s]", "mean_draft [N]"]
    run = po.read_problem(SUBSOILER, BRIEF[1::2]).simulate({"soil.cohesion": 25e3, "scene.tow_speed": 3.0})
    assert float(rows[4][3]) == run.mean_draft
    with np.load(tmp_path / "table.npz") as arrays:
        assert arrays["mean_draft"][3] == run.mean_draft

    # Nothing is computed any more, and so no process begins.
    again = call(*command, "--csv", "again.csv")
    assert again.status == 0
    assert "6 points were stored before" in again.out
    assert (tmp_path / "again.csv").read_bytes() == (tmp_path / "deep" / "table.csv").read_bytes()
    assert len(list(tmp_path.glob("*.sweep.db"))) == 1


@pytest.mark.usefixtures("ctrl_c")
def test_ctrl_c_leaves_a_store_that_goes_on(tmp_path):
    file = str(tmp_path / "stick.toml")
    call("init", file)
    store, table = tmp_path / "sweep.db", tmp_path / "table.csv"
    over = ("--over", "soil.cohesion=5..45 kPa:100", "--over", "scene.tow_speed=1..3 m/s:100", "--method", "each")
    command = ("sweep", file, *over, "--workers", "1", "--store", str(store))
    process = subprocess.Popen([sys.executable, "-m", "plough_opt", *command], stderr=subprocess.PIPE, text=True)
    try:
        swept.until(lambda: swept.stored(store), process)
        process.send_signal(signal.SIGINT)
        error = process.communicate(timeout=60)[1]
    finally:
        process.kill()
    kept = len(swept.stored(store))
    assert 0 < kept < 10_000
    assert process.returncode == 130
    # Before it, where the machine is slow, how far it was after every ten seconds.
    expected = f"stopped: {kept} of 10000 points are in '{store}': the same sweep continues from there"
    assert error.splitlines()[-1] == expected
    # Another question is refused with what differs; the same one goes on (that it repeats nothing is tested elsewhere).
    other = call(*command, "--set", "scene.frame_mass=25 kg", "--csv", table)
    assert other.status == 2
    assert "scene.frame_mass: 20.0 there, 25.0 here" in other.said
    assert not table.exists()


def test_failures_are_reported(tmp_path, monkeypatch):
    monkeypatch.setattr("plough_opt.studies.sweep.result._QUOTED", 1)
    over = ("--over", "share.height=0.12..0.13 m", "--samples", "3", "--set", "effects.motion=false", "--optimise")
    store, table = tmp_path / "sweep.db", tmp_path / "table.csv"
    done = call("sweep", REFERENCE, *over, "--workers", "1", "--store", store, "--csv", table)
    assert done.status == 1
    assert "3 points, 3 failed" in done.out
    assert len(re.findall(r"failed at share.height = 0.12[0-9]* m: .*'loosened_radius'", done.out)) == 1
    assert "and 2 more failed" in done.out
    assert table.read_text().count("'loosened_radius'") == 3
    assert "note: 'share.height' is a variable of the file: every point fixes it" in done.err
    assert "note: 3 samples are not a power of two" in done.err
    assert "no solution: every point failed" in done.err
