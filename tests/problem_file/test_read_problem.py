"""Reading of problem files: quantities in SI, scenes, designs, and the shipped field problem."""

import math
import tomllib

import numpy as np
import pytest
from helpers.problem_files import COTTON, PROBLEMS, changed
from helpers.scripts import imported

import plough_opt as po
from plough_opt.motion.vocabulary import MEASURES
from plough_opt.problem_file import template

# --- a right problem file becomes: a scene, its variables, and the same results as Python by hand ---

DEG = math.pi / 180


def steel_mass(wedge_angle, chisel_angle, height):
    """Return the mass of a solid steel cone of equal height and surface, by the source's own form of (7)."""
    p = math.pi * math.cos(chisel_angle) ** 2 / (2 * math.tan(wedge_angle))
    return 7850 * math.pi / 3 * height**3 * math.tan(math.asin(math.sqrt(p**2 + 1) - p)) ** 2


def test_a_file_has_its_soil_variables_and_title():
    reference = po.read_problem(PROBLEMS / "reference.toml")
    assert reference.title == "R1: reference problem with three local optima"
    assert reference.notes == ()
    soil = reference.scene().soil
    assert "reference.toml" in soil.source
    properties = (soil.density, soil.density_ratio, soil.cohesion, soil.friction_angle, soil.tool_friction)
    assert properties == pytest.approx((1400.0, 0.8, 15e3, 30 * DEG, 0.5))
    found = {name: (v.lower, v.upper, v.guess, v.log, v.unit) for name, v in reference.variables.items()}
    assert found == {
        "share.wedge_angle": (*(pytest.approx(x * DEG) for x in (5, 60, 25)), False, "rad"),
        "share.height": (0.10, 0.50, 0.25, False, "m"),
        "scene.stiffness": (*(pytest.approx(x) for x in (5e3, 500e3, 50e3)), True, "N/m"),
    }


def test_a_file_simulates_as_the_same_scene_built_in_python():
    run = po.read_problem(PROBLEMS / "cotton_subsoiler.toml").simulate()
    share = po.Wedge(angle=po.deg(25), chisel_angle=po.deg(15), height=0.25)
    effects = po.Effects(strength_wave=po.StrengthWave(amplitude=0.3, wavelength=0.2), damping=400.0)
    mass = 20.0 + steel_mass(25 * DEG, 15 * DEG, 0.25)
    by_hand = po.simulate(po.Scene(po.named_soil("serozem"), share, 50e3, mass, 2.0, effects), duration=2.0)
    np.testing.assert_allclose(run.time, np.linspace(0.0, 2.0, 401), atol=1e-12)
    np.testing.assert_allclose(run.mount_force, by_hand.mount_force, rtol=1e-9)
    np.testing.assert_allclose(run.deflection, by_hand.deflection, rtol=1e-9)
    assert run.mean_draft == pytest.approx(by_hand.mean_draft, rel=1e-11)
    assert run.force_rms == pytest.approx(by_hand.force_rms, rel=1e-10)


def test_the_template_means_the_same_as_the_subsoiler():
    assert tomllib.loads(template()) == tomllib.loads(COTTON)


def test_what_the_template_comments_out_is_right_too(read):
    lines = [
        line.removeprefix("# ") if line.startswith("# [") or (line.startswith("# ") and " = " in line) else line
        for line in template().splitlines()
    ]
    # Quasi-static scenes know no start, damper, contact law or entry, neither do the print and other laws; an orbit has
    # no duration.
    left = ("motion", "damping", "orbit", "formulation", "medium")
    text = "\n".join(line for line in lines if not line.startswith(left))
    problem = read(text)
    scene = problem.shares["front"].scene()
    assert scene.soil.cohesion == pytest.approx(25e3)
    assert problem.shares["rear"].scene().soil.cohesion == pytest.approx(15e3)
    assert scene.soil.ambient_pressure == pytest.approx(5e3)
    assert (scene.effects.tow_ramp, scene.effects.rate_term) == (0.5, pytest.approx(0.01))
    assert problem.table.scene.outputs == 400


