"""A right problem file becomes: a scene, its variables, and the same results as Python by hand."""

import math
import tomllib

import numpy as np
import pytest

import plough_opt as po
from plough_opt.motion.vocabulary import MEASURES
from plough_opt.problem_file import TEMPLATE

DEG = math.pi / 180


def steel_mass(wedge_angle, chisel_angle, height):
    """Return the mass of a solid steel cone of equal height and surface, by the source's own form of (7)."""
    p = math.pi * math.cos(chisel_angle) ** 2 / (2 * math.tan(wedge_angle))
    half_angle = math.asin(math.sqrt(p**2 + 1) - p)
    return 7850 * math.pi / 3 * height**3 * math.tan(half_angle) ** 2


@pytest.fixture(scope="module")
def subsoiler(problems):
    return po.read_problem(problems / "cotton_subsoiler.toml")


@pytest.fixture(scope="module")
def reference(problems):
    return po.read_problem(problems / "reference.toml")


def test_a_file_has_its_variables_and_title(reference):
    assert reference.title == "R1: reference problem with three local optima"
    assert reference.notes == ()
    assert "reference.toml" in reference.scene().soil.source
    found = {name: (v.lower, v.upper, v.guess, v.log, v.unit) for name, v in reference.variables.items()}
    assert found == {
        "share.wedge_angle": (*(pytest.approx(x * DEG) for x in (5, 60, 25)), False, "rad"),
        "share.height": (0.10, 0.50, 0.25, False, "m"),
        "scene.stiffness": (*(pytest.approx(x) for x in (5e3, 500e3, 50e3)), True, "N/m"),
    }


@pytest.mark.parametrize("name", ["subsoiler", "reference"])
def test_a_file_simulates_as_the_same_scene_built_in_python(name, request):
    run = request.getfixturevalue(name).simulate()
    soil = {
        "subsoiler": po.named_soil("serozem"),
        "reference": po.Soil(density=1400, density_ratio=0.8, cohesion=15e3, friction_angle=po.deg(30),
                             tool_friction=0.5, ambient_pressure=10e3),
    }[name]  # fmt: skip
    share = po.Wedge(angle=po.deg(25), chisel_angle=po.deg(15), height=0.25)
    wavelength, damping = {"subsoiler": (0.2, 400.0), "reference": (0.6, None)}[name]
    effects = po.Effects(strength_wave=po.StrengthWave(amplitude=0.3, wavelength=wavelength), damping=damping)
    mass = 20.0 + steel_mass(25 * DEG, 15 * DEG, 0.25)
    by_hand = po.simulate(po.Scene(soil, share, 50e3, mass, 2.0, effects), duration=2.0)
    np.testing.assert_allclose(run.time, np.linspace(0.0, 2.0, 401), atol=1e-12)
    np.testing.assert_allclose(run.mount_force, by_hand.mount_force, rtol=1e-9)
    np.testing.assert_allclose(run.deflection, by_hand.deflection, rtol=1e-9)
    assert run.mean_draft == pytest.approx(by_hand.mean_draft, rel=1e-11)
    assert run.force_rms == pytest.approx(by_hand.force_rms, rel=1e-10)


def test_the_template_means_the_same_as_the_subsoiler(read, cotton, subsoiler):
    assert tomllib.loads(TEMPLATE) == tomllib.loads(cotton)
    template = read(TEMPLATE)
    assert template.scene() == subsoiler.scene()
    assert template.variables == subsoiler.variables
    assert template.table == subsoiler.table


