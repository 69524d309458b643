"""Several shares in a problem file, against designs of several scenes written in Python and against one share alone."""

import json
import re

import numpy as np
import pytest

import plough_opt as po
from plough_opt.app import main

FRAME = """
title = "A frame"
[soil]
name = "serozem"
[share]
wedge_angle = "35 deg"
chisel_angle = "15 deg"
[scene]
tow_speed = "2 m/s"
frame_mass = "20 kg"
duration = "0.5 s"
stiffness = "60 kN/m"
[effects]
motion = false
[variables]
"share.height" = { lower = "0.1 m", upper = "0.5 m", guess = "0.25 m" }
[minimise]
mean_draft = { per = "1 kN" }
[require]
loosened_radius = { at_least = "0.12 m" }
"""
TWO = f"""{FRAME}
[shares.front]
[shares.rear]
soil.cohesion = "30 kPa"
share.wedge_angle = "30 deg"
variables.share.height = {{ upper = "0.45 m" }}
require.loosened_radius = {{ at_least = "0.15 m" }}
"""
MOVING = TWO.replace(
    "motion = false", 'damping = "400 N*s/m"\nstrength_wave = { amplitude = 0.3, wavelength = "0.2 m" }'
)


def scene_of(height, *, angle=35.0, cohesion=None):
    """Return the scene that `TWO` describes, built without a problem file."""
    soil = po.named_soil("serozem")
    if cohesion is not None:
        names = ("density", "density_ratio", "friction_angle", "tool_friction", "ambient_pressure")
        soil = po.Soil(**{name: getattr(soil, name) for name in names}, cohesion=cohesion)
    share = po.Wedge(po.deg(angle), po.deg(15.0), height)
    mass = 20.0 + share.equivalent_cone().solid_mass(7850.0)
    return po.Scene(soil, share, 60e3, mass, 2.0, po.Effects(motion=False))


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
    assert best.variables == pytest.approx(
        {"share.height": own.variables["front"], "rear.share.height": own.variables["rear"]}, rel=1e-8
    )
    assert machine.mean_draft == pytest.approx(sum(own(po.simulate(scene, 0.5)).mean_draft for scene in scenes), 1e-8)
    assert {one.name for one in best.limits if one.kind == "requirement"} == {
        "front.loosened_radius", "rear.loosened_radius",
    }  # fmt: skip


def test_what_is_chosen_above_is_one_value_for_all_shares(read):
    """Two shares alike need what one needs: twice the draft, at the same height."""
    alone, _ = read(FRAME).optimise(search="near")
    both, machine = read(f"{FRAME}\n[shares.left]\n[shares.right]\n").optimise(search="near")
    assert both.variables == pytest.approx(alone.variables, rel=1e-8)
    assert both.objective == pytest.approx(2.0 * alone.objective, rel=1e-8)
    assert machine.tow_power == pytest.approx(2.0 * alone.run.tow_power, rel=1e-8)


def test_drafts_are_limited_together_and_all_else_for_each_share(read):
    best, machine = read(TWO).optimise(search="near")
    # The radii need this draft of both shares together, and less is not to be had.
    least = float(machine.mean_draft) / 1e3
    with pytest.raises(po.InfeasibleDesign, match="mean_draft"):
        read(TWO, f"require.mean_draft.at_most={0.99 * least} kN").optimise(search="near")
    loose, _ = read(TWO, f"require.mean_draft.at_most={1.01 * least} kN").optimise(search="near")
    limits = {one.name: one.value for one in loose.limits}
    assert limits["mean_draft"] == pytest.approx(machine.mean_draft, rel=1e-8)
    assert best.margins["rear.loosened_radius"] == pytest.approx(0.0, abs=1e-8)


def test_a_value_takes_the_place_of_a_variable_above_and_the_other_way_round(read):
    problem = read(f'{FRAME}\n[shares.a]\nshare.height = "0.3 m"\n[shares.b]\n')
    assert set(problem.variables) == {"share.height"}
    assert problem.fixed["a.share.height"] == 0.3
    runs = problem.machine().runs
    assert [runs[name].scene.share.height for name in "ab"] == [0.3, 0.25]
    assert problem.machine({"share.height": 0.2}).runs["a"].scene.share.height == 0.3
    problem = read(f'{FRAME}\n[shares.a]\nvariables."scene.stiffness" = {{ lower = "9 kN/m", upper = "90 kN/m" }}')
    assert set(problem.variables) == {"share.height", "a.scene.stiffness"}
    assert problem.shares["a"].values()["scene.stiffness"] == pytest.approx(49.5e3)


def test_changes_reach_one_share_or_all(read):
    change = (
        'shares.rear.soil.cohesion="12 kPa"',
        'scene.tow_speed="3 m/s"',
        'shares.front.variables.share.height.upper="0.4 m"',
    )
    problem = read(TWO, *change)
    scenes = {name: part.scene() for name, part in problem.shares.items()}
    assert [scene.tow_speed for scene in scenes.values()] == [3.0, 3.0]
    assert scenes["rear"].soil.cohesion == 12e3 != scenes["front"].soil.cohesion
    assert problem.variables["front.share.height"].upper == 0.4
    fixed = read(TWO, 'shares.rear.share.height="0.2 m"')
    assert set(fixed.variables) == {"share.height"}
    assert "is now fixed at 0.2 m" in " ".join(fixed.notes).replace('"', "")
    assert fixed.shares["rear"].scene().share.height == 0.2


