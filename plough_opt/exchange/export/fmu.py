"""Export of a scene as an FMU for model exchange, FMI 3.0: C source, description and binary."""

import hashlib
import html
import io
import math
import platform
import re
import tempfile
import zipfile
from collections.abc import Iterable, Iterator
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Any, Final, Literal
from xml.etree import ElementTree

import casadi as ca
import numpy as np

from plough_opt.core.checks import check_choice
from plough_opt.core.compiler import NOT_FOUND, compile_library, find_compiler
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import as_number, is_casadi, is_symbolic, map_expressions
from plough_opt.core.files import check_file, write_file
from plough_opt.core.quantities import BESIDE
from plough_opt.core.units import registry
from plough_opt.exchange.export.fmu_model import KINDS, FmuModel, model_of
from plough_opt.exchange.named_scene import NamedScene
from plough_opt.motion.scene import Scene

_CATEGORIES: Final = {
    "logStatusWarning": "warnings about a run",
    "logStatusError": "why a call was refused",
}
# Relative tolerance proposed for integration: the default error of forces.
_TOLERANCE: Final = 1e-8
# Base units: FMI's symbol -> pint's name.
_BASE_UNITS: Final = {"kg": "kilogram", "m": "meter", "s": "second", "rad": "radian"}
# Macro in the C runtime -> the kind of variables that it counts.
_COUNTS: Final = {
    "NX": "states", "NY": "outputs", "NZ": "indicators", "NC": "calculated", "NU": "inputs", "NP": "parameters",
    "ND": "discrete",
}  # fmt: skip
_NAME: Final = re.compile(r"[A-Za-z_]\w{0,62}", re.ASCII)
_SYSTEMS: Final = {"linux": ("linux", ".so"), "darwin": ("darwin", ".dylib"), "windows": ("windows", ".dll")}
_PROCESSORS: Final = {"x86_64": "x86_64", "amd64": "x86_64", "aarch64": "aarch64", "arm64": "aarch64"}
# A longer source (in characters) is compiled without optimisation, which would take minutes. Only a density profile
# makes one so long, and it is evaluated once in a run.
_MOST_OPTIMISED: Final = 500_000
# Every entry of the archive has the earliest date that zip files allow, so that the same scene gives the same file.
_DATE: Final = (1980, 1, 1, 0, 0, 0)


def model_description(model: FmuModel, name: str, token: str, description: str, duration: float | None) -> bytes:
    """Return modelDescription.xml.

    Args:
        model: the exported share.
        name: name of model and binary.
        token: instantiation token in the C source.
        description: what the FMU is, in a sentence.
        duration: proposed duration of a simulation [s], or None.
    """
    has_derivatives = str("forward_derive" in model.functions).lower()
    exchange = _tag(
        "ModelExchange",
        modelIdentifier=name,
        canGetAndSetFMUState="true",
        canSerializeFMUState="true",
        providesDirectionalDerivatives=has_derivatives,
        providesAdjointDerivatives=has_derivatives,
        needsCompletedIntegratorStep="true",
    )
    categories = (_tag("Category", name=category, description=text) for category, text in _CATEGORIES.items())
    end = {} if duration is None else {"stopTime": repr(float(duration))}
    root = _tag(
        "fmiModelDescription",
        exchange,
        _tag("UnitDefinitions", *_units(model)),
        _tag("LogCategories", *categories),
        _tag("DefaultExperiment", startTime="0.0", tolerance=repr(_TOLERANCE), **end),
        _tag("ModelVariables", *_variables(model)),
        _tag("ModelStructure", *_structure(model)),
        fmiVersion="3.0",
        modelName=name,
        instantiationToken=token,
        description=description,
        generationTool=f"plough_opt {version('plough_opt')}",
        variableNamingConvention="structured",
    )
    return _xml(root)


