"""FMUs: what fmpy and a C program make of them, their description, states, errors and archives."""

import ctypes
import dataclasses
import math
import re
import subprocess
import zipfile
from pathlib import Path

import casadi as ca
import numpy as np
import pint
import pytest
from helpers.differences import differences
from helpers.extras import needs
from helpers.linear_motion import released
from helpers.scenes import Shank, scene_of

import plough_opt as po
from plough_opt.exchange.building import NamedScene
from plough_opt.export import write_fmu

fmpy = needs("fmpy")
FMICallException = needs("fmpy.fmi1").FMICallException
FMU3Model = needs("fmpy.fmi3").FMU3Model
validate_fmu = needs("fmpy.validation").validate_fmu

# --- FMPy as a tool that imports and simulates FMUs ---

# FMPy's CVode holds the absolute error to the relative tolerance times the nominal values. Of its relative tolerance of
# 1e-11 some hundred steps of order 5 leave a few 1e-8.
TOLERANCE = 1e-11
WITHIN = 1e-7
DOUBLES = ctypes.POINTER(ctypes.c_double)
ARRAYS = ("travel", "speed", "deflection", "mount_force", "soil_resistance")
SHARE = po.Wedge(po.deg(45.0), po.deg(15.0), 0.25)


def fmu_scene(**changes):
    return scene_of(**{"share": SHARE, "stiffness": 3e5, "mass": 30.0, "tow_speed": 1.5} | changes)


def instance_of(path, kind=FMU3Model, log=None):
    """Return an instance of an FMU, and its value references by name."""
    description, folder = fmpy.read_model_description(str(path)), fmpy.extract(str(path))
    identifier = description.modelExchange.modelIdentifier
    fmu = kind(guid=description.guid, unzipDirectory=folder, modelIdentifier=identifier)
    fmu.instantiate(logMessage=log)
    return fmu, {variable.name: variable.valueReference for variable in description.modelVariables}


def simulated(path, duration, outputs=200, **options):
    """Simulate an FMU with FMPy's CVode."""
    given = {"fmi_type": "ModelExchange", "solver": "CVode", "relative_tolerance": TOLERANCE, "record_events": False}
    return fmpy.simulate_fmu(str(path), stop_time=duration, output_interval=duration / outputs, **given | options)


def worst(found, run):
    """Return the largest difference of any array, over that array's largest value; 0 if both are 0 throughout."""
    pairs = [(np.max(np.abs(found[name] - getattr(run, name))), np.max(np.abs(getattr(run, name)))) for name in ARRAYS]
    return max(float(error / size) if error else 0.0 for error, size in pairs)


# --- FMUs, simulated by FMPy: valid, with the motion of `po.simulate` ---

DURATION = 1.2
WAVE, CALM = po.StrengthWave(0.9, 0.25), po.StrengthWave(0.3, 0.2)
REFERENCE = po.Accuracy(error=1e-10)
Pair = dataclasses.make_dataclass(
    "Pair", ["pair"], frozen=True, namespace={"force": lambda self, _, speed: self.pair[0] + self.pair[1] * speed}
)
CASES = {
    "every smooth effect": {"strength_wave": CALM, "damping": 400.0, "speed_term": 0.1, "tow_ramp": 0.3},
    "smooth contact": {"contact": po.Smooth(0.1), "strength_wave": WAVE, "start": "towed"},
    "stick and slip": {"contact": po.StickSlip(1.3), "strength_wave": WAVE, "start": "rest"},
    "entry, stick and slip": {"contact": po.StickSlip(1.2), "strength_wave": WAVE, "start": "rest", "entry": True},
    "own resistances": {"own": (Shank(150.0, 80.0, per_metre=15.0), Pair((50.0, 30.0))), "strength_wave": WAVE,
                        "added_mass": False},
}  # fmt: skip


@pytest.mark.parametrize("effects", CASES.values(), ids=CASES)
def test_simulates_to_the_same_motion(effects, tmp_path):
    scene = fmu_scene(**effects)
    fmu = write_fmu(scene, tmp_path / "share.fmu")
    assert validate_fmu(str(fmu)) == []
    run = po.simulate(scene, DURATION, accuracy=REFERENCE, outputs=200)
    sticks = isinstance(scene.effects.contact, po.StickSlip)
    found = simulated(fmu, DURATION, output=[*ARRAYS, *(("mode", "opening") if sticks else ())])
    assert worst(found, run) <= WITHIN
    if sticks:
        assert np.array_equal(found["mode"], run.mode)
        assert np.max(np.abs(found["opening"] - run.opening)) < WITHIN * np.max(run.travel)
        assert len(np.unique(run.mode)) > 1


