"""The command with files that ask for a periodic orbit."""

import json

import pytest


@pytest.fixture
def file(cotton, tmp_path):
    """Write the subsoiler's problem file for an orbit, without a duration."""

    def file(form):
        text = cotton.read_text(encoding="utf-8").replace('duration = "2 s"\n', "")
        path = tmp_path / "share.toml"
        path.write_text(text.replace("[effects]\n", f'[effects]\norbit = "{form}"\n'), encoding="utf-8")
        return path

    return file


@pytest.mark.parametrize("form", ["periodic", "linearised", "harmonic_balance"])
def test_simulate_reports_saves_and_draws_an_orbit(cli, file, tmp_path, form):
    picture = tmp_path / "orbit.svg"
    shown = cli("simulate", file(form))
    saved = cli("simulate", file(form), "--json", "--plot", picture)
    assert shown.status == saved.status == 0
    assert "mean draft" in shown.out
    assert ("a share from equilibrium" in shown.out) == (form == "periodic")
    run = json.loads(saved.out)
    assert run["time"][-1] == pytest.approx(0.1, rel=1e-12)
    assert run["mount_force"][-1] == pytest.approx(run["mount_force"][0], rel=1e-10)
    assert (run["error_estimate"] <= 1e-8) == (form == "periodic")
    assert picture.stat().st_size > 1000


@pytest.mark.parametrize(
    "form", ["linearised", *(pytest.param(form, marks=pytest.mark.slow) for form in ("periodic", "harmonic_balance"))]
)
def test_optimise_saves_and_draws_an_orbit(cli, file, tmp_path, form):
    picture = tmp_path / "design.svg"
    done = cli("optimise", file(form), "--json", "--search", "near", "--plot", picture)
    assert done.status == 0, done.err
    assert json.loads(done.out)["run"]["time"][-1] == pytest.approx(0.1, rel=1e-12)
    assert picture.stat().st_size > 1000
