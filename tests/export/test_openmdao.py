"""OpenMDAO as the client: partials and bounds; docs/howto/exports.md runs its driver, with units."""

import subprocess
import sys

import numpy as np
import pytest
from helpers.extras import needs

import plough_opt as po
from plough_opt.core.quantities import EVERY
from plough_opt.motion.vocabulary import MEASURES

om = needs("openmdao.api")
PloughComponent, write_openmdao = po.export.PloughComponent, po.export.write_openmdao


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.setenv("OPENMDAO_REPORTS", "0")
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def small(r1_scene):
    """Builds the component of a name that costs least."""
    return lambda name: po.component(
        r1_scene(motion=False), 1.0, inputs=["share.height"], outputs=["mean_draft"], name=name
    )


def _problem(component):
    problem = om.Problem(reports=None)
    problem.model.add_subsystem("share", PloughComponent(component), promotes=["*"])
    return problem


def _worst(checked):
    """Return the largest relative error of any partial, by the differences' size; zeros must be zeros."""
    pairs = [(found["J_fwd"], found["J_fd"]) for found in checked["share"].values()]
    # The least float keeps 0 / 0 from being NaN.
    return max(
        np.abs(exact - differences).max() / max(np.abs(differences).max(), 5e-324) for exact, differences in pairs
    )


def test_partials_are_casadis_jacobian_and_pass_check_partials(around_r1):
    problem = _problem(around_r1)
    problem.setup()
    for x in ([0.6, 0.2, 4.2e4], [0.85, 0.28, 4.4e4], [0.55, 0.16, 3.1e4]):
        for port, value in zip(around_r1.inputs, x, strict=True):
            problem[port.argument] = value
        problem.run_model()
        assert [float(problem[port.argument][0]) for port in around_r1.outputs] == list(around_r1(*x))
        problem.model.run_linearize()
        totals = [port.argument for port in around_r1.outputs], [port.argument for port in around_r1.inputs]
        found = problem.compute_totals(*totals, return_format="array")
        assert found == pytest.approx(around_r1.slopes(*x).full(), rel=1e-14, abs=1e-300)
        # Central differences with a step of 5e-6 have an error of some 1e-8 where no slope is all but zero.
        assert _worst(problem.check_partials(out_stream=None)) < 1e-7


def test_columns_pass_check_partials_too(with_columns):
    problem = _problem(with_columns)
    problem.setup()
    problem.run_model()
    assert problem["mount_force"].shape == (11,)
    assert _worst(problem.check_partials(out_stream=None)) < 1e-7


def test_every_unit_of_every_quantity_is_known_to_openmdao():
    from openmdao.utils.units import valid_units

    from plough_opt.exchange.export.openmdao import units_of

    for unit in {one.unit for one in EVERY.values()} | {one.unit.symbol for one in MEASURES.values()}:
        assert valid_units(units_of(unit)) if unit else units_of(unit) is None, unit


MODULES = """
import importlib, sys
sys.modules["plough_opt"] = None
import openmdao.api as openmdao
for folder in sys.argv[1:]:
    sys.path.insert(0, folder)
    name = folder.rpartition("_of_")[2]
    module = importlib.import_module(name)
    own = getattr(module, "".join(part[:1].upper() + part[1:] for part in name.split("_")))
    problem = openmdao.Problem(reports=None)
    problem.model.add_subsystem("share", own(), promotes=["*"])
    problem.setup()
    problem.set_val("share_height", 20.0, units="cm")
    problem.run_model()
    pairs = problem.check_partials(out_stream=None)["share"].values()
    print(float(problem["mean_draft"][0]), max(abs(pair["J_fwd"] - pair["J_fd"]).max() for pair in pairs))
assert not [name for name in sys.modules if name.startswith("plough_opt.")]
"""


@pytest.mark.thorough
def test_written_modules_need_no_plough_opt_whatever_their_names(around_r1, small, tmp_path):
    """The names of the others are those that the module itself uses."""
    components = [around_r1, *map(small, ["om", "units_of"])]
    folders = [str(write_openmdao(one, tmp_path / f"module_of_{one.name()}")) for one in components]
    done = subprocess.run([sys.executable, "-c", MODULES, *folders], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    printed = np.array(done.stdout.split(), dtype=float).reshape(-1, 2)
    assert printed[0, 0] == around_r1(share_height=0.2)["mean_draft"]
    assert printed[1:, 0].tolist() == [one(0.2) for one in components[1:]]
    assert printed[:, 1].max() < 1e-3  # of slopes of thousands of N/m
    text = (tmp_path / "module_of_share" / "share.py").read_text()
    assert "import plough_opt" not in text
    assert "out half_angle [rad] at most 0.261799" in text
    with pytest.raises(po.InputError, match="exists already"):
        write_openmdao(around_r1, folders[0])


def test_outside_the_bounds_and_without_a_finite_result_is_an_analysis_error(around_r1, not_always_finite):
    problem = _problem(around_r1)
    problem.setup()
    problem["share_height"] = 0.15 - 0.9e-6 * 0.15  # by which an optimiser may have relaxed the bound
    problem.run_model()
    for value in (0.15 - 1.1e-6 * 0.15, 0.3 + 1.1e-6 * 0.15, np.nan):
        problem["share_height"] = value
        with pytest.raises(om.AnalysisError, match=r"share_height = .* must lie between 0\.15 and 0\.3, the bounds"):
            problem.run_model()
    problem = _problem(not_always_finite)
    problem.setup()
    problem["share_height"] = 0.24
    with pytest.raises(om.AnalysisError, match="'logarithm' has no finite value"):
        problem.run_model()
