"""FMU of a scene: a share on its mount for model exchange by the Functional Mock-up Interface, version 3.0."""

import io
import platform
import re
import tempfile
import zipfile
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from plough_opt.core.checks import check_choice
from plough_opt.core.compiler import compile_library, find_compiler
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
# Characters from which a source takes minutes to optimise: a density profile's, whose result is computed once in a run.
_LONG: Final = 500_000
# The earliest date of a zip file, for every entry: the same scene gives the same file.
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

    The input is the strut's speed or position, the outputs are travel, speed, deflection, mount force and soil
    resistance, and every number of soil, share, mount and effects is a parameter; see docs/fmu.md. The tool that
    imports the FMU integrates it; events of stick and slip and of entry have event indicators. The start follows from
    the parameters and from the input at that time. Parameters may change at events ("tunable").

    Args:
        scene: numeric, with motion from a start. Its tow speed is the input's default.
        path: of the FMU, ending in .fmu; an existing file is replaced, and nothing is written if anything fails.
        strut: whether the input is the strut's ``"speed"`` [m/s] or ``"position"`` [m].
        steel_density: of the share's material [kg/m^3]; the share's own mass is then a part of the scene's, computed
            from the parameters of its shape. None: the mass is a parameter of its own.
        duration: proposed duration of a simulation [s].
        name: of the model, a C identifier.
        binary: whether to compile for this machine; else the FMU contains only C source, which a tool may compile.

    Returns:
        The path.

    Raises:
        DomainError: a duration or density outside its domain.
        InputError: a scene that is not an initial value problem, symbols or arrays in it, a strut's position where its
            speed is needed, a name that is not a C identifier, no compiler, or a path that cannot be written.
    """
    target, scene, by_speed = check_file(path, ".fmu", "FMU"), _numbers(scene), strut == "speed"
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
    check_choice("strut", strut, ("speed", "position"), ", which the FMU's input is to be")
    if not _NAME.fullmatch(name):
        raise InputError(f"name = {name!r} must be a C identifier: letters, digits and _, at most 63, no digit first")
    if not scene.effects.motion:
        raise InputError("a scene without motion has nothing to integrate: an FMU needs effects with motion = True")
    if scene.effects.orbit != "transient":
        raise InputError(
            "a lasting orbit has no start to integrate from: an FMU needs effects with orbit = 'transient'"
        )
    if duration is not None:
        BESIDE["scene.duration"].check(duration)
    scene.check_reaction()


def _numbers(scene: Scene) -> Scene:
    """Return the scene with plain numbers in it."""

    def number(value: Any) -> float:
        if not is_symbolic(value) and as_number(value).size != 1:
            raise InputError(f"the scene holds an array of {as_number(value).size} values: an FMU is of one scene")
        return float(as_number(value))

    plain: Scene = map_expressions(scene, number, lambda value: is_casadi(value) or isinstance(value, np.ndarray))
    return plain


def _platform() -> tuple[str, str]:
    """Return the folder and the suffix of binaries for this machine, as FMI 3.0 names them."""
    system, processor = platform.system().lower(), platform.machine().lower()
    if system not in _SYSTEMS or processor not in _PROCESSORS:
        raise InputError(
            f"FMI has no name for binaries of {system} on {processor}: use binary=False (--sources), and let the"
            " tool compile the sources"
        )
    word, suffix = _SYSTEMS[system]
    return f"{_PROCESSORS[processor]}-{word}", suffix


def _compiled(source: str) -> bytes:
    command = find_compiler()
    if command is None:
        raise InputError(
            "no C compiler was found (cc, gcc, clang, or $CC): install one, or use binary=False (--sources) for an FMU"
            " of sources, which the importing tool compiles"
        )
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "share"
        flags = ("-std=c11", "-O0" if len(source) > _LONG else "-O1", "-fvisibility=hidden", "-ffp-contract=off")
        problem = compile_library(source, (*command, *flags), made, ("-lm",))
        if problem is not None:
            raise InputError(
                f"{command[0]} could not compile the FMU ({problem}): set $CC to another compiler, or use binary ="
                " False for an FMU of sources"
            )
        return made.read_bytes()


def _archive(content: dict[str, bytes]) -> bytes:
    """Return files as one zip archive."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for name, data in content.items():
            archive.writestr(zipfile.ZipInfo(name, _DATE), data, zipfile.ZIP_DEFLATED)
    return packed.getvalue()
