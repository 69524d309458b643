"""Scenes under any law of resistance: motion, drafts, batches, designs and problem files."""

import dataclasses
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from helpers import three_modes
from helpers.scenes import SEROZEM, scene_of

import plough_opt as po
from plough_opt import crosscheck
from plough_opt.core.checks import check_domain
from plough_opt.laws import AsabeD497, McKyesAli, SphericalCavity, SwickPerumpral, Tine, UniversalEarthmoving

SHARE = po.Wedge(po.deg(30), po.deg(35), 0.25)
TINE = Tine(0.1, 0.25, po.deg(35), 500.0, 300.0)
LOADS = {"surcharge": 500.0, "adhesion": 300.0}

DRAFTS = {
    McKyesAli(width=0.1, **LOADS): lambda v: crosscheck.mckyes_ali_draft(SEROZEM, TINE, v),
    UniversalEarthmoving(width=0.1, **LOADS): lambda v: crosscheck.godwin_draft(SEROZEM, TINE, v),
    AsabeD497("fine", "winged", 2.0): lambda v: crosscheck.asabe_draft(0.25, v, "fine", point="winged", shanks=2.0),
    SphericalCavity(): lambda v: crosscheck.spherical_cavity_draft(SHARE.equivalent_cone(), SEROZEM, v),
}


def scene(law, **changes):
    wavy = {"strength_wave": po.StrengthWave(0.3, 0.2), "damping": 400.0, "stiffness": 5e5, "mass": 40.0}
    return scene_of(share=SHARE, medium=law, **wavy | changes)


@pytest.mark.parametrize("law", DRAFTS, ids=lambda law: law.label)
def test_motion_and_steady_resistance_follow_from_the_drafts_formula(law):
    three_modes.agreed(scene(law), 0.6)
    for speed in (0.0, 1.0, 3.0):
        # The law splits the formula into a static part and one with the squared speed.
        assert scene(law, tow_speed=speed).steady_resistance == pytest.approx(DRAFTS[law](speed), rel=1e-14)


def test_law_of_steady_sliding_gives_its_draft():
    steady = po.simulate(scene_of(share=SHARE, medium=SwickPerumpral(width=0.1), motion=False), 1.0)
    draft = crosscheck.swick_perumpral_draft(SEROZEM, Tine(0.1, 0.25, po.deg(35)), 2.0)
    assert steady.mean_draft == pytest.approx(draft, rel=1e-14)


def test_what_a_law_lacks_is_omitted_with_a_warning_or_refused():
    own = scene(McKyesAli(width=0.1))
    run = po.simulate(own, 0.2)
    assert own.inertia == own.mass
    assert any("does not include soil that moves with the share" in text for text in run.warnings)
    for value in (lambda: run.specific_draft, lambda: own.loosened_radius, lambda: own.carried_soil):
        with pytest.raises(po.InputError, match="has no meaning in McKyes-Ali, which"):
            value()
    assert own.ambient_share == 0.0


def test_batch_agrees_with_single_runs():
    def of(rake, depth, stiffness):
        return scene(McKyesAli(width=0.1, rake_angle=rake, depth=depth), stiffness=stiffness)

    x = [ca.MX.sym(name) for name in ("rake", "depth", "stiffness")]
    values = np.array([[po.deg(42.0), 0.27, 4e5], [po.deg(46.0), 0.24, 6e5]])
    singles = [po.simulate(of(*row.tolist()), 0.5).mean_draft for row in values]
    # The relative error of a batch is 1e-8 of mean draft or RMS.
    np.testing.assert_allclose(po.Batch(of(*x), 0.5, x)(values).mean_draft, singles, rtol=2e-8)


def read(medium):
    """Return a problem with a medium, without requirements that only the plastic gas meets."""
    path = Path(__file__).parents[2] / "problems" / "cotton_subsoiler.toml"
    return po.read_problem(path, ["require={}", f"scene.medium={medium}"])


def test_problem_file_names_a_law_with_its_own_quantities():
    own = read("{law='mckyes_ali', width='10 cm', depth='30 cm', rake_angle='35 deg'}").scene()
    assert own.law == McKyesAli(width=0.1, depth=0.3, rake_angle=po.deg(35))


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
    class Limited(po.ResistanceLaw):
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
