"""The accuracy study of a scene and of a design: true errors, advice, failures, pictures; the contest; its script."""

import ast
import dataclasses
import io
import itertools
import math
import re

import casadi as ca
import matplotlib.image
import numpy as np
import pytest
from helpers.problem_files import REFERENCE
from helpers.scenes import scene_of
from helpers.scripts import imported
from helpers.small_designs import design, softest
from matplotlib.figure import Figure
from rich.console import Console

import plough_opt as po
from plough_opt.core import compiler
from plough_opt.core.compiler import find_compiler
from plough_opt.studies.accuracy import methods
from plough_opt.studies.accuracy import study as studies
from plough_opt.studies.accuracy.methods import FACTORS, Contestant, Task, measured, prepared, step_counts
from plough_opt.studies.accuracy.reference import reference_run
from plough_opt.studies.accuracy.result import (
    AUTO,
    COMPILED,
    OPTIMUM,
    VARIABLES,
    AccuracyStudy,
    MethodResult,
    cheapest,
    efficient,
)
from plough_opt.studies.accuracy.study import reference_optimum

WAVE = po.StrengthWave(amplitude=0.3, wavelength=0.2)


@pytest.fixture(scope="module", params=["thin", pytest.param("full", marks=pytest.mark.slow)])
def linear(request):
    """Return a scene with a closed form, and its study, with a clock by which no method takes too long."""
    plain = scene_of(start="rest", inertial_drag=False)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(methods, "least_times", lambda uses, *_: [1e-3] * len(uses))
        thin = request.param == "thin"
        study = po.study_accuracy(plain, 0.15, wanted=1e-15, outputs=10, allowance=1e3, thin=thin)
    return plain, study


def test_every_integrator_has_the_errors_of_its_setting(linear):
    plain, study = linear
    true = reference_run(plain, 0.15, outputs=10).run  # tests/accuracy/test_motion_reference.py proves it
    size = max(abs(true.mean_draft), true.force_rms)
    checked = 0
    families = {"integrator": False, methods.MACHINE_CODE: True}
    for entry in study.entries:
        if entry.family not in families or entry.method in (AUTO, COMPILED) or entry.failure:
            continue
        value, kind = sorted(entry.setting.split())  # digits before letters
        accuracy = po.Accuracy(entry.method.removesuffix(", compiled"), **{kind: ast.literal_eval(value)})
        run = prepared(Task(plain, 0.15, 10, 1.0), accuracy, compiled=families[entry.family])[1]()
        for name, of in (("mean draft", "mean_draft"), ("RMS", "force_rms")):
            off = float(abs(getattr(run, of) - getattr(true, of)) / size)
            assert entry.errors[name] == pytest.approx(off, rel=1e-9, abs=1e-17), name
        assert entry.errors["averages"] == max(entry.errors["mean draft"], entry.errors["RMS"])
        checked += 1
    assert checked >= 18
    with pytest.raises(po.IntegrationError, match="not finite"):
        prepared(Task(scene_of(stiffness=1e9, start="rest"), 0.2, 2, 1.0), po.Accuracy("rk", steps=40))[1]()


def test_the_efficient_named_integrators_have_their_time_with_a_check(damped):
    families = ([e for e in damped.entries if e.family == f] for f in ("integrator", methods.MACHINE_CODE))
    front = [e for family in families for e in efficient(family, "averages", damped.floors["motion"])]
    named = [e for e in front if e.method not in (AUTO, COMPILED)]
    assert named
    assert [e for e in damped.entries if e.checked is not None] == [e for e in damped.entries if e in named]
    assert all(0.0 < e.checked < math.inf and e.setup > 0.0 for e in named)


def test_the_wanted_error_is_one_that_auto_aims_at():
    for wanted, aimed in ((3e-7, [1e-3, 1e-6, 3e-7, 1e-8, 1e-10]), (1e-15, [1e-3, 1e-6, 1e-8, 1e-10, 1e-12])):
        task = Task(scene_of(), 0.2, 4, 1.0, thin=True, wanted=wanted)
        assert [a.error for a in methods.automatic_settings(task)] == aimed