def test_what_the_template_comments_out_is_right_too(read):
    lines = [
        line.removeprefix("# ") if line.startswith("# [") or (line.startswith("# ") and " = " in line) else line
        for line in TEMPLATE.splitlines()
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


def test_a_named_soil_takes_overrides_and_says_so(read, changed):
    name = 'name = "serozem"'
    soil = read(changed((name, f'{name}\ncohesion = "25 kPa"\ndensity_ratio = "75 %"'))).scene().soil
    serozem = po.named_soil("serozem")
    assert (soil.cohesion, soil.density_ratio) == (pytest.approx(25e3), pytest.approx(0.75))
    assert (soil.density, soil.friction_angle) == (serozem.density, serozem.friction_angle)
    assert soil.source.startswith(serozem.source)
    assert "changed in" in soil.source
    assert "cohesion, density_ratio" in soil.source


def test_a_soil_may_be_given_in_full_with_its_elastic_constants(read, changed):
    given = """\
density = "1.35 g/cm^3"
density_ratio = 0.8
cohesion = "15 kPa"
friction_angle = "30 deg"
tool_friction = "50 %"
youngs_modulus = "10 MPa"
poisson_ratio = 0.33"""
    soil = read(changed(('name = "serozem"', given))).scene().soil
    assert soil.density == pytest.approx(1350.0)
    assert (soil.youngs_modulus, soil.poisson_ratio) == (pytest.approx(10e6), 0.33)
    assert (soil.tool_friction, soil.ambient_pressure) == (0.5, 101325.0)


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
    assert problem.scene().effects == po.Effects(
        inertial_drag=False, added_mass=False, ambient_pressure=False, start="rest", tow_ramp=0.5, rate_term=0.01
    )  # fmt: skip
    run = problem.simulate()
    assert (run.accuracy.method, run.accuracy.steps) == ("dop853", 800)
    np.testing.assert_allclose(run.time, np.linspace(0.0, 1.0, 9), atol=1e-15)


def test_a_guess_left_out_is_the_middle_of_its_bounds_geometric_on_a_log_scale(read, changed):
    scene = read(changed((', guess = "25 deg"', ""), (', guess = "50 kN/m"', ""))).scene()
    assert scene.share.angle == pytest.approx(32.5 * DEG)
    assert scene.stiffness == pytest.approx(100e3)


VARIABLES = [
    ("soil.cohesion", "", ("10 kPa", "30 kPa"), lambda scene: scene.soil.cohesion / 20e3),
    ("scene.steel_density", 'steel_density = "7850 kg/m^3"', ("7.8 t/m^3", "7.9 t/m^3"),
     lambda scene: (scene.mass - 20) / steel_mass(25 * DEG, 15 * DEG, 0.25)),
    ("effects.strength_wave.amplitude", "amplitude = 0.3, ", ("0.1", "0.5"),
     lambda scene: scene.effects.strength_wave.amplitude / 0.3),
    ("scene.duration", 'duration = "2 s"\n', ("1 s", "3 s"), lambda _: 1.0),
]  # fmt: skip


@pytest.mark.parametrize(("key", "fixed", "ends", "value"), VARIABLES, ids=[key for key, *_ in VARIABLES])
def test_any_quantity_may_be_a_variable(read, changed, key, fixed, ends, value):
    variable = "[variables]", f"[variables]\n'{key}' = {{ lower = '{ends[0]}', upper = '{ends[1]}' }}"
    problem = read(changed(variable, *([(fixed, "")] if fixed else [])))
    assert key in problem.variables
    assert value(problem.scene()) == pytest.approx(1.0, rel=1e-12)


def test_comments_blank_lines_windows_line_ends_and_a_byte_order_mark_mean_nothing(tmp_path, cotton, subsoiler):
    text = "# a comment\n\n" + cotton.replace("\n", "  # said\n\n")
    path = tmp_path / "share.toml"
    path.write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode())
    assert po.read_problem(str(path)).scene() == subsoiler.scene()


def test_every_average_may_be_minimised_and_every_measure_required(read, cotton):
    measures = {name: one for name, one in MEASURES.items() if not one.random}
    averages = [name for name, one in measures.items() if not one.everywhere]
    minimise = "".join(f'minimise.{name}.per = "2 {measures[name].unit.symbol}"\n' for name in averages)
    require = "".join(f'require.{name}.at_most = "1e9 {one.unit.symbol}"\n' for name, one in measures.items())
    problem = read(minimise + require + cotton.split("[minimise]")[0])
    assert problem.design()[1].time.numel() == 401
    assert (list(problem.table.minimise), list(problem.table.require)) == (averages, list(measures))


def test_a_quasi_static_file_has_the_optimum_that_is_worked_out_by_hand(read):
    """The radius is proportional to the height, and the draft grows with it: the least radius decides."""
    question = """effects.motion = false
variables."share.height" = { lower = "5 cm", upper = "50 cm" }
minimise = { mean_draft = { per = "500 N" }, tow_power = { per = "2 kW" } }
require.loosened_radius.at_least = "10 cm"
"""
    best, run = read(MINIMAL.replace(', height = "20 cm"', "") + question).optimise()
    cone, soil = po.Wedge(angle=30 * DEG, chisel_angle=0.0, height=1.0).equivalent_cone(), po.named_soil("hardpan")
    height = 0.1 / po.loosened_radius(cone, soil)
    force = po.resistance(po.Cone(cone.half_angle, height), soil, 1.0, 0.0)
    assert best.variables["share.height"] == pytest.approx(height, rel=1e-7)
    assert best.objective == pytest.approx(force / 500.0 + force * 1.0 / 2000.0, rel=1e-7)
    assert run.mean_draft == pytest.approx(force, rel=1e-7)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ('minimise.mean_draft.per = "1 kN"\n', r"nothing to choose: add a table \[variables\]"),
        ('variables."scene.steel_density" = { lower = "7 t/m^3", upper = "8 t/m^3" }\n',
         r"nothing to minimise: add a table \[minimise\]"),
    ],
)  # fmt: skip
def test_a_design_with_nothing_to_choose_or_to_minimise_is_refused(read, more, words):
    with pytest.raises(po.InputError, match=rf"share\.toml: {words}"):
        read(MINIMAL + more).design()
