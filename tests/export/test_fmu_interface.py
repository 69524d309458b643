"""Interface of an FMU: units, derivatives, states, parameters outside their domain, and invalid exports."""

import dataclasses
import math
import re
import subprocess
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import casadi as ca
import fmpy
import numpy as np
import pint
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu
from helpers.differences import differences
from helpers.fmu_tools import DOUBLES, WITHIN, fmu_scene, instance_of, simulated, worst

import plough_opt as po
from plough_opt.core.expressions import exp
from plough_opt.export import write_fmu

EFFECTS = {
    "strength_wave": po.StrengthWave(0.3, 0.2), "damping": 900.0, "rate_term": 0.05, "contact": po.Smooth(0.2),
    "tow_ramp": 0.3,
}  # fmt: skip


@pytest.fixture(scope="module")
def scene():
    """A scene with every effect that is smooth, at the end of the ramp where speeds are up."""
    return fmu_scene(**EFFECTS, stiffness=1e5)


@pytest.fixture(scope="module")
def fmu(scene, tmp_path_factory):
    return write_fmu(scene, tmp_path_factory.mktemp("fmu") / "share.fmu", steel_density=7850.0, duration=1.0)


@pytest.fixture
def instance(fmu):
    made, references = instance_of(fmu)
    yield made, references
    made.freeInstance()


def started(instance, time=0.2):
    """Bring an instance to continuous time mode, off its equilibrium."""
    made, references = instance
    made.enterInitializationMode()
    made.exitInitializationMode()
    made.updateDiscreteStates()
    made.enterContinuousTimeMode()
    made.setTime(time)
    states = np.array([0.31, 0.9, 0.07])
    made.setContinuousStates(states.ctypes.data_as(DOUBLES), 3)
    return made, references


def test_every_variable_is_described_and_every_quantity_has_its_unit(fmu):
    description = fmpy.read_model_description(str(fmu))
    registry = pint.UnitRegistry()
    for unit in description.unitDefinitions:
        base = unit.baseUnit
        built = math.prod(registry.Unit(name) ** getattr(base, name) for name in ("kg", "m", "s", "rad"))
        # FMI writes N.s/m and kg/m3 where pint reads N*s/m and kg/m**3.
        written = re.sub(r"([a-z])(\d)", r"\1**\2", unit.name).replace(".", "*")
        assert (1.0 * registry.Unit("" if written == "1" else written)).to_base_units() == 1.0 * built, unit.name
        for shown in unit.displayUnits:
            one = registry.Quantity(1.0, written).to(shown.name).magnitude
            assert shown.factor == pytest.approx(one, rel=1e-15), shown.name
    for variable in description.modelVariables:
        assert variable.description, variable.name
        assert variable.unit in {unit.name for unit in description.unitDefinitions}, variable.name
    limits = {variable.name: (variable.min, variable.max) for variable in description.modelVariables}
    assert limits["soil.density_ratio"] == ("0.0", "1.0")
    assert limits["scene.stiffness"] == ("0.0", None)
    assert float(limits["share.wedge_angle"][1]) == np.pi / 2


def test_effects_that_are_off_add_no_variables(tmp_path):
    bare = fmu_scene(inertial_drag=False, added_mass=False, ambient_pressure=False, tow_ramp=0.0)
    written = write_fmu(bare, tmp_path / "bare.fmu", binary=False)
    names = {variable.name for variable in fmpy.read_model_description(str(written)).modelVariables}
    assert not [name for name in names if name.startswith(("effects.", "event_indicator", "mode"))]
    assert not names & {"soil.density", "soil.ambient_pressure", "share.drag_coefficient", "share.added_mass"}
    assert len(names) == 24


