"""Write docs/images/report.png, the head of the page of `plough-opt explore`, and explore.png, after a move and a pin.

python .ci/explore_picture.py
"""

import sys
import tempfile
from pathlib import Path

import plough_opt as po

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from helpers.browser import chromium, open_page  # noqa: E402  # the tests' helpers are no package


def main() -> None:
    """Open the page of the shipped example, move the design, and take the pictures."""
    with tempfile.TemporaryDirectory() as folder, chromium() as browser:
        written = po.explore(ROOT / "problems" / "cotton_subsoiler.toml", Path(folder) / "page.html")
        page, _, _ = open_page(browser, written, 880, 1400)
        page.screenshot(path=ROOT / "docs" / "images" / "report.png")
        page, _, _ = open_page(browser, written, 1280, 900, "#explore")
        page.get_by_role("button", name="Pin this design").click()
        page.evaluate("ploughOpt.set({ 'share.height': 0.3, 'scene.stiffness': 8e4 })")
        page.locator("#now_cloud").scroll_into_view_if_needed()
        page.locator("#sample", has_text="of 2000").wait_for(timeout=120_000)
        page.locator("#explore").screenshot(path=ROOT / "docs" / "images" / "explore.png")


if __name__ == "__main__":
    main()
