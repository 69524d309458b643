"""CONTRIBUTING.md: its five additions are taken from the page, added from outside the package, and used."""

import csv
import json
import re
import shlex
import sys
from pathlib import Path

import pytest
from helpers.commands import call, line_of_a_page, printed

import plough_opt as po
from plough_opt.exchange.export.formats import FORMATS
from plough_opt.laws import LAWS
from plough_opt.motion.effects import OWN_EFFECTS
from plough_opt.motion.methods import METHODS
from plough_opt.motion.vocabulary import MEASURES, called

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
BLOCKS = re.compile(r"```(\w+)\n(.*?)```", re.DOTALL)
INTRODUCTION, *PARTS = re.split(r"^### ", TEXT, flags=re.MULTILINE)
SECTIONS = {part.partition("\n")[0]: BLOCKS.findall(part) for part in PARTS}
REGISTRIES = (OWN_EFFECTS, LAWS, MEASURES, FORMATS, METHODS)


def module_of(section):
    """Return the name and the text of the one file that a section adds."""
    (text,) = (text for language, text in SECTIONS[section] if language == "python" and text.startswith("# "))
    return re.match(r"# (\w+)\.py\n", text)[1], text


@pytest.fixture
def workshop(tmp_path, monkeypatch):
    """Return a function that puts a section's modules and files where a user would, and removes what they add."""
    before, known = [dict(registry) for registry in REGISTRIES], {*sys.modules}
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    kinds = dict(BLOCKS.findall(INTRODUCTION[INTRODUCTION.index("The examples below") :]))

    def install(section):
        name, text = module_of(section)
        # An installed package, as its entry points are found.
        Path("mine-1.0.dist-info").mkdir()
        for file, content in {
            "tine.toml": kinds["toml"],
            "scene_of_mine.py": kinds["python"],
            f"{name}.py": text,
            "mine-1.0.dist-info/METADATA": "Metadata-Version: 2.1\nName: mine\nVersion: 1.0\n",
            "mine-1.0.dist-info/entry_points.txt": f"[plough_opt]\n{name} = {name}\n",
        }.items():
            Path(file).write_text(content, encoding="utf-8")
        return name

    yield install
    for registry, own in zip(REGISTRIES, before, strict=True):
        registry.clear()
        registry.update(own)
    for name in {*sys.modules} - known:
        if str(tmp_path) in (getattr(sys.modules[name], "__file__", None) or ""):
            del sys.modules[name]


def use(section, capsys, long=False):
    """Run a section's other blocks in order, or only its lines that take long; return what each of them printed."""
    said = []
    for language, text in SECTIONS[section]:
        if language == "sh":
            lines = [line for line in text.splitlines() if ("accuracy tine" in line) is long]
            said.append("".join(map(line_of_a_page, lines)))
        elif not long and not text.startswith("# "):
            exec(compile(text, f"CONTRIBUTING.md, {section}", "exec"), {})  # the page's own text
            said.append(capsys.readouterr().out)
    return said


def refused(line, told):
    """Check that a command refuses its arguments with some words."""
    done = call(*shlex.split(line))
    assert done.status == 2
    assert told in done.said


def test_the_page_shows_five_additions_each_one_file_and_one_line():
    assert list(SECTIONS) == ["An effect", "A resistance law", "A measure", "An export format", "An integrator"]
    for section in SECTIONS:
        line = r"^(?:po\.laws\.)?(OWN_EFFECTS|LAWS|MEASURES|FORMATS|METHODS)\["
        assert len(re.findall(line, module_of(section)[1], flags=re.MULTILINE)) == 1, section
    named = re.findall(r"`(plough_opt/[\w/]+\.py)`", TEXT)
    assert len(named) == 5
    assert all((ROOT / path).exists() for path in named)


