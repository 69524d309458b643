"""Scenes: what they are made of, their warnings, and the elastic medium."""

import dataclasses
import json
import math

import casadi as ca
import numpy as np
import pytest
from helpers.differences import differences
from helpers.scenes import SEROZEM, SHARE, scene_of

import plough_opt as po
from plough_opt.soil import elastic

# --- properties ---


def test_reaction_omits_effects_that_are_off(r1_scene):
    full = po.soil_reaction(r1_scene().cone, r1_scene().soil)
    dry = po.soil_reaction(r1_scene().cone, dataclasses.replace(r1_scene().soil, ambient_pressure=0.0))
    assert r1_scene().reaction == full
    assert r1_scene(inertial_drag=False).reaction == dataclasses.replace(full, drag=0.0)
    assert r1_scene(added_mass=False).reaction == dataclasses.replace(full, added_mass=0.0)
    assert r1_scene(ambient_pressure=False).reaction == dry
    assert dry.static < full.static


def test_scales_of_a_scene(r1_scene):
    scene = r1_scene(strength_wave=po.StrengthWave(0.3, 0.6), rate_term=0.05)
    static, drag, added = scene.reaction.static, scene.reaction.drag, scene.reaction.added_mass
    assert scene.inertia == scene.mass + added
    assert scene.natural_frequency == pytest.approx(math.sqrt(5e4 / (scene.mass + added)), rel=1e-15)
    assert scene.wave_frequency == pytest.approx(2 * math.pi * 2.0 / 0.6, rel=1e-15)
    assert scene.steady_resistance == pytest.approx(static * (1 + 0.05 * 4.0) + drag * 4.0, rel=1e-15)
    assert (scene.branch, r1_scene().branch) == ("stiff", "")
    assert r1_scene().wave_frequency == 0.0
    assert r1_scene(added_mass=False).inertia == scene.mass


# --- warnings ---


@pytest.mark.parametrize("name", po.soil_names())
@pytest.mark.parametrize(("pressure", "advised"), [(101325.0, True), (8e3, False)])
def test_ambient_share_is_the_part_of_the_pressure(r1_scene, name, pressure, advised):
    # It does not depend on the share: A is proportional to nu p_a + tau0/(1 + mu), equation (26).
    soil = dataclasses.replace(po.named_soil(name), ambient_pressure=pressure)
    mu = math.sin(soil.friction_angle)
    ambient, own = 2 * mu * pressure, 2 * soil.cohesion * math.cos(soil.friction_angle)
    share = ambient / (ambient + own)
    for scene in (r1_scene(soil=soil), r1_scene(12.0, 0.4, soil=soil)):
        assert scene.ambient_share == pytest.approx(share, rel=1e-13)
    (warning,) = r1_scene(soil=soil).warnings()
    assert f"({pressure / 1e3:.4g} kPa) carries {100 * share:.0f} % of the static draft" in warning
    assert ("set soil.ambient_pressure" in warning) == advised


def test_without_ambient_pressure_there_is_no_share_and_no_warning(r1_scene, r1_soil):
    soils = [dataclasses.replace(r1_soil, ambient_pressure=0.0, cohesion=cohesion) for cohesion in (15e3, 0.0)]
    for scene in (r1_scene(ambient_pressure=False), *(r1_scene(soil=soil) for soil in soils)):
        assert scene.ambient_share == 0.0
        assert scene.warnings() == ()


@pytest.mark.parametrize(("half_angle", "warned"), [(15.0, False), (19.99, False), (20.01, True), (35.0, True)])
def test_a_blunt_share_carries_a_warning(r1_scene, half_angle, warned):
    scene = dataclasses.replace(r1_scene(ambient_pressure=False), share=po.Cone(po.deg(half_angle), 0.25))
    found = scene.warnings()
    assert bool(found) == warned
    assert not warned or (f"half angle is {half_angle:.1f} deg" in found[0] and "plane sections" in found[0])


def test_the_speed_term_is_as_small_as_the_readme_says():
    """The percentages of the draft hold for the best share of the cotton problem in all named soils."""
    cone = po.Wedge(po.deg(39.1), po.deg(15), 0.254).equivalent_cone()
    for speed, low, high in ((1.0, 0.15, 0.35), (2.0, 0.65, 1.35), (3.0, 1.5, 3.0)):
        for name in po.soil_names():
            soil = po.named_soil(name)
            part = 1.0 - po.resistance(cone, soil, 0.0, 0.0) / po.resistance(cone, soil, speed, 0.0)
            assert low < 100.0 * float(part) < high, (name, speed)


# --- the elastic medium: the steady contact force, and what it lacks beside the plastic gas ---


def scene(medium="elastic", **changes):
    return scene_of(**{"medium": medium, "stiffness": 5e5, "motion": False} | changes)


@pytest.mark.parametrize("share", [SHARE, SHARE.equivalent_cone()], ids=["wedge", "cone"])
def test_draft_is_the_contact_force_on_the_equivalent_cone(share):
    force = elastic.cone_force(SHARE.equivalent_cone(), SEROZEM, 2.0)
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
    assert not any("order of magnitude" in warning for warning in scene("plastic").warnings())
    # The soil presses on the whole cone, so contact is never lost and the force above ambient pressure stays.
    assert scene(ambient_pressure=False).steady_resistance == pytest.approx(own.steady_resistance, rel=1e-14)
    run = po.simulate(own, duration=1.0)
    for loosened in (lambda: run.specific_draft, lambda: own.loosened_radius):
        with pytest.raises(po.InputError, match="no compaction front"):
            loosened()
    assert json.loads(run.to_json())["specific_draft"] is None


@pytest.mark.slow
def test_symbolic_scene_has_the_derivatives_of_its_draft():
    # Second derivatives are tested in tests/elastic.
    def draft(speed, angle):
        run = po.simulate(scene(share=po.Cone(angle, 0.25), tow_speed=speed), duration=1.0, outputs=3)
        return run.mean_draft

    x, at = ca.MX.sym("x", 2), np.array([20.0, 0.2])
    gradient = ca.Function("f", [x], [ca.gradient(draft(*ca.vertsplit(x)), x)])(at).full().ravel()
    slopes = differences(lambda y: draft(*(at * (1.0 + y)).tolist()), np.zeros(2), 1e-3)
    # Rounding over the relative step.
    np.testing.assert_allclose(gradient * at, slopes.ravel(), rtol=1e-10)
