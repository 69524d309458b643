"""The command with files that ask for a lasting orbit."""

import json

import pytest

FORMS = ("periodic", "linearised", "harmonic_balance")
SLOW = ("periodic", "harmonic_balance")


@pytest.fixture
def file(cotton, tmp_path):
    """Write the subsoiler's problem file for an orbit, without a duration."""

    def file(form):
        text = cotton.read_text(encoding="utf-8")
        for old, new in (('duration = "2 s"\n', ""), ("[effects]\n", f'[effects]\norbit = "{form}"\n')):
            assert text.count(old) == 1
            text = text.replace(old, new)
        path = tmp_path / "share.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return file


@pytest.mark.parametrize("form", FORMS)
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


@pytest.mark.parametrize("form", ["linearised", *(pytest.param(form, marks=pytest.mark.slow) for form in SLOW)])
def test_optimise_saves_and_draws_an_orbit(cli, file, tmp_path, form):
    picture = tmp_path / "design.svg"
    done = cli("optimise", file(form), "--json", "--plot", picture)
    assert done.status == 0, done.err
    assert json.loads(done.out)["run"]["time"][-1] == pytest.approx(0.1, rel=1e-12)
    assert picture.stat().st_size > 1000


def test_optimise_prints_tables_of_an_orbit(cli, file):
    done = cli("optimise", file("linearised"))
    assert done.status == 0, done.err
    assert "scene.stiffness" in done.out


@pytest.mark.parametrize("command", ["check", "simulate", "optimise"])
def test_a_duration_from_outside_is_refused(cli, file, command):
    done = cli(command, file("periodic"), "--set", "scene.duration=2 s")
    assert (done.status, done.out) == (2, "")
    assert "a lasting orbit has a duration of its own" in done.err
