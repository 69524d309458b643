"""Sphinx builds the documentation from out/source, which stage.py writes, and the docstrings: see `make docs`."""

import inspect
import re
import shutil
from importlib.util import find_spec
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Literal, Union, get_args, get_origin

import numpy as np
from sphinx import search

import plough_opt

ROOT = Path(__file__).parents[1]

project = "plough_opt"
release = version = plough_opt.__version__
copyright = "the authors of plough_opt; MIT licence"
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.mathjax", "sphinx_copybutton"]
nitpicky = True

html_theme = "furo"
html_title = f"plough_opt {release}"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_js_files = ["site.js"]
html_copy_source = False
mathjax_path = "mathjax/tex-chtml.js"
copybutton_prompt_text = r">>> |\.\.\. "
copybutton_prompt_is_regexp = True

myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_fence_as_directive = ["math"]
myst_heading_anchors = 4
# The notebooks' stored outputs are shown; tests/test_pages.py runs them and compares.
nb_execution_mode = "off"
nb_merge_streams = True

default_role = "py:obj"
add_module_names = False
autodoc_default_options = {"members": True, "member-order": "bysource"}
napoleon_custom_sections = [("Attributes", "params_style")]


class English(search.SearchEnglish):
    """English in which a decimal number such as 0.15 is one word, and units of one letter are not searched for."""

    js_splitter_code = r"""var splitQuery = (query) => {
  const words = query.match(/\d+(?:\.\d+)+|[\p{Letter}\p{Number}_]+/gu) ?? [];
  const longer = words.filter((word) => word.length > 1);
  return longer.length ? longer : words;
};"""

    def split(self, text):
        """Return the words of a text."""
        return re.findall(r"\d+(?:\.\d+)+|\w+", text)


def resolve(app, env, node, content):
    """Link a public name in a docstring or signature, by whatever path it is written; show others as they are."""
    if node.get("refdomain") != "py":
        return None
    known = env.domains["py"].objects
    last = node["reftarget"].rpartition("plough_opt.")[2].split(".")
    for start in range(len(last)):
        name = ".".join(["plough_opt", *last[start:]])
        if name in known:
            return env.domains["py"].resolve_xref(env, node["refdoc"], app.builder, "obj", name, node, content)
    return content


def signature(_app, what, _name, thing, _options, given, _returned):
    """Return a signature as `help` shows it, without what annotations add for converters; none for results."""
    if not given or what not in ("class", "function", "method"):
        return None
    if what == "class" and hasattr(thing, "save"):  # a result is returned, not built
        return "", None
    own = inspect.signature(thing)
    parameters = [
        one if one.annotation is one.empty else one.replace(annotation=Written(one.annotation))
        for one in own.parameters.values()
        if one.name not in ("self", "cls")
    ]
    returned = None if what == "class" or own.return_annotation is own.empty else written(own.return_annotation)
    return str(own.replace(parameters=parameters, return_annotation=own.empty)), returned


class Written:
    """An annotation that is printed in few words."""

    def __init__(self, kind):
        self.kind = kind

    def __repr__(self):
        return written(self.kind)


def written(kind):
    """Return a type by the names that a reader knows, without what annotations add for saving and checking."""
    origin, parts = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return written(parts[0])
    if origin in (Union, UnionType):
        return " | ".join(map(written, parts))
    if origin is np.ndarray:
        return "Array"
    if origin is Literal or kind is ...:
        return ", ".join(map(repr, parts)) or "..."
    if isinstance(kind, str):
        return kind
    if isinstance(kind, list):
        return f"[{', '.join(map(written, kind))}]"
    name = "None" if kind is NoneType else getattr(origin or kind, "__name__", str(kind)).lstrip("_")
    return f"{name}[{', '.join(map(written, parts))}]" if parts else name


# What differs in the live page from run to run.
TIMES = r' · [0-9-]{10} [0-9:]{5}\+00:00|<tr><th scope="row">(?:written|time of [^<]*)</th>.*?</tr>\n?'
# In the frame on the front page only the part that computes is seen, with each name above its slider.
FRAMED = """<script>if (self !== top) document.documentElement.classList.add("framed");</script>
<style>
.framed :is(header, footer, .skip, section:not(#explore)) { display: none; }
.framed .control { grid-template-columns: minmax(0, 1fr) 6em 3.5em; }
.framed .control > span:first-child { grid-column: 1 / -1; }
</style>
"""


def finish(app, error):
    """Add MathJax with its fonts, and the live page without the times of its computation."""
    if error or app.builder.name != "html":
        return
    out = Path(app.outdir)
    mathjax = Path(find_spec("sphinx-mathjax-offline").origin).parent / "static/mathjax"
    fonts = "output/chtml/fonts/woff-v2"
    shutil.copytree(mathjax / fonts, out / "_static/mathjax" / fonts, dirs_exist_ok=True)
    shutil.copy(mathjax / "tex-chtml.js", out / "_static/mathjax")
    live = (ROOT / "out/live/cotton.html").read_text(encoding="utf-8")
    (out / "live").mkdir(exist_ok=True)
    (out / "live/cotton.html").write_text(
        re.sub(TIMES, "", live).replace("</head>", FRAMED + "</head>", 1), encoding="utf-8"
    )


def setup(app):
    """Connect what is above."""
    search.languages["en"] = English
    app.connect("missing-reference", resolve)
    app.connect("autodoc-process-signature", signature)
    app.connect("build-finished", finish)
