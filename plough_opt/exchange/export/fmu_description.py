"""modelDescription.xml and its companions of an exported share."""

from __future__ import annotations

import html
import math
from collections.abc import Iterable, Iterator
from importlib.metadata import version
from xml.etree import ElementTree

from plough_opt.exchange.export.fmu_equations import Model
from plough_opt.exchange.export.fmu_variables import UNITS, Variable

_CATEGORIES = {
    "logStatusWarning": "what a user must know of a run",
    "logStatusError": "what was refused, and why",
}
# Relative tolerance that the FMU proposes, as tight as forces are told to.
_TOLERANCE = 1e-8


class References:
    """Value references: the order in which the C source knows the variables."""

    def __init__(self, model: Model) -> None:
        """Number the variables."""
        names = model.names
        groups = (
            *(names.states, names.rates, names.outputs, names.indicators, model.calculated),
            *(names.inputs, model.parameters, names.discrete),
        )
        self._numbers = {"time": 0}
        for variable in (variable for group in groups for variable in group):
            self._numbers[variable.name] = len(self._numbers)

    def __getitem__(self, name: str) -> str:
        """Return the value reference of a variable."""
        return str(self._numbers[name])


def model_description(model: Model, name: str, token: str, description: str, duration: float | None) -> bytes:
    """Return modelDescription.xml.

    Args:
        model: the exported share.
        name: of model and binary.
        token: of the C source.
        description: what the FMU is, in a sentence.
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
    """Return sources/buildDescription.xml: what a tool needs to compile the FMU for its platform."""
    root = ElementTree.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ElementTree.SubElement(root, "BuildConfiguration", modelIdentifier=name)
    file_set = ElementTree.SubElement(configuration, "SourceFileSet", language="C11")
    ElementTree.SubElement(file_set, "SourceFile", name=source)
    return _written(root)


def documentation(model: Model, name: str, description: str, notes: Iterable[str]) -> bytes:
    """Return documentation/index.html: the variables, and what a reader of the results must know."""
    rows = "\n".join(
        f"<tr><td>{html.escape(v.name)}</td><td>{html.escape(v.unit)}</td><td>{html.escape(v.description)}</td></tr>"
        for v in (*model.names.inputs, *model.parameters, *_told(model))
    )
    told = "\n".join(f"<li>{html.escape(note)}</li>" for note in notes)
    text = (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f"<title>{html.escape(name)}</title></head><body>\n"
        f"<h1>{html.escape(name)}</h1>\n<p>{html.escape(description)}</p>\n<ul>\n{told}\n</ul>\n"
        f"<table>\n<tr><th>variable</th><th>unit</th><th>meaning</th></tr>\n{rows}\n</table>\n</body></html>\n"
    )
    return text.encode()


def _told(model: Model) -> tuple[Variable, ...]:
    """Return what is an output: states, forces, and the mode."""
    return (*model.names.states, *model.names.outputs, *model.names.discrete)


def _written(root: ElementTree.Element) -> bytes:
    ElementTree.indent(root)
    text: bytes = ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)
    return text + b"\n"


def _units(parent: ElementTree.Element, model: Model) -> None:
    names = model.names
    groups = (
        names.states,
        names.rates,
        names.outputs,
        names.inputs,
        model.calculated,
        model.parameters,
        names.discrete,
    )
    used = {"s", *(variable.unit for group in groups for variable in group)}
    for name, unit in UNITS.items():
        if name in used:
            element = ElementTree.SubElement(parent, "Unit", name=name)
            ElementTree.SubElement(element, "BaseUnit", {base: str(power) for base, power in unit.base.items()})
            for shown, factor in unit.shown.items():
                ElementTree.SubElement(element, "DisplayUnit", name=shown, factor=repr(factor))


def _variables(parent: ElementTree.Element, model: Model) -> None:
    names, reference = model.names, References(model)
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
    told = (*names.states, *names.outputs)
    for group, causality, variability, initial in (
        (told, "output", "continuous", "calculated"),
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
    """Return unit, limits and order of magnitude."""
    found = {"nominal": repr(variable.magnitude)}
    if variable.unit:
        found["unit"] = variable.unit
    if variable.shown:
        found["displayUnit"] = variable.shown
    found |= {
        name: repr(value) for name, value in (("min", variable.low), ("max", variable.high)) if math.isfinite(value)
    }
    return found


def _structure(parent: ElementTree.Element, model: Model) -> None:
    names, reference = model.names, References(model)

    def listed(kind: str, variables: Iterable[Variable]) -> None:
        for variable in variables:
            attributes = {"valueReference": reference[variable.name]}
            if kind != "InitialUnknown" and variable.name in model.depends:
                attributes["dependencies"] = " ".join(reference[on] for on in model.depends[variable.name])
            ElementTree.SubElement(parent, kind, attributes)

    listed("Output", _told(model))
    listed("ContinuousStateDerivative", names.rates)
    listed("InitialUnknown", _ordered(reference, (*_told(model), *names.rates, *model.calculated)))
    listed("EventIndicator", names.indicators)


def _ordered(reference: References, variables: Iterable[Variable]) -> Iterator[Variable]:
    yield from sorted(variables, key=lambda variable: int(reference[variable.name]))
