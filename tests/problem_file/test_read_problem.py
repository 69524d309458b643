"""What problem files become: scenes, designs, measures of their own, and several shares on one frame."""

import dataclasses
import itertools
import json
import math
import re
import tomllib

import jsonschema
import numpy as np
import pytest
from helpers.commands import call, cells, printed
from helpers.problem_files import COTTON, PROBLEMS, STATIC, changed, refused_files

import plough_opt as po
from plough_opt.motion.vocabulary import MEASURES
from plough_opt.problem_file import template
from plough_opt.problem_file.schema import file_schema, measures_of
from plough_opt.problem_file.sweep import ProblemSweep

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
        ProblemSweep.of(one, {"soil.cohesion": [1e4, 2e4]}).question
        for one in (problem, read(text, "scene.tow_speed=9 km/h"))
    ]
    assert questions[0] != questions[1]  # of the same largest speed
    jsonschema.validate(tomllib.loads(text), file_schema())


@pytest.mark.parametrize(("course", "words"), refused_files()["courses"])
def test_a_wrong_course_of_the_tow_speed_is_refused_with_its_line(blames, course, words):
    blames(changed(('"7.2 km/h"', course)), "tow_speed", "scene.tow_speed", words)


VARIED = [
    ("effects.strength_wave.amplitude", "amplitude = 0.3, ", ("0.1", "0.5"),
     lambda scene: scene.effects.strength_wave.amplitude / 0.3),
    ("scene.duration", 'duration = "2 s"\n', ("1 s", "3 s"), lambda _: 1.0),
]  # fmt: skip


@pytest.mark.parametrize(("key", "fixed", "ends", "value"), VARIED)
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
    (["soil.strength_factor=3"], ["soft", "front"]),
    (["soil.density_ratio=0.794"], ["level", "soft"]),
    (["scene.stiffness=50 kN/m"], ["level", "front"]),
    (["require={half_angle={at_most='20 deg'}}"], ["level", "soft"]),
    (["require={half_angle={at_most='21 deg'}}"], ["level", "blunt", "soft"]),
    (["require={half_angle={at_most='21 deg'}}", "share.wedge_angle=30 deg"], ["level", "soft"]),
    ([SPEED], ["level", "soft", "speed", "front"]),
    (["require={half_angle={at_most='20 deg'}}", VARYING], ["level", "soft", "pressure"]),
    ([SPEED, "effects.rate_term=0.02 s^2/m^2"], ["level", "soft", "front"]),
    (["scene.medium={law='mckyes_ali', depth='30 cm'}", "require={}"], []),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "relied_on"), RELIED_ON)
def test_a_design_is_told_what_it_relies_on(tmp_path, changes, relied_on):
    path = tmp_path / "cotton.toml"
    text = COTTON.replace('tow_speed = "7.2 km/h"', "") if "tow_speed" in str(changes) else COTTON
    path.write_text(text, encoding="utf-8")
    found = po.read_problem(path, changes).reliance
    assert len(found) == len(relied_on)
    for name, sentence in zip(relied_on, found, strict=True):
        assert sentence.startswith(RELIANCE[name])


# --- the [measures] table: results of a file's own, against the same arithmetic by hand ---

RIGHT = {
    "power_per_width": ("tow_power / (2 * loosened_radius)", "kW/m"),
    "slender": ("share.height * sqrt(loosened_radius**-2)", ""),
    "uneven": ("force_rms / mean_draft + exp(-force_rms / mean_draft)", ""),
    "draft_per_depth": ("maximum(mean_draft, 2 * force_rms) / share.height", "N/cm"),
    "excess": ("mean_draft / (mean_draft - force_rms)", ""),
    "spare": ("0.2e0 * mean_draft - -1 * force_rms**1", "kN"),
    "pushed": ("maximum(0, 0 + mean_draft - 0.0)", "kN"),
}


def written(measures, text=COTTON):
    """Return a problem file with a table of own results."""
    rows = [f'{name} = {{ value = "{value}", unit = "{unit}" }}' for name, (value, unit) in measures.items()]
    return "\n".join([text, "[measures]", *rows, ""])