def test_gradients_of_the_finest_settings_agree_with_the_reference(linear):
    study = linear[1]
    rows = [entry for entry in study.entries if entry.family == "derivatives" and not entry.failure]
    best = {row.method: min(e.errors["gradient"] for e in rows if e.method == row.method) for row in rows}
    assert set(best) == {"auto", "dop853", "collocation", "rk", "cvodes", "idas", "erk", "rosenbrock"}
    # The tightest tolerance of a thin study is 1e-6, which leaves some ten times as much.
    assert max(best.values()) < 3e-5
    assert best["dop853"] < 1e-10
    assert study.floors["gradient"] < 1e-12


@pytest.fixture(scope="module")
def damped():
    """Return the study of a transient that tends to a periodic orbit."""
    scene = scene_of(strength_wave=WAVE, damping=400.0)
    return po.study_accuracy(scene, 0.5, outputs=8, thin=True, allowance=0.2, derivatives=False)


def test_the_table_names_the_references_errors(damped):
    floors = damped.floors
    assert 0.0 < floors["motion"] <= floors["motion, trajectory"] < 1e-14
    assert 0.0 < floors["lasting orbit"] <= floors["lasting orbit, trajectory"] < 1e-14
    title = damped.table(damped.questions[0]).title
    assert f"(reference: {floors['motion']:.0e}, its trajectory {floors['motion, trajectory']:.0e})" in title


# --- models that simplify the motion, relative to the transient and to the periodic orbit ---


def test_both_orbit_and_transient_are_ranked_and_the_default_is_in_the_first(damped):
    titles = [question.title for question in damped.questions]
    own = ["averages of the motion, in machine code"] if find_compiler() else []
    assert titles == ["averages of the motion", *own, "averages of the periodic orbit"]
    first = damped.questions[0]
    assert first.default in [(e.method, e.setting) for e in damped.of(first)]


# --- failures are rows with the reason ---


def test_methods_without_events():
    sticks = scene_of(tow_speed=0.5, start="rest", contact=po.StickSlip(1.2), damping=50.0, strength_wave=WAVE)
    study = po.study_accuracy(sticks, 0.05, outputs=2, thin=True, allowance=0.02)
    refused = {e.method: e.failure for e in study.failures}
    assert {"dop853", "collocation", "rk", "cvodes", "idas"} <= set(refused)
    assert all("events" in refused[m] for m in ("dop853", "cvodes"))
    assert {e.method for e in study.of(study.questions[0])} == {"auto", "erk", "rosenbrock", "quasi-static"}
    assert {e.method for e in study.entries if e.family == "derivatives"} == {"auto", "erk", "rosenbrock"}


def test_a_scene_without_a_motion_has_nothing_to_choose():
    study = po.study_accuracy(scene_of(motion=False, strength_wave=WAVE), 0.1)
    assert (study.entries, study.questions, study.advice) == ((), (), "")
    assert any("no motion" in note and "no method" in note for note in study.notes)
    assert "Times" not in str(study)


def test_what_enters_the_soil_has_no_quasi_static_limit():
    enters = scene_of(start="towed", entry=True)
    study = po.study_accuracy(enters, 0.05, outputs=2, thin=True, allowance=1e-4, derivatives=False)
    refused = {e.method: e.failure for e in study.failures}
    assert refused["quasi-static"] == "its share is wholly buried from the start, so it cannot enter"


def test_what_takes_too_long_is_cut_off_and_the_default_late(monkeypatch):
    monkeypatch.setattr(studies, "HAS_EXTENDED", False)
    study = po.study_accuracy(scene_of(), 0.1, outputs=4, allowance=1e-9, derivatives=False)
    cut = {e.label: e for e in study.failures if "cut off" in e.failure}
    assert {"dop853", "rk", "auto"} <= {e.method for e in cut.values()}
    assert all(math.isinf(e.seconds) and not e.errors for e in cut.values())
    # The default may take twenty times as long.
    for label, allowed in (("auto, error 1e-06", "1e-09"), ("auto, error 1e-08", "2e-08")):
        assert cut[label].failure.endswith(f", {allowed} s allowed")
    # Nothing moves in this scene.
    (still,) = (e for e in study.entries if e.method == "quasi-static")
    assert still.errors["trajectory"] < 1e-15
    assert any("no floats wider than a double" in note for note in study.notes)


def test_without_a_reference_a_note_says_why():
    # The soil drives this share away without bound.
    study = po.study_accuracy(scene_of(stiffness=50.0, start="rest", formulation="printed"), 0.5, outputs=4)
    assert study.questions == ()
    assert any("no reference for the motion: the reference stops at" in note for note in study.notes)
    assert study.advice == ""


