"""Scenes under any law of resistance: motion, drafts, batches, designs, problem files, and the same domain in all."""

import dataclasses
import pickle

import casadi as ca
import numpy as np
import pytest
from helpers import three_modes
from helpers.problem_files import SUBSOILER
from helpers.scenes import SEROZEM, scene_of
from scipy.optimize import minimize_scalar

import plough_opt as po
from plough_opt import crosscheck
from plough_opt.core.checks import check_domain
from plough_opt.expressions import exp
from plough_opt.laws import LAWS, AsabeD497, McKyesAli, SphericalCavity, SwickPerumpral, Tine, UniversalEarthmoving

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


def read(medium):
    """Return a problem with a medium, without requirements that only the plastic gas meets."""
    return po.read_problem(SUBSOILER, ["require={}", f"scene.medium={medium}"])


def test_problem_file_names_a_law_with_its_own_quantities():
    own = read("{law='mckyes_ali', width='10 cm', depth='30 cm', rake_angle='35 deg'}").scene()
    assert own.law == McKyesAli(width=0.1, depth=0.3, rake_angle=po.deg(35))


WRONG_MEDIA = [
    ("{law='mckyes'}", "no resistance law is named 'mckyes'.*mckyes_ali"),
    ("{law='mckyes_ali', dept='30 cm'}", "'dept' is not a quantity of McKyesAli.*depth"),
    ("{law='mckyes_ali', depth='30 kg'}", "'depth' = \"30 kg\" has the wrong unit"),
    ("3", "must be a resistance law, such as"),
]


@pytest.mark.parametrize(("medium", "message"), WRONG_MEDIA)
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


SEED, COUNT = 1977, 24
# Name of an input, its unit, and the range of random values.
RANGES = {
    "wedge": ("rad", po.deg(5.0), po.deg(60.0)),
    "chisel": ("rad", po.deg(10.0), po.deg(89.0)),
    "height": ("m", -0.05, 0.5),
    "speed": ("m/s", 0.5, 6.0),
    "modulus": ("Pa", 1e5, 3e6),
}


def drawn_scene(law, wedge, chisel, height, speed, modulus, *, motion):
    soil = dataclasses.replace(SEROZEM, youngs_modulus=modulus)
    wavy = {"strength_wave": po.StrengthWave(0.3, 0.2), "damping": 400.0} if motion else {}
    return scene_of(soil, po.Wedge(wedge, chisel, height), 5e5, 40.0, speed, law, motion=motion, **wavy)


def rows():
    rng = np.random.default_rng(SEED)
    lower, upper = np.array([ends[1:] for ends in RANGES.values()]).T
    values = lower + (upper - lower) * rng.random((COUNT, len(RANGES)))
    values[:, -1] = np.exp(rng.uniform(*np.log([lower[-1], upper[-1]]), COUNT))
    return values


def outcome(evaluate):
    """Return a draft [N], or the message of a refusal."""
    try:
        return evaluate()
    except po.PloughError as error:
        return str(error)


def by_component(law, row):
    inputs = [
        po.Input(
            name, symbol=ca.MX.sym(name), unit=unit, lower=value - 1e-9 * abs(value), upper=value + 1e-9 * abs(value)
        )
        for (name, (unit, *_)), value in zip(RANGES.items(), row, strict=True)
    ]
    symbols = [one.symbol for one in inputs]
    made = po.component(drawn_scene(law, *symbols, motion=False), 0.1, inputs=inputs, outputs=["mean_draft"])
    return made(*row)


def by_design(law, row):
    design = po.Design()
    symbols = [
        design.variable(name, guess=v, lower=v - 1e-9 * abs(v), upper=v + 1e-9 * abs(v), unit=unit)
        for (name, (unit, *_)), v in zip(RANGES.items(), row.tolist(), strict=True)
    ]
    design.minimise(po.simulate(drawn_scene(law, *symbols, motion=False), 0.1).mean_draft / 1e3)
    return 1e3 * design.solve(search="near", judge="bare").objective


# The graph of the elastic medium takes seconds to build.
CASES = [pytest.param(law, 2, marks=[pytest.mark.slow] * (law == "elastic")) for law in LAWS]
CASES += [pytest.param(law, COUNT, marks=pytest.mark.slow) for law in LAWS if law != "elastic"]


