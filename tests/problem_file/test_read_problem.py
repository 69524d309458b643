"""What problem files become: scenes, designs, and designs from catalogues."""

import itertools
import math
import tomllib

import jsonschema
import numpy as np
import pytest
from helpers.problem_files import COTTON, PROBLEMS, STATIC, changed, refused_files

import plough_opt as po
from plough_opt.motion.vocabulary import MEASURES
from plough_opt.problem_file import template
from plough_opt.problem_file.schema import file_schema
from plough_opt.problem_file.sweep import plan_of

# --- a right problem file becomes: a scene, its variables, and the same results as Python by hand ---

DEG = math.pi / 180


def steel_mass(wedge_angle, chisel_angle, height):
    """Return the mass of a solid steel cone of equal height and surface, by the source's own form of (7)."""
    p = math.pi * math.cos(chisel_angle) ** 2 / (2 * math.tan(wedge_angle))
    return 7850 * math.pi / 3 * height**3 * math.tan(math.asin(math.sqrt(p**2 + 1) - p)) ** 2


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
    problem = read("\n".join(line for line in lines if not line.startswith(left)))
    scene = problem.scene()
    assert scene.soil.cohesion == pytest.approx(25e3)
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


COURSE = '{ time = ["0 s", "500 ms", "2 s"], speed = ["3.6 km/h", "2.5 m/s", "2 m/s"] }'


def test_a_tow_speed_over_time_is_that_of_simulate(read):
    text = changed(('"7.2 km/h"', COURSE))
    problem, constant = read(text), read(COTTON)
    run = po.simulate(constant.scene(), 2.0, tow_speed=([0.0, 0.5, 2.0], [1.0, 2.5, 2.0]))
    assert problem.simulate().mean_draft == run.mean_draft
    # A change of the speed scales the course, whose largest speed it is.
    scaled = po.simulate(constant.scene(), 2.0, tow_speed=([0.0, 0.5, 2.0], [2.0, 5.0, 4.0]))
    assert problem.simulate({"scene.tow_speed": 5.0}).tow_power == scaled.tow_power
    assert read(text, "scene.tow_speed=7.2 km/h").simulate().mean_draft == constant.simulate().mean_draft
    best, found = read(text, "share.wedge_angle=35 deg", "share.height=0.3 m").optimise(parameters=True, search="near")
    assert found.scene.effects.tow_profile == problem.course
    assert "scene.duration" not in [one.name for one in best.every_sensitivity()]
    questions = [
        plan_of(one, {"soil.cohesion": [1e4, 2e4]}).question for one in (problem, read(text, "scene.tow_speed=9 km/h"))
    ]
    assert questions[0] != questions[1]  # of the same largest speed
    jsonschema.validate(tomllib.loads(text), file_schema())


@pytest.mark.parametrize(("course", "words"), refused_files()["courses"])
def test_a_wrong_course_of_the_tow_speed_is_refused_with_its_line(blames, course, words):
    blames(changed(('"7.2 km/h"', course)), "tow_speed", "scene.tow_speed", words)


def test_an_orbit_of_a_file_is_that_of_the_effects(read):
    problem = read(changed(('duration = "2 s"\n', ""), ("[effects]\n", '[effects]\norbit = "periodic"\n')))
    run = problem.simulate()
    assert run.duration == pytest.approx(0.2 / 2.0, rel=1e-15)
    assert np.array_equal(run.mount_force, po.simulate(problem.scene()).mount_force)


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


SPEED = "variables.scene.tow_speed={lower='1 m/s', upper='3 m/s'}"
VARYING = "uncertain.soil.ambient_pressure={distribution='uniform', lower='50 kPa', upper='90 kPa'}"
RELIANCE = {
    "level": "the level of the draft was not measured",
    "blunt": "of two shares with the same base the blunter",
    "soft": "a mount softer than its resonance",
    "speed": "the draft grows by some per cent over the usual speeds",
    "pressure": "with one density ratio the draft grows in proportion to the ambient pressure",
    "front": "loosened_radius is 2.2 times the base radius",
}


