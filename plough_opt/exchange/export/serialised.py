"""A component as a file that CasADi alone can load."""

import json
import tempfile
from importlib.metadata import version
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from plough_opt.core.files import Content, check_file, write_files
from plough_opt.exchange.component import Component, Port
from plough_opt.exchange.component.ports import BEYOND


def write_casadi(component: Component, path: str | Path, description: str | Path | None = None) -> Path:
    """Write a component as a serialised CasADi Function and, if wanted, its names, units and bounds as JSON.

    A process with CasADi and without plough_opt loads it by ``casadi.Function.load(path)`` in Python, and by
    ``casadi::Function::load`` or ``casadi.Function.load`` in C++, MATLAB and Octave.

    Where an input lies outside its bounds, by more than the 1e-6 of their distance by which optimisers relax them, the
    results are NaN: steps and checks were not chosen for it.

    Args:
        component: what to write.
        path: of the Function, ending in .casadi; what is there is replaced.
        description: of a JSON file with names, units, bounds and accuracy, ending in .json; None: none is written.

    Returns:
        The path.

    Raises:
        InputError: another ending, or a place that cannot be written.
    """
    target = check_file(path, ".casadi", "serialised Function")
    files: dict[Path, Content] = {target: serialised(component)}
    if description is not None:
        files[check_file(description, ".json", "description")] = json.dumps(described(component), indent=2) + "\n"
    write_files(files, "serialised Function")
    return target


def serialised(component: Component) -> bytes:
    """Return the component's Function as CasADi writes it to a file; outside its bounds the results are NaN."""
    guarded = _guarded(component)
    with tempfile.TemporaryDirectory() as folder:
        written = Path(folder) / "function.casadi"
        guarded.save(str(written))
        return written.read_bytes()


def _guarded(component: Component) -> ca.Function:
    """Return the Function with NaN for its results where an input lies outside its bounds."""
    names = [port.argument for port in component.inputs]
    x = [ca.MX.sym(name) for name in names]
    slack = [BEYOND * (port.upper - port.lower) for port in component.inputs]
    inside: ca.MX = ca.MX(1)
    for value, port, more in zip(x, component.inputs, slack, strict=True):
        inside = ca.logic_and(inside, ca.logic_and(value >= port.lower - more, value <= port.upper + more))
    found = [ca.if_else(inside, result, ca.MX.nan(*result.shape)) for result in component.call(x)]
    values = {"default_in": [port.value for port in component.inputs]}
    return ca.Function(component.name(), x, found, names, [port.argument for port in component.outputs], values)


def described(component: Component) -> dict[str, Any]:
    """Return names, units, bounds and accuracy as plain data."""
    return {
        "name": component.name(),
        "inputs": [_plain(port) for port in component.inputs],
        "outputs": [_plain(port) for port in component.outputs],
        "method": component.accuracy.method,
        "steps": component.accuracy.steps,
        "error_estimate": component.error_estimate,
        "warnings": list(component.warnings),
        "versions": {package: version(package) for package in ("plough_opt", "casadi")},
    }


def _plain(port: Port) -> dict[str, Any]:
    """Return a port; a limit that it does not have is null."""
    return {
        "name": port.name,
        "argument": port.argument,
        "unit": port.unit,
        "lower": port.lower if np.isfinite(port.lower) else None,
        "upper": port.upper if np.isfinite(port.upper) else None,
        "value": port.value,
        "size": port.size,
    }
