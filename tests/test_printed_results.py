"""What `print` shows of results: their tables, and no page of raw numbers."""

import pytest

import plough_opt as po


@pytest.fixture(scope="module")
def best():
    d = po.Design()
    height = d.variable("height", guess=0.25, lower=0.1, upper=0.5, unit="m")
    stiffness = d.variable("stiffness", guess=1e5, lower=1e4, upper=1e6, unit="N/m", log=True)
    share = po.Wedge(po.deg(30), po.deg(15), height)
    scene = po.Scene(
        po.named_soil("serozem"),
        share,
        stiffness,
        20.0,
        2.0,
        po.Effects(damping=400.0, strength_wave=po.StrengthWave(0.3, 0.2)),
    )
    run = po.simulate(scene, 1.0)
    d.minimise(run.mean_draft / 1e3 + run.force_rms / 1e3)
    d.require("loosened radius", scene.loosened_radius, at_least=0.12, unit="m")
    return d.solve(search="near"), run


def test_an_optimum_prints_its_tables(best):
    text = str(best[0])
    assert len(text) < 2500
    for words in ("Best design (solved)", "objective", "height", "loosened radius", "decides", " m "):
        assert words in text, words
    assert "array(" not in text
    # The value printed is the one returned.
    assert f"{best[0].variables['height']:.5g}"[:6] in text
    assert str(best[0].local_optima[0]).count("\n") >= 4


def test_a_run_prints_its_table(best):
    run = best[0](best[1])
    text = str(run)
    assert f"{run.mean_draft:.6g} N" in text
    assert "peak deflection" in text
    assert all(f"Note: {note}." in text for note in run.warnings)
    assert str(best[1]) == "<Run: expressions of a scene's symbols>"