WRONG = [
    ({"duration": None}, "duration is missing"),
    ({"duration": 0.0}, "duration"),
    ({"wanted": 0.5}, "wanted error"),
    ({"outputs": 0}, "outputs = 0"),
    ({"allowance": 0.0}, "time allowed"),
    ({"scene": scene_of(strength_wave=WAVE, orbit="periodic")}, "omit the duration"),
    ({"scene": scene_of(stiffness=ca.MX.sym("k"))}, "holds symbols"),
]


@pytest.mark.parametrize(("change", "said"), WRONG)
def test_wrong_inputs(change, said):
    given = {"scene": scene_of(), "duration": 0.1} | change
    with pytest.raises((po.InputError, po.DomainError), match=said):
        po.study_accuracy(given.pop("scene"), given.pop("duration"), **given)


def made(*rows, wanted=1e-6, default=("auto", "error 1e-08")):
    """Return a study of rows (method, setting, seconds, error, further fields of the entry)."""
    entries = tuple(MethodResult("integrator", m, s, t, 0.1, {"averages": e}, *more) for m, s, t, e, *more in rows)
    return AccuracyStudy("made", 1.0, wanted, entries, {"motion": 1e-17}, ("a note",), {"motion": default})


A, TIGHT, B = ("a", "loose", 1e-3, 1e-3), ("a", "tight", 2e-3, 1e-7), ("b", "", 6e-3, 1e-8)


# --- a sentence on the cheapest method that reaches the wanted error, the next method, and the default ---


ADVICE = [
    pytest.param(
        (A, TIGHT, ("a", "tighter", 3e-3, 1e-9), B, ("auto", "error 1e-08", 0.1, 1e-10)), 1e-6,
        ("1e-06", "a, tight: 2 ms, error 1e-07", "3.0 times cheaper", "b", "default", "100 ms", "50 times"),
        id="the next is another method"),
    pytest.param(
        (("auto", "error 1e-08", 1e-3, 1e-9), ("b", "", 1.05e-3, 1e-8)), 1e-8,
        ("auto, error 1e-08: 1 ms", "about as cheap", "b; that is the default."), id="the default is best"),
    pytest.param(
        (("auto", "error 1e-06", 1e-3, 1e-7), ("auto", "error 1e-08", 2e-3, 1e-9)), 1e-6,
        ("auto, error 1e-06: 1 ms, error 1e-07; that is Accuracy(error=1e-06); the default",), id="auto"),
    pytest.param((TIGHT, ("b", "", 1e-3, 1e-2)), 1e-6, ("a, tight: 2 ms", "only method"), id="the only method"),
    pytest.param(
        (A, ("b", "", 2.0, 1e-5), ("auto", "error 1e-08", 3.0, 1e-4)), 1e-6,
        ("nothing", "1e-06", "b", "1e-05", "2 s", "the default, auto, error 1e-08, takes 3 s"), id="none"),
    pytest.param(
        (("dop853", "80 steps", 1e-3, 1e-7, None, 3e-3), ("auto", "error 1e-06", 2e-3, 1e-9),
         ("auto", "error 1e-08", 6e-3, 1e-10), ("rk", "900 steps", 9e-3, 1e-8)), 1e-6,
        ("dop853, 80 steps: 1 ms", "9.0 times cheaper", "rk, 900 steps", "3 ms", "Accuracy(error=1e-06)", "2 ms",
         "1.5 times faster", "default", "6 ms", "2.0 times as long"),
        id="a named method is compared with its like, and its check with checked runs"),
    pytest.param((B,), 1.25e-3, ("1.25e-03", "b: 6 ms, error 1e-08."), id="three digits"),
]  # fmt: skip


@pytest.mark.parametrize(("rows", "wanted", "facts"), ADVICE)
def test_the_cheapest_good_setting_is_advised(rows, wanted, facts):
    assert re.search(".*".join(map(re.escape, facts)), made(*rows, wanted=wanted).advice)


def test_failures_with_the_same_reason_share_a_sentence():
    rows = (("a", "1", "slow"), ("b", "", "odd"), ("a", "2", "slow"))
    failed = [MethodResult("integrator", m, s, math.inf, failure=reason) for m, s, reason in rows]
    study = dataclasses.replace(made(("c", "", 1.0, 1e-3)), entries=tuple(failed))
    assert study.refusals == ("no result of a, 1; a, 2: slow", "no result of b: odd")


