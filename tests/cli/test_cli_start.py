"""What each command imports before it begins: counted in modules, by a process of its own."""

import json
import subprocess
import sys

import pytest
from helpers.problem_files import SUBSOILER

NUMERICAL = {"casadi", "matplotlib", "numpy", "pint", "pydantic", "scipy"}
ROOMS = ("soil", "laws", "motion", "design", "studies", "problem_file")
SCRIPT = """
import contextlib, io, json, sys
sys.argv[0] = "plough-opt"
from plough_opt.__main__ import main
with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.suppress(SystemExit):
    main()
print(json.dumps([out.getvalue(), sorted(sys.modules)]))
"""


def started(*arguments):
    """Return what a command prints, and the modules that it imported."""
    line = [sys.executable, "-c", SCRIPT, *map(str, arguments)]
    done = subprocess.run(line, capture_output=True, text=True, check=True, timeout=60)
    out, modules = json.loads(done.stdout)
    return out, set(modules)


@pytest.mark.parametrize(
    ("arguments", "shown"),
    [
        (["--help"], "calibrate"), (["--version"], "plough-opt"), (["completion", "bash"], "--judge"),
        (["optimise", "--help"], "--judge"), (["sweep", "--help"], "--scheduler"), (["export", "--help"], "FMU"),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, list) else "",
)  # fmt: skip
def test_help_and_completion_import_no_numerical_library_and_no_room(arguments, shown):
    out, modules = started(*arguments)
    assert shown in out
    assert not modules & NUMERICAL
    assert not [name for name in modules if name.startswith(tuple(f"plough_opt.{room}" for room in ROOMS))]


@pytest.mark.parametrize("command", ["check", "simulate"])
def test_a_command_imports_only_what_it_uses(command):
    out, modules = started(command, SUBSOILER)
    assert "mean draft" in out if command == "simulate" else "3 requirements" in out
    # All units of the file are common ones, which need no registry; nothing is optimised, drawn or studied.
    assert not modules & {"matplotlib", "pint", "scipy"}
    assert not [name for name in modules if name.startswith("plough_opt.design")]
    assert not {"plough_opt.studies.tradeoff", "plough_opt.studies.uncertainty", "plough_opt.app.plots"} & modules


def test_an_optimisation_needs_no_registry_of_units_and_draws_nothing():
    _, modules = started("optimise", SUBSOILER, "--search", "near", "--set", "scene.duration=0.2 s")
    assert "plough_opt.design" in modules
    assert not modules & {"matplotlib", "pint"}


def test_a_report_draws_with_its_own_scripts(tmp_path):
    guess = ("--set=share.wedge_angle=25 deg", "--set=share.height=0.25 m", "--set=scene.stiffness=50 kN/m")
    _, modules = started("report", SUBSOILER, *guess, "--no-accuracy", "--output", tmp_path / "a.html")
    assert (tmp_path / "a.html").stat().st_size > 10_000
    assert not modules & {"matplotlib", "pint"}
