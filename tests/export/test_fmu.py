"""FMUs, simulated by FMPy: valid, with the motion of `po.simulate`."""

import dataclasses

import fmpy
import numpy as np
import pytest
from fmpy.fmi3 import FMU3Model
from fmpy.validation import validate_fmu
from helpers.fmu_tools import ARRAYS, CLOSELY, WITHIN, fmu_scene, instance_of, simulated, stepped, worst
from helpers.linear_motion import released
from helpers.scenes import Shank

import plough_opt as po
from plough_opt.exchange.named_scene import NamedScene
from plough_opt.export import write_fmu

DURATION = 1.2
WAVE, CALM = po.StrengthWave(0.9, 0.25), po.StrengthWave(0.3, 0.2)
STRENGTHLESS = dataclasses.replace(po.named_soil("serozem"), cohesion=0.0, ambient_pressure=0.0, friction_angle=0.0)
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
MORE_CASES = {
    "from rest": {"start": "rest", "damping": 300.0, "inertial_drag": False, "ambient_pressure": False},
    "stick and slip on a ramp": {"contact": po.StickSlip(1.3), "strength_wave": WAVE, "tow_ramp": 0.4, "damping": 50.0},
    "entry with retreat": {"entry": True, "start": "rest", "strength_wave": WAVE},
    "one printed error": {"formulation": po.Printed(repelling_spring=False), "strength_wave": CALM},
}
EDGES = {
    "a strut that stands still": ({}, {"tow_speed": 0.0}),
    "a cone": ({"start": "towed"}, {"share": po.Cone(po.deg(12.0), 0.3)}),
    "no strength": ({}, {"soil": STRENGTHLESS}),
    "no strength, stick and slip": ({"start": "rest", "contact": po.StickSlip()}, {"soil": STRENGTHLESS}),
}


@pytest.mark.parametrize(
    ("effects", "changes"),
    [
        *(pytest.param(effects, {}, id=name) for name, effects in CASES.items()),
        *(pytest.param(effects, {}, id=name, marks=pytest.mark.slow) for name, effects in MORE_CASES.items()),
        *(pytest.param(*changed, id=name, marks=pytest.mark.slow) for name, changed in EDGES.items()),
    ],
)
def test_simulates_to_the_same_motion(effects, changes, tmp_path):
    scene = fmu_scene(**effects, **changes)
    effects = scene.effects
    fmu = write_fmu(scene, tmp_path / "share.fmu")
    assert validate_fmu(str(fmu)) == []
    run = po.simulate(scene, DURATION, accuracy=REFERENCE, outputs=200)
    sticks = isinstance(effects.contact, po.StickSlip)
    found = simulated(fmu, DURATION, output=[*ARRAYS, *(("mode", "opening") if sticks else ())])
    assert worst(found, run) <= WITHIN
    if changes:
        return
    if sticks:
        assert np.array_equal(found["mode"], run.mode)
        assert np.max(np.abs(found["opening"] - run.opening)) < WITHIN * np.max(run.travel)
        assert len(np.unique(run.mode)) > 1
    enters = sticks and effects.entry
    for beside in (0.0, -1e-12, 1e-12) if enters else (0.0,):
        found, events = stepped(fmu, run.time, ARRAYS, beside)
        assert worst(found, run) < CLOSELY
        # Breaking away, wholly buried, and then once at least for each wavelength: stop, gap or recapture.
        assert events > 8 or not enters


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


def ramped(time, speed=1.5, ramp=0.4):
    """Speed of a strut on a ramp: the smoothstep of fifth order."""
    u = min(time / ramp, 1.0)
    return speed * u**3 * (10.0 + u * (6.0 * u - 15.0))


def test_a_speed_signal_equals_a_tow_ramp(tmp_path):
    # A scene without events that never retreats.
    constant, ramping = (
        fmu_scene(strength_wave=po.StrengthWave(0.3, 0.2), damping=900.0, tow_ramp=ramp, stiffness=1e5)
        for ramp in (None, 0.4)
    )
    run = po.simulate(ramping, DURATION, accuracy=REFERENCE, outputs=200)
    found = driven(
        write_fmu(constant, tmp_path / "waved.fmu"), "strut_speed", ramped, output=[*ARRAYS, "strut_position"]
    )
    assert worst(found, run) < WITHIN
    # The path of the ramp is half its time at full speed behind.
    assert found["strut_position"][-1] == pytest.approx(1.5 * (DURATION - 0.2), rel=WITHIN)


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
