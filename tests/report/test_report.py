"""`plough-opt explore`: what the page says, and what it does in a real browser."""

import json
import math
import re
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from helpers.browser import open_page
from helpers.commands import printed
from helpers.problem_files import PROBLEMS, SUBSOILER, changed
from PIL import Image

import plough_opt as po

# Two variables fewer than the file has, so that the search is short.
FIXED = ("share.wedge_angle=39 deg", "share.height=0.26 m")
HOSTILE = "Subsoiler </script><script>document.title='broken'</script> & \\\"quotes\\\" <img src=http://x.invalid/a>"


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Return the report of the subsoiler for cotton, under a title that tries to break out of the page."""
    folder = tmp_path_factory.mktemp("report")
    (folder / "cotton.toml").write_text(changed(("Subsoiler for cotton on serozem", HOSTILE)), encoding="utf-8")
    printed("explore", folder / "cotton.toml", "-o", folder / "report.html", *(f"--set={text}" for text in FIXED))
    return folder / "report.html"


@pytest.fixture(scope="module")
def solved():
    """Return the optimum that the report is about, and its run."""
    return po.read_problem(SUBSOILER, FIXED).optimise(parameters=True)


class Page(HTMLParser):
    """Tags with their attributes, and the text of each section."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.text, self.section = [], {}, ""
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        self.section = dict(attributes)["id"] if tag == "section" else self.section

    def handle_data(self, data):
        self.text[self.section] = self.text.get(self.section, "") + data.replace("\u00a0", " ")


def data_of(text):
    return json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.S)[1])


def test_the_page_says_what_was_asked_and_found(written, solved):
    text = written.read_text(encoding="utf-8")
    found = Page(text).text
    best, run = solved
    for section, words in {
        "question": ["mean draft in units of 1 kN plus RMS of the mount force"],
        "answer": [f"stiffness {best.variables['scene.stiffness'] / 1e3:.4g} kN/m", f"{run.mean_draft / 1e3:.4g} kN"],
        "design": [f"{best.margins['deflection']:.3g} m", "10 kN/m to 1000 kN/m"],
        "soil": ["Syrdarya"],
        "provenance": ["share.wedge_angle=39 deg; share.height=0.26 m"],
        "warnings": ["carries", "hold within 25 %", "factor of up to 3.3", "Nothing has been validated in a field"],
        "accuracy": ["dop853"],
        "sensitivities": ["tool friction"],
    }.items():
        assert [one for one in words if one not in found[section]] == []
    for name, margin in best.margins.items():
        assert name.replace("_", " ") in found["design"]
        shown = 0.0 if abs(margin) < 1e-9 else math.degrees(margin) if name == "half_angle" else margin
        assert f"{shown:.3g}" in found["design"]
    assert "strength_wave" not in re.sub(r"<pre>.*?</pre>", "", text, flags=re.DOTALL).partition('id="data"')[0]


def test_the_pictures_hold_the_runs_own_numbers(written, solved):
    data = data_of(written.read_text(encoding="utf-8"))
    _, run = solved
    force, deflection, speed = data["charts"]
    # Six digits are written.
    assert force["series"][0]["values"] == pytest.approx(run.mount_force / 1e3, rel=1e-5)
    ends = [run.mean_draft - run.force_rms, run.mean_draft + run.force_rms]
    assert force["band"] == pytest.approx([end / 1e3 for end in ends], rel=1e-5)
    assert {"label": "limit of deflection", "value": 0.12, "dash": ""}.items() <= deflection["lines"][1].items()
    assert speed["series"][0]["values"] == pytest.approx(run.speed * 3.6, rel=1e-5)
    # The section is drawn to scale.
    half = run.scene.cone.height * run.scene.cone.slope
    (drawn,) = re.findall(r'class="cone" d="M0 0L([0-9.]+) ([0-9.]+)V', written.read_text(encoding="utf-8"))
    assert [*map(float, drawn)] == pytest.approx([run.scene.cone.height, half], rel=1e-3)


def test_no_text_leaves_its_place_and_nothing_is_asked_of_a_network(written):
    found = Page(written.read_text(encoding="utf-8"))
    assert [attributes["id"] for tag, attributes in found.tags if tag == "script" and "id" in attributes] == [
        "data",
        "engine",
    ]
    assert sum(tag == "script" for tag, _ in found.tags) == 6
    assert not [tag for tag, _ in found.tags if tag in ("img", "link", "iframe", "object")]
    assert not [one for _, one in found.tags if {"src", "srcset", "onload", "onclick"} & one.keys()]
    assert HOSTILE.replace('\\"', '"') in found.text[""]  # as a text, in the heading
    policy = next(attributes["content"] for tag, attributes in found.tags if attributes.get("http-equiv"))
    assert policy.startswith("default-src 'none'")
    # A text in the place of each picture.
    assert all(attributes["aria-label"] for tag, attributes in found.tags if tag in ("figure", "canvas"))


