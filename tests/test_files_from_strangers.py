"""Files from strangers: they run no code, write nowhere else and do not command a terminal."""

import functools
import hashlib
import json
import os
import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import pytest
from helpers.commands import call, printed
from helpers.problem_files import PROBLEMS, SUBSOILER
from helpers.scenes import Shank, scene_of

import plough_opt as po

NAMES = tomllib.loads(Path(__file__).with_name("strangers.toml").read_text(encoding="utf-8"))
acts = []  # what programs are started and what is written, while a list is there


def _watch(event, arguments):
    """Note programs that are started, and files that are opened to write, renamed or removed."""
    if _watch.folder is None:
        return
    opened = event == "open" and arguments[2] & WRITING
    if (opened or event in CHANGES) and isinstance(arguments[0], str | bytes | os.PathLike):
        place = os.fsdecode(arguments[0])
    elif event in ("os.system", "os.exec", "os.fork", "os.posix_spawn", "subprocess.Popen", "socket.connect"):
        place = "/"
    else:
        return
    inside = os.path.realpath(place).startswith((os.path.realpath(_watch.folder), os.devnull))
    if not inside and "__pycache__" not in place:
        acts.append((event, arguments))


_watch.folder = None
CHANGES = ("os.remove", "os.rename", "os.mkdir", "os.rmdir", "os.link", "os.symlink", "os.chmod", "os.truncate")
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC
sys.addaudithook(_watch)


@pytest.fixture(autouse=True)
def _nothing_else_happens(tmp_path):
    """Fail a test that starts a program or writes outside its folder."""
    acts.clear()
    _watch.folder = tmp_path
    yield
    _watch.folder = None
    assert acts == []


def run_of(**effects):
    soil = po.named_soil("serozem").with_density_profile(lambda r: 1400.0 + 0.0 * r, order=2)
    return po.simulate(scene_of(soil, motion=False, **effects), 0.1, outputs=4)


def test_a_file_imports_and_calls_nothing(tmp_path):
    """Where it names a class it can name one of a few; what else it names is refused or shown, and never looked up."""
    path, text = tmp_path / "a.json", run_of(own=(Shank(30.0),)).to_json()
    for name in NAMES["dangerous"]:
        data = json.loads(text)
        scene = data["scene"]
        scene["effects"]["own"][0] = scene["soil"]["density_profile"]["density"] = {"not saved": name}
        path.write_text(json.dumps(data), encoding="utf-8")
        found = po.load(path).scene
        assert (found.effects.own[0].name, found.soil.density_profile.density.name) == (name, name)
        with pytest.raises(po.InputError, match="a saved result only names"):
            po.simulate(found, 0.1)
        for place in ("share", "medium"):
            path.write_text(json.dumps(data | {"scene": scene | {place: {"class": name}}}), encoding="utf-8")
            with pytest.raises(po.InputError, match=rf"at scene\.{place}: "):
                po.load(path)


def test_toolkits_own_effects_and_laws_are_read_again(tmp_path):
    steep = po.Wedge(po.deg(30), po.deg(55), 0.25)
    scene = scene_of(share=steep, medium=po.laws.LAWS["mckyes_ali"](), motion=False)
    assert po.load(po.simulate(scene, 0.1).save(tmp_path / "a.json")).scene == scene


@functools.cache
def run_with_origin():
    """Return a run with an origin, as JSON data."""
    problem = po.read_problem(SUBSOILER, ["scene.outputs=4"])
    return replace(run_of(), origin=problem.origin).to_json()


def with_origin(path, **changes):
    """Write a result whose origin is changed, and return the path."""
    data = json.loads(run_with_origin())
    data["origin"] |= changes
    path.write_text(json.dumps(data), encoding="utf-8")
    return path


def test_a_changed_problem_is_not_shown(tmp_path):
    text = SUBSOILER.read_text(encoding="utf-8")
    for changes in ({"text": text + "\n"}, {"sha256": "0" * 64}, {"text": ""}, {"sha256": "\x1b[2J"}):
        path = with_origin(tmp_path / "a.json", **changes)
        for words in ((), ("--problem",), ("--json",)):
            done = call("show", path, *words)
            assert (done.status, done.out, "SHA-256" in done.said) == (2, "", True)


@pytest.mark.parametrize(("mark", "end"), [("", "\n"), ("", "\r\n"), ("\ufeff", "\n")])
def test_problem_and_data_are_saved_byte_for_byte(tmp_path, mark, end):
    """Line ends and byte order marks as well, under the digest of the file."""
    (tmp_path / "in").mkdir()
    for name in ("field.toml", "insertions.csv", "transect.csv"):
        text = mark + (PROBLEMS / name).read_text(encoding="utf-8").replace("\n", end)
        (tmp_path / "in" / name).write_bytes(text.encode())
    run = po.read_problem(tmp_path / "in" / "field.toml").simulate()
    path = run.save(tmp_path / "a.json")
    origin = po.load(path).origin
    assert origin.sha256 == hashlib.sha256((tmp_path / "in" / "field.toml").read_bytes()).hexdigest()
    for file in (tmp_path / "in").iterdir():
        assert {origin.file: origin.text, **origin.data}[file.name].encode() == file.read_bytes()
    shown = printed("show", path, "--problem")
    assert not {"\r", "\ufeff"} & {*shown}
    for name in ("field.toml", "insertions.csv", "transect.csv"):
        assert (PROBLEMS / name).read_text(encoding="utf-8").rstrip() in shown
