"""Scenes under any law of resistance: motion, drafts, batches, designs and problem files."""

import dataclasses
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from helpers import three_modes

import plough_opt as po
from plough_opt.core.checks import check_domain
from plough_opt.laws import (
    AsabeD497,
    McKyesAli,
    ResistanceLaw,
    SphericalCavity,
    SwickPerumpral,
    Tine,
    UniversalEarthmoving,
)
from plough_opt.studies.crosscheck import (
    asabe_draft,
    godwin_draft,
    mckyes_ali_draft,
    spherical_cavity_draft,
    swick_perumpral_draft,
)

SOIL = po.named_soil("serozem")
SHARE = po.Wedge(po.deg(30), po.deg(35), 0.25)
TINE = Tine(0.1, 0.25, po.deg(35), 500.0, 300.0)
LOADS = {"surcharge": 500.0, "adhesion": 300.0}
WAVY = po.Effects(strength_wave=po.StrengthWave(0.3, 0.2), damping=400.0)

DRAFTS = {
    McKyesAli(width=0.1, **LOADS): lambda v: mckyes_ali_draft(SOIL, TINE, v),
    UniversalEarthmoving(width=0.1, **LOADS): lambda v: godwin_draft(SOIL, TINE, v),
    AsabeD497("fine", "winged", 2.0): lambda v: asabe_draft(0.25, v, "fine", point="winged", shanks=2.0),
    SphericalCavity(): lambda v: spherical_cavity_draft(SHARE.equivalent_cone(), SOIL, v),
}


def scene(law, **changes):
    given = {"soil": SOIL, "share": SHARE, "stiffness": 5e5, "mass": 40.0, "tow_speed": 2.0, "effects": WAVY}
    return po.Scene(**given | changes, medium=law)


@pytest.mark.parametrize("law", DRAFTS, ids=lambda law: law.label)
def test_motion_is_that_of_an_independent_integrator(law):
    three_modes.agreed(scene(law), 0.6)


@pytest.mark.parametrize("law", DRAFTS, ids=lambda law: law.label)
def test_steady_resistance_is_the_draft_of_the_formula(law):
    for speed in (0.0, 1.0, 3.0):
        # The law splits the formula into a static part and one with the squared speed.
        assert scene(law, tow_speed=speed).steady_resistance == pytest.approx(DRAFTS[law](speed), rel=1e-14)


def test_law_of_steady_sliding_gives_its_draft_and_no_motion():
    law = SwickPerumpral(width=0.1)
    steady = po.simulate(scene(law, effects=po.Effects(motion=False)), 1.0)
    tine = Tine(0.1, 0.25, po.deg(35))
    assert steady.mean_draft == pytest.approx(swick_perumpral_draft(SOIL, tine, 2.0), rel=1e-14)
    for effects in (po.Effects(), po.Effects(motion=False, strength_wave=WAVY.strength_wave)):
        with pytest.raises(po.InputError, match="no meaning in Swick-Perumpral, which gives the force of steady"):
            scene(law, effects=effects)


def test_effects_that_a_law_lacks_are_refused_or_omitted_with_a_warning():
    own = scene(McKyesAli(width=0.1))
    run = po.simulate(own, 0.2)
    assert own.inertia == own.mass
    assert any("does not include soil that moves with the share" in text for text in run.warnings)
    for value in (lambda: run.specific_draft, lambda: own.loosened_radius, lambda: own.carried_soil):
        with pytest.raises(po.InputError, match="has no meaning in McKyes-Ali, which"):
            value()
    assert own.ambient_share == 0.0
    with pytest.raises(po.InputError, match="how the resistance grows while the share enters"):
        scene(McKyesAli(width=0.1), effects=po.Effects(entry=True, start="towed"))
    with pytest.raises(po.InputError, match="is one of the plastic gas"):
        scene(McKyesAli(), effects=po.Effects(formulation="printed"))


@pytest.mark.parametrize("law", [McKyesAli, 3, None, object()], ids=["class", "number", "none", "object"])
def test_a_medium_of_the_wrong_type_is_refused(law):
    with pytest.raises(po.InputError, match="must be a ResistanceLaw, such as McKyesAli"):
        scene(law)


