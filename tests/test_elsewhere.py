"""Other systems, as far as Linux shows them: cp1252 and CRLF as on Windows, and paths with blanks and umlauts.

Other tests show spawned processes (every sweep), no C compiler (test_batch_compiler.py), names that differ in case only
(test_files_from_strangers.py), and CRLF in tables of measurements (calibration/test_measurements.py).
"""

import csv
import os
import subprocess
import sys

import pytest
from helpers.problem_files import SUBSOILER

import plough_opt as po

# A file that is opened without an encoding is an error: it would be read by the system's.
OPENED = ("-X", "warn_default_encoding", "-W", "error::EncodingWarning:plough_opt")


@pytest.fixture(scope="module", params=[pytest.param("streams", marks=pytest.mark.thorough), "locale"])
def cp1252(request, tmp_path_factory):
    """Return the variables under which Python's streams, or everything that depends on the locale, is in cp1252."""
    if request.param == "streams":
        return {"PYTHONIOENCODING": "cp1252", "PYTHONUTF8": "0"}
    folder = tmp_path_factory.mktemp("locales")
    made = ["localedef", "-i", "de_DE", "-f", "CP1252", folder / "de_DE.CP1252"]
    if subprocess.run(made, capture_output=True, check=False).returncode:
        pytest.skip("no locale in cp1252 can be made: apt-get install locales")
    return {"LOCPATH": str(folder), "LC_ALL": "de_DE.CP1252", "PYTHONUTF8": "0"}


@pytest.fixture(scope="module")
def run(cp1252, tmp_path_factory):
    """Return a function that runs a command beside a problem file with CRLF, and returns what it prints."""
    folder = tmp_path_factory.mktemp("x") / "Pflüge für Böden"
    folder.mkdir()
    text = SUBSOILER.read_text(encoding="utf-8").replace("\n", "\r\n").replace('title = "', 'title = "Größe ')
    (folder / "mein Schar.toml").write_bytes(text.encode())

    def run(*arguments):
        line = [sys.executable, *OPENED, "-m", "plough_opt", *arguments]
        done = subprocess.run(line, cwd=folder, env=os.environ | cp1252, capture_output=True, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout.decode("cp1252")  # raises an error for what is not cp1252

    run.folder = folder
    return run


FILE = "mein Schar.toml"
COMMANDS = {
    "check": ("check", FILE, "--effects"),
    "c": ("export", FILE, "--to", "c", "-o", "Höhe in C"),
    "fmu": ("export", FILE, "--to", "fmu", "--sources", "-o", "Höhe.fmu"),
}


@pytest.mark.parametrize("command", ["check", *(pytest.param(one, marks=pytest.mark.thorough) for one in ("c", "fmu"))])
def test_a_command_works_in_cp1252_in_a_folder_with_blanks_and_umlauts(run, command):
    printed = run(*COMMANDS[command])
    assert printed
    for name in COMMANDS[command]:
        if name.startswith("Höhe"):
            assert (run.folder / name).exists()


def test_what_a_command_prints_and_writes_is_that_of_utf_8(run):
    brief = ("--search", "near", "--set", "scene.duration=0.2 s")
    assert run("optimise", FILE, *brief, "--plot", "Größe.png", "-o", "Größe.json")
    assert run("sweep", FILE, "--over", "share.height=0.2..0.3 m:2", "--workers", "2", "--csv", "Höhe.csv")
    assert (run.folder / "Größe.png").exists()
    loaded = po.load(run.folder / "Größe.json")
    problem = po.read_problem(run.folder / FILE, ["scene.duration=0.2 s"])
    assert problem.table.title.startswith("Größe ")
    assert loaded.objective == pytest.approx(problem.optimise(search="near")[0].objective, rel=1e-9)
    with (run.folder / "Höhe.csv").open(encoding="utf-8", newline="") as file:
        rows = [*csv.DictReader(file)]
    heights = [float(row["share.height [m]"]) for row in rows]
    assert heights == [0.2, 0.3]
    alone = [po.simulate(problem.scene({"share.height": x}), 2.0).mean_draft for x in heights]
    assert [float(row["mean_draft [N]"]) for row in rows] == pytest.approx(alone, rel=1e-6)
