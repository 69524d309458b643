"""Periodic orbits of many designs at once against single orbits, and against SciPy's shooting."""

import functools

import casadi as ca
import numpy as np
import pytest
from helpers.orbit_oracle import orbit
from helpers.scenes import R1_SOIL, Shank, scene_of

import plough_opt as po
from plough_opt.motion.compiled_steps import ManyRuns, compiled_steps
from plough_opt.motion.equation import Structure, equation_of, parameters

# A common period of 0.6 m.
TWO = (po.StrengthWave(0.2, 0.6), po.StrengthWave(0.3, 0.2, 1.0))
# Name -> effects of a scene with such a damping and such a strength wave, if it has them.
KINDS = {
    "damped": lambda damping, wave: {"damping": damping, "strength_wave": wave},
    "undamped": lambda _, wave: {"strength_wave": wave},
    "rate term": lambda damping, wave: {"damping": damping, "strength_wave": wave, "rate_term": 0.03},
    "conservative": lambda _, wave: {"strength_wave": wave, "inertial_drag": False, "added_mass": False},
    "two waves": lambda damping, _: {"damping": damping, "strength_wave": TWO},
    "light": lambda damping, wave: {"damping": damping, "strength_wave": wave, "ambient_pressure": False},
}
PER_KIND = 40
# Blocks of designs of each kind: the first in every test run, the others in slow ones.
BLOCKS = [pytest.param(k, marks=pytest.mark.slow if k else ()) for k in range(0, PER_KIND, 8)]
LOW = np.array([0.17, 0.15, 3.5, 20.0, 1.0, 50.0, 0.0, 0.2])
HIGH = np.array([0.6, 0.40, 6.0, 60.0, 4.0, 600.0, 1.0, 1.0])


def built(kind, x):
    """Return the scene of a kind at the quantities of `LOW`: numbers, or symbols."""
    share = po.Wedge(x[0], po.deg(15.0), x[1])
    effects = KINDS[kind](x[5], po.StrengthWave(x[6], x[7]))
    return scene_of(R1_SOIL, share, x[2], x[3], x[4], orbit="periodic", **effects)


@pytest.fixture(scope="module")
def designs():
    """Return the 240 designs: a row of `LOW`'s quantities for each, by kind."""
    rows = np.random.default_rng(31).uniform(LOW, HIGH, (len(KINDS), PER_KIND, len(LOW)))
    rows[..., 2] = 10.0 ** rows[..., 2]
    return dict(zip(KINDS, rows, strict=True))


@pytest.fixture(scope="module")
def batch_of():
    """Return the function from a kind to its batch to an error, compiled once."""

    @functools.cache
    def batch_of(kind, error=1e-9):
        x = [ca.MX.sym(f"x{k}") for k in range(len(LOW))]
        return po.Batch(built(kind, x), None, x, error=error)

    return batch_of


def single(kind, row):
    """Return the run of a single orbit, or the message of its error."""
    try:
        return po.simulate(built(kind, row.tolist()), accuracy=po.Accuracy(error=1e-11), outputs=64)
    except po.IntegrationError as error:
        return str(error)


@pytest.mark.parametrize("block", BLOCKS)
@pytest.mark.parametrize("kind", KINDS)
def test_a_batch_finds_single_orbits_with_honest_errors(designs, batch_of, kind, block):
    rows = designs[kind][block : block + 8]
    found = batch_of(kind)(rows)
    both = (found, batch_of(kind, 1e-5)(rows)) if kind == "damped" else (found,)
    lost: list[int] = []
    for k, row in enumerate(rows):
        run = single(kind, row)
        if isinstance(run, str):
            assert found.reasons[k] == run
            continue
        if k in found.reasons:
            assert "no periodic orbit" in found.reasons[k]
            lost.append(k)
            continue
        size = max(abs(run.mean_draft), run.force_rms)
        for result in both:
            error = max(abs(result.mean_draft[k] - run.mean_draft), abs(result.force_rms[k] - run.force_rms)) / size
            assert error <= result.error_estimate[k] + 1e-10
            assert result.error_estimate[k] <= result.wanted
            assert result.mean_deflection[k] == pytest.approx(run.mean_deflection, rel=2 * result.wanted)
            assert result.displacement_rms[k] == pytest.approx(run.displacement_rms, abs=result.wanted * size / row[2])
            assert result.tow_power[k] == pytest.approx(run.tow_power, rel=result.wanted)
        assert found.largest_multiplier[k] == pytest.approx(max(map(abs, run.floquet)), rel=1e-4)
        assert found.unstable[k] == any("unstable" in warning for warning in run.warnings)
    # Far from the linear response Newton's steps may lead anywhere: a batch misses the orbit of one of all designs.
    assert lost == ([2] if (kind, block) == ("undamped", 8) else [])
    assert any("unstable" in warning for warning in found.warnings) == found.unstable.any()
    assert any("equilibrium" in warning for warning in found.warnings)
    assert found.to_dataframe()["largest_multiplier"].tolist() == pytest.approx(
        found.largest_multiplier.tolist(), nan_ok=True
    )