def test_plastic_gas_by_name_and_as_a_law_are_the_same():
    by_name, as_law = (po.simulate(scene(medium), 0.5) for medium in ("plastic", po.laws.PlasticGas()))
    assert by_name.mean_draft == as_law.mean_draft
    np.testing.assert_array_equal(by_name.mount_force, as_law.mount_force)


def symbolic(x):
    """Return a run of McKyes and Ali's law whose rake angle, depth and stiffness vary."""
    rake, depth, stiffness = x
    law = McKyesAli(width=0.1, rake_angle=rake, depth=depth)
    return po.simulate(scene(law, stiffness=stiffness), 0.5)


AT = np.array([po.deg(42.0), 0.27, 4e5])


def test_batch_agrees_with_single_runs():
    x = [ca.MX.sym(name) for name in ("rake", "depth", "stiffness")]
    law = McKyesAli(width=0.1, rake_angle=x[0], depth=x[1])
    values = np.array([AT, AT * [1.1, 0.9, 1.5]])
    found = po.Batch(scene(law, stiffness=x[2]), 0.5, x)(values)
    singles = [symbolic(row.tolist()).mean_draft for row in values]
    # The relative error of a batch is 1e-8 of mean draft or RMS.
    np.testing.assert_allclose(found.mean_draft, singles, rtol=2e-8)


def test_bounds_beyond_the_law_are_refused_by_the_design():
    design = po.Design()
    speed = design.variable("speed", guess=2.0, lower=1.0, upper=6.0, unit="m/s")
    design.minimise(po.simulate(scene(McKyesAli(width=0.1), tow_speed=speed), 0.5).mean_draft)
    with pytest.raises(po.DomainError, match=r"upper bound of 'speed'.*draft grows more slowly than the square"):
        design.solve()


def read(medium):
    """Return a problem with a medium, without requirements that only the plastic gas meets."""
    path = Path(__file__).parents[2] / "problems" / "cotton_subsoiler.toml"
    return po.read_problem(path, ["require={}", f"scene.medium={medium}"])


def test_problem_file_names_a_law_with_its_own_quantities():
    own = read("{law='mckyes_ali', width='10 cm', depth='30 cm', rake_angle='35 deg'}").scene()
    assert own.law == McKyesAli(width=0.1, depth=0.3, rake_angle=po.deg(35))
    tine = Tine(0.1, 0.3, po.deg(35))
    assert own.steady_resistance == pytest.approx(mckyes_ali_draft(SOIL, tine, 2.0), rel=1e-14)


@pytest.mark.parametrize(
    ("medium", "message"),
    [
        ("{law='mckyes'}", "no resistance law is named 'mckyes'.*mckyes_ali"),
        ("{law='mckyes_ali', dept='30 cm'}", "'dept' is not a quantity of McKyesAli.*depth"),
        ("{law='mckyes_ali', depth='30 kg'}", "'depth' = \"30 kg\" has the wrong unit"),
        ("3", "must be a resistance law, such as"),
    ],
)
def test_problem_file_refuses_anything_else(medium, message):
    with pytest.raises(po.InputError, match=message):
        read(medium)


def limited(largest):
    """Return a new class of the same name, as a notebook does when a cell is run again."""

    @dataclasses.dataclass(frozen=True)
    class Limited(ResistanceLaw):
        newtons: object
        label = "a law with a domain"

        def reaction(self, at):
            del at
            check_domain("force", self.newtons, "N", at_most=largest)
            return po.SoilReaction(static=self.newtons)

    return Limited


def test_a_redefined_class_is_another_law():
    def solve(kind):
        design = po.Design()
        force = design.variable("force", guess=2e3, lower=1e3, upper=5e3, unit="N")
        design.minimise(po.simulate(scene(kind(force)), 0.2).mean_draft)
        return design.solve()

    assert solve(limited(1e9)).variables["force"] == pytest.approx(1e3)
    with pytest.raises(po.DomainError, match=r"upper bound of 'force'.*force = 5000 N"):
        solve(limited(4e3))
