"""The scripts of problems/: the paper's figures, the larger design, particles and measurements."""

import dataclasses
import math
import re
import shutil
from collections import Counter

import matplotlib.image
import numpy as np
import pytest
from helpers.linear_motion import oscillation
from helpers.problem_files import PROBLEMS
from helpers.scripts import imported
from scipy.optimize import minimize_scalar

import plough_opt as po

# --- the source's figures, and each claim of its Discussion against a closed form or a measured trend ---


RATIOS = (0.2, 0.4, 0.6, 0.8, 0.95)
STIFFNESSES = (50.0, 200.0, 500.0)


@pytest.fixture(scope="module")
def paper():
    with imported("paper_figures") as module:
        yield module


@pytest.fixture(scope="module")
def swings(paper):
    """Return the first oscillations on a mount, by the density ratios."""
    return lambda stiffness, ratios=RATIOS: [paper.swing(paper.run(ratio, stiffness)) for ratio in ratios]


def values(swings, name):
    return np.array([getattr(one, name) for one in swings])


def rises(values):
    return bool(np.all(np.diff(values) > 0.0))


# --- without drag: z = z_s + A sin(omega t - phi) in closed form ---


@pytest.mark.parametrize("stiffness", STIFFNESSES)
@pytest.mark.parametrize("ratio", RATIOS)
def test_an_oscillation_without_drag_is_the_closed_form(paper, ratio, stiffness):
    scene = paper.scene(ratio, stiffness, inertial_drag=False)
    found = paper.swing(po.simulate(scene, paper.DURATION, outputs=paper.OUTPUTS))
    inertia, steady = scene.inertia, scene.reaction.static / stiffness
    amplitude = math.sqrt(steady**2 + scene.tow_speed**2 * inertia / stiffness)
    # Turning points are interpolated over steps of 2 ms, at most 1/240 of a period.
    assert found.period == pytest.approx(2 * math.pi * math.sqrt(inertia / stiffness), rel=1e-5)
    assert (found.displacement, found.last) == pytest.approx((amplitude, amplitude), rel=1e-5)
    assert found.force == pytest.approx(stiffness * amplitude, rel=1e-5)
    assert found.peak_force == pytest.approx(stiffness * (steady + amplitude), rel=1e-5)
    assert found.compressed == pytest.approx(0.5 + math.asin(steady / amplitude) / math.pi, abs=1e-4)
    retreat = math.hypot(scene.tow_speed, scene.natural_frequency * steady) - scene.tow_speed
    assert found.retreat == pytest.approx(retreat, abs=1e-4)


# --- the claims of the Discussion ---


def test_frequency_grows_as_the_root_of_the_stiffness(swings):
    soft, middle, stiff = (values(swings(k), "period") for k in STIFFNESSES)
    # Drag lengthens the period in the second order of a damping ratio below 0.07.
    assert soft / middle == pytest.approx(2.0, rel=4e-3)
    assert soft / stiff == pytest.approx(math.sqrt(10.0), rel=4e-3)


@pytest.mark.parametrize("stiffness", STIFFNESSES)
def test_period_grows_with_the_density_ratio_by_less_than_a_percent(paper, swings, stiffness):
    periods = values(swings(stiffness), "period")
    assert rises(periods)
    by_mass = math.sqrt(paper.scene(RATIOS[-1], stiffness).inertia / paper.scene(RATIOS[0], stiffness).inertia) - 1
    assert by_mass == pytest.approx(0.0032, abs=5e-5)
    assert by_mass < periods[-1] / periods[0] - 1 < 0.007


def test_on_a_soft_spring_the_amplitude_falls_and_then_rises(swings):
    amplitudes = values(swings(50.0), "displacement")
    assert amplitudes == pytest.approx([0.466, 0.463, 0.458, 0.453, 0.460], abs=5e-4)
    turn = minimize_scalar(lambda b1: swings(50.0, [b1])[0].displacement, bounds=(0.6, 0.95), options={"xatol": 1e-3})
    assert turn.x == pytest.approx(0.867, abs=5e-3)