def by_hand(run):
    """Return the values of `RIGHT` in their units, by Python's own arithmetic."""
    radius, height = run.scene.loosened_radius, run.scene.share.height
    uneven = run.force_rms / run.mean_draft
    return {
        "power_per_width": run.tow_power / (2.0 * radius) / 1e3,
        "slender": height / radius,
        "uneven": uneven + math.exp(-uneven),
        "draft_per_depth": max(run.mean_draft, 2.0 * run.force_rms) / height / 100.0,
        "excess": run.mean_draft / (run.mean_draft - run.force_rms),
        "spare": (0.2 * run.mean_draft + run.force_rms) / 1e3,
        "pushed": run.mean_draft / 1e3,
    }


def test_values_are_those_of_the_arithmetic(read):
    problem = read(written(RIGHT))
    run = problem.simulate()
    for name, value in by_hand(run).items():
        shown = float(measures_of(problem.table)[name].of(run)) / problem.displays[name].factor
        assert shown == pytest.approx(value, rel=1e-14), name  # a few roundings
        assert problem.displays[name].symbol == RIGHT[name][1]


def test_one_is_minimised_and_another_required(read):
    text = changed(
        ('mean_draft = { per = "1 kN" }', 'power_per_width = { per = "1 kW/m" }'),
        ("[require]", '[require]\ndraft_per_depth = { at_most = "150 N/cm" }'),
    )
    best, run = read(written(RIGHT, text), "scene.duration=0.5 s").optimise(search="near")
    expected = by_hand(run)
    # The design integrates its own run: both are right to 1e-8.
    assert best.objective == pytest.approx(expected["power_per_width"] + run.force_rms / 1e3, rel=1e-7)
    # Margins are SI: N/m.
    assert best.margins["draft_per_depth"] == pytest.approx(100.0 * (150.0 - expected["draft_per_depth"]), abs=1e-3)


def test_brackets_alone_nest_nothing(read):
    assert read(written({"mine": ("(" * 90 + "force_rms" + ")" * 90, "N")}))


@pytest.mark.parametrize("value", ["1 / 0", "exp(2000)", "(0 - 8)**0.5", "sqrt(0 - 1)", "log(force_rms/force_rms - 1)"])
def test_what_has_no_finite_value_is_refused_when_it_is_computed(read, value):
    problem = read(written({"mine": (value, "")}), "scene.duration=0.1 s")
    with pytest.raises(po.InputError, match="has no finite value in this run"):
        measures_of(problem.table)["mine"].of(problem.simulate())


WRONG_MEASURES = [
    *refused_files()["measures"],
    ("mine", "0x1" + 256 * "0" + " * force_rms", "N", "too large"),
    ("mine", "-" * 60 + "force_rms", "N", "deep"),
    ("mine", "force_rms" + " + force_rms" * 40, "N", "characters"),
]


@pytest.mark.parametrize(("name", "value", "unit", "words"), WRONG_MEASURES)
def test_wrong_ones_are_refused_with_their_line(blames, name, value, unit, words):
    blames(written({name: (value, unit)}), f"{name} = {{ value", words)


# --- several shares in a problem file, against designs of several scenes written in Python and against one share alone

TWO = f"""{STATIC}
[shares.front]
[shares.rear]
soil.cohesion = "30 kPa"
share.wedge_angle = "30 deg"
variables.share.height = {{ upper = "0.45 m" }}
require.loosened_radius = {{ at_least = "0.15 m" }}
"""
WAVE = 'strength_wave = { amplitude = 0.3, wavelength = "0.2 m" }'
MOVING = TWO.replace("motion = false", f'damping = "400 N*s/m"\n{WAVE}')


def scene_of(height, *, angle=35.0, cohesion=20e3):
    """Return the scene that `TWO` describes, built without a problem file."""
    soil = dataclasses.replace(po.named_soil("serozem"), cohesion=cohesion)
    share = po.Wedge(po.deg(angle), po.deg(15.0), height)
    return po.Scene(soil, share, 60e3, 20.0 + share.equivalent_cone().solid_mass(7850.0), 2.0, po.Effects(motion=False))


