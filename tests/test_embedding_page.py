"""docs/embedding.md: its commands and examples run, in order."""

import re
import shlex
import sys
from pathlib import Path

import pytest

from plough_opt.app import main
from plough_opt.core.quantities import EVERY
from plough_opt.motion.vocabulary import MEASURES

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "docs" / "embedding.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```(\w+)\n(.*?)```", TEXT, flags=re.DOTALL)


def test_there_are_commands_and_examples():
    assert [language for language, _ in BLOCKS] == ["python", "python", "sh", "python", "python"]


def test_the_tables_hold_every_name_and_no_other():
    rows = re.findall(r"^\| ([^|]*`[^|]*) \| ([^|]*) \|$", TEXT, flags=re.MULTILINE)
    named = {name for names, _ in rows for name in re.findall(r"`([\w.]+)`", names)} - {"steel_density"}
    # Further strength waves are named in a sentence.
    assert named == {name for name in (*EVERY, *MEASURES) if not re.search(r"wave_\d", name)}
    units = {unit.strip() for _, column in rows for unit in column.split(";")}
    known = {one.unit for one in EVERY.values()} | {one.unit.symbol for one in MEASURES.values()}
    assert {unit or "1" for unit in known} == units


def test_commands_and_examples_run_in_order(tmp_path, monkeypatch, capsys):
    pytest.importorskip("openmdao")
    monkeypatch.setenv("OPENMDAO_REPORTS", "0")
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.chdir(tmp_path)
    (tmp_path / "problems").symlink_to(ROOT / "problems")
    printed = []
    for language, text in BLOCKS:
        if language == "sh":
            for line in text.splitlines():
                assert main(shlex.split(line)[1:]) == 0, line
        else:
            exec(compile(text, "embedding.md", "exec"), {})  # the page's own text
        printed.append(capsys.readouterr().out)
    sys.modules.pop("share", None)
    assert "share.height [m] 0.2 to 0.3, value 0.25" in printed[1]
    # OpenMDAO at the global optimum of R1, and CasADi's Jacobian.
    assert "True [0.82500571] [39.1146985" in printed[4]
    assert "jac_share" in printed[3]