def test_a_table_fits_a_narrow_terminal_with_every_figure():
    rows = [("periodic orbit of it", "1600 steps"), ("rosenbrock", "tolerance 1e-12"), ("auto", "error 1e-08")]
    errors = dict.fromkeys(("averages", "mean draft", "RMS", "last force", "trajectory"), 1.25e-13)
    entries = tuple(MethodResult("integrator", m, s, 1.251e-4, 0.1237, errors) for m, s in rows)
    study = dataclasses.replace(made(("a", "", 1.0, 1.0)), entries=entries)
    console = Console(width=80, file=io.StringIO(), highlight=False)
    console.print(study.table(study.questions[0]))
    printed = console.file.getvalue()
    # Each entry is on one line.
    for method, setting in rows:
        assert re.search(rf" {method}, {setting}.* 125 µs +120 ms( +1e-13){{4}} *\n", printed)


# --- a panel for each question, with all entries that its table ranks ---


def test_each_question_has_a_panel_and_two_share_a_legend_below(damped, tmp_path):
    interpreted = tuple(e for e in damped.entries if e.family != methods.MACHINE_CODE)
    study = dataclasses.replace(damped, entries=interpreted)
    figure = study.plot(tmp_path / "study.png")
    assert [axes.get_title() for axes in figure.axes] == [question.title for question in study.questions]
    (legend,) = figure.legends
    names = {text.get_text() for text in legend.get_texts()}
    assert {"auto", "dop853", "efficient front", "wanted error", "the default"} <= names
    assert (tmp_path / "study.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("beside", [{"floors": {}}, {"entries": ()}], ids=["reference", "entries"])
def test_a_picture_without_errors_is_refused_with_the_reason(beside):
    study = dataclasses.replace(made(("a", "", 0.2, 1e-3)), **beside)
    for target in (None, Figure().subplots()):
        with pytest.raises(po.InputError, match="no error to draw: a note"):
            study.plot(target)


def test_a_short_axis_has_numbers_too():
    figure = made(("a", "", 0.2, 1e-3), ("b", "", 0.3, 1e-5)).plot()
    figure.draw_without_rendering()
    (axes, _) = figure.axes
    low, high = axes.get_xlim()
    ticks = [tick.label1.get_text() for tick in axes.xaxis.get_major_ticks() if low <= tick.get_loc() <= high]
    assert ticks == ["200 ms", "300 ms"]


def test_axes_show_every_entry_the_front_and_the_wanted_error():
    axes = Figure().subplots()
    made(("a", "1", 1e-3, 1e-3), ("a", "2", 2e-3, 0.0), ("b", "", 4e-3, 1e-4)).plot(axes)
    lines = {line.get_label(): line for line in axes.lines}
    assert list(lines["a"].get_xdata()) == [1e-3, 2e-3]
    # An error of zero is drawn at the bottom.
    assert np.all(np.asarray(lines["a"].get_ydata()) > 0.0)
    assert list(lines["efficient front"].get_xdata()) == [1e-3, 2e-3]
    assert any(list(line.get_ydata()) == [1e-6, 1e-6] for line in axes.lines)


# --- the contest: times in turns, the efficient front, and the cheapest setting that is good enough ---


@dataclasses.dataclass
class Clock:
    """Processor time that uses wind, and the steps of all settings built so far."""

    now: float = 0.0
    built: list = dataclasses.field(default_factory=list)

    def contestant(self, order=8, factors=FACTORS, seconds=lambda steps, _: 1e-3 * steps / 40.0):
        """Return a contestant of some order.

        Args:
            order: order of its error over the steps.
            factors: multiples of 40 steps that are measured in any case.
            seconds: (steps, number of the use of that setting) -> time of a use [s].
        """

        def prepare(steps):
            self.built.append(steps)
            numbers = itertools.count()

            def use():
                self.now += seconds(steps, next(numbers))

            return use, lambda: (use(), {"error": 0.5 * (40.0 / steps) ** order})[1]

        rungs, shown = step_counts(40, factors)
        return Contestant("family", "fast", prepare, lambda found: found, rungs, shown, "{} steps".format)


@pytest.fixture
def clock(monkeypatch):
    own = Clock()
    monkeypatch.setattr(methods.time, "process_time", lambda: own.now)
    return own


def winner(contestants, wanted, allowance=1e3):
    return cheapest(measured(contestants, "error", wanted, allowance), "error", wanted)


@pytest.mark.parametrize(("order", "wanted"), [(4, 1e-1), (4, 1e-6), (8, 1e-4), (8, 1e-9)])
def test_it_is_within_a_tenth_of_the_least_steps_in_thin_and_in_full_mode(clock, wanted, order):
    true = 40.0 * (0.5 / wanted) ** (1.0 / order)
    found = []
    for thin in (False, True):
        clock.built.clear()
        factors = Task(None, 0.2, 4, 1.0, thin=thin).some(FACTORS)
        found.append(winner([clock.contestant(order, factors)], wanted))
    full, thin = (best and best.setting for best in found)
    assert full == thin
    assert (full is not None) == (true <= 40.0 * max(FACTORS))
    if full is not None:
        assert int(full.split()[0]) == pytest.approx(true, rel=0.1, abs=1.0)
        # The halvings of some seventy settings, and those measured in any case.
        assert len(clock.built) <= 4 + 7


def test_one_slow_measurement_changes_no_advice(clock):
    """A good setting is timed again, even if it seemed slow at first."""
    wanted = 0.5 * 0.5**8

    def seconds(steps, number):
        # Slow at first, and now and then in turns.
        slow = steps == 80 and (number < 16 or number % 5 == 0)
        return 1e-3 * steps / 40.0 * (3.0 if slow else 1.0)

    best = winner([clock.contestant(seconds=seconds)], wanted, 1.0)
    assert (best.setting, best.seconds) == ("80 steps", pytest.approx(2e-3))


def test_a_clock_that_ticks_coarsely_still_tells_short_uses_apart(clock, monkeypatch):
    """On Windows, and under a limit of processor time, a use between two ticks seems to take no time."""
    monkeypatch.setattr(methods.time, "process_time", lambda: clock.now // 0.016 * 0.016)
    entries = measured([clock.contestant(factors=(1, 2), seconds=lambda n, _: 1e-4 * n / 40.0)], "error", 1.0, 10.0)
    # A turn is one tick: some 160 uses of one setting and 80 of the other.
    times = {e.setting: e.seconds for e in entries}
    assert [times["40 steps"], times["80 steps"]] == pytest.approx([1e-4, 2e-4], rel=0.05)


# --- the script that studies five scenes ---


@pytest.fixture
def cost():
    with imported("accuracy_cost") as module:
        yield module


def test_the_scenes_are_what_they_are_called(cost):
    smooth, stiff, resonant, sticks, entry = cost.scenes().values()
    assert float(stiff[0].natural_frequency) * stiff[1] / (2.0 * math.pi) == pytest.approx(1400, rel=0.05)
    assert float(resonant[0].natural_frequency) == pytest.approx(float(resonant[0].wave_frequency), rel=1e-12)
    assert set(po.simulate(*sticks, outputs=300).mode) == {0.0, 1.0}
    travel = po.simulate(*entry).travel
    assert travel[0] == 0.0 < entry[0].cone.height < travel[-1]
    assert float(smooth[0].natural_frequency) * smooth[1] < 100


@pytest.mark.slow
def test_short_versions_of_the_scenes(cost, tmp_path, monkeypatch, capsys):
    soft = {name: dataclasses.replace(s, stiffness=min(s.stiffness, 2e5)) for name, (s, _) in cost.scenes().items()}
    short = {name: (soft[name], duration / 20.0) for name, (_, duration) in cost.scenes().items()}
    monkeypatch.setattr(cost, "scenes", lambda: short)
    cost.main(["--thin", "--folder", str(tmp_path)])
    printed = capsys.readouterr().out
    for words in ("averages of the motion: for 1e-06 take ", "averages of the motion: relative error against time"):
        assert printed.count(words) == 5
    assert "cannot locate events" in printed
    assert "casadi 3" in printed
    assert matplotlib.image.imread(tmp_path / "accuracy_cost.png").shape[:2] == (1014, 1560)
    for word, name in zip(("smooth", "stiff", "resonant", "stick", "entry"), cost.scenes(), strict=True):
        study = po.AccuracyStudy.load(tmp_path / f"accuracy_cost_{word}.json")
        assert study.title == name
        assert study.advice in printed


# --- of a design: the reference and the errors of searches, and what has no result or no reference ---

# The true optimum of problem R1: wedge angle [deg], height [m], stiffness [N/m] and objective. It is the best of 1.9
# million simulations on a grid, polished with exact gradients to a residual of 1e-9 and checked in long double.
R1 = (39.11469851, 0.2002828632, 37505.6423, 0.9164459115)


# --- the reference ---


@pytest.mark.slow
def test_the_reference_is_the_true_optimum_of_r1():
    d = po.read_problem(REFERENCE).design()[0]
    best = d.solve(search="near")
    known = dict(zip(best.variables, (math.radians(R1[0]), *R1[1:3]), strict=True))
    # Nearer to it than to the other optima, but farther off than any search: IPOPT and Newton's method lead to it.
    rough = dataclasses.replace(best, variables={name: 1.0005 * value for name, value in known.items()})
    found = reference_optimum(d.declared, rough)
    # The last digits of the true values.
    assert found.objective == pytest.approx(R1[3], abs=1e-10)
    assert found.variables == pytest.approx(known, rel=1e-8)
    assert max(found.floor, found.off) < 1e-12


def test_the_reference_of_a_design_with_every_result_of_a_run(r1_soil, r1_wave):
    """Outputs that are used and others that are not, two signals with an RMS, the tow power and a parameter."""
    d, k0 = design(stiffness=(2e4, 1e4, 4e4, "N/m", True))
    damping = d.parameter("damping", 250.0, unit="N s/m")
    effects = po.Effects(strength_wave=r1_wave, damping=damping, tow_ramp=0.13, start="rest")
    scene = po.Scene(r1_soil, po.Wedge(po.deg(30.0), po.deg(15.0), 0.2), k0, 25.0, 2.0, effects)
    run, averages = po.simulate(scene, 0.5, outputs=10), po.simulate(scene, 0.3, outputs=7)
    d.minimise(run.mean_draft / 1e3 + run.force_rms / 1e3 + run.displacement_rms / 1e-2 + averages.tow_power / 1e3)
    d.require("deflection", run.deflection, at_most=0.045, unit="m")
    d.require("force", run.mount_force, at_least=-1e4, at_most=1e4, unit="N")
    best = d.solve(search="near")
    assert best.active
    found = reference_optimum(d.declared, best)
    # Gradients by two methods vanish at one design: IPOPT's tolerance of 1e-10, then rounding.
    assert found.errors(best)["variables"] < 1e-8
    assert max(found.floor, found.off) < 1e-12


HARD = [
    ((2e4, 1e4, 6e4), None, {"damping": 400.0, "orbit": "periodic"}),
    ((7e4, 6e4, 1.2e5), 0.1, {"contact": po.StickSlip()}),
]


@pytest.mark.slow
@pytest.mark.parametrize(("stiffness", "duration", "effects"), HARD, ids=["orbit", "sticks"])
def test_the_reference_of_an_orbit_and_of_a_share_that_sticks(r1_soil, r1_wave, stiffness, duration, effects):
    d = softest(r1_soil, r1_wave, stiffness, duration, **effects)
    best = d.solve(search="near")
    found = reference_optimum(d.declared, best)
    assert found.floor < 1e-9
    assert found.errors(best)["objective"] < 1e-8


# --- searches ---


def smooth(_soil, _wave):
    d, x = design(x=(0.5, 0.0, 2.0))
    d.minimise(1.0 + (x - 1.25) ** 2)
    return d


def with_a_run(soil, wave):
    return softest(soil, wave, duration=0.1)


@pytest.mark.parametrize("made", [smooth, pytest.param(with_a_run, marks=pytest.mark.slow)])
def test_searches_have_their_errors_and_times(r1_soil, r1_wave, made):
    d = made(r1_soil, r1_wave)
    study = po.study_design(d, thin=True, title="A design")
    methods = ["interpreted", "compiled"] if find_compiler() else ["interpreted"]
    efforts = ["near", "250 designs", "1000 designs", "auto", "thorough"]
    ranked = [e for e in study.entries if e.failure is None]
    assert {(e.method, e.setting) for e in ranked} == {(method, effort) for method in methods for effort in efforts}
    assert [e.seconds for e in ranked] == sorted(e.seconds for e in ranked)
    for entry in ranked:
        assert set(entry.errors) == {"objective", "variables"}
        assert 0.0 < entry.seconds < math.inf
        # One basin; IPOPT's tolerance.
        assert max(entry.errors.values()) < 1e-7
    assert [q.title for q in study.questions] == ["objective of the optimum", "variables of the optimum"]
    assert all("the default" in study.advise(q) for q in study.questions)
    assert 0.0 < max(study.floors[OPTIMUM], study.floors[VARIABLES]) < 1e-11
    assert [axes.get_title() for axes in study.plot().axes] == [q.title for q in study.questions]
    assert [(row.search, row.right) for row in study.thoroughness] == [(e, 1 if e == "near" else 3) for e in efforts]
    # The design keeps its state.
    assert d.solve(search="near").variables == d.solve(search="near").variables


def test_the_largest_error_of_any_seed_is_that_of_the_basin_it_ended_in(monkeypatch):
    monkeypatch.setattr(compiler, "find_compiler", lambda: None)
    # Two wells on either side of the middle. The guess lies in the one without the best optimum.
    d, x = design(x=(-0.4, -1.0, 1.0))
    d.minimise((x**2 - 0.16) ** 2 - 0.02 * x)
    study = po.study_design(d, thin=True)
    # Roots of f' = 4 x^3 - 0.64 x - 0.02.
    low, _, high = np.sort(np.roots([4.0, 0.0, -0.64, -0.02]).real)
    value, least = ((x**2 - 0.16) ** 2 - 0.02 * x for x in (low, high))
    *ranked, compiled = study.entries
    (near,) = (entry for entry in ranked if entry.setting == "near")
    others = [entry for entry in ranked if entry is not near]
    assert near.errors["variables"] == pytest.approx((high - low) / 2.0, abs=1e-6)
    assert near.errors["objective"] == pytest.approx((value - least) / abs(least), rel=1e-6)
    assert all(max(entry.errors.values()) < 1e-8 for entry in others)
    assert [row.right for row in study.thoroughness] == [0, 3, 3, 3, 3]
    assert not any("take interpreted, near" in study.advise(question) for question in study.questions)
    assert compiled.failure == compiler.interpretation_warning()
    # Rounding of the roots, and of f'/f'' with f'' of about 1.
    assert reference_optimum(d.declared, d.solve()).variables["x"] == pytest.approx(high, abs=1e-14)


@pytest.fixture
def bowl(monkeypatch):
    """Return a design without a run, whose optimum is x = 1.25 and, by the requirement, y = 1; there is no compiler."""
    monkeypatch.setattr(compiler, "find_compiler", lambda: None)
    d, x, y = design(x=(0.5, 0.0, 2.0), y=(1.5, 0.5, 2.0))
    d.minimise(1.0 + (x - 1.25) ** 2 + y)
    d.require("least y", y, at_least=1.0)
    d.require("least x", x, at_least=0.2)  # inactive
    return d


def test_the_reference_lies_on_the_active_limits(bowl):
    found = reference_optimum(bowl.declared, bowl.solve())
    # IPOPT stops 1e-11 inside the limit, and 1e-10 beside the bottom; the reference does not.
    assert found.variables == pytest.approx({"x": 1.25, "y": 1.0}, abs=1e-15)
    assert found.objective == pytest.approx(2.0, abs=1e-15)
    assert max(found.floor, found.off) < 1e-14


# --- what has no result or no reference ---


def test_a_search_that_takes_too_long_is_the_last(bowl):
    late = po.study_design(bowl, limit=1e-9, thin=True)
    assert [(row.search, row.asked) for row in late.thoroughness] == [("near", 1)]
    assert [entry.setting for entry in late.entries] == ["near", ""]


def test_an_objective_over_the_tolerance_box_has_no_reference(monkeypatch):
    monkeypatch.setattr(studies, "_EFFORTS", ("near", 250))
    d, x = design(x=(0.5, 0.0, 2.0, "", False, 0.05))
    d.minimise((x - 1.25) ** 2, over="mean")
    study = po.study_design(d, thin=True)
    assert study.questions == ()
    assert any("no reference for the optimum" in note and "tolerances" in note for note in study.notes)
    assert [row.right for row in study.thoroughness] == [1, 3]