@pytest.mark.parametrize(("stiffness", "first", "last"), [(200.0, -0.038, -0.415), (500.0, -0.032, -0.427)])
def test_on_a_stiff_spring_the_amplitude_increases_only_beside_the_singularity(swings, stiffness, first, last):
    amplitudes, later = (values(swings(stiffness), name) for name in ("displacement", "last"))
    assert rises(-amplitudes)
    assert amplitudes[-1] / amplitudes[0] - 1 == pytest.approx(first, abs=5e-4)
    # Drag grows with b1 too, and separates the amplitudes after six oscillations.
    assert later[-1] / later[0] - 1 == pytest.approx(last, abs=2e-3)
    assert rises(values(swings(stiffness, (0.98, 0.995, 0.999)), "displacement"))


def test_force_amplitude_grows_and_displacement_amplitude_falls_with_the_stiffness(paper, swings):
    rows = [swings(k) for k in STIFFNESSES]
    force, displacement = (np.array([values(row, name) for row in rows]) for name in ("force", "displacement"))
    assert rises(force.T)
    assert rises(-displacement.T)
    # Without static load they are V0 sqrt(k0 M) and V0 sqrt(M/k0); F0 increases and drag reduces them by up to 10 %.
    scenes = [[paper.scene(ratio, k) for ratio in RATIOS] for k in STIFFNESSES]
    unloaded = [[scene.tow_speed * math.sqrt(scene.stiffness * scene.inertia) for scene in row] for row in scenes]
    np.testing.assert_allclose(force, unloaded, rtol=0.10)
    assert force[2] / force[0] == pytest.approx(math.sqrt(10.0), rel=0.06)
    assert displacement[2] / displacement[0] == pytest.approx(math.sqrt(0.1), rel=0.06)


@pytest.mark.parametrize("stiffness", STIFFNESSES)
def test_the_spring_is_compressed_longer_than_pulled_and_more_so_with_the_density_ratio(paper, swings, stiffness):
    own = swings(stiffness)
    assert own[0].compressed > 0.5
    assert rises(values(own, "compressed"))
    assert rises(values(own, "peak_force"))
    # F0 alone gives 1/2 + atan(F0/(V0 sqrt(k0 M)))/pi; drag has one sign and increases that.
    for one, ratio in zip(own, RATIOS, strict=True):
        scene = paper.scene(ratio, stiffness)
        ratio_of_forces = scene.reaction.static / (scene.tow_speed * math.sqrt(stiffness * scene.inertia))
        assert one.compressed > 0.5 + math.atan(ratio_of_forces) / math.pi


# --- printed and derived equation ---


def test_the_printed_share_runs_away_exponentially_and_with_drag_faster(paper):
    alone = paper.printed_run(formulation="printed", inertial_drag=False)
    scene, omega = alone.scene, alone.scene.natural_frequency
    exact, _ = oscillation(scene, paper.PRINTED_DURATION)
    assert alone.deflection[-1] == pytest.approx(exact, rel=1e-7)
    late = 30.0 / omega  # when the rest has decayed
    assert paper.runaway(scene) * math.exp(30.0) == pytest.approx(oscillation(scene, late)[0], rel=1e-12)
    whole, derived = paper.printed_run(formulation="printed"), paper.printed_run()
    assert whole.deflection[-1] > 1.5 * exact
    assert whole.travel[-1] < -13.0 < 1.4 < derived.travel[-1]


# --- the script ---


