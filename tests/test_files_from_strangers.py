"""Files from strangers: they run no code, write nowhere else and do not command a terminal."""

import functools
import hashlib
import json
import os
import sys
import tomllib
import types
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from helpers.commands import call, printed
from helpers.problem_files import PROBLEMS, SUBSOILER
from helpers.scenes import Shank, scene_of

import plough_opt as po
from plough_opt.core.expressions import exp

NAMES = tomllib.loads(Path(__file__).with_name("strangers.toml").read_text(encoding="utf-8"))
OWN = "po.core.files.os.system json.dumps BORROWED ALIAS Plain Careless INSTANCE Plain.force"
# Imported while a result is read.
DANGEROUS = [*NAMES["dangerous"], *(f"{__name__}:{name}" for name in OWN.split())]
called = []
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


def density(r, width):
    return 1350.0 * (1.05 + 0.3 * exp(-((r / width) ** 2)))


class Group:
    """Functions that belong together."""

    @staticmethod
    def density(r, width):
        return density(r, width)


ALIAS = density
BORROWED = json.dumps


class Plain:
    """No dataclass, but with the method of an effect."""

    def __init__(self, **given):
        called.append(given)

    def force(self, travel, speed):
        return 0.0 * travel + 0.0 * speed


@dataclass(frozen=True)
class Careless:
    """A dataclass that is no effect, and acts when it is made."""

    static: float = 0.0

    def __post_init__(self):
        called.append(self)


INSTANCE = Careless.__new__(Careless)


def run_of(function=density, **effects):
    soil = po.named_soil("serozem").with_density_profile(function, 0.15, order=2)
    return po.simulate(scene_of(soil, motion=False, **effects), 0.1, outputs=4)


def forged(path, text, **changes):
    """Write a result in which texts are replaced, and return its path."""
    for old, new in changes.values():
        assert json.dumps(old) in text
        text = text.replace(json.dumps(old), json.dumps(new))
    path.write_text(text, encoding="utf-8")
    return path


def test_a_file_names_no_function_but_those_of_the_users_modules(tmp_path):
    """Whatever else it names is replaced by a function that refuses to run."""
    text, name = run_of().to_json(), f"{__name__}:density"
    assert po.load(forged(tmp_path / "a.json", text)).scene.soil.density_profile.density is density
    for path in DANGEROUS:
        file = forged(tmp_path / "a.json", text, name=(name, path))
        with pytest.raises(po.InputError, match=r"not defined here|does not name a class or a function"):
            po.simulate(po.load(file).scene, 0.1)


def test_a_file_names_no_class_but_effects_and_laws(tmp_path):
    text, name = run_of(own=(Shank(30.0),)).to_json(), "helpers.scenes:Shank"
    assert po.load(forged(tmp_path / "a.json", text)).scene.effects.own == (Shank(30.0),)
    for path in DANGEROUS:
        file = forged(tmp_path / "a.json", text, name=(name, path))
        with pytest.raises(po.InputError, match=r"not defined here|does not name a class or a function|not of type"):
            po.load(file).scene.effects.own[0].force(0.0, 1.0)
    assert called == []


WRONG_FIELDS = [
    *(("static", value) for value in ("x", None, [[[1.0]]], {"function": "os:system"}, {"class": "elsewhere:Shank"})),
    *((name, 1.0) for name in ("force", "at_rest", "__class__", "__dict__", "a b", "def", "")),
]


@pytest.mark.parametrize(("field", "value"), WRONG_FIELDS)
def test_fields_of_an_effect_have_its_types(tmp_path, field, value):
    data = json.loads(run_of(own=(Shank(30.0),)).to_json())
    (own,) = data["scene"]["effects"]["own"]
    own |= {field: value}
    if field != "static":  # such names can only be in a class that is not defined
        own["class"] = "elsewhere:Shank"
    path = tmp_path / "a.json"
    path.write_text(json.dumps(data), encoding="utf-8")
    with pytest.raises(po.InputError, match=r"scene\.effects\.own"):
        po.load(path)


def test_users_functions_effects_and_laws_are_read_again(tmp_path):
    for function in (density, Group.density):
        made = run_of(function, own=(Shank(30.0),))
        found = po.load(made.save(tmp_path / "a.json"))
        assert found.scene == made.scene
        assert found.scene.soil.density_profile.density is function
        assert po.simulate(found.scene, 0.1, outputs=4).mean_draft == made.mean_draft
    steep = po.Wedge(po.deg(30), po.deg(55), 0.25)
    scene = scene_of(share=steep, medium=po.laws.LAWS["mckyes_ali"](), motion=False)
    assert po.load(po.simulate(scene, 0.1).save(tmp_path / "a.json")).scene == scene


@pytest.mark.parametrize("entry", [True, False])
def test_an_installed_package_counts_if_it_is_an_addition(tmp_path, monkeypatch, entry):
    package = types.ModuleType("my_soils")
    package.__file__ = str(tmp_path / "site-packages" / "my_soils.py")
    exec("def density(r, width):\n    return 1400.0 + 0.0 * r", vars(package))
    monkeypatch.setitem(sys.modules, "my_soils", package)
    monkeypatch.setattr("plough_opt.core.plain_data.additions", lambda: {"my_soils"} if entry else set())
    found = po.load(run_of(package.density).save(tmp_path / "a.json")).scene.soil.density_profile.density
    assert (found is package.density) == entry


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


