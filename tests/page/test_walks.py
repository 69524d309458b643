"""The page that computes, in a headless Chromium as a person uses it."""

import csv
import json
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from helpers.browser import open_page
from helpers.commands import printed
from helpers.problem_files import STATIC, SUBSOILER, changed

import plough_opt as po

HOSTILE = "</script><script>document.title='broken'</script> <img src=x onerror=alert(1)>"
SPRINGS = 'catalogue = ["40 kN/m", "50 kN/m", "63 kN/m", "80 kN/m"]'
HEIGHT = "share height"


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Return the page of the subsoiler for cotton with a catalogue, under a title that tries to break out of it."""
    folder = tmp_path_factory.mktemp("explore")
    text = changed(("Subsoiler for cotton on serozem", HOSTILE), ("log = true }", f"log = true, {SPRINGS} }}"))
    (folder / "cotton.toml").write_text(text, encoding="utf-8")
    return po.explore(folder / "cotton.toml", folder / "page.html")


@pytest.fixture
def opened(browser):
    """Return a function that opens a page; at the end the pages have said nothing and asked for nothing."""
    every = []

    def opened(written, *arguments, **context):
        every.append((*open_page(browser, written, *arguments, **context), written))
        return every[-1][0]

    yield opened
    for page, said, asked, written in every:
        assert (said, {*asked}) == ([], {written.as_uri()})
        page.context.close()


@pytest.fixture
def walk(opened, written):
    return opened(written)


def state(page):
    return page.evaluate("ploughOpt.state()")


def cell(page, name, column=0):
    """Return the text of a result in the table."""
    row = page.locator("#table tbody tr").filter(has=page.get_by_role("rowheader", name=name, exact=True))
    return row.locator("td").nth(column).inner_text()


def settled(page):
    """Wait until the last move has been answered."""
    page.evaluate("() => ploughOpt.set({})")


def slider(page, name):
    return page.get_by_role("slider", name=name, exact=True)


def test_a_slider_is_dragged_and_the_results_are_those_of_simulate(walk):
    handle = slider(walk, HEIGHT)
    for _ in range(3):  # what is still being drawn above the slider may move it under the mouse
        settled(walk)
        handle.scroll_into_view_if_needed()
        box = handle.bounding_box()
        walk.mouse.move(box["x"] + 0.38 * box["width"], box["y"] + box["height"] / 2)
        walk.mouse.down()
        walk.mouse.move(box["x"] + 0.7 * box["width"], box["y"] + box["height"] / 2, steps=8)
        walk.mouse.up()
        settled(walk)
        if state(walk)["share.height"] > 0.3:
            break
    values = state(walk)
    assert values["share.height"] > 0.3
    run = po.read_problem(SUBSOILER).simulate(values)
    assert cell(walk, "mean draft") == f"{run.mean_draft / 1e3:.4g} kN"
    assert cell(walk, "peak deflection") == f"{run.peak_deflection:.4g} m"
    assert f"share.height={values['share.height']}" in walk.url
    best = float(cell(walk, "mean draft", 2).split()[0])
    from_best = float(cell(walk, "mean draft", 1).strip("+ %"))
    assert from_best == pytest.approx(100.0 * (run.mean_draft / 1e3 / best - 1.0), abs=0.1)
    found = walk.evaluate("v => ploughOpt.evaluate(v)", values)
    assert found["force_rms"] == pytest.approx(run.force_rms, rel=1e-6)
    assert found["mount_force"] == pytest.approx(run.mount_force, rel=1e-6)


NO_NUMBERS = ["abc", "300 mm", "", "0.3.1"]


def test_values_are_typed_with_a_decimal_comma_and_wrong_ones_named_and_kept_in_the_page(walk):
    field = walk.get_by_label(f"{HEIGHT} in m", exact=True)
    field.fill("0,31")
    settled(walk)
    assert state(walk)["share.height"] == 0.31
    command, draft = walk.locator("#command").input_value(), cell(walk, "mean draft")
    for text in [*NO_NUMBERS, "-0.31"]:
        field.fill(text)
        words = f"'{text}' is not a number: write one in m" if text in NO_NUMBERS else f"= {text} m must be above"
        walk.locator(".wrong", has_text=words).wait_for()
        assert field.get_attribute("aria-invalid") == "true"
        assert walk.locator("#table thead").inner_text().split("\t")[1].strip() == "last valid"
        assert (walk.locator("#command").input_value(), cell(walk, "mean draft")) == (command, draft)
        for name in ("Problem file", "CSV", "SVG", "STL", "Copy the command", "Pin this design"):
            assert walk.get_by_role("button", name=name, exact=True).is_disabled()
    field.fill("0.3")
    settled(walk)
    assert (walk.locator(".wrong:not(:empty)").count(), field.get_attribute("aria-invalid")) == (0, "false")
    assert walk.locator("#table thead").inner_text().split("\t")[1].strip() == "now"
    assert walk.get_by_role("button", name="CSV", exact=True).is_enabled()


def test_a_design_of_the_landscape_is_taken_by_a_click_and_left_by_going_back(walk):
    before = state(walk)
    cloud = walk.locator("#now_cloud")
    cloud.scroll_into_view_if_needed()
    walk.locator("#sample", has_text="of 2000").wait_for(timeout=60_000)
    assert "better half" in walk.locator("#sample").inner_text()
    over = cloud.locator(".u-over")
    size = over.bounding_box()
    over.click(position={"x": 0.3 * size["width"], "y": 0.93 * size["height"]})
    settled(walk)
    assert state(walk) != before
    walk.go_back()
    walk.wait_for_function("before => JSON.stringify(ploughOpt.state()) === JSON.stringify(before)", arg=before)
    walk.locator("#across").select_option(label="stiffness")
    walk.locator("#up").select_option(label="mean deflection")
    assert "half" not in walk.locator("#sample").inner_text()
    assert cloud.locator("canvas").count() == 1


def test_the_keyboard_alone_moves_pins_and_undoes(walk):
    before = state(walk)
    slider(walk, "stiffness").focus()
    for _ in range(2):  # from the spring next to the best
        walk.keyboard.press("ArrowRight")
    settled(walk)
    assert state(walk)["scene.stiffness"] == 80e3
    walk.get_by_role("button", name="Pin this design").press("Enter")
    assert cell(walk, "stiffness", 3) == cell(walk, "stiffness")
    walk.get_by_role("button", name="remove pin 1").press("Enter")
    assert walk.locator("#table thead th").count() == 4
    walk.get_by_role("link", name="Explore").press("Enter")  # leads there, and leaves the design
    assert state(walk) != before
    while walk.get_by_role("button", name="Undo").is_enabled():
        walk.get_by_role("button", name="Undo").press("Enter")
        walk.evaluate("ploughOpt.set({})")
    settled(walk)
    assert state(walk) == before


def test_an_effect_is_switched_off_with_what_it_does_and_costs(walk):
    walk.locator("summary", has_text="effects on and off").click()
    says = walk.locator(".switch", has_text="damping").locator(".small")
    says.filter(has_text="operations in the equation").wait_for()
    told = says.inner_text()
    walk.get_by_role("checkbox", name="damping", exact=True).uncheck()
    settled(walk)
    problem = po.read_problem(SUBSOILER, ["effects.damping=0 N*s/m"])
    run = problem.simulate({name: value for name, value in state(walk).items() if name != "effects.damping"})
    assert cell(walk, "RMS of the mount force") == f"{run.force_rms / 1e3:.4g} kN"
    change = float(cell(walk, "RMS of the mount force", 1).strip("+ %"))
    assert f"without it: mean draft {cell(walk, 'mean draft', 1)}, RMS of the mount force +{change:.4g} %" in told
    head = walk.locator("#table thead").inner_text()
    assert "now, without damping" in head
    assert "best, file’s question" in head
    assert walk.locator("#command").input_value().endswith("""--set 'effects.damping="0 N*s/m"'""")
    walk.reload()
    walk.wait_for_selector("#explore[data-ready]", state="attached")
    assert walk.evaluate("ploughOpt.effects().damping") is False
    walk.evaluate("ploughOpt.switch('damping')")
    settled(walk)
    assert cell(walk, "RMS of the mount force", 1) == "0 %"


def test_a_link_opens_the_same_design(walk, opened, written):
    walk.evaluate("ploughOpt.set({ 'scene.tow_speed': 2.5, 'share.height': 0.3 })")
    settled(walk)
    again = opened(written, address="#" + walk.url.partition("#")[2])
    assert state(again) == state(walk)
    assert again.locator("#table thead").inner_text().count("file’s question") == 1
    command = again.locator("#command").input_value()
    assert command.endswith("--set 'scene.tow_speed=\"9 km/h\"'")


def test_a_local_search_improves_and_says_what_it_is(walk):
    walk.evaluate("ploughOpt.set({ 'share.wedge_angle': 0.6, 'share.height': 0.35, 'scene.stiffness': 1e5 })")
    settled(walk)
    before = float(cell(walk, "objective"))
    walk.get_by_role("button", name="Find better from here").click()
    walk.locator("#status", has_text="local and certifies nothing").wait_for(timeout=60_000)
    assert float(cell(walk, "objective")) < before
    assert walk.locator("#lights .bad").count() == 0


def test_what_is_downloaded_can_be_read(walk, tmp_path):
    walk.evaluate("ploughOpt.set({ 'scene.tow_speed': 2.5, 'soil.cohesion': 25e3, 'share.height': 0.3 })")
    settled(walk)
    files = {}
    for name in ("Problem file", "CSV", "SVG", "STL"):
        with walk.expect_download() as download:
            walk.get_by_role("button", name=name, exact=True).click()
        files[name] = tmp_path / download.value.suggested_filename
        download.value.save_as(files[name])
    problem = po.read_problem(files["Problem file"])
    assert problem.values()["scene.tow_speed"] == pytest.approx(2.5)
    assert problem.title == HOSTILE
    run = problem.simulate()
    assert cell(walk, "mean draft") == f"{run.mean_draft / 1e3:.4g} kN"
    rows = list(csv.reader(files["CSV"].read_text().splitlines()))
    column = rows[0].index("mount_force [N]")
    assert [float(row[column]) for row in rows[1:]] == pytest.approx(run.mount_force, rel=1e-6)
    assert len(ET.parse(files["SVG"]).getroot().findall("{*}polyline")) == 2
    mesh = run.scene.share.mesh()
    corners = [line.split()[1:] for line in files["STL"].read_text().splitlines() if line.startswith("vertex")]
    assert np.array(corners, dtype=float) == pytest.approx(1e3 * mesh.vertices[mesh.triangles.ravel()], rel=1e-5)


def test_hostile_names_are_texts(walk):
    assert walk.title().startswith("</script>")
    assert walk.locator("h1").inner_text() == HOSTILE
    assert walk.locator("img").count() == 0


def test_a_phone_in_the_dark_and_paper_show_the_page(opened, written):
    page = opened(written, 390, 844, "#explore", color_scheme="dark")
    assert page.evaluate("document.documentElement.scrollWidth") == 390
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(18, 25, 31)"
    page.emulate_media(media="print")
    assert not page.locator("#explore").is_visible()
    assert page.locator("#answer").is_visible()


def test_without_scripts_the_report_is_readable(browser, written):
    context = browser.new_context(java_script_enabled=False, offline=True)
    page = context.new_page()
    page.goto(written.as_uri())
    assert "Best design" in page.locator("#answer").inner_text()
    assert not page.locator("#explore").is_visible()
    context.close()


def test_the_command_opens_the_page_in_the_cache_folder(tmp_path, monkeypatch):
    opened = []
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr("webbrowser.open", opened.append)
    file = tmp_path / "cotton.toml"
    file.write_text(STATIC, encoding="utf-8")
    printed("explore", file, "-q")
    (page,) = (tmp_path / "cache").rglob("*.html")
    assert opened == [f"{page.as_uri()}#explore"]
    wrote = json.loads(printed("explore", file, "--json"))["wrote"]
    assert (wrote, len(opened)) == ([str(page)], 1)