def build_description(name: str, source: str) -> bytes:
    """Return sources/buildDescription.xml, which tells a tool how to compile the FMU for its platform."""
    file_set = _tag("SourceFileSet", _tag("SourceFile", name=source), language="C11")
    configuration = _tag("BuildConfiguration", file_set, modelIdentifier=name)
    return _xml(_tag("fmiBuildDescription", configuration, fmiVersion="3.0"))


def documentation(model: FmuModel, name: str, description: str, notes: Iterable[str]) -> bytes:
    """Return documentation/index.html: a table of the variables, and warnings about the results."""
    rows = "\n".join(
        f"<tr><td>{html.escape(v.name)}</td><td>{html.escape(_spelled(v.unit))}</td>"
        f"<td>{html.escape(v.description)}</td></tr>"
        for v in (*model.of_kind["inputs"], *model.of_kind["parameters"], *model.visible)
    )
    items = "\n".join(f"<li>{html.escape(note)}</li>" for note in notes)
    text = (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f"<title>{html.escape(name)}</title></head><body>\n"
        f"<h1>{html.escape(name)}</h1>\n<p>{html.escape(description)}</p>\n<ul>\n{items}\n</ul>\n"
        f"<table>\n<tr><th>variable</th><th>unit</th><th>meaning</th></tr>\n{rows}\n</table>\n</body></html>\n"
    )
    return text.encode()


def _tag(name: str, /, *children: ElementTree.Element, **attributes: str) -> ElementTree.Element:
    """Return an element with its attributes and children, both in the given order."""
    element = ElementTree.Element(name, attributes)
    element.extend(children)
    return element


def _xml(root: ElementTree.Element) -> bytes:
    """Return an element as an indented XML document."""
    ElementTree.indent(root)
    text: bytes = ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)
    return text + b"\n"


def _spelled(unit: str) -> str:
    """Return a unit in FMI's spelling, such as N.s/m or m/s2."""
    return unit.replace("^", "").replace("*", ".")


def _units(model: FmuModel) -> Iterator[ElementTree.Element]:
    """Yield the variables' units in SI base units, each with the display units that its variables propose."""
    shown: dict[str, set[str]] = {"s": set()}
    for kind in KINDS:
        for variable in model.of_kind[kind]:
            shown.setdefault(variable.unit, set()).add(variable.shown)
    for unit in filter(None, shown):
        one = registry().Quantity(1.0, unit)
        powers = dict(one.to_base_units().unit_items())
        base = {symbol: f"{powers[name]:g}" for symbol, name in _BASE_UNITS.items() if name in powers}
        displays = (
            _tag("DisplayUnit", name=other, factor=repr(one.to(other).magnitude))
            for other in sorted(shown[unit] - {""})
        )
        yield _tag("Unit", _tag("BaseUnit", **base), *displays, name=_spelled(unit))


def _variables(model: FmuModel) -> Iterator[ElementTree.Element]:
    """Yield time and every variable."""
    time = {"name": "time", "valueReference": "0", "causality": "independent", "variability": "continuous"}
    yield _tag("Float64", **time, unit="s", description="time")
    for kind, (causality, variability, initial) in KINDS.items():
        for variable in model.of_kind[kind]:
            attributes = {
                "name": variable.name,
                "valueReference": model.references[variable.name],
                "causality": causality,
                "variability": variability,
                "initial": initial,
                "description": variable.description,
                "nominal": repr(variable.magnitude),
                "unit": _spelled(variable.unit),
                "displayUnit": variable.shown,
                "min": repr(variable.low) if math.isfinite(variable.low) else "",
                "max": repr(variable.high) if math.isfinite(variable.high) else "",
                "start": repr(variable.start) if initial == "exact" else "",
                "derivative": model.references.get(variable.derivative, ""),
                "reinit": "true" if variable.name == "speed" and model.of_kind["discrete"] else "",
            }
            yield _tag("Float64", **{name: text for name, text in attributes.items() if text})