def test_one_share_can_be_chosen(read):
    problem = read(TWO, "shares=rear", 'soil.cohesion="31 kPa"')
    assert not problem.shares
    assert problem.scene().soil.cohesion == 31e3
    assert problem.table.require["loosened_radius"].at_least == "0.15 m"
    machine = read(TWO)
    with pytest.raises(po.InputError, match=r"several shares, front, rear.*--set shares=front.*problem\.shares"):
        machine.scene()
    again = read(TWO, *machine.shares["rear"].origin.overrides)
    assert again.scene() == machine.shares["rear"].scene()
    assert machine.shares["rear"].simulate().mean_draft == machine.machine().runs["rear"].mean_draft


def test_sensitivities_tell_shares_apart(read):
    best, _ = read(TWO).optimise(search="near", parameters=True)
    # The soil above is that of the front share alone, for the rear one has its own.
    front, rear = (best.sensitivity(name, check=True) for name in ("soil.cohesion", "rear.soil.cohesion"))
    assert max(front.difference, rear.difference) < 1e-4  # central differences of two solves
    assert best.sensitivity("scene.tow_speed").objective > 0.0  # one speed for both
    alone, _ = read(TWO, "shares=front").optimise(search="near", parameters=True)
    assert front.objective == pytest.approx(alone.sensitivity("soil.cohesion").objective, rel=1e-6)


def test_a_front_trades_sums_over_the_shares(read):
    traded = f"{TWO}\n[trade_off]\nmean_draft = {{}}\nloosened_radius = {{ maximise = true }}\npoints = 5\n"
    front = read(traded).trade_off()
    best, _ = read(TWO).optimise(search="near")
    assert min(front.to_dataframe()["mean_draft"]) == pytest.approx(1e3 * best.objective, rel=1e-6)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[shares.rear]", "[shares.scene]", "line 23: 'scene' cannot be the name of a share"),
        ("soil.cohesion =", "soil.cohesio =", "line 24: 'soil.cohesio' is not a known key: did you mean 'cohesion'"),
        ("soil.cohesion =", "scene.tow_speed =", "line 24: 'scene.tow_speed' belongs to the frame"),
        ("soil.cohesion =", "accuracy.error =", "line 24: 'accuracy' cannot differ between shares"),
        ('upper = "0.45 m"', 'upper = "0.05 m"', "line 26: the bounds of 'share.height' contradict each other"),
        ("[shares.front]", "[uncertain]\n[shares.front]", "a design for an uncertain soil can have only one share"),
        (FRAME, "shares = 3\n", "'shares' must hold a table for each share"),
    ],
)
def test_a_mistake_is_named_with_its_line(read, old, new, said):
    assert old in TWO
    text = TWO.replace(old, new, 1)
    text = f"shares = 3\n{FRAME}" if old == FRAME else text
    with pytest.raises(po.InputError, match=re.escape(said)):
        read(text)


def test_an_unknown_share_is_refused(read):
    with pytest.raises(po.InputError, match="did you mean 'rear'"):
        read(TWO, "shares=reer")
    with pytest.raises(po.InputError, match="did you mean 'rear'"):
        read(TWO, "shares.reer.soil.cohesion=3 kPa")
    with pytest.raises(po.InputError, match="no share is named"):
        read(FRAME, "shares=rear")


def test_the_commands_show_them_side_by_side(tmp_path, capsys):
    path, picture = tmp_path / "frame.toml", tmp_path / "frame.svg"
    path.write_text(MOVING, encoding="utf-8")
    assert main(["check", str(path)]) == 0
    shown = capsys.readouterr().out
    assert "Scene of the share 'rear'" in shown
    assert "designed as one machine" in shown
    assert main(["simulate", str(path), "--plot", str(picture)]) == 0
    shown = capsys.readouterr().out
    assert re.search(r"front\s+┃\s+rear\s+┃\s+together", shown)
    assert picture.stat().st_size > 0
    assert main(["check", str(path), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["quantities"]["rear.soil.cohesion"] == 30e3
    assert "soil.cohesion" not in found["quantities"]
    for words in (
        ("export", "--to", "c", "--output", tmp_path / "share.c"),
        ("sweep", "--over", "soil.cohesion=5..45 kPa:2"),
        ("report", "-o", tmp_path / "share.html"),
        ("accuracy",),
    ):
        assert main([words[0], str(path), *map(str, words[1:])]) == 2
        assert "--set shares=front" in capsys.readouterr().err


def test_a_machine_adds_up_what_adds_up(read):
    machine = read(MOVING).machine()
    rows = {label: cells for label, *cells in machine.response().rows}
    own = [run.mean_draft for run in machine.runs.values()]
    drafts = [float(cell.split()[0]) for cell in rows["mean draft"]]
    assert drafts == pytest.approx([*np.array(own) / 1e3, sum(own) / 1e3], rel=1e-4)  # five digits are printed
    # Oscillations, deflections, radii and angles do not add up.
    assert {label for label, cells in rows.items() if cells[-1]} == {"mean draft", "tow power"}
    frame = machine.to_dataframe()
    assert len(frame) == sum(len(run.time) for run in machine.runs.values())
    assert list(dict.fromkeys(frame["share"])) == ["front", "rear"]
