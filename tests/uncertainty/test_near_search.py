"""`solve(search="near")`: the optimum of the basin in which the guess lies, on either side of a resonance."""

import pytest

import plough_opt as po


@pytest.mark.parametrize(("guess", "branch"), [(6e3, "soft"), (9e4, "stiff")])
def test_the_basin_of_the_guess_is_kept(guess, branch):
    d = po.Design()
    k0 = d.variable("stiffness", guess=guess, lower=5e3, upper=1e5, unit="N/m", log=True)
    share = po.Wedge(po.deg(25), po.deg(15), 0.25)
    effects = po.Effects(strength_wave=po.StrengthWave(0.3, 0.6), damping=200.0)
    run = po.simulate(po.Scene(po.named_soil("firm sandy loam"), share, k0, 28.0, 2.0, effects), 2.0)
    d.minimise(run.force_rms / 1e3)
    best = d.solve(search="near")
    assert best.name.startswith(branch)
    assert best.search.designs == 0
    assert len(best.local_optima) == 1


def test_a_name_that_is_no_search_is_refused():
    d = po.Design()
    d.minimise((d.variable("x", guess=0.5, lower=0.0, upper=1.0) - 0.3) ** 2)
    with pytest.raises(po.InputError, match="'near'"):
        d.solve(search="nearr")