def test_the_script_writes_every_picture_and_the_table(paper, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    paper.main(["--folder", str(tmp_path / "figures")])
    names = [f"figure_{n}.png" for n in range(1, 8)] + ["printed.png"]
    assert sorted(path.name for path in (tmp_path / "figures").iterdir()) == sorted(names)
    for name in names:
        image = matplotlib.image.imread(tmp_path / "figures" / name)
        assert min(image.shape[:2]) > 400
        assert image[..., :3].std() > 0.05
    out = capsys.readouterr().out
    assert all(f"wrote {tmp_path / 'figures' / name}" in out for name in names)
    assert "does it follow?" in out
    assert "drives the share back: at up to 0.001, 0.004, 0.013, 0.051, 0.284 m/s" in out


# --- the larger design: parts against closed forms, a certified optimum, and no better design by brute force ---


@pytest.fixture(scope="module")
def frame():
    with imported("subsoiler_frame") as module, imported("subsoiler_frame_check") as module.checks:
        yield module


@pytest.fixture(scope="module")
def checks(frame):
    return frame.checks


@pytest.fixture(scope="module")
def solved(frame):
    d, c, m = frame.design()
    return c, m, d.solve(search="local")


def free(checks, best):
    return np.array([[best.variables[name]] for name in checks.FREE])


# --- parts ---


def test_moments_are_those_of_textbook_beams(frame):
    # A load P in the middle of a span 2b: sagging P b / 2. At a distance a outside a bracket: -P a at the bracket.
    assert frame.moments([0.0], [10.0], 2.0) == pytest.approx([-10.0, 0.0, 0.0])
    assert frame.moments([-3.0, 3.0], [10.0, 10.0], 2.0) == pytest.approx([0.0, 0.0, 10.0, 10.0])


def test_traction_by_hand(frame):
    # Bn = 50, slip 10 %: gross 0.88 (1 - e^-5) (1 - e^-0.75) + 0.04, resistance 0.02 + 0.04 + 0.05 / 7.07.
    weight = frame.TRACTOR * frame.GRAVITY
    gross, net = frame.traction(0.1, weight)
    assert gross / weight == pytest.approx(0.88 * 0.99326205 * 0.52763345 + 0.04, rel=1e-7)
    assert (gross - net) / weight == pytest.approx(0.06 + 0.05 / 50**0.5, rel=1e-12)


def test_the_motion_in_numpy_converges_to_the_orbit_with_order_4(frame, checks):
    scene = po.Scene(frame.soil(0.5), po.Cone(0.26, 0.35), 3e5, 80.0, 1.4, frame.EFFECTS)
    orbit = po.simulate(scene)
    errors = [abs(checks.settled_averages(scene, 12, steps).force_rms / orbit.force_rms - 1.0) for steps in (32, 64)]
    assert errors[1] < 5e-5
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.3)
    assert checks.settled_averages(scene, 12, 64).mean_draft == pytest.approx(orbit.mean_draft, rel=1e-6)


# --- the optimum ---


def test_the_optimum_is_certified(checks, solved):
    c, m, best = solved
    assert best.status == "solved"
    # The tolerances of the optimiser are 1e-10 in scaled values.
    assert checks.least_margin(m, best) > -1e-9
    assert checks.kkt_residual(c, m, best) < 1e-8
    assert max(best.gap, best.error_estimate) < 1e-8
    assert set(best.active) == {"half angle", "loosened overlap", "oscillation", "stress", "grip", "power"}


def test_numpy_alone_gives_the_same_fuel(checks, solved):
    _, m, best = solved
    found = checks.evaluate(free(checks, best), len(m.scenes))
    # By Runge-Kutta steps the error of mean drafts is 1e-7, and that of the active oscillation limit 3e-5.
    assert found.fuel[0] == pytest.approx(best(m.fuel), rel=1e-6)
    assert found.worst[0] < 5e-5
    for name in ("height", "tube", "slip"):
        assert getattr(found.variables, name)[0] == pytest.approx(best.variables[name], rel=5e-5)


def test_no_design_near_the_optimum_is_better(checks, solved):
    _, m, best = solved
    random = np.random.default_rng(3).uniform(-1.0, 1.0, (len(checks.FREE), 1500))
    # Designs at different distances; blunter shares violate the half angle.
    rows = free(checks, best) * (1.0 + random * np.geomspace(1e-3, 0.2, random.shape[1]))
    found = checks.evaluate(rows, len(m.scenes))
    excess = found.fuel[found.worst <= 1e-9] / best(m.fuel) - 1.0
    assert excess.size > 20
    # The error of 3e-5 in the oscillation changes the fuel by less than 1e-6.
    assert -1e-6 < excess.min() < 0.01


@pytest.mark.slow
def test_brute_force_finds_the_same_design(checks, solved):
    _, m, best = solved
    found, tried = checks.brute_force(len(m.scenes))
    assert tried > 10_000
    assert -1e-6 < found.fuel / best(m.fuel) - 1.0 < 1e-3
    assert found.variables["spacing"] == pytest.approx(best.variables["spacing"], rel=0.05)


# --- the command ---


@pytest.mark.slow
def test_the_scripts_print_certify_and_draw(frame, tmp_path, capsys):
    with imported("subsoiler_frame_picture") as picture:
        c, m, best = frame.solved()
        frame.checks.check(c, m, best)
        picture.draw(m, best, tmp_path / "frame.png")
    said = capsys.readouterr().out
    assert "MJ/ha" in said
    assert "no limit balances" in said
    assert matplotlib.image.imread(tmp_path / "frame.png").std() > 0.1


# --- the experiment among particles: its plan, tools and statistics, a small run in YADE, and the rows on file ---


