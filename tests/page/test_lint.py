"""The page's scripts by TypeScript's checker and ESLint, where npm is."""

import shutil
import subprocess

import pytest

from plough_opt.app.page import asset

pytestmark = pytest.mark.thorough

TOOLS = ("typescript@5.9", "eslint@9", "@eslint/js@9")
# The scripts of the page share one scope, and those of its workers another.
SCOPES = {
    "page": (("charts.js", "solid.js", "motion.js", "explore.js"), "declare const uPlot: any, ogl: any;"),
    "workers": (("engine.js", "worker.js"), "declare const MODEL: any, FUNCTIONS: any;"),
}
CHECKED = ("--allowJs", "--checkJs", "--noEmit", "--target", "es2022", "--lib", "es2023,dom,dom.iterable")
# TypeScript finds names without a definition, also those defined in another file of the same scope.
RULES = """
import js from "@eslint/js";
export default [{ ...js.configs.recommended, languageOptions: { sourceType: "script" }, rules: {
  ...js.configs.recommended.rules, "no-undef": "off", "no-var": "error",
  "prefer-const": ["error", { destructuring: "all" }],
  eqeqeq: ["error", "always", { null: "ignore" }],
  "no-unused-vars": ["error", { vars: "local", argsIgnorePattern: "^_", varsIgnorePattern: "^_" }],
} }];
"""


@pytest.fixture(scope="module")
def tools(tmp_path_factory):
    """Return a folder with the tools and the scripts."""
    npm, folder = shutil.which("npm"), tmp_path_factory.mktemp("scripts")
    if npm is None:
        pytest.skip("needs npm: apt-get install npm")
    install = [npm, "install", "--prefer-offline", "--no-audit", "--no-fund", "--silent", "--prefix", folder, *TOOLS]
    done = subprocess.run(install, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"npm cannot install the tools: {done.stderr.strip()[-200:]}")
    for scripts, declared in SCOPES.values():
        for name in scripts:
            (folder / name).write_text(asset(name), encoding="utf-8")
        (folder / f"{scripts[0]}.d.ts").write_text(declared, encoding="utf-8")
    (folder / "eslint.config.mjs").write_text(RULES, encoding="utf-8")
    return folder


def said(folder, tool, *arguments):
    command = [folder / "node_modules" / ".bin" / tool, *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False).stdout


@pytest.mark.parametrize("scope", SCOPES)
def test_types_agree(tools, scope):
    scripts, _ = SCOPES[scope]
    assert said(tools, "tsc", *CHECKED, f"{scripts[0]}.d.ts", *scripts) == ""


def test_no_rule_is_broken(tools):
    assert said(tools, "eslint", *(name for scripts, _ in SCOPES.values() for name in scripts)) == ""


def test_own_scripts_weigh_less_than_150_kilobytes():
    own = [name for scripts, _ in SCOPES.values() for name in scripts]
    assert sum(len(asset(name).encode()) for name in own) < 150e3
