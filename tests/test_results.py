"""Results of every kind: printed, drawn, compared, as frames; saved with their origin as JSON that reads back equal."""

import json
import math
import platform
import re
import shutil
from dataclasses import dataclass, replace
from importlib.metadata import version

import casadi as ca
import numpy as np
import pytest
from helpers.commands import call, cells, printed
from helpers.every_result import EVERY, STILL, batch, fit, front, optimum, run
from helpers.problem_files import SUBSOILER
from helpers.scenes import Shank, scene_of
from helpers.strict_json import strict

import plough_opt as po
from plough_opt.core.expressions import exp

pandas = pytest.importorskip("pandas")


def drawn(figure):
    """Return titles, labels and limits of a figure's axes."""
    return [(a.get_title(), a.get_xlabel(), a.get_ylabel(), a.get_xlim(), a.get_ylim()) for a in figure.axes]


@pytest.mark.parametrize("name", EVERY)
def test_a_loaded_result_equals_the_saved_one(name, tmp_path):
    """The same class, text, tables, pictures and frames, and the same file if it is saved again."""
    made = EVERY[name]()
    assert type(made).__name__ == name
    path = made.save(tmp_path / "deep" / "result.json")
    saved = strict(path.read_text(encoding="utf-8"))
    assert saved["schema"] == 3
    packages = {package: version(package) for package in ("plough_opt", "casadi", "numpy")}
    assert saved["versions"].items() >= (packages | {"python": platform.python_version()}).items()
    found = po.load(str(path))
    assert type(found) is type(made)
    assert type(found).load(path).to_json() == found.to_json()
    assert (str(found), repr(found)) == (str(made), repr(made))
    assert found.save(tmp_path / "again.json").read_bytes() == path.read_bytes()
    assert found.shown_page().html() == made.shown_page().html()
    assert drawn(found.plot()) == drawn(made.plot()) != []
    pandas.testing.assert_frame_equal(found.to_dataframe(), made.to_dataframe(), check_exact=True)
    assert found.to_dataframe().attrs == made.to_dataframe().attrs
    # It shows itself briefly, and in a notebook as tables with a picture.
    assert len(repr(made)) < 200
    assert "\n" not in repr(made)
    assert name == "Rounded" or str(made).count("\n") >= 2  # a sentence, or a table
    assert not re.search(r"array\(|MX\(|object at 0x", str(made))
    html = found._repr_html_()
    assert html.count("<table>") == html.count("</table>") >= 1
    assert 'src="data:image/png;base64,' in html
    # Designs and runs can be compared by the command.
    neither = {"BatchResult", "Fit", "TradeOff", "AccuracyStudy"}
    assert call("show", path, run().save(tmp_path / "run.json")).status == (2 if name in neither else 0)


def test_a_run_prints_and_saves_its_numbers():
    made = run()
    text, saved = str(made), json.loads(made.to_json())
    assert re.search(rf"mean draft +{made.mean_draft / 1e3:.4g} kN", text)
    assert re.search(rf"RMS of the mount force +{made.force_rms / 1e3:.4g} kN", text)
    # Deflections of some and of some tens of millimetres stand beside each other in one unit.
    assert len(set(re.findall(r"deflection +[-0-9.e]+ (\w+)", text))) == 1
    assert all(f"Note: {note}." in text for note in made.warnings)
    assert saved["kind"] == "run"
    np.testing.assert_array_equal(saved["mount_force"], made.mount_force)
    assert saved["averages"]["force_rms"] == made.force_rms
    assert saved["peak_force"] == np.max(made.mount_force)
    assert saved["specific_draft"] == made.specific_draft
    assert saved["quantities"]["soil.friction_angle"] == math.radians(28.0)


