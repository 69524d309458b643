"""The motion in JavaScript: equality with `po.simulate` at seeded designs, in node and in Chromium."""

import json
import shutil
import subprocess

import numpy as np
import pytest
from helpers.problem_files import COTTON, SUBSOILER, changed

import plough_opt as po
from plough_opt.app.page import asset
from plough_opt.app.page_model import AVERAGES, ROWS, page_model
from plough_opt.core.errors import DomainError, InputError, PloughError
from plough_opt.problem_file.measures import measures_of

NODE = shutil.which("node")
needs_node = pytest.mark.skipif(NODE is None, reason="needs node: apt-get install nodejs")
WAVES = 'strength_wave={amplitude=0.3,wavelength="0.2 m"}'
COMPACTION = 'soil.compaction={pressure=["25 kPa","50 kPa","100 kPa"],volume_lost=[0.010,0.021,0.039]}'
# Scene -> changes of the file.
SCENES = {
    "as in the file": [],
    "undamped": [f"effects={{{WAVES}}}"],
    "from rest": ["effects.start=rest"],
    "towed": ["effects.start=towed"],
    "ramp": ["effects.start=rest", "effects.tow_ramp=0.137 s"],
    "ramp from equilibrium": ["effects.tow_ramp=0.4 s"],
    "smooth contact": ["effects.contact=smooth", "effects.contact_width=0.4 m/s", "scene.duration=0.5 s"],
    "rate term and two waves": [
        'effects.strength_wave_2={amplitude=0.1,wavelength="0.5 m",phase="20 deg"}', "effects.rate_term=0.02 s^2/m^2"
    ],
    "no drag, no added mass": ["effects.inertial_drag=false", "effects.added_mass=false"],
    "quasi-static ramp": [f'effects={{motion=false,tow_ramp="0.3 s",{WAVES}}}'],
    "another law": ["scene.medium=mckyes_ali", "share.chisel_angle=35 deg", "require={}"],
    "a result of the file": [
        'measures.fuel={value="tow_power / (2 * loosened_radius)",unit="W/m"}', "scene.outputs=150",
        "effects.ambient_pressure=false",
    ],
    "whole waves": ["scene.average=whole waves", "scene.duration=1.03 s"],
    "whole waves of two, quasi-static": [
        'effects={motion=false,tow_ramp="0.1 s",strength_wave={amplitude=0.3,wavelength="0.2 m"},'
        'strength_wave_2={amplitude=0.1,wavelength="0.5 m"}}', "scene.average=whole waves", "scene.duration=1.03 s",
    ],
    "a compression test": ["soil.ambient_pressure=60 kPa", COMPACTION],
}  # fmt: skip
DESIGNS = 17
# A symbolic RMS is never 0, so that it has derivatives: by that a small one differs from a number's.
ROUNDING = 1e-9
CLIENT = """
const { inputs } = MODEL, own = engine(MODEL, FUNCTIONS);
const tried = (x) => {
  try {
    const found = own.evaluate(x);
    for (const key in found.rows) found.rows[key] = [...found.rows[key]];
    return found;
  } catch (error) { return error.message; }
};
"""


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


def script(model, rows):
    """Return a script that prints the results of designs as JSON."""
    given = f"const MODEL = {json.dumps(model.data)};\n{model.functions}\n{asset('engine.js')}\n{CLIENT}"
    return f"{given}\nconst ALL = {json.dumps(rows)}.map(tried);"