def test_another_scene_by_its_parameters_starts_from_its_own_equilibrium(r1_soil, tmp_path):
    first = fmu_scene(strength_wave=po.StrengthWave(0.2, 0.3), damping=500.0, rate_term=0.01)
    effects = po.Effects(strength_wave=po.StrengthWave(0.4, 0.25), damping=700.0, rate_term=0.03)
    share = po.Wedge(po.deg(35.0), po.deg(20.0), 0.2)
    mass = 25.0 + share.equivalent_cone().solid_mass(7800.0)
    second = po.Scene(r1_soil, share, 8e4, mass, 2.0, effects)
    fmu = write_fmu(first, tmp_path / "share.fmu", steel_density=7850.0)
    variables = fmpy.read_model_description(str(fmu)).modelVariables
    numbers = NamedScene(second, steel_density=7800.0).values
    values = {one.name: numbers[one.name] for one in variables if one.causality == "parameter"}
    # FMPy takes a value in a display unit too.
    values |= {"soil.friction_angle": (np.degrees(r1_soil.friction_angle), "deg"), "share.wedge_angle": (35.0, "deg")}
    values |= {"scene.stiffness": (80.0, "kN/m"), "strut_speed": (7.2, "km/h")}
    calculated = {
        "share.half_angle": second.cone.half_angle,
        "share.loosened_radius": second.loosened_radius,
        "share.static_resistance": second.reaction.static,
        "share.drag_coefficient": second.reaction.drag,
        "share.added_mass": second.reaction.added_mass,
    }
    run = po.simulate(second, DURATION, accuracy=REFERENCE, outputs=200)
    found = simulated(fmu, DURATION, start_values=values, output=[*ARRAYS, *calculated])
    assert worst(found, run) < WITHIN
    # Angles in degrees and speeds in km/h come back with an error of rounding.
    for name, value in calculated.items():
        assert found[name][0] == pytest.approx(value, rel=1e-13)
    # The start is not an integration: the steady deflection of (27) to rounding.
    assert found["deflection"][0] == pytest.approx(second.steady_resistance / second.stiffness, rel=1e-13)


class Driven(FMU3Model):
    """An FMU whose input is a function of time whenever rates are asked for: FMPy holds it between outputs."""

    reference, signal = 0, None

    def setTime(self, time):
        super().setTime(time)
        self.setFloat64([self.reference], [self.signal(time)])


def driven(path, name, signal, **options):
    fmu, references = instance_of(path, Driven)
    fmu.reference, fmu.signal = references[name], signal
    found = simulated(path, DURATION, fmu_instance=fmu, start_values={name: signal(0.0)}, **options)
    fmu.freeInstance()
    return found


def test_a_linear_position_equals_a_tow_speed(tmp_path):
    scene = fmu_scene(strength_wave=WAVE, contact=po.StickSlip(1.3))
    fmu = write_fmu(scene, tmp_path / "share.fmu", strut="position")
    assert validate_fmu(str(fmu)) == []
    run = po.simulate(scene, DURATION, accuracy=REFERENCE, outputs=200)
    found = driven(fmu, "strut_position", lambda time: 1.5 * time, output=list(ARRAYS))
    assert worst(found, run) < WITHIN


def test_a_parameter_may_change_at_an_event(tmp_path):
    # Without wave, drag and damper the deflection is a cosine about F0/k0, for each stiffness.
    scene = fmu_scene(inertial_drag=False, start="towed")
    fmu = write_fmu(scene, tmp_path / "share.fmu")
    load, inertia, half = scene.reaction.static, scene.inertia, DURATION / 2.0
    first, second = 3e5, 1.2e6
    signal = np.array(
        [(0.0, 1.5, first), (half, 1.5, first), (half, 1.5, second), (DURATION, 1.5, second)],
        dtype=[("time", float), ("strut_speed", float), ("scene.stiffness", float)],
    )
    found = simulated(fmu, DURATION, input=signal, output=["deflection", "mount_force"])
    time = found["time"]
    before = load / first + released(inertia, 0.0, first, (-load / first, 0.0), time)[0]
    z, rate = released(inertia, 0.0, first, (-load / first, 0.0), half)
    apart = z + load / first - load / second
    after = load / second + released(inertia, 0.0, second, (apart, rate), time - half)[0]
    expected = np.where(time < half, before, after)
    assert np.max(np.abs(found["deflection"] - expected)) < WITHIN * np.max(np.abs(expected))
    stiffness = np.where(time < half * (1 - 1e-9), first, second)
    assert np.allclose(found["mount_force"], stiffness * found["deflection"], rtol=1e-13)


# --- interface of an FMU: units, derivatives, states, parameters outside their domain, and invalid exports ---

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


OUTSIDE = [
    ("soil.density_ratio", 1.0, "soil.density_ratio = 1 must be below 1"),
    ("effects.strength_wave.amplitude", 1.5, "effects.strength_wave.amplitude = 1.5 must be at most 1"),
    ("soil.cohesion", -1.0, "soil.cohesion = -1 must be at least 0"),
    ("strut_speed", -0.5, "strut_speed = -0.5 must be at least 0 at the start"),
    ("strut_speed", np.inf, "must be finite"),
]


@pytest.mark.parametrize(("name", "value", "words"), OUTSIDE)
def test_parameters_outside_their_domain_are_refused(fmu, name, value, words):
    made, _, messages = logged(fmu)
    with pytest.raises(FMICallException):
        simulated(fmu, 0.1, fmu_instance=made, start_values={name: value})
    assert words in messages[-1]
    made.freeInstance()


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


BAD_EXPORTS = [
    ({"motion": False}, {}, "has nothing to integrate"),
    ({"stiffness": ca.MX.sym("k")}, {}, "evaluate it with best"),
    ({}, {"strut": "acceleration"}, "must be 'speed' or 'position'"),
    ({"damping": 3.0}, {"strut": "position"}, "a damper in the mount needs the strut's speed"),
    ({"mass": 1.0}, {"steel_density": 7850.0}, "more than the whole moving mass of 1 kg"),
    ({}, {"name": "two words"}, "must be a C identifier"),
]


@pytest.mark.parametrize(("changes", "options", "words"), BAD_EXPORTS)
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
