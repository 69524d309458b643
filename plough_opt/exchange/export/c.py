"""A component as C with a test that compares it with Python's values, and as a serialised CasADi Function."""

import json
import tempfile
from collections.abc import Iterable
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from string import Template
from typing import Any

import casadi as ca
import numpy as np

from plough_opt.core.compiler import code_of
from plough_opt.core.errors import InputError
from plough_opt.core.files import Content, check_file, check_new_folder, text_of, write_files, write_folder
from plough_opt.exchange.component import RELAXATION, Component, Port, corner_points, interior_points

MOST_ULP = 4
"""Units in the last place by which a compiled result may differ from Python's."""

# The written test compares at this many points inside the bounds, and at up to `_MOST_CORNERS` corners.
_TEST_POINTS = 6
_MOST_CORNERS = 9


def write_c(component: Component, path: str | Path) -> Path:
    """Write a component as C99 without dependencies, into a new folder.

    For a component named ``share`` the folder holds ``share.h`` and ``share.c`` with the values and the Jacobian;
    ``share_test.c``, which fails if a compiled result differs from Python's by more than 4 units in the last place;
    and a Makefile that runs this test. Compile with ``-ffp-contract=off``: a compiler that fuses products and sums
    rounds differently from Python.

    Args:
        component: the component; its name becomes the prefix of the C functions.
        path: path of the folder, which must not exist.

    Returns:
        The path.

    Raises:
        InputError: the folder exists or cannot be written, or CasADi cannot write the component as C.

    Example:
        >>> import tempfile
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
        >>> scene = po.Scene(soil, share, "50 kN/m", "30 kg", "2 m/s")
        >>> component = po.component(scene, 0.5, inputs=["scene.stiffness"], outputs=["mean_draft"])
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = po.export.write_c(component, f"{folder}/share")
        >>> path.name
        'share'
    """
    target, name, values = check_new_folder(path, "C source"), component.name(), _values(component)
    templates = {f"{name}.h": "component.h", f"{name}.c": "component.c", f"{name}_test.c": "component_test.c"}
    files = {file: Template(text_of(__package__, one)).substitute(values) for file, one in templates.items()}
    return write_folder(target, "C source", {**files, "Makefile": _MAKEFILE.replace("NAME", name)})


def _values(component: Component) -> dict[str, Any]:
    """Return what stands in the C files in place of names: sizes, CasADi's code, tables, and points with results.

    Raises:
        InputError: the component contains a root finder, for which CasADi generates no C.
    """
    name, inputs, x = component.name(), component.inputs, ca.MX.sym("x", len(component.inputs))
    values = ca.Function(f"{name}_values", [x], [ca.vertcat(*component.call(ca.vertsplit(x)))])
    # Transposed because CasADi stores matrices by columns, and the header promises rows.
    slopes = ca.Function(f"{name}_slopes", [x], [component.slopes(*ca.vertsplit(x)).T])
    if any(inner.class_name() == "Newton" for function in (values, slopes) for inner in function.find_functions()):
        raise InputError("CasADi writes no periodic orbit as C: export to casadi")
    outputs = [(port, k) for port in component.outputs for k in range(port.size)]
    texts = {
        "input_names": [port.name for port in inputs],
        "input_units": [port.unit for port in inputs],
        "output_names": [f"{port.name}[{k}]" if port.size > 1 else port.name for port, k in outputs],
        "output_units": [port.unit for port, _ in outputs],
    }
    quoted = {key: ",\n  ".join(json.dumps(one, ensure_ascii=False) for one in own) for key, own in texts.items()}
    tables = [f"const char *const {name}_{key}[] = {{\n  {own}\n}};" for key, own in quoted.items()]
    for key, side in (("lower", "lower"), ("upper", "upper"), ("values", "value")):
        tables.append(f"const double {name}_input_{key}[] = {{{_row(getattr(port, side) for port in inputs)}}};")
    points = [*interior_points(inputs)[:_TEST_POINTS], *corner_points(inputs)[:_MOST_CORNERS]]
    comment = "\n".join(f" * {line}".rstrip() for line in str(component).replace("*/", "* /").splitlines())
    sizes = {size: max(getattr(one, f"sz_{size}")() for one in (values, slopes)) + 1 for size in ("arg", "res", "iw")}
    results = {"evaluate": _rows(values(x).full().ravel() for x in points),
               "jacobian": _rows(slopes(x).full().ravel(order="F") for x in points)}  # fmt: skip
    return {
        "name": name, "upper": name.upper(), "version": version("plough_opt"), "comment": comment,
        "inputs": len(inputs), "outputs": len(outputs), "beyond": float(RELAXATION).hex(), "tables": "\n".join(tables),
        "graph": code_of(f"{name}_graph", [values, slopes]), "count": len(points), "points": _rows(points),
        "work_values": values.sz_w() + 1, "count_values": values.numel_out(0), "most": MOST_ULP,
        "work_slopes": slopes.sz_w() + 1, "count_slopes": slopes.numel_out(0), **sizes, **results,
    }  # fmt: skip


def _row(values: Iterable[float]) -> str:
    return ", ".join(float(value).hex() for value in values)


def _rows(values: Iterable[Iterable[float]]) -> str:
    return ",\n".join(f"  {{{_row(row)}}}" for row in values)


_MAKEFILE = """\
test: NAME_test
\t./NAME_test

NAME_test: NAME_test.c NAME.c NAME.h
\t$(CC) -std=c99 -O2 -ffp-contract=off NAME_test.c NAME.c -o NAME_test -lm
"""


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
    contents: dict[Path, Content] = {target: serialised(component)}
    if description is not None:
        contents[check_file(description, "description", ".json")] = json.dumps(described(component), indent=2) + "\n"
    write_files(contents, "serialised Function")
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
    limits = {side: end if np.isfinite(end) else None for side, end in (("lower", port.lower), ("upper", port.upper))}
    return {**asdict(port), "argument": port.argument, **limits}