def in_node(model, rows, folder):
    """Return the results of designs as node computes them."""
    (folder / "engine.js").write_text(f"{script(model, rows)}\nconsole.log(JSON.stringify(ALL));", encoding="utf-8")
    done = subprocess.run([NODE, folder / "engine.js"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return json.loads(done.stdout)


def apart(found, run, measures):
    """Return the largest difference of results from those of a run, each relative to its own size."""
    rows = [np.max(np.abs(found["rows"][name] - getattr(run, name))) / np.max(np.abs(getattr(run, name)))
            for name in ROWS if np.any(getattr(run, name))]  # fmt: skip
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


def assert_equal(problem, model, rows, results):
    """Assert that results are those of `po.simulate`, and refusals those of Python in its own words."""
    names, measures = [one["name"] for one in model.data["inputs"]], measures_of(problem.table)
    compared = 0
    for row, found in zip(rows, results, strict=True):
        run = simulated(problem, dict(zip(names, row, strict=True)))
        if isinstance(run, PloughError):
            assert isinstance(found, str), (run, row)
            assert not isinstance(run, DomainError) or found == str(run)
            continue
        assert not isinstance(found, str), (found, row)
        allowed = found["error_estimate"] + run.error_estimate + ROUNDING
        assert apart(found, run, measures) <= min(allowed, 1e-6), (found["error_estimate"], run.error_estimate, row)
        compared += 1
    assert compared > DESIGNS // 2


@needs_node
@pytest.mark.parametrize("scene", SCENES)
def test_results_are_those_of_simulate(scene, tmp_path):
    problem = po.read_problem(SUBSOILER, SCENES[scene])
    model = page_model(problem)
    rows = designs(model, scene)
    assert_equal(problem, model, rows, in_node(model, rows, tmp_path))


@needs_node
def test_a_rough_run_for_the_landscape_is_near(tmp_path):
    """Averages are those of the accurate run to five digits; a peak may lie between two outputs."""
    model = page_model(po.read_problem(SUBSOILER))
    rows = designs(model, "as in the file")
    pairs = f"{script(model, rows)}\nconst both = (x) => [own.evaluate(x), own.evaluate(x, {{ sketch: true }})];"
    (tmp_path / "rough.js").write_text(
        f"{pairs}\nconsole.log(JSON.stringify({json.dumps(rows)}.map(both)));", encoding="utf-8"
    )
    done = subprocess.run([NODE, tmp_path / "rough.js"], capture_output=True, text=True, check=True)
    for accurate, rough in json.loads(done.stdout):
        size = abs(accurate["mean_draft"])
        assert [rough[name] for name in ("mean_draft", "force_rms")] == pytest.approx(
            [accurate[name] for name in ("mean_draft", "force_rms")], abs=1e-5 * size
        )
        assert rough["error_estimate"] is None
        swing = accurate["peak_deflection"] - accurate["mean_deflection"]
        assert abs(rough["peak_deflection"] - accurate["peak_deflection"]) < 0.1 * swing


def test_chromium_computes_the_same(browser):
    problem = po.read_problem(SUBSOILER)
    model = page_model(problem)
    rows = designs(model, "as in the file")
    page = browser.new_page()
    assert_equal(problem, model, rows, page.evaluate(f"() => {{ {script(model, rows)}; return ALL; }}"))
    page.close()


REFUSED = {
    "periodic orbits": ["effects.orbit=linearised"],
    "stick and slip": ["effects.contact=stick_slip"],
    "the entry of a share": ["effects.start=rest", "effects.entry=true"],
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_the_page_cannot_compute_is_refused_by_name(what, tmp_path):
    file = tmp_path / "file.toml"
    file.write_text(changed(('duration = "2 s"\n', "")) if "orbit" in what else COTTON, encoding="utf-8")
    problem = po.read_problem(file, REFUSED[what])
    with pytest.raises(InputError, match=what):
        page_model(problem)


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


@needs_node
def test_the_density_ratio_follows_the_compression_test_in_its_range(tmp_path):
    problem = po.read_problem(SUBSOILER, SCENES["a compression test"])
    model = page_model(problem)
    names = [one["name"] for one in model.data["inputs"]]
    assert "soil.density_ratio" not in names
    at = names.index("soil.ambient_pressure")
    one = model.data["inputs"][at]
    assert (one["lower"], one["upper"]) == (pytest.approx(30e3), pytest.approx(100e3))
    good = [one["value"] for one in model.data["inputs"]]
    rows = [[*good[:at], pressure, *good[at + 1 :]] for pressure in (90e3, 24e3, 101e3)]
    inside, *outside = in_node(model, rows, tmp_path)
    run = problem.simulate({"soil.ambient_pressure": 90e3})
    assert inside["mean_draft"] == pytest.approx(run.mean_draft, rel=1e-8)
    assert outside == [f"ambient pressure = {value} Pa must be {rule} Pa: the compression test goes no further"
                       for value, rule in ((24000, "at least 25000"), (101000, "at most 100000"))]  # fmt: skip