def near(problem, **options):
    """Return the optimum near the guess."""
    return problem.optimise(search="near", **options)[0]


def test_they_are_one_design_of_all_scenes(read):
    best, machine = read(TWO).optimise(search="near")
    design = po.Design()
    front = design.variable("front", guess=0.25, lower=0.1, upper=0.5, unit="m")
    rear = design.variable("rear", guess=0.25, lower=0.1, upper=0.45, unit="m")
    scenes = scene_of(front), scene_of(rear, angle=30.0, cohesion=30e3)
    design.minimise(sum(po.simulate(scene, 0.5).mean_draft for scene in scenes) / 1e3)
    for scene, radius in zip(scenes, (0.12, 0.15), strict=True):
        design.require(f"radius {radius}", scene.loosened_radius, at_least=radius, unit="m")
    own = design.solve(search="near")
    # Both solve to the optimiser's 1e-9; the requirements decide, so that nothing is flat.
    assert best.objective == pytest.approx(own.objective, rel=1e-8)
    heights = {"share.height": own.variables["front"], "rear.share.height": own.variables["rear"]}
    assert best.variables == pytest.approx(heights, rel=1e-8)
    assert machine.mean_draft == pytest.approx(sum(own(po.simulate(scene, 0.5)).mean_draft for scene in scenes), 1e-8)
    assert {*best.margins} == {"front.loosened_radius", "rear.loosened_radius"}


def test_what_is_chosen_above_is_one_value_for_all_shares(read):
    """Two shares alike need what one needs: twice the draft, at the same height."""
    alone, both = near(read(STATIC)), near(read(f"{STATIC}\n[shares.left]\n[shares.right]\n"))
    assert both.variables == pytest.approx(alone.variables, rel=1e-8)
    assert both.objective == pytest.approx(2.0 * alone.objective, rel=1e-8)
    assert both.run.tow_power == pytest.approx(2.0 * alone.run.tow_power, rel=1e-8)


def test_drafts_are_limited_together_and_all_else_for_each_share(read):
    best = near(read(TWO))
    # The radii need this draft of both shares together, and less is not to be had.
    least = float(best.run.mean_draft) / 1e3
    with pytest.raises(po.InfeasibleDesign, match="mean_draft"):
        near(read(TWO, f"require.mean_draft.at_most={0.99 * least} kN"))
    loose = near(read(TWO, f"require.mean_draft.at_most={1.01 * least} kN"))
    assert loose.margins["mean_draft"] == pytest.approx(0.01e3 * least, rel=1e-6)
    assert best.margins["rear.loosened_radius"] == pytest.approx(0.0, abs=1e-8)


def test_a_value_takes_the_place_of_a_variable_above_and_the_other_way_round(read):
    problem = read(f'{STATIC}\n[shares.a]\nshare.height = "0.3 m"\n[shares.b]\n')
    assert (set(problem.variables), problem.fixed["a.share.height"]) == ({"share.height"}, 0.3)
    for changes, heights in ((None, [0.3, 0.25]), ({"share.height": 0.2}, [0.3, 0.2])):
        assert [run.scene.share.height for run in problem.machine(changes).runs.values()] == heights
    free = "variables.soil.tool_friction={ lower = 0.1, upper = 0.5 }"
    smooth = read(f"{STATIC}\n[shares.a]\nsoil.tool_friction = 0\n[shares.b]\n", free)
    assert (len(smooth.variables), smooth.fixed["a.soil.tool_friction"]) == (2, 0.0)
    problem = read(f'{STATIC}\n[shares.a]\nvariables."scene.stiffness" = {{ lower = "9 kN/m", upper = "90 kN/m" }}')
    assert set(problem.variables) == {"share.height", "a.scene.stiffness"}
    assert problem.shares["a"].values()["scene.stiffness"] == pytest.approx(49.5e3)