def test_derivatives_are_those_of_the_values(instance):
    made, references = started(instance)
    states, outputs = ("travel", "speed", "deflection"), ("mount_force", "soil_resistance", "strut_position")
    knowns = [references[name] for name in (*states, "strut_speed")]
    unknowns = [references[name] for name in (*(f"der({state})" for state in states), *outputs)]

    def values(at):
        made.setContinuousStates(at[:3].ctypes.data_as(DOUBLES), 3)
        made.setFloat64(knowns[3:], at[3:])
        return np.array(made.getFloat64(unknowns))

    here = np.array(made.getFloat64(knowns))
    slopes = differences(lambda part: values(part * here), np.ones(len(here)), 1e-3)
    values(here)
    for known, size, slope in zip(knowns, here, slopes.T, strict=True):
        exact = size * np.array(made.getDirectionalDerivative(unknowns, [known], [1.0]))
        assert np.max(np.abs(exact - slope)) < 1e-9 * np.max(np.abs(slope)), known


def test_derivatives_at_the_start_go_through_the_equilibrium(tmp_path):
    scene = fmu_scene(rate_term=0.05)
    fmu, references = instance_of(write_fmu(scene, tmp_path / "share.fmu"))
    fmu.enterInitializationMode()

    def derivative(unknown, known):
        return fmu.getDirectionalDerivative([references[unknown]], [references[known]], [1.0])[0]

    load, drag, speed, stiffness = scene.reaction.static, scene.reaction.drag, scene.tow_speed, scene.stiffness
    deflection = (load * (1.0 + 0.05 * speed**2) + drag * speed**2) / stiffness
    assert derivative("deflection", "scene.stiffness") == pytest.approx(-deflection / stiffness, rel=1e-13)
    by_speed = 2.0 * speed * (0.05 * load + drag) / stiffness
    assert derivative("deflection", "strut_speed") == pytest.approx(by_speed, rel=1e-13)
    assert derivative("travel", "strut_speed") == pytest.approx(-by_speed, rel=1e-13)
    assert derivative("mount_force", "scene.stiffness") == pytest.approx(0.0, abs=1e-13 * deflection)
    # F0 is linear in the cohesion.
    firmer = fmu_scene(soil=dataclasses.replace(scene.soil, cohesion=scene.soil.cohesion + 1e4))
    slope = (firmer.reaction.static - load) / 1e4
    assert derivative("share.static_resistance", "soil.cohesion") == pytest.approx(slope, rel=1e-12)
    fmu.freeInstance()


@pytest.mark.parametrize("at_start", [False, True], ids=["later", "at the start"])
def test_adjoint_derivatives_are_the_transpose(fmu, instance, at_start):
    made, references = instance
    variables = fmpy.read_model_description(str(fmu)).modelVariables
    knowns = [variable.valueReference for variable in variables if variable.causality in ("input", "parameter")]
    unknowns = [references[name] for name in ("der(speed)", "mount_force", "soil_resistance", "share.added_mass")]
    if at_start:
        made.enterInitializationMode()
        unknowns += [references["deflection"]]
    else:
        started(instance)
        knowns += [references[name] for name in ("travel", "speed", "deflection")]
    random = np.random.default_rng(1)
    # Seeds of each variable's own order of magnitude, as long as that is not 0.
    seed = random.uniform(-1.0, 1.0, len(knowns)) * np.array(made.getFloat64(knowns))
    weight = random.uniform(-1.0, 1.0, len(unknowns)) / np.maximum(np.abs(made.getFloat64(unknowns)), 1.0)
    forwards = np.dot(weight, made.getDirectionalDerivative(unknowns, knowns, seed))
    backwards = np.dot(seed, made.getAdjointDerivative(unknowns, knowns, weight, len(knowns)))
    assert forwards != 0.0
    assert backwards == pytest.approx(forwards, rel=1e-12)


