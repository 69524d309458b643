"""How much a command says beside its results, and what editors and shells complete by."""

import json
import logging
import subprocess

import pytest

from plough_opt.app import main

COTTON = "problems/cotton_subsoiler.toml"


@pytest.fixture
def cotton(request):
    """Return the path of a problem file."""
    return str(request.config.rootpath / COTTON)


def simulated(capsys, *options):
    """Return what both streams get from a simulation."""
    assert main(["simulate", *options]) == 0
    return capsys.readouterr()


def test_quiet_leaves_results_alone_and_the_error_stream_empty(cotton, capsys, tmp_path):
    options = (cotton, "--set", "share.height=0.3 m", "--json")
    loud = simulated(capsys, *options, "--plot", str(tmp_path / "a.png"))
    silent = simulated(capsys, *options, "--plot", str(tmp_path / "b.png"), "--quiet")
    assert "wrote" in loud.err
    assert silent.err == ""
    assert json.loads(silent.out)["averages"] == json.loads(loud.out)["averages"]


def test_quiet_does_not_silence_errors(cotton, capsys):
    assert main(["simulate", "-q", cotton, "--set", "share.hight=0.3 m"]) == 2
    assert "share.hight" in capsys.readouterr().err


def test_verbose_says_each_step_and_twice_each_run(cotton, capsys):
    once, twice = simulated(capsys, cotton, "-v").err, simulated(capsys, cotton, "-vv").err
    assert "simulating" in once
    assert "estimated error" not in once
    assert "estimated error" in twice


def test_logging_is_left_as_it_was(cotton, capsys):
    library = logging.getLogger("plough_opt")
    before = library.level, list(library.handlers)
    simulated(capsys, cotton, "-vv")
    assert (library.level, library.handlers) == (before[0], before[1])


def test_quiet_and_verbose_exclude_each_other(cotton, capsys):
    with pytest.raises(SystemExit, match="2"):
        main(["simulate", cotton, "-q", "-v"])
    assert "not allowed" in capsys.readouterr().err


def test_schema_is_printed_as_json(capsys):
    assert main(["schema"]) == 0
    assert json.loads(capsys.readouterr().out)["properties"]["require"]


def test_bash_completes_commands_and_options(capsys, tmp_path):
    assert main(["completion", "bash"]) == 0
    script = tmp_path / "completion.sh"
    script.write_text(capsys.readouterr().out, encoding="utf-8")
    ask = (
        f"source {script}; COMP_WORDS=(plough-opt {{words}}); COMP_CWORD={{last}};"
        ' _shtab_plough_opt; echo "${{COMPREPLY[@]}}"'
    )
    for words, last, expected in (("opt", 1, "optimise optimize"), ("optimise --sen", 2, "--sensitivity")):
        line = ask.format(words=words, last=last)
        done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=True)
        assert done.stdout.split() == expected.split()


def test_a_shell_without_completion_is_refused_with_those_that_have_one(capsys):
    with pytest.raises(SystemExit, match="2"):
        main(["completion", "cmd"])
    assert "bash" in capsys.readouterr().err
