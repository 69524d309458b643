"""Compiled designs: the same optimum, and a warning if there is no compiler."""

import numpy as np
import pytest

import plough_opt as po
from plough_opt.motion import compiled_steps
from plough_opt.motion.equation import Structure, equation_of, parameters


@pytest.fixture
def small(build_r1):
    """R1 with short runs and the cohesion as a parameter."""
    return build_r1(duration=0.4, outputs=5, parameters=["cohesion"]).design


@pytest.fixture
def cache(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "plough_opt"


def test_the_optimum_is_the_same(small, cache):
    plain, fast = small.solve(), small.solve(compiled=True)
    assert list(cache.glob("*.so"))
    # IPOPT stops at 1e-10 of the scaled optimality conditions, each time at a point of its own.
    assert fast.objective == pytest.approx(plain.objective, rel=1e-10)
    for own, other in zip(fast.local_optima, plain.local_optima, strict=True):
        assert own.objective == pytest.approx(other.objective, rel=1e-9)
    assert fast.warnings == plain.warnings
    # Parameters are not part of the compiled code.
    softer = {"cohesion": 10e3}
    again, expected = (small.solve(parameters=softer, compiled=how) for how in (True, False))
    assert again.objective == pytest.approx(expected.objective, rel=1e-10)
    assert again.objective < fast.objective


def test_a_design_is_interpreted_without_a_compiler(small, cache, monkeypatch):
    monkeypatch.setenv("CC", "no_such_compiler")
    monkeypatch.setenv("PATH", str(cache))
    compiled_steps.compiled_steps.cache_clear()
    try:
        best = small.solve(compiled=True)
    finally:
        compiled_steps.compiled_steps.cache_clear()
    assert "no C compiler was found" in str(best.search)
    assert best.status == "solved"
    assert any("no C compiler was found" in warning for warning in best.warnings)
    assert not any("no C compiler" in warning for warning in small.solve().warnings)


@pytest.mark.parametrize("ramp", [None, 0.13])
def test_many_runs_agree_with_and_without_a_compiler(r1_scene, monkeypatch, tmp_path, ramp):
    """States at the outputs, means and mean squares: a search reads all of them."""
    scene = r1_scene(strength_wave=po.StrengthWave(0.3, 0.6), damping=200.0, tow_ramp=ramp)
    structure, known = Structure.of(scene), parameters(scene)
    names = equation_of(structure).names
    p = np.array([[*(float(known[name]) for name in names), 0.4]] * 3)
    p[:, names.index("stiffness")] *= (0.5, 1.0, 2.0)
    uncached = compiled_steps.compiled_steps.__wrapped__
    monkeypatch.setattr(compiled_steps, "compiled_steps", uncached)  # remembers nothing
    compiled = compiled_steps.ManyRuns(structure, 5)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    plain = compiled_steps.ManyRuns(structure, 5)
    assert (compiled.compiled, plain.compiled) == (True, False)
    for finer, near in ((1.0, 1e-4), (4.0, 1e-7)):
        found, wanted = (runs(p, finer=finer) for runs in (plain, compiled))
        # Between steps the compiled runs read a polynomial of degree 5: its slope errs by the fifth power of a step.
        assert np.all(np.abs(found - wanted) <= near * np.max(np.abs(wanted), axis=0))