def test_changes_reach_one_share_or_all(read):
    change = ('shares.rear.soil.cohesion="12 kPa"', 'shares.front.variables.share.height.upper="0.4 m"')
    problem = read(TWO, 'scene.tow_speed="3 m/s"', *change)
    front, rear = (part.scene() for part in problem.shares.values())
    assert front.tow_speed == rear.tow_speed == 3.0
    assert rear.soil.cohesion == 12e3 != front.soil.cohesion
    assert problem.variables["front.share.height"].upper == 0.4
    fixed = read(TWO, 'shares.rear.share.height="0.2 m"')
    assert set(fixed.variables) == {"share.height"}
    assert "is now fixed at" in " ".join(fixed.notes)
    assert fixed.shares["rear"].scene().share.height == 0.2


def test_one_share_can_be_chosen(read):
    problem = read(TWO, "shares=rear", 'soil.cohesion="31 kPa"')
    assert not problem.shares
    assert problem.scene().soil.cohesion == 31e3
    assert problem.table.require["loosened_radius"].at_least == "0.15 m"
    machine = read(TWO)
    with pytest.raises(po.InputError, match=r"several shares, front, rear.*--set shares=front.*problem\.shares"):
        machine.scene()
    assert read(TWO, *machine.shares["rear"].origin.overrides).scene() == machine.shares["rear"].scene()


def test_sensitivities_tell_shares_apart(read):
    best = near(read(TWO), parameters=True)
    # The soil above is that of the front share alone, for the rear one has its own.
    front, rear = (best.sensitivity(name, check=True) for name in ("soil.cohesion", "rear.soil.cohesion"))
    assert max(front.difference, rear.difference) < 1e-4  # central differences of two solves
    assert best.sensitivity("scene.tow_speed").objective > 0.0  # one speed for both
    alone = near(read(TWO, "shares=front"), parameters=True)
    assert front.objective == pytest.approx(alone.sensitivity("soil.cohesion").objective, rel=1e-6)


def test_a_front_trades_sums_over_the_shares(read):
    traded = f"{TWO}\n[trade_off]\nmean_draft = {{}}\nloosened_radius = {{ maximise = true }}\npoints = 5\n"
    drafts = read(traded).trade_off().to_dataframe()["mean_draft"]
    assert min(drafts) == pytest.approx(1e3 * near(read(TWO)).objective, rel=1e-6)


WRONG_SHARES = [
    *refused_files()["shares"],
    (TWO[TWO.index("[shares") :], "[[shares]]", "'shares' must hold a table for each share"),
]


@pytest.mark.parametrize(("old", "new", "said"), WRONG_SHARES)
def test_a_mistake_is_named_with_its_line(refusal, old, new, said):
    assert said in refusal(changed((old, new), text=TWO))


def test_a_change_to_an_unknown_share_or_to_no_table_is_refused(refusal):
    for change in ("shares=reer", "shares.reer.soil.cohesion=3 kPa"):
        assert "did you mean 'rear'" in refusal(TWO, change)
    assert "'shares' must hold a table for each share" in refusal(TWO, "shares.front=3")
    assert refusal(STATIC, "shares=rear") == "no share is named 'rear': the file has no table [shares]"


def test_the_commands_show_them_side_by_side(read, tmp_path):
    path, picture = read(MOVING).name, tmp_path / "frame.svg"
    shown = printed("check", path)
    assert "Scene of the share 'rear'" in shown
    assert "designed as one machine" in shown
    assert re.search(r"front\s+┃\s+rear\s+┃\s+together", printed("simulate", path, "--plot", picture))
    assert picture.stat().st_size > 0
    found = json.loads(printed("check", path, "--json"))
    assert found["quantities"]["rear.soil.cohesion"] == 30e3
    assert "soil.cohesion" not in found["quantities"]


def test_the_picture_of_their_optimum_has_both_responses_with_the_limits_of_each(read):
    best = read(TWO, "require.deflection.at_most=0.12 m").optimise(search=8)[0]
    force, deflection, *_, search, _ = best.plot().axes
    assert [line.get_label() for line in deflection.lines] == ["front", "limit of front", "rear", "limit of rear"]
    drafts = [line.get_ydata()[0] for line in force.lines]
    assert drafts == pytest.approx([run.mean_draft / 1e3 for run in best.run.runs.values()], rel=1e-8)
    assert search.get_xscale() == "linear"