def test_state_is_kept_and_serialised(instance):
    made, references = started(instance)
    names = [references[name] for name in ("travel", "der(speed)", "mount_force", "scene.stiffness")]
    before = made.getFloat64(names)
    state = made.getFMUState()
    kept = made.serializeFMUState(state)
    made.setTime(0.9)
    made.setFloat64([references["strut_speed"]], [0.3])
    assert made.getFloat64(names) != before
    made.setFMUState(state)
    assert made.getFloat64(names) == before
    made.freeFMUState(state)
    made.reset()
    made.enterInitializationMode()
    restored = made.deserializeFMUState(kept)
    made.setFMUState(restored)
    assert made.getFloat64(names) == before
    made.freeFMUState(restored)


def logged(fmu):
    """Return an instance, its value references, and a list to which it adds its messages."""
    messages = []
    return *instance_of(fmu, log=lambda *arguments: messages.append(arguments[-1].decode())), messages


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("soil.density_ratio", 1.0, "soil.density_ratio = 1 must be below 1"),
        ("effects.strength_wave.amplitude", 1.5, "effects.strength_wave.amplitude = 1.5 must be at most 1"),
        ("soil.cohesion", -1.0, "soil.cohesion = -1 must be at least 0"),
        ("strut_speed", -0.5, "strut_speed = -0.5 must be at least 0 at the start"),
        ("strut_speed", np.inf, "must be finite"),
    ],
)
def test_parameters_outside_their_domain_are_refused(fmu, name, value, words):
    made, _, messages = logged(fmu)
    with pytest.raises(FMICallException):
        simulated(fmu, 0.1, fmu_instance=made, start_values={name: value})
    assert words in messages[-1]
    made.freeInstance()


def test_calls_in_the_wrong_mode_are_refused(fmu):
    made, references, messages = logged(fmu)
    force = references["mount_force"]
    for call, *arguments in (
        (made.setFloat64, [references["share.half_angle"]], [0.1]),
        (made.enterContinuousTimeMode,),
        (made.getFloat64, [10_000]),
        (made.getDirectionalDerivative, [force], [force], [1.0]),
        (lambda: started((made, references))[0].setFloat64([references["scene.stiffness"]], [2e5]),),
    ):
        with pytest.raises(FMICallException):
            call(*arguments)
    assert len(messages) == 5
    made.freeInstance()


def test_a_retreating_share_is_logged(tmp_path, capsys):
    for contact, warned in (("resisting", True), (po.Smooth(0.1), False)):
        simulated(write_fmu(fmu_scene(start="rest", contact=contact), tmp_path / "share.fmu"), 0.2)
        assert ("[WARNING] the share retreats at" in capsys.readouterr().out) is warned


def test_the_sources_are_all_that_a_compiler_needs(scene, fmu, tmp_path):
    written = write_fmu(scene, tmp_path / "sources.fmu", steel_density=7850.0, binary=False)
    assert validate_fmu(str(written)) == []
    assert not [name for name in zipfile.ZipFile(written).namelist() if name.startswith("binaries")]
    folder = Path(fmpy.extract(str(written)))
    (files,) = fmpy.read_model_description(str(folder)).buildConfigurations[0].sourceFileSets
    assert files.language == "C11"
    binaries = folder / "binaries" / fmpy.platform_tuple
    binaries.mkdir(parents=True)
    library = binaries / f"plough_share{fmpy.sharedLibraryExtension}"
    sources = [folder / "sources" / name for name in files.sourceFiles]
    subprocess.run(["cc", "-std=c11", "-shared", "-fPIC", "-o", library, *sources, "-lm"], check=True)
    ours, theirs = simulated(fmu, 0.3), simulated(folder, 0.3)
    # Other optimisations round otherwise.
    assert np.allclose(ours["mount_force"], theirs["mount_force"], rtol=1e-9, atol=0.0)


