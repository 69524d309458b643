"""A headless Chromium, and pages opened in it from files, without a network."""

import shutil
from contextlib import contextmanager

import pytest

from helpers.extras import needs

# Without a graphics card Chromium draws WebGL by itself.
SWITCHES = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-first-run",
            "--disable-background-networking")  # fmt: skip


@contextmanager
def chromium():
    """Yield a headless Chromium; skip the test if there is none."""
    playwright = needs("playwright.sync_api")
    where = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if where is None:
        pytest.skip("there is no browser: apt-get install chromium")
    with playwright.sync_playwright() as started:
        browser = started.chromium.launch(executable_path=where, args=SWITCHES)
        yield browser
        browser.close()


def open_page(browser, written, width=1280, height=900, address="", **context):
    """Open a page in a window of a size; return it with what it wrote to the console and asked for.

    The page has computed its first results.
    """
    context = browser.new_context(viewport={"width": width, "height": height}, offline=True, **context)
    page, said, asked = context.new_page(), [], []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    # Workers start from texts in the page's own memory.
    page.on("request", lambda request: None if request.url.startswith("blob:") else asked.append(request.url))
    page.goto(written.as_uri() + address)
    page.wait_for_selector("#explore[data-ready]", state="attached")
    return page, said, asked
