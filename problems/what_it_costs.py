"""What a user waits for: processor time of commands and calls, as a table.

    python problems/what_it_costs.py --times 3

A unit is the processor time of `python -c "import casadi, numpy"`, which is measured between the rows. Every row runs
in a fresh process, one after another, and the least of several times counts, so that other work on the machine
disturbs little. Libraries are compiled to bytecode, as after their first use. Calls are timed without the imports and
after two calls like them.
"""

import argparse
import os
import platform
import subprocess
import sys
import tempfile
from datetime import UTC, datetime
from pathlib import Path

HERE = Path(__file__).resolve().parent
UNIT = [sys.executable, "-c", "import casadi, numpy"]
COTTON, REFERENCE = HERE / "cotton_subsoiler.toml", HERE / "reference.toml"
SAMPLES = 20_000

COMMANDS = {
    "`plough-opt --help`": ["--help"],
    "`plough-opt --version`": ["--version"],
    "`plough-opt check problems/cotton_subsoiler.toml`": ["check", COTTON],
    "`plough-opt simulate problems/cotton_subsoiler.toml`": ["simulate", COTTON],
    "`plough-opt optimise problems/cotton_subsoiler.toml`": ["optimise", COTTON],
    "`plough-opt explore problems/cotton_subsoiler.toml -o page.html`": ["explore", COTTON, "-o", "page.html"],
    "`plough-opt optimise problems/uncertain_field.toml`": ["optimise", HERE / "uncertain_field.toml"],
    "`plough-opt tradeoff problems/draft_oscillation_loosening.toml`": [
        "tradeoff", HERE / "draft_oscillation_loosening.toml",
    ],
    f"`plough-opt sweep problems/cotton_subsoiler.toml`, {SAMPLES} designs": [
        "sweep", COTTON, "--samples", SAMPLES, "--workers", "1", "--csv", "swept.csv",
        "--over", 'share.height="0.2..0.4 m"', "--over", 'scene.stiffness="10..1000 kN/m log"',
    ],
    "the same with `--plot`": [
        "sweep", COTTON, "--samples", SAMPLES, "--workers", "1", "--csv", "swept.csv", "--plot", "swept.png",
        "--over", 'share.height="0.2..0.4 m"', "--over", 'scene.stiffness="10..1000 kN/m log"',
    ],
}  # fmt: skip

TIMED = f"""
import sys, time
import plough_opt as po

def timed(call, count):
    call(), call()
    began = time.process_time()
    for _ in range(count):
        call()
    print((time.process_time() - began) / count)

reference = po.read_problem({str(REFERENCE)!r})
scene, design = reference.scene(), reference.design()[0]
others = iter([reference.scene({{"scene.stiffness": 4e4 + 10.0 * k}}) for k in range(202)])
front = po.read_problem({str(HERE / "force_against_deflection.toml")!r})
"""

CALLS = {
    "`po.simulate(scene, 2.0, compiled=True)`, the same scene": "po.simulate(scene, 2.0, compiled=True), 200",
    "the same, a new scene each time": "po.simulate(next(others), 2.0, compiled=True), 200",
    "`po.simulate(scene, 2.0)`": "po.simulate(scene, 2.0), 100",
    "`po.simulate(scene, 2.0, accuracy=po.Accuracy(error=1e-6))`":
        "po.simulate(scene, 2.0, accuracy=po.Accuracy(error=1e-6)), 100",
    '`design.solve(search="near", compiled=True)` of `problems/reference.toml`, again':
        "design.solve(search='near', compiled=True), 10",
    "`design.solve(compiled=True)`, again": "design.solve(compiled=True), 5",
    "`problem.trade_off(64)` of `problems/force_against_deflection.toml`, 50 designs": "front.trade_off(64), 3",
}  # fmt: skip

# Tools that are faster at a row, each by its time over ours: from `make bench`, which says how they are called.
FASTER = {
    "`po.simulate(scene, 2.0, compiled=True)`, the same scene": "heyoka.py (without an estimate)",
    "the same, a new scene each time": "heyoka.py, Numba RK4 (without an estimate)",
    '`design.solve(search="near", compiled=True)` of `problems/reference.toml`, again': "SLSQP on Numba RK4",
    "`design.solve(compiled=True)`, again": "SLSQP on Numba RK4 from five starts",
}


# Without bytecode, as in some containers, imports take three times as long, and so does the unit. The threads that
# NumPy starts at its import would add half a unit to the unit, and the command line starts none.
ENVIRONMENT = {name: text for name, text in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
ENVIRONMENT["OPENBLAS_NUM_THREADS"] = "1"


def spent(command: list[str], folder: str) -> tuple[float, float, str]:
    """Return the processor time [s] of a command, its largest memory [MB], and what it prints."""
    with subprocess.Popen(
        command, cwd=folder, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as started:
        assert started.stdout is not None
        printed = started.stdout.read()
        _, status, usage = os.wait4(started.pid, 0)
        started.returncode = os.waitstatus_to_exitcode(status)
    if started.returncode:
        raise SystemExit(f"{' '.join(command)} ended with status {started.returncode}")
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024.0, printed


def main() -> None:
    """Measure every row, and print them as a table in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=3, help="how often each row is measured (default: 3)")
    parser.add_argument("--only", default="", help="only rows whose text contains this")
    options = parser.parse_args()
    commands = {
        name: [sys.executable, "-m", "plough_opt", *map(str, arguments)] for name, arguments in COMMANDS.items()
    }
    calls = {name: [sys.executable, "-c", f"{TIMED}timed(lambda: {call})"] for name, call in CALLS.items()}
    rows = {name: row for name, row in {**commands, **calls}.items() if options.only in name}
    units: list[float] = []
    seconds, memory = dict.fromkeys(rows, float("inf")), dict.fromkeys(rows, 0.0)
    for _ in range(options.times):
        for name, row in rows.items():
            with tempfile.TemporaryDirectory() as folder:
                units.append(spent(UNIT, folder)[0])
                taken, most, printed = spent(row, folder)
            seconds[name] = min(seconds[name], float(printed) if name in calls else taken)
            memory[name] = max(memory[name], most)
    unit = min(units)
    when = datetime.now(UTC).strftime("%-d %B %Y")
    print(f"{when}, {platform.machine()}, Python {platform.python_version()}; a unit is {unit:.2f} s.\n")
    print("| | units | MB | faster |\n|---|---|---|---|")
    for name in rows:
        own = seconds[name] / unit
        shown = f"{own:.0f}" if own >= 100.0 else f"{own:.2g}"
        print(f"| {name} | {shown} | {memory[name]:.0f} | {FASTER.get(name, '')} |")


if __name__ == "__main__":
    main()