def test_a_density_profile_has_no_derivatives(tmp_path):
    soil = po.named_soil("serozem").with_density_profile(
        lambda r, width: 1450 + 250 * exp(-((r / width) ** 2)), 0.2, order=2
    )
    effects = {"strength_wave": po.StrengthWave(0.3, 0.2), "damping": 900.0}
    written = write_fmu(fmu_scene(**effects, soil=soil), tmp_path / "profile.fmu")
    assert validate_fmu(str(written)) == []
    exchange = ElementTree.fromstring(zipfile.ZipFile(written).read("modelDescription.xml")).find("ModelExchange")
    assert exchange.get("providesDirectionalDerivatives") == exchange.get("providesAdjointDerivatives") == "false"
    made, references = instance_of(written)
    made.enterInitializationMode()
    with pytest.raises(FMICallException):
        made.getDirectionalDerivative([references["deflection"]], [references["scene.stiffness"]], [1.0])
    made.freeInstance()
    wider = po.named_soil("serozem").with_density_profile(soil.density_profile.density, 0.3, order=2)
    run = po.simulate(fmu_scene(**effects, soil=wider), 0.6, accuracy=po.Accuracy(error=1e-10), outputs=200)
    found = simulated(written, 0.6, start_values={"soil.density_profile.parameters[1]": 0.3})
    assert worst(found, run) < WITHIN


def test_the_same_scene_gives_the_same_file(scene, tmp_path):
    first, second = (write_fmu(scene, tmp_path / name, binary=False) for name in ("first.fmu", "second.fmu"))
    assert first.read_bytes() == second.read_bytes()
    other = write_fmu(fmu_scene(**EFFECTS), second, binary=False)
    tokens = {fmpy.read_model_description(str(path)).instantiationToken for path in (first, other)}
    assert len(tokens) == 2
    page = zipfile.ZipFile(first).read("documentation/index.html").decode()
    # XML parsers read it: every tag is closed.
    read = ElementTree.fromstring(page.replace("<!DOCTYPE html>", "").replace('<meta charset="utf-8">', ""))
    assert "half angle" in "".join(read.itertext())


@pytest.mark.parametrize(
    ("changes", "options", "words"),
    [
        ({"motion": False}, {}, "has nothing to integrate"),
        ({"orbit": "periodic"}, {}, "has no start"),
        ({"stiffness": ca.MX.sym("k")}, {}, "evaluate it with best"),
        ({"stiffness": np.array([1e4, 2e4])}, {}, "an array of 2 values"),
        ({}, {"strut": "acceleration"}, "must be 'speed' or 'position'"),
        ({"damping": 3.0}, {"strut": "position"}, "a damper in the mount needs the strut's speed"),
        ({"tow_ramp": 0.3}, {"strut": "position"}, "leave tow_ramp out"),
        ({"mass": 1.0}, {"steel_density": 7850.0}, "more than the whole moving mass of 1 kg"),
        ({}, {"steel_density": -1.0}, "density of the share's material = -1 kg/m^3 must be at least 0"),
        ({}, {"duration": 0.0}, "duration = 0 s must be above 0"),
        ({}, {"name": "two words"}, "must be a C identifier"),
    ],
)
def test_bad_exports_are_refused_and_change_no_file(changes, options, words, tmp_path):
    path = tmp_path / "share.fmu"
    path.write_text("as it was")
    with pytest.raises((po.InputError, po.DomainError), match=re.escape(words)):
        write_fmu(fmu_scene(strength_wave=po.StrengthWave(0.3, 0.2), **changes), path, **options)
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == [("share.fmu", "as it was")]


def test_without_a_compiler_or_a_known_processor_nothing_is_written(scene, tmp_path, monkeypatch):
    for name, value, words in (("CC", "false", "compile the FMU"), ("PATH", str(tmp_path), "no C compiler was found")):
        monkeypatch.setenv(name, value)
        with pytest.raises(po.InputError, match=words):
            write_fmu(scene, tmp_path / "share.fmu")
    monkeypatch.setattr("platform.machine", lambda: "s390x")
    with pytest.raises(po.InputError, match=r"does not define binaries for [a-z]+ on s390x: use binary=False"):
        write_fmu(scene, tmp_path / "share.fmu")
    assert not list(tmp_path.iterdir())