def test_an_optimum_prints_and_saves_its_design_and_limits(tmp_path):
    best = optimum()
    text, saved = str(best), json.loads(best.to_json())
    assert "Best design: objective" in text
    # The height at which the front h tan(beta)/sqrt(1 - b1) reaches 0.12 m, with the four digits of results.
    height = 0.12 * math.sqrt(1.0 - STILL.soil.density_ratio) / math.tan(math.radians(10.0))
    assert best.variables["height"] == pytest.approx(height, rel=1e-8)
    assert re.search(rf"height +{1e3 * height:.4g} mm +100 mm to 500 mm", text)
    # A limit that decides has no margin.
    assert re.search(r"loosened radius +at least 0.12 m +0.12 m +0 m +decides\n", text)
    # Nor has one that is met to rounding but does not decide.
    (limit,) = (one for one in best.limits if one.name == "loosened radius")
    assert replace(limit, active=False, margin=1e-13).margin_text() == "0 m"
    assert str(best.local_optima[0]).count("\n") >= 4
    assert saved["local_optima"][0] == saved["best"]
    assert saved["best"]["variables"] == best.variables
    assert saved["run"]["averages"]["mean_draft"] == best.run.mean_draft
    found = po.load(best.save(tmp_path / "best.json"))
    assert (found.margins, found.active) == (best.margins, best.active)


def test_a_symbolic_run_shows_no_numbers():
    symbolic = po.simulate(replace(STILL, mass=ca.MX.sym("mass")), 0.1)
    assert str(symbolic) == "<Run: expressions of a scene's symbols>"
    assert "expressions" in symbolic._repr_html_()
    for refused in (symbolic.plot, symbolic.to_dataframe):
        with pytest.raises(po.InputError, match="symbolic run"):
            refused()


def test_frames_hold_the_numbers_with_their_units():
    made, best = run(), optimum()
    frame = made.to_dataframe()
    np.testing.assert_array_equal(frame["mount_force"], made.mount_force)
    assert frame.attrs["units"]["mount_force"] == "N"
    frame = best.to_dataframe()
    assert frame.loc[0, "height"] == best.variables["height"]
    assert frame.attrs["units"] == {"height": "m", "stiffness": "N/m"}
    frame = front().to_dataframe()
    np.testing.assert_array_equal(frame[["draft", "radius"]], front().objectives)
    assert frame.attrs["units"] == {"draft": "N", "radius": "m", "x": "m"}
    np.testing.assert_array_equal(batch().to_dataframe()["mean_draft"], batch().mean_draft)
    np.testing.assert_array_equal(fit().to_dataframe()["observed"], fit().observed)


def denser(r, width):
    return 1350.0 * (1.05 + 0.3 * exp(-((r / width) ** 2)))


@dataclass(frozen=True)
class Constant(po.ResistanceLaw):
    force: float
    label = "a constant force"

    def reaction(self, at):
        return po.SoilReaction(self.force + 0.0 * at.speed)


def test_what_is_the_users_own_is_only_named(tmp_path):
    """Numbers and tables are read back; to compute with a function, an effect or a law it must be given again."""
    soil = po.named_soil("serozem").with_density_profile(denser, 0.15, order=2)
    still = {"motion": False, "ambient_pressure": False}
    for scene, own, name in (
        (scene_of(soil, damping=400.0), lambda scene: scene.soil.density_profile.density, "denser"),
        (scene_of(own=(Shank(30.0),)), lambda scene: scene.effects.own[0].force, "Shank(static=30.0"),
        (scene_of(medium=Constant(500.0), **still), lambda scene: scene.law.reaction, "Constant(force=500.0)"),
    ):
        made = po.simulate(scene, 0.2)
        path = made.save(tmp_path / "own.json")
        found = po.load(path)
        assert (found.mean_draft, str(found)) == (made.mean_draft, str(made))
        assert found.save(tmp_path / "again.json").read_bytes() == path.read_bytes()
        assert po.load(path).scene == found.scene
        with pytest.raises(po.InputError, match=rf"a saved result only names '{re.escape(name)}"):
            own(found.scene)(0.0, 1.0)


# What is no result of this version is refused with a sentence that names the file.
WRONG = "is not a result of this version (schema 3)"


INVALID_FILES = [
    *((text, WRONG) for text in ("", "[]", '{"kind": "run"}')),
    *((part, "at line") for part in (0.1, 0.999)),
    *(({"schema": schema}, "schema") for schema in (1, 2, True, "3", None)),
    ({"seconds": math.nan}, "expected value at line"),
    ({"mount_force": [1.0]}, "mount_force must have a number for each output time"),
    ({"shown": {"parts": [{"columns": [], "rows": [["a"]]}]}}, "1 cells, but the table has 0 columns"),
    *((without, without) for without in ("title", "averages")),
    (b"\x89PNG\r\n\x1a\n", "cannot be read"),
    *((text, "") for text in ("[" * 100_000, '{"a":' * 100_000, f'{{"schema": 3, "x": {"[" * 3000}{"]" * 3000}}}')),
    *((f'{{"schema": {number}}}', "") for number in ("NaN", "-Infinity", "1e999", "9" * 5000)),
    *((text, "") for text in ('{"schema": 3, "kind": "\\ud800"}', "\ufeff{}", "null", '"x"', "{}{}", "\x00")),
]


