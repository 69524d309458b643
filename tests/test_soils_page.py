"""The numbers in docs/soils.md match the code."""

import re
import runpy
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

import plough_opt as po

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "docs" / "soils.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```(\w+)\n(.*?)```", TEXT, flags=re.DOTALL)


def test_the_table_of_cone_indices_matches_the_code():
    rows = re.findall(r"^\| ([a-z ]+) \| ([\d.]+) kPa \| ([\d.]+) kPa \|$", TEXT, flags=re.MULTILINE)
    assert tuple(name for name, *_ in rows) == po.soil_names()
    for name, *values in rows:
        soils = [replace(po.named_soil(name), ambient_pressure=pressure) for pressure in (101325.0, 5e3)]
        assert [*map(float, values)] == pytest.approx([po.cone_index(soil) / 1e3 for soil in soils], rel=4e-4)  # digits


def test_its_problem_file_tables_are_valid(tmp_path):
    tables, waves, random = (text for language, text in BLOCKS if language == "toml")
    soil, uncertain = tables.split("\n\n")
    file = (ROOT / "problems" / "cotton_subsoiler.toml").read_text(encoding="utf-8")
    start = file.index("[soil]")
    rest = file[file.index("\n[", start) :].replace("[effects]", waves, 1)
    left_out = ("deflection", "strength_wave = { amplitude = 0.3")
    lines = [line for line in rest.splitlines() if not line.startswith(left_out)]
    path = tmp_path / "share.toml"
    path.write_text(file[:start] + soil + "\n" + "\n".join(lines) + "\n" + uncertain, encoding="utf-8")
    shutil.copy(ROOT / "problems" / "insertions.csv", tmp_path)
    problem = po.read_problem(path)
    readings = po.read_penetrometer(ROOT / "problems" / "insertions.csv", (0.25, 0.45))
    assert po.cone_index(problem.scene().soil) == pytest.approx(readings.mean, rel=1e-12)
    assert [wave.wavelength for wave in problem.scene().effects.waves] == [0.73, 2.1]
    _, effects, minimise = re.split(r"\[\w+\]\n", random)
    given = effects.replace("# random", "random").splitlines()
    shutil.copy(ROOT / "problems" / "transect.csv", tmp_path)
    for line in given[:2]:
        text = file.replace('strength_wave = { amplitude = 0.3, wavelength = "0.2 m" }', line)
        path.write_text(text.replace("[minimise]\n", f"[minimise]\n{minimise}"), encoding="utf-8")
        assert po.read_problem(path).scene().stationary_force_rms > 0.0


def test_the_quoted_draft_and_band_match_the_command():
    own, low, high = map(float, re.findall(r"^([\d.]+) kN beside ([\d.]+) to ([\d.]+) kN", TEXT, flags=re.MULTILINE)[0])
    scene = po.read_problem(ROOT / "problems" / "field.toml").scene()
    found = po.crosscheck.compare(scene, depth=[0.45], texture="fine", speeds=[5 / 3.6])
    draft = next(row for row in found.others if row.model.startswith("ASABE"))
    shown = (found.own.drafts[0], *(draft.drafts[0] * (1.0 + sign * draft.band) for sign in (-1, 1)))
    assert (own, low, high) == pytest.approx([value / 1e3 for value in shown], abs=0.05)


def test_the_synthetic_readings_match_their_script():
    script = runpy.run_path(str(ROOT / "problems" / "make_field_data.py"))
    for name in ("insertions", "transect"):
        text = (ROOT / "problems" / f"{name}.csv").read_text(encoding="utf-8")
        assert text == script[name]()
        assert "synthetic" in text.splitlines()[0]
