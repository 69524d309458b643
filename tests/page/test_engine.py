"""The motion in JavaScript: equality with `po.simulate` in node and in Chromium; types and style of the scripts."""

import json
import shutil
import subprocess
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.problem_files import COTTON, SUBSOILER, changed
from helpers.scenes import Shank, Waves

import plough_opt as po
from plough_opt.app.page import asset
from plough_opt.app.page_model import AVERAGES, ROWS, design_model, page_model, switches
from plough_opt.core.errors import DomainError, PloughError
from plough_opt.motion.effects import OWN_EFFECTS
from plough_opt.motion.vocabulary import MEASURES

NODE = shutil.which("node")
needs_node = pytest.mark.skipif(NODE is None, reason="needs node: apt-get install nodejs")
SCENES = tomllib.loads(Path(__file__).with_name("scenes.toml").read_text(encoding="utf-8"))
DESIGNS = 17
WAVE = po.StrengthWave(0.3, "20 cm")
# A symbolic RMS is never 0, so that it has derivatives: by that a small one differs from a number's.
ROUNDING = 1e-9
CLIENT = Path(__file__).with_name("client.js").read_text(encoding="utf-8")


def read(scene, folder):
    """Return the problem of a scene; a periodic orbit has no duration."""
    file = folder / "cotton_subsoiler.toml"
    file.write_text(changed(('duration = "2 s"\n', "")) if "orbit" in scene else COTTON, encoding="utf-8")
    return po.read_problem(file, SCENES[scene])


def designs(model, scene):
    """Return seeded values of all inputs of a model: variables between their bounds, the others near the file's."""
    random = np.random.default_rng([33, list(SCENES).index(scene)])
    rows = []
    for _ in range(DESIGNS):
        row = []
        for one in model.data["inputs"]:
            low, high = (one["lower"], one["upper"]) if one["variable"] else (0.8 * one["value"], 1.2 * one["value"])
            logarithmic = one["log"] and one["variable"]
            row.append(
                float(np.exp(random.uniform(*np.log([low, high]))) if logarithmic else random.uniform(low, high))
            )
        rows.append(row)
    return rows


def script(model, rows, effects=None):
    """Return a script that computes designs, or a list of them for each key of switched effects."""
    given = f"const MODEL = {json.dumps(model.data)};\n{model.functions}\n{asset('engine.js')}\n{CLIENT}"
    each = f"(key) => {json.dumps(rows)}.map((x) => tried(x, engine(MODEL, FUNCTIONS, key)))"
    return f"{given}\nconst EACH = {each}, ALL = {'EACH()' if effects is None else f'{json.dumps(effects)}.map(EACH)'};"