PARTICLES = PROBLEMS / "particles"
MAIN = "half angle, equal height"


@pytest.fixture(scope="module")
def script():
    with imported("particles/run_plan") as module:
        yield module


def case(script, **changes):
    return script.Case(case="test", question="test", **changes)


# --- plan ---


def test_the_plan_has_every_run_once_and_three_packings_of_each_case(script):
    runs = script.plan()
    assert len({one.key for one in runs}) == len(runs) == len({(one.case, one.seed) for one in runs})
    packings = Counter(one.case for one in runs)
    assert {name for name, count in packings.items() if count != 3} == {"diameter-slender-0.01"}


def test_an_interrupted_plan_continues_where_it_ended(script, tmp_path, monkeypatch, capsys):
    runs = script.plan()[:30]
    failing, interrupted = runs[1], [runs[25]]
    done = []

    def pretended(one):
        if one in interrupted:
            interrupted.clear()
            raise KeyboardInterrupt
        if one == failing:
            raise RuntimeError("no result")
        done.append(one)
        return {**vars(one), "draft": 1.0 / 3.0}

    monkeypatch.setattr(script, "plan", lambda: runs)
    monkeypatch.setattr(script, "run", pretended)
    with pytest.raises(KeyboardInterrupt):
        script.main([], tmp_path)
    for _ in range(2):
        script.main([], tmp_path)
    assert done == [one for one in runs if one != failing]
    assert capsys.readouterr().out.count("FAILED: no result") == 3
    rows = [row for name in ("particles", "triaxial") for row in script.read_rows(tmp_path / f"{name}.csv")]
    assert {row["kind"] for row in rows} == {"cone", "triaxial"}
    assert Counter(map(script.key_of, rows)) == Counter(one.key for one in done)
    assert {row["draft"] for row in rows} == {"0.333333"}


# --- tools ---


def area(faces):
    corners = np.array(faces)
    return np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2.0


@pytest.mark.parametrize("angle", [10.0, 15.0, 20.0, 25.0])
def test_tools_of_one_half_angle_have_the_surface_of_the_cone(script, angle):
    radius = 0.1 * math.tan(math.radians(angle))
    surface = math.pi * radius * math.hypot(radius, 0.1)  # equation (6)
    for kind in ("wedge", "closed_share", "open_share"):
        tool = script.faces_of(case(script, kind=kind, half_angle=angle))
        assert area(tool["working"]) == pytest.approx(surface, rel=1e-12), kind
    cone = script.faces_of(case(script, half_angle=angle))
    # The pyramid that replaces the cone has its base area; its faces are a little flatter.
    assert area(cone["base"]) == pytest.approx(math.pi * radius**2, rel=1e-12)
    assert area(cone["working"]) == pytest.approx(surface, rel=0.015)


def test_closed_tools_leave_no_gap(script):
    for kind in ("cone", "wedge", "closed_share"):
        groups = script.faces_of(case(script, kind=kind)).values()
        triangles = [t for group in groups for t in group]
        edges = Counter(frozenset((t[i], t[i - 1])) for t in triangles for i in range(3))
        assert set(edges.values()) == {2}, kind


# --- statistics ---


@pytest.mark.parametrize("memory", [0.0, 0.6, 0.9])
def test_the_standard_error_of_a_first_order_process(script, memory):
    rng = np.random.default_rng(4)
    length, trials = 1000, 400
    noise = rng.standard_normal((trials, length + 200))
    series = np.zeros_like(noise)
    for i in range(1, noise.shape[1]):
        series[:, i] = memory * series[:, i - 1] + noise[:, i]
    series = series[:, 200:]
    # Var(mean) of x_i = memory x_(i-1) + e_i, exact for a finite length.
    lags = np.arange(1, length)
    spread = 1.0 + 2.0 * np.sum((1.0 - lags / length) * memory**lags)
    truth = math.sqrt(spread / (1.0 - memory**2) / length)
    errors = np.array([script.standard_error(one) for one in series])
    # 400 trials: a standard error of 4 % in what they scatter by, and of 1 to 2 % in the mean of their estimates.
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(truth, rel=0.08)
    assert series.mean(axis=1).std() == pytest.approx(truth, rel=0.12)