@pytest.mark.parametrize("place", ["file", "data"])
def test_a_problem_is_restored_below_its_folder(tmp_path, place):
    """Names that lead elsewhere on any system, by themselves or by links, leave nothing anywhere."""
    outside = tmp_path / "outside"
    outside.mkdir()
    for number, name in enumerate(NAMES["elsewhere"]):
        given = {"file": name} if place == "file" else {"data": {"fine.csv": "a", name: "b"}}
        path, target = with_origin(tmp_path / "a.json", **given), tmp_path / "in" / str(number)
        target.mkdir(parents=True)
        (target / "link").symlink_to(outside, target_is_directory=True)
        (target / "subsoiler.TOML").symlink_to(outside / "y")
        before = {*tmp_path.rglob("*")}
        done = call("show", path, "--restore", target)
        assert done.status == 2, name
        assert {*tmp_path.rglob("*")} == before, (name, done)


def test_files_that_are_one_on_some_systems_are_not_restored(tmp_path):
    for data in ({"a.csv": "1", "A.csv": "2"}, {"x/\u00e9.csv": "1", "x/e\u0301.csv": "2"}, {"SHARE.toml": "1"},
                 {"x/a.csv": "1", "x\\a.csv": "2"}, {"share.toml": "1"}, {"A": "1", "a/b.csv": "2"},
                 {"SHARE.toml/b.csv": "1"}, {"x/a.csv": "1", "x//a.csv": "2"},
                 {"x/a.csv": "1", "x/./a.csv": "2"}):  # fmt: skip
        path = with_origin(tmp_path / "a.json", file="share.toml", data=data)
        done = call("show", path, "--restore", tmp_path / "new")
        assert (done.status, "the same" in done.said) == (2, True)
        assert not (tmp_path / "new").exists()


def test_a_changed_problem_is_not_shown(tmp_path):
    text = SUBSOILER.read_text(encoding="utf-8")
    for changes in ({"text": text + "\n"}, {"sha256": "0" * 64}, {"text": ""}, {"sha256": "\x1b[2J"}):
        path = with_origin(tmp_path / "a.json", **changes)
        for words in ((), ("--problem",), ("--json",), ("--restore", tmp_path / "new")):
            done = call("show", path, *words)
            assert (done.status, done.out, "SHA-256" in done.said) == (2, "", True)
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(("mark", "end"), [("", "\n"), ("", "\r\n"), ("\ufeff", "\n")])
def test_problem_and_data_are_restored_byte_for_byte(tmp_path, mark, end):
    """Line ends and byte order marks as well, under the digest of the file."""
    (tmp_path / "in").mkdir()
    for name in ("field.toml", "insertions.csv", "transect.csv"):
        text = mark + (PROBLEMS / name).read_text(encoding="utf-8").replace("\n", end)
        (tmp_path / "in" / name).write_bytes(text.encode())
    run = po.read_problem(tmp_path / "in" / "field.toml").simulate()
    path = run.save(tmp_path / "a.json")
    origin = po.load(path).origin
    assert origin.sha256 == hashlib.sha256((tmp_path / "in" / "field.toml").read_bytes()).hexdigest()
    printed("show", path, "--restore", tmp_path / "new")
    done = call("show", path, "--restore", tmp_path / "new")
    assert (done.status, "exists already" in done.said) == (2, True)  # nothing is overwritten
    for file in (tmp_path / "in").iterdir():
        assert (tmp_path / "new" / file.name).read_bytes() == file.read_bytes()
    assert po.read_problem(tmp_path / "new" / "field.toml").simulate().mean_draft == run.mean_draft
    shown = printed("show", path, "--problem")
    assert not {"\r", "\ufeff"} & {*shown}
    for name in ("field.toml", "insertions.csv", "transect.csv"):
        assert (PROBLEMS / name).read_text(encoding="utf-8").rstrip() in shown


def test_two_data_files_of_one_name_are_both_kept(tmp_path):
    texts = [f"scene.tow_speed [m/s],mean_draft [kN],sigma [kN]\n{rows}" for rows in
             ("1,3.1,0.1\n2,4.0,0.1\n", "1.5,3.4,0.1\n2.5,4.7,0.1\n", "3,5.5,0.1\n")]  # fmt: skip
    paths = [tmp_path / folder / "draft.csv" for folder in ("monday", "tuesday", "wednesday")]
    for path, text in zip(paths, texts, strict=True):
        path.parent.mkdir()
        path.write_text(text, encoding="utf-8")
    data = [word for path in paths for word in ("--data", path)]
    unknown = ("--unknown", "soil.cohesion=1..80 kPa", "--set", "effects={motion=false}")
    printed("calibrate", PROBLEMS / "reference.toml", *data, *unknown, "--output", tmp_path / "fit.json")
    origin = po.load(tmp_path / "fit.json").origin
    assert [*origin.data.values()] == texts
    origin.restore(tmp_path / "new")
    assert sorted(file.read_text(encoding="utf-8") for file in (tmp_path / "new").glob("*.csv")) == sorted(texts)