@pytest.fixture(scope="module")
def desk(browser, written):
    """Return the report on a desk's screen, for several tests; at the end it has said and asked for nothing."""
    page, said, asked = open_page(browser, written)
    yield page
    assert (said, asked) == ([], [written.as_uri()])


# Whether a canvas holds more than one colour.
DRAWN = Path(__file__).with_name("drawn.js").read_text(encoding="utf-8")


def test_the_page_draws(desk):
    assert desk.title().startswith("Subsoiler </script>")
    canvases = desk.locator("canvas").all()
    assert len(canvases) == desk.locator(".chart").count()
    assert all(canvas.evaluate(DRAWN) > 5 for canvas in canvases)


def test_the_motion_plays_and_steps(desk):
    motion = desk.locator("#motion")

    def time():
        return float(motion.get_attribute("data-time"))

    motion.press("ArrowRight")
    assert time() == pytest.approx(0.01)
    motion.press("Space")
    while time() < 0.05:  # it plays at a fifth of the speed
        desk.wait_for_timeout(20)
    motion.press("Space")
    motion.get_by_label("time").fill("500")
    assert time() == pytest.approx(1.0)
    assert "deflection" in motion.locator("output").inner_text()


def test_the_first_sections_say_what_was_found_and_how_far_to_trust_it(written):
    text = written.read_text(encoding="utf-8")
    sections = [attributes["id"] for tag, attributes in Page(text).tags if tag == "section"]
    assert sections[:3] == ["question", "answer", "warnings"]
    readme = (PROBLEMS.parent / "README.md").read_text(encoding="utf-8").replace("\n", " ")
    found = Page(text).text
    for fact in ("hold within 25 %", "factor of up to 3.3", "Nothing has been validated in a field"):
        assert fact in found["warnings"]
        assert fact in readme
    # One line of numerical accuracy; the rest is folded away.
    assert found["accuracy"].strip().splitlines()[1].startswith("The equations are solved to")
    assert "<details><summary>Errors and computing times" in text


# --- run.animate: a GIF whose pictures differ, and a page of its own ---


@pytest.fixture(scope="module")
def run(r1_scene, r1_wave):
    return po.simulate(r1_scene(strength_wave=r1_wave, damping=300.0), 0.3, outputs=60)


def test_a_gif_shows_the_whole_motion_slower(run, tmp_path):
    assert run.animate(tmp_path / "new" / "a.gif", slower=2.0) == tmp_path / "new" / "a.gif"
    with Image.open(tmp_path / "new" / "a.gif") as made:
        assert made.n_frames == 9  # 0.6 s of 15 pictures each
        pictures = []
        for k in range(made.n_frames):
            made.seek(k)
            # A GIF counts in hundredths of a second.
            assert made.info["duration"] == pytest.approx(600.0 / 9.0, abs=10.0)
            pictures.append(np.asarray(made.convert("RGB"), dtype=float))
    assert all(np.mean(np.abs(one - other)) > 0.1 for one, other in pairwise(pictures))


def test_a_page_holds_the_runs_own_motion(run, tmp_path):
    text = run.animate(tmp_path / "a.html").read_text(encoding="utf-8")
    data = json.loads(re.search(r'id="data">(.*?)</script>', text, re.S)[1])["motion"]
    assert data["deflection"] == pytest.approx(run.deflection, rel=1e-5)
    assert np.subtract(data["strut"], data["deflection"]) == pytest.approx(run.travel, abs=1e-5)
    assert data["waves"] == [{"amplitude": 0.3, "wavelength": 0.6, "phase": 0.0}]
    assert "default-src 'none'" in text


def test_what_cannot_be_shown_is_refused(run, r1_scene, tmp_path):
    for made, options, text in (
        (po.simulate(r1_scene(motion=False), 0.3), {"target": tmp_path / "a.gif"}, "nothing changes over time"),
        (run, {"target": tmp_path / "a.mp4"}, "end in .html or .gif"),
        (run, {"target": tmp_path / "a.gif", "slower": 0.0}, "slower"),
        (run, {"target": 3}, "must be a path"),
    ):
        with pytest.raises(po.PloughError, match=text):
            made.animate(**options)
    assert list(tmp_path.iterdir()) == []
