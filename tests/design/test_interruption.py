"""Designs that are solved in threads of one process, and those that are interrupted."""

import subprocess
import sys

import pytest
from helpers.small_designs import design

from plough_opt.design import ipopt

# In a process of its own, whose output and errors threads must not lose.
SCRIPT = """
from concurrent.futures import ThreadPoolExecutor
import plough_opt as po

def solved(upper):
    d = po.Design()
    height = d.variable("height", guess=0.25, lower=0.1, upper=0.5, unit="m")
    k0 = d.variable("stiffness", guess=5e4, lower=1e4, upper=upper, unit="N/m", log=True)
    cone = po.Cone(po.deg(10.0), height)
    wave = po.StrengthWave(amplitude=0.3, wavelength=0.2)
    scene = po.Scene(po.named_soil("serozem"), cone, k0, 25.0, 2.0, po.Effects(strength_wave=wave, damping=400.0))
    run = po.simulate(scene, 0.5)
    d.minimise((run.mean_draft + run.force_rms) / 1e3)
    d.require("loosened radius", scene.loosened_radius, at_least=0.12, unit="m")
    return d.solve(search="local").objective

uppers = [1e5, 2e5]
with ThreadPoolExecutor(2) as pool:
    together = list(pool.map(solved, uppers))
assert together == [solved(upper) for upper in uppers], together
print("all solved")
"""


def test_designs_in_threads_are_those_one_after_the_other():
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=False)
    assert done.stdout.split("\n")[0] == "all solved", done.stderr


@pytest.mark.filterwarnings("ignore")  # CasADi reports every evaluation that failed
def test_an_interruption_ends_a_solve_and_not_the_next(monkeypatch):
    d, x = design(x=(0.5, 0.1, 1.0))
    d.minimise(x + 1.0 / x)
    d.require("sum", x, at_most=0.8)

    def stop(*_, **_keywords):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(ipopt.LastPoint, "__call__", stop)
        with pytest.raises(KeyboardInterrupt):
            d.solve()
    assert d.solve().variables["x"] == pytest.approx(0.8, rel=1e-9)
