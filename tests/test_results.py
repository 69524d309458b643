"""Saved results: complete, strict JSON that reads back equal, and refusal of what is no result."""

import dataclasses
import json
import math
import platform
from importlib.metadata import version

import numpy as np
import pytest

import plough_opt as po


@pytest.fixture(scope="module")
def scene():
    share = po.Wedge(angle=po.deg(25), chisel_angle=po.deg(15), height=0.25)
    effects = po.Effects(strength_wave=po.StrengthWave(amplitude=0.3, wavelength=0.2), damping=400.0)
    return po.Scene(po.named_soil("serozem"), share, stiffness=5e4, mass=23.0, tow_speed=2.0, effects=effects)


@pytest.fixture(scope="module")
def run(scene):
    return po.simulate(scene, duration=0.5, outputs=20)


@pytest.fixture(scope="module")
def optimum(scene):
    """Return an optimum, and its run, of a quasi-static question with a known answer."""
    design = po.Design()
    height = design.variable("height", guess=0.25, lower=0.1, upper=0.5, unit="m")
    cone = po.Cone(half_angle=po.deg(10), height=height)
    found = po.simulate(
        po.Scene(scene.soil, cone, stiffness=5e4, mass=20.0, tow_speed=2.0, effects=po.Effects(motion=False)), 1.0
    )
    design.minimise(found.mean_draft / 1e3)
    design.require("loosened radius", po.loosened_radius(cone, scene.soil), at_least=0.12, unit="m")
    best = design.solve()
    return best, best(found)


@pytest.fixture(scope="module")
def saved_run(run):
    return run


@pytest.fixture(scope="module")
def saved_optimum(optimum):
    best, run = optimum
    return dataclasses.replace(best, run=run)


@pytest.fixture
def written(tmp_path):
    """Write a text as result.json and return its path."""

    def write(text):
        path = tmp_path / "result.json"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def strict(text):
    """Parse JSON that holds no NaN and no infinity."""

    def refuse(constant):
        raise AssertionError(f"{constant} is not JSON")

    return json.loads(text, parse_constant=refuse)


def numbers(value):
    """Return all numbers in parsed JSON."""
    if isinstance(value, dict):
        return [x for item in value.values() for x in numbers(item)]
    if isinstance(value, list):
        return [x for item in value for x in numbers(item)]
    return [value] if isinstance(value, int | float) else []


def test_a_run_reads_back_equal(saved_run, written):
    again = po.load(written(saved_run.to_json()))
    assert again.scene == saved_run.scene
    assert again.to_json() == saved_run.to_json()


def test_an_optimum_reads_back_equal(saved_optimum, written):
    again = po.load(written(saved_optimum.to_json()))
    assert (again.variables, again.limits, again.local_optima) == (
        saved_optimum.variables, saved_optimum.limits, saved_optimum.local_optima,
    )  # fmt: skip
    assert again.to_json() == saved_optimum.to_json()


def test_the_path_may_be_text(saved_run, written):
    assert po.load(str(written(saved_run.to_json()))).to_json() == saved_run.to_json()


@pytest.mark.parametrize("title", ["Плуг β = 15°", 'with "quotes" \\ and\nlines', "", "[bold]"])
def test_any_title_reads_back_equal(run, written, title):
    named = dataclasses.replace(run, origin=dataclasses.replace(run.origin, title=title))
    assert po.load(written(named.to_json())).origin.title == title


@pytest.mark.parametrize("kind", ["run", "optimum"])
def test_a_result_says_what_made_it(kind, request):
    saved = strict(request.getfixturevalue(f"saved_{kind}").to_json())
    assert (saved["schema"], saved["kind"]) == (2, kind)
    versions = saved["versions"]
    for package in ("plough_opt", "casadi", "numpy"):
        assert versions[package] == version(package)
    assert versions["python"] == platform.python_version()


@pytest.mark.parametrize("kind", ["run", "optimum"])
def test_every_number_of_a_result_is_finite(kind, request):
    found = numbers(strict(request.getfixturevalue(f"saved_{kind}").to_json()))
    assert len(found) > 100
    assert all(math.isfinite(x) for x in found)


def test_a_saved_run_holds_the_numbers_of_the_run(run, saved_run):
    saved = strict(saved_run.to_json())
    for name in ("time", "travel", "speed", "deflection", "mount_force", "soil_resistance"):
        np.testing.assert_array_equal(saved[name], getattr(run, name))
    for name in ("mean_draft", "force_rms", "mean_deflection", "displacement_rms", "tow_power"):
        assert saved["averages"][name] == getattr(run, name)
    assert saved["peak_force"] == np.max(run.mount_force)
    assert saved["peak_deflection"] == np.max(run.deflection)
    assert saved["specific_draft"] == run.specific_draft
    assert saved["accuracy"]["method"] == run.accuracy.method
    assert (saved["error_estimate"], saved["seconds"]) == (run.error_estimate, run.seconds)
    assert saved["warnings"] == list(run.warnings)