@pytest.mark.parametrize(("law", "count"), CASES)
def test_all_refuse_the_same_designs_for_the_same_reason(law, count):
    every, symbols = rows()[:count], [ca.MX.sym(name) for name in RANGES]
    steady = LAWS[law].lacking.get("motion")
    batch = None if steady else po.Batch(drawn_scene(law, *symbols, motion=True), 0.1, symbols)(every)
    refused = 0
    for k, row in enumerate(every):
        single = outcome(lambda row=row: po.simulate(drawn_scene(law, *row.tolist(), motion=False), 0.1).mean_draft)
        others = [outcome(lambda row=row: by_component(law, row)), outcome(lambda row=row: by_design(law, row))]
        if isinstance(single, str):
            refused += 1
            noun = single.split(" = ")[0]
            assert all(isinstance(other, str) and noun in other for other in others), (noun, others)
            if batch is not None:
                assert noun in batch.reasons[k]
        else:
            # The component's and the design's boxes extend by 1e-9 of each value.
            assert others == pytest.approx([single, single], rel=1e-7)
            if batch is not None:
                moving = po.simulate(drawn_scene(law, *row.tolist(), motion=True), 0.1).mean_draft
                assert batch.mean_draft[k] == pytest.approx(moving, rel=1e-5)
    assert 0 < refused < count or count < COUNT


def test_a_component_refuses_a_call_outside_the_domain_between_its_bounds():
    """The tine is too narrow for its depth near s = 0.31 only."""
    s = ca.MX.sym("s")
    law = UniversalEarthmoving(width=0.05 - 0.03 * exp(-(((s - 0.31) / 0.01) ** 2)), depth=0.2, rake_angle=0.6)
    given = [po.Input("s", symbol=s, lower=-1.0, upper=1.0)]
    made = po.component(scene_of(medium=law, motion=False), 1.0, inputs=given, outputs=["mean_draft"])
    for component in (made, pickle.loads(pickle.dumps(made))):
        assert component(0.2) > 0.0
        with pytest.raises(po.DomainError, match="depth over width = 10 must be at most 6"):
            component(0.31)


@pytest.mark.parametrize("motion", [False, True])
def test_an_optimum_at_the_edge_of_a_domain_is_exact_and_names_it(motion):
    """The least draft over wedge and chisel angles lies at six times the width, by the formula and brute force."""

    def of(wedge, chisel):
        return scene_of(share=po.Wedge(wedge, chisel, 0.25), medium="universal_earthmoving", motion=motion)

    design = po.Design()
    wedge = design.variable("wedge", guess=po.deg(30), lower=po.deg(10), upper=po.deg(50), unit="rad")
    chisel = design.variable("chisel", guess=po.deg(35), lower=po.deg(5), upper=po.deg(60), unit="rad")
    design.minimise(po.simulate(of(wedge, chisel), 0.2).mean_draft / 1e3)
    best = design.solve(judge="bare")
    assert best.status == "solved"
    assert best.active == ("the universal earthmoving equation: depth over width",)
    again = po.simulate(of(best.variables["wedge"], best.variables["chisel"]), 0.2)
    assert again.mean_draft / 1e3 == pytest.approx(best.objective, rel=1e-8)

    def draft(at):
        tine = Tine(0.25 / 6.0, 0.25, at)
        return crosscheck.godwin_draft(SEROZEM, tine, 2.0) / 1e3

    # At that width the chisel angle alone decides; for any such angle a wedge angle gives the width.
    brute = minimize_scalar(draft, bounds=(po.deg(5.0), po.deg(60.0)), method="bounded", options={"xatol": 1e-10})
    assert best.objective == pytest.approx(brute.fun, rel=1e-8)


def test_a_problem_file_whose_share_no_wedge_fits_names_law_and_ranges():
    problem = po.read_problem(SUBSOILER, ["require={}", "scene.medium=mckyes_ali"])
    with pytest.raises(po.InputError, match=r"share.height from 0.1 m to 0.5 m.*McKyes-Ali.*least force of a wedge"):
        problem.optimise()
