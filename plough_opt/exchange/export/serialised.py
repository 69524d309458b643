"""A component as a serialised CasADi Function, which CasADi loads without plough_opt."""

import json
import tempfile
from importlib.metadata import version
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from plough_opt.core.files import Content, check_file, write_files
from plough_opt.exchange.component import Component, Port
from plough_opt.exchange.component.component import RELAXATION


def write_casadi(component: Component, path: str | Path, description: str | Path | None = None) -> Path:
    """Write a component as a serialised CasADi Function and, if wanted, its names, units and bounds as JSON.

    CasADi loads it without plough_opt: by ``casadi.Function.load(path)`` in Python, MATLAB and Octave, and by
    ``casadi::Function::load`` in C++.

    If an input lies outside its bounds, the results are NaN, because steps and checks were not chosen for it. Bounds
    are widened by 1e-6 of their distance, by which optimisers relax them.

    Args:
        component: the component.
        path: path of the Function, ending in .casadi; an existing file is replaced.
        description: path of a JSON file with names, units, bounds and accuracy, ending in .json; None: no such file.

    Returns:
        The path.

    Raises:
        InputError: a path with another ending, or one that cannot be written.

    Example:
        >>> import tempfile
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
        >>> scene = po.Scene(soil, share, "50 kN/m", "30 kg", "2 m/s")
        >>> component = po.component(scene, 0.5, inputs=["scene.stiffness"], outputs=["mean_draft"])
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = po.export.write_casadi(component, f"{folder}/share.casadi")
        >>> path.name
        'share.casadi'
    """
    target = check_file(path, "serialised Function", ".casadi")
    files: dict[Path, Content] = {target: serialised(component)}
    if description is not None:
        files[check_file(description, "description", ".json")] = json.dumps(described(component), indent=2) + "\n"
    write_files(files, "serialised Function")
    return target


def serialised(component: Component) -> bytes:
    """Return the component's Function as CasADi writes it to a file; outside its bounds the results are NaN."""
    function = _nan_outside_bounds(component)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "function.casadi"
        function.save(str(file))
        return file.read_bytes()


def _nan_outside_bounds(component: Component) -> ca.Function:
    """Return the Function with NaN for all results if an input lies outside its bounds."""
    names = [port.argument for port in component.inputs]
    x = [ca.MX.sym(name) for name in names]
    slack = [RELAXATION * (port.upper - port.lower) for port in component.inputs]
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
        "inputs": [_port_data(port) for port in component.inputs],
        "outputs": [_port_data(port) for port in component.outputs],
        "method": component.accuracy.method,
        "steps": component.accuracy.steps,
        "error_estimate": component.error_estimate,
        "warnings": list(component.warnings),
        "versions": {package: version(package) for package in ("plough_opt", "casadi")},
    }


def _port_data(port: Port) -> dict[str, Any]:
    """Return a port as plain data; an infinite limit is None."""
    return {
        "name": port.name,
        "argument": port.argument,
        "unit": port.unit,
        "lower": port.lower if np.isfinite(port.lower) else None,
        "upper": port.upper if np.isfinite(port.upper) else None,
        "value": port.value,
        "size": port.size,
    }
