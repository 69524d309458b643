"""Times of the page that computes, in node: a move of a slider, and the cloud of its landscape; none is asserted."""

import json
import shutil
import subprocess

import pytest
from helpers.problem_files import SUBSOILER

import plough_opt as po
from plough_opt.app.page import asset
from plough_opt.app.page_model import page_model

pytestmark = pytest.mark.bench

# A process that has computed once answers each line by computing again; the page's workers stay as warm.
CLIENT = """
let seed = 1;
const random = () => (seed = (seed * 16807) % 2147483647) / 2147483647;
const between = ({ variable, lower, upper, value, log }) =>
  !variable ? value : log ? lower * (upper / lower) ** random() : lower + random() * (upper - lower);
const design = () => MODEL.inputs.map(between), own = engine(MODEL, FUNCTIONS);
const TASKS = {
  move: () => own.evaluate(design()).steps,
  cloud: () => Array.from({ length: 2000 }, () => own.evaluate(design(), { sketch: true })).length,
};
require("readline").createInterface({ input: process.stdin }).on("line", (task) => console.log(TASKS[task]()));
"""


@pytest.mark.parametrize(("task", "rounds"), [("move", 200), ("cloud", 10)])
def test_time(task, rounds, benchmark, tmp_path):
    node = shutil.which("node")
    if node is None:
        pytest.skip("needs node: apt-get install nodejs")
    model = page_model(po.read_problem(SUBSOILER))
    script = f"const MODEL = {json.dumps(model.data)};\n{model.functions}\n{asset('engine.js')}\n{CLIENT}"
    (tmp_path / "page.js").write_text(script, encoding="utf-8")
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([node, tmp_path / "page.js"], **pipes) as process:

        def ask():
            process.stdin.write(f"{task}\n")
            process.stdin.flush()
            return int(process.stdout.readline())

        done = benchmark.pedantic(ask, rounds=rounds, warmup_rounds=3)
        assert done >= (800 if task == "move" else 2000)  # steps of 400 intervals, designs
        process.stdin.close()
