"""docs/report.md: its examples run, and its figures are those of the files."""

import gzip
import re
from pathlib import Path

import ezdxf
import trimesh

from plough_opt.app import main
from plough_opt.app.page.writing import ASSETS

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs" / "report.md").read_text(encoding="utf-8")


def test_the_examples_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names = {}
    for text in re.findall(r"```python\n(.*?)```", TEXT, flags=re.DOTALL):
        exec(compile(text, "report.md", "exec"), names)  # the page's own text
    assert f"{1e4 * names['share'].area:.1f} cm^2 of faces" in capsys.readouterr().out
    assert names["plate"].volume < names["block"].volume
    assert trimesh.load_mesh("out/cone.stl").is_watertight
    assert {path.name for path in Path("out").iterdir()} == {"share.dxf", "cone.stl", "share.gif", "share.html"}


def test_its_commands_are_commands(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    lines = [line.split("plough-opt ")[1] for line in re.findall(r"^plough-opt .*", TEXT, flags=re.MULTILINE)]
    assert [line.partition(" ")[0] for line in lines] == ["report", "export", "export"]
    for line in lines[1:]:
        words = [word.strip('"') for word in re.findall(r'"[^"]*"|\S+', line.replace("problems/", f"{ROOT}/problems/"))]
        at = [] if "--at" in words else ["--at", "guess"]  # without the search for the best
        assert main([*words, *at]) == 0
    assert ezdxf.readfile("out/share.dxf").modelspace()


def test_scripts_by_others_are_small_and_licensed():
    scripts = [path for path in ASSETS.iterdir() if path.name.endswith(".min.js")]
    licences = (ASSETS / "LICENSES.txt").read_text(encoding="utf-8")
    assert all(path.name in licences for path in scripts)
    size = sum(len(gzip.compress(path.read_bytes())) for path in scripts)
    assert f"{size / 1000:.0f} kB compressed" in TEXT