def test_a_named_soil_takes_overrides_and_says_so(read):
    name = 'name = "serozem"'
    soil = read(changed((name, f'{name}\ncohesion = "25 kPa"\ndensity_ratio = "75 %"'))).scene().soil
    serozem = po.named_soil("serozem")
    assert (soil.cohesion, soil.density_ratio) == (pytest.approx(25e3), pytest.approx(0.75))
    assert (soil.density, soil.friction_angle) == (serozem.density, serozem.friction_angle)
    assert soil.source.startswith(serozem.source)
    assert "changed in" in soil.source
    assert "cohesion, density_ratio" in soil.source


MINIMAL = """\
soil.name = "hardpan"
share = { wedge_angle = "30 deg", chisel_angle = "0 deg", height = "20 cm" }
scene = { tow_speed = "1 m/s", frame_mass = "10 kg", stiffness = "50 N/mm", duration = "1 s" }
"""


def test_what_a_file_leaves_out_has_its_default(read):
    problem = read(MINIMAL)
    assert problem.title == "untitled problem"
    assert problem.scene().effects == po.Effects()
    assert problem.accuracy == po.Accuracy()
    assert problem.table.scene.outputs == 400
    assert problem.scene().mass == pytest.approx(10 + steel_mass(30 * DEG, 0.0, 0.2), rel=1e-12)
    assert problem.variables == {}


def test_effects_accuracy_and_outputs_reach_the_simulation(read):
    effects = "inertial_drag=false, added_mass=false, ambient_pressure=false, start='rest', tow_ramp='0.5 s'"
    more = f"effects = {{ {effects}, rate_term='0.01 s^2/m^2' }}\naccuracy = {{ method='dop853', steps=800 }}\n"
    problem = read(MINIMAL.replace('duration = "1 s"', 'duration = "1 s", outputs = 8') + more)
    off = dict.fromkeys(("inertial_drag", "added_mass", "ambient_pressure"), False)
    assert problem.scene().effects == po.Effects(**off, start="rest", tow_ramp=0.5, rate_term=0.01)
    run = problem.simulate()
    assert (run.accuracy.method, run.accuracy.steps) == ("dop853", 800)
    np.testing.assert_allclose(run.time, np.linspace(0.0, 1.0, 9), atol=1e-15)


def test_a_guess_left_out_is_the_middle_of_its_bounds_geometric_on_a_log_scale(read):
    scene = read(changed((', guess = "25 deg"', ""), (', guess = "50 kN/m"', ""))).scene()
    assert scene.share.angle == pytest.approx(32.5 * DEG)
    assert scene.stiffness == pytest.approx(100e3)


@pytest.mark.parametrize(
    ("key", "fixed", "ends", "value"),
    [
        ("effects.strength_wave.amplitude", "amplitude = 0.3, ", ("0.1", "0.5"),
         lambda scene: scene.effects.strength_wave.amplitude / 0.3),
        ("scene.duration", 'duration = "2 s"\n', ("1 s", "3 s"), lambda _: 1.0),
    ],
)  # fmt: skip
def test_any_quantity_may_be_a_variable(read, key, fixed, ends, value):
    added = f"[variables]\n'{key}' = {{ lower = '{ends[0]}', upper = '{ends[1]}' }}"
    problem = read(changed(("[variables]", added), (fixed, "")))
    assert key in problem.variables
    assert value(problem.scene()) == pytest.approx(1.0, rel=1e-12)


def test_comments_blank_lines_windows_line_ends_and_a_byte_order_mark_mean_nothing(read, tmp_path):
    text = "# a comment\n\n" + COTTON.replace("\n", "  # said\n\n")
    path = tmp_path / "windows.toml"
    path.write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode())
    assert po.read_problem(str(path)).scene() == read(COTTON).scene()


def test_every_average_may_be_minimised_and_every_measure_required(read):
    measures = {name: one for name, one in MEASURES.items() if not one.random}
    averages = [name for name, one in measures.items() if not one.everywhere]
    minimise = "".join(f'minimise.{name}.per = "2 {measures[name].unit.symbol}"\n' for name in averages)
    require = "".join(f'require.{name}.at_most = "1e9 {one.unit.symbol}"\n' for name, one in measures.items())
    problem = read(minimise + require + COTTON.split("[minimise]")[0])
    assert problem.design()[1].time.numel() == 401
    assert (list(problem.table.minimise), list(problem.table.require)) == (averages, list(measures))


