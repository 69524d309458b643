"""The files of an FMU: model description, documentation, C source and build description."""

import hashlib
import html
import math
from collections.abc import Iterable, Iterator
from importlib.metadata import version
from importlib.resources import files
from typing import Final
from xml.etree import ElementTree

import casadi as ca

from plough_opt.core.units import registry
from plough_opt.exchange.export.fmu_model import KINDS, Model

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


def model_description(model: Model, name: str, token: str, description: str, duration: float | None) -> bytes:
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


def documentation(model: Model, name: str, description: str, notes: Iterable[str]) -> bytes:
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


def _units(model: Model) -> Iterator[ElementTree.Element]:
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


def _variables(model: Model) -> Iterator[ElementTree.Element]:
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


def _structure(model: Model) -> Iterator[ElementTree.Element]:
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


def c_source(model: Model, *, pushes: bool, by_speed: bool) -> tuple[str, str]:
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


def _constants(model: Model, pushes: bool, by_speed: bool) -> str:
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