def test_the_displaced_zone_of_incompressible_soil(script):
    rng = np.random.default_rng(5)
    base, end = 0.02, 0.14
    before = rng.uniform(-end, end, (200_000, 3))
    radius = np.hypot(before[:, 1], before[:, 2])
    # Incompressible soil around a cylinder that has grown from nothing: y^2 = r^2 + R^2.
    moved = before * ((np.sqrt(radius**2 + base**2) - radius) / radius)[:, None]
    radii = script.zone_radii(before, moved, 0.0, base, 0.01, end)
    truth = [base * (1.0 - share**2) / (2.0 * share) for share in script.ZONE_SHARES]
    assert truth[0] > end
    assert truth[1] > end
    assert radii[:2] == [end, end]
    assert radii[3] == pytest.approx(truth[3], rel=0.02)
    assert script.zone_radii(before, 0.0 * moved, 0.0, base, 0.01, end) == [base] * 4


# --- YADE ---


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("yade") is None, reason="YADE is not installed (Debian: apt-get install yade)")
def test_small_runs_repeat_exactly_and_balance(script, tmp_path):
    # About 200 spheres of 50 mm.
    pull = case(script, diameter=0.05, half_angle=25.0, height=0.07, stiffness=2e5, bands=1)
    first, again = (script.run(pull, tmp_path / name) for name in ("first", "again"))
    assert {**first, "cpu": 0} == {**again, "cpu": 0}
    assert first["spheres"] in range(150, 250)
    # The spring's mean stretch carries the mean draft, but for what little the share's speed changes.
    assert first["deflection"] * 2e5 == pytest.approx(first["draft"], rel=0.05)
    assert first["working"] == pytest.approx(first["draft"], rel=0.15)
    test = script.run(case(script, kind="triaxial", diameter=0.05), tmp_path / "first")
    assert 3.0 < test["axial_stress"] / 50e3 < 6.0
    assert 0.0 < test["compaction"] < 0.05


# --- rows on file ---

TABLES = {"particles": ("draft", "standard_error", "path", "zone_10"), "triaxial": ("axial_stress", "compaction")}
CONES = ("cone-15", "cone-35", "wide-15", "wide-35")
WORDS = {"case", "question", "kind", "yade"}


@pytest.mark.parametrize("name", TABLES)
def test_rows_are_numbers_under_documented_columns(script, name):
    rows = script.read_rows(PARTICLES / f"{name}.csv")
    explained = set(re.findall(r"\w+", (PARTICLES / "README.md").read_text(encoding="utf-8")))
    assert {*rows[0]} <= explained
    for row in rows:
        numbers = {column: float(text) for column, text in row.items() if column not in WORDS}
        assert np.isfinite([*numbers.values()]).all(), row["case"]
        assert min(numbers[column] for column in TABLES[name]) > 0.0, row["case"]
        assert 0.3 < numbers["porosity"] < 0.5
    assert len({script.key_of(row) for row in rows}) == len(rows)


def test_cases_were_run_in_every_packing_of_the_plan(script):
    planned = Counter(one.case for one in script.plan())
    for name in TABLES:
        cases = [row["case"] for row in script.read_rows(PARTICLES / f"{name}.csv")]
        # The plan may have been interrupted in the middle of its last case.
        complete = Counter(one for one in cases if one != cases[-1])
        assert complete == {one: planned[one] for one in complete}
        if name == "particles":
            assert {one.case for one in script.plan() if one.question == MAIN} <= {*complete}


def test_the_page_states_the_effect_of_the_box(script):
    rows = script.read_rows(PARTICLES / "particles.csv")
    mean = {name: np.mean([float(row["draft"]) for row in rows if row["case"] == name]) for name in CONES}
    slender, blunt = (mean[f"wide-{angle}"] / mean[f"cone-{angle}"] for angle in (15, 35))
    page = " ".join((PARTICLES / "README.md").read_text(encoding="utf-8").split())
    assert f"15° draws {slender:.2f} and 35° {blunt:.2f} times the force" in page


# --- comparisons with particles and measurements: arithmetic, and the tables of the page from the rows on file ---


