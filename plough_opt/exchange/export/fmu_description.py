"""modelDescription.xml and its companions of an exported share."""

from __future__ import annotations

import html
import math
from collections.abc import Iterable
from importlib.metadata import version
from xml.etree import ElementTree

from plough_opt.exchange.export.fmu_equations import Model
from plough_opt.exchange.export.fmu_variables import UNITS, Variable

_CATEGORIES = {
    "logStatusWarning": "warnings about a run",
    "logStatusError": "why a call was refused",
}
# Relative tolerance that the FMU proposes: the default error of forces.
_TOLERANCE = 1e-8


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
        f"<tr><td>{html.escape(v.name)}</td><td>{html.escape(v.unit)}</td><td>{html.escape(v.description)}</td></tr>"
        for v in (*model.names.inputs, *model.parameters, *_outputs(model))
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
    return (*model.names.states, *model.names.outputs, *model.names.discrete)


def _written(root: ElementTree.Element) -> bytes:
    ElementTree.indent(root)
    text: bytes = ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)
    return text + b"\n"


def _units(parent: ElementTree.Element, model: Model) -> None:
    used = {"s", *(variable.unit for variable in model.variables)}
    for name, unit in UNITS.items():
        if name in used:
            element = ElementTree.SubElement(parent, "Unit", name=name)
            ElementTree.SubElement(element, "BaseUnit", {base: str(power) for base, power in unit.base.items()})
            for shown, factor in unit.shown.items():
                ElementTree.SubElement(element, "DisplayUnit", name=shown, factor=repr(factor))


def _variables(parent: ElementTree.Element, model: Model) -> None:
    names, reference = model.names, _references(model)
    ElementTree.SubElement(
        parent,
        "Float64",
        name="time",
        valueReference="0",
        causality="independent",
        variability="continuous",
        unit="s",
        description="time",
    )
    for group, causality, variability, initial in (
        ((*names.states, *names.outputs), "output", "continuous", "calculated"),
        (names.rates, "local", "continuous", "calculated"),
        (names.indicators, "local", "continuous", "calculated"),
        (model.calculated, "calculatedParameter", "tunable", "calculated"),
        (names.inputs, "input", "continuous", "exact"),
        (model.parameters, "parameter", "tunable", "exact"),
        (names.discrete, "output", "discrete", "calculated"),
    ):
        for variable in group:
            attributes = {
                "name": variable.name,
                "valueReference": reference[variable.name],
                "causality": causality,
                "variability": variability,
                "initial": initial,
                "description": variable.description,
                **_numbers(variable),
            }
            if initial == "exact":
                attributes["start"] = repr(variable.start)
            if variable.derivative:
                attributes["derivative"] = reference[variable.derivative]
            if variable.name == "speed" and names.discrete:
                attributes["reinit"] = "true"
            ElementTree.SubElement(parent, "Float64", attributes)


def _numbers(variable: Variable) -> dict[str, str]:
    """Return unit, limits and order of magnitude as attributes."""
    attributes = {"nominal": repr(variable.magnitude), "unit": variable.unit, "displayUnit": variable.shown}
    for name, limit in (("min", variable.low), ("max", variable.high)):
        attributes[name] = repr(limit) if math.isfinite(limit) else ""
    return {name: text for name, text in attributes.items() if text}


def _structure(parent: ElementTree.Element, model: Model) -> None:
    names, reference = model.names, _references(model)

    def listed(kind: str, variables: Iterable[Variable]) -> None:
        for variable in variables:
            attributes = {"valueReference": reference[variable.name]}
            if kind != "InitialUnknown" and variable.name in model.depends:
                attributes["dependencies"] = " ".join(reference[on] for on in model.depends[variable.name])
            ElementTree.SubElement(parent, kind, attributes)

    unknown = (*_outputs(model), *names.rates, *model.calculated)
    listed("Output", _outputs(model))
    listed("ContinuousStateDerivative", names.rates)
    listed("InitialUnknown", sorted(unknown, key=lambda variable: int(reference[variable.name])))
    listed("EventIndicator", names.indicators)