def in_node(model, rows, folder, effects=None):
    """Return the results of designs as node computes them."""
    (folder / "engine.js").write_text(
        f"{script(model, rows, effects)}\nconsole.log(JSON.stringify(ALL));", encoding="utf-8"
    )
    done = subprocess.run([NODE, folder / "engine.js"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return json.loads(done.stdout)


def apart(found, run, measures):
    """Return the largest difference of results from those of a run, each relative to its own size."""
    sizes = {name: np.max(np.abs(getattr(run, name))) for name in ROWS}
    sizes["travel"] = max(sizes["travel"], sizes["deflection"])  # the travel of a share that sticks is rounding
    rows = [np.max(np.abs(found["rows"][name] - getattr(run, name))) / size for name, size in sizes.items() if size]
    means = [abs(found[name] - getattr(run, name)) / abs(getattr(run, name)) for name in AVERAGES if getattr(run, name)]
    others = [abs(found[name] - measure.of(run)) / abs(measure.of(run)) for name, measure in measures.items()
              if name in found and measure.of(run)]  # fmt: skip
    return max([*rows, *means, *others])


def simulated(problem, values):
    """Return the run of values, or the error that refuses them."""
    try:
        return problem.simulate(values)
    except PloughError as error:
        return error


def runs_of(problem, model, rows):
    """Return the runs of designs, or the errors that refuse them."""
    names = [one["name"] for one in model.data["inputs"]]
    return [simulated(problem, dict(zip(names, row, strict=True))) for row in rows]


def assert_equal(rows, runs, results):
    """Assert that results are those of `po.simulate`, and refusals those of Python in its own words."""
    measures, compared = MEASURES, 0
    for row, run, found in zip(rows, runs, results, strict=True):
        if isinstance(run, PloughError):
            assert isinstance(found, str), (run, row)
            assert not isinstance(run, DomainError) or found == str(run)
            continue
        assert not isinstance(found, str), (found, row)
        allowed = found["error_estimate"] + run.error_estimate + ROUNDING
        assert apart(found, run, measures) <= min(allowed, 1e-6), (found["error_estimate"], run.error_estimate, row)
        if "floquet" in found:
            assert run.settles.orbit is None or run.settles.orbit == (found["unsettled"] < 0.01)
            # slopes by differences are wrong by 1e-6, and a double multiplier by the root of that
            assert found["floquet"] == pytest.approx(np.max(np.abs(run.floquet)), abs=1e-3)
        compared += 1
    assert compared > DESIGNS // 2


# The other scenes run with the thorough tests; what most of them have alone, these have beside something else.
NOW = {"rate term and two waves", "a periodic orbit", "entry, stick and slip, ramp", "a speed over time"}


@needs_node
@pytest.mark.parametrize(
    "scene", [pytest.param(name, marks=[pytest.mark.thorough] * (name not in NOW)) for name in SCENES]
)
def test_results_in_node_and_chromium_are_those_of_simulate(scene, browser, tmp_path):
    problem = read(scene, tmp_path)
    model = page_model(problem)
    rows = designs(model, scene)
    runs = runs_of(problem, model, rows)
    assert_equal(rows, runs, in_node(model, rows, tmp_path))
    page = browser.new_page()
    assert_equal(rows, runs, page.evaluate(f"() => {{ {script(model, rows)}; return ALL; }}"))
    page.close()


@needs_node
def test_switched_effects_are_those_of_simulate_and_of_the_overrides_that_the_page_names(tmp_path):
    problem = po.read_problem(SUBSOILER, ["effects.start=rest", "effects.rate_term=0.02 s^2/m^2"])
    model, switched = page_model(problem), switches(problem)
    assert len(model.data["variants"]) == 32  # of 128 combinations, those of the fewest switches
    rows = [designs(model, "from rest")[0]]
    found = in_node(model, rows, tmp_path, effects=[*model.data["variants"]])
    values = dict(zip([one["name"] for one in model.data["inputs"]], rows[0], strict=True))
    for key, (result,) in zip(model.data["variants"], found, strict=True):
        which = [switched[int(k)] for k in key.split(",") if k]
        changes = {name: value for one in which for name, value in one.changes.items()}
        scene = problem.scene(values)
        scene = replace(scene, effects=replace(scene.effects, **changes))
        assert apart(result, problem.run_of(scene, values), {}) <= 1e-7, key
        settings = [f"{name}={json.dumps(value)}" for one in which for name, value in one.settings]
        own = po.read_problem(SUBSOILER, [*problem.overrides, *settings])
        kept = {name: value for name, value in values.items() if name not in dict(s for o in which for s in o.settings)}
        assert result["mean_draft"] == pytest.approx(own.simulate(kept).mean_draft, rel=1e-7), key


@needs_node
def test_own_resistances_are_written_from_their_graph(tmp_path, monkeypatch):
    monkeypatch.setitem(OWN_EFFECTS, "shank", Shank)
    monkeypatch.setitem(OWN_EFFECTS, "waves", Waves)
    own = "effects.own=[{effect='shank', static=150, viscous=80}, {effect='waves', sine=30, wavelength=0.7}]"
    problem = po.read_problem(SUBSOILER, [own])
    model = page_model(problem)
    rows = designs(model, "as in the file")
    assert_equal(rows, runs_of(problem, model, rows), in_node(model, rows, tmp_path))


def question():
    """Return a design of the user's own, and its objective and requirements as a function of numbers."""
    design = po.Design()
    h = design.variable("height", guess="25 cm", lower="10 cm", upper="40 cm")
    k = design.parameter("cohesion", "20 kPa")

    def results(height, cohesion):
        share = po.Wedge("30 deg", "15 deg", height)
        soil = replace(po.named_soil("serozem"), cohesion=cohesion)
        scene = po.Scene(soil, share, "80 kN/m", "30 kg", "2 m/s", po.Effects(strength_wave=WAVE, damping=400.0))
        run = po.simulate(scene, 0.5)
        return run.mean_draft / 1e3 + run.force_rms / 1e3, scene.loosened_radius, run.deflection

    objective, radius, deflection = results(h, k)
    design.minimise(objective)
    design.require("radius", radius, at_least="12 cm")
    design.require("deflection", deflection, at_most="7 cm")
    return design, results


@needs_node
def test_a_design_of_ones_own_is_that_of_simulate(tmp_path):
    design, results = question()
    model = design_model(design)
    model.data["error"] = 1e-9
    rows = [[0.12, 20e3], [0.25, 20e3], [0.31, 26e3], [0.39, 11e3]]
    for row, found in zip(rows, in_node(model, rows, tmp_path), strict=True):
        objective, radius, deflection = results(*row)
        assert found["objective"] == pytest.approx(objective, rel=1e-7)
        margins = [one["margin"] for one in found["requirements"]]
        assert margins == pytest.approx([radius - 0.12, 0.07 - np.max(deflection)], abs=1e-8)
    outside = in_node(model, [[0.5, 20e3]], tmp_path)
    assert outside == [
        "height = 0.5 m must be at most 0.4 m: the steps of this page resolve the motion between these bounds"
    ]


WRONG = {"share.height": -0.1, "soil.density_ratio": 1.0, "share.wedge_angle": 1.6, "scene.stiffness": 0.0,
         "effects.strength_wave.amplitude": 1.5, "scene.tow_speed": 1e50}  # fmt: skip


@needs_node
def test_values_outside_the_domain_are_refused_in_the_command_lines_words(tmp_path):
    problem = po.read_problem(SUBSOILER)
    model = page_model(problem)
    names = [one["name"] for one in model.data["inputs"]]
    good = {one["name"]: one["value"] for one in model.data["inputs"]}
    rows = [[(good | {name: value})[key] for key in names] for name, value in WRONG.items()]
    for (name, value), found in zip(WRONG.items(), in_node(model, rows, tmp_path), strict=True):
        with pytest.raises(DomainError) as refused:
            problem.simulate({name: value})
        # The command line also asks for a likely slip of the unit.
        assert found
        assert str(refused.value).startswith(found)


# --- the page's scripts by TypeScript's checker and ESLint, where npm is ---

TOOLS = ("typescript@5.9", "eslint@9", "@eslint/js@9")
# The scripts of the page share one scope, and those of its workers another.
SCOPES = {
    "page": (("charts.js", "motion.js", "explore.js"), "declare const uPlot: any;"),
    "workers": (("engine.js", "worker.js"), "declare const MODEL: any, FUNCTIONS: any;"),
}
CHECKED = ("--allowJs", "--checkJs", "--noEmit", "--target", "es2022", "--lib", "es2023,dom,dom.iterable")
# TypeScript finds names without a definition, also those defined in another file of the same scope.
RULES = Path(__file__).with_name("eslint.config.mjs").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def tools(tmp_path_factory):
    """Return a folder with the tools and the scripts."""
    npm, folder = shutil.which("npm"), tmp_path_factory.mktemp("scripts")
    if npm is None:
        pytest.skip("needs npm: apt-get install npm")
    install = [npm, "install", "--prefer-offline", "--no-audit", "--no-fund", "--silent", "--prefix", folder, *TOOLS]
    done = subprocess.run(install, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"npm cannot install the tools: {done.stderr.strip()[-200:]}")
    for scripts, declared in SCOPES.values():
        for name in scripts:
            (folder / name).write_text(asset(name), encoding="utf-8")
        (folder / f"{scripts[0]}.d.ts").write_text(declared, encoding="utf-8")
    (folder / "eslint.config.mjs").write_text(RULES, encoding="utf-8")
    return folder


@pytest.mark.thorough
def test_types_agree_and_no_rule_is_broken(tools):
    lines = [["tsc", *CHECKED, f"{scripts[0]}.d.ts", *scripts] for scripts, _ in SCOPES.values()]
    for tool, *arguments in [*lines, ["eslint", *(name for scripts, _ in SCOPES.values() for name in scripts)]]:
        line = [tools / "node_modules" / ".bin" / tool, *arguments]
        assert subprocess.run(line, cwd=tools, capture_output=True, text=True, check=False).stdout == ""