RELIED_ON = [
    ([], ["level", "soft", "front"]),
    (["soil.cone_index=1 MPa"], ["soft", "front"]),
    (["soil.density_ratio=0.794"], ["level", "soft"]),
    (["require={half_angle={at_most='21 deg'}}"], ["level", "blunt", "soft"]),
    ([SPEED], ["level", "soft", "speed", "front"]),
    (["require={half_angle={at_most='20 deg'}}", VARYING], ["level", "soft", "pressure"]),
    (["scene.medium={law='mckyes_ali', depth='30 cm'}", "require={}"], []),
]


@pytest.mark.parametrize(("changes", "relied_on"), RELIED_ON)
def test_a_design_is_told_what_it_relies_on(tmp_path, changes, relied_on):
    path = tmp_path / "cotton.toml"
    text = COTTON.replace('tow_speed = "7.2 km/h"', "") if "tow_speed" in str(changes) else COTTON
    path.write_text(text, encoding="utf-8")
    found = po.read_problem(path, changes).reliance
    assert len(found) == len(relied_on)
    for name, sentence in zip(relied_on, found, strict=True):
        assert sentence.startswith(RELIANCE[name])


# --- catalogues and steps in a problem file: the best design in their values, and what it costs ---

HEIGHT = '"share.height" = { lower = "0.1 m", upper = "0.5 m", guess = "0.25 m" }'
ANGLE = '"share.wedge_angle" = { lower = "20 deg", upper = "40 deg" }'


def offering(height="", angle=None):
    """Return the static problem with more keys of its height and, if given, with the wedge angle as a variable."""
    lines = [HEIGHT.replace(" }", f"{height} }}")]
    fixed = [] if angle is None else [('wedge_angle = "35 deg"\n', "")]
    lines += [] if angle is None else [ANGLE.replace(" }", f"{angle} }}")]
    return changed((HEIGHT, "\n".join(lines)), *fixed, text=STATIC)


@pytest.fixture
def cheapest(read):
    """Return the least objective of designs that meet the requirement, each simulated by itself."""

    def least(text, angles, heights):
        found = {}
        for angle, height in itertools.product(angles, heights):
            run = read(text, f"share.wedge_angle={angle} deg", f"share.height={height} m").simulate()
            if run.scene.loosened_radius >= 0.12:
                found[angle, height] = run.mean_draft / 1e3
        return min(found.items(), key=lambda one: one[1])

    return least


def test_steps_and_catalogues_go_together(read, cheapest, tmp_path):
    text = offering(', step = "2 cm"', ', catalogue = ["24 deg", "30 deg", "36 deg", "70 deg"]')
    assert [note for note in read(text).cautions if "20 deg to 40 deg, leave out of its catalogue 70 deg" in note]
    best, _ = read(text).optimise()
    (angle, height), objective = cheapest(text, [24.0, 30.0, 36.0], [0.02 * k for k in range(5, 26)])
    assert best.bought.variables == pytest.approx({"share.height": height, "share.wedge_angle": po.deg(angle)})
    assert best.bought.objective == pytest.approx(objective, rel=1e-6)
    assert best.bought.objective > best.objective
    assert best.variables["share.height"] != height
    assert read(STATIC).optimise()[0].bought is None
    assert "catalogue" in str(best)
    assert f"{best.bought.cost_percent:+.2g} %" in str(best)
    again = po.load(best.save(tmp_path / "best.json"))
    assert str(again) == str(best)
    assert again.bought.variables == best.bought.variables


@pytest.mark.parametrize(("more", "pieces"), [(more, pieces) for more, *pieces in refused_files()["catalogues"]])
def test_a_wrong_catalogue_is_refused_with_its_line(blames, more, pieces):
    blames(offering(more), "share.height", *pieces)


def test_a_catalogue_is_for_one_soil(refusal):
    text = offering(', step = "1 cm"') + '\n[uncertain]\n"soil.cohesion" = { distribution = "normal", std = "2 kPa" }\n'
    assert "one soil" in refusal(text)


def test_editors_complete_catalogues():
    assert {"catalogue", "step"} <= {*file_schema()["$defs"]["VariableTable"]["properties"]}
