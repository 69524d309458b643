"""The documentation as `make docs` builds it, read in headless Chromium without a network."""

import re
from pathlib import Path
from urllib.parse import unquote, urldefrag, urljoin

import pytest

import plough_opt as po

SITE = Path(__file__).parents[2] / "out" / "site"
PAGES = [path for path in sorted(SITE.rglob("*.html")) if path.parts[len(SITE.parts)] not in ("_static", "live")]
PHONE, DESK = {"width": 390, "height": 844}, {"width": 1280, "height": 900}

pytestmark = [pytest.mark.site, pytest.mark.skipif(not PAGES, reason="make docs builds the site")]


@pytest.fixture
def window(browser):
    """Return a function that opens a page; what its pages said and asked for from elsewhere is empty at the end."""
    said, opened = [], []

    def show(path, size=DESK, scheme="light"):
        context = browser.new_context(viewport=size, color_scheme=scheme, offline=True)
        context.grant_permissions(["clipboard-read", "clipboard-write"])
        opened.append(context)
        page = context.new_page()
        page.on("console", lambda message: said.append(f"{page.url}: {message.text}"))
        page.on("pageerror", lambda error: said.append(f"{page.url}: {error}"))
        page.on("request", lambda request: request.url.startswith(("http", "ws")) and said.append(request.url))
        page.on("requestfailed", lambda request: said.append(request.url))
        page.goto(Path(SITE, path).as_uri() if "//" not in str(path) else path)
        return page

    yield show
    for context in opened:
        context.close()
    assert said == []


# --- every page: links, sections, width, contrast, console ---

# Text whose contrast to what is behind it is below 4.5, or 3 for large letters (WCAG 2.1, level AA).
FAINT = Path(__file__).with_name("faint.js").read_text(encoding="utf-8")


def name_of(path):
    return path.relative_to(SITE).with_suffix("").as_posix()


@pytest.mark.parametrize("path", PAGES, ids=name_of)
def test_a_page_has_no_faint_text_and_fits_a_phone(window, path):
    page = window(path, PHONE, "dark")
    page.wait_for_function("!window.MathJax?.startup || MathJax.startup.promise.then(() => true)")
    wide = page.evaluate("document.documentElement.scrollWidth - window.innerWidth")
    assert wide <= 0
    assert page.evaluate(FAINT) == []
    page.emulate_media(color_scheme="light")
    assert page.evaluate(FAINT) == []
    assert page.locator("mjx-merror").count() == 0


TEXTS = {path: path.read_text(encoding="utf-8") for path in PAGES}
PLACES = {path: set(re.findall(r'\bid="([^"]+)"', text)) for path, text in TEXTS.items()}


@pytest.mark.parametrize("path", PAGES, ids=name_of)
def test_links_lead_somewhere_and_sections_hold_something(path):
    text, dead = TEXTS[path], []
    for link in set(re.findall(r'\b(?:href|src)="([^"]+)"', text)):
        address, place = urldefrag(urljoin(path.as_uri(), link.replace("&amp;", "&")))
        if not address.startswith("file:"):
            continue
        target = Path(unquote(address.partition("?")[0].removeprefix("file://")))
        if not target.is_file() or (place and target in PLACES and unquote(place) not in PLACES[target]):
            dead.append(link)
    assert dead == []
    assert not re.findall(r"<section[^>]*>\s*<h\d>.*?</h\d>\s*</section>", text, flags=re.DOTALL)
    assert not re.findall(r"0x[0-9a-f]{6,}", re.sub(r"<pre>.*?</pre>", "", text, flags=re.DOTALL))


# --- what a reader does ---


# The title of a page that a reader looks for, and the most pages that hold the words.
SEARCHED = {"strength wave": ("Glossary", 30), "0.15 m": ("A first design", 15), "Design.solve": ("Design", 30)}


@pytest.mark.parametrize("words", SEARCHED)
def test_the_search_finds(window, words):
    title, most = SEARCHED[words]
    page = window("index.html")
    page.fill("input[name=q]", words)
    page.keyboard.press("Enter")
    page.wait_for_function("document.querySelector('#search-results p')?.innerText.match(/found|did not match/)")
    found = page.locator("#search-results li a").all_inner_texts()
    assert title in found
    assert len(found) <= most
    if words == "Design.solve":
        assert "plough_opt.Design.solve" in found[0]


def test_code_copies_without_prompts(window):
    page = window("reference/python/design.html")
    block = page.locator("div.highlight", has_text=">>> design = po.Design()").first
    block.hover()
    block.locator("button.copybtn").click()
    page.wait_for_function("navigator.clipboard.readText().then((text) => text.includes('po.Design()'))")
    text = page.evaluate("navigator.clipboard.readText()")
    assert "import plough_opt as po" in text
    assert ">>>" not in text


def test_the_live_page_computes_inside_the_site(window):
    page = window("index.html")
    page.locator("iframe.live").scroll_into_view_if_needed()
    frame = page.frame_locator("iframe.live")
    frame.locator("#explore[data-ready]").wait_for(state="attached")
    inner = next(one for one in page.frames if one.url.partition("#")[0].endswith("cotton.html"))
    values = {"share.height": 0.3, "share.wedge_angle": po.deg(30), "scene.stiffness": 6e4}
    found = inner.evaluate("(values) => ploughOpt.evaluate(values)", values)
    problem = po.read_problem(Path(__file__).parents[2] / "problems" / "cotton_subsoiler.toml", [
        "share.height=0.3 m", "share.wedge_angle=30 deg", "scene.stiffness=60 kN/m"])  # fmt: skip
    assert found["mean_draft"] == pytest.approx(problem.simulate().mean_draft, rel=1e-6)


def test_formulas_are_set(window):
    page = window("explanation/theory.html")
    page.wait_for_selector("mjx-container")
    assert page.locator("mjx-container").count() > 50


def test_every_public_name_is_described():
    told = "".join(text for path, text in TEXTS.items() if path.parent.name == "python")
    listed = set(re.findall(r'id="(plough_opt\.[\w.]+)"', told))
    modules = [name for name in po.__all__ if type(getattr(po, name)).__name__ == "module"]
    assert {f"plough_opt.{name}" for name in po.__all__ if name not in modules} <= listed