def test_effect(workshop, capsys):
    workshop("An effect")
    first, second = use("An effect", capsys)[0].splitlines()
    slides, sticks = map(float, first.split())
    bare = po.Scene(po.named_soil("serozem"), po.Wedge(po.deg(30), po.deg(35), 0.25), 2e5, 40.0, 2.0)
    assert slides == pytest.approx(bare.steady_resistance + 150.0 + 160.0, rel=1e-12)
    # From rest and over a short time.
    assert sticks > bare.steady_resistance / 2
    assert "viscous" in second
    shank = "[{effect='shank', static='150 N', viscous='80 N*s/m'}]"
    own = po.read_problem("tine.toml", [f"effects.own={shank}"])
    # 80 N s/m at 2 m/s.
    rise = own.simulate().mean_draft - po.read_problem("tine.toml").simulate().mean_draft
    assert rise == pytest.approx(150.0 + 160.0, rel=1e-9)
    for wrong, told in (
        ("[{effect='shank', static='150 N'}]", "is incomplete"),
        ("[{static='150 N'}]", "must be a list of tables with a name"),
        ("[{effect='shank', static='150 m', viscous='1 N*s/m'}]", "'static' = \"150 m\" has the wrong unit"),
        ("[{effect='shank', statik='150 N'}]", "'statik' is not a quantity of Shank: did you mean 'static'"),
    ):
        refused(f'check tine.toml --set effects.own="{wrong}"', told)


def test_resistance_law(workshop, capsys):
    workshop("A resistance law")
    script, command = use("A resistance law", capsys)
    assert "a fit per width and depth: fitted from 1 to 3 m/s" in script
    assert "does not include soil that moves with the share" in script
    assert "law of resistance" in command or "share.height" in command
    table = "scene.medium={law='per_width', width='12 cm'}"
    own = po.read_problem("tine.toml", [table])
    # 250 kPa on 12 cm by 25 cm, and a twentieth of that per (m/s)^2.
    assert own.simulate().mean_draft == pytest.approx(250e3 * 0.12 * 0.25 * 1.2, rel=1e-9)
    refused("check tine.toml --set scene.medium='per_with'", "did you mean 'per_width'")


def test_measure(workshop, capsys):
    workshop("A measure")
    objective, *_ = use("A measure", capsys)[0].split()
    assert called("work_per_metre at_most") == "towing work per metre, at most"
    # At a steady speed the work per metre is the draft.
    own = po.read_problem("tine.toml").optimise()[0].objective
    assert float(objective) == pytest.approx(own, rel=1e-7)
    lines = Path("swept.csv").read_text(encoding="utf-8").splitlines()
    rows = [*csv.DictReader(line for line in lines if not line.startswith("#"))]
    assert len(rows) == 3
    for row in rows:
        found = {heading.partition(" ")[0]: value for heading, value in row.items()}
        assert float(found["work_per_metre"]) == pytest.approx(float(found["mean_draft"]), rel=1e-9)
    assert "towing work per metre" in printed("simulate", "tine.toml")
    told = po.Measurements("work_per_metre", [3e3, 4e3], {"scene.tow_speed": [1.0, 2.0]}, sigma=100.0)
    assert told.result == "work_per_metre"
    wrong = "check tine.toml --set 'require.work_per_meter.at_most=5 kN'"
    refused(wrong, "did you mean 'work_per_metre'")


def test_export_format(workshop, capsys):
    workshop("An export format")
    use("An export format", capsys)
    rows = csv.DictReader(Path("tine.csv").read_text(encoding="utf-8").splitlines())
    values = {row["name"]: float(row["value"]) for row in rows}
    assert values["share.height"] == 0.25
    assert values["mean_draft"] == pytest.approx(po.read_problem("tine.toml").simulate().mean_draft, rel=1e-6)
    refused("export tine.toml --to table --output a.txt", "end in .csv")
    refused("export tine.toml --to table --output a.csv --strut speed", "--strut cannot be used with --to table")


def test_integrator(workshop, capsys):
    workshop("An integrator")
    script, _ = use("An integrator", capsys)
    draft, error = map(float, script.splitlines()[0].split())
    assert 0.0 < error < 1e-6
    assert draft > 0.0
    assert "stiffness" in script
    refused("simulate tine.toml --set accuracy.method=three_eights", "did you mean 'three_eighths'")


@pytest.mark.slow
def test_integrator_takes_part_in_the_accuracy_study(workshop, capsys):
    workshop("An integrator")
    (said,) = use("An integrator", capsys, long=True)
    assert "three_eighths" in said
    assert "three_eighths" in json.dumps(json.loads(Path("accuracy.json").read_text(encoding="utf-8")))


def test_addition_that_cannot_be_imported_is_named(workshop, tmp_path):
    name = workshop("An integrator")
    (tmp_path / f"{name}.py").write_text("import no_such_module\n", encoding="utf-8")
    told = f"the addition '{name}' = {name} of mine cannot be imported (ModuleNotFoundError"
    refused("soils", told)
