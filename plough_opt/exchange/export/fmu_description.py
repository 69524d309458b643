"""modelDescription.xml and its companions of an exported share."""

import html
import math
from collections.abc import Iterable
from importlib.metadata import version
from xml.etree import ElementTree

from plough_opt.core.units import registry
from plough_opt.exchange.export.fmu_equations import KINDS, Model
from plough_opt.exchange.export.fmu_variables import Variable

_CATEGORIES = {
    "logStatusWarning": "warnings about a run",
    "logStatusError": "why a call was refused",
}
# Relative tolerance that the FMU proposes: the default error of forces.
_TOLERANCE = 1e-8
# Kind of variables -> causality, variability and initial value by FMI 3.0.
_KINDS = {
    **dict.fromkeys(("states", "outputs"), ("output", "continuous", "calculated")),
    **dict.fromkeys(("rates", "indicators"), ("local", "continuous", "calculated")),
    "calculated": ("calculatedParameter", "tunable", "calculated"),
    "inputs": ("input", "continuous", "exact"),
    "parameters": ("parameter", "tunable", "exact"),
    "discrete": ("output", "discrete", "calculated"),
}
# Base units as FMI and as pint call them.
_BASE = {"kg": "kilogram", "m": "meter", "s": "second", "rad": "radian"}


def _references(model: Model) -> dict[str, str]:
    """Return the value reference of each variable, in the order of the C source."""
    return {name: str(k) for k, name in enumerate(["time", *(variable.name for variable in model.variables)])}


def model_description(model: Model, name: str, token: str, description: str, duration: float | None) -> bytes:
    """Return modelDescription.xml.

    Args:
        model: the exported share.
        name: of model and binary.
        token: of the C source.
        description: of the FMU, in a sentence.
        duration: proposed duration of a simulation [s], or None.
    """
    root = ElementTree.Element(
        "fmiModelDescription",
        fmiVersion="3.0",
        modelName=name,
        instantiationToken=token,
        description=description,
        generationTool=f"plough_opt {version('plough_opt')}",
        variableNamingConvention="structured",
    )
    has_derivatives = str("forward_derive" in model.functions).lower()
    ElementTree.SubElement(
        root,
        "ModelExchange",
        modelIdentifier=name,
        canGetAndSetFMUState="true",
        canSerializeFMUState="true",
        providesDirectionalDerivatives=has_derivatives,
        providesAdjointDerivatives=has_derivatives,
        needsCompletedIntegratorStep="true",
    )
    _units(ElementTree.SubElement(root, "UnitDefinitions"), model)
    categories = ElementTree.SubElement(root, "LogCategories")
    for category, text in _CATEGORIES.items():
        ElementTree.SubElement(categories, "Category", name=category, description=text)
    experiment = {"startTime": "0.0", "tolerance": repr(_TOLERANCE)}
    if duration is not None:
        experiment["stopTime"] = repr(float(duration))
    ElementTree.SubElement(root, "DefaultExperiment", experiment)
    _variables(ElementTree.SubElement(root, "ModelVariables"), model)
    _structure(ElementTree.SubElement(root, "ModelStructure"), model)
    return _written(root)


def build_description(name: str, source: str) -> bytes:
    """Return sources/buildDescription.xml, with which a tool can compile the FMU for its platform."""
    root = ElementTree.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ElementTree.SubElement(root, "BuildConfiguration", modelIdentifier=name)
    file_set = ElementTree.SubElement(configuration, "SourceFileSet", language="C11")
    ElementTree.SubElement(file_set, "SourceFile", name=source)
    return _written(root)


def documentation(model: Model, name: str, description: str, notes: Iterable[str]) -> bytes:
    """Return documentation/index.html: the variables, and warnings about the results."""
    rows = "\n".join(
        f"<tr><td>{html.escape(v.name)}</td><td>{html.escape(_spelled(v.unit))}</td>"
        f"<td>{html.escape(v.description)}</td></tr>"
        for v in (*model.of_kind["inputs"], *model.of_kind["parameters"], *_outputs(model))
    )
    items = "\n".join(f"<li>{html.escape(note)}</li>" for note in notes)
    text = (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f"<title>{html.escape(name)}</title></head><body>\n"
        f"<h1>{html.escape(name)}</h1>\n<p>{html.escape(description)}</p>\n<ul>\n{items}\n</ul>\n"
        f"<table>\n<tr><th>variable</th><th>unit</th><th>meaning</th></tr>\n{rows}\n</table>\n</body></html>\n"
    )
    return text.encode()


def _outputs(model: Model) -> tuple[Variable, ...]:
    """Return the variables with the causality "output": states, forces, and the mode."""
    return tuple(one for kind in KINDS if _KINDS[kind][0] == "output" for one in model.of_kind[kind])


def _written(root: ElementTree.Element) -> bytes:
    ElementTree.indent(root)
    text: bytes = ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)
    return text + b"\n"


def _spelled(unit: str) -> str:
    """Return a unit as FMI spells it: N.s/m, m/s2."""
    return unit.replace("^", "").replace("*", ".")


def _units(parent: ElementTree.Element, model: Model) -> None:
    """Define the units of the variables by SI's base units, and those in which tools may show them instead."""
    shown: dict[str, set[str]] = {"s": set()}
    for variable in model.variables:
        shown.setdefault(variable.unit, set()).add(variable.shown)
    for unit, others in shown.items():
        if not unit:
            continue
        element = ElementTree.SubElement(parent, "Unit", name=_spelled(unit))
        powers = dict(registry().Quantity(1.0, unit).to_base_units().unit_items())
        base = {symbol: f"{powers[name]:g}" for symbol, name in _BASE.items() if name in powers}
        ElementTree.SubElement(element, "BaseUnit", base)
        for other in sorted(others - {""}):
            factor = registry().Quantity(1.0, unit).to(other).magnitude
            ElementTree.SubElement(element, "DisplayUnit", name=other, factor=repr(factor))


def _variables(parent: ElementTree.Element, model: Model) -> None:
    time = {"name": "time", "valueReference": "0", "causality": "independent", "variability": "continuous"}
    ElementTree.SubElement(parent, "Float64", time | {"unit": "s", "description": "time"})
    reference = _references(model)
    for kind in KINDS:
        causality, variability, initial = _KINDS[kind]
        for variable in model.of_kind[kind]:
            attributes = {
                "name": variable.name,
                "valueReference": reference[variable.name],
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
                "derivative": reference.get(variable.derivative, ""),
                "reinit": "true" if variable.name == "speed" and model.of_kind["discrete"] else "",
            }
            ElementTree.SubElement(parent, "Float64", {name: text for name, text in attributes.items() if text})


def _structure(parent: ElementTree.Element, model: Model) -> None:
    of_kind, reference = model.of_kind, _references(model)
    unknown = (*_outputs(model), *of_kind["rates"], *of_kind["calculated"])
    for name, variables in (
        ("Output", _outputs(model)),
        ("ContinuousStateDerivative", of_kind["rates"]),
        ("InitialUnknown", sorted(unknown, key=lambda variable: int(reference[variable.name]))),
        ("EventIndicator", of_kind["indicators"]),
    ):
        for variable in variables:
            attributes = {"valueReference": reference[variable.name]}
            if name != "InitialUnknown" and variable.name in model.depends:
                attributes["dependencies"] = " ".join(reference[on] for on in model.depends[variable.name])
            ElementTree.SubElement(parent, name, attributes)