def test_a_machine_adds_up_what_adds_up(read):
    machine = read(MOVING).machine()
    rows = {label: cells for label, *cells in machine.response().rows}
    own = [run.mean_draft for run in machine.runs.values()]
    assert rows["mean draft"] == [f"{draft / 1e3:.4g} kN" for draft in (*own, sum(own))]
    # Oscillations, deflections, radii and angles do not add up.
    assert {label for label, cells in rows.items() if cells[-1]} == {"mean draft", "tow power"}
    frame = machine.to_dataframe()
    assert len(frame) == sum(len(run.time) for run in machine.runs.values())
    assert list(dict.fromkeys(frame["share"])) == ["front", "rear"]


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


def test_commands_print_and_save_it(tmp_path):
    path = tmp_path / "share.toml"
    path.write_text(offering(', step = "2 cm"'), encoding="utf-8")
    out = printed("optimise", path, "--over", "worst")
    assert "corners" in out
    saved = json.loads(printed("optimise", path, "--json"))
    height = saved["bought"]["variables"]["share.height"]
    assert cells(printed("optimise", path).partition("best from the catalogue")[2], "share.height")[1:] == [
        f"{height:.5g} m", "catalogue",
    ]  # fmt: skip
    printed("explore", path, "-o", tmp_path / "a.html")
    page = (tmp_path / "a.html").read_text(encoding="utf-8")
    shown = f"{height:.5g}\N{NO-BREAK SPACE}m"
    assert f"From the catalogue: share height {shown} (objective +" in page
    table = tmp_path / "a.csv"
    heading = next(line for line in printed("optimise", path, "--csv", table).splitlines() if "Best design" in line)
    assert f"; from the catalogue {saved['bought']['objective']:.6g} (+" in heading
    assert heading.endswith(f"with share.height {height:.4g} m")
    assert table.read_text().splitlines()[-1] == f"from the catalogue,{saved['bought']['objective']!r},{height!r}"
    for at, size in (("catalogue", height), ("best", saved["variables"]["share.height"])):
        said = printed("export", path, "--to", "stl", "--at", at, "-o", tmp_path / f"{at}.stl")
        assert f"height {1e3 * size:.4g} mm" in said
    assert printed("export", path, "--to", "stl", "-o", tmp_path / "usual.stl").startswith(
        "Share of the best design from"
    )


def test_a_catalogue_in_which_nothing_will_do_leaves_the_best_with_a_warning(tmp_path):
    path = tmp_path / "share.toml"
    path.write_text(offering(', catalogue = ["0.11 m", "0.12 m"]'), encoding="utf-8")
    done = call("optimise", path)
    assert done.status == 0
    assert "nothing in the catalogue" in done.out
    assert "loosened_radius" in done.out.partition("nothing in the catalogue")[2]
    done = call("export", path, "--to", "stl", "-o", tmp_path / "a.stl")
    assert (done.status, "--at best" in done.said) == (1, True)
    path.write_text(STATIC, encoding="utf-8")
    assert "no variable" in call("export", path, "--to", "stl", "--at", "catalogue", "-o", tmp_path / "a.stl").said


@pytest.mark.parametrize(("more", "pieces"), [(more, pieces) for more, *pieces in refused_files()["catalogues"]])
def test_a_wrong_catalogue_is_refused_with_its_line(blames, more, pieces):
    blames(offering(more), "share.height", *pieces)


def test_a_catalogue_is_for_one_soil(refusal):
    text = offering(', step = "1 cm"') + '\n[uncertain]\n"soil.cohesion" = { distribution = "normal", std = "2 kPa" }\n'
    assert "one soil" in refusal(text)


def test_editors_complete_catalogues():
    assert {"catalogue", "step"} <= {*file_schema()["$defs"]["VariableTable"]["properties"]}
