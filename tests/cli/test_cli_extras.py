"""Commands that need an extra say so first."""

import shlex
import sys

import pytest
from helpers.commands import call

MISSING = [
    ("report FILE --output a.html", "jinja2", "report"),
    ("export FILE --to openmdao --output a", "openmdao", "openmdao"),
    ("export FILE --to stl --output a.stl", "trimesh", "parts"),
    ("export FILE --to gltf --output a.glb", "trimesh", "parts"),
    ("export FILE --to dxf --output a.dxf", "ezdxf", "parts"),
    ("export FILE --to step --output a.step", "build123d", "step"),
    ("sweep FILE --over share.height='0.2..0.3 m:3' --scheduler tcp://127.0.0.1:1", "distributed", "cluster"),
]


@pytest.mark.parametrize(("command", "library", "extra"), MISSING)
def test_extras_are_looked_for_before_anything_is_read(monkeypatch, tmp_path, command, library, extra):
    """Even the file need not exist."""
    monkeypatch.chdir(tmp_path)
    for name in [name for name in sys.modules if name.partition(".")[0] == library]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, library, None)
    done = call(*shlex.split(command.replace("FILE", "missing.toml")))
    assert (done.status, f"pip install 'plough_opt[{extra}]'" in done.said) == (2, True), done.err
    assert "missing.toml" not in done.said
