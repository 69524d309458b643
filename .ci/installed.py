"""Run every command of the plough_opt that is installed beside this Python, in a new folder outside any repository.

python .ci/installed.py [EXTRA ...]

Without the extras, each command must work, or name the extra that it needs before it even reads a file. With the extras
`report`, `openmdao` and `parts` given, their commands must work too. Only the standard library is imported here.
"""

import importlib.metadata
import os
import re
import shlex
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

COMMAND = Path(sysconfig.get_path("scripts")) / ("plough-opt.exe" if os.name == "nt" else "plough-opt")
DATA = {
    "record.csv": "position [m],cone_index [kPa]\n"
    + "".join(f"{0.05 * k:.2f},{1000 + 300 * (k % 8 < 4)}\n" for k in range(200)),
    "draft.csv": "share.height [m],mean_draft [kN]\n0.20,2.1\n0.25,3.7\n0.30,6.2\n0.35,9.4\n",
}
TRADED = "--set trade_off=\"{mean_draft={}, loosened_radius={maximise=true}}\" --set require='{}'"
FEWER = "--set share.wedge_angle='30 deg' --set scene.stiffness='50 kN/m'"

# A command -> the file that it writes, or a text that it prints.
WORK = {
    "init a.toml": "a.toml",
    "soils": "serozem",
    "init --schema": "$schema",
    "check a.toml": "D497",
    "check a.toml --plot share.png": "share.png",
    "simulate a.toml -o run.json --plot run.png": "run.json",
    "optimise a.toml --search near -o best.json --plot best.png": "best.json",
    "show best.json --problem": "title",
    "show best.json run.json": "best.json",
    f"tradeoff a.toml --points 5 {TRADED} {FEWER}": "loosened",
    "sweep a.toml --over share.height='0.2..0.3 m:3' --workers 2 --csv swept.csv": "swept.csv",
    f"calibrate a.toml {FEWER} --data draft.csv --unknown soil.cohesion='1..80 kPa'": "cohesion",
    "accuracy a.toml --seconds 0.02 --set scene.duration='0.2 s'": "efficient",
    "export a.toml --to c -o c_code": "c_code",
    "export a.toml --to casadi -o a.casadi": "a.casadi",
    "export a.toml --to javascript -o a.mjs": "a.mjs",
    "export a.toml --to fmu --sources -o a.fmu": "a.fmu",
}
# A command -> its extra, and the file that it writes with it.
NEED = {
    "explore FILE -o page.html": ("report", "page.html"),
    "export FILE --to openmdao -o component": ("openmdao", "component"),
    "export FILE --to stl --at guess -o a.stl": ("parts", "a.stl"),
    "export FILE --to dxf --at guess -o a.dxf": ("parts", "a.dxf"),
    "export FILE --to step --at guess -o a.step": ("step", "a.step"),
    "simulate a.toml --csv run.csv": ("pandas", "run.csv"),
    "sweep FILE --over share.height='0.2..0.3 m:3' --scheduler tcp://127.0.0.1:1": ("cluster", ""),
}


def call(line: str) -> tuple[int, str]:
    """Run a command; return its exit status, and what it printed."""
    done = subprocess.run(
        [COMMAND, *shlex.split(line)], capture_output=True, encoding="utf-8", timeout=600, check=False
    )
    return done.returncode, done.stdout + done.stderr


def expect(line: str, wanted: str) -> None:
    """Run a command; exit with what it printed unless it works."""
    status, printed = call(line)
    if status or not (Path(wanted).exists() or wanted in printed):
        sys.exit(f"plough-opt {line}\nexit status {status}, and '{wanted}' is not there:\n{printed}")


def main(extras: list[str]) -> None:
    """Check the package, then the commands."""
    os.environ |= {"PYTHONUTF8": "1", "PYTHONWARNINGS": "error::DeprecationWarning:plough_opt"}
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        os.chdir(folder)
        package = importlib.metadata.distribution("plough_opt")
        tops = {file.parts[0] for file in package.files or () if "__pycache__" not in file.parts} - {".."}
        assert tops == {"plough_opt", f"plough_opt-{package.version}.dist-info"}, tops
        assert call("--version") == (0, f"plough-opt {package.version}\n")
        listed = re.findall(r"^ {4}(\w+) ", call("--help")[1], re.MULTILINE)
        tried = [line.split()[0] for line in (*WORK, *NEED)]
        assert {*listed} == {*tried}, {*listed} ^ {*tried}
        for name in listed:
            expect(f"{name} --help", "usage: plough-opt")
        for name, text in DATA.items():
            Path(name).write_text(text, encoding="utf-8")
        lines = dict(WORK) if not extras else {"init a.toml": "a.toml"}
        for line, wanted in lines.items():
            expect(line, wanted)
        for line, (extra, written) in NEED.items():
            if extra in extras:
                expect(line.replace("FILE", "a.toml"), written)
            elif not extras:
                expected = f"pip install 'plough_opt[{extra}]'"
                status, printed = call(line.replace("FILE", "missing.toml"))
                assert status == 2, (line, printed)
                assert expected in printed, (line, printed)
        count = len([extra for extra, _ in NEED.values() if extra in extras]) if extras else len(WORK) + len(NEED)
        os.chdir(Path(folder).parent)
    print(f"{count} commands")


if __name__ == "__main__":
    main(sys.argv[1:])