@pytest.mark.parametrize("block", BLOCKS)
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "two waves"])
def test_the_orbits_of_a_batch_are_those_of_scipy(designs, batch_of, kind, block):
    rows = designs[kind][block : block + 8 : 1 if block else 4]
    found = batch_of(kind)(rows)
    for k, row in enumerate(rows):
        if k in found.reasons:
            continue
        run = single(kind, row)
        true = orbit(run.scene, (run.deflection[0], run.scene.tow_speed - run.speed[0]), 64)
        # Averages over equal intervals of a period converge exponentially.
        assert found.mean_draft[k] == pytest.approx(np.mean(true.force[:-1]), rel=1e-8)
        assert found.force_rms[k] == pytest.approx(np.std(true.force[:-1]), rel=1e-6, abs=1e-8 * found.mean_draft[k])
        largest = np.abs(np.linalg.eigvals(true.monodromy)).max()
        assert found.largest_multiplier[k] == pytest.approx(largest, rel=1e-4)


@pytest.mark.parametrize("kind", KINDS)
def test_the_orbits_of_a_search_are_single_orbits(designs, batch_of, kind):
    rows = designs[kind][:8]
    scenes = [built(kind, row.tolist()) for row in rows]
    structure = Structure.of(scenes[0])
    names = equation_of(structure).names
    values = (parameters(scene, structure) for scene in scenes)
    p = np.array(
        [[*(value[name] for name in names), scene.wave_period] for value, scene in zip(values, scenes, strict=True)]
    )
    runs = ManyRuns(structure, 64)
    assert runs.compiled == batch_of(kind).compiled
    found, averages = runs(p), ManyRuns(structure, 0)(p)
    for k, row in enumerate(rows):
        run = single(kind, row)
        if isinstance(run, str):
            assert np.isnan(found[k]).all()
            continue
        w = run.deflection - float(run.scene.steady_resistance / run.scene.stiffness)
        size = run.displacement_rms
        assert found[k, : 2 * len(w) : 2] == pytest.approx(w, rel=0, abs=1e-3 * size + 1e-12)
        assert averages[k, 0] == pytest.approx(w[:-1].mean(), rel=0, abs=1e-4 * size + 1e-12)
        assert np.sqrt(averages[k, structure.damper + 1]) == pytest.approx(size, rel=1e-4, abs=1e-12)


@pytest.mark.usefixtures("no_compiler")
def test_without_a_compiler_orbits_are_the_same(designs, batch_of):
    rows = designs["damped"][:3]
    interpreted = batch_of.__wrapped__("damped")(rows)
    assert interpreted.mean_draft == pytest.approx(
        [single("damped", row).mean_draft if k not in interpreted.reasons else np.nan for k, row in enumerate(rows)],
        rel=1e-9,
        nan_ok=True,
    )
    structure = Structure.of(built("damped", rows[0].tolist()))
    values = parameters(built("damped", rows[-1].tolist()), structure)
    p = np.array([[*(values[name] for name in equation_of(structure).names), rows[-1][7] / rows[-1][4]]])
    expected = ManyRuns(structure, 0)(p)
    compiled_steps.cache_clear()
    try:
        assert ManyRuns(structure, 0)(p) == pytest.approx(expected, rel=1e-4)
    finally:
        compiled_steps.cache_clear()


def test_orbits_that_a_batch_refuses(r1_scene):
    damping, wave = ca.MX.sym("damping"), po.StrengthWave(0.3, 0.6)

    def batch(duration=None, **effects):
        return po.Batch(r1_scene(damping=damping, strength_wave=wave, **effects), duration, [damping])

    for call, match in (
        (lambda: batch(orbit="linearised"), "orbit = 'periodic'"),
        (lambda: batch(orbit=po.HarmonicBalance(3)), "orbit = 'periodic'"),
        (lambda: batch(orbit="periodic", own=(Shank(per_metre=10.0),)), "own resistances repeat"),
        (lambda: batch(1.0, orbit="periodic"), "one wavelength"),
        (lambda: batch(), "duration is missing"),
    ):
        with pytest.raises(po.InputError, match=match):
            call()


def test_a_standing_share_has_no_orbit(batch_of, designs):
    rows = designs["damped"][:2].copy()
    rows[1, 4] = 0.0
    assert "a standing share has no orbit" in batch_of("damped")(rows).reasons[1]