@pytest.mark.parametrize(("text", "words"), INVALID_FILES, ids=range(len(INVALID_FILES)))
def test_an_invalid_file_is_refused(tmp_path, text, words):
    path = tmp_path / "result.json"
    whole = run().to_json()
    if isinstance(text, float):
        text = whole[: int(text * len(whole))]
    elif isinstance(text, dict):
        text = json.dumps(json.loads(whole) | text)
    elif text == words:
        text = json.dumps({key: value for key, value in json.loads(whole).items() if key != text})
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    refused(path, words)


def refused(path, words):
    """Check that a file is refused with some words behind its name and that of the version."""
    with pytest.raises(po.InputError, match=rf"^[^\n]*{re.escape(str(path))}[^\n]*\Z") as caught:
        po.load(path)
    message = str(caught.value)
    assert len(message.replace(str(path), "")) < 1000
    assert words in (message if words == WRONG or "(schema 3)" not in message else message.split("(schema 3)")[1])


def test_folders_and_missing_files_are_refused(tmp_path):
    refused(tmp_path, "is a folder")
    refused(tmp_path / "nothing.json", "there is no file")


# --- saved results: their origin, shown as they were printed, compared ---


QUICK = ("--set", "effects.motion=false", "--set", "scene.outputs=10")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a shipped problem file, without the lines that need motion."""
    where = tmp_path_factory.mktemp("saved")
    text = SUBSOILER.read_text(encoding="utf-8")
    still = re.sub(r"^(damping|force_rms|deflection).*\n", "", text, flags=re.MULTILINE)
    (where / "share.toml").write_text(still, encoding="utf-8")
    return where


def optimised(folder, speed):
    return "optimise", folder / "share.toml", *QUICK, "--search", "near", "--set", f'scene.tow_speed="{speed}"'


@pytest.fixture(scope="module")
def saved(folder):
    """Two optima that differ in the tow speed."""
    paths = {folder / "slow.json": "7.2 km/h", folder / "fast.json": "2.5 m/s"}
    for path, speed in paths.items():
        path.write_text(printed(*optimised(folder, speed), "--json"), encoding="utf-8")
    return [*paths]


def test_show_prints_the_same_tables(folder, saved):
    words = optimised(folder, "2.5 m/s")
    fresh, again = printed(*words).splitlines(), printed("show", saved[1]).splitlines()
    # The last line of the tables has the time that the solve took.
    assert again[: len(fresh) - 1] == fresh[:-1]
    assert again[-2].startswith("Made from share.toml (SHA-256 ")
    assert '--set scene.tow_speed="2.5 m/s"' in again[-2]
    assert "plough_opt" in again[-1]
    assert strict(printed("show", saved[1], "--json")) == strict(saved[1].read_text(encoding="utf-8"))


def test_several_designs_are_shown_side_by_side(saved, tmp_path):
    slow, fast = (po.load(path) for path in saved)
    picture = tmp_path / "both.svg"
    text = printed("show", *saved, "--plot", picture)
    # In one unit, that of the first.
    assert cells(text, "tow speed") == ["7.2 km/h", "9 km/h", "+25 %"]
    three = printed("show", *saved[::-1], shutil.copy(saved[0], tmp_path / "third.json"))
    assert cells(three, "tow speed") == ["2.5 m/s", "2 m/s", "2 m/s", "+20 %"]
    first, second = (one.run.averages.mean_draft for one in (slow, fast))
    drafts = [f"{draft / 1e3:.4g} kN" for draft in (first, second)]
    assert cells(text, "mean draft") == [*drafts, f"{100.0 * (second / first - 1.0):+.3g} %"]
    assert cells(text, "objective")[:2] == [f"{one.objective:.6g}" for one in (slow, fast)]
    # What all have alike is no row.
    assert "cohesion" not in text
    assert 'scene.tow_speed="2.5 m/s"' in text
    assert picture.stat().st_size > 5000
    found = strict(printed("show", *saved, "--json"))
    assert found["fast.json"]["share.height"] == fast.variables["share.height"]
