"""Write the pages of the site, from this folder and the rest of the repository, to out/source, where Sphinx reads them.

Pages link as files of the repository do, so that they can be read there too; here the links become those of the site.
"""

import json
import os
import re
import shutil
from pathlib import Path

from from_code import PARTS

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
SOURCE = ROOT / "out" / "source"

# File of the repository -> page of the site.
PAGES = {
    **{path: SOURCE / path.relative_to(DOCS) for path in sorted(DOCS.rglob("*.md"))},
    **{path: SOURCE / "tutorial" / path.name for path in sorted((ROOT / "notebooks").glob("*.ipynb"))},
    ROOT / "README.md": SOURCE / "index.md",
    ROOT / "ARCHITECTURE.md": SOURCE / "explanation" / "architecture.md",
    ROOT / "CHANGELOG.md": SOURCE / "changes.md",
    ROOT / "CONTRIBUTING.md": SOURCE / "howto" / "contributing.md",
    ROOT / "problems" / "particles" / "README.md": SOURCE / "explanation" / "particles.md",
}


def on_the_site(text, file):
    """Return Markdown of a file with the links and formulas of a page of the site."""

    def link(found):
        target = (file.parent / found[1]).resolve()
        if target.is_relative_to(DOCS / "images"):
            place = SOURCE / target.relative_to(DOCS)
        else:
            place = PAGES.get(target, target)
        return f"]({Path(os.path.relpath(place, PAGES[file].parent)).as_posix()}"

    parts = re.split(r"(^```.*?^```$)", text, flags=re.DOTALL | re.MULTILINE)
    for k in range(0, len(parts), 2):
        linked = re.sub(r"\]\((?!\w+:|#)([^)#\s]+)", link, parts[k])
        parts[k] = re.sub(r"\$`([^`\n]+)`\$", r"$\1$", linked)
    return "".join(parts)


def page(file):
    """Return a page in Markdown, with what it takes from the README and from the code."""

    def included(found):
        text = (file.parent / found[1]).read_text(encoding="utf-8")
        return on_the_site(text.partition(found[2])[0], (file.parent / found[1]).resolve())

    text = on_the_site(file.read_text(encoding="utf-8"), file)
    text = re.sub(r"```\{include\} (\S+)\n:end-before: (.+)\n```", included, text)
    return re.sub(r"```\{from-code\} (\w+) ?(.*)\n```", lambda found: PARTS[found[1]](*found[2].split()), text)


def notebook(file):
    """Return a notebook with the links of the site."""
    content = json.loads(file.read_text(encoding="utf-8"))
    for cell in content["cells"]:
        if cell["cell_type"] == "markdown":
            cell["source"] = on_the_site("".join(cell["source"]), file)
    return json.dumps(content, ensure_ascii=False)


if __name__ == "__main__":
    shutil.rmtree(SOURCE, ignore_errors=True)
    shutil.copytree(DOCS / "images", SOURCE / "images")
    for file, place in PAGES.items():
        if file.name != "README.md" or file.parent != ROOT:
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_text(notebook(file) if file.suffix == ".ipynb" else page(file), encoding="utf-8")
