"""How much a command says beside its results, and what editors and shells complete by."""

import json
import logging
import subprocess

import pytest

from plough_opt.app import main

BRIEF = ("--set", "scene.duration=0.2 s", "--set", "scene.outputs=20")


def test_quiet_leaves_results_alone_and_the_error_stream_empty(cli, cotton, tmp_path):
    options = ("simulate", cotton, "--set", "share.height=0.3 m", "--json", *BRIEF)
    loud = cli(*options, "--plot", tmp_path / "a.png")
    silent = cli(*options, "--plot", tmp_path / "b.png", "--quiet")
    assert "wrote" in loud.err
    assert silent.err == ""
    assert json.loads(silent.out)["averages"] == json.loads(loud.out)["averages"]
    wrong = cli("simulate", "-q", cotton, "--set", "share.hight=0.3 m")
    assert wrong.status == 2
    assert "share.hight" in wrong.err


def test_verbose_says_each_step_and_twice_each_run_and_leaves_logging_as_it_was(cli, cotton):
    library = logging.getLogger("plough_opt")
    before = library.level, list(library.handlers)
    once, twice = (cli("simulate", cotton, how, *BRIEF).err for how in ("-v", "-vv"))
    assert "simulating" in once
    assert "estimated error" not in once
    assert "estimated error" in twice
    assert (library.level, library.handlers) == before


@pytest.mark.parametrize(
    ("arguments", "words"), [(["simulate", "a.toml", "-q", "-v"], "not allowed"), (["completion", "cmd"], "bash")]
)
def test_options_that_cannot_be_are_refused_with_those_that_can(capsys, arguments, words):
    with pytest.raises(SystemExit, match="2"):
        main(arguments)
    assert words in capsys.readouterr().err


def test_schema_is_printed_as_json(cli):
    assert json.loads(cli("schema").out)["properties"]["require"]


def test_bash_completes_commands_and_options(cli, tmp_path):
    script = tmp_path / "completion.sh"
    script.write_text(cli("completion", "bash").out, encoding="utf-8")
    for words, last, expected in (("opt", 1, "optimise optimize"), ("optimise --sen", 2, "--sensitivity")):
        line = f"source {script}; COMP_WORDS=(plough-opt {words}); COMP_CWORD={last}; _shtab_plough_opt"
        done = subprocess.run(
            ["bash", "-c", f'{line}; echo "${{COMPREPLY[@]}}"'], capture_output=True, text=True, check=True
        )
        assert done.stdout.split() == expected.split()
