"""Scenes in the elastic medium: the steady contact force, and refusals of effects without meaning there."""

import dataclasses
import json
import math

import casadi as ca
import numpy as np
import pytest

import plough_opt as po
from plough_opt.soil import elastic

SOIL = po.named_soil("serozem")
SHARE = po.Wedge(po.deg(30), po.deg(15), 0.25)
STEADY = po.Effects(motion=False)


def scene(**changes):
    return po.Scene(**({"soil": SOIL, "share": SHARE, "stiffness": 5e5, "mass": 20.0, "tow_speed": 2.0,
                        "effects": STEADY, "medium": "elastic"} | changes))  # fmt: skip


@pytest.mark.parametrize("share", [SHARE, SHARE.equivalent_cone()], ids=["wedge", "cone"])
def test_draft_is_the_contact_force_on_the_equivalent_cone(share):
    force = elastic.cone_force(SHARE.equivalent_cone(), SOIL, 2.0)
    run = po.simulate(scene(share=share), duration=1.0)
    assert run.mean_draft == pytest.approx(force, rel=1e-14)
    np.testing.assert_allclose(run.mount_force, force, rtol=1e-14)
    np.testing.assert_allclose(run.deflection, force / 5e5, rtol=1e-14)
    # Rounding of the average of a constant.
    assert run.force_rms <= 1e-14 * force
    assert run.tow_power == pytest.approx(2.0 * force, rel=1e-14)


def test_scene_carries_no_part_of_the_plastic_gas():
    own = scene()
    assert own.inertia == 20.0
    assert own.reaction.drag == own.reaction.added_mass == own.ambient_share == 0.0
    assert any("order of magnitude" in warning for warning in own.warnings())
    assert not any("order of magnitude" in warning for warning in scene(medium="plastic").warnings())


def test_ambient_pressure_only_keeps_the_contact():
    # The soil presses on the whole cone, so contact is never lost and the force above ambient pressure stays.
    without = scene(effects=po.Effects(motion=False, ambient_pressure=False))
    assert without.steady_resistance == pytest.approx(scene().steady_resistance, rel=1e-14)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"effects": po.Effects()}, r"motion has no meaning in the elastic medium.*Effects\(motion=False\)"),
        (
            {"effects": po.Effects(motion=False, strength_wave=po.StrengthWave(0.3, 0.2))},
            "strength_wave has no meaning",
        ),
        ({"effects": po.Effects(motion=False, tow_ramp=0.1)}, "tow_ramp has no meaning"),
        ({"effects": po.Effects(motion=False, rate_term=0.1)}, "rate_term has no meaning"),
        (
            {"effects": po.Effects(motion=False, formulation=po.Printed(repelling_spring=False))},
            "printed formulation is one of the plastic gas",
        ),
        ({"medium": "viscous"}, "no resistance law is named 'viscous'.*elastic.*plastic"),
    ],
)
def test_effects_without_meaning_are_refused(changes, message):
    with pytest.raises(po.InputError, match=message):
        scene(**changes)


def test_it_has_no_loosened_section():
    run = po.simulate(scene(), duration=1.0)
    with pytest.raises(po.InputError, match="no compaction front"):
        _ = run.specific_draft
    with pytest.raises(po.InputError, match="no compaction front"):
        _ = scene().loosened_radius


def test_soil_without_elastic_constants_and_a_speed_beyond_the_shear_wave_are_refused():
    with pytest.raises(po.InputError, match="needs youngs_modulus"):
        po.simulate(scene(soil=dataclasses.replace(SOIL, youngs_modulus=None)), duration=1.0)
    with pytest.raises(po.DomainError, match=r"speed over shear wave speed = 1\.1"):
        po.simulate(scene(tow_speed=1.1 * elastic.shear_wave_speed(SOIL)), duration=1.0)


def test_symbolic_scene_has_the_force_and_its_derivatives():
    # Second derivatives are tested in tests/elastic.
    speed, slope = ca.MX.sym("speed"), ca.MX.sym("slope")
    run = po.simulate(scene(share=po.Cone(ca.atan(slope), 0.25), tow_speed=speed), duration=1.0, outputs=3)
    gradient = ca.gradient(run.mean_draft, ca.vertcat(speed, slope))
    value, first = ca.Function("f", [speed, slope], [run.mean_draft, gradient])(20.0, 0.2)

    def force(v, t):
        return elastic.cone_force(po.Cone(math.atan(t), 0.25), SOIL, v)

    step = 1e-3
    assert float(value) == pytest.approx(force(20.0, 0.2), rel=1e-13)
    slopes = [(force(20 + 20 * step, 0.2) - force(20 - 20 * step, 0.2)) / (40 * step),
              (force(20, 0.2 + step) - force(20, 0.2 - step)) / (2 * step)]  # fmt: skip
    # Central differences with relative steps of 1e-3.
    np.testing.assert_allclose(first.full().ravel(), slopes, rtol=1e-4)


@pytest.mark.slow
def test_a_design_keeps_below_the_shear_wave():
    design = po.Design()
    speed = design.variable("speed", guess="20 m/s", lower="1 m/s", upper="80 m/s")
    draft = po.simulate(scene(tow_speed=speed), 1.0, outputs=4).mean_draft
    design.minimise(draft / 1e4)
    best = design.solve(search="local")
    assert best.margins["elastic medium: speed over shear wave speed"] == pytest.approx(
        0.9999 - best.variables["speed"] / elastic.shear_wave_speed(SOIL), rel=1e-9
    )
    assert best.objective == pytest.approx(po.simulate(scene(tow_speed=1.0), 1.0).mean_draft / 1e4, rel=1e-7)


def test_a_saved_run_has_no_specific_draft():
    assert json.loads(po.simulate(scene(), 1.0).to_json())["specific_draft"] is None
