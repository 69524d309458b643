"""Build the wheel and the source archive, check them, and try the wheel in a clean environment of each Python found.

python .ci/dist.py [PYTHON ...]

The tools build, twine, check-wheel-contents and uv stand beside the Python that runs this. Interpreters other than
those on the path or below ~/.pyenv can be given. A supported version without an interpreter is named, and no failure.
"""

import datetime
import hashlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DIST = ROOT / "dist"
LIMIT = 1_000_000  # bytes of each file
# Extras whose commands are tried too, in the first environment: their libraries are small, or wanted by other programs.
EXTRAS = ("report", "openmdao", "parts")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def run(*command: str | Path, **options) -> str:
    """Run a command and return what it prints; exit with all of it if the command fails."""
    done = subprocess.run([*map(str, command)], capture_output=True, text=True, check=False, **options)
    if done.returncode:
        sys.exit(f"{' '.join(map(str, command))}\n{done.stdout}{done.stderr}")
    return done.stdout


def tool(name: str) -> Path:
    """Return the path of a tool beside this Python."""
    return Path(sys.executable).parent / name


def built(source: Path, to: Path, *parts: str) -> dict[str, bytes]:
    """Build the project of a folder, dated as its release; return name -> content of the files."""
    changes = (source / "CHANGELOG.md").read_text(encoding="utf-8")
    released = re.search(rf"^## \[{re.escape(PROJECT['version'])}\] - (\S+)$", changes, re.MULTILINE)[1]
    day = datetime.datetime.fromisoformat(released).replace(tzinfo=datetime.UTC)
    dated = os.environ | {"SOURCE_DATE_EPOCH": f"{day.timestamp():.0f}"}
    run(sys.executable, "-m", "build", "--installer", "uv", *parts, "--outdir", to, source, env=dated)
    return {path.name: path.read_bytes() for path in sorted(to.iterdir())}


def build() -> Path:
    """Build both files twice, check them, write them and the recipe into dist/, and return the wheel."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "copy"
        shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(".git", ".venv*", "dist", "out", "__pycache__"))
        for path in copy.rglob("*"):
            os.utime(path, (1e9, 1e9))
        # First the archive and from it the wheel, then both from another folder with files of another time.
        files = built(ROOT, Path(folder) / "first")
        again = built(copy, Path(folder) / "second", "--sdist", "--wheel")
    assert len(files) == 2
    assert files == again, "two builds differ"
    shutil.rmtree(DIST, ignore_errors=True)
    DIST.mkdir()
    for name, content in files.items():
        (DIST / name).write_bytes(content)
        print(f"{name}: {len(content) / 1e3:.0f} kB, the same in two builds")
        assert len(content) < LIMIT, f"{name} has {LIMIT / 1e6:g} MB or more"
    wheel, archive = sorted(DIST.iterdir(), key=lambda path: path.suffix != ".whl")
    names = [path.relative_to(ROOT) for path in (wheel, archive)]
    print(run(tool("twine"), "--no-color", "check", "--strict", *names, cwd=ROOT).strip())
    print(run(tool("check-wheel-contents"), wheel.relative_to(ROOT), cwd=ROOT).strip())
    recipe = (ROOT / ".ci" / "recipe" / "recipe.yaml").read_text(encoding="utf-8")
    checksum = hashlib.sha256(archive.read_bytes()).hexdigest()
    (DIST / "recipe.yaml").write_text(recipe.replace("SHA256", checksum), encoding="utf-8")
    return wheel


def works(python: str | Path) -> bool:
    """Return True if an interpreter starts; pyenv puts commands on the path that do not."""
    return subprocess.run([python, "-c", ""], capture_output=True, check=False).returncode == 0


def interpreters(given: list[str]) -> dict[str, Path]:
    """Return version -> interpreter of every supported version that is found here."""
    versions = re.findall(r"Python :: (3\.\d+)", " ".join(PROJECT["classifiers"]))
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    found = {}
    for version in versions:
        on_path = shutil.which(f"python{version}")
        places = [*([on_path] if on_path else []), *sorted(pyenv.glob(f"{version}.*/bin/python"))]
        if working := [Path(place) for place in places if works(place)]:
            found[version] = working[0]
    for python in given:
        version = run(python, "-c", "import sys; print(*sys.version_info[:2], sep='.')").strip()
        found[version] = Path(python)
    for version in versions:
        if version not in found:
            print(f"Python {version}: no interpreter here, not tried")
    return dict(sorted(found.items()))


def tried(version: str, python: Path, wheel: Path, extras: tuple[str, ...]) -> str:
    """Install the wheel into a clean environment and run the commands; return a line of the table."""
    with tempfile.TemporaryDirectory() as folder:
        run(tool("uv"), "venv", "--python", python, "env", cwd=folder)
        inside = Path(folder) / "env" / "bin" / "python"
        install = (tool("uv"), "pip", "install", "--python", inside)
        start = time.perf_counter()
        run(*install, wheel, cwd=folder)
        took = time.perf_counter() - start
        check = (inside, ROOT / ".ci" / "installed.py")
        line = f"Python {version}: installed in {took:.0f} s, core alone: {run(*check, cwd=folder).strip()}"
        if extras:
            run(*install, f"{wheel}[{','.join(extras)}]", cwd=folder)
            line += f", with {', '.join(extras)}: {run(*check, *extras, cwd=folder).strip()}"
    return line


def main() -> None:
    """Build, check and try."""
    wheel = build()
    found = interpreters(sys.argv[1:])
    with ThreadPoolExecutor(2) as pool:
        extras = [EXTRAS if number == 0 else () for number in range(len(found))]
        for line in pool.map(tried, found, found.values(), [wheel] * len(found), extras):
            print(line, flush=True)


if __name__ == "__main__":
    main()