PAGE = (PROBLEMS.parent / "docs" / "explanation" / "validation.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def measured():
    with imported("measured/compare") as module:
        yield module


@pytest.fixture(scope="module")
def particles():
    with imported("particles/findings") as module:
        yield module


@pytest.mark.parametrize("of", ["measured", "particles"])
def test_the_page_holds_the_tables_of_measurements_and_particles(request, of):
    script = request.getfixturevalue(of)
    for headings, table in script.TABLES.values():
        assert script.markdown(headings, table()) in PAGE


def test_thirty_measured_rows_with_sources(measured):
    tables = sorted(path.stem for path in (PROBLEMS / "measured").glob("*.csv"))
    values = [name for name in tables if name not in ("to_obtain", "trends")]
    assert sum(len(measured.rows_of(name)) for name in values) + len(measured.rows_of("trends")) >= 30
    for name in tables:
        assert (PROBLEMS / "measured" / f"{name}.csv").read_text(encoding="utf-8").startswith("#")


def test_the_published_sand_against_the_plane_wedge_by_hand(measured):
    """Rankine's passive wedge: without cohesion, tool friction and crescents."""
    law = measured.SwickPerumpral(depth=0.2, width=0.3, rake_angle=math.pi / 2.0)
    scene = measured.blade_scene(measured.SwickPerumpral, 0.0, 0.3, 0.2)
    smooth = measured.dataclasses.replace(scene.soil, tool_friction=0.0)
    still = measured.dataclasses.replace(scene, soil=smooth, medium=law, tow_speed=1e-6)
    passive = math.tan(math.radians(45.0 + 35.0 / 2.0)) ** 2
    assert still.steady_resistance == pytest.approx(1440.0 * 9.81 * 0.2**2 / 2.0 * 0.3 * passive, rel=1e-3)


def test_mean_and_error(particles):
    mean, error = particles.mean_and_error(np.random.default_rng(4).normal(3.0, 0.5, 400).tolist())
    assert mean == pytest.approx(3.0, abs=4.0 * error)
    # The standard deviation of 400 normal values is known to 3.5 %.
    assert error == pytest.approx(0.5 / 20.0, rel=0.15)


def test_the_soil_of_triaxial_tests_fails_where_they_failed(particles):
    """The Mohr-Coulomb line of the soil gives back the axial stresses, which lie on it within their scatter."""
    soil = particles.tested_soil(30.0, 100e3, 50e3)
    strength = math.tan(math.pi / 4.0 + soil.friction_angle / 2.0)
    for row in particles.table("triaxial"):
        case = particles.case_of(row)
        if (case.friction, case.cohesion) == (30.0, 100e3):
            expected = case.pressure * strength**2 + 2.0 * soil.cohesion * strength
            assert float(row["axial_stress"]) == pytest.approx(expected, rel=0.15)


def test_the_page_states_what_one_density_ratio_gives(particles):
    """b1 from the tests at each pressure, by `Soil.from_compaction` too; and that of 50 kPa at all pressures."""
    pressures = [25e3, 50e3, 100e3, 200e3]
    soils = [dataclasses.replace(particles.tested_soil(30.0, 100e3, p), tool_friction=0.4) for p in pressures]
    lost = [1.0 - soil.density_ratio for soil in soils]

    def draft(soil):
        still = po.Effects(motion=False)
        return float(po.Scene(soil, po.Cone(po.deg(15.0), 0.1), 1e6, 1.0, 2.0, still).steady_resistance)

    following = [draft(po.Soil.from_compaction(pressures, lost, soil)) for soil in soils]
    assert following == pytest.approx([draft(soil) for soil in soils], rel=1e-12)
    fixed = [draft(dataclasses.replace(soil, density_ratio=soils[1].density_ratio)) for soil in soils]
    one = [force / fixed[1] for force in fixed]
    assert f"{one[0]:.2f}, {one[2]:.2f} and {one[3]:.2f} times that at 50 kPa" in PAGE
    soils_page = (PROBLEMS.parent / "docs" / "howto" / "soils.md").read_text(encoding="utf-8")
    (deepest,) = (r.mean for q in particles.QUESTIONS for r in particles.ratios(q) if r.case.pressure == 200e3)
    assert f"from {one[3]:.2f} to {following[3] / following[1]:.2f} times" in soils_page
    assert f"the particles' is {deepest:.2f} times" in soils_page


def test_ratios_compare_cases_that_differ_in_nothing_else(particles):
    for question in particles.QUESTIONS:
        for one in particles.ratios(question):
            drafts = particles.drafts(one.case)
            reference = particles.dataclasses.replace(one.case, **question.varied)
            seeds = drafts.keys() & particles.drafts(reference).keys()
            by_hand = np.mean([drafts[seed] / particles.drafts(reference)[seed] for seed in seeds])
            assert one.mean == pytest.approx(by_hand, rel=1e-12)