# --- problems/field.toml: from readings to the best share, beside what the readings were made of and closed forms ---


@pytest.mark.parametrize("search", ["near", pytest.param("auto", marks=pytest.mark.slow)])
def test_its_best_share_is_the_one_by_hand(search):
    """Three limits decide three variables: front, slope of the cone, deflection; the draft follows from the reading."""
    best, run = po.read_problem(PROBLEMS / "field.toml").optimise(search=search)
    scene = run.scene
    base = 0.13 * math.sqrt(1.0 - scene.soil.density_ratio)  # radius of the base whose front is 13 cm wide
    reading = po.read_penetrometer(PROBLEMS / "insertions.csv", (0.25, 0.45)).mean
    assert scene.cone.half_angle == pytest.approx(po.deg(15), rel=1e-8)
    assert scene.cone.height * math.tan(po.deg(15)) == pytest.approx(base, rel=1e-8)
    # At 15 degrees the share is a larger penetrometer; what inertia adds is 0.05 %.
    assert scene.reaction.static == pytest.approx(reading * math.pi * base**2, rel=1e-7)
    assert best.variables["scene.stiffness"] == pytest.approx(run.mean_draft / 0.03, rel=1e-6)
    assert best.objective == pytest.approx(run.mean_draft / 1e4 + scene.stationary_force_rms / 1e3, rel=1e-8)
    # Strength varies slowly beside a mount of 90 rad/s: a few per cent more than what a rigid one passes on.
    rigid = scene.reaction.static * math.sqrt(scene.effects.random_strength.variance)
    assert 1.0 < scene.stationary_force_rms / rigid < 1.1


def test_the_record_tells_what_it_was_made_of():
    found = po.strength_waves(po.read_strength_record(PROBLEMS / "transect.csv"), 0.2)
    largest = found.found[0]
    with imported("make_field_data") as made:
        # Beside random strength the noise at the rows' wave number is that of its spectrum: three half widths.
        assert largest.wave.wavelength == pytest.approx(made.ROWS, abs=3.0 * largest.wavelength)
        assert largest.wave.amplitude == pytest.approx(made.ROW_AMPLITUDE, abs=3.0 * largest.amplitude)
        # Of some sixty independent lengths the variance scatters by a fifth, its root by a tenth.
        put_in = math.hypot(made.RMS, made.ROW_AMPLITUDE / math.sqrt(2.0))
        assert math.sqrt(found.variance) == pytest.approx(put_in, rel=0.25)


SPEED = "variables.scene.tow_speed={lower='1 m/s', upper='3 m/s'}"
RELIANCE = {
    "level": "the level of the draft was not measured",
    "blunt": "of two shares with the same base the blunter",
    "speed": "the draft grows by some per cent over the usual speeds",
    "front": "loosened_radius is 2.2 times the base radius",
}


@pytest.mark.parametrize(
    ("changes", "relied_on"),
    [
        ([], ["level", "front"]),
        (["soil.cone_index=1 MPa"], ["front"]),
        (["soil.strength_factor=3"], ["front"]),
        (["soil.density_ratio=0.794"], ["level"]),
        (["require={half_angle={at_most='20 deg'}}"], ["level"]),
        (["require={half_angle={at_most='21 deg'}}"], ["level", "blunt"]),
        (["require={half_angle={at_most='21 deg'}}", "share.wedge_angle=30 deg"], ["level"]),
        ([SPEED], ["level", "speed", "front"]),
        ([SPEED, "effects.rate_term=0.02 s^2/m^2"], ["level", "front"]),
        (["scene.medium={law='mckyes_ali', depth='30 cm'}", "require={}"], []),
    ],
)  # fmt: skip
def test_a_design_is_told_what_it_relies_on(tmp_path, changes, relied_on):
    path = tmp_path / "cotton.toml"
    text = COTTON.replace('tow_speed = "7.2 km/h"', "") if "tow_speed" in str(changes) else COTTON
    path.write_text(text, encoding="utf-8")
    found = po.read_problem(path, changes).reliance
    assert len(found) == len(relied_on)
    for name, sentence in zip(relied_on, found, strict=True):
        assert sentence.startswith(RELIANCE[name])