def _structure(model: FmuModel) -> Iterator[ElementTree.Element]:
    """Yield outputs, rates, initial unknowns and event indicators with their dependencies."""
    of_kind, reference = model.of_kind, model.references
    unknown = (*model.visible, *of_kind["rates"], *of_kind["calculated"])
    for name, variables in (
        ("Output", model.visible),
        ("ContinuousStateDerivative", of_kind["rates"]),
        ("InitialUnknown", sorted(unknown, key=lambda variable: int(reference[variable.name]))),
        ("EventIndicator", of_kind["indicators"]),
    ):
        for variable in variables:
            attributes = {"valueReference": reference[variable.name]}
            if name != "InitialUnknown" and variable.name in model.depends:
                attributes["dependencies"] = " ".join(reference[on] for on in model.depends[variable.name])
            yield _tag(name, **attributes)


def c_source(model: FmuModel, *, pushes: bool, by_speed: bool) -> tuple[str, str]:
    """Return the C source of an FMU, and its instantiation token.

    Args:
        model: the exported share.
        pushes: whether the contact law lets soil push a retreating share; the FMU then logs a warning if it retreats.
        by_speed: whether the strut's speed is the input.
    """
    folder = files("plough_opt.exchange.export")
    runtime = (folder.joinpath(name).read_text(encoding="utf-8") for name in ("fmu_runtime.c", "fmu_optional.c"))
    # CasADi's functions are static: only the runtime in the same source calls them.
    generator = ca.CodeGenerator("share.c", {"with_header": False, "main": False, "casadi_int": "long long"})
    for function in model.functions.values():
        generator.add(function)
    equations = f"#define CASADI_SYMBOL_EXPORT static\n{generator.dump()}"
    parts = (_constants(model, pushes, by_speed), equations, *runtime)
    # The token covers what is computed; names and units are in the description only.
    token = hashlib.sha256("".join(parts).encode()).hexdigest()[:32]
    return "\n".join((f'#define TOKEN "{token}"', *parts)), token


def _constants(model: FmuModel, pushes: bool, by_speed: bool) -> str:
    """Return the C of sizes and options, and of the variables' domains, start values and orders of magnitude."""
    of_kind, functions = model.of_kind, model.functions
    counts = {count: len(of_kind[kind]) for count, kind in _COUNTS.items()} | {
        "NQ": functions["derive"].numel_out(0),
        "NW": max(function.sz_w() for function in functions.values()),
        "PUSHES": int(pushes),
        "NEEDS_SPEED": int(by_speed),
        "HAS_DERIVATIVES": int("forward_derive" in functions),
    }
    limits = ",\n".join(
        f'  {{"{one.name}", {_row((one.low, one.high))}, {int(one.above)}, {int(one.below)}}}'
        for one in of_kind["parameters"]
    )
    starts = _row(variable.start for kind in ("inputs", "parameters") for variable in of_kind[kind])
    return "\n".join(
        (
            *(f"#define {name} {count}" for name, count in counts.items()),
            "#include <math.h>",
            "typedef struct { const char *name; double low, high; int above, below; } Limits;",
            f"static const Limits limits[] = {{\n{limits}}};",
            f"static const double starts[] = {{{starts}}};",
            f"static const double nominals[] = {{{_row(variable.magnitude for variable in of_kind['states'])}}};",
        )
    )


def _row(values: Iterable[float]) -> str:
    """Return numbers as elements of a C initialiser."""
    infinite = {math.inf: "INFINITY", -math.inf: "-INFINITY"}
    return ", ".join(infinite.get(value, repr(float(value))) for value in values)


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
    see docs/howto/fmu.md. The importing tool integrates the FMU; event indicators mark stick, slip and entry. The FMU
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

    Example:
        >>> import tempfile
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
        >>> scene = po.Scene(soil, share, "50 kN/m", "30 kg", "2 m/s")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = po.export.write_fmu(scene, f"{folder}/share.fmu", binary=False)
        >>> path.name
        'share.fmu'
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
    if scene.effects.tow_profile is not None:
        raise InputError("the input of an FMU is the strut's motion: leave tow_profile out")
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
