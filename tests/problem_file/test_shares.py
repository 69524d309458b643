"""Several shares in a problem file, against designs of several scenes written in Python and against one share alone."""

import dataclasses
import json
import re

import pytest
from helpers.commands import printed
from helpers.problem_files import STATIC, changed

import plough_opt as po

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


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[shares.rear]", "[shares.scene]", "line 22: 'scene' cannot be the name of a share"),
        ("soil.cohesion =", "soill.cohesion =", "line 23: 'soill' is not a table of a share: did you mean 'soil'"),
        ("soil.cohesion =", "soil.cohesio =", "line 23: 'soil.cohesio' is not a known key: did you mean 'cohesion'"),
        ("soil.cohesion =", "scene.tow_speed =", "line 23: 'scene.tow_speed' belongs to the frame"),
        ("soil.cohesion =", "accuracy.error =", "line 23: 'accuracy' cannot differ between shares"),
        ('upper = "0.45 m"', 'upper = "0.05 m"', "line 25: the bounds of 'share.height' contradict each other"),
        ("[shares.front]", "[uncertain]\n[shares.front]", "a design for an uncertain soil can have only one share"),
        (TWO[TWO.index("[shares") :], "[[shares]]", "'shares' must hold a table for each share"),
    ],
)
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