def test_a_saved_optimum_holds_the_design_its_limits_and_its_run(optimum, saved_optimum):
    best, run = optimum
    saved = strict(saved_optimum.to_json())
    assert saved["status"] == "solved"
    assert saved["best"]["variables"] == best.variables
    assert saved["best"]["objective"] == pytest.approx(run.mean_draft / 1e3, rel=1e-9)
    limits = {limit["name"]: limit for limit in saved["best"]["limits"]}
    assert set(limits) == {"loosened radius", "height"}
    assert limits["loosened radius"]["value"] == pytest.approx(0.12, rel=1e-7)
    assert limits["loosened radius"]["active"] is True
    assert saved["local_optima"][0] == saved["best"]
    assert saved["run"]["averages"]["mean_draft"] == run.mean_draft


def test_a_loaded_optimum_answers_as_the_solved_one_does(optimum, saved_optimum, written):
    best, _ = optimum
    loaded = po.load(written(saved_optimum.to_json()))
    assert loaded.margins == best.margins
    assert loaded.active == best.active


def test_soil_without_any_strength_gives_a_result_without_gaps(written):
    soil = po.Soil(1350.0, 0.8, 0.0, po.deg(28), 0.5, ambient_pressure=0.0)
    scene = po.Scene(soil, po.Cone(po.deg(10), 0.25), stiffness=5e4, mass=20.0, tow_speed=0.0)
    run = po.simulate(scene, 0.5, outputs=4)
    assert run.averages.mean_draft == pytest.approx(0.0, abs=1e-9)
    assert po.load(written(run.to_json())).to_json() == run.to_json()


def test_a_stand_in_for_no_orbit_reads_back_with_its_infinite_error(written):
    wave = po.StrengthWave(amplitude=1.0, wavelength=0.02)
    effects = po.Effects(strength_wave=wave, orbit="linearised")
    run = po.simulate(po.Scene(po.named_soil("serozem"), po.Cone(po.deg(12), 0.25), 2e3, 25.0, 0.3, effects), outputs=4)
    assert run.error_estimate == math.inf
    text = run.to_json()
    assert strict(text)["error_estimate"] == "Infinity"
    assert po.load(written(text)).error_estimate == math.inf


class TestLoadRefuses:
    """What is no result of this version is refused with a sentence that names the file."""

    def refusal(self, path):
        with pytest.raises(po.InputError) as caught:
            po.load(path)
        message = str(caught.value)
        assert str(path) in message
        assert "\n" not in message
        return message

    @pytest.mark.parametrize(
        "text",
        [
            "",
            "{}",
            "[]",
            "3",
            "null",
            '"run"',
            '{"kind": "run"}',
            '{"kind": "run", "schema": 2}',
            'title = "a problem"',
        ],
    )
    def test_a_wrong_file(self, written, text):
        assert "is not a result of this version (schema 2)" in self.refusal(written(text))

    @pytest.mark.parametrize("kind", ["run", "optimum"])
    @pytest.mark.parametrize("part", [0.1, 0.5, 0.999])
    def test_truncated_json(self, written, request, kind, part):
        text = request.getfixturevalue(f"saved_{kind}").to_json()
        assert "Invalid JSON" in self.refusal(written(text[: int(part * len(text))]))

    @pytest.mark.parametrize("schema", [0, 1, True, "2", None, 2.5])
    def test_another_schema_number(self, saved_run, written, schema):
        changed = json.dumps(json.loads(saved_run.to_json()) | {"schema": schema})
        message = self.refusal(written(changed))
        assert "schema 2" in message
        assert "schema" in message.split("(schema 2)")[1]

    def test_no_schema_number(self, saved_run, written):
        found = json.loads(saved_run.to_json())
        del found["schema"]
        assert "schema" in self.refusal(written(json.dumps(found))).split("(schema 2)")[1]

    def test_another_kind(self, saved_run, written):
        changed = json.dumps(json.loads(saved_run.to_json()) | {"kind": "sweep"})
        assert "'sweep'" in self.refusal(written(changed))

    @pytest.mark.parametrize("key", ["title", "versions", "averages", "time"])
    def test_a_missing_key_is_named(self, saved_run, written, key):
        found = json.loads(saved_run.to_json())
        del found[key]
        assert key in self.refusal(written(json.dumps(found)))

    def test_a_missing_file(self, tmp_path):
        assert "cannot be read" in self.refusal(tmp_path / "nothing.json")

    def test_a_folder(self, tmp_path):
        assert "cannot be read" in self.refusal(tmp_path)

    def test_a_file_that_is_no_text(self, tmp_path):
        path = tmp_path / "plot.png"
        path.write_bytes(b"\x89PNG\r\n\x1a\n")
        assert "cannot be read" in self.refusal(path)
