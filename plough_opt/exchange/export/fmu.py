"""`write_fmu`: a share on its mount as a Functional Mock-up Unit for model exchange, FMI 3.0."""

import io
import platform
import re
import tempfile
import zipfile
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from plough_opt.core.checks import check_choice
from plough_opt.core.compiler import NOT_FOUND, compile_library, find_compiler
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import as_number, is_casadi, is_symbolic, map_expressions
from plough_opt.core.files import check_file, write_file
from plough_opt.core.quantities import BESIDE
from plough_opt.exchange.export.fmu_files import build_description, c_source, documentation, model_description
from plough_opt.exchange.export.fmu_model import model_of
from plough_opt.exchange.named_scene import NamedScene
from plough_opt.motion.scene import Scene

_NAME: Final = re.compile(r"[A-Za-z_]\w{0,62}", re.ASCII)
_SYSTEMS: Final = {"linux": ("linux", ".so"), "darwin": ("darwin", ".dylib"), "windows": ("windows", ".dll")}
_PROCESSORS: Final = {"x86_64": "x86_64", "amd64": "x86_64", "aarch64": "aarch64", "arm64": "aarch64"}
# A longer source (in characters) is compiled without optimisation, which would take minutes. Only a density profile
# makes one so long, and it is evaluated once in a run.
_MOST_OPTIMISED: Final = 500_000
# Every entry of the archive has the earliest date that zip files allow, so that the same scene gives the same file.
_DATE: Final = (1980, 1, 1, 0, 0, 0)


def write_fmu(
    scene: Scene,
    path: str | Path,
    *,
    strut: Literal["speed", "position"] = "speed",
    steel_density: float | None = None,
    duration: float | None = None,
    name: str = "plough_share",
    binary: bool = True,
) -> Path:
    """Write the moving share of a scene as an FMU, FMI 3.0 for model exchange.

    The input is the strut's speed or position. The outputs are travel, speed, deflection, mount force and soil
    resistance. Every number of soil, share, mount and effects is a parameter, which may change at events ("tunable");
    see docs/fmu.md. The importing tool integrates the FMU; event indicators mark stick, slip and entry. The FMU
    computes its start from the parameters and from the input at that time.

    Args:
        scene: a numeric scene with motion from a start. Its tow speed is the input's default.
        path: path of the FMU, ending in .fmu; an existing file is replaced, and nothing is written if anything fails.
        strut: which motion of the strut is the input, ``"speed"`` [m/s] or ``"position"`` [m].
        steel_density: density of the share's material [kg/m^3]. The share's own mass is then a part of the scene's and
            follows the parameters of its shape. None: the whole mass is one parameter.
        duration: proposed duration of a simulation [s].
        name: name of the model, a C identifier.
        binary: whether to compile for this machine; otherwise the FMU contains C source only, which a tool may compile.

    Returns:
        The path.

    Raises:
        DomainError: a duration or density outside its domain.
        InputError: a scene that is not an initial value problem, or that holds symbols or arrays; the strut's position
            as input where its speed is needed; a name that is not a C identifier; a missing compiler; or a path that
            cannot be written.
    """
    target, scene, by_speed = check_file(path, "FMU", ".fmu"), _numeric(scene), strut == "speed"
    _check(scene, strut, duration, name)
    model = model_of(NamedScene(scene, steel_density=steel_density), by_speed=by_speed)
    source, token = c_source(model, pushes=scene.effects.contact == "resisting", by_speed=by_speed)
    description = f"{scene.describe()}; the strut's {strut} is the input"
    content = {
        "modelDescription.xml": model_description(model, name, token, description, duration),
        "documentation/index.html": documentation(model, name, description, scene.warnings()),
        "sources/buildDescription.xml": build_description(name, f"{name}.c"),
        f"sources/{name}.c": source.encode(),
    }
    if binary:
        folder, suffix = _platform()
        content[f"binaries/{folder}/{name}{suffix}"] = _compiled(source)
    return write_file(target, "FMU", _archive(content))


def _check(scene: Scene, strut: str, duration: float | None, name: str) -> None:
    """Raise InputError or DomainError if a scene or an option cannot be exported."""
    check_choice("strut", strut, ("speed", "position"), ", the FMU's input")
    if not _NAME.fullmatch(name):
        raise InputError(f"name = {name!r} must be a C identifier: letters, digits and _, at most 63, no digit first")
    if not scene.effects.motion:
        raise InputError("a scene without motion has nothing to integrate: an FMU needs effects with motion = True")
    if scene.effects.orbit != "transient":
        raise InputError(
            "a periodic orbit has no start to integrate from: an FMU needs effects with orbit = 'transient'"
        )
    if duration is not None:
        BESIDE["scene.duration"].check(duration)
    scene.check_reaction()


def _numeric(scene: Scene) -> Scene:
    """Return the scene with every number as a float.

    Raises:
        InputError: the scene holds symbols or arrays.
    """

    def number(value: Any) -> float:
        if not is_symbolic(value) and as_number(value).size != 1:
            raise InputError(
                f"the scene holds an array of {as_number(value).size} values: an FMU holds one scene, so give one value"
            )
        return float(as_number(value))

    plain: Scene = map_expressions(scene, number, lambda value: is_casadi(value) or isinstance(value, np.ndarray))
    return plain


def _platform() -> tuple[str, str]:
    """Return folder and suffix of binaries for this machine, as FMI 3.0 names them."""
    system, processor = platform.system().lower(), platform.machine().lower()
    if system not in _SYSTEMS or processor not in _PROCESSORS:
        raise InputError(
            f"FMI 3.0 does not define binaries for {system} on {processor}: use binary=False (--sources), and let the"
            " importing tool compile the sources"
        )
    word, suffix = _SYSTEMS[system]
    return f"{_PROCESSORS[processor]}-{word}", suffix


def _compiled(source: str) -> bytes:
    """Return the shared library of a C source.

    Raises:
        InputError: there is no compiler, or it fails.
    """
    command = find_compiler()
    if command is None:
        raise InputError(
            f"{NOT_FOUND}: install one, or use binary=False (--sources) and let the importing tool compile the sources"
        )
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "share"
        optimisation = "-O0" if len(source) > _MOST_OPTIMISED else "-O1"
        flags = ("-std=c11", optimisation, "-fvisibility=hidden", "-ffp-contract=off")
        problem = compile_library(source, (*command, *flags), made, ("-lm",))
        if problem is not None:
            raise InputError(
                f"{command[0]} could not compile the FMU ({problem}): set $CC to another compiler, or use binary=False"
                " (--sources) and let the importing tool compile the sources"
            )
        return made.read_bytes()


def _archive(content: dict[str, bytes]) -> bytes:
    """Return files as one zip archive."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for name, data in content.items():
            archive.writestr(zipfile.ZipInfo(name, _DATE), data, zipfile.ZIP_DEFLATED)
    return packed.getvalue()
