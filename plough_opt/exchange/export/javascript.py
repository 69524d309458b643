"""CasADi Functions as JavaScript, and a component as an ES module for web pages and node."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Iterable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import casadi as ca

from plough_opt.core.compiler import LANE_BY_LANE, LIBRARY, LIBRARY_OF_TWO, instructions, name_of
from plough_opt.core.errors import InputError
from plough_opt.core.files import check_file, text_of, write_file
from plough_opt.exchange.component import RELAXATION, Component, Port

# Operation -> expression of its operands. JavaScript's numbers are doubles, and a condition becomes 0 or 1.
_EXPRESSIONS: Final = {
    ca.OP_ASSIGN: "{0}", ca.OP_ADD: "{0} + {1}", ca.OP_SUB: "{0} - {1}", ca.OP_MUL: "{0} * {1}",
    ca.OP_DIV: "{0} / {1}", ca.OP_NEG: "-{0}", ca.OP_SQ: "{0} * {0}", ca.OP_TWICE: "{0} + {0}", ca.OP_INV: "1 / {0}",
    ca.OP_LT: "+({0} < {1})", ca.OP_LE: "+({0} <= {1})", ca.OP_EQ: "+({0} === {1})", ca.OP_NE: "+({0} !== {1})",
    ca.OP_AND: "+!!({0} && {1})", ca.OP_OR: "+!!({0} || {1})", ca.OP_NOT: "+!{0}",
    ca.OP_IF_ELSE_ZERO: "{0} ? {1} : 0", ca.OP_FMOD: "{0} % {1}",
    ca.OP_FABS: "Math.abs({0})", ca.OP_SIGN: "Math.sign({0})", ca.OP_FMIN: "least({0}, {1})",
    ca.OP_FMAX: "most({0}, {1})",
    # JavaScript has the functions of C except the error function.
    **{code: f"Math.{name}({{0}})" for code, name in (LIBRARY | LANE_BY_LANE).items() if name != "erf"},
    **{code: f"Math.{name}({{0}}, {{1}})" for code, name in LIBRARY_OF_TWO.items()},
}  # fmt: skip


class Source:
    """JavaScript of CasADi Functions, each written once.

    A Function becomes a function of arrays that returns an array of arrays. An array holds the elements of a matrix
    column by column, without those that are zero by structure.

    Args:
        asks: what the user can do if a Function cannot be written, at the end of the message.
    """

    def __init__(self, asks: str) -> None:
        self._asks, self._names, self._parts = asks, dict[int, str](), [text_of(__package__, "functions.js")]
        self._constants: dict[str, str] = {}
        self._written: dict[str, str] = {}
        self._kept: list[ca.Function] = []  # so that no other Function gets the hash of one that is gone

    def add(self, function: ca.Function) -> str:
        """Write a Function and all that it calls; return its name in JavaScript.

        Raises:
            InputError: it has an operation, or calls a kind of Function, without a JavaScript form.
        """
        key = hash(function)
        if key not in self._names:
            writers = {"SXFunction": self._scalar, "MXFunction": self._matrix, "Map": self._map}
            kind = function.class_name()
            if kind not in writers:
                raise self._refusal(f"CasADi's '{kind}' (in '{function.name()}')")
            arguments = ", ".join(f"a{k}" for k in range(function.n_in()))
            body = "\n".join(f"  {line}" for line in writers[kind](function))
            self._kept.append(function)
            text = f"({arguments}) {{\n{body}\n}}\n"
            if text not in self._written:
                self._written[text] = f"{function.name()}_{len(self._written)}"
                self._parts.append(f"function {self._written[text]}{text}")
            self._names[key] = self._written[text]
        return self._names[key]

    def __str__(self) -> str:
        """Return the JavaScript so far."""
        constants = [f"const {name} = {text};" for text, name in self._constants.items()]
        return "\n".join([*constants, *self._parts])

    def _refusal(self, what: str) -> InputError:
        return InputError(f"{what} has no JavaScript form: {self._asks}")

    def _constant(self, values: Iterable[float]) -> str:
        text = f"[{', '.join(map(number, values))}]"
        return self._constants.setdefault(text, f"constant_{len(self._constants)}")

    def _expression(self, code: int, of: list[str]) -> str:
        if code not in _EXPRESSIONS:
            raise self._refusal(f"the operation '{name_of(code)}'")
        return _EXPRESSIONS[code].format(*of)

    def _scalar(self, function: ca.Function) -> Iterable[str]:
        """Yield the statements of a Function of SX."""
        work: dict[int, str] = {}
        results = [["0"] * function.nnz_out(k) for k in range(function.n_out())]
        for count, (code, into, of, constant) in enumerate(instructions(function)):
            if code == ca.OP_INPUT:
                work[into[0]] = f"a{of[0]}[{of[1]}]"
            elif code == ca.OP_CONST:
                work[into[0]] = f"({number(constant)})" if constant < 0.0 else number(constant)
            elif code == ca.OP_OUTPUT:
                results[into[0]][into[1]] = work[of[0]]
            else:
                yield f"const x{count} = {self._expression(code, [work[j] for j in of])};"
                work[into[0]] = f"x{count}"
        rows = ", ".join(f"[{', '.join(one)}]" for one in results)
        yield f"return [{rows}];"

    def _map(self, function: ca.Function) -> Iterable[str]:
        """Yield the statements of a Function that applies another one to each column."""
        (inner,) = function.find_functions(0)
        count = function.size2_in(0) // inner.size2_in(0)
        arguments = ", ".join(f"a{k}" for k in range(function.n_in()))
        yield f"return mapped({self.add(inner)}, {count}, {arguments});"

    def _matrix(self, function: ca.Function) -> Iterable[str]:
        """Yield the statements of a Function of MX."""
        results: list[list[str]] = [[] for _ in range(function.n_out())]
        places = {j for k in range(function.n_instructions()) for j in function.instruction_output(k) if j >= 0}
        yield f"let {', '.join(f'w{j}' for j in sorted(places))};"
        for k in range(function.n_instructions()):
            code, node = function.instruction_id(k), function.instruction_MX(k)
            into, of = function.instruction_output(k), function.instruction_input(k)
            if code == ca.OP_INPUT:
                info = node.info()
                whole = node.nnz() == function.nnz_in(info["ind"])
                part = "" if whole else f".slice({info['offset']}, {info['offset'] + node.nnz()})"
                yield f"w{into[0]} = a{info['ind']}{part};"
            elif code == ca.OP_OUTPUT:
                # A later instruction may write to the same place.
                name = f"result_{k}"
                results[into[0]].append(name)
                yield f"const {name} = w{of[0]};"
            else:
                places_of = ", ".join(f"w{j}" if j >= 0 else "" for j in into)
                target = f"[{places_of}]" if len(into) > 1 or code in _SEVERAL else places_of
                yield f"{target} = {self._node(code, node, [f'w{j}' for j in of])};"
        joined = [one[0] if len(one) == 1 else f"[{', '.join(f'...{part}' for part in one)}]" for one in results]
        yield f"return [{', '.join(joined)}];"

    def _node(self, code: int, node: ca.MX, of: list[str]) -> str:
        """Return the expression of a matrix operation."""
        if code == ca.OP_CONST:
            return self._constant(ca.evalf(node).nonzeros())
        if code == ca.OP_CALL:
            return f"{self.add(node.which_function())}({', '.join(of)})"
        if code == ca.OP_MTIMES:
            return self._product(node, of)
        if code == ca.OP_GETNONZEROS:
            return self._elements(node.info(), of[0])
        if code in (ca.OP_HORZCAT, ca.OP_VERTCAT):
            return f"[{', '.join(f'...{one}' for one in of)}]"
        if code in _SEVERAL:
            sizes = [node.get_output(k).nnz() for k in range(node.n_out())]
            ends = [sum(sizes[:k]) for k in range(len(sizes) + 1)]
            return f"[{', '.join(f'{of[0]}.slice({a}, {b})' for a, b in itertools.pairwise(ends))}]"
        if code == ca.OP_HORZREPMAT:
            return f"Array({node.nnz() // node.dep(0).nnz()}).fill({of[0]}).flat()"
        if code == ca.OP_RESHAPE or (code == ca.OP_TRANSPOSE and node.is_vector()):
            return of[0]
        if code == ca.OP_TRANSPOSE and node.is_dense():
            return f"transposed({of[0]}, {node.size2()})"
        if code == ca.OP_DOT:
            return f"[pairwise((x, y) => x * y, {of[0]}, {of[1]}).reduce((sum, x) => sum + x, 0)]"
        apply = "each((x) => {}, {})" if len(of) == 1 else "pairwise((x, y) => {}, {})"
        return apply.format(self._expression(code, ["x", "y"][: len(of)]), ", ".join(of))

    def _elements(self, info: Mapping[str, Any], of: str) -> str:
        """Return the expression of some elements of an array."""
        if "slice" in info and info["slice"]["step"] == 1:
            return f"{of}.slice({info['slice']['start']}, {info['slice']['stop']})"
        ranges = [range(*(info[name][key] for key in ("start", "stop", "step")))
                  for name in ("slice", "outer", "inner") if name in info]  # fmt: skip
        which = map(sum, itertools.product(*ranges)) if ranges else info["nz"]
        return f"{self._constant(which)}.map((i) => {of}[i])"

    def _product(self, node: ca.MX, of: list[str]) -> str:
        """Return the expression of a sum and a product of matrices, of which only the last may be sparse."""
        left, right = node.dep(1).sparsity(), node.dep(2).sparsity()
        if not (left.is_dense() and node.is_dense()):
            raise self._refusal("a product whose first matrix is sparse")
        start, row = self._constant(right.colind()), self._constant(right.row())
        return f"product({', '.join(of)}, {left.size1()}, {start}, {row})"


_SEVERAL: Final = (ca.OP_CALL, ca.OP_HORZSPLIT, ca.OP_VERTSPLIT)


def number(value: float) -> str:
    """Return a number in JavaScript."""
    return "NaN" if math.isnan(value) else repr(value).replace("inf", "Infinity")


def write_javascript(component: Component, path: str | Path) -> Path:
    """Write a component as an ES module without dependencies, for any web page and for node.

    It exports ``inputs`` and ``outputs`` with names, units, bounds and values, and ``evaluate(values)``, from values by
    name to results by name in SI units, with JSDoc types. Inputs that the caller omits have their values. It throws a
    TypeError if a value is not a finite number, such as a text, and a RangeError if an input is unknown, a value lies
    outside its bounds by more than a millionth of their distance, or a result is not finite.

    Args:
        component: the component.
        path: path of the module, ending in .mjs or .js; an existing file is replaced.

    Returns:
        The path.

    Raises:
        InputError: another ending, a file that cannot be written, or a scene that JavaScript cannot represent.

    Example:
        >>> import tempfile
        >>> import plough_opt as po
        >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
        >>> scene = po.Scene(po.named_soil("serozem"), share, "50 kN/m", "30 kg", "2 m/s")
        >>> component = po.component(scene, 0.5, inputs=["scene.stiffness"], outputs=["loosened_radius"])
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = po.export.write_javascript(component, f"{folder}/share.mjs")
        >>> path.name
        'share.mjs'
    """
    target = check_file(path, "JavaScript module", ".mjs", ".js")
    source = Source("export to c or casadi instead, or leave out the effect that needs it")
    values = source.add(component)
    heading = str(component).replace("*/", "* /").replace("\n", "\n * ")
    parts = (
        f"// Written by plough_opt {version('plough_opt')}. It needs nothing else.\n/*\n * {heading}\n */\n",
        _types("Values", "Values of the inputs in SI units; one that is left out has its own.", component.inputs, "?"),
        _types("Results", "Results in SI units.", component.outputs),
        _list("Input", "inputs", map(_input, component.inputs)),
        _list("Output", "outputs", map(_output, component.outputs)),
        text_of(__package__, "module.mjs"),
        f"const RELAXATION = {number(RELAXATION)};\n\n{source}\nconst computed = {values};\n",
    )
    return write_file(target, "JavaScript module", "\n".join(parts))


def _input(port: Port) -> dict[str, Any]:
    return {"name": port.name, "unit": port.unit, "lower": port.lower, "upper": port.upper, "value": port.value}


def _output(port: Port) -> dict[str, Any]:
    low, high = (limit if math.isfinite(limit) else None for limit in (port.lower, port.upper))
    return {"name": port.name, "unit": port.unit, "atLeast": low, "atMost": high, "size": port.size}


def _list(kind: str, name: str, entries: Iterable[dict[str, Any]]) -> str:
    """Return the export of a list of objects of one JSDoc type."""
    text = json.dumps([*entries], indent=2, ensure_ascii=False)
    return f"/** @type {{{kind}[]}} */\nexport const {name} = {text};\n"


def _types(name: str, about: str, ports: Iterable[Port], optional: str = "") -> str:
    """Return a JSDoc type whose members are ports, a line with unit and limits for each."""
    lines = []
    for port in ports:
        many = f" at {port.size} output times" if port.size > 1 else ""
        of = f"in {port.unit or 'no unit'}{many}{port.limits and ', '}{port.limits}".replace("*/", "* /")
        lines.append(f" *   {json.dumps(port.name)}{optional}: number{'[]' if port.size > 1 else ''}, // {of}")
    return "\n".join(["/**", f" * {about}", " * @typedef {{", *lines, f" * }}}} {name}", " */"])
